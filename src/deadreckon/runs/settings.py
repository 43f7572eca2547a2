"""Settings of runs, such as their evaluation, storage and resuming, which Python, the command line and suites share.

Functions take these settings as keywords, `train(agent, log, chunk=500)`, and pass them on as one object. The classes
named `...Options` are the same keywords for type checkers.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import Fold, Holdout
from deadreckon.errors import UserError
from deadreckon.nets.encoder import Kind
from deadreckon.online import Online
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.settings import DecisionOptions, DecisionSettings, EstimateOptions, EstimateSettings, EvidenceSettings
from deadreckon.progress import unwatched
from deadreckon.randomness import check_seed
from deadreckon.runs.callback import Callback
from deadreckon.settings import Settings
from deadreckon.training.hyperparameters import check_fields

ChunkWatcher = Callable[[Any, int], Any]  # gets each `training.fit.Chunk` and the number of updates in all

MOST_HISTORY = 10_000  # most observations that a policy acts on


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Settings that runs on a log and runs in a simulator share."""

    evaluate_every: int | None = None
    """updates between evaluations; None: a tenth of the run; the last update is evaluated too"""
    episodes: int = 20  # number of episodes per evaluation
    chunk: int = 1000  # updates between checkpoints, the most that an interruption can lose
    resume: bool = False  # continue the run in the output folder; a finished run is extended if --steps is larger
    watch: ChunkWatcher = unwatched  # called after every chunk; ends the run there by raising `StopTraining`
    callback: Callback | None = None
    """called after every chunk with a `runs.callback.TrainingProgress`; ends the run there by returning True"""
    track: Any = None
    """trackers that show the run: tensorboard, wandb, mlflow, a `runs.trackers.Tracker`, or several of these"""

    def check(self, seed: int, **counts: int) -> None:
        """Refuses settings out of range.

        Args:
            seed: the first random seed.
            **counts: further numbers that must be at least 1, `seeds` among them.

        Raises:
            UserError: names what is too small or too large.
        """
        counts |= {"chunk": self.chunk, "episodes": self.episodes}
        for name, count in counts.items():
            if count < 1:
                raise UserError(f"{name} must be >= 1, got {count}")
        if not 0 <= seed <= 2**32 - counts["seeds"]:
            raise UserError(f"seed must be from 0 to 2^32 - seeds, got {seed}")
        if self.evaluate_every is not None and self.evaluate_every < 1:
            raise UserError(f"evaluate_every must be >= 1, got {self.evaluate_every}")


@dataclass(frozen=True, kw_only=True)
class TrainSettings(RunSettings):
    """Settings of a run on a log."""

    stream: bool | None = None  # whether to keep the log in host memory; None: only if it does not fit on the device
    strict: bool = False  # whether to refuse logs with actions out of bounds instead of clipping them
    holdout: Holdout | Fold | float | None = None
    """Held-out episodes, which are not used for training (`data.split.Holdout`, or its share alone; 0: none). None: a fifth at
    random if there is no simulator to evaluate in, else none; of a memory-mapped log the latest fifth, so that the rest is not
    copied. Of fewer than 10 episodes (or clusters) none, with a warning. A run that is continued keeps its own."""
    history: int = 1  # number of last observations, with the actions between them, that the agent and its policy act on

    encoder: Kind = "patches"
    """network between images and the agent's own: patches (fast on CPUs), drq or impala (convolutions, for GPUs)"""
    shift: int | None = None
    """largest random shift of images in pixels (DrQ); None: 4 of 84, and 0 where positions in an image determine actions"""

    def check(self, seed: int, **counts: int) -> None:
        """See `RunSettings`."""
        super().check(seed, history=self.history, **counts)
        if self.history > MOST_HISTORY:
            raise UserError(f"history must be <= {MOST_HISTORY:,}, got {self.history:,}")
        if self.shift is not None and self.shift < 0:
            raise UserError(f"shift must be 0 or more pixels, got {self.shift}")


@dataclass(frozen=True, kw_only=True)
class OnlineSettings(RunSettings):
    """Settings of a run in a simulator."""

    evaluate_every: int | None = None
    """environment steps between evaluations; None: a fiftieth of the run; the last update is evaluated too"""
    episodes: int = 10  # number of episodes per evaluation, with greedy actions
    chunk: int = 2000  # updates between checkpoints, the most that an interruption can lose
    threads: int | None = None  # threads of the simulator; None: one per core; results do not depend on it
    settings: Online | None = None  # how acting and updates alternate; None: the agent's own, or the defaults of `Online`
    demonstrations: Dataset | str | Path | None = None  # log of demonstrations, for agents that use them (DAPG)
    start: object = None  # offline run to continue (a `Run` or its folder), from its last update; None: train from scratch
    data: Dataset | str | Path | None = None  # log to mix into every batch; None: that of `start`, or none
    log_share: float = 0.5  # share of the log in each batch, where there is one; the rest is the agent's own experience


@dataclass(frozen=True, kw_only=True)
class ReturnSettings(Settings):
    """Settings of returns that are measured in a simulator; the same as of an `Estimand`."""

    discount: float | Sequence[float] = 0.99  # discount factor per step, one for all policies or one each
    horizon: int | None = None  # number of first steps that are discounted and summed; None: all until a terminal or a timeout
    greedy: bool = True  # whether actions are deterministic (greedy) instead of sampled

    def check_values(self) -> None:
        """Refuses what an `Estimand` refuses."""
        super().check_values()
        for discount in self.discounts:
            Estimand(discount, self.horizon, self.greedy)

    @property
    def discounts(self) -> list[float]:
        """The discount factors: one for all policies, or one each."""
        return np.atleast_1d(np.asarray(self.discount, np.float64)).tolist()


@dataclass(frozen=True, kw_only=True)
class JudgeSettings(DecisionSettings, EstimateSettings):
    """Settings of an evaluation from a log: what is estimated, what decides, on which episodes."""

    horizon: int | Literal["auto"] | None = "auto"
    """first steps of an episode that count; None: all; auto: those of the longest episode, if timeouts fall there, else all"""
    out: Path | str | None = None  # folder of `estimates.json`, which has all results, and of checkpoints; None: none
    cluster: str | None = None
    """column whose values are resampled as one, such as a user; None: that of the holdout, if it has one"""
    by_group: str | None = None  # column, such as a site, whose values are subgroups; the gain is shown for each
    unseen: bool = False  # assert that policies were not trained on this log if their files do not record it
    counted: bool = True  # whether this counts as a look at these episodes; the level falls with the number of looks
    episodes: int = 100  # number of episodes per policy in the simulator that checks the choice

    def check_values(self) -> None:
        """Refuses settings out of range before a look is counted, which cannot be undone."""
        super().check_values()
        if self.episodes < 2:
            raise UserError(f"episodes must be 2 or more, for a standard error, got {self.episodes}")
        check_fields(self.model)


@dataclass(frozen=True, kw_only=True)
class RecommendSettings(EvidenceSettings):
    """Settings of a recommendation, from a log to a decision."""

    task: str | None = None  # simulator to check the choice in; None: that of a known log, and none for others
    discount: float = 0.99  # discount factor per step of the returns
    seed: int = 0  # random seed of everything
    holdout: Holdout | float | None = None
    """Episodes that are held out for the decision (`data.split.Holdout`, or its share alone). None: a fifth at random, of a
    memory-mapped log the latest."""
    history: int = 1  # number of last observations, with the actions between them, that agents and policies act on
    columns: dict[str, Any] | None = None  # of tables, which column is what; see `Dataset.from_frame`

    def check_values(self) -> None:
        """Refuses settings out of range before the log is read."""
        super().check_values()
        check_seed(self.seed)
        if not 0.0 <= self.discount < 1.0:
            raise UserError(f"discount must be in [0, 1), got {self.discount}")
        if self.history < 1:
            raise UserError(f"history must be >= 1, got {self.history}")
        share = self.holdout.share if isinstance(self.holdout, Holdout) else self.holdout
        if share is not None and not 0 < share < 1:
            raise UserError(f"holdout: the share held out must lie between 0 and 1, got {share}: the decision needs it")


class _Options(TypedDict, total=False):
    evaluate_every: int | None
    episodes: int
    chunk: int
    resume: bool
    watch: ChunkWatcher
    callback: Callback | None
    track: Any


class TrainOptions(_Options, total=False):
    """Keywords of `TrainSettings`."""

    stream: bool | None
    strict: bool
    holdout: Holdout | Fold | float | None
    history: int
    encoder: Kind
    shift: int | None


class OnlineOptions(_Options, total=False):
    """Keywords of `OnlineSettings`."""

    threads: int | None
    settings: Online | None
    demonstrations: Dataset | str | Path | None
    start: object
    data: Dataset | str | Path | None
    log_share: float


class ReturnOptions(TypedDict, total=False):
    """Keywords of `ReturnSettings`."""

    discount: float | Sequence[float]
    horizon: int | None
    greedy: bool


class JudgeOptions(EstimateOptions, DecisionOptions, total=False):
    """Keywords of `JudgeSettings`."""

    cluster: str | None
    by_group: str | None
    unseen: bool
    counted: bool
    episodes: int


class RecommendOptions(TypedDict, total=False):
    """Keywords of `RecommendSettings`."""

    task: str | None
    discount: float
    seed: int
    holdout: Holdout | float | None
    accept_model_based: bool
    cost_limit: float | Mapping[str, float] | Sequence[str] | None
    stationary: bool
    history: int
    columns: dict[str, Any] | None
