"""Policies of runs judged from a log alone, and, where there is a simulator, the judgement checked in it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Spec
from deadreckon.data.split import RANDOM, TIME
from deadreckon.data.split import clusters as clusters_of
from deadreckon.data.split import groups as groups_of
from deadreckon.errors import UserError
from deadreckon.files import digest, read_json, write_json
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.decide import check, decide
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.groups import Groups
from deadreckon.ope.registry import PROPENSITIES, as_estimator, titled
from deadreckon.ope.select import Choice, gains, supported
from deadreckon.progress import Watcher, unwatched
from deadreckon.runs.evaluate import evaluate
from deadreckon.runs.gather import for_case, fresh, gather
from deadreckon.runs.looks import Look, look
from deadreckon.stats.interval import ALPHA
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task

NAME = "estimates.json"


class Judged(NamedTuple):
    """What `judge` finds.

    Attributes:
        estimates: one per estimator.
        choice: by the first of them.
        told: all of it as JSON values, as in `estimates.json`.
    """

    estimates: list[Estimates]
    choice: Choice
    told: dict[str, Any]


def judge(
    given: Sequence[Any],
    data: Dataset,
    estimators: Sequence[Any] | str = "auto",
    *,
    out: Path | str | None = None,
    discount: float = 0.995,
    horizon: int | Literal["auto"] | None = "auto",
    greedy: bool = False,
    task: Task | str | None = None,
    episodes: int = 100,
    seed: int = 0,
    model: BehaviorModel = PROPENSITIES,
    cluster: str | None = None,
    unseen: bool = False,
    accept_model_based: bool = False,
    counted: bool = True,
    guarantee: bool = False,
    return_range: tuple[float, float] | None = None,
    confounding: float | None = None,
    by_group: str | None = None,
    tail: float | None = None,
    watch: Watcher = unwatched,
) -> Judged:
    """Estimates policies from a log, decides which to deploy, if any, and then looks into the simulator whether that was right.

    Policies are judged on the episodes that none of them has learned from, which is looked up by the contents of episodes.
    Where there are none, or nobody knows, estimates say so and nothing is deployed.

    Args:
        given: where the policies are; see `gather`.
        data: the log: the one that they learned from, with the episodes that were held out, or a new one.
        estimators: names, `Estimator` objects or functions, the first of which decides; or "auto" (`ope.decide.automatic`).
        out: folder for `estimates.json`, which holds all that is found, and checkpoints; None writes nothing.
        discount: of the returns; one where episodes end or have a horizon.
        horizon: steps of an episode that count; see `Estimand.of`.
        greedy: deterministic (greedy) or sampled actions.
        task: simulator in which the estimates are checked; None checks nothing.
        episodes: of a policy there.
        seed: random seed.
        model: how the behaviour policy is learned where that is needed.
        cluster: column of the log whose values are redrawn as one, such as a user; None: the one by which episodes were held
            out.
        unseen: assert that the policies have not learned from this log, where their files do not say it.
        accept_model_based: deploy also by estimates that no logged reward corrects.
        counted: take note of the look at these episodes, whose level falls with the looks there have been.
        guarantee: deploy only by a lower bound of the gain that holds for any number of episodes; see `ope.guarantee`.
        return_range: least and greatest return that an episode can have, for the guarantee.
        confounding: deploy only if the gain stays above zero when odds of logged actions are off by up to this factor.
        by_group: column of the log, with one value per episode, for whose values the gain is told.
        tail: share of episodes, the worst of which are told apart.
        watch: called while something is fitted.

    Raises:
        UserError: input that does not fit, in one line.
    """
    groups = None
    if by_group is not None:
        values, codes = groups_of(data, by_group)
        groups = Groups(by_group, tuple(map(str, values)), codes)
    found = gather(given)
    names = [g.run if g.seed is None else f"{g.run} seed {g.seed}" for g in found]
    if len(set(names)) < len(names):
        names = [f"{name} ({i})" for i, name in enumerate(names)]
    task = find_task(task) if isinstance(task, str) else task
    if task is not None:
        there = Spec.empty(task.observation_shape, task.action_space, task.name)
        sizes = [(spec.observation_shape, spec.action_size) for spec in (there, data.spec)]
        if sizes[0] != sizes[1] or there.discrete != data.spec.discrete:
            told = " and ".join(f"{spec.name} has observations {spec.observation_shape}, actions {spec.action}"
                                for spec in (there, data.spec))  # fmt: skip
            raise UserError(f"the choice cannot be checked there: {told}")
    rows = fresh(found, data, unseen)
    cluster = cluster or next((g.by for g in found if g.by not in (None, RANDOM, TIME)), None)
    policies = [for_case(g, data) for g in found]
    case = OPEInput(
        data, policies, discount=discount, horizon=horizon, seed=seed, greedy=greedy, names=names, logged=True,
        out=None if out is None else Path(out) / "fits", watch=watch, held=rows.held, noise=None,
        clusters=None if cluster is None else clusters_of(data, cluster),
    )  # fmt: skip
    check(case, guarantee, return_range, confounding, groups, tail)  # what is refused is no look
    if estimators != "auto":
        estimators = [as_estimator(each) for each in ([estimators] if isinstance(estimators, str) else estimators)]
    spent = Look(1, ALPHA, len(found))
    if counted:
        spent = look(data.episode_ids[rows.held], digest([case.manner, case.estimand.as_json()], 16), len(found))
    decision = decide(
        case, estimators, seen=rows.against, accept_model_based=accept_model_based, alpha=spent.alpha, model=model,
        guarantee=guarantee, return_range=return_range, confounding=confounding, groups=groups, tail=tail,
    )  # fmt: skip
    results, checks, choice, more = decision
    truth = None
    if task is not None:
        acting = [g.policy[0].policy if isinstance(g.policy, tuple) else g.policy for g in found]
        truth = simulated(
            acting, task, episodes=episodes, seed=seed, greedy=greedy, discount=discount, horizon=case.estimand.horizon
        )
    every = [gains(each, spent.alpha, supported(each, checks)) for each in results]
    every[0][: len(names)] = choice.gains  # which know what speaks against an interval
    shares = lambda x: [None if np.isnan(share) else float(share) for share in x]  # noqa: E731
    told = {
        "log": data.name, "estimand": case.estimand.as_json() | {"words": str(case.estimand)}, "seed": seed, "truth": truth,
        "policies": [
            {"name": name, "run": g.run, "seed": g.seed, "file": None if g.file is None else str(g.file)}
            for name, g in zip(names, found)
        ],
        "propensities": "logged" if "behavior_log_probs" in data.extras else "learned",
        "judged": {"words": rows.told, "episodes": len(rows.held), "of": data.episodes, "fresh": not any(rows.against),
                   "units": int(case.units.max()) + 1, "cluster": cluster,
                   "clusters": len(np.unique(case.clusters[case.held]))},
        "looks": {"number": spent.number, "policies": spent.policies, "alpha": spent.alpha, "counted": counted},
        "support": {"missing": shares(checks.missing), "ratio": shares(checks.ratio), "degenerate": checks.degenerate.tolist()},
        "results": [
            {"method": each.method, "title": titled(each.method), "corrected": each.corrected, "value": each.value.tolist(),
             "low": each.low.tolist(), "high": each.high.tolist(), "gain": told_gains.tolist(),
             "seconds": each.seconds, "warnings": list(each.warnings),
             "effective": None if each.ess is None else each.ess.tolist(),
             "diagnostics": {name: shares(numbers) for name, numbers in each.diagnostics.items()}}
            for each, told_gains in zip(results, every)
        ],
        "choice": {"name": choice.name, "deploy": choice.deploy, "gain": [choice.gain, choice.low, choice.high],
                   "level": choice.level, "reason": choice.reason, "evidence": list(choice.evidence),
                   "warnings": list(choice.warnings), "objections": [list(own) for own in choice.objections], **more},
    }  # fmt: skip
    if out is not None:
        write_json(Path(out) / NAME, told)
    return Judged(results, choice, told)


def grounds(told: dict[str, Any]) -> list[tuple[str, str]]:
    """What a decision rests on, as pairs of a name and a text; of what `judge` found."""
    judged, looks, level = told["judged"], told["looks"], f"{100 * told['choice']['level']:.3g} %"
    cluster, count = judged["cluster"], judged.get("clusters")
    of = "" if cluster is None else f", in {count:,} clusters by {cluster}" if count else f", in clusters by {cluster}"
    policies = f"{looks['policies']:,} {'policy' if looks['policies'] == 1 else 'policies'}"
    looked = f"look {looks['number']} at these episodes or some of them, {policies} so far in all looks"
    if not looks["counted"]:
        looked = "looks at these episodes were not counted"
    known = {"logged": "those that were logged", "learned": "a model's of the behaviour policy: none were logged"}
    found = [
        ("log", told["log"]),
        ("estimated", told["estimand"]["words"]),
        ("evaluated on", judged["words"] + of),
        ("level", f"{level} for all policies at once: {looked}"),
    ]
    return found + ([("propensities", known[told["propensities"]])] if "propensities" in told else [])


def simulated(policies: Sequence[Any], task: Task, *, episodes: int, **options: Any) -> dict[str, Any]:
    """What policies are worth in a simulator, as `estimates.json` holds it; `options` are those of `evaluate`."""
    seen = evaluate(policies, task, episodes=episodes, **options).discounted
    errors = seen.std(1, ddof=1) / np.sqrt(episodes)
    return {"task": task.name, "episodes": episodes, "mean": seen.mean(1).tolist(), "error": errors.tolist()}


def checked(told: dict[str, Any]) -> str:
    """What the simulator says to the choice, in one line: its regret is what the best policy would have had beyond it."""
    truth = told["truth"]
    if truth is None:
        return "not checked: no simulator was named"
    means = np.asarray(truth["mean"])
    names = [each["name"] for each in told["policies"]]
    chosen = names.index(told["choice"]["name"])
    lost, spread = float(means.max() - means[chosen]), float(np.ptp(means))
    share = f", {100 * lost / spread:.0f} % of the range of all" if spread > 0 else ""
    rank = int((means > means[chosen]).sum()) + 1
    found = f"in the simulator {names[chosen]} has {means[chosen]:.2f} ± {truth['error'][chosen]:.2f} and is "
    if rank == 1:
        return f"{found}the best of {len(names)}"
    return (
        f"{found}number {rank} of {len(names)}; the best, {names[int(means.argmax())]}, has {means.max():.2f}: a regret of "
        f"{lost:.2f}{share}"
    )


def supports(told: dict[str, Any]) -> str:
    """How much of what each policy does has no support in the log, a line each."""
    names = [each["name"] for each in told["policies"]]
    width = max(map(len, names))
    shares = ["not known" if share is None else f"{100 * share:.0f} %" for share in told["support"]["missing"]]
    words = "mean weight per step {:.2f} (1 where there is support)"
    weights = ["" if mean is None else f", {words.format(mean)}" for mean in told["support"]["ratio"]]
    lines = [f"  {name:<{width}}  {share}{weight}" for name, share, weight in zip(names, shares, weights)]
    return "\n".join(["share of each policy's actions without support in the log", *lines])


def groups(told: dict[str, Any]) -> str:
    """The gain of the chosen policy in each group, a line each, where that was asked for."""
    found = told["choice"]["groups"]
    if "refused" in found:
        return f"gains by {found['column']} are not known: {found['refused']}"
    width = max(len(each["name"]) for each in found["values"])
    level = f"{100 * told['choice']['level']:.3g} %, for all groups at once"
    lines = [f"gain of {told['choice']['name']} by {found['column']} ({level})"]
    for each in found["values"]:
        ends = "too few for an interval" if each["low"] is None else f"[{each['low']:+.2f}, {each['high']:+.2f}]"
        gain = "" if each["gain"] is None else f"{each['gain']:+.2f} {ends}"
        lines.append(f"  {each['name']:<{width}}  {each['episodes']:>8,} episodes  {gain}")
    return "\n".join(lines)


def read_estimates(path: Path | str) -> dict[str, Any]:
    """What `judge` wrote into a folder, or the file itself.

    Raises:
        UserError: there is none.
    """
    path = Path(path)
    path = path / NAME if path.is_dir() else path
    if not path.exists():
        raise UserError(f"no estimates in {path}; `deadreckon ope --out FOLDER` writes them")
    told = read_json(path)
    if "estimand" not in told:
        raise UserError(f"{path} is from a version that judged policies on the rows that taught them; estimate them again")
    if not told["results"]:
        raise UserError(f"{path} holds no estimates: {told['choice']['reason']}")
    return told
