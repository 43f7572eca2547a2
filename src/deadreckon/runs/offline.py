"""Evaluates policies of runs from a log alone, and checks the decision in a simulator if there is one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Spec
from deadreckon.data.split import RANDOM, TIME, group_of
from deadreckon.data.split import clusters as clusters_of
from deadreckon.errors import UserError
from deadreckon.files import alone, digest
from deadreckon.interrupts import resumable
from deadreckon.ope.basis import UNITS
from deadreckon.ope.case import OPEInput
from deadreckon.ope.decide import Decision, automatic, check, decide
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.groups import Groups
from deadreckon.ope.latest import LEVEL as CHANGED
from deadreckon.ope.over_time import adjusted, changed
from deadreckon.ope.registry import Function, as_estimators, fits_name, titled
from deadreckon.ope.select import Choice, doubted, gains
from deadreckon.ope.settings import DecisionSettings, EstimateSettings
from deadreckon.provided import provided
from deadreckon.runs.decision_record import ESTIMATES, read_results, saved_at, write_results
from deadreckon.runs.evaluate import evaluate
from deadreckon.runs.gather import Gathered, check_encodings, for_case, fresh, gather
from deadreckon.runs.looks import Look, look
from deadreckon.runs.settings import JudgeOptions, JudgeSettings
from deadreckon.stats.interval import ALPHA, decimals, fixed, level_in_words, p_in_words
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task
from deadreckon.training.hyperparameters import described


class Judged(NamedTuple):
    """The result of `judge`.

    Attributes:
        estimates: one per estimator.
        choice: by the first of them.
        results: all results as JSON values, as in `estimates.json`.
    """

    estimates: list[Estimates]
    choice: Choice
    results: dict[str, Any]

    def _repr_html_(self) -> str | None:
        return provided("notebook")(self)

    def __str__(self) -> str:
        """The estimates and the decision, as the command prints them."""
        return "\n\n".join(map(str, (*self.estimates, self.choice)))


def judge(
    policies: Any,
    data: Dataset | str | Path,
    estimators: Sequence[Any] | str = "auto",
    *,
    task: Any = None,
    **options: Unpack[JudgeOptions],
) -> Judged:
    """Estimates policies from a log, decides which to deploy, if any, and then checks the decision in a simulator.

    Policies are evaluated on the episodes that none of them was trained on, which are identified by their contents. If there
    are none, or this is not known, estimates say so and nothing is deployed.

    Args:
        policies: the policies, or their paths, one or several; see `gather`.
        data: a log, the name of a known one, or a file: the training log with its held-out episodes, or a new log.
        estimators: names, `Estimator` objects or functions, the first of which decides; or "auto" (`ope.decide.automatic`).
        task: simulator in which the estimates are checked, as `tasks.registry.task` takes it; None: no check.
        **options: what is estimated: `discount`, `horizon`, `greedy`; what decides: `accept_model_based`, `cost_limit`,
            `stationary`, `guarantee`, `return_range`, `confounding`, `tail`, `by_group`, `model`; on which episodes: `cluster`,
            `unseen`, `counted`; and `seed`, `episodes` (per policy in the simulator), `out` and `watch`. See
            `runs.settings.JudgeSettings`.

    Raises:
        BusyError: another process writes to `out`.
        UserError: input that does not fit, in one line.
    """
    settings = JudgeSettings.of(options)
    settings.check_values()
    log = data if isinstance(data, Dataset) else catalogue.load(data)
    if settings.out is None:
        return judge_alone(policies, log, estimators, task, settings)
    out = Path(settings.out)
    if out.exists() and not out.is_dir():
        raise UserError(f"{out} is a file; --out must be a folder")
    with alone(out, what=str(out)), resumable(out / fits_name()):
        return judge_alone(policies, log, estimators, task, settings)


def judge_alone(policies: Any, data: Dataset, estimators: Sequence[Any] | str, task: Any, settings: JudgeSettings) -> Judged:
    """`judge` for callers that hold the lock of `settings.out`, or have no folder."""
    groups = None if settings.by_group is None else Groups.of(data, settings.by_group)
    candidates = gather(policies)
    files = [saved_at(each.file, settings.out) for each in candidates]  # as they are now, even if they change meanwhile
    check_encodings(candidates, data)
    task = None if task is None else find_task(task)
    if task is not None:
        _check_spaces(task, data)
    episodes = fresh(candidates, data, settings.unseen)
    held_by = (each.by for each in candidates if each.by not in (None, RANDOM, TIME))
    cluster = settings.cluster or next(held_by, None) or group_of(data)
    case = OPEInput(
        data, [for_case(each, data, settings.unseen) for each in candidates], names=_names(candidates), logged=True,
        held=episodes.held, clusters=None if cluster is None else clusters_of(data, cluster), noise=None,
        **_with_fits_apart(settings).only(EstimateSettings),
    )  # fmt: skip
    if _simulated(data):
        settings = replace(settings, stationary=True)
    check(case, settings, groups)  # before a look is counted
    case = adjusted(case, settings.stationary)  # before estimators are chosen, which may fit models
    if isinstance(estimators, str) and estimators == "auto":
        estimators = automatic(case, settings.model, settings.accept_model_based)
    estimators = as_estimators(estimators)
    for each in estimators:
        each.check(case)
    current = Look(1, ALPHA, len(candidates))
    if settings.counted:
        # What the intervals of gains depend on: with another estimator, other clusters or positions, it is another look.
        parts = [case.policies_digest, case.estimand.as_json(), _told_apart(estimators[0]), cluster]
        digested = digest(parts + (["positions"] if case.positions else []), 16)
        current = look(data, episodes.held, digested, len(candidates))
    decision = decide(
        case, estimators, seen=episodes.against, alpha=current.alpha, groups=groups, **settings.only(DecisionSettings)
    )
    results: dict[str, Any] = {
        "log": data.name, "estimand": case.estimand.as_json() | {"words": str(case.estimand)}, "seed": settings.seed,
        "truth": None,
        "policies": [
            {"name": name, "run": each.run, "seed": each.seed, **file}
            for name, each, file in zip(case.names, candidates, files)
        ],
        "propensities": "logged" if "behavior_log_probs" in data.extras else "learned",
        "judged": {"words": episodes.told, "episodes": len(episodes.held), "of": data.episodes,
                   "fresh": not any(episodes.against), "units": int(case.units.max()) + 1, "cluster": cluster,
                   "clusters": len(np.unique(case.clusters[case.held]))},
        "looks": {"number": current.number, "policies": current.policies, "alpha": current.alpha, "counted": settings.counted},
        **_decision_as_json(decision, current.alpha),
    }  # fmt: skip
    _write(settings, results)  # before the simulator, which may fail: the estimates have cost a look and most of the time
    if task is not None:
        acting = [each.acting for each in candidates]
        results["truth"] = simulated(acting, task, results["estimand"], episodes=settings.episodes, seed=settings.seed)
        _write(settings, results)
    return Judged(decision.estimates, decision.choice, results)


def _simulated(data: Dataset) -> bool:
    """Whether a log is from a simulator, which never changes: one of the catalogue, or collected by this package."""
    return data.name.partition("@")[0] in catalogue.ENTRIES or data.provenance.source == "collected"


def _write(settings: JudgeSettings, results: dict[str, Any]) -> None:
    if settings.out is not None:
        write_results(Path(settings.out) / ESTIMATES, results)


def _told_apart(estimator: Estimator) -> str:
    """Text that identifies an estimator: all its settings, or a function's name, as its address changes between processes."""
    return estimator.label if isinstance(estimator, Function) else described(estimator)


def _check_spaces(task: Task, data: Dataset) -> None:
    """Refuses a simulator whose observations or actions are not the log's.

    Raises:
        UserError: names both.
    """
    specs = Spec.empty(task.observation_shape, task.action_space, task.name), data.spec
    sizes = [(spec.observation_shape, spec.action_size, spec.discrete) for spec in specs]
    if sizes[0] != sizes[1]:
        spaces = " and ".join(f"{spec.name} has observations {spec.observation_shape}, actions {spec.action}" for spec in specs)
        raise UserError(f"the choice cannot be checked there: {spaces}")


def _names(candidates: Sequence[Gathered]) -> list[str]:
    names = [each.name for each in candidates]
    return [f"{name} ({i})" for i, name in enumerate(names)] if len(set(names)) < len(names) else names


def _with_fits_apart(settings: JudgeSettings) -> JudgeSettings:
    """The settings, with a separate folder for checkpoints of fits below that of the results."""
    return settings if settings.out is None else replace(settings, out=Path(settings.out) / fits_name())


def _decision_as_json(decision: Decision, alpha: float) -> dict[str, Any]:
    """Support, estimates with their gains, and choice."""
    choice, support = decision.choice, decision.support
    every = [gains(each, alpha, doubted(each, support)[1]) for each in decision.estimates]
    every[0][: len(choice.gains)] = choice.gains  # these take objections to intervals into account
    return {
        "support": {"missing": _known(support.missing), "ratio": _known(support.ratio),
                    "degenerate": support.degenerate.tolist()},
        "results": [
            {"method": each.method, "title": titled(each.method), "corrected": each.corrected, "value": each.value.tolist(),
             "low": each.low.tolist(), "high": each.high.tolist(), "gain": own.tolist(),
             "seconds": each.seconds, "warnings": list(each.warnings),
             "effective": None if each.ess is None else each.ess.tolist(),
             "diagnostics": {name: _known(values) for name, values in each.diagnostics.items()}}
            for each, own in zip(decision.estimates, every)
        ],
        "choice": {"name": choice.name, "deploy": choice.deploy, "gain": [choice.gain, choice.low, choice.high],
                   "level": choice.level, "reason": choice.reason, "evidence": list(choice.evidence),
                   "warnings": list(choice.warnings), "objections": [list(own) for own in choice.objections],
                   **decision.more},
    }  # fmt: skip


def _known(values: np.ndarray) -> list[float | None]:
    """Numbers as JSON values, None for NaN."""
    return [None if np.isnan(value) else float(value) for value in values]


def grounds(results: dict[str, Any]) -> list[tuple[str, str]]:
    """The grounds of a decision, as pairs of a name and a text, from the results of `judge`."""
    judged, looks, level = results["judged"], results["looks"], level_in_words(results["choice"]["level"])
    cluster, count = judged["cluster"], judged.get("clusters")
    of = "" if cluster is None else f", in {count:,} clusters by {cluster}" if count else f", in clusters by {cluster}"
    if cluster is None and count is not None and count < judged["episodes"]:
        of = f", of which {count:,} are different: copies are counted as one"
    policies = f"{looks['policies']:,} {'policy' if looks['policies'] == 1 else 'policies'}"
    looked = f"look {looks['number']} at these episodes or some of them, {policies} so far"
    if not looks["counted"]:
        looked = "looks at these episodes were not counted"
    known = {"logged": "logged", "learned": "estimated by a model of the behaviour policy; the log has none"}
    lines = [
        ("log", results["log"]),
        ("estimated", results["estimand"]["words"]),
        ("evaluated on", judged["words"] + of),
        ("level", f"{level} for all policies at once: {looked}"),
    ]
    if "propensities" in results:
        lines.append(("propensities", known[results["propensities"]]))
    if (over := results["choice"].get("over_time")) is not None:
        lines.append(("over time", _over_time(over)))
    return lines


def _over_time(over: Mapping[str, Any]) -> str:
    """Whether estimates are adjusted for time, in words."""
    if over["stationary"]:
        return "the system is taken for stationary"
    if over["p_value"] is None:
        told = f"there are too few episodes or clusters to test whether the behaviour policy changed: {UNITS} are needed"
    elif over["adjusted"]:
        p = p_in_words(over["p_value"])
        what = changed(over.get("within_clusters", False))
        told = f"the behaviour policy {what} ({p}), and actions of about the same position are compared"
    else:
        told = f"no change of the behaviour policy along the log is found ({p_in_words(over['p_value'])})"
    if (latest := over.get("latest")) is None:
        return told
    if latest["why"]:
        return f"{told}; the gain in the latest third of the episodes is not compared with that before: {latest['why']}"
    p = p_in_words(latest["p_value"])
    if latest["p_value"] < CHANGED:
        return f"{told}; the gain in the latest third of the episodes differs from that before ({p})"
    return f"{told}; no change of the gain in the latest third of the episodes is found ({p})"


def simulated(policies: Sequence[Any], task: Task, estimand: Mapping[str, Any], *, episodes: int, seed: int) -> dict[str, Any]:
    """The values of policies in a simulator by an estimand, both as in `estimates.json`; at least two episodes."""
    asked = {name: estimand[name] for name in ("discount", "horizon", "greedy")}
    played = evaluate(policies, task, episodes=episodes, seed=seed, **asked)
    returns = played.discounted
    errors = returns.std(1, ddof=1) / np.sqrt(episodes)
    found = {"task": task.name, "episodes": episodes, "mean": returns.mean(1).tolist(), "error": errors.tolist()}
    # All policies have the same starts, so that common effects of starts cancel in differences.
    differences = returns[:, None] - returns
    found["apart"] = (differences.std(-1, ddof=1) / np.sqrt(episodes)).tolist()
    # An estimate without a horizon includes rewards after a time limit, which the simulator does not show.
    endless = asked["horizon"] is None and asked["discount"] < 1.0
    beyond = float((asked["discount"] ** task.horizon * (played.lengths >= task.horizon)).mean(1).max()) if endless else 0.0
    return found | ({"beyond": beyond} if beyond > TAIL else {})


def checked(results: dict[str, Any]) -> str:
    """The result of the check in the simulator, in one line: the regret is the best policy's value minus the chosen one's."""
    truth = results["truth"]
    if truth is None:
        return "not checked in a simulator (--task names one)"
    means = np.asarray(truth["mean"])
    names = [each["name"] for each in results["policies"]]
    chosen = names.index(results["choice"]["name"])
    lost, spread = float(means.max() - means[chosen]), float(np.ptp(means))
    share = f", {100 * lost / spread:.0f} % of the range of all" if spread > 0 else ""
    limit = ""
    if "beyond" in truth:
        limit = f"; its time limit leaves {100 * truth['beyond']:.0f} % of the discounted time out, which the estimates include"
    rank = int((means > means[chosen]).sum()) + 1
    d = decimals(*means)
    said = lambda error: f" (standard error {fixed(error, d)})"  # noqa: E731 - in words: a bare ± could be an interval
    words = f"in the simulator {names[chosen]} has {fixed(means[chosen], d)}{said(truth['error'][chosen])} and is "
    error = lambda other: said(truth["apart"][chosen][other]) if "apart" in truth else ""  # noqa: E731
    if rank == 1:
        others = [i for i in np.argsort(-means, kind="stable").tolist() if i != chosen]
        behind = [f"; the next, {names[i]}, is lower by {fixed(means[chosen] - means[i], d)}{error(i)}" for i in others[:1]]
        return f"{words}the best of {len(names)}{''.join(behind)}{limit}"
    best = int(means.argmax())
    return (
        f"{words}in place {rank} of {len(names)}; the best, {names[best]}, has {fixed(means[best], d)}: a regret of "
        f"{fixed(lost, d)}{error(best)}{share}{limit}"
    )


def supports(results: dict[str, Any]) -> str:
    """The share of each policy's actions without support in the log, one line each."""
    names = [each["name"] for each in results["policies"]]
    width = max(map(len, names))
    shares = ["not known" if share is None else f"{100 * share:.0f} %" for share in results["support"]["missing"]]
    words = "mean weight per step {} (1 where there is support)"
    weights = ["" if mean is None else f", {words.format(fixed(mean, 2))}" for mean in results["support"]["ratio"]]
    lines = [f"  {name:<{width}}  {share}{weight}" for name, share, weight in zip(names, shares, weights)]
    return "\n".join(["share of each policy's actions without support in the log", *lines])


def groups(results: dict[str, Any]) -> str:
    """The gain of the chosen policy in each group, one line each, if it was requested."""
    choice, by = results["choice"], results["choice"]["groups"]
    if "refused" in by:
        return f"gains by subgroup of {by['column']} are not known: {by['refused']}"
    width = max(len(each["name"]) for each in by["values"])
    level = f"{level_in_words(choice['level'])}, for all subgroups at once"
    lines = [f"gain of {choice['name']} by {by['column']} ({level})"]
    known = [each[end] for each in by["values"] for end in ("gain", "low", "high") if each[end] is not None]
    d = decimals(*known)
    for each in by["values"]:
        unknown = f"without an interval: {each.get('why') or 'too few episodes'}"
        ends = unknown if each["low"] is None else f"[{each['low']:+.{d}f}, {each['high']:+.{d}f}]"
        gain = "" if each["gain"] is None else f"{each['gain']:+.{d}f} {ends}"
        lines.append(f"  {each['name']:<{width}}  {each['episodes']:>8,} episodes  {gain}")
    return "\n".join(lines)


def read_estimates(path: Path | str) -> dict[str, Any]:
    """Reads the results that `judge` wrote into a folder, or the file itself.

    Raises:
        UserError: there are none, or the file is damaged.
    """
    path = Path(path)
    path = path / ESTIMATES if path.is_dir() else path
    if not path.exists():
        raise UserError(f"no estimates in {path}; `deadreckon ope --out FOLDER` writes them")
    results = read_results(path)
    if not results["results"]:
        raise UserError(f"{path} holds no estimates: {results['choice']['reason']}")
    return results
