"""COMBO (Yu et al. 2021): SAC on rollouts, with critics that are held down on actions which no log has seen.

To the squared errors of each critic j comes

    cql_weight ( E_s[ log sum_a exp Q_j(s, a) ] - E_log[ Q_j(s, a) ] )

with s of the whole batch, logged and made up, and the sum estimated from `samples` actions each: uniform, of the policy at s,
and of the policy at s', each divided by its density (the penalty of CQL, Kumar et al. 2020). No uncertainty of the model is
used.
"""

from typing import ClassVar

from deadreckon.agents.cql import soft_maximum
from deadreckon.agents.offline_mbrl import OfflineMBRL
from deadreckon.errors import UserError
from deadreckon.nets.mlp import q_values
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, Sizes, static


class COMBO(OfflineMBRL):
    """SAC on rollouts, with conservative critics."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"conservatism": "cql_weight", "beta": "cql_weight", "draws": "samples"}

    hidden: Sizes = static((256, 256, 256))  # width of each hidden layer
    real_batch_size: CountOrZero = static(128)
    """logged transitions in a batch (128 of 256 are half); the others come from the model"""
    entropy_backup: bool = static(False)  # whether the critics' targets include the entropy bonus
    cql_weight: NonNegative = 5.0  # weight of the conservative penalty (beta in the paper; published: 0.5 or 5, by log)
    samples: Count = static(10)  # actions sampled from each distribution to estimate the log-sum-exp

    def resolve(self, spec, steps):
        """Refuses a batch without logged rows, from which critics could be held down without end."""
        agent = super().resolve(spec, steps)
        if self.real_batch_size < 1:
            raise UserError(f"COMBO.real_batch_size, the logged rows in a batch, must be 1 or more, got {self.real_batch_size}")
        return agent

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors, and the penalty."""
        loss, metrics = super().critic_loss(critics, state, batch, target, key)
        high = soft_maximum(critics, state.actor, batch, self.samples, key).mean(-1)
        logged = q_values(critics, batch.observation[: self.real_batch_size], batch.action[: self.real_batch_size]).mean(-1)
        gap = high - logged
        return loss + self.cql_weight * gap.sum(), metrics | {"gap": gap.mean()}
