"""Learned oracles: trained once, on all but a tenth of the data, and kept in the package's folder of designs."""

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np

from deadreckon.files import home
from deadreckon.training.checkpoint import load_arrays, save_arrays

HELD_OUT = 0.1  # share of the data that tells how good an oracle is

Arrays = tuple[dict[str, np.ndarray], dict[str, Any]]  # arrays, and JSON values


def split(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are held out and all others, drawn with a seed that never changes."""
    out, rest = np.split(np.random.default_rng(0).permutation(rows), [round(HELD_OUT * rows)])
    return out, rest


def kept(name: str, x: np.ndarray, y: np.ndarray, settings: tuple[Any, ...], train: Callable[[], Arrays]) -> Arrays:
    """What `train` makes of data and settings; it is called where that is not known yet.

    Args:
        name: of the file, before the digest of all that follows.
        x: designs of the data.
        y: their scores.
        settings: numbers and texts that `train` depends on.
        train: fits the oracle.
    """
    digest = hashlib.blake2b(x.tobytes() + y.tobytes() + repr((*settings, HELD_OUT)).encode(), digest_size=8).hexdigest()
    place = home() / "designs" / "oracles" / f"{name}-{digest}.npz"
    if not place.exists():
        save_arrays(place, *train())
    return load_arrays(place)
