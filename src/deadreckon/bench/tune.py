"""Settings for an agent without cheating: chosen on training tasks in their simulators, or from the log alone by estimates.

The thesis splits its tasks (Table D.3): settings may be tuned in the simulators of training tasks only. Where there is no
simulator, as with a log of one's own, or none may be used, off-policy estimates choose (thesis 8.2); how much that loses is
known wherever there is a simulator after all, and told. Of a log of one's own, settings learn from one part and are
estimated on another; the part that `train` holds out by default is in neither, so that it can judge what is chosen.
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack, get_args

import numpy as np

from deadreckon.agents import agent_class, canonical_name, space
from deadreckon.bench.executor import Executor, OnEvent, run
from deadreckon.bench.jobs import Job
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Method, Suite
from deadreckon.bench.tuned import By, Trial, Tuned, named, standing_of
from deadreckon.data import catalogue
from deadreckon.errors import BusyError, UserError, unknown
from deadreckon.files import write_json
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.coverage import MODEL
from deadreckon.ope.metrics import compare
from deadreckon.randomness import check_seed
from deadreckon.runs.holdout import trial_parts
from deadreckon.runs.offline import judge
from deadreckon.runs.settings import JudgeOptions, JudgeSettings, RunSettings
from deadreckon.tasks.registry import of_log
from deadreckon.training.field_names import with_field_names
from deadreckon.training.hyperparameters import check_fields


@dataclass(frozen=True, kw_only=True)
class TrialSettings(JudgeSettings):
    """Of the estimates that settings are chosen by."""

    discount: float = 0.99  # discount factor per step of the estimated returns
    greedy: bool = True  # whether to evaluate deterministic (greedy) instead of sampled actions
    model: BehaviorModel = MODEL  # how the behaviour policy is learned, to see what of the policies' actions the log covers
    counted: bool = False  # whether this counts as a look at these episodes; they choose settings, and no card rests on them


def candidates(
    agent: str, given: Mapping[str, Sequence[Any]] | None = None, most: int | None = None, seed: int = 0
) -> list[dict[str, Any]]:
    """Settings to try: all combinations, or some of them, the agent's defaults first where they are one of the combinations.

    Args:
        agent: its name.
        given: field -> values; None: those that its paper varied, as far as the package knows them.
        most: so many, drawn without replacement, but never without the defaults; None: all.
        seed: of the draw.

    Raises:
        UserError: an unknown agent or field, an agent without a known space, a space without values, or a seed that is
            out of range.
    """
    check_seed(seed)
    kind = agent_class(agent)
    values = with_field_names(kind, space(agent) if given is None else given)
    defaults = vars(kind())
    for name, choices in values.items():
        if name not in defaults:
            raise unknown(f"field of {agent}", name, defaults)
        if not choices:
            raise UserError(f"{name} has no values to try")
        for choice in choices:
            check_fields(kind(**{name: choice}))
    distinct = [list(dict.fromkeys(choices)) for choices in values.values()]
    grid = [dict(zip(values, each)) for each in itertools.product(*distinct)]
    kept = [each for each in grid if all(each[name] == defaults[name] for name in each)]
    others = [each for each in grid if each not in kept]
    grid = kept + others
    if most is None or most >= len(grid):
        return grid
    if most < 1:
        raise UserError(f"at least one setting must be tried, got {most}")
    picked = np.sort(np.random.default_rng(seed).choice(len(others), most - len(kept), replace=False))
    return kept + [others[i] for i in picked]


def suite(
    agent: str, logs: Sequence[str], settings: Sequence[Mapping[str, Any]], *, by: By, steps: int, seeds: int = 3,
    rows: int | None = None, fixed: Mapping[str, Any] | None = None,
) -> Suite:  # fmt: skip
    """The search as a suite, so that it is run, kept and resumed as any other.

    Args:
        agent: its name.
        logs: names or files.
        settings: see `candidates`.
        by: what chooses.
        steps: updates of each setting, log and seed.
        seeds: of each.
        rows: of logs that are collected; None: all.
        fixed: fields that are the same in all.

    Raises:
        UserError: a task that the thesis keeps for evaluation, or none, to be tuned in by its simulator; several logs to be
            tuned from by estimates, whose values do not compare; a field that is both tried and fixed; or no steps or seeds.
    """
    RunSettings().check(0, steps=steps, seeds=seeds)
    if both := {name for each in settings for name in each} & set(fixed or {}):
        raise UserError(f"{', '.join(sorted(both))} cannot be tried and be the same in all")
    if by not in get_args(By):
        raise unknown("way to choose", by, get_args(By))
    if by == "ope" and len(logs) > 1:
        raise UserError(f"estimates choose for one log; tune for each of {', '.join(logs)} by itself")
    for log in logs if by == "simulator" else ():
        task = of_log(log)
        if task is None:
            raise UserError(f"{log} has no simulator to tune in; --by ope chooses from the log alone")
        if task.split == "evaluation":
            told = f"{task.name} is kept for evaluation (thesis Table D.3), so its simulator must not choose settings"
            raise UserError(f"{told}; tune on a training task, or --by ope")
    agent = canonical_name(agent)
    methods = tuple(Method(named(each), agent, {**(fixed or {}), **each}) for each in settings)
    return Suite(
        f"tune-{agent}", "learn", tuple(logs), methods, seeds=seeds, steps=dict.fromkeys(logs, steps),
        evaluations=1, rows=rows, about=f"settings of {agent}", divided=by == "ope",
    )  # fmt: skip


def tune(
    search: Suite, settings: Sequence[Mapping[str, Any]], *, by: By, store: Store, executor: Executor, on_event: OnEvent,
    estimators: Sequence[Any] = ("fqe",), **options: Unpack[JudgeOptions],
) -> Tuned:  # fmt: skip
    """Runs what is not done yet, and chooses.

    Args:
        search: from `suite`.
        settings: that it was made of.
        by: what chooses.
        store: where results lie, and `tuned.json` will.
        executor: where jobs run; closed at the end.
        on_event: called with every event of a job.
        estimators: the first chooses, by the mean over seeds.
        **options: of `runs.offline.judge`, such as `discount` and `model`; defaults are those of `TrialSettings`.

    Raises:
        BusyError: another command does some of it.
        UserError: a setting that failed, in the first one's words.
    """
    judging = judging_of(options)
    trials = tried(search, settings, by, store, executor, on_event, estimators, replace(judging, out=store.path / "estimates"))
    return chosen(search, by, trials, store)


def judging_of(options: Mapping[str, Any]) -> TrialSettings:
    """How settings are estimated.

    Raises:
        UserError: a discount out of range.
    """
    judging = TrialSettings.of(options)
    if not 0.0 <= judging.discount < 1.0:
        raise UserError(f"discount must be in [0, 1), got {judging.discount}")
    return judging


def tried(
    search: Suite, settings: Sequence[Mapping[str, Any]], by: By, store: Store, executor: Executor, on_event: OnEvent,
    estimators: Sequence[Any], judging: TrialSettings,
) -> list[Trial]:  # fmt: skip
    """Runs what is not done yet, and gives what is known of each setting; estimates go to the folder that `judging` names."""
    jobs = plan(search, executor.lanes)
    run(jobs, store, on_event, executor)
    failures = [(job, failure) for job in store.undone(jobs) if (failure := store.failure(job, job.seeds[0]))]
    if failures:
        job, failure = failures[0]
        raise UserError(f"{len(failures)} of {len(jobs)} jobs failed, the first ({job.method}): {failure['error']}")
    if elsewhere := store.undone(jobs):
        raise BusyError(f"{len(elsewhere)} of {len(jobs)} jobs are being done by another command; choose when it has ended")
    rows = {row["cell"]: row for row in store.of(jobs).to_pylist()}
    values = _estimated(jobs, store, rows, estimators, judging) if by == "ope" else {}
    trials = []
    for method, fields in zip(search.methods, settings):
        own = [[rows[c] for job in jobs if (job.method, job.on) == (method.name, on) for c in job.cells] for on in search.on]
        failure = next((row["failure"] for log in own for row in log if row["failure"]), "")
        scores = np.array([[row["score"] for row in log] for log in own], float)
        told = np.array(values.get(method.name, [])).reshape(-1, 4)
        trials.append(Trial(dict(fields), scores, told[:, 0], failure, told[:, 1:]))
    return trials


def chosen(search: Suite, by: By, trials: Sequence[Trial], store: Store) -> Tuned:
    """The choice among settings that were tried, which is written to `tuned.json`.

    Raises:
        UserError: none can be chosen.
    """
    means = np.array([trial.scores.mean() for trial in trials])
    standing = np.array([standing_of(trial, by) for trial in trials])
    if not np.isfinite(standing).any():
        raise UserError(f"no setting can be chosen: {trials[0].failure or 'nothing finite was estimated'}")
    best = int(np.nanargmax(standing))
    known = bool(np.isfinite(means).all()) and by == "ope"
    ranked = known and np.isfinite(standing).all() and min(np.ptp(means), np.ptp(standing)) > 0
    truth = compare(standing, means) if ranked else None
    lost = float(means.max() - means[best]) if known else None
    found = Tuned(search.methods[0].agent, by, tuple(trials), trials[best], truth, lost)
    write_json(store.path / "tuned.json", _json(found, search))
    return found


def _estimated(
    jobs: Sequence[Job], store: Store, rows: Mapping[str, Mapping[str, Any]], estimators: Sequence[Any],
    judging: TrialSettings,
) -> dict[str, list[list[float]]]:  # fmt: skip
    """Method -> for each seed what its policy is estimated at, and its gain with both ends."""
    from deadreckon.bench.work import source

    folders = {store.run_of(rows[cell]): job.method for job in jobs for cell in job.cells}
    log = catalogue.load(source(jobs[0]))
    if jobs[0].options.get("divided"):
        log = trial_parts(log)[1]
    judged = judge(list(folders), log, estimators, **vars(judging))
    values: dict[str, list[list[float]]] = {}
    owners = {folder.name: method for folder, method in folders.items()}
    first = judged.results["results"][0]
    for policy, value, gain in zip(judged.results["policies"], first["value"], first["gain"]):
        values.setdefault(owners[policy["run"]], []).append([value, *gain])
    return values


def _json(found: Tuned, search: Suite) -> dict[str, Any]:
    trials = [{"fields": t.fields, "scores": _finite(t.scores), "values": _each_finite(t.values),
               "gains": [_each_finite(own) for own in t.gains]} for t in found.trials]
    said = {"agent": found.agent, "by": found.by, "logs": search.on, "steps": search.steps, "seeds": search.seeds}
    return json.loads(json.dumps({**said, "best": found.best.fields, "lost": found.lost, "trials": trials}))


def _each_finite(values: np.ndarray) -> list[float | None]:
    """JSON has no NaN."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _finite(scores: np.ndarray) -> list[Any] | None:
    return scores.tolist() if np.isfinite(scores).all() else None
