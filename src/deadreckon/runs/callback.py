"""The callback of a run: what a user's function receives after every chunk, and how it ends the run."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.errors import UserError
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.training.fit import Failure


class StopTraining(Exception):
    """Raised by a callback or watcher to end the run with this chunk, as if it were complete; it can be resumed."""


@dataclass(frozen=True)
class TrainingProgress:
    """The progress of a run, as its callback receives it after a chunk of updates.

    Attributes:
        path: the run folder.
        step: updates done.
        steps: updates in all.
        seeds: one per lane.
        metrics: per name (seeds,) means over the chunk; of a failed seed NaN.
        failures: per seed None, or the metric and step at which it diverged.
    """

    path: Path
    step: int
    steps: int
    seeds: list[int]
    metrics: dict[str, np.ndarray]
    failures: tuple[Failure | None, ...]
    find_evaluations: Callable[[], pa.Table] = field(repr=False)
    find_policies: Callable[[], list[EnvPolicy]] = field(repr=False)

    @property
    def evaluations(self) -> pa.Table:
        """One row per episode of every evaluation up to `step`; waits for unfinished evaluations, so that the decisions of a
        callback do not depend on the machine's speed."""
        return self.find_evaluations()

    @property
    def policies(self) -> list[EnvPolicy]:
        """The current policies, one per seed; for a failed seed the last good one."""
        return self.find_policies()


Callback = Callable[[TrainingProgress], Any]  # returns True to end the run, else False or None


def ends(callback: Callback, progress: TrainingProgress) -> bool:
    """Whether the callback wants the run to end here.

    Raises:
        UserError: it returned something other than True, False and None.
    """
    answer = callback(progress)
    if answer is not None and not isinstance(answer, bool | np.bool_):
        raise UserError(f"a callback must return True to end the run, or False or None to continue, got {answer!r}")
    return bool(answer)
