"""AlgaeDICE (Nachum et al. 2019; thesis 7.4): a policy by the dual of its own value, a saddle point instead of backups.

With the residuals of critic j, a' from the actor, as the authors' code mixes target and present critics,

    delta_j = r + discount (0.95 min_i Q'_i(s', a') + 0.05 Q_j(s', a') - temperature log pi(a'|s')) - Q_j(s, a),

critics minimise and the actor maximises

    E[ f(delta_j) ] + (1 - discount) regularisation E[ Q_j(s_0, a_0) ],   f(x) = |x|^p / p,

over the log's rows and its first observations s_0, with a_0 from the actor. The gradient goes through both ends of delta.
"""

from typing import Annotated, Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.agent import backup
from deadreckon.agents.sac import SAC
from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, minimum, q_values
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import NonNegative, Range

FRESH = 0.05  # share of the present critics in what follows


class AlgaeDICE(SAC):
    """Policy gradients from arbitrary experience by DICE."""

    revision: ClassVar[int] = 1
    supports_discrete: ClassVar[bool] = False
    online: ClassVar[bool] = False
    fine_tunes: ClassVar[bool] = False

    actor_lr: NonNegative = 1e-3  # learning rate of the actor
    critic_lr: NonNegative = 1e-3  # learning rate of the critics
    temperature_lr: NonNegative = 1e-3  # learning rate of the logarithm of the entropy temperature
    regularisation: NonNegative = 0.01  # weight of the divergence from the distribution of the log (alpha in the paper)
    exponent: Annotated[float, Range(gt=1)] = 1.5  # exponent p of the divergence function f, above 1

    def needs(self, spec):
        """Transitions, and the first observations of episodes."""
        return BatchSpec(batch_size=self.batch_size, initial=self.batch_size, standardise=self.standardise)

    def target(self, state, batch, key) -> Any:
        """None: critics move both sides of the equation."""
        return None

    def residual(
        self, critics: MLP, actor: MLP, state: Any, batch: Batch, key: Array
    ) -> tuple[Float[Array, "k b"], Float[Array, "b"]]:
        """delta_j of every critic, and log pi(a'|s')."""
        d = dist.gaussian_head(actor(batch.next_observation))
        pre = dist.sample(d, key)
        log_prob = dist.log_prob(d, pre)
        before, after = (q_values(each, batch.next_observation, jnp.tanh(pre)) for each in (state.target_critics, critics))
        bonus = -jnp.exp(state.log_temperature) * log_prob if self.entropy_backup else 0.0
        future = (1.0 - FRESH) * minimum(before) + FRESH * after + bonus
        return backup(batch, self.discount, future) - q_values(critics, batch.observation, batch.action), log_prob

    def first(self, critics: MLP, actor: MLP, batch: Batch, key: Array) -> Float[Array, "k b"]:
        """(1 - discount) regularisation Q_j(s_0, a_0)."""
        action = jnp.tanh(dist.sample(dist.gaussian_head(actor(batch.initial_observation)), key))
        return (1.0 - self.discount) * self.regularisation * q_values(critics, batch.initial_observation, action)

    def critic_loss(self, critics, state, batch, target, key):
        """E[f(delta_j)] + (1 - discount) regularisation E[Q_j(s_0, a_0)], summed over critics."""
        k_residual, k_first = keys(key, "residual", "first")
        delta, _ = self.residual(critics, state.actor, state, batch, k_residual)
        # |x|^p has no slope that autodiff could find at 0.
        size = jnp.abs(delta) + 1e-12
        loss = size**self.exponent / self.exponent + self.first(critics, state.actor, batch, k_first)
        return loss.mean(-1).sum(), {"critic_loss": loss.mean(), "residual": delta.mean()}

    def actor_loss(self, actor, state, batch, key):
        """Minus the mean over critics of f'(delta_j) delta_j, where delta_j is positive, and the first term's part."""
        k_residual, k_first = keys(key, "residual", "first")
        delta, log_prob = self.residual(state.critics, actor, state, batch, k_residual)
        slope = jax.lax.stop_gradient(jnp.maximum(delta, 0.0) ** (self.exponent - 1.0))
        gain = slope * delta + self.first(state.critics, actor, batch, k_first)
        return -gain.mean(), log_prob.mean()
