"""ABM (Siegel et al. 2020): the best policy within a divergence of a prior, which imitates what has turned out well in the log.

With V(s) the mean of Q'(s, a_i) over draws a_i of a copy of the policy, and windows of the log that end with the state s_N,

    L_critic = E[ (r + gamma V(s') - Q(s, a))^2 ]                                                            (1)
    L_prior  = -E[ f(R_t - V(s_t)) log pi_prior(a_t|s_t) ],   R_t = r_t + ... + gamma^(N-t) V(s_N),   f = 1_{> 0}   (2)
    pi       = argmax E[ Q(s, a), a of pi ]   with   E[ KL(pi || pi_prior) ] <= epsilon                      (3)

The last in two steps, as in MPO (Abdolmaleki et al. 2018): what solves it has the density pi_prior exp(Q' / eta), with the
temperature eta that minimises eta epsilon + eta E_s[ log E_{a of pi_prior} exp(Q'(s, a) / eta) ]; and the network of the policy
imitates draws of the prior with these weights.
"""

import math
from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.agent import Agent, advantage_in_windows, backup, create_critics, imitation_loss, rows_of_windows
from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.nets.optim import apply_gradients, clip_by_norm, copy, init_opt, renewed
from deadreckon.policies.kinds import Likelihood, create_imitator, stochastic
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Positive, Sizes, UnitInterval, static
from deadreckon.training.later_fields import later

LEAST = -10.0  # log of the smallest temperature: values that differ by less than rounding have no order


class State(NamedTuple):
    """Networks, targets, the temperature's logarithm and optimisers."""

    actor: Any  # of a stochastic policy
    prior: Any
    critic: MLP  # stacked: leading axis 1
    target_actor: Any
    target_critic: MLP
    log_eta: Array
    opts: tuple[optax.OptState, ...]  # of actor, prior, critic and temperature


class ABM(Agent):
    """A policy near an advantage-weighted behaviour model."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"kl": "epsilon", "trajectory_length": "window", "draws": "samples"}

    actor_lr: NonNegative = 1e-4  # learning rate of the policy
    prior_lr: NonNegative = 1e-4  # learning rate of the prior
    critic_lr: NonNegative = 1e-4  # learning rate of the critic
    eta_lr: NonNegative = 1e-2  # learning rate of the temperature
    discount: UnitInterval = 0.99  # discount factor per step
    epsilon: Positive = 0.1  # mean KL divergence of the improved policy from the prior, in nats
    eta: Positive = 1.0  # first temperature that divides the values
    prior: Literal["advantage", "all"] = static("advantage")
    """logged actions that the prior imitates: those with better outcomes than the policy (ABM), or all (BM in the paper)"""
    window: Count = static(8)  # consecutive transitions after which the value stands for the rest of the return
    samples: Count = static(20)  # draws of the policy for a value, and of the prior for an improvement
    target_update_period: Count = static(100)  # updates between copies of the networks to their targets
    max_grad_norm: Positive = 40.0  # norm above which the gradients of a network are clipped
    likelihood: Likelihood = static("normal")
    """likelihood of actions: normal around tanh of a network, or tanh-normal"""
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update), in windows of the length above
    standardise: bool = later(False)  # whether observations are standardised to mean 0 and standard deviation 1

    def resolve(self, spec, steps):
        """See `Agent.resolve`; weights of so many draws must be able to diverge by epsilon."""
        agent = super().resolve(spec, steps)
        most = math.log(self.samples)  # where one draw has all the weight
        if not self.epsilon < most:
            raise UserError(
                f"{type(self).__name__}: epsilon must be below log(samples), the largest divergence of {self.samples} draws, "
                f"{most:.3g}, got {self.epsilon:g}"
            )
        return agent

    def needs(self, spec):
        """Windows of transitions."""
        size = max(self.batch_size // self.window, 1)
        return BatchSpec((*BatchSpec.columns, "time"), size, window=self.window, standardise=self.standardise)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        ka, kp, kc = keys(key, "actor", "prior", "critic")
        actor, prior = (create_imitator(spec, self.hidden, k, self.likelihood) for k in (ka, kp))
        critic = create_critics(spec, self.hidden, 1, kc)
        log_eta = jnp.log(jnp.asarray(self.eta, jnp.float32))
        opts = tuple(init_opt(each) for each in (actor, prior, critic, log_eta))
        return State(actor, prior, critic, copy(actor), copy(critic), log_eta, opts)

    def values(self, state: State, batch: Batch, key: PRNGKeyArray) -> tuple[Float[Array, "b w"], Float[Array, "b w"]]:
        """V(s) and V(s') of the target networks: of a state between two rows one number, so that sums over rows telescope."""
        seen = jnp.concatenate([batch.observation[:, :1], batch.next_observation], 1)
        found = self.value(state, seen, key)
        return found[:, :-1], found[:, 1:]

    def value(self, state: State, observation: Float[Array, "b w o"], key: PRNGKeyArray) -> Float[Array, "b w"]:
        """V(s) of the target networks."""
        flat = observation.reshape(-1, observation.shape[-1])
        drawn = stochastic(state.target_actor).actions(flat, key, greedy=False, count=(self.samples,))
        return q_values(state.target_critic, flat, drawn)[0].mean(0).reshape(observation.shape[:2])

    def target(self, batch: Batch, following: Float[Array, "b w"]) -> Float[Array, "b w"]:
        """r + gamma V(s')."""
        return backup(batch, self.discount, following)

    def advantage(self, batch: Batch, now: Float[Array, "b w"], following: Float[Array, "b w"]) -> Float[Array, "b w"]:
        """R_t - V(s_t), to the end of the window or of the episode."""
        return advantage_in_windows(batch, self.target(batch, following) - now, self.discount)

    def critic_loss(self, critic: MLP, batch: Batch, target: Float[Array, "b w"], rows: Float[Array, "b w"]):
        """Squared error of the rows that are there (`rows`, of mean one)."""
        q = q_values(critic, batch.observation, batch.action)[0]
        loss = (rows * jnp.square(q - jax.lax.stop_gradient(target))).mean()
        return loss, {"critic_loss": loss, "q": (rows * q).mean()}

    def eta_loss(self, log_eta: Array, values: Float[Array, "m n"], rows: Float[Array, "n"]) -> Float[Array, ""]:
        """The dual of (3), of draws of the prior."""
        eta = jnp.exp(log_eta)
        free = jax.nn.logsumexp(values / eta, axis=0) - jnp.log(len(values))
        return eta * (self.epsilon + (rows * free).mean())

    def actor_loss(
        self, actor: Any, observation: Float[Array, "n o"], drawn: Float[Array, "m n a"], weight: Float[Array, "m n"]
    ) -> Float[Array, ""]:
        """-E[ sum_i w_i log pi(a_i|s) ] of draws of the prior, whose weights sum to one for each state."""
        log_prob = stochastic(actor).log_likelihood(observation, drawn)
        return -(jax.lax.stop_gradient(weight) * log_prob).sum(0).mean()

    def update(self, state, batch, *, step, key):
        """Critic, prior, temperature, policy, and at the end of every period the targets."""
        k_value, k_prior = keys(key, "value", "prior")
        rows = rows_of_windows(batch, self.window)
        now, following = self.values(state, batch, k_value)
        target = self.target(batch, following)
        slopes, metrics = jax.grad(self.critic_loss, has_aux=True)(state.critic, batch, target, rows)
        good = self.advantage(batch, now, following) > 0 if self.prior == "advantage" else jnp.ones_like(rows)
        prior_loss, prior_slopes = jax.value_and_grad(imitation_loss)(state.prior, batch, rows * good)

        seen, flat_rows = batch.observation.reshape(-1, batch.observation.shape[-1]), rows.reshape(-1)
        drawn = stochastic(state.prior).actions(seen, k_prior, greedy=False, count=(self.samples,))
        values = q_values(state.target_critic, seen, drawn)[0]
        eta_slope = jax.grad(self.eta_loss)(state.log_eta, values, flat_rows)
        weight = jax.nn.softmax(values / jnp.exp(state.log_eta), axis=0) * flat_rows
        actor_loss, actor_slopes = jax.value_and_grad(self.actor_loss)(state.actor, seen, drawn, weight)

        steps = (
            (state.actor, actor_slopes, self.actor_lr), (state.prior, prior_slopes, self.prior_lr),
            (state.critic, slopes, self.critic_lr), (state.log_eta, eta_slope, self.eta_lr),
        )  # fmt: skip
        made = [
            apply_gradients(net, clip_by_norm(slope, self.max_grad_norm), opt, lr)
            for (net, slope, lr), opt in zip(steps, state.opts, strict=True)
        ]
        (actor, prior, critic, log_eta), opts = zip(*made)
        log_eta = jnp.maximum(log_eta, LEAST)
        before = state.target_actor, state.target_critic
        target_actor, target_critic = renewed(before, (actor, critic), step, self.target_update_period)
        more = {"actor_loss": actor_loss, "prior_loss": prior_loss, "eta": jnp.exp(log_eta), "imitated": (rows * good).mean()}
        return State(actor, prior, critic, target_actor, target_critic, log_eta, opts), metrics | more

    def policy(self, state):
        """The actor; greedy is its mean."""
        return stochastic(state.actor)

    def q_value(self, state, observation, action):
        """The critic."""
        return q_values(state.critic, observation, action)[0]
