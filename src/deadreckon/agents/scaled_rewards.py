"""Rewards in the units in which agents were published: scaled and shifted on the way into a batch, and nowhere else.

    r' = scale r + shift,   scale = normalized_return_range / (largest - smallest return of the log's episodes), or a number

With `standardise_rewards` their mean over the log is 0 and their standard deviation 1.
Returns, evaluations, reports and estimates of policies stay in the log's units.
"""

from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from deadreckon.agents.agent import Agent
from deadreckon.data.batch import Batch
from deadreckon.errors import UserError
from deadreckon.training.hyperparameters import Number, Positive, host
from deadreckon.training.later_fields import later


class ScaledRewards(Agent):
    """What agents share that learn from scaled rewards."""

    revision: ClassVar[int] = 1

    normalized_return_range: Positive | None = host(None)
    """range that the returns of the log's episodes are scaled to (published for IQL and XQL on robots: 1000); None: none"""
    reward_scale: Positive | None = None  # factor of every reward; None: 1, or by normalized_return_range
    reward_shift: Number = 0.0  # number added to every scaled reward (published for IQL on AntMaze: -1)
    standardise_rewards: bool = later(False)
    """whether rewards are standardised to mean 0 and standard deviation 1 (published for EDAC on Adroit)"""

    def resolve(self, spec, steps):
        """Fills in the scale of the rewards, and their shift where they are standardised."""
        agent = super().resolve(spec, steps)
        wanted, name = self.normalized_return_range, type(self).__name__
        if self.standardise_rewards:
            if wanted is not None or self.reward_scale is not None or self.reward_shift != 0.0:
                rest = "leave out reward_shift and normalized_return_range (0 and None), and set reward_scale to None"
                raise UserError(f"{name}.standardise_rewards sets the scale and the shift of rewards: {rest}")
            if not spec.rows:
                raise UserError(f"{name}.standardise_rewards needs a log, whose rewards it standardises; leave it out online")
            if not spec.reward.std > 0.0:
                raise UserError(
                    f"{name}.standardise_rewards needs rewards that differ; all of {spec.name} are {spec.reward.mean:g}"
                )
            scale = 1.0 / float(spec.reward.std)
            return agent.replace(reward_scale=scale, reward_shift=-scale * float(spec.reward.mean), standardise_rewards=False)
        if wanted is None:
            return agent.replace(reward_scale=1.0 if self.reward_scale is None else self.reward_scale)
        if self.reward_scale is not None:
            both = f"{name} takes reward_scale or normalized_return_range, got both"
            raise UserError(f"{both}; reward_scale=None leaves the scale to the other")
        low, high = spec.returns
        if not high > low:
            raise UserError(
                f"{name}.normalized_return_range needs episodes with different returns; all of {spec.name} have {low:g}: "
                "give reward_scale instead"
            )
        return agent.replace(reward_scale=wanted / (high - low), normalized_return_range=None)

    def learned(self, batch: Batch) -> Batch:
        """A batch with the scaled rewards of training; the training loop applies it to every batch."""
        return batch._replace(reward=self.reward_scale * batch.reward + self.reward_shift)

    def logged_value(self, value: Array) -> Any:
        """Values of learned rewards in the log's units; NaN with a shift, which counts by how long episodes last."""
        return jnp.where(self.reward_shift == 0.0, value / jnp.asarray(self.reward_scale), jnp.nan)
