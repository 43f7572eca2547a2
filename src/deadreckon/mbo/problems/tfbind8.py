"""TFBind8: DNA of eight bases that a transcription factor binds (Barrera et al. 2016); every design has a measured score."""

from pathlib import Path

import numpy as np

from deadreckon.errors import UserError
from deadreckon.foreign.archive import read_arrays
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.problem import Problem, file_of, hidden
from deadreckon.mbo.variables import Variable

FILE, SOURCE = "tfbind8_six6.npz", "arrays x and y of Design-Bench's TFBind8, SIX6 reference 1"
BASES, LENGTH = ("A", "C", "G", "T"), 8


def tfbind8(*, path: Path | str | None = None, shown: float = 50.0) -> Problem:
    """All 65,792 sequences, of which the half that binds worse is shown.

    Args:
        path: of an npz with x (rows, 8) in 0 .. 3 and y (rows,); None: the package's folder of designs.
        shown: percentile of the scores up to which designs are shown.

    Raises:
        UserError: the file is missing, or holds something else.
    """
    place = file_of("tfbind8", path, FILE, SOURCE)
    x, y = _arrays(place)
    codes = x @ len(BASES) ** np.arange(LENGTH)
    # The 256 palindromes are there twice, with the same score.
    table = np.full(len(BASES) ** LENGTH, np.nan)
    table[codes] = y
    if np.isnan(table).any():
        raise UserError(f"{place}: {int(np.isnan(table).sum()):,} of {len(table):,} sequences have no score")

    def oracle(designs: np.ndarray) -> np.ndarray:
        return table[np.asarray(designs).astype(int) @ len(BASES) ** np.arange(LENGTH)]

    variables = tuple(Variable(f"base{i}", "categorical", levels=BASES) for i in range(LENGTH))
    full = Designs(x, y, variables, "tfbind8")
    return hidden("tfbind8", full, oracle, "exact: every sequence is measured", most=shown, optimum=float(y.max()))


def _arrays(place: Path) -> tuple[np.ndarray, np.ndarray]:
    """Bases (rows, 8) of sequences and their scores (rows,)."""
    arrays = read_arrays(place, "an npz with arrays x and y")
    if not {"x", "y"} <= arrays.keys() or any(arrays[key].dtype.kind not in "biuf" for key in ("x", "y")):
        raise UserError(f"{place}: no npz with arrays x and y of numbers, as in {SOURCE}")
    x, y = arrays["x"], arrays["y"].reshape(-1).astype(np.float64)
    if x.ndim != 2 or x.shape[1] != LENGTH or not np.isin(x, range(len(BASES))).all():
        raise UserError(f"{place}: x must be (rows, {LENGTH}) with bases 0 .. {len(BASES) - 1}, got {x.shape}")
    if len(x) != len(y):
        raise UserError(f"{place}: x and y must have equally many rows, got {len(x):,} and {len(y):,}")
    return x.astype(int), y
