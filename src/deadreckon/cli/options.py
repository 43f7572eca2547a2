"""Options of commands that are settings of functions too: each is declared once, where the function is.

These functions need numerical libraries, which take a second to load. So commands import this module when they begin, and
nothing imports it on the way to another command.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import tyro

from deadreckon.cli.data import Mapping
from deadreckon.cli.fits import NAMES, Fits
from deadreckon.runs.settings import JudgeSettings, OnlineSettings, RecommendSettings, TrainSettings

_TRACKERS = tyro.conf.arg(metavar="tensorboard|wandb|mlflow|module:Class ...")
_LIMITS = tyro.conf.arg(metavar="[COLUMN=]LIMIT [COLUMN=LIMIT ...]")


@dataclass(frozen=True, kw_only=True)
class _Online(OnlineSettings):
    demonstrations: str | None = None  # log of demonstrations, a known name or a file, for agents that learn from them
    start: Annotated[str | None, tyro.conf.arg(name="from", metavar="RUN")] = None
    """folder of an offline run to continue, from its last update; None: train from scratch"""
    data: str | None = None  # log to mix into every batch, a known name or a file; None: that of --from, or none
    settings: tyro.conf.Suppress[Any] = None
    watch: tyro.conf.Suppress[Any] = None
    callback: tyro.conf.Suppress[Any] = None
    track: Annotated[tuple[str, ...], _TRACKERS] = ()  # trackers that show the run


@dataclass(frozen=True, kw_only=True)
class _OnLog(TrainSettings):
    holdout: Annotated[float | None, tyro.conf.arg(metavar="SHARE")] = None
    """share of the episodes that is held out for `deadreckon ope`; None: 0.2, or 0 if there is a simulator"""
    watch: tyro.conf.Suppress[Any] = None
    callback: tyro.conf.Suppress[Any] = None
    track: Annotated[tuple[str, ...], _TRACKERS] = ()  # trackers that show the run


@dataclass
class TrainOnline:
    """Train a policy by acting in a simulator; --agent NAME chooses the algorithm, --from RUN continues an offline run."""

    task: str | None = None
    """simulator: a task (see `deadreckon tasks`), gymnasium:ID or module:Class; None: with --from, the task of that run"""
    steps: int = 1_000_000  # environment steps per seed, including the uniformly random ones at the beginning
    seeds: int | None = None
    """number of runs in one program, with random seeds SEED .. SEED + SEEDS - 1; None: 1, or with --from the run's"""
    seed: int | None = None  # first random seed; None: 0, or with --from that of the run
    out: str | None = None  # run folder; None: runs/AGENT-TASK-online, or runs/AGENT-TASK-fine-tuned with --from
    copies: int | None = None  # environments stepped in parallel per seed; None: the agent's own number, or 8
    explore: int | None = None  # environment steps with uniform actions before the first update; None: the agent's, or 10,000
    updates_per_step: float | None = None  # updates per environment step after the random ones; None: the agent's, or 1
    block: int | None = None  # environment steps between two blocks of updates; None: the agent's own number, or 64
    settings: Annotated[_Online, tyro.conf.arg(name="")] = field(default_factory=_Online)


@dataclass
class Train:
    """Train a policy on a log with the algorithm --agent NAME (required), or with --online by acting in a simulator.

    --preset NAME sets the hyperparameters to those published for a log or domain; see `deadreckon agents`.
    """

    data: str  # log to train on: a known name, or a file
    map: Annotated[Mapping, tyro.conf.arg(name="")]  # columns of a table, and how its file is read
    horizon: int | None = None  # number of steps after which episodes were cut off, for logs that do not mark time limits
    steps: int = 100_000  # number of updates per seed
    seeds: int = 1  # number of independent runs in one compiled program, with the random seeds SEED .. SEED + SEEDS - 1
    seed: int = 0  # first random seed
    task: str | None = None
    """simulator to evaluate in: a task, a Gymnasium id or module:Class; None: that of a known log, none for others"""
    out: str | None = None  # run folder; None: runs/AGENT-LOG
    mmap: bool = False  # whether to memory-map the log, for logs larger than memory; folders of more than 1 GiB always are
    settings: Annotated[_OnLog, tyro.conf.arg(name="")] = field(default_factory=_OnLog)
    holdout_by: Annotated[str | None, tyro.conf.arg(metavar="random|time|COLUMN")] = None
    """how to choose held-out episodes: random, the latest (time), or all episodes of some values of a COLUMN"""
    cross_fit: Annotated[int | None, tyro.conf.arg(metavar="FOLDS")] = None
    """number of folds: one policy per fold, trained on all other folds, so that every episode is held out once"""
    deliver: Literal["mixture", "refit"] = "mixture"
    """policy to deploy after --cross-fit: one fold's, sampled per episode (mixture), or one trained on all episodes (refit)"""


@dataclass(frozen=True, kw_only=True)
class _Judge(JudgeSettings):
    cost_limit: Annotated[tuple[str, ...] | None, _LIMITS] = None
    """limit of a policy's total cost, one number or COLUMN=LIMIT each; deploy only if the interval's upper end is within"""
    out: str | None = None  # folder of estimates (for `report --estimates`) and checkpoints, to continue from
    model: tyro.conf.Suppress[Any] = None  # the sizes of fits make it
    counted: tyro.conf.Suppress[bool] = True
    episodes: tyro.conf.Suppress[int] = JudgeSettings.episodes
    watch: tyro.conf.Suppress[Any] = None


@dataclass
class Ope:
    """Estimate the values of policies from a log alone, with confidence intervals, on episodes held out from training.

    --select prints a decision, --list the estimators; `deadreckon ope bench` compares them.
    """

    data: str  # log to estimate from: a known name, or a file
    policies: tuple[str, ...]  # run or cross-fit folders, policy files (.npz; DOPE's .pkl), or a task with policies
    estimators: Annotated[str, NAMES] = "auto"
    """names of estimators with commas (see --list), of which the first one decides; auto: by properties of the log"""
    select: bool = False  # whether to print a decision card: which policy to deploy, or none, and why
    map: Annotated[Mapping, tyro.conf.arg(name="")] = field(default_factory=Mapping)  # columns of a table
    log_horizon: int | None = None  # number of steps after which episodes were cut off: the --horizon that `train` had, if any
    episodes: int | None = None  # number of episodes to use, the first on which no policy was trained; None: all of these
    task: str | None = None
    """simulator in which to check the decision, if there is one: a task, a Gymnasium id or module:Class"""
    settings: Annotated[_Judge, tyro.conf.arg(name="")] = field(default_factory=_Judge)
    fits: Annotated[Fits, tyro.conf.arg(name="")] = field(default_factory=Fits)


@dataclass(frozen=True, kw_only=True)
class _Recommend(RecommendSettings):
    holdout: Annotated[float | None, tyro.conf.arg(metavar="SHARE")] = None
    """share of the episodes that is held out for the decision; None: 0.2"""
    holdout_by: Annotated[str | None, tyro.conf.arg(metavar="random|time|COLUMN")] = None
    """how to choose held-out episodes: random, the latest (time), or all episodes of some values of a COLUMN"""
    cost_limit: Annotated[tuple[str, ...] | None, _LIMITS] = None
    """limit of a policy's total cost, one number or COLUMN=LIMIT each; deploy only if the interval's upper end is within"""
    columns: tyro.conf.Suppress[Any] = None


@dataclass
class Recommend:
    """Train agents on a log, estimate their values on held-out episodes, and recommend which to deploy in a given time."""

    data: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]  # log to train on: a known name, or a file
    budget: str = "30m"  # time of the whole command, such as 90s, 30m or 2h; a decision card is written at its end
    out: str = "runs/recommend"  # folder of the runs, the estimates and report.html, which must not exist yet
    settings: Annotated[_Recommend, tyro.conf.arg(name="")] = field(default_factory=_Recommend)
    map: Annotated[Mapping, tyro.conf.arg(name="")] = field(default_factory=Mapping)  # columns of a table
