"""Policies of runs judged from a log alone, and, where there is a simulator, the judgement checked in it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.ope.coverage import LEVEL, MODEL, coverage
from deadreckon.ope.estimate import BehaviorModel, Case, Estimates, Watcher
from deadreckon.ope.registry import as_estimator
from deadreckon.ope.select import Choice, gain, select
from deadreckon.policies import library, store
from deadreckon.policies.dope import load_dope
from deadreckon.runs.evaluate import evaluate
from deadreckon.runs.train import Run, load
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Task

NAME = "estimates.json"


class Judged(NamedTuple):
    """What `judge` finds.

    Attributes:
        estimates: one an estimator.
        choice: by the first of them.
        told: all of it as JSON values, as in `estimates.json`.
    """

    estimates: list[Estimates]
    choice: Choice
    told: dict[str, Any]


def gather(given: Sequence[Any]) -> tuple[list[Any], list[tuple[str, int | None]]]:
    """Policies, and for each the name of what it comes from and its seed there.

    Args:
        given: runs, their folders, policy files (`.npz`, DOPE's `.pkl`), or names of tasks whose eleven snapshots are meant.

    Raises:
        UserError: none of these.
    """
    policies: list[Any] = []
    owners: list[tuple[str, int | None]] = []
    for each in given:
        path = None if isinstance(each, Run) else Path(each)
        if path is None or path.is_dir():
            run = each if isinstance(each, Run) else load(each)
            policies += run.policies
            owners += [(run.path.name, seed) for seed in run.seeds]
        elif path.exists() or path.suffix:
            policies.append(load_dope(path) if path.suffix in (".pkl", ".pickle") else store.load(path))
            owners.append((path.stem, None))
        else:
            snapshots = [s for s in library.library(str(each)) if s.name.startswith("snapshot-")]
            policies += [s.policy() for s in snapshots]
            owners += [(f"{each} {s.name}", None) for s in snapshots]
    if not policies:
        raise UserError("no policy to judge")
    return policies, owners


def judge(
    given: Sequence[Any],
    data: Dataset,
    estimators: Sequence[Any] = ("fqe",),
    *,
    out: Path | str | None = None,
    discount: float = 0.995,
    greedy: bool = False,
    task: Task | str | None = None,
    episodes: int = 100,
    seed: int = 0,
    model: BehaviorModel = MODEL,
    watch: Watcher = lambda what, step, steps: None,
) -> Judged:
    """Estimates policies from a log, chooses one, and then looks into the simulator whether that was right.

    Args:
        given: where the policies are; see `gather`.
        data: the log; not necessarily the one that they learned from.
        estimators: names, `Estimator` objects or functions; the first decides.
        out: folder for `estimates.json`, which holds all that is found, and checkpoints; None writes nothing.
        discount: of the returns.
        greedy: the policies' best guesses, or their draws.
        task: where the estimates are checked; None checks nothing.
        episodes: of a policy there.
        seed: of everything random.
        model: how the log's own policy is learned, to see what of the policies' actions the log covers.
        watch: called while something is fitted.

    Raises:
        UserError: input that does not fit, in one line.
    """
    policies, owners = gather(given)
    names = [name if s is None else f"{name} seed {s}" for name, s in owners]
    if len(set(names)) < len(names):
        names = [f"{name} ({i})" for i, name in enumerate(names)]
    found = [as_estimator(each) for each in estimators]
    task = find_task(task) if isinstance(task, str) else task
    if task is not None:
        there = Spec.empty(task.observation_shape, task.action_space, task.name)
        sizes = [(spec.observation_shape, spec.action_size) for spec in (there, data.spec)]
        if sizes[0] != sizes[1] or there.discrete != data.spec.discrete:
            told = " and ".join(f"{spec.name} has observations {spec.observation_shape}, actions {spec.action}"
                                for spec in (there, data.spec))  # fmt: skip
            raise UserError(f"the choice cannot be checked there: {told}")
    case = Case(
        data, policies, discount=discount, seed=seed, greedy=greedy, names=names, logged=True,
        out=None if out is None else Path(out) / "fits", watch=watch,
    )  # fmt: skip
    covered = coverage(case, model)
    results = [each.on(case) for each in found]
    choice = select(results, covered)
    truth = None
    if task is not None:
        seen = evaluate(policies, task, episodes=episodes, seed=seed, greedy=greedy, discount=discount).discounted
        errors = seen.std(1, ddof=1) / np.sqrt(episodes)
        truth = {"task": task.name, "episodes": episodes, "mean": seen.mean(1).tolist(), "error": errors.tolist()}
    told = {
        "log": data.name, "discount": discount, "greedy": greedy, "seed": seed, "truth": truth,
        "policies": [{"name": name, "run": run, "seed": s} for name, (run, s) in zip(names, owners)],
        "covered": [None if np.isnan(share) else float(share) for share in covered],
        "results": [
            {"method": each.method, "value": each.value.tolist(), "low": each.low.tolist(), "high": each.high.tolist(),
             "gain": [list(gain(each, i)) for i in range(len(names))], "seconds": each.seconds, "warnings": list(each.warnings),
             "effective": None if each.effective is None else each.effective.tolist()}
            for each in results
        ],
        "choice": {"name": choice.name, "deploy": choice.deploy, "gain": [choice.gain, choice.low, choice.high],
                   "reason": choice.reason, "evidence": list(choice.evidence), "warnings": list(choice.warnings)},
    }  # fmt: skip
    if out is not None:
        write_json(Path(out) / NAME, told)
    return Judged(results, choice, told)


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
    return (
        f"in the simulator {names[chosen]} has {means[chosen]:.2f} ± {truth['error'][chosen]:.2f} and is number {rank} of "
        f"{len(names)}; the best, {names[int(means.argmax())]}, has {means.max():.2f}: a regret of {lost:.2f}{share}"
    )


def coverages(told: dict[str, Any]) -> str:
    """How much of what each policy does the log covers, a line each."""
    names = [each["name"] for each in told["policies"]]
    width = max(map(len, names))
    shares = ["not known" if share is None else f"{100 * share:.0f} %" for share in told["covered"]]
    lines = [f"  {name:<{width}}  {share}" for name, share in zip(names, shares)]
    return "\n".join([f"actions within what the log shows ({100 * LEVEL:.0f} % of its own are)", *lines])


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
    # Files from before coverage was told.
    told.setdefault("covered", [None] * len(told["policies"]))
    return told


