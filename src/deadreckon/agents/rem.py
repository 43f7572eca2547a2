"""REM (Agarwal et al. 2020; thesis 7.4): critics with many heads; every update fits one random mixture of them.

With weights w, uniform numbers divided by their sum, drawn for every batch,

    L = E[ ( sum_k w_k Q_k(s, a) - r - discount sum_k w_k Q'_k(s', a') )^2 ].

Of continuous actions a' and the actor are TD3's, as in D4RL's table, and the actor follows the mean of the heads; of discrete
actions a' maximises the same mixture, as published, and the policy takes the best action by the mean.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.agent import backup
from deadreckon.agents.td3 import TD3, State
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import copy, init_opt
from deadreckon.policies.candidates import GreedyActions
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, static


class REM(TD3):
    """TD3, or Q-learning for discrete actions, on mixtures of heads."""

    revision: ClassVar[int] = 2
    fine_tunes: ClassVar[bool] = False
    supports_discrete: ClassVar[bool] = True
    other_names: ClassVar[dict[str, str]] = {"num_heads": "heads"}

    actor_lr: NonNegative = 1e-3  # learning rate of the actor
    critic_lr: NonNegative = 1e-3  # learning rate of the critics
    heads: Count = static(100)  # number of heads of the critic network (published for discrete actions: 200)
    hidden: Sizes = static((400, 300))  # width of each hidden layer
    batch_size: Count = static(100)  # batch size (transitions per update)

    def init(self, spec, key):
        """Fresh networks; targets are copies. There is no actor where actions are discrete."""
        ka, kc = keys(key, "actor", "critics")
        inputs = spec.observation_size + (0 if spec.discrete else spec.action_size)
        outputs = self.heads * (spec.action_size if spec.discrete else 1)
        options: Any = {"normalise": self.layer_norm, "init": self.critic_init, "mask": spec.mask_size}
        critic = MLP.create(inputs, self.hidden, outputs, kc, **options)
        actor: Any = ()
        if not spec.discrete:
            actor = MLP.create(spec.observation_size, self.hidden, spec.action_size, ka, init=self.actor_init)
        return State(actor, critic, copy(actor), copy(critic), init_opt(actor), init_opt(critic))

    def head_values(self, critic: MLP, observation: Array, action: Array | None) -> Float[Array, "b k *n"]:
        """Q of every head for one action a state; for None of every discrete action."""
        if action is None:
            return critic(observation).reshape(len(observation), self.heads, -1)
        if jnp.issubdtype(action.dtype, jnp.integer):
            values = self.head_values(critic, observation, None)
            return jnp.take_along_axis(values, action[:, None, None], -1)[..., 0]
        return critic(jnp.concatenate([observation, action], -1))

    def target(self, state, batch, key):
        """Weights of the heads (k,), and r + discount sum_k w_k Q'_k(s', a')."""
        k_weights, k_act = keys(key, "weights", "act")
        weights = simplex(k_weights, self.heads)
        discrete = jnp.issubdtype(batch.action.dtype, jnp.integer)
        action = None if discrete else self.next_action(state, batch, k_act)
        mixed = mixture(weights, self.head_values(state.target_critics, batch.next_observation, action))
        return weights, backup(batch, self.discount, mixed.max(-1) if discrete else mixed)

    def critic_loss(self, critics, state, batch, target, key):
        """The squared error of one random mixture."""
        weights, value = target
        q = self.head_values(critics, batch.observation, batch.action)
        error = jnp.square(mixture(weights, q) - jax.lax.stop_gradient(value)).mean()
        return error, {"critic_loss": error, "q": q.mean()}

    def actor_loss(self, actor, state, batch):
        """-mean_k Q_k(s, pi(s)); nothing where actions are discrete."""
        if not isinstance(actor, MLP):
            return jnp.zeros(())
        return -self.head_values(state.critics, batch.observation, jnp.tanh(actor(batch.observation))).mean()

    def policy(self, state):
        """The actor, or the best of discrete actions by the mean of the heads."""
        return super().policy(state) if isinstance(state.actor, MLP) else GreedyActions(averaged(state.critics, self.heads))

    def q_value(self, state, observation, action):
        """The mean of the heads."""
        return self.head_values(state.critics, observation, action).mean(1)


def averaged(critic: MLP, heads: int) -> MLP:
    """The network whose outputs are means over the heads: of its last layer's, which are heads times actions."""
    weights, bias = critic.weights[-1], critic.biases[-1]
    last = weights.reshape(len(weights), heads, -1).mean(1), bias.reshape(heads, -1).mean(0)
    weights, biases = (*critic.weights[:-1], last[0]), (*critic.biases[:-1], last[1])
    return dataclasses.replace(critic, weights=weights, biases=biases)


def mixture(weights: Float[Array, "k"], values: Float[Array, "b k *n"]) -> Float[Array, "b *n"]:
    """sum_k w_k Q_k."""
    return (values * weights.reshape(-1, *[1] * (values.ndim - 2))).sum(1)


def simplex(key: Array, count: int) -> Float[Array, "k"]:
    """Uniform numbers divided by their sum."""
    drawn = jax.random.uniform(key, (count,))
    return drawn / drawn.sum()
