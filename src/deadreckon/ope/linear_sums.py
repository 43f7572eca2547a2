"""Sums over rows from which critics that are linear in features are fitted, with and without each fold or group."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

BLOCK = 1024  # rows at a time
SUMMED = ("gram", "next", "reward", "start", "rows", "episodes", "lost_gram", "lost_reward", "lost_rows")


class Critic(NamedTuple):
    """Solved weights.

    Attributes:
        weights: (steps, size) of the value with 1, 2, ... steps to go, or (1, size) without a horizon.
        ratios: (steps, size) of the ratio of the policy's occupancy of step 0, 1, ... over the log's rows, or (1, size) of its
            discounted occupancy.
        ridge: that it was solved with.
        settled: whether the backup does not diverge.
    """

    weights: np.ndarray
    ratios: np.ndarray
    ridge: float
    settled: bool


@dataclass
class Sums:
    """Sums over the rows of each of several groups of episodes, in float64.

    Attributes:
        gram: (groups, d, d) of phi phi' of all rows, as one step to go needs no successors.
        next: (groups, policies, d, d) of phi phi_next', zero after terminals.
        reward: (groups, d) of phi r of all rows.
        start: (groups, policies, d) of features at initial observations.
        rows, episodes: (groups,) counts.
        lost_gram, lost_reward, lost_rows: (groups, 2, *) the part of gram, reward and rows that cannot be used for more steps:
            rows without a known next observation (0) and, for the behaviour policy, also those without a known next action (1).
        logged: index of the behaviour policy, or -1.
    """

    gram: np.ndarray
    next: np.ndarray
    reward: np.ndarray
    start: np.ndarray
    rows: np.ndarray
    episodes: np.ndarray
    lost_gram: np.ndarray
    lost_reward: np.ndarray
    lost_rows: np.ndarray
    logged: int

    def lacks_rows(self, policy: int) -> bool:
        """Whether some rows cannot be used for a policy, so that its sums are over fewer."""
        return bool(self.lost_rows[:, int(policy == self.logged)].any())

    def kind(self, policy: int) -> int:
        """Which policies share a Gram matrix: 1 of the behaviour policy where it has fewer rows than the others, else 0."""
        return int(policy == self.logged and not np.array_equal(self.lost_rows[:, 0], self.lost_rows[:, 1]))

    def whole(self, policy: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(groups, ...) gram, reward and number of rows of one policy, over the rows with a known successor."""
        if not self.lacks_rows(policy):
            return self.gram, self.reward, self.rows
        kind = int(policy == self.logged)
        return self.gram - self.lost_gram[:, kind], self.reward - self.lost_reward[:, kind], self.rows - self.lost_rows[:, kind]

    def of(self, weight: np.ndarray, policy: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """gram, next and reward of one policy over the rows with a known successor, its mean initial features and the number of
        these rows, groups counted `weight` times.
        """
        add = partial(np.tensordot, weight, axes=1)
        start = add(self.start[:, policy]) / max(float(weight @ self.episodes), 1.0)
        gram, reward, rows = self.whole(policy)
        return add(gram), add(self.next[:, policy]), add(reward), start, float(weight @ rows)

    def of_all(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """gram, reward and number of all rows, groups counted `weight` times."""
        return np.tensordot(weight, self.gram, 1), np.tensordot(weight, self.reward, 1), float(weight @ self.rows)


def blocks(rows: np.ndarray) -> list[np.ndarray]:
    """Rows, a block at a time."""
    return [rows[i : i + BLOCK] for i in range(0, len(rows), BLOCK)]
