"""A design problem: the scored designs that methods see, and the oracle that they do not."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from deadreckon.data.arrow import is_text
from deadreckon.errors import UserError
from deadreckon.files import home
from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs

Oracle = Callable[[np.ndarray], np.ndarray]  # (n, variables) designs as `Designs.x` holds them -> (n,) true scores


@dataclass(frozen=True)
class Scores:
    """What proposed designs are truly worth.

    Attributes:
        problem, method: names.
        true: (n,) by the oracle.
        predicted: (n,) what the method believed; NaN where it believed nothing.
        low, high: least and greatest score of all data of the problem, shown or not: 0 and 1 of normalised scores.
    """

    problem: str
    method: str
    true: np.ndarray
    predicted: np.ndarray
    low: float
    high: float

    def percentile(self, q: float = 100.0, normalised: bool = False) -> float:
        """A percentile of the true scores: 100 is the best design, 50 the median (thesis 6.6)."""
        found = float(np.percentile(self.true, q))
        return (found - self.low) / (self.high - self.low) if normalised else found

    @property
    def exploitation(self) -> float:
        """Median of predicted less true scores, in ranges of all data; NaN where nothing was predicted."""
        return float(np.median(self.predicted - self.true) / (self.high - self.low))

    def __str__(self) -> str:
        best, middle = (f"{self.percentile(q):,.4g} ({self.percentile(q, True):.2f})" for q in (100, 50))
        predicted = "" if np.isnan(self.exploitation) else f", predicted {np.median(self.predicted):,.4g}"
        return f"{self.method} on {self.problem}: best of {len(self.true)} {best}, median {middle}{predicted}"


@dataclass(frozen=True, eq=False)
class Problem:
    """A design problem.

    Attributes:
        name: of the problem.
        visible: what methods see.
        low, high: least and greatest score of all data, shown or not.
        oracle: the true scores of designs.
        about: one line: what the oracle is, and how far it can be trusted.
        optimum: the greatest score that any design has, where it is known.
    """

    name: str
    visible: Designs
    low: float
    high: float
    oracle: Oracle
    about: str
    optimum: float | None = None

    def score(self, designs: Proposals | np.ndarray) -> Scores:
        """What designs are truly worth.

        Args:
            designs: a method's proposals, or (n, variables) designs.

        Raises:
            UserError: designs that the problem's variables do not allow.
        """
        made = designs if isinstance(designs, Proposals) else None
        x = np.asarray(designs.x if isinstance(designs, Proposals) else designs, np.float32)
        self.visible.check(x)
        true = np.asarray(self.oracle(x), np.float64)
        predicted = np.full(len(x), np.nan) if made is None else made.predicted
        return Scores(self.name, "designs" if made is None else made.method, true, predicted, self.low, self.high)


def hidden(
    name: str, full: Designs, oracle: Oracle, about: str, *, least: float = 0.0, most: float, limit: int | None = None,
    optimum: float | None = None,
) -> Problem:  # fmt: skip
    """A problem that shows those of its designs whose scores lie between two percentiles.

    Args:
        name: of the problem.
        full: all designs.
        oracle: see `Problem`.
        about: see `Problem`.
        least: percentile of the least score that is shown.
        most: percentile of the greatest.
        limit: designs shown at most, drawn from the others with a seed that never changes.
        optimum: see `Problem`.

    Raises:
        UserError: the percentiles are not in order between 0 and 100, or too few designs are left (`Designs`).
    """
    if not 0 <= least <= most <= 100:
        raise UserError(f"{name}: percentiles of shown scores ascend from 0 to 100 at most, got {least:g} and {most:g}")
    low, high = np.percentile(full.y, [least, most])
    rows = np.flatnonzero((full.y >= low) & (full.y <= high))
    if limit is not None and len(rows) > limit:
        rows = np.sort(np.random.default_rng(0).choice(rows, limit, replace=False))
    return Problem(name, full.part(rows, name), float(full.y.min()), float(full.y.max()), oracle, about, optimum)


def texts_of(place: Path, table: pa.Table, column: str) -> list[str]:
    """The cells of a column of texts; empty ones are empty texts.

    Raises:
        UserError: the column holds something else.
    """
    cells = table.column(column)
    if not (is_text(cells.type) or pa.types.is_null(cells.type)):
        raise UserError(f"{place}: column {column} must hold texts, got {cells.type}")
    return [text or "" for text in cells.to_pylist()]


def file_of(name: str, path: Path | str | None, file: str, source: str) -> Path:
    """Where a problem's data lies: as given, or in the package's folder of designs.

    Raises:
        UserError: it is not there; the line says where it comes from and where to put it.
    """
    found = home() / "designs" / file if path is None else Path(path)
    if not found.is_file():
        there = "" if path is None else f" {path} is not there;"
        raise UserError(f"{name} needs {file} ({source}):{there} give --path, or put it at {home() / 'designs' / file}")
    return found
