"""The evaluation protocol of design methods (thesis 6.6): best and median score of 128 designs by the oracle, over seeds, and
published scores for comparison.

The oracle is queried once, after a method has made its proposals; no method has access to its scores.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from deadreckon.errors import UserError
from deadreckon.files import digest, read_json, write_json
from deadreckon.mbo.designer import Designer
from deadreckon.mbo.nn_distance import nn_distance
from deadreckon.mbo.problems.problem import Problem, Scores
from deadreckon.names import file_part
from deadreckon.progress import Watcher, unwatched
from deadreckon.stats.interval import Interval
from deadreckon.stats.means import student_interval
from deadreckon.training.revisions import of_learning, revisions

REVISION = 1  # of the evaluation protocol; raised if scores change (see bench/identity.py)
# Problems that differ only in the oracle from the one in the thesis's tables.
SAME = {"superconductor-boosting": "superconductor", "gfp-gp": "gfp"}
PERCENTILES = {100: "Best of the designs", 50: "Median design"}


@dataclass(frozen=True)
class Result:
    """The scores of a method's proposals on a problem.

    Attributes:
        problem, method: names.
        seeds: of the proposals.
        true, predicted: (seeds, n) scores by the oracle, and predictions of the method (NaN if it makes none).
        predicted_std: (seeds, n) standard deviations of the predictions (NaN if there are none).
        nn_distance: (seeds, n) distance to the nearest design of the visible data (`mbo.nn_distance`).
        low, high: least and greatest score of all data of the problem.
        data_best: the greatest score of the visible data.
        about: what the oracle is.
        settings: the designer, as text.
        seconds: computation time of all proposals, without scoring.
    """

    problem: str
    method: str
    seeds: tuple[int, ...]
    true: np.ndarray
    predicted: np.ndarray
    predicted_std: np.ndarray
    nn_distance: np.ndarray
    low: float
    high: float
    data_best: float
    about: str
    settings: str
    seconds: float

    def scores(self, i: int) -> Scores:
        """Scores of the i-th seed."""
        return Scores(self.problem, self.method, self.true[i], self.predicted[i], self.low, self.high)

    def percentile(self, q: float, normalised: bool = False) -> Interval:
        """A percentile of the true scores: mean over seeds, with a Student's t interval."""
        return student_interval(np.array([self.scores(i).percentile(q, normalised) for i in range(len(self.seeds))]))

    @property
    def exploitation(self) -> Interval:
        """Predicted minus true scores, in ranges of all data (`Scores.exploitation`); mean over seeds, with its interval."""
        return student_interval(np.array([self.scores(i).exploitation for i in range(len(self.seeds))]))

    @property
    def distance(self) -> Interval:
        """Median distance of the designs to the visible data, where 1 is typical; mean over seeds, with its interval."""
        return student_interval(np.median(self.nn_distance, 1))

    @property
    def uncertainty(self) -> Interval:
        """Median predicted standard deviation, in ranges of all data; mean over seeds, with its interval."""
        return student_interval(np.median(self.predicted_std, 1) / (self.high - self.low))


def evaluate_designers(
    problem: Problem,
    designers: Iterable[tuple[str, Designer]],
    n: int = 128,
    *,
    seeds: Sequence[int] = range(16),
    together: int | None = None,
    out: Path | str | None = None,
    watch: Watcher = unwatched,
    on_result: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """Runs design methods on a problem, and scores their proposals by the oracle.

    Args:
        problem: the design problem.
        designers: (name in tables, designer) of each method.
        n: number of proposals of each.
        seeds: one set of proposals each.
        together: seeds of one program, 1 or more; None: all. Fewer take less memory.
        out: folder for results and checkpoints; existing results are not computed again.
        watch: see `Designer.propose`.
        on_result: called with every result.

    Returns:
        One result per method.

    Raises:
        UserError: `together` is below 1.
    """
    if together is not None and together < 1:
        raise UserError(f"together must be 1 or more, got {together}")
    visible = problem.visible
    known = visible.x.tobytes() + visible.y.tobytes() + repr(visible.variables).encode()
    data = hashlib.blake2b(known, digest_size=8).hexdigest()
    results = []
    for name, designer in designers:
        settings = designer.settings_text(visible)
        asked = {
            "name": name, "settings": settings, "n": n, "seeds": list(seeds), "data": data, "oracle": problem.about,
            "revisions": of_learning() | {"method": revisions(designer), "protocol": REVISION},
        }  # fmt: skip
        folder = None if out is None else Path(out) / file_part(problem.name)
        path = None if folder is None else folder / f"{file_part(name)}-{digest(asked, 4)}.json"
        if path is not None and path.exists():
            result = _from_json(read_json(path, _Kept)["result"])
        else:
            found = []
            for at in range(0, len(seeds), together or len(seeds)):
                some = list(seeds[at : at + (together or len(seeds))])
                fits = None if folder is None else folder / "fits"
                found.append(designer.propose_many(visible, n, seeds=some, out=fits, watch=watch, distinct=False))
            made = [each for part in found for each in part]
            scores = [problem.score(each) for each in made]
            result = Result(
                problem.name, name, tuple(seeds), np.stack([s.true for s in scores]), np.stack([s.predicted for s in scores]),
                np.stack([each.predicted_std for each in made]), np.stack([nn_distance(visible, each.x) for each in made]),
                problem.low, problem.high, float(visible.y.max()), problem.about, settings,
                sum(part[0].seconds for part in found),
            )  # fmt: skip
            if path is not None:
                write_json(path, {"asked": asked, "result": _to_json(result)})
        results.append(result)
        on_result(result)
    return results


class _Told(TypedDict):
    problem: str
    method: str
    seeds: list[int]
    true: list[list[float]]
    predicted: list[list[float]]
    predicted_std: list[list[float]]
    nn_distance: list[list[float]]
    low: float
    high: float
    data_best: float
    about: str
    settings: str
    seconds: float


class _Kept(TypedDict):
    """The contents of a result file."""

    result: _Told


def _to_json(result: Result) -> dict[str, Any]:
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(result).items()}


def _from_json(fields: dict[str, Any]) -> Result:
    arrays = {name: np.asarray(fields[name], float) for name in ("true", "predicted", "predicted_std", "nn_distance")}
    told: dict[str, Any] = {**fields, **arrays, "seeds": tuple(fields["seeds"])}
    return Result(**told)


@cache
def published() -> dict[str, dict[str, dict[str, tuple[float, float]]]]:
    """Percentile -> problem -> method -> mean and standard deviation, as printed in the thesis for Design-Bench's data."""
    found = json.loads(files("deadreckon.mbo").joinpath("published.json").read_text("utf-8"))
    for q in map(str, PERCENTILES):
        found[q] |= {name: found[q][same] for name, same in SAME.items()}
    return found


def markdown(results: Sequence[Result], q: int = 100, normalised: bool = False) -> str:
    """A Markdown table of one percentile: a row per problem, below it the thesis's values, a column per method.

    Args:
        results: of one or several problems.
        q: 100 or 50.
        normalised: whether scores are scaled such that those of all data of the problem range from 0 to 1.

    Raises:
        UserError: two results of one method on one problem.
    """
    methods = list(dict.fromkeys(r.method for r in results))
    lines = ["| problem | data | " + " | ".join(methods) + " |", "|---|---:|" + "---:|" * len(methods)]
    for name in dict.fromkeys(r.problem for r in results):
        own = _by_method([r for r in results if r.problem == name])
        first = next(iter(own.values()))
        best = (first.data_best - first.low) / (first.high - first.low) if normalised else first.data_best
        cells = [_shown(own[m].percentile(q, normalised)) if m in own else "" for m in methods]
        lines.append(f"| {name} | {best:,.4g} | " + " | ".join(cells) + " |")
        printed = published()[str(q)].get(name, {})
        if printed and not normalised:
            cells = [f"{printed[m][0]:,.4g} ± {printed[m][1]:,.4g}" if m in printed else "" for m in methods]
            data = f"{printed['data'][0]:,.4g}" if "data" in printed else ""
            lines.append(f"| thesis | {data} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


COLUMNS = {
    "exploitation": "Overestimation: predicted less true score, in ranges of all data (NEMO cannot predict more than the "
    "middle of its last bin, DDOM no more than the best of the data)",
    "uncertainty": "Median predicted standard deviation, in ranges of all data",
    "distance": "Median distance to the nearest design shown, 1 being typical among these",
}


def trust(results: Sequence[Result], what: str) -> str:
    """A Markdown table of one measure of reliability: a row per problem, a column per method.

    Args:
        results: of one or several problems.
        what: among `COLUMNS`.
    """
    methods = list(dict.fromkeys(r.method for r in results))
    lines = ["| problem | " + " | ".join(methods) + " |", "|---|" + "---:|" * len(methods)]
    for name in dict.fromkeys(r.problem for r in results):
        own = _by_method([r for r in results if r.problem == name])
        lines.append(f"| {name} | " + " | ".join(_shown(getattr(own[m], what)) if m in own else "" for m in methods) + " |")
    return "\n".join(lines)


def tables(results: Sequence[Result]) -> str:
    """All tables in Markdown: both percentiles, unscaled and normalised, and the measures of reliability."""
    parts = []
    for q, words in PERCENTILES.items():
        parts += [f"{words}, by the oracle", markdown(results, q)]
        normalised = markdown(results, q, normalised=True)
        parts += [f"{words}, normalised: 0 and 1 are the least and the greatest of all data", normalised]
    for what, words in COLUMNS.items():
        parts += [words, trust(results, what)]
    settings = dict.fromkeys(f"- {r.method}: `{r.settings}`" for r in results)
    return "\n\n".join([*parts, "Settings", "\n".join(settings)])


def _shown(interval: Interval) -> str:
    """An interval as a cell of a table; empty if it is not known."""
    return "" if math.isnan(interval.value) else f"{interval:,.4g}"


def _by_method(results: Sequence[Result]) -> dict[str, Result]:
    own = {r.method: r for r in results}
    if len(own) < len(results):
        raise UserError(f"{results[0].problem} has several results of one method; keep each setting in a folder of its own")
    return own
