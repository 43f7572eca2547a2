"""BRAC (Wu et al. 2019; thesis 7.4): an actor-critic that pays for being away from a model of the log's policy.

The model is fitted first and stays. With D an estimate of a divergence at each state, targets are

    y = r + discount (min_j Q'_j(s', a') - [value form] penalty D(s')),   a' from the actor,

and the actor minimises E[ penalty D(s) - min_j Q_j(s, a) ], in the warm start without Q.
"""

from typing import ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent, backup, bellman_loss, create_critics
from deadreckon.agents.bc import cloned
from deadreckon.data.batch import BatchSpec
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import FIRST_WEIGHTS, MLP, FirstWeights, minimum, q_values
from deadreckon.nets.mmd import mmd
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.policies.kinds import TanhGaussian
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, Positive, Sizes, UnitInterval, static
from deadreckon.training.later_fields import later

WARM_STEPS, WARM_SHARE = 20_000, 0.2  # of the run, whichever is smaller (the D4RL version: 20,000 of 1,000,000)


class State(NamedTuple):
    """Networks, target critics, the fitted behaviour model and optimisers."""

    actor: MLP
    critics: MLP  # stacked: leading axis 2
    target_critics: MLP
    behavior: MLP
    actor_opt: optax.OptState
    critics_opt: optax.OptState


class BRAC(Agent):
    """Behaviour-regularised actor-critic; the value form is BRAC-v, the other BRAC-p."""

    revision: ClassVar[int] = 2
    by_length: ClassVar[tuple[str, ...]] = ("warm_start",)
    other_names: ClassVar[dict[str, str]] = {"value_form": "value_penalty", "draws": "samples"}

    actor_lr: NonNegative = 3e-5  # learning rate of the actor (D4RL version)
    critic_lr: NonNegative = 1e-3  # learning rate of the critics (D4RL version)
    behavior_lr: NonNegative = 5e-4  # learning rate of the behaviour model (D4RL version)
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of the target critics, per update
    penalty: NonNegative = 1.0  # weight of the divergence (alpha in the paper); the best one depends on the task
    bandwidth: Positive = 20.0  # bandwidth of the kernel, with divergence="mmd"
    value_penalty: bool = static(True)  # whether the targets are penalised too (BRAC-v), or the actor alone (BRAC-p)
    divergence: Literal["kl", "mmd"] = static("kl")  # divergence from the behaviour model that is penalised
    samples: Count = static(10)  # actions sampled from each policy to estimate the MMD
    behavior_steps: Count = static(100_000)  # updates of the behaviour model before all others
    warm_start: CountOrZero | None = static(None)
    """updates in which the actor minimises the divergence alone; None: min(20,000, 20 % of the run)"""
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    standardise: bool = later(False)  # whether observations are standardised to mean 0 and standard deviation 1
    first_weights: FirstWeights = later("uniform")  # initial weights: "uniform", "glorot" (authors), "orthogonal" or "rlkit"

    def resolve(self, spec, steps):
        """Fills in the warm start."""
        agent = super().resolve(spec, steps)
        return agent if self.warm_start is not None else agent.replace(warm_start=min(WARM_STEPS, int(WARM_SHARE * steps)))

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        ka, kc, kb = keys(key, "actor", "critics", "behavior")
        first, first_q = FIRST_WEIGHTS[self.first_weights]
        make = lambda k: MLP.create(spec.observation_size, self.hidden, 2 * spec.action_size, k, init=first)  # noqa: E731
        actor, critics, behavior = make(ka), create_critics(spec, self.hidden, 2, kc, init=first_q), make(kb)
        return State(actor, critics, copy(critics), behavior, init_opt(actor), init_opt(critics))

    def prepare(self, state, rows, key, fit):
        """Fits the behaviour model, by maximum likelihood; the actor begins as it."""
        behavior = cloned(self, fit, key)
        return state._replace(behavior=behavior, actor=copy(behavior))

    def away(self, d: dist.Gaussian, behavior: MLP, observation, key) -> Float[Array, "b"]:
        """How far the policy is from the behaviour model at every state."""
        model = dist.gaussian_head(behavior(observation))
        if self.divergence == "kl":
            return dist.kl(d, model)
        k_own, k_model = keys(key, "policy", "behavior")
        own, other = (jnp.tanh(dist.sample(each, k, (self.samples,))) for each, k in ((d, k_own), (model, k_model)))
        return mmd(own, other, "laplacian", self.bandwidth)

    def target(self, state, batch, key) -> Float[Array, "b"]:
        """r + discount (min_j Q'_j(s', a') - penalty D(s')), without D in BRAC-p (eq. 6)."""
        k_act, k_away = keys(key, "act", "divergence")
        d = dist.gaussian_head(state.actor(batch.next_observation))
        future = minimum(q_values(state.target_critics, batch.next_observation, jnp.tanh(dist.sample(d, k_act))))
        if self.value_penalty:
            future = future - self.penalty * self.away(d, state.behavior, batch.next_observation, k_away)
        return backup(batch, self.discount, future)

    def actor_loss(self, actor: MLP, state, batch, step, key):
        """E[ penalty D(s) - min_j Q_j(s, a) ], a reparameterised, in the warm start without Q; and the mean of D (eq. 7)."""
        k_act, k_away = keys(key, "act", "divergence")
        d = dist.gaussian_head(actor(batch.observation))
        q = minimum(q_values(state.critics, batch.observation, jnp.tanh(dist.sample(d, k_act))))
        away = self.away(d, state.behavior, batch.observation, k_away)
        return (self.penalty * away - jnp.where(step < self.warm_start, 0.0, q)).mean(), away.mean()

    def update(self, state, batch, *, step, key):
        """Critics, actor, targets."""
        k_target, k_actor = keys(key, "target", "actor_loss")
        target = self.target(state, batch, k_target)
        grads, metrics = jax.grad(bellman_loss, has_aux=True)(state.critics, batch, target)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        state = state._replace(critics=critics, critics_opt=critics_opt)
        (loss, away), grads = jax.value_and_grad(self.actor_loss, has_aux=True)(state.actor, state, batch, step, k_actor)
        actor, actor_opt = apply_gradients(state.actor, grads, state.actor_opt, self.actor_lr)
        targets = polyak_update(state.target_critics, critics, self.tau)
        state = state._replace(actor=actor, actor_opt=actor_opt, target_critics=targets)
        return state, metrics | {"actor_loss": loss, "divergence": away}

    def policy(self, state):
        """The actor; greedy is its mean."""
        return TanhGaussian(state.actor)

    def q_value(self, state, observation, action):
        """The smaller of the two critics; in the value form it includes later penalties."""
        return minimum(q_values(state.critics, observation, action))
