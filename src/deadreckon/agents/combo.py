"""COMBO (Yu et al. 2021): SAC on rollouts, with critics that are held down on actions which no log has seen.

To the squared errors of each critic j comes

    conservatism ( E_s[ log sum_a exp Q_j(s, a) ] - E_log[ Q_j(s, a) ] )

with s of the whole batch, logged and made up, and the sum estimated from `draws` actions each: uniform, of the policy at s, and
of the policy at s', each divided by its density (the penalty of CQL, Kumar et al. 2020). The model's doubts are not asked.
"""

import jax

from deadreckon.agents.cql import soft_maximum
from deadreckon.agents.dreaming import Dreaming
from deadreckon.errors import UserError
from deadreckon.nets.mlp import q_values
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, Sizes, static


class COMBO(Dreaming):
    """SAC on rollouts, with conservative critics."""

    hidden: Sizes = static((256, 256, 256))  # width of each hidden layer
    logged_rows: CountOrZero = static(128)  # of a batch are logged, half of 256; the others are made up
    entropy_backup: bool = static(False)  # whether targets hold the entropy bonus too
    conservatism: NonNegative = 5.0  # weight of the penalty (published: 0.5 or 5, by log)
    draws: Count = static(10)  # actions of each kind

    def resolve(self, spec, steps):
        """Refuses a batch without logged rows, from which critics could be held down without end."""
        if self.logged_rows < 1:
            raise UserError(f"COMBO needs logged rows in a batch, got {self.logged_rows}")
        return super().resolve(spec, steps)

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors, and the penalty."""
        loss, metrics = super().critic_loss(critics, state, batch, target, key)
        high = soft_maximum(critics, state.actor, batch, self.draws, jax.random.fold_in(key, 2)).mean(-1)
        logged = q_values(critics, batch.observation[: self.logged_rows], batch.action[: self.logged_rows]).mean(-1)
        gap = high - logged
        return loss + self.conservatism * gap.sum(), metrics | {"gap": gap.mean()}
