"""AWAC (Nair et al. 2020): critics of the present policy, and imitation weighted by how much better than it an action is."""

from typing import Any, ClassVar, NamedTuple

import jax
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.agent import backup, bellman_loss, capped_exp, create_critics, imitation_loss
from deadreckon.agents.scaled_rewards import ScaledRewards
from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.nets.mlp import MLP, minimum, q_values
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.policies.kinds import Categorical, Likelihood, TanhMeanGaussian, create_imitator, stochastic
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Positive, Sizes, UnitInterval, static


class State(NamedTuple):
    """Networks, target critics and optimisers."""

    actor: MLP | Categorical | TanhMeanGaussian
    critics: MLP  # stacked: leading axis 2
    target_critics: MLP
    actor_opt: optax.OptState
    critics_opt: optax.OptState


class AWAC(ScaledRewards):
    """Twin critics, and imitation weighted by exp(advantage / temperature)."""

    revision: ClassVar[int] = 2
    fine_tunes: ClassVar[bool] = True
    other_names: ClassVar[dict[str, str]] = {"draws": "samples", "lambda": "temperature"}

    actor_lr: NonNegative = 3e-4  # learning rate of the actor
    critic_lr: NonNegative = 3e-4  # learning rate of the critics
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of the target critics, per update
    temperature: Positive = 1.0 / 3.0  # temperature that divides the advantage (lambda; public code: 1/3 or 0.1, by domain)
    max_weight: Positive = 100.0  # largest weight of a transition in the loss of the actor
    samples: Count = static(1)  # actions sampled from the policy to estimate its value
    likelihood: Likelihood = static("normal")
    """likelihood of logged actions: normal around tanh of a network, or tanh-normal"""
    hidden: Sizes = static((256, 256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    standardise: bool = static(True)  # whether observations are standardised to mean 0 and standard deviation 1

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    def init(self, spec, key) -> Any:
        """Fresh networks; targets are copies."""
        ka, kc = keys(key, "actor", "critics")
        actor = create_imitator(spec, self.hidden, ka, self.likelihood)
        critics = create_critics(spec, self.hidden, 2, kc)
        return State(actor, critics, copy(critics), init_opt(actor), init_opt(critics))

    def target(self, state, batch: Batch, key: PRNGKeyArray) -> Array:
        """r + discount min_j Q'_j(s', a'), a' from the present actor."""
        action = stochastic(state.actor).actions(batch.next_observation, key, greedy=False)
        return backup(batch, self.discount, minimum(q_values(state.target_critics, batch.next_observation, action)))

    def advantage(self, state, batch: Batch, key: PRNGKeyArray) -> Float[Array, "b"]:
        """min_j Q_j(s, a) less the mean of min_j Q_j(s, a_i) over actions of the actor."""
        drawn = stochastic(state.actor).actions(batch.observation, key, greedy=False, count=(self.samples,))
        own = minimum(q_values(state.critics, batch.observation, drawn)).mean(0)
        return minimum(q_values(state.critics, batch.observation, batch.action)) - own

    def weights(self, advantage: Float[Array, "b"]) -> Float[Array, "b"]:
        """exp(advantage / temperature), cut above; the authors' code takes a softmax over the batch instead."""
        return capped_exp(advantage / self.temperature, self.max_weight)

    def update(self, state, batch, *, step, key):
        """Critics, actor, targets."""
        k_target, k_actor = keys(key, "target", "actor_loss")
        target = self.target(state, batch, k_target)
        grads, metrics = jax.grad(bellman_loss, has_aux=True)(state.critics, batch, target)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        state = state._replace(critics=critics, critics_opt=critics_opt)
        weight = self.weights(self.advantage(state, batch, k_actor))
        loss, grads = jax.value_and_grad(imitation_loss)(state.actor, batch, weight)
        actor, actor_opt = apply_gradients(state.actor, grads, state.actor_opt, self.actor_lr)
        targets = polyak_update(state.target_critics, critics, self.tau)
        state = state._replace(actor=actor, actor_opt=actor_opt, target_critics=targets)
        return state, metrics | {"actor_loss": loss, "weight": weight.mean()}

    def policy(self, state):
        """The actor; greedy is its mean."""
        return stochastic(state.actor)

    def q_value(self, state, observation, action):
        """The smaller of the two critics, in the log's units."""
        return self.logged_value(minimum(q_values(state.critics, observation, action)))
