"""The DOPE protocol (thesis 8.3-8.5): logs and policies whose true values are known, and how near estimators come to them.

The policies are the eleven snapshots that come with the package, drawing their actions; their true discounted returns are
stored beside them (`policies/library.py`). The logs are the package's own (`hopper-medium-v2@dr1`).
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.ope.estimate import Case, Estimates, Watcher
from deadreckon.ope.metrics import Metrics, compare
from deadreckon.ope.registry import Function, as_estimator
from deadreckon.policies import library


@dataclass(frozen=True)
class Result:
    """One estimator on one log.

    Attributes:
        log: its name.
        method: the estimator's label.
        names: of the policies.
        truth, errors: (policies,) true discounted returns and their standard errors.
        estimates: (policies,).
        low, high: (policies,) intervals.
        seconds: it took.
        warnings: of the estimator.
        settings: of the estimator, as text.
    """

    log: str
    method: str
    names: tuple[str, ...]
    truth: np.ndarray
    errors: np.ndarray
    estimates: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seconds: float
    warnings: tuple[str, ...]
    settings: str

    def metrics(self, **options: Any) -> Metrics:
        """Absolute error, rank correlation and regret; see `metrics.compare`."""
        return compare(self.estimates, self.truth, **options)


def evaluate_log(
    data: Dataset,
    task: str,
    estimators: Sequence[Any],
    *,
    seed: int = 0,
    out: Path | str | None = None,
    watch: Watcher = lambda what, step, steps: None,
    told: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """Estimates the snapshots of a task from a log, by each of the estimators.

    Args:
        data: the log.
        task: whose policies.
        estimators: names, `Estimator` objects, or functions `fn(data, policies, discount) -> values`.
        seed: of everything random.
        out: folder for results and checkpoints; results that are there are not computed again.
        watch: called while something is fitted.
        told: called with every result.
    """
    snapshots = [s for s in library.library(task) if s.name.startswith("snapshot-")]
    discount = snapshots[0].sampled.discount
    truth, errors = (np.array([getattr(s.sampled, f) for s in snapshots]) for f in ("discounted", "discounted_error"))
    names = tuple(s.name for s in snapshots)
    case: Case | None = None
    results = []
    for given in estimators:
        found = as_estimator(given)
        asked = {"settings": str(found), "seed": seed, "log": data.fingerprint, "truth": truth.tolist()}
        digest = hashlib.blake2b(json.dumps(asked).encode(), digest_size=4).hexdigest()
        # What a function does is not in its name, so its results are not kept.
        folder = None if out is None or isinstance(found, Function) else Path(out) / data.name
        path = None if folder is None else folder / f"{type(found).__name__}-{digest}.json"
        if path is not None and path.exists():
            result = _from_json(read_json(path)["result"])
        else:
            if case is None:
                fits = None if out is None else Path(out) / data.name / f"fits-seed{seed}"
                policies = [s.policy() for s in snapshots]
                case = Case(data, policies, discount=discount, seed=seed, names=names, out=fits, watch=watch)
            result = _result(found.on(case), data.name, truth, errors, str(found))
            if path is not None:
                write_json(path, {"asked": asked, "result": _to_json(result)})
        results.append(result)
        told(result)
    return results


def _result(found: Estimates, log: str, truth: np.ndarray, errors: np.ndarray, settings: str) -> Result:
    estimates = found.value, found.low, found.high
    return Result(log, found.method, found.names, truth, errors, *estimates, found.seconds, found.warnings, settings)


def _to_json(result: Result) -> dict[str, Any]:
    fields = {f.name: getattr(result, f.name) for f in dataclasses.fields(result)}
    return json.loads(json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in fields.items()}))


def _from_json(fields: Mapping[str, Any]) -> Result:
    arrays: dict[str, Any] = {n: np.asarray(fields[n], float) for n in ("truth", "errors", "estimates", "low", "high")}
    tuples: dict[str, Any] = {name: tuple(fields[name]) for name in ("names", "warnings")}
    return Result(**{**fields, **arrays, **tuples})


def read_results(out: Path | str) -> list[Result]:
    """All results in a folder that `evaluate_log` filled, in order of logs and names.

    Raises:
        UserError: there are none.
    """
    found = [_from_json(read_json(path)["result"]) for path in sorted(Path(out).glob("*/*.json"))]
    if not found:
        raise UserError(f"no results in {out}")
    return found


def markdown(results: Sequence[Result], metric: str, **options: Any) -> str:
    """A table of one metric, a row a log and a column an estimator, with medians; mean over redrawn policies and deviation.

    Args:
        results: of one or several logs; of several seeds, means are shown.
        metric: `absolute_error`, `rank_correlation` or `regret`.
        options: of `metrics.compare`.
    """
    methods = list(dict.fromkeys(r.method for r in results))
    logs = list(dict.fromkeys(r.log for r in results))
    rows: dict[str, list[str]] = {}
    means: dict[str, list[float]] = {method: [] for method in methods}
    for log in logs:
        cells = []
        for method in methods:
            own = [r for r in results if r.log == log and r.method == method and np.isfinite(r.estimates).all()]
            if not own:
                cells.append("")
                continue
            pairs = np.array([getattr(r.metrics(**options), metric) for r in own]).mean(0)
            means[method].append(float(pairs[0]))
            cells.append(f"{pairs[0]:.2f} ± {pairs[1]:.2f}")
        rows[log] = cells
    medians = [f"{np.median(means[method]):.2f}" if means[method] else "" for method in methods]
    lines = ["| log | " + " | ".join(methods) + " |", "|---|" + "---:|" * len(methods)]
    lines += [f"| {log} | " + " | ".join(cells) + " |" for log, cells in rows.items()]
    return "\n".join([*lines, "| median | " + " | ".join(medians) + " |"])
