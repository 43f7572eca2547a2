"""Cross-fitting: every episode is held out once, so that a small log serves for both training and evaluation.

Each of K policies is trained on all folds but one and evaluated on that one. The mean of their values is the value of the
procedure, and exactly that of the mixture that draws one of them for each episode. For a policy that is trained again on all
episodes, it is the value of the same procedure with a little less data.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Unpack, get_args

import numpy as np

from deadreckon.agents import agent_name, short_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.data.split import RANDOM, Fold, group_of
from deadreckon.data.split import folds as dealt
from deadreckon.errors import DivergedError, UserError, unknown
from deadreckon.files import write_json
from deadreckon.interrupts import resumable
from deadreckon.names import file_part
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy, Mixture
from deadreckon.runs.folder import Folder
from deadreckon.runs.lanes import lanes_of
from deadreckon.runs.reading import noted
from deadreckon.runs.records import CROSS_FIT, read_cross_fit
from deadreckon.runs.run import Run, load
from deadreckon.runs.seen import seen
from deadreckon.runs.settings import TrainOptions, TrainSettings
from deadreckon.runs.train import train
from deadreckon.versions import differences

Deliver = Literal["mixture", "refit"]
MIXTURE, REFIT = "mixture.npz", "refit"
MIXTURE_OF = "mixture-seed{}.npz"  # of one seed, where there are several


@dataclass(frozen=True)
class CrossFit:
    """A finished cross-fit.

    Attributes:
        path: its folder.
        config: the settings, as in `crossfit.json`; `members` are the mixture's, (fold, seed) each.
        runs: one per fold, which was not trained on it.
    """

    path: Path
    config: dict[str, Any]
    runs: list[Run]

    def fold_of(self, log: Dataset) -> np.ndarray:
        """(episodes,) the fold in which each episode was held out, whose policies were not trained on it; -1 for none."""
        fold = np.full(log.episodes, -1)
        for number, run in enumerate(self.runs):
            assert run.held is not None  # a cross-fit records it
            fold[seen(run.held, log)] = number
        return fold

    @property
    def policy_path(self) -> Path:
        """Path of the policy to deploy: the mixture's file, or the folder of the run on all episodes."""
        return self.path / (MIXTURE if self.config["deliver"] == "mixture" else REFIT)

    @property
    def policy(self) -> EnvPolicy:
        """The policy to deploy."""
        return store.load(self.policy_path) if self.config["deliver"] == "mixture" else load(self.policy_path).policy

    def policy_of(self, seed: int) -> EnvPolicy:
        """The policy to deploy for one seed: the mixture of its policies, or its policy trained on all episodes."""
        if self.config["deliver"] != "mixture":
            refit = load(self.policy_path)
            return refit.policies[refit.seeds.index(seed)]
        return Mixture.of([run.policies[run.seeds.index(seed)] for run in self.runs])

    def file_of(self, seed: int) -> Path | None:
        """The file of `policy_of`; None if a fold's policy of that seed failed, or in folders from older versions."""
        if self.config["deliver"] != "mixture":
            return Folder(self.policy_path).policy(seed)
        file = self.policy_path if len(self.runs[0].seeds) == 1 else self.path / MIXTURE_OF.format(seed)
        return file if file.exists() else None

    def __str__(self) -> str:
        held = [run.config["data"]["holdout"]["held"] for run in self.runs]
        count, most = (f"{n:,}" for n in (sum(held), max(held)))
        told = f"{len(self.runs)} folds of up to {most} of {count} episodes, each held out once"
        return f"{told}\npolicy: {self.policy_path}\ncross-fit folder: {self.path}"


def cross_fit(
    agent: Agent | str | Sequence[Agent],
    data: Dataset | str | Path,
    *,
    folds: int = 5,
    by: str | None = None,
    seed: int = 0,
    out: Path | str | None = None,
    deliver: Deliver = "mixture",
    steps: int = 100_000,
    seeds: int = 1,
    task: Any = None,
    **settings: Unpack[TrainOptions],
) -> CrossFit:
    """Trains an agent once for each fold of a log, on the other folds, and makes the policy to deploy.

    Args:
        agent: as for `runs.train.train`.
        data: a log, the name of a known one, or a file.
        folds: number of folds.
        by: "random", "time" or a column whose values stay together; see `data.split.Holdout`. None: the log's group, or
            "random".
        seed: of the folds, and the first of each run's.
        out: folder of the run folders `fold0`, `fold1`, ...; None is `runs/AGENT-LOG-crossfit`.
        deliver: "mixture" combines the policies of all folds into one, `mixture.npz`; "refit" makes a run on all episodes,
            `refit`.
        steps: number of updates, for every fold.
        seeds: number of independent runs of every fold.
        task: see `runs.train.train`.
        **settings: see `train`; for every fold, and without `holdout`. With `resume`, finished folds are not trained again, and
            `deliver` may be different.

    Raises:
        UserError: invalid input, in which case nothing is written, and results of an earlier call stay.
        DivergedError: every seed of a fold failed.
    """
    if (holdout := settings.get("holdout")) is not None:
        raise UserError(f"cross_fit holds every fold out in turn: leave holdout out, got {holdout}")
    asked = TrainSettings.of(settings)
    asked.check(seed, steps=steps, seeds=seeds)
    if deliver not in get_args(Deliver):
        raise unknown("delivery", deliver, get_args(Deliver))
    log = data if isinstance(data, Dataset) else catalogue.load(data, strict=asked.strict)
    by = by or group_of(log) or RANDOM
    fold = dealt(log, folds, by, seed)
    first = lanes_of(agent, seeds)[0]
    name = agent_name(first)
    path = Path(out) if out is not None else Path("runs") / file_part(f"{short_name(first)}-{log.name}-crossfit")
    config = {
        "folds": folds, "by": by, "seed": seed, "agent": name, "episodes": np.bincount(fold).tolist(),
        "data": {"name": log.name, "fingerprint": log.fingerprint}, "deliver": deliver,
    }  # fmt: skip
    shared: dict[str, Any] = {**settings, "seed": seed, "steps": steps, "seeds": seeds, "task": task}
    with Folder(path).alone(), resumable(path / CROSS_FIT):
        new = not path.exists()
        _begin(path, config, asked.resume)
        try:
            return _cross_fit(agent, log, path, config, shared)
        except UserError:
            if new and not any(path.glob("fold*")):  # training refused the input before it wrote anything
                shutil.rmtree(path, ignore_errors=True)
            raise


def _cross_fit(agent: Any, log: Dataset, path: Path, config: dict[str, Any], shared: dict[str, Any]) -> CrossFit:
    """The cross-fit in the folder `path`, which has begun; `shared` are options of `train`."""
    folds, by, seed = config["folds"], config["by"], config["seed"]
    runs = []
    for each in range(folds):
        runs.append(train(agent, log, out=path / f"fold{each}", holdout=Fold(each, folds, by, seed), **shared))
        if not each:  # the settings are accepted; the folds may be trained for longer, so mixtures are made again
            for mixture in path.glob("mixture*.npz"):
                mixture.unlink()
            write_json(path / CROSS_FIT, config)
    healthy = [[i for i, failure in enumerate(run.failures) if failure is None] for run in runs]
    each = min(map(len, healthy))  # as many of each fold, so that the mixture's value is the mean of the folds'
    if not each:
        failed = [not own for own in healthy].index(True)
        failure = next(f for f in runs[failed].failures if f is not None)
        raise DivergedError(f"{path / f'fold{failed}'} failed: {failure.metric} was not finite at update {failure.step}")
    if config["deliver"] == "mixture":
        picked = [(k, i) for k, own in enumerate(healthy) for i in own[:each]]
        config["members"] = [[k, runs[k].seeds[i]] for k, i in picked]
        mixture = Mixture.of([runs[k].policies[i] for k, i in picked])
        meta = {"agent": config["agent"], "members": config["members"], "log": noted(log)}
        known = {"taught": log.episode_ids, "held": np.zeros(0, np.uint64)}
        store.save(path / MIXTURE, mixture, meta, **known)
        for i in {*range(len(runs[0].seeds))}.intersection(*healthy) if len(runs[0].seeds) > 1 else ():
            one = Mixture.of([run.policies[i] for run in runs])  # the policy that is evaluated for this seed
            of = meta | {"members": [[k, run.seeds[i]] for k, run in enumerate(runs)]}
            store.save(path / MIXTURE_OF.format(runs[0].seeds[i]), one, of, **known)
    else:
        train(agent, log, out=path / REFIT, holdout=0, **shared)
    write_json(path / CROSS_FIT, config)
    return CrossFit(path, config, runs)


def load_cross_fit(path: Path | str) -> CrossFit:
    """A finished cross-fit from its folder.

    Raises:
        UserError: the folder holds none, or one that is not finished.
    """
    path = Path(path)
    if not (path / CROSS_FIT).exists():
        raise UserError(f"{path} holds no cross-fit (no {CROSS_FIT})")
    config = read_cross_fit(path / CROSS_FIT)
    folds = [path / f"fold{each}" for each in range(config["folds"])]
    parts = [Folder(each) for each in (folds if config["deliver"] == "mixture" else [*folds, path / REFIT])]
    steps = [each.read_config()["steps"] if each.has_policies() else None for each in parts]
    # While a cross-fit is trained for longer, some of its runs have more updates than others.
    if None in steps or len({*steps}) > 1 or not CrossFit(path, config, []).policy_path.exists():
        again = f"deadreckon train ... --cross-fit {config['folds']} --out {path} --resume"
        raise UserError(f"{path} is not finished; `{again}` resumes it")
    return CrossFit(path, config, [load(each) for each in folds])


def _begin(path: Path, config: dict[str, Any], resume: bool) -> None:
    """Writes the settings of a new cross-fit; of an earlier one, checks that it is the same.

    Raises:
        UserError: the folder holds something else, or `resume` is needed.
    """
    if (path / CROSS_FIT).exists():
        if not resume:
            raise UserError(f"{path} holds a cross-fit already; --resume continues it, or choose another --out")
        before = read_cross_fit(path / CROSS_FIT)
        if different := differences(before, config, ("folds", "by", "seed", "agent", "data")):
            raise UserError(f"{path} holds another cross-fit: {different[0]}; choose another --out")
    elif not Folder(path).is_free():
        raise UserError(f"{path} exists and is not a cross-fit; choose another --out")
    else:
        write_json(path / CROSS_FIT, config)
