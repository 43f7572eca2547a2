"""The DOPE protocol (thesis 8.3-8.5): estimates for logs and policies whose true values are known, and their errors.

The policies are the snapshots in the package, with sampled actions; their true discounted returns are stored beside them
(`policies/library.py`). The logs are the package's own (`hopper-medium-v2@dr1`).
"""

import dataclasses
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import VERSION
from deadreckon.errors import DivergedError, UserError
from deadreckon.files import digest, read_json, write_json
from deadreckon.names import file_part
from deadreckon.ope.behavior import REVISION as PROPENSITIES
from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.metrics import Metrics, compare, error_rates, published, sharpe_ratio
from deadreckon.ope.registry import Function, as_estimators, fits_name
from deadreckon.ope.settings import FitOptions, FitSettings
from deadreckon.policies import library
from deadreckon.progress import unwatched
from deadreckon.stats import interval
from deadreckon.training.revisions import of_learning, revisions

REVISION = 1  # of the protocol: policies, true values, metrics; raised where numbers change (see bench/identity.py)
METRICS = {
    "absolute_error": "Absolute error, in ranges of the true values",
    "rank_correlation": "Rank correlation",
    "regret": "Regret@1, in ranges of the true values",
}
TRIED = 5  # k of SharpeRatio@k, and of regret@k in Table E.3
UNPLUGGED = "-full-replay-v0"  # ends the name of a task's log in the half of DOPE that uses RL Unplugged
PRINTED = {"WPDIS": "IS", "WDR": "DR"}  # names in thesis E.2 of methods that have a more exact name here


@dataclass(frozen=True)
class Result:
    """One estimator on one log.

    Attributes:
        log: its name.
        method: the estimator's label.
        names: of the policies.
        behavior: mean discounted return of the log.
        truth, errors: (policies,) true discounted returns and their standard errors.
        estimates: (policies,).
        low, high: (policies,) intervals.
        seconds: the time it took.
        warnings: of the estimator.
        settings: of the estimator, as text.
    """

    log: str
    method: str
    names: tuple[str, ...]
    behavior: float
    truth: np.ndarray
    errors: np.ndarray
    estimates: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seconds: float
    warnings: tuple[str, ...]
    settings: str

    def metrics(self, **options: Any) -> Metrics:
        """Absolute error, rank correlation and regret; see `metrics.compare`. Resampled once for all tables."""
        key = tuple(sorted(options.items()))
        if key not in self._compared:
            self._compared[key] = compare(self.estimates, self.truth, **options)
        return self._compared[key]

    @cached_property
    def _compared(self) -> dict[Any, Metrics]:
        return {}

    def risks(self) -> tuple[float, float, float]:
        """SharpeRatio@k against the behaviour policy, with k of `TRIED`; type I and II errors of deploying what seems no worse
        than it."""
        sharpe = sharpe_ratio(self.estimates, self.truth, self.behavior, TRIED)
        return sharpe, *error_rates(self.estimates, self.truth, self.behavior)


@dataclass(frozen=True, kw_only=True)
class DopeSettings(FitSettings):
    """Settings of the protocol's fits and results."""

    out: Path | str | None = None  # folder of results and checkpoints; existing results are not computed again
    told: Callable[[Result], None] = unwatched  # called with every result


class DopeOptions(FitOptions, total=False):
    """Keywords of `DopeSettings`."""

    told: Callable[[Result], None]


def estimator_revisions(estimator: Estimator) -> dict[str, Any]:
    """Revisions of an estimator's code, without those of the training of its fits; see `training/revisions.py`."""
    found = {"method": revisions(estimator), "intervals": interval.REVISION, "protocol": REVISION}
    return found | ({"propensities": PROPENSITIES} if getattr(estimator, "folds", 1) > 1 else {})


def evaluate_log(
    data: Dataset, task: str, estimators: Sequence[Any], **options: Unpack[DopeOptions]
) -> list[Result]:
    """Estimates the snapshots of a task from a log, by each of the estimators.

    Args:
        data: the log.
        task: whose policies.
        estimators: names, `Estimator` objects, or functions `fn(data, policies, discount) -> values`; or a single one.
        **options: `seed`, `out`, `watch` and `told`; see `DopeSettings`. Results in `out` are identified by log, estimator,
            seed and the revisions of their code: those of other revisions are computed again.

    Raises:
        UserError: an unknown estimator or task, or a file of results that is damaged.
    """
    settings, asked = DopeSettings.of(options), as_estimators(estimators)
    snapshots = library.evaluated(task)
    discount = snapshots[0].sampled.discount
    truth, errors = (np.array([getattr(s.sampled, f) for s in snapshots]) for f in ("discounted", "discounted_error"))
    names = tuple(s.name for s in snapshots)
    case: OPEInput | None = None
    behavior = math.nan  # known with the case
    results = []
    folder = None if settings.out is None else Path(settings.out) / file_part(data.name)
    for estimator in asked:
        identity = {
            "settings": str(estimator), "seed": settings.seed, "log": data.fingerprint, "truth": truth.tolist(),
            "revisions": of_learning() | estimator_revisions(estimator),
        }  # fmt: skip
        # The name of a function does not identify its code, so its results are not stored.
        name = f"{type(estimator).__name__}-{digest(identity, 4)}.json"
        path = None if folder is None or isinstance(estimator, Function) else folder / name
        if path is not None and path.exists():
            result = _kept(path)
        else:
            if case is None:
                fits = replace(settings, out=None if folder is None else folder / fits_name())
                policies, behavior = [s.policy() for s in snapshots], float(np.mean(data.returns(discount)))
                case = OPEInput(data, policies, discount=discount, names=names, **fits.only(FitSettings))
            try:
                estimates = estimator.on(case)
            except DivergedError as error:  # other methods and other logs continue
                estimates = _no_estimates(estimator, names, discount, str(error))
            result = Result(
                data.name, estimates.method, estimates.names, behavior, truth, errors, estimates.value, estimates.low,
                estimates.high, estimates.seconds, estimates.warnings, str(estimator),
            )  # fmt: skip
            if path is not None:
                write_json(path, {"asked": identity, "result": to_json(result)})
        results.append(result)
        settings.told(result)
    return results


def _kept(path: Path) -> Result:
    try:
        return from_json(read_json(path, dict)["result"])
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} is not a complete result ({error}); delete it to compute it again") from error


def _no_estimates(estimator: Estimator, names: tuple[str, ...], discount: float, why: str) -> Estimates:
    """Estimates that are NaN, for a method that gave none."""
    nan = np.full(len(names), np.nan)
    return Estimates(estimator.label, names, nan, nan, nan, Estimand(discount), warnings=(f"no estimates: {why}",))


def to_json(result: Result) -> dict[str, Any]:
    """A result as JSON values."""
    fields = {f.name: getattr(result, f.name) for f in dataclasses.fields(result)}
    return json.loads(json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in fields.items()}))


def from_json(fields: Mapping[str, Any]) -> Result:
    """The result that `to_json` wrote."""
    arrays: dict[str, Any] = {n: np.asarray(fields[n], float) for n in ("truth", "errors", "estimates", "low", "high")}
    tuples: dict[str, Any] = {name: tuple(fields[name]) for name in ("names", "warnings")}
    return Result(**{**fields, **arrays, **tuples})


class Shown(NamedTuple):
    """A metric that tables show.

    Attributes:
        metric: among `METRICS`.
        k: of the regret.
        title: of the table.
    """

    metric: str
    k: int
    title: str


def shown_metrics(results: Sequence[Result]) -> list[Shown]:
    """The thesis's metrics: error, rank correlation and regret@1, on tasks of dm_control also regret@5 (Table E.3)."""
    metrics = [Shown(metric, 1, title) for metric, title in METRICS.items()]
    if any(of_unplugged(r.log) for r in results):
        metrics.append(Shown("regret", TRIED, METRICS["regret"].replace("@1", f"@{TRIED}")))
    return metrics


def of_unplugged(log: str) -> str | None:
    """The task of a log that belongs to DOPE's half on RL Unplugged."""
    name = log.removesuffix(f"@{VERSION}")
    return name.removesuffix(UNPLUGGED) if name.endswith(UNPLUGGED) else None


class Cell(NamedTuple):
    """A metric of one method on one log.

    Attributes:
        value: on the policies without resampling; like the next two a mean over seeds, and NaN if no estimate is finite.
        mean, spread: over resampled policies, as printed in thesis E.2.
        printed: mean and spread in thesis E.2 for the original log and policies, where it prints one on this scale.
    """

    value: float
    mean: float
    spread: float
    printed: tuple[float, float] | None


def cells(results: Sequence[Result], metric: str, **options: Any) -> dict[str, dict[str, Cell]]:
    """Log -> method -> one metric.

    Args:
        results: of one or several logs; of several seeds, means are taken.
        metric: among `METRICS`.
        options: of `metrics.compare`.

    Raises:
        UserError: a method with two settings, whose mean would have no meaning.
    """
    table: dict[str, dict[str, Cell]] = {}
    for log in dict.fromkeys(r.log for r in results):
        for method in dict.fromkeys(r.method for r in results):
            own = [r for r in results if (r.log, r.method) == (log, method)]
            if len({r.settings for r in own}) > 1:
                raise UserError(f"{method} on {log} has results of several settings; keep each in a folder of its own")
            good = [r.metrics(**options) for r in own if np.isfinite(r.estimates).all()]
            measured = np.mean([getattr(m, metric) for m in good], 0) if good else np.full(3, np.nan)
            if own:
                # Thesis E.2 prints errors as returns, and regrets in ranges of the true values.
                same = options.get("normalised", True) == (metric != "absolute_error")
                theirs = printed(metric, log, method, options.get("k", 1)) if same else None
                table.setdefault(log, {})[method] = Cell(*(float(x) for x in measured), printed=theirs)
    return table


def printed(metric: str, log: str, method: str, k: int = 1) -> tuple[float, float] | None:
    """Mean and spread of a metric in thesis E.2, where it prints one for that log and method (its label); `k` of the regret."""
    task = of_unplugged(log)
    table = published().get(f"regret_at_{k}", {}) if metric == "regret" else published()[metric]
    name = task or re.sub(r"-v\d+$", "", log.removesuffix(f"@{VERSION}"))
    values = table.get("rl_unplugged" if task else "d4rl", {}).get(name, {}).get(PRINTED.get(method, method))
    return None if values is None else (float(values[0]), float(values[1]))


def markdown(results: Sequence[Result], metric: str, **options: Any) -> str:
    """A table of one metric: a row per log, a column per estimator; medians last.

    Cells are the metric itself ± its deviation over resampled policies. If thesis E.2 has the log, two rows follow that can be
    compared with each other: the mean over resampled policies ± the same deviation, and the numbers of E.2, which are of this
    kind.

    Arguments and errors are those of `cells`.
    """
    table = cells(results, metric, **options)
    methods = list(dict.fromkeys(r.method for r in results))
    lines = ["| log | " + " | ".join(methods) + " |", "|---|" + "---:|" * len(methods)]
    pair = lambda mean, spread: f"{mean:{form}} ± {spread:{form}}" if math.isfinite(mean) else ""  # noqa: E731
    for log, row in table.items():
        form = ".2f" if max((abs(c.value) for c in row.values() if math.isfinite(c.value)), default=0.0) < 100 else ",.0f"
        shown = [pair(row[m].value, row[m].spread) if m in row else "" for m in methods]
        lines.append(f"| {log} | " + " | ".join(shown) + " |")
        theirs = [row[m].printed if m in row else None for m in methods]
        if any(theirs):
            redrawn = [pair(row[m].mean, row[m].spread) if p else "" for m, p in zip(methods, theirs)]
            lines.append("| over redrawn policies | " + " | ".join(redrawn) + " |")
            lines.append("| thesis E.2 | " + " | ".join(pair(*p) if p else "" for p in theirs) + " |")
    # A method that has no value on some log has no median: one over the other logs would be too favourable.
    values = {m: [row[m].value if m in row else math.nan for row in table.values()] for m in methods}
    form = ".2f" if max((abs(m) for v in values.values() for m in v if math.isfinite(m)), default=0.0) < 100 else ",.0f"
    medians = [f"{np.median(v):{form}}" if np.isfinite(v).all() else "" for v in values.values()]
    return "\n".join([*lines, "| median | " + " | ".join(medians) + " |"])


def risks(results: Sequence[Result]) -> str:
    """A table of the risks of choosing by each estimator, as means over logs (those for which a rate is defined).

    Methods without finite estimates on some log are left out; see `Result.risks`.
    """
    lines = [f"| | SharpeRatio@{TRIED} | type I error | type II error |", "|---|---:|---:|---:|"]
    for method in dict.fromkeys(r.method for r in results):
        own = [r for r in results if r.method == method]
        if all(np.isfinite(r.estimates).all() for r in own):
            columns = np.array([r.risks() for r in own]).T
            shown = [f"{np.nanmean(c):.2f}" if np.isfinite(c).any() else "" for c in columns]
            lines.append(f"| {method} | " + " | ".join(shown) + " |")
    return "\n".join(lines)
