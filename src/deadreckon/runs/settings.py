"""How a run is evaluated, kept and gone on with: what Python, the command line and suites share.

Functions take these settings as keywords, `train(agent, log, chunk=500)`, and pass them on as one object. `TrainOptions` and
`OnlineOptions` are the same keywords for type checkers.
"""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypedDict

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import Fold, Holdout
from deadreckon.errors import UserError, unknown
from deadreckon.online import Online
from deadreckon.progress import unwatched

ChunkWatcher = Callable[[Any, int], Any]  # gets each `training.fit.Chunk` and the number of updates in all


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """What runs on a log and runs in a simulator have in common."""

    evaluate_every: int | None = None
    """updates between evaluations; None: a tenth of the run; the last update is evaluated too"""
    episodes: int = 20  # number of episodes per evaluation
    chunk: int = 1000  # updates between checkpoints, which is also what a kill can lose
    resume: bool = False  # continue the run in the output folder; a finished one is made longer if more steps are asked for
    watch: ChunkWatcher = unwatched  # called after every chunk; ends the run there by raising `runs.recorder.StopTraining`

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Settings from keywords.

        Raises:
            UserError: there is no such setting.
        """
        names = [field.name for field in dataclasses.fields(cls)]
        for name in given:
            if name not in names:
                raise unknown("setting", name, names)
        return cls(**given)

    def check(self, seed: int, **counts: int) -> None:
        """Refuses what no run can be made of.

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
    """Of a run on a log."""

    stream: bool | None = None  # whether batches are fetched from the host; None: where the log does not fit on the device
    strict: bool = False  # whether to refuse logs with actions out of bounds instead of clipping them
    holdout: Holdout | Fold | float | None = None
    """Episodes to judge by, which are not learned from (`data.split.Holdout`, or its share alone; 0: none). None: a fifth at
    random of a log that no simulator judges, none of others; of a memory-mapped log the latest fifth, so that the rest is not
    copied. Of fewer than 10 episodes (or clusters) none, with a warning. A run that is continued keeps its own."""


@dataclass(frozen=True, kw_only=True)
class OnlineSettings(RunSettings):
    """Of a run in a simulator."""

    evaluate_every: int | None = None  # environment steps between evaluations; None: a fiftieth of the run
    episodes: int = 10  # number of episodes per evaluation, with greedy actions
    chunk: int = 2000  # updates between checkpoints, which is also what a kill can lose
    threads: int | None = None  # threads of the simulator; None: one per core; results do not depend on it
    settings: Online | None = None  # how acting and learning take turns; None: the agent's own, or the defaults of `Online`
    demonstrations: Dataset | str | Path | None = None  # log of demonstrations, for agents that learn from them (DAPG)


class _Options(TypedDict, total=False):
    evaluate_every: int | None
    episodes: int
    chunk: int
    resume: bool
    watch: ChunkWatcher


class TrainOptions(_Options, total=False):
    """Keywords of `TrainSettings`."""

    stream: bool | None
    strict: bool
    holdout: Holdout | Fold | float | None


class OnlineOptions(_Options, total=False):
    """Keywords of `OnlineSettings`."""

    threads: int | None
    settings: Online | None
    demonstrations: Dataset | str | Path | None
