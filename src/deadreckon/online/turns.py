"""The alternation of acting and updates in an online run."""

import math
from dataclasses import dataclass

from deadreckon.errors import UserError

# Of each whole number the least value, and what it is, for messages.
_MEANINGS = {
    "copies": (1, "the number of environments that are stepped together for each seed"),
    "explore": (0, "the number of environment steps with random actions before the first update"),
    "block": (1, "the number of environment steps between two blocks of updates"),
}
_UPDATES = "the number of updates for each environment step"


@dataclass(frozen=True)
class Online:
    """The alternation of acting and updates.

    Attributes:
        copies: environments per seed, stepped together with one call of the policy.
        explore: environment steps of uniform actions before the first update; 0 only with a log.
        updates_per_step: updates per environment step after that (the update-to-data ratio).
        block: environment steps between two blocks of updates; the policy does not change in between.
    """

    copies: int = 8
    explore: int = 10_000
    updates_per_step: float = 1.0
    block: int = 64

    def __post_init__(self):
        for name, (least, meaning) in _MEANINGS.items():
            if not getattr(self, name) >= least:
                raise UserError(f"{name}, {meaning}, must be {least} or more, got {getattr(self, name)}")
        if not 0 < self.updates_per_step < math.inf:
            raise UserError(f"updates_per_step, {_UPDATES}, must be above 0, got {self.updates_per_step}")
        for name in ("block", "explore"):
            if (steps := getattr(self, name)) % self.copies:
                below = steps // self.copies * self.copies
                near = f"{below} or {below + self.copies}" if below >= _MEANINGS[name][0] else f"{below + self.copies}"
                raise UserError(
                    f"{name}, {_MEANINGS[name][1]}, must be a multiple of copies ({self.copies} environments that are stepped "
                    f"together), got {steps}, such as {near}"
                )
        if self.updates_per_block < 1 or abs(self.updates_per_block - self.block * self.updates_per_step) > 1e-9:
            near = max(self.updates_per_block, 1)
            raise UserError(
                f"updates_per_step, {_UPDATES}, must give a whole number of updates for each block of {self.block} environment "
                f"steps, got {self.updates_per_step}; {near / self.block!r} gives {near}"
            )

    @property
    def updates_per_block(self) -> int:
        """Updates between two blocks of acting."""
        return round(self.block * self.updates_per_step)

    def updates(self, steps: int) -> int:
        """Updates in a run of `steps` environment steps; whole blocks only.

        Raises:
            UserError: too few steps for one block.
        """
        blocks = (steps - self.explore) // self.block
        if blocks < 1:
            raise UserError(
                f"{steps} environment steps are too few: {self.explore} random ones before the first update (explore) and a "
                f"block of {self.block} are the least, so give {self.explore + self.block} or more, or less to explore"
            )
        return blocks * self.updates_per_block

    def steps(self, updates: int) -> int:
        """Environment steps taken when `updates` are done; the steps of a block come before its updates."""
        return self.explore + -(-updates // self.updates_per_block) * self.block if updates else 0
