"""FQL (Park et al. 2025): a one-step actor that imitates a flow and is improved by a critic.

A flow model imitates the log: its field v(s, x, t) is fitted by flow matching, so that following it from noise z at t = 0 to
t = 1 gives actions like the log's. The actor mu(s, z) is held to where the flow ends from the same noise, and raises the
critics:

    L_flow  = E[ | v(s, (1 - t) z + t a, t) - (a - z) |^2 ],
    L_actor = E[ alpha | mu(s, z) - flow(s, z) |^2 - mean_j Q_j(s, mu(s, z)) / c ],

where c is E[ | mean_j Q_j(s, mu(s, z)) | ] without gradient, or 1 with `scale_q=False`.
"""

from typing import ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import backup, bellman_loss, create_critics
from deadreckon.agents.scaled_rewards import ScaledRewards
from deadreckon.data.batch import BatchSpec
from deadreckon.nets.mlp import GLOROT, MLP, minimum, q_values
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.policies.candidates import OneStep
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, UnitInterval, static
from deadreckon.training.later_fields import later


class State(NamedTuple):
    """Networks, target critics and optimisers."""

    flow: MLP
    actor: MLP
    critics: MLP  # stacked: leading axis 2
    target_critics: MLP
    flow_opt: optax.OptState
    actor_opt: optax.OptState
    critics_opt: optax.OptState


class FQL(ScaledRewards):
    """Flow Q-learning."""

    revision: ClassVar[int] = 2
    other_names: ClassVar[dict[str, str]] = {"imitation": "alpha"}

    actor_lr: NonNegative = 3e-4  # learning rate of the actor
    behavior_lr: NonNegative = 3e-4  # learning rate of the flow
    critic_lr: NonNegative = 3e-4  # learning rate of the critics
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of the target critics, per update
    alpha: NonNegative = 10.0
    """weight of the distance to the actions of the flow (published: 0.03 to 10 with scale_q; 3 to 30,000 without, by log)"""
    target_q: Literal["mean", "min"] = static("mean")  # value of the critics in the targets: mean or minimum (Adroit: min)
    flow_steps: Count = static(10)  # Euler steps of the flow from noise to actions
    scale_q: bool = static(True)  # whether the actor loss divides Q by its mean absolute value
    hidden: Sizes = static((512, 512, 512, 512))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    standardise: bool = later(False)  # whether observations are standardised to mean 0 and standard deviation 1

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        kf, ka, kc = keys(key, "flow", "actor", "critics")
        inputs = spec.observation_size + spec.action_size
        flow = MLP.create(inputs + 1, self.hidden, spec.action_size, kf, activation="gelu", init=GLOROT)
        actor = MLP.create(inputs, self.hidden, spec.action_size, ka, activation="gelu", init=GLOROT)
        critics = create_critics(spec, self.hidden, 2, kc, activation="gelu", normalise=True, init=GLOROT)
        return State(flow, actor, critics, copy(critics), init_opt(flow), init_opt(actor), init_opt(critics))

    def flow_loss(self, flow: MLP, batch, key) -> Array:
        """Squared error of the field on straight lines from noise to logged actions, at uniform times."""
        k_noise, k_time = keys(key, "noise", "time")
        noise = jax.random.normal(k_noise, batch.action.shape)
        time = jax.random.uniform(k_time, (len(noise), 1))
        there = (1.0 - time) * noise + time * batch.action
        found = flow(jnp.concatenate([batch.observation, there, time], -1))
        return jnp.square(found - (batch.action - noise)).mean()

    def followed(self, flow: MLP, observation: Float[Array, "b o"], noise: Float[Array, "b a"]) -> Float[Array, "b a"]:
        """Where the flow leads from noise, within -1 and 1."""

        def move(i: Array, x: Array) -> Array:
            time = jnp.full((len(x), 1), i / self.flow_steps)
            return x + flow(jnp.concatenate([observation, x, time], -1)) / self.flow_steps

        return jnp.clip(jax.lax.fori_loop(0, self.flow_steps, move, noise), -1.0, 1.0)

    def target(self, state, batch, key) -> Float[Array, "b"]:
        """r + discount mean_j (or min_j) Q'_j(s', a'), a' of the actor."""
        action = OneStep(state.actor).decode(batch.next_observation, jax.random.normal(key, batch.action.shape))
        q = q_values(state.target_critics, batch.next_observation, action)
        return backup(batch, self.discount, q.mean(0) if self.target_q == "mean" else minimum(q))

    def actor_loss(self, actor: MLP, state, batch, key) -> tuple[Array, Array]:
        """alpha |mu(s, z) - flow(s, z)|^2 - mean_j Q_j(s, mu(s, z)) / c, means over rows; also gives the distance."""
        noise = jax.random.normal(key, batch.action.shape)
        made = actor(jnp.concatenate([batch.observation, noise], -1))
        away = jnp.square(made - self.followed(state.flow, batch.observation, noise)).mean()
        q = q_values(state.critics, batch.observation, jnp.clip(made, -1.0, 1.0)).mean(0)
        scale = 1.0 / (jax.lax.stop_gradient(jnp.abs(q).mean()) + 1e-8) if self.scale_q else 1.0
        return self.alpha * away - scale * q.mean(), away

    def update(self, state, batch, *, step, key):
        """Flow, critics, actor, targets."""
        k_flow, k_target, k_actor = keys(key, "flow_loss", "target", "actor_loss")
        flow_loss, grads = jax.value_and_grad(self.flow_loss)(state.flow, batch, k_flow)
        flow, flow_opt = apply_gradients(state.flow, grads, state.flow_opt, self.behavior_lr)
        target = self.target(state, batch, k_target)
        grads, metrics = jax.grad(bellman_loss, has_aux=True)(state.critics, batch, target)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        state = state._replace(flow=flow, flow_opt=flow_opt, critics=critics, critics_opt=critics_opt)
        (loss, away), grads = jax.value_and_grad(self.actor_loss, has_aux=True)(state.actor, state, batch, k_actor)
        actor, actor_opt = apply_gradients(state.actor, grads, state.actor_opt, self.actor_lr)
        targets = polyak_update(state.target_critics, critics, self.tau)
        state = state._replace(actor=actor, actor_opt=actor_opt, target_critics=targets)
        return state, metrics | {"actor_loss": loss, "flow_loss": flow_loss, "distance": away}

    def policy(self, state):
        """The actor, from noise."""
        return OneStep(state.actor)

    def q_value(self, state, observation, action):
        """The mean of the two critics, in the log's units."""
        return self.logged_value(q_values(state.critics, observation, action).mean(0))
