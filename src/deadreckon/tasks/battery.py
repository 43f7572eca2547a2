"""A battery at a power market: a day in eight blocks of three hours, in each of which it sells, waits or buys a unit.

The price follows the block and a level that wanders, which the battery does not move. What is left at the end of the day is
bought at a low price. So the world has 8 x 4 x 4 states, the value of any policy is a sum (`values`), and estimates from a log
can be held against it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.tasks.task import Reference, Simulator, Starts, Task

SELL, WAIT, BUY = range(3)
BLOCKS, FULL = 8, 3  # blocks of a day; units that the battery holds
BASE = np.array([3.5, 3.1, 5.0, 7.0, 4.6, 4.4, 9.0, 6.2])  # price of a unit of 100 kWh by the block, in euros
LEVELS = np.array([0.7, 0.9, 1.1, 1.3])  # what the level multiplies it by
WANDER = 0.3  # chance that the level falls from one block to the next, and that it rises
LOSS = 0.95  # of a unit that is sold, and of what is bought
LEFT = 2.5  # euros for a unit that is left at the end


def prices(blocks: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Euros a unit, in blocks 0 .. 7 and levels 0 .. 3."""
    return BASE[blocks] * LEVELS[levels]


def outcome(blocks: np.ndarray, charge: np.ndarray, levels: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a block earns, and the charge after it. Who sells from an empty battery, or buys for a full one, waits."""
    price = prices(blocks, levels)
    sold, bought = (actions == SELL) & (charge > 0), (actions == BUY) & (charge < FULL)
    after = charge - sold + bought
    return sold * LOSS * price - bought * price / LOSS + (blocks == BLOCKS - 1) * after * LEFT, after


def observed(blocks: np.ndarray, charge: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """(n, 3) block, charge and price."""
    return np.stack([blocks, charge, prices(blocks, levels)], -1).astype(np.float32)


def grid() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Block, charge and level of every state, (8, 4, 4) each."""
    blocks, charge, levels = np.meshgrid(np.arange(BLOCKS), np.arange(FULL + 1), np.arange(len(LEVELS)), indexing="ij")
    return blocks, charge, levels


def values(chances: np.ndarray | None = None) -> np.ndarray:
    """(8, 4, 4) expected euros from each state on.

    Args:
        chances: (8, 4, 4, 3) of each action; None: the best possible.

    Raises:
        UserError: probabilities of another shape, negative ones, or such that do not sum to 1.
    """
    if chances is not None:
        chances = np.asarray(chances, float)
        if chances.shape != (shape := (*grid()[0].shape, BUY + 1)):
            raise UserError(f"battery: probabilities must have shape {shape}, got {chances.shape}")
        if not ((chances >= 0).all() and np.abs(chances.sum(-1) - 1.0).max() <= 1e-3):
            raise UserError("battery: probabilities of actions must be 0 or more and sum to 1 in each state")
    moves = np.zeros((len(LEVELS), len(LEVELS)))
    for level in range(len(LEVELS)):
        for step, chance in ((-1, WANDER), (0, 1 - 2 * WANDER), (1, WANDER)):
            moves[level, np.clip(level + step, 0, len(LEVELS) - 1)] += chance
    blocks, charge, levels = grid()
    out, after = np.zeros(blocks.shape), np.zeros(blocks.shape[1:])
    for block in reversed(range(BLOCKS)):
        each = []
        for action in (SELL, WAIT, BUY):
            earned, left = outcome(blocks[block], charge[block], levels[block], np.full_like(levels[block], action))
            each.append(earned + (after @ moves.T)[left, levels[block]])
        q = np.stack(each, -1)
        out[block] = after = q.max(-1) if chances is None else (q * chances[block]).sum(-1)
    return out


@dataclass(frozen=True)
class Battery(Task):
    """The task. Observations are block, charge and price; rewards are euros."""

    revision: ClassVar[int] = 1

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> Simulator:
        """See `Task.simulate`; it is too small for threads."""
        return Copies(self.name, seeds)


class Copies:
    """The simulator: whole days of prices are drawn when an episode begins."""

    def __init__(self, name: str, seeds: Sequence[int]):
        self._name, copies = name, len(seeds)
        self._starts = Starts(seeds, _day)
        self._levels = np.zeros((copies, BLOCKS), int)
        self._block, self._charge = np.full(copies, BLOCKS), np.zeros(copies, int)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """See `Simulator.reset`."""
        which, days = self._starts.begun(which, seeds)
        for copy, levels in zip(which, days):
            self._levels[copy] = levels
        self._block[which], self._charge[which] = 0, 0
        return self._observe()[which]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """See `Simulator.step`; actions are (copies,) integers."""
        actions = np.asarray(actions)
        running = self._block < BLOCKS
        if actions.shape != self._block.shape or not np.isin(actions[running], (SELL, WAIT, BUY)).all():
            raise UserError(f"{self._name}: actions are {len(self._block)} integers of 0 .. 2, got {actions.tolist()}")
        block = np.minimum(self._block, BLOCKS - 1)
        earned, self._charge = outcome(block, self._charge, self._levels[np.arange(len(block)), block], actions)
        self._block = self._block + running
        return self._observe(), earned, self._block == BLOCKS, np.zeros(len(block), bool)

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        own = {"levels": self._levels, "block": self._block, "charge": self._charge}
        return self._starts.state() | {name: column.copy() for name, column in own.items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        self._starts.restore(state)
        self._levels, self._block, self._charge = (state[name].copy() for name in ("levels", "block", "charge"))

    def _observe(self) -> np.ndarray:
        block = np.minimum(self._block, BLOCKS - 1)
        return observed(block, self._charge, self._levels[np.arange(len(block)), block])


def _day(generator: np.random.Generator) -> np.ndarray:
    """(8,) levels of a day."""
    draws = generator.random(BLOCKS)
    levels = np.empty(BLOCKS, int)
    levels[0] = int(draws[0] * len(LEVELS))
    for block in range(1, BLOCKS):
        step = int(draws[block] > 1 - WANDER) - int(draws[block] < WANDER)
        levels[block] = min(max(levels[block - 1] + step, 0), len(LEVELS) - 1)
    return levels


TASK = Battery(
    name="battery", domain="battery", horizon=BLOCKS, observation_shape=(3,), action_space=Discrete(3),
    gym_id="deadreckon/Battery-v1",
    reference=Reference(-3.821, 9.666, "exact: uniform actions, and the best policy (`values`)"),
    summary="buy and sell power over a day; small enough to be solved exactly",
)  # fmt: skip
