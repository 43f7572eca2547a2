"""A battery at a power market: a day of 24 hours, in each of which it sells, waits or buys. Small enough to be solved exactly.

The price follows the hour and a level that wanders, which the battery does not move. What is left at the end of the day is
bought at a low price. So the world has 24 x 5 x 7 states, and the value of any policy is a sum (`values`), which tests and the
demo hold estimates against.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.tasks.task import Reference, Simulator, Starts, Task

SELL, WAIT, BUY = range(3)
HOURS, FULL = 24, 4  # hours of a day; units that the battery holds, one an hour
BASE = np.array([
    38, 34, 31, 30, 30, 33, 45, 62, 74, 70, 60, 52, 46, 42, 42, 48, 60, 78, 92, 95, 86, 70, 54, 44,
], float)  # price of a unit by the hour, in euros
LEVELS = 1.0 + 0.12 * np.arange(-3, 4)  # what the day's level multiplies it by
WANDER = 0.25  # chance that the level falls in an hour, and that it rises
LOSS = 0.95  # of a unit that is sold, and of what is bought
LEFT = 30.0  # euros for a unit that is left at the end


def prices(hours: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Euros a unit, at hours 0 .. 23 and levels 0 .. 6."""
    return BASE[hours] * LEVELS[levels]


def outcome(hours: np.ndarray, charge: np.ndarray, levels: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What an hour earns, and the charge after it. Who sells from an empty battery, or buys for a full one, waits."""
    price = prices(hours, levels)
    sold, bought = (actions == SELL) & (charge > 0), (actions == BUY) & (charge < FULL)
    after = charge - sold + bought
    return sold * LOSS * price - bought * price / LOSS + (hours == HOURS - 1) * after * LEFT, after


def observed(hours: np.ndarray, charge: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """(n, 3) hour, charge and price."""
    return np.stack([hours, charge, prices(hours, levels)], -1).astype(np.float32)


def grid() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hour, charge and level of every state, (24, 5, 7) each."""
    hours, charge, levels = np.meshgrid(np.arange(HOURS), np.arange(FULL + 1), np.arange(len(LEVELS)), indexing="ij")
    return hours, charge, levels


def values(chances: np.ndarray | None = None) -> np.ndarray:
    """(24, 5, 7) expected euros from each state on.

    Args:
        chances: (24, 5, 7, 3) of each action; None: the best possible.
    """
    moves = np.zeros((len(LEVELS), len(LEVELS)))
    for level in range(len(LEVELS)):
        for step, chance in ((-1, WANDER), (0, 1 - 2 * WANDER), (1, WANDER)):
            moves[level, np.clip(level + step, 0, len(LEVELS) - 1)] += chance
    hours, charge, levels = grid()
    out, after = np.zeros(hours.shape), np.zeros(hours.shape[1:])
    for hour in reversed(range(HOURS)):
        each = []
        for action in (SELL, WAIT, BUY):
            earned, left = outcome(hours[hour], charge[hour], levels[hour], np.full_like(levels[hour], action))
            each.append(earned + (after @ moves.T)[left, levels[hour]])
        q = np.stack(each, -1)
        out[hour] = after = q.max(-1) if chances is None else (q * chances[hour]).sum(-1)
    return out


def start_value(found: np.ndarray) -> float:
    """The mean of `values` over the states that days begin in: an empty battery at any level."""
    return float(found[0, 0].mean())


@dataclass(frozen=True)
class Battery(Task):
    """The task. Observations are hour, charge and price; rewards are euros."""

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> Simulator:
        """See `Task.simulate`; it is too small for threads."""
        return Copies(self.name, seeds)


class Copies:
    """The simulator: whole days of prices are drawn when an episode begins."""

    def __init__(self, name: str, seeds: Sequence[int]):
        self._name, copies = name, len(seeds)
        self._starts = Starts(seeds, _day)
        self._levels = np.zeros((copies, HOURS), int)
        self._hour, self._charge = np.full(copies, HOURS), np.zeros(copies, int)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """See `Simulator.reset`."""
        which = np.arange(len(self._hour)) if which is None else np.asarray(which)
        if seeds is not None:
            self._starts.begin(which, seeds)
        for copy in which:
            self._levels[copy] = self._starts.next(copy)
        self._hour[which], self._charge[which] = 0, 0
        return self._observe()[which]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """See `Simulator.step`; actions are (copies,) integers."""
        actions = np.asarray(actions)
        running = self._hour < HOURS
        if actions.shape != self._hour.shape or not np.isin(actions[running], (SELL, WAIT, BUY)).all():
            raise UserError(f"{self._name}: actions are {len(self._hour)} integers of 0 .. 2, got {actions.tolist()}")
        hour = np.minimum(self._hour, HOURS - 1)
        earned, self._charge = outcome(hour, self._charge, self._levels[np.arange(len(hour)), hour], actions)
        self._hour = self._hour + running
        return self._observe(), earned, self._hour == HOURS, np.zeros(len(hour), bool)

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return self._starts.state() | {"levels": self._levels.copy(), "hour": self._hour.copy(), "charge": self._charge.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        self._starts.restore(state)
        self._levels, self._hour, self._charge = (state[name].copy() for name in ("levels", "hour", "charge"))

    def _observe(self) -> np.ndarray:
        hour = np.minimum(self._hour, HOURS - 1)
        return observed(hour, self._charge, self._levels[np.arange(len(hour)), hour])


def _day(generator: np.random.Generator) -> np.ndarray:
    """(24,) levels of a day."""
    draws = generator.random(HOURS)
    levels = np.empty(HOURS, int)
    levels[0] = int(draws[0] * len(LEVELS))
    for hour in range(1, HOURS):
        step = int(draws[hour] > 1 - WANDER) - int(draws[hour] < WANDER)
        levels[hour] = min(max(levels[hour - 1] + step, 0), len(LEVELS) - 1)
    return levels


TASK = Battery(
    name="battery", domain="battery", horizon=HOURS, observation_shape=(3,), action_space=Discrete(3),
    gym_id="deadreckon/Battery-v1", reference=Reference(-62.06, 269.17, "exact: uniform actions, and the best policy (`values`)"),
    summary="buy and sell power over a day; small enough to be solved exactly",
)  # fmt: skip
