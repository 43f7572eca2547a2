"""An agent that compiles in a second, for tests of what is around agents."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from deadreckon.agents.agent import Agent
from deadreckon.data.batch import BatchSpec
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP
from deadreckon.policies.kinds import TanhGaussian
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, static


class Little(Agent):
    """Imitates what was rewarded. Every number of a batch, and the key, move its weights."""

    online: ClassVar[bool] = True

    lr: NonNegative = 1e-2
    hidden: Sizes = static((4,))
    batch_size: Count = static(8)

    def needs(self, spec):
        return BatchSpec(batch_size=self.batch_size)

    def init(self, spec, key):
        return MLP.create(spec.observation_size, self.hidden, 2 * spec.action_size, key)

    def update(self, state, batch, *, step, key):
        worth = jnp.tanh(batch.reward + (1.0 - batch.terminal) * batch.next_observation.mean(-1))

        def loss(actor):
            d = dist.gaussian_head(actor(batch.observation))
            return -((worth + 0.1 * jax.random.uniform(key)) * dist.log_prob(d, jnp.arctanh(batch.action))).mean()

        value, grads = jax.value_and_grad(loss)(state)
        return jax.tree.map(lambda p, g: p - self.lr * g, state, grads), {"loss": value}

    def policy(self, state):
        return TanhGaussian(state)
