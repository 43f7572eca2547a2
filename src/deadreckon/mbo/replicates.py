"""Rows of the same design as one row, with the mean score and its standard error."""

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from deadreckon.errors import UserError
from deadreckon.mbo.design_table import numbers_of
from deadreckon.mbo.variables import FEWEST

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs


def pooled(data: "Designs") -> "Designs":
    """The same data with one row a design; how many were pooled, and how far they scatter, is told in a warning.

    A pooled score is the mean of its rows; where these have standard errors above 0, the mean weighed by their inverse squares.
    Its standard error follows from those of the rows where they are given, else from the scatter within designs, pooled over
    all designs (the pooled variance of one-way analysis of variance): s / sqrt(measurements), for unreplicated designs too.
    Data without replicates is given back as it is, and so is data of fewer than `FEWEST` different designs. Where all
    replicates have the same score to the last digit, and the same standard error, nothing is learned of the noise: of each
    design one row is kept.
    """
    _, first, which = np.unique(data.x, axis=0, return_index=True, return_inverse=True)
    which = which.reshape(-1)
    if len(first) == len(data) or len(first) < FEWEST:
        return data
    order = np.argsort(first)  # designs in the order of the table
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    which, first = rank[which], first[order]
    count = np.bincount(which).astype(np.float64)
    given = data.std_error
    weight = np.ones(len(data)) if given is None or not (given > 0).all() else 1.0 / np.square(given)
    y = np.bincount(which, weight * data.y) / np.bincount(which, weight)
    freedom = len(data) - len(first)
    plain = np.bincount(which, data.y) / count
    scatter = float(np.sqrt(np.square(data.y - plain[which]).sum() / freedom))
    repeated, of = int(count[count > 1].sum()), int((count > 1).sum())
    told = f"{repeated} rows are replicates of {of} design{'s' * (of > 1)}"
    if all((each == each[first][which]).all() for each in (data.y, *([] if given is None else [given]))):
        told += f" with the same {data.target} to the last digit; one of each is kept, as if the others were copies"
        warnings.warn(f"{data.name}: {told}", stacklevel=3)
        error = None if given is None else given[first]
        kept = {"table_rows": data.numbered(first), "pooling": told}
        return replace(data, x=data.x[first], y=data.y[first], std_error=error, **kept)
    if given is None:
        error = scatter / np.sqrt(count)
    else:
        error = np.sqrt(np.bincount(which, np.square(weight * given))) / np.bincount(which, weight)
    told += f" and are pooled; the standard deviation of {data.target} between replicates is {scatter:.3g}"
    warnings.warn(f"{data.name}: {told}", stacklevel=3)
    return replace(
        data, x=data.x[first], y=y, pooling=told,
        replicates=count, std_error=error, table_rows=data.numbered(first),
    )  # fmt: skip


def noise_beyond(data: "Designs") -> float:
    """Standard deviation of the noise that one measurement has beyond that of a usual row, where rows are means of several.

    The mean of m measurements has the standard error e if each has the variance m e^2, of which (m - 1) e^2 is beyond that of
    the row; the root of its mean over rows. It is known from replicates, and no model's guess: a model that takes noise for
    signal believes that there is none.
    """
    if data.replicates is None or data.std_error is None:
        return 0.0
    return float(np.sqrt(((data.replicates - 1.0) * np.square(data.std_error)).mean()))


def errors_of(name: str, table: pa.Table, column: str, rows: np.ndarray) -> np.ndarray:
    """(rows,) standard errors, as `numbers_of` gives numbers.

    Raises:
        UserError: one of them is negative, or no finite number.
    """
    error = numbers_of(name, table, column, rows)
    if (error < 0).any():
        row = int(error.argmin())
        raise UserError(f"{name}: column {column} is {error[row]:g} in row {rows[row]}, standard errors are 0 or more")
    return error
