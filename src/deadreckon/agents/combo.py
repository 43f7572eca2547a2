"""COMBO (Yu et al. 2021): SAC on rollouts, with critics that are held down on actions which no log has seen.

To the squared errors of each critic j comes

    conservatism ( E_s[ log sum_a exp Q_j(s, a) ] - E_log[ Q_j(s, a) ] )

with s of the whole batch, logged and made up, and the sum estimated from `draws` actions each: uniform, of the policy at s, and
of the policy at s', each divided by its density (the penalty of CQL, Kumar et al. 2020). The model's doubts are not asked.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.dreaming import Dreaming
from deadreckon.data.batch import Batch
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.training.learner import static


class COMBO(Dreaming):
    """SAC on rollouts, with conservative critics."""

    hidden: tuple[int, ...] = static((256, 256, 256))  # width of each hidden layer
    logged_rows: int = static(128)  # of a batch are logged, half of 256; the others are made up
    entropy_backup: bool = static(False)  # whether targets hold the entropy bonus too
    conservatism: float = 5.0  # weight of the penalty (published: 0.5 or 5, by log)
    draws: int = static(10)  # actions of each kind

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


def soft_maximum(critics: MLP, actor: MLP, batch: Batch, draws: int, key: Array) -> Float[Array, "k b"]:
    """Estimates log of the integral of exp Q(s, .) over all actions, up to a constant of the number of draws."""
    k_uniform, k_now, k_next = jax.random.split(key, 3)
    rows, size = batch.action.shape
    uniform = jax.random.uniform(k_uniform, (draws, rows, size), minval=-1.0, maxval=1.0)
    parts = [q_values(critics, batch.observation, uniform) + size * jnp.log(2.0)]
    for k, seen in ((k_now, batch.observation), (k_next, batch.next_observation)):
        d = dist.gaussian_head(actor(seen))
        pre = dist.sample(d, k, (draws,))
        parts.append(q_values(critics, batch.observation, jnp.tanh(pre)) - dist.log_prob(d, pre))
    return jax.nn.logsumexp(jnp.concatenate(parts, 1), axis=1)
