"""The battery's log: an operator who goes by the clock and now and then does something else, and how likely that was."""

import numpy as np

from deadreckon.collect.growing_log import collected
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.tasks.battery import BLOCKS, BUY, SELL, TASK, WAIT

NIGHT, EVENING = (0, 1), (6, 7)  # blocks of the day in which the operator buys, and sells
TRIED = 0.4  # of the blocks the operator takes any action, each with the same chance


def by_the_clock(blocks: np.ndarray) -> np.ndarray:
    """(n, 3) the operator's chances of each action in these blocks."""
    rule = np.where(np.isin(blocks, NIGHT), BUY, np.where(np.isin(blocks, EVENING), SELL, WAIT))
    return TRIED / 3 + (1 - TRIED) * np.eye(3)[rule]


def collect_battery(days: int, seed: int = 0) -> Dataset:
    """A log of so many days; its column `behavior_log_probs` tells how likely each action was.

    Args:
        days: episodes of eight blocks, one or more.
        seed: of prices and actions.

    Raises:
        UserError: no days.
    """
    if days < 1:
        raise UserError(f"days must be 1 or more, got {days}")
    prices, draws = np.random.SeedSequence(seed).spawn(2)
    simulator = TASK.simulate([int(s) for s in prices.generate_state(days, np.uint64)])
    rng = np.random.default_rng(draws)
    seen, observations, actions, rewards, chances = simulator.reset(), [], [], [], []
    for block in range(BLOCKS):
        likely = by_the_clock(np.full(days, block))
        taken = (rng.random(days)[:, None] > likely.cumsum(1)).sum(1).clip(max=2)
        observations.append(seen)
        actions.append(taken)
        chances.append(likely[np.arange(days), taken])
        seen, earned, _, _ = simulator.step(taken)
        rewards.append(earned)
    found = observations, actions, rewards, chances
    columns = [np.stack(each, 1).reshape(days * BLOCKS, *each[0].shape[1:]) for each in found]
    provenance = collected(None, seed, ("numpy",), {"task": TASK.name, "days": days, "tried": TRIED})
    terminals = np.tile(np.arange(BLOCKS) == BLOCKS - 1, days)
    return Dataset.from_arrays(
        observations=columns[0], actions=columns[1], rewards=columns[2], terminals=terminals, final_observations=seen,
        action_space=TASK.action_space, name="battery-by-the-clock", provenance=provenance,
        behavior_log_probs=np.log(columns[3]),
    )  # fmt: skip
