"""IQL (Kostrikov et al. 2022): values of the log's own actions by expectile regression, and imitation weighted by advantage.

No action outside of the log is ever valued: V(s) is an upper expectile of Q(s, a) over the actions that the log has in s, and
what critics look forward to is V(s').
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array

from deadreckon.agents.agent import backup, bellman_loss, capped_exp, create_critics, imitation_loss
from deadreckon.agents.scaled_rewards import ScaledRewards
from deadreckon.data.batch import BatchSpec
from deadreckon.nets.mlp import MLP, ORTHOGONAL, minimum, q_values
from deadreckon.nets.optim import apply_gradients, copy, cosine_decay, init_opt, polyak_update
from deadreckon.policies.kinds import Categorical, Likelihood, TanhMeanGaussian, create_imitator, stochastic
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, Fraction, NonNegative, Positive, Sizes, UnitInterval, static


class State(NamedTuple):
    """Networks, target critics and optimisers."""

    actor: MLP | Categorical | TanhMeanGaussian
    value: MLP
    critics: MLP  # stacked: leading axis 2
    target_critics: MLP
    actor_opt: optax.OptState
    value_opt: optax.OptState
    critics_opt: optax.OptState


class IQL(ScaledRewards):
    """Expectile values and weighted imitation."""

    revision: ClassVar[int] = 3
    supports_discrete: ClassVar[bool] = True
    fine_tunes: ClassVar[bool] = True
    supports_images: ClassVar[bool] = True
    by_length: ClassVar[tuple[str, ...]] = ("actor_decay_steps",)
    other_names: ClassVar[dict[str, str]] = {"sharpness": "beta"}

    actor_lr: NonNegative = 3e-4  # learning rate of the actor
    actor_decay_steps: NonNegative | None = None
    """updates over which the learning rate of the actor falls to 0 along a cosine; None: the whole run, 0: it stays"""
    critic_lr: NonNegative = 3e-4  # learning rate of critics and values
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of the target critics, per update
    expectile: Fraction = 0.7  # expectile of the values: 0.5 is the mean over logged actions, 1 the maximum (AntMaze: 0.9)
    beta: NonNegative = 3.0
    """inverse temperature of the advantage weights: 0 is imitation (AntMaze: 10)"""
    max_weight: Positive = 100.0  # largest weight of a transition in the loss of the actor
    likelihood: Likelihood = static("normal")
    """likelihood of logged actions: normal around tanh of a network, as in public code, or tanh-normal"""
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    layer_norm: bool = static(False)  # whether the value network uses layer normalisation (XQL's public code)
    standardise: bool = static(False)  # whether flat observations are standardised to mean 0 and standard deviation 1

    def resolve(self, spec, steps):
        """Fills in how long the actor's learning rate falls."""
        agent = super().resolve(spec, steps)
        return agent if self.actor_decay_steps is not None else agent.replace(actor_decay_steps=float(steps))

    def going_on(self):
        """See `Agent`; the actor's learning rate, which fell to 0 over the run on the log, is constant."""
        return self.replace(actor_decay_steps=0.0)

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        ka, kv, kc = keys(key, "actor", "value", "critics")
        actor = create_imitator(spec, self.hidden, ka, self.likelihood, init=ORTHOGONAL)
        value = MLP.create(spec.observation_size, self.hidden, 1, kv, normalise=self.layer_norm, init=ORTHOGONAL)
        critics = create_critics(spec, self.hidden, 2, kc, init=ORTHOGONAL)
        return State(actor, value, critics, copy(critics), init_opt(actor), init_opt(value), init_opt(critics))

    def value_loss(self, value: MLP, batch, q: Array) -> Array:
        """E[ |tau - 1(q < V)| (q - V)^2 ], q the smaller target critic of the logged action (eq. 5)."""
        gap = q - value(batch.observation)[..., 0]
        return (jnp.where(gap < 0, 1.0 - self.expectile, self.expectile) * jnp.square(gap)).mean()

    def actor_loss(self, actor: MLP | Categorical | TanhMeanGaussian, batch, advantage: Array) -> Array:
        """-E[ exp(beta (q - V)) log pi(a|s) ], weights cut above (eq. 7)."""
        return imitation_loss(actor, batch, capped_exp(self.beta * advantage, self.max_weight))

    def update(self, state, batch, *, step, key):
        """Values, actor, critics, targets, each by what those before it have become."""
        q = minimum(q_values(state.target_critics, batch.observation, batch.action))
        value_loss, grads = jax.value_and_grad(self.value_loss)(state.value, batch, q)
        value, value_opt = apply_gradients(state.value, grads, state.value_opt, self.critic_lr)

        advantage = q - value(batch.observation)[..., 0]
        actor_loss, grads = jax.value_and_grad(self.actor_loss)(state.actor, batch, advantage)
        actor_lr = cosine_decay(self.actor_lr, step, self.actor_decay_steps)
        actor, actor_opt = apply_gradients(state.actor, grads, state.actor_opt, actor_lr)

        target = backup(batch, self.discount, value(batch.next_observation)[..., 0])  # eq. 6
        grads, metrics = jax.grad(bellman_loss, has_aux=True)(state.critics, batch, target)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        targets = polyak_update(state.target_critics, critics, self.tau)
        state = State(actor, value, critics, targets, actor_opt, value_opt, critics_opt)
        return state, metrics | {"actor_loss": actor_loss, "value_loss": value_loss, "advantage": advantage.mean()}

    def representation_loss(self, state, batch, *, step, key):
        """That of the critics."""
        target = backup(batch, self.discount, state.value(batch.next_observation)[..., 0])
        return bellman_loss(state.critics, batch, target)[0]

    def policy(self, state):
        """The actor; its greedy action is the mean, or the most probable one."""
        return stochastic(state.actor)

    def q_value(self, state, observation, action):
        """The smaller of the two critics, in the log's units."""
        return self.logged_value(minimum(q_values(state.critics, observation, action)))
