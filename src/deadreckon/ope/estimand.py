"""The estimand: which rewards of an episode count, their discount, and how the policy acts."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.sequences import times
from deadreckon.settings import check_kind

TAIL = 0.02  # share of the discounted time after a timeout that may be left to a critic without a warning
FIXED = 0.95  # share of the timeouts at the longest length from which on that is the horizon


@dataclass(frozen=True)
class Estimand:
    """The value of a policy: E[sum_t discount^t r_t] over episodes that begin as the log's do.

    The behaviour policy, and a check in a simulator, have the same estimand.

    Attributes:
        discount: of the rewards, per step.
        horizon: only the first `horizon` steps of an episode count; None: all steps until the episode ends by a terminal.
            Rewards after a timeout then count as well, although the log does not show them.
        greedy: the policy takes its deterministic (most likely) action; otherwise its actions are sampled.
    """

    discount: float = 0.995
    horizon: int | None = None
    greedy: bool = False

    def __post_init__(self):
        for name, hint in (("discount", float), ("horizon", int | None), ("greedy", bool)):
            check_kind(name, getattr(self, name), hint)
        if not 0.0 <= self.discount <= 1.0:
            raise UserError(f"discount must be in [0, 1], got {self.discount}")
        if self.horizon is not None and self.horizon < 1:
            raise UserError(f"horizon must be a number of steps, 1 or more, got {self.horizon}")

    @classmethod
    def of(cls, log: Dataset, discount: float, horizon: int | str | None = "auto", greedy: bool = False) -> "Estimand":
        """The estimand for a log.

        Args:
            log: the log with the episodes.
            discount: per step.
            horizon: steps, None, or "auto": 1 where all episodes have one step; the longest episode's length, if 95 % of the
                log's timeouts or more fall there and more than 2 % of the discounted time lies beyond it; else None.
            greedy: deterministic actions instead of sampled ones.

        Raises:
            UserError: a discount of one where episodes need not end.
        """
        check_kind("horizon", horizon, int | Literal["auto"] | None)
        check_kind("discount", discount, float)
        if isinstance(horizon, str):
            cut, most = log.lengths[~np.asarray(log.terminals)[log.ends]], int(log.lengths.max())
            fixed = len(cut) and (cut == most).mean() >= FIXED and discount**most > TAIL  # a few recordings may be shorter
            horizon = most if most == 1 or fixed else None
        found = cls(discount, horizon if horizon is None else int(horizon), greedy)
        found.check(log)
        return found

    def check(self, log: Dataset) -> None:
        """Refuses estimands without a finite value.

        Raises:
            UserError: a discount of one where episodes need not end.
        """
        if self.discount == 1.0 and self.horizon is None and not np.asarray(log.terminals)[log.ends].all():
            raise UserError(
                f"discount=1 needs episodes that end by a terminal, or a horizon: {log.name} has timeouts; give horizon "
                f"(for instance {int(log.lengths.max())}, the longest episode) or a discount below 1"
            )

    def effective_horizon(self, log: Dataset) -> float:
        """The largest discounted number of steps of an episode: a return divided by it is on the scale of a reward."""
        if self.horizon is not None:
            return discounted_steps(self.discount, self.horizon)
        return float(log.lengths.max()) if self.discount == 1.0 else 1.0 / (1.0 - self.discount)

    def cut(self, log: Dataset) -> Dataset:
        """The part of a log that counts: with a horizon, the first steps of each episode, which ends there; see `cut_at`."""
        if self.horizon is None:
            return log
        return cut_at(log, self.horizon)

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {"discount": self.discount, "horizon": self.horizon, "greedy": self.greedy}

    def __str__(self) -> str:
        return_ = "expected return" if self.discount == 1.0 else f"expected discounted return (discount {self.discount:g})"
        if self.horizon == 1:
            return_ = "expected reward"
            until = "of one step"
        elif self.horizon is not None:
            until = f"of the first {self.horizon:,} steps of an episode"
        else:
            until = "of an episode until it ends; rewards after a timeout count"
        return f"{return_} {until}; {'deterministic (greedy)' if self.greedy else 'sampled'} actions"


def discounted_steps(discount: float, steps: float) -> float:
    """sum_{t < steps} discount^t."""
    return float(steps) if discount == 1.0 else (1.0 - discount**steps) / (1.0 - discount)


def cut_at(log: Dataset, horizon: int) -> Dataset:
    """The first `horizon` steps of each episode; an episode that is that long ends there by a terminal.

    Raises:
        UserError: the log's rows do not follow each other.
    """
    lengths = log.lengths
    if (lengths == 1).all() and horizon >= 1 and np.asarray(log.terminals).all():
        return log
    if log.successors is not None:
        raise UserError(f"{log.name}: its rows do not follow each other, so the first {horizon} steps are not known")
    time = times(lengths)
    keep = time < horizon
    terminals, timeouts = np.array(log.terminals), np.array(log.timeouts)
    over = time == horizon - 1
    terminals[over], timeouts[over] = True, False
    final = np.array(log.final_observations)
    longer = np.flatnonzero(lengths > horizon)
    final[longer] = np.asarray(log.observations)[log.starts[longer] + horizon]
    return replace(
        log,
        observations=np.asarray(log.observations)[keep], actions=np.asarray(log.actions)[keep],
        rewards=np.asarray(log.rewards)[keep], terminals=terminals[keep], timeouts=timeouts[keep], final_observations=final,
        extras={name: np.asarray(column)[keep] for name, column in log.extras.items()},
    )  # fmt: skip
