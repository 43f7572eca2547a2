"""A time budget: how much of it is left, and how it is divided."""

import math
import time
from dataclasses import dataclass

from deadreckon.errors import UserError
from deadreckon.runs.durations import in_words, seconds_of

RESERVE, SHORT, LONG = 0.05, 2.0, 15.0  # share of the time that is kept for the card, and its bounds in seconds
SCANT = 0.3  # largest share of the time for the reserve
LEARNING = 0.6  # share of the rest for training, as planned before pilots


@dataclass(frozen=True)
class Clock:
    """A time budget, in seconds.

    Attributes:
        budget: all of it.
        began: start, by `time.perf_counter()`.
        reserve: part of the budget that is kept for the card.
    """

    budget: float
    began: float
    reserve: float

    @classmethod
    def of(cls, budget: float | str, began: float | None) -> "Clock":
        """Reads the budget.

        Raises:
            UserError: it is not a time, or not above 0.
        """
        seconds = seconds_of(budget) if isinstance(budget, str) else float(budget)
        if not 0 < seconds < math.inf:
            raise UserError(f"the budget must be above 0, got {budget} seconds")
        reserve = min(min(max(RESERVE * seconds, SHORT), LONG), SCANT * seconds)
        return cls(seconds, time.perf_counter() if began is None else began, reserve)

    def spent(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.began

    def left(self) -> float:
        """Seconds until the work must end."""
        return self.budget - self.reserve - self.spent()

    def divided(self) -> str:
        """The planned division of the time in words, before anything is measured."""
        work = self.budget - self.reserve
        parts = [LEARNING * work, (1 - LEARNING) * work, self.reserve]
        learning, judging, reserve = map(in_words, parts)
        return (
            f"time plan for {in_words(self.budget)}: about {learning} for pilots and training, {judging} for the evaluation "
            f"on held-out episodes, {reserve} in reserve; pilots measure the speed on this log and machine"
        )
