"""A time budget: how much of it is left, and how it is divided."""

import math
import time
from dataclasses import dataclass

from deadreckon.errors import UserError
from deadreckon.runs.durations import in_words, seconds_of

RESERVE, SHORT, LONG = 0.05, 2.0, 15.0  # share of the time that is kept for the card, and its bounds in seconds
SCANT = 0.3  # the reserve is never more than this share
LEARNING = 0.6  # share of the rest for learning, as planned before anything is known


@dataclass(frozen=True)
class Clock:
    """How much time there is, in seconds.

    Attributes:
        budget: in all.
        began: by `time.perf_counter()`.
        reserve: of it, for the card.
    """

    budget: float
    began: float
    reserve: float

    @classmethod
    def of(cls, budget: float | str, began: float | None) -> "Clock":
        """Reads the budget.

        Raises:
            UserError: it is no time, or none at all.
        """
        seconds = seconds_of(budget) if isinstance(budget, str) else float(budget)
        if not 0 < seconds < math.inf:
            raise UserError(f"the budget must be above 0, got {budget} seconds")
        reserve = min(min(max(RESERVE * seconds, SHORT), LONG), SCANT * seconds)
        return cls(seconds, time.perf_counter() if began is None else began, reserve)

    def spent(self) -> float:
        """Since it began."""
        return time.perf_counter() - self.began

    def left(self) -> float:
        """Until the work must end."""
        return self.budget - self.reserve - self.spent()

    def divided(self) -> str:
        """How the time is planned, before anything is known."""
        work = self.budget - self.reserve
        parts = [LEARNING * work, (1 - LEARNING) * work, self.reserve]
        learning, judging, reserve = map(in_words, parts)
        return (
            f"time plan for {in_words(self.budget)}: about {learning} for pilots and training, {judging} for the evaluation "
            f"on held-out episodes, {reserve} in reserve; pilots measure the speed on this log and machine"
        )
