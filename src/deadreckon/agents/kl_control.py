"""KL-control (Jaques et al. 2019; thesis 4.4): SAC with the log's policy in place of the uniform one.

A model of the log's policy is fitted first and stays. Where SAC has entropy, this has the divergence from that model: targets
and actor pay temperature (log pi(a|s) - log model(a|s)), and the temperature is such that the divergence is `target_kl` on
average.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from deadreckon.agents.bc import cloned
from deadreckon.agents.sac import SAC
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.nets.optim import copy
from deadreckon.training.learner import static


class KLControl(SAC):
    """SAC that pays for its divergence from the log's policy."""

    online: ClassVar[bool] = False

    target_kl: float = 1.0  # nats that the policy is away from the model on average
    behavior_lr: float = 3e-4  # learning rate of the behaviour model
    behavior_steps: int = static(100_000)  # updates of the behaviour model, before all others

    def resolve(self, spec, steps):
        """There is no entropy to hold."""
        if self.target_entropy not in (None, 0.0):
            raise UserError("KLControl holds a divergence, not an entropy: set target_kl and leave out target_entropy")
        return SAC.resolve(self.replace(target_entropy=0.0), spec, steps)

    @property
    def held_entropy(self):
        """Minus the divergence is in the place of the entropy."""
        return -self.target_kl

    def init(self, spec, key) -> Any:
        """SAC's state with a model of the log's policy, as yet unfitted."""
        model = MLP.create(spec.observation_size, self.hidden, 2 * spec.action_size, jax.random.fold_in(key, 2))
        return super().init(spec, key)._replace(model=model)

    def prepare(self, state, rows, key, fit):
        """Fits the model, by maximum likelihood; the actor begins as it."""
        model = cloned(self, fit, key)
        return state._replace(model=model, actor=copy(model))

    def act(self, state, observation, noise):
        """Actions of the present actor, and minus what they pay in targets."""
        d = dist.gaussian_head(state.actor(observation))
        pre = d.mean + jnp.exp(d.log_std) * noise
        if not self.entropy_backup:
            return jnp.tanh(pre), jnp.zeros(pre.shape[:-1])
        return jnp.tanh(pre), -jnp.exp(state.log_temperature) * divergence(d, state.model, observation, pre)

    def actor_loss(self, actor, state, batch, key):
        """temperature log(pi(a|s) / model(a|s)) - min_j Q_j(s, a), a reparameterised; also gives the mean divergence."""
        d = dist.gaussian_head(actor(batch.observation))
        pre = dist.sample(d, key)
        away = divergence(d, state.model, batch.observation, pre)
        q = self.believed(q_values(state.critics, batch.observation, jnp.tanh(pre)))
        return (jnp.exp(state.log_temperature) * away - q).mean(), away.mean()

    def update(self, state, batch, *, step, key):
        """SAC's, whose entropy is minus the divergence."""
        state, metrics = super().update(state, batch, step=step, key=key)
        return state, metrics | {"divergence": -metrics.pop("entropy")}


def divergence(d: dist.Gaussian, model: MLP, observation, pre):
    """log pi(a|s) - log model(a|s) of actions drawn from pi: one draw's estimate of the KL divergence, (b,)."""
    return dist.log_prob(d, pre) - dist.log_prob(dist.gaussian_head(model(observation)), pre)
