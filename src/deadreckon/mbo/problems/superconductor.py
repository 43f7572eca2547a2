"""Superconductors: the critical temperature of a material, from what it is made of (Hamidieh 2018; thesis 6.5).

Designs are 81 statistics of the elements' properties, as in the thesis, or 86 amounts of the elements H to Rn. Both are
computed from chemical formulas with the package's own table of elements (`elements.csv`; mendeleev's values), so they differ a
little from those of UCI's `train.csv`, which is read too.
"""

import csv
import math
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from deadreckon.data.arrow import flat, some_numbers
from deadreckon.errors import UserError, reading, unknown
from deadreckon.mbo.design_table import numbers_of
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.problem import Problem, file_of, hidden
from deadreckon.mbo.problems.trees import boosted, forest
from deadreckon.mbo.variables import Variable

FILE = "superconductor.csv"
SOURCE = "formulas and critical temperatures: a CSV with columns name and Tc, or train.csv or unique_m.csv of UCI data set 464"
STATISTICS = ("mean", "wtd_mean", "gmean", "wtd_gmean", "entropy", "wtd_entropy", "range", "wtd_range", "std", "wtd_std")
FORMS = ("statistics", "composition")
ORACLES = {"forest": forest, "boosting": boosted}
_PART = re.compile(r"([A-Z][a-z]?)(\d+\.?\d*|\.\d+)?")
_HYDROGEN = {"D": "H", "T": "H"}


@cache
def _table() -> tuple[list[str], dict[str, np.ndarray]]:
    text = files("deadreckon.mbo.problems").joinpath("elements.csv").read_text("utf-8")
    head, *rows = csv.reader(text.splitlines())
    return head[1:], {symbol: np.array([float(v) if v else np.nan for v in values]) for symbol, *values in rows}


def elements() -> dict[str, np.ndarray]:
    """Symbol -> (8,) properties of the elements H to Rn; NaN where a value is not known."""
    return _table()[1]


def properties() -> list[str]:
    """Names of the eight."""
    return _table()[0]


def amounts(formula: str) -> dict[str, float]:
    """Atoms of each element in a formula unit such as `Ba0.4K0.6Fe2As2`.

    Raises:
        UserError: it is no such formula, or holds an element beyond Rn.
    """
    found: dict[str, float] = {}
    at = 0
    for part in _PART.finditer(formula):
        symbol = _HYDROGEN.get(part[1], part[1])
        if part.start() != at or symbol not in elements():
            break
        found[symbol] = found.get(symbol, 0.0) + float(part[2] or 1)
        at = part.end()
    if at != len(formula) or not found or sum(found.values()) <= 0:
        raise UserError(f"{formula!r} is not a formula of elements H to Rn with amounts, such as Ba0.4K0.6Fe2As2")
    return {symbol: amount for symbol, amount in found.items() if amount > 0}


def composition(found: Mapping[str, float]) -> np.ndarray:
    """(86,) atoms of each element."""
    return np.array([found.get(symbol, 0.0) for symbol in elements()])


def statistics(found: Mapping[str, float]) -> np.ndarray:
    """(81,) number of elements, then ten statistics of each of eight properties (Hamidieh 2018, table 2).

    With t the property's values and p the shares of the elements, w = t / sum(t) and v = p w / sum(p w): means t and p t,
    geometric means, entropies of w and v, ranges of t and p t, deviations of t, plain and weighted by p. An element whose value
    is not known is left out.
    """
    symbols = list(found)
    share = np.array([found[symbol] for symbol in symbols])
    table = np.array([elements()[symbol] for symbol in symbols])
    out = [float(len(symbols))]
    for t in table.T:
        known = np.isfinite(t)
        out += _ten(np.maximum(t[known], 0.0), share[known]) if known.any() else [0.0] * len(STATISTICS)
    return np.array(out)


def _ten(t: np.ndarray, share: np.ndarray) -> list[float]:
    p = share / share.sum()
    w = t / t.sum() if t.sum() > 0 else np.full(len(t), 1 / len(t))
    v = p * w / (p * w).sum() if (p * w).sum() > 0 else p
    log = np.log(np.maximum(t, 1e-6))
    mean, weighted = t.mean(), (p * t).sum()
    entropy = lambda q: float(-(q[q > 0] * np.log(q[q > 0])).sum())  # noqa: E731
    return [
        mean, weighted, float(np.exp(log.mean())), float(np.exp((p * log).sum())), entropy(w), entropy(v),
        float(np.ptp(t)), float(np.ptp(p * t)), float(t.std()), float(np.sqrt((p * np.square(t - weighted)).sum())),
    ]  # fmt: skip


def superconductor(
    name: str = "superconductor",
    *,
    path: Path | str | None = None,
    form: Literal["statistics", "composition"] = "statistics",
    shown: float = 80.0,
    oracle: Literal["forest", "boosting"] = "forest",
    bounded: bool = True,
) -> Problem:
    """Materials with a critical temperature in K, of which the colder part is shown; the oracle is learned from all.

    The benchmark of 2020, which the thesis's tables are of, scored designs by gradient boosting and had no bounds
    (`superconductor-boosting` among the problems); a random forest and bounds are of later versions.

    Args:
        name: of the problem.
        path: a CSV with columns `name` (formula) and `Tc`, UCI's `train.csv` (statistics) or `unique_m.csv` (composition);
            None: the package's folder of designs. Rows without a positive temperature and formulas that cannot be read are left
            out; a formula that is there several times counts once, with its mean.
        form: of the designs: `statistics` (81) or `composition` (86).
        shown: percentile of the temperatures up to which materials are shown.
        oracle: `forest` (100 trees) or `boosting` (374 trees; the first time it trains for minutes).
        bounded: whether designs lie in the range of the data, or anywhere.

    Raises:
        UserError: the file is missing or holds something else.
    """
    if form not in FORMS:
        raise unknown("form", form, FORMS)
    if oracle not in ORACLES:
        raise unknown("oracle", oracle, ORACLES)
    place = file_of("superconductor", path, FILE, SOURCE)
    with reading(place, "CSV"):
        table = arrow_csv.read_csv(place)
    columns = set(table.column_names)
    wide = _names(form) if form == "composition" else [f for f in table.column_names if f != "critical_temp"]
    if {"name", "Tc"} <= columns:
        x, y = _of_formulas(table, form, str(place))
        names = _names(form)
    elif "critical_temp" in columns and set(wide) <= columns and len(wide) == (86 if form == "composition" else 81):
        rows = np.arange(table.num_rows)
        x = np.stack([numbers_of(str(place), table, column, rows) for column in wide], 1)
        y, names = numbers_of(str(place), table, "critical_temp", rows), wide
    else:
        raise UserError(f"{place}: neither columns name and Tc, nor critical_temp and the columns of {form}, as in {SOURCE}")
    ends = [_ends(column) if bounded else (-math.inf, math.inf) for column in x.astype(np.float32).T]
    variables = tuple(Variable(column, "continuous", *each) for column, each in zip(names, ends))
    full = Designs(x, y, variables, "superconductor", "critical temperature, K")
    judge = ORACLES[oracle](f"superconductor-{form}", x, y)
    return hidden(name, full, judge, judge.about, most=shown)


def _ends(column: np.ndarray) -> tuple[float, float]:
    return float(column.min()), float(column.max())


def _names(form: str) -> list[str]:
    if form == "composition":
        return list(elements())
    return ["number_of_elements", *(f"{statistic}_{name}" for name in properties() for statistic in STATISTICS)]


def _of_formulas(table: pa.Table, form: str, place: str) -> tuple[np.ndarray, np.ndarray]:
    """Designs and temperatures, a row a material."""
    found: dict[tuple[tuple[str, float], ...], list[float]] = {}
    temperatures = some_numbers(place, "Tc", flat(table, "Tc"))[0].tolist()  # NaN where it is missing
    for formula, temperature in zip(table.column("name").to_pylist(), temperatures):
        if not temperature > 0:
            continue
        try:
            parts = amounts(str(formula))
        except UserError:
            continue
        found.setdefault(tuple(sorted(parts.items())), []).append(temperature)
    if not found:
        raise UserError(f"{place}: no row has a formula of elements H to Rn and a temperature above 0")
    of = composition if form == "composition" else statistics
    return np.stack([of(dict(parts)) for parts in found]), np.array([np.mean(t) for t in found.values()])
