"""Importance-sampled BEAR (thesis A.3, Algorithm 5): a set policy bounds the actions, the actor is weighted within it."""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array

from deadreckon.agents import bear
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, minimum, q_values
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.nets.vae import VAE
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, Fraction, NonNegative, static


class State(NamedTuple):
    """As BEAR's, with the set-determining policy."""

    actor: MLP
    set_policy: MLP
    critics: MLP
    behavior: MLP | VAE
    log_multiplier: Array
    target_actor: MLP
    target_critics: MLP
    opts: dict[str, optax.OptState]


class ISBEAR(bear.BEAR):
    """BEAR with two policies: `set_policy` stays in support where critics agree, `actor` is the best within its reach.

    Line 8 of the algorithm prints no Q term and leaves delta undeclared: delta is a field, the set policy minimises the
    critics' disagreement, sqrt((1 - delta) / delta var_k E_a Q_k), under the MMD constraint. Targets are a MEAN over
    samples (line 5). Line 9 takes the advantage instead of Q, see `weighted_loss`. Base "td3" only; the constraint is always
    on the set policy, and `actor_samples` has no part.
    """

    revision: ClassVar[int] = 1

    delta: Fraction = 0.5  # confidence of the bound on the disagreement of the critics; undeclared in the thesis
    ratio_min: NonNegative = 0.5  # lower clip of the importance ratio (beta_1); undeclared in the thesis
    ratio_max: NonNegative = 2.0  # upper clip of the importance ratio (beta_2); undeclared in the thesis
    policy_samples: Count = static(10)  # actions of the set policy (m); n << m, line 7
    target_samples: Count = static(10)  # actions sampled from the target actor (p), of which the mean value is the target

    def resolve(self, spec, steps):
        """As BEAR's; the algorithm has no entropy, and importance ratios need a range."""
        if self.base != "td3":
            raise UserError(f"ISBEAR.base takes 'td3' only, got {self.base!r}")
        if self.actor_samples != 1:
            raise UserError(f"ISBEAR has no use for actor_samples; leave it out, got {self.actor_samples}")
        agent = super().resolve(spec, steps)
        if not self.ratio_min < self.ratio_max:
            raise UserError(f"ISBEAR: ratio_min must be below ratio_max, got {self.ratio_min:g} and {self.ratio_max:g}")
        return agent

    def init(self, spec, key):
        """Fresh networks; the set policy starts as the actor."""
        first = super().init(spec, key)
        opts = {name: opt for name, opt in first.opts.items() if name != "temperature"}
        set_policy = copy(first.actor)
        return State(
            first.actor, set_policy, first.critics, first.behavior, first.log_multiplier, first.target_actor,
            first.target_critics, opts | {"set_policy": init_opt(set_policy)},
        )  # fmt: skip

    def future(self, state, batch, key):
        """The mean mixed value over p actions of the target actor (line 5)."""
        d = dist.gaussian_head(state.target_actor(batch.next_observation))
        action = jnp.tanh(dist.sample(d, key, (self.target_samples,)))
        return self.mix(q_values(state.target_critics, batch.next_observation, action)).mean(0)

    def set_loss(self, set_policy, state, batch, step, key):
        """sqrt((1 - delta) / delta var_k E_a Q_k(s, a)) + alpha MMD (line 8); at first the MMD alone."""
        k_policy, k_behavior, k_copies = keys(key, "policy", "behavior", "copies")
        d = dist.gaussian_head(set_policy(batch.observation))
        pre = dist.sample(d, k_policy, (self.policy_samples,))
        divergence = self.constrained(self.divergence(d, pre, state, batch, k_behavior, k_copies))
        q = q_values(state.critics, batch.observation, jnp.tanh(pre)).mean(1)
        spread = jnp.sqrt((1.0 - self.delta) / self.delta * q.var(0) + 1e-6).mean()
        return self.lagrangian(spread, divergence, state, step), (divergence, spread)

    def weighted_loss(self, actor, state, batch, step, key):
        """-E_{a ~ set}[clip(pi(a|s) / pi_set(a|s)) A(s, a)] (line 9); at first it imitates the set policy.

        A is Q less its mean over the set policy's samples. The line has Q itself, whose level would matter: with clipped
        ratios a large positive Q pushes every ratio up to the clip, whatever the action.
        """
        proposal = dist.gaussian_head(state.set_policy(batch.observation))
        pre = jax.lax.stop_gradient(dist.sample(proposal, key, (self.policy_samples,)))
        log_prob = dist.log_prob(dist.gaussian_head(actor(batch.observation)), pre)
        ratio = jnp.exp(log_prob - jax.lax.stop_gradient(dist.log_prob(proposal, pre)))
        q = q_values(state.critics, batch.observation, jnp.tanh(pre))
        q = minimum(q) if self.actor_value == "min" else q.mean(0)
        gain = (jnp.clip(ratio, self.ratio_min, self.ratio_max) * (q - q.mean(0))).mean()
        return jnp.where(step < self.warm_start, -log_prob.mean(), -gain)

    def update(self, state, batch, *, step, key):
        """Behaviour model, critics, set policy and multiplier, actor, targets (Algorithm 5)."""
        k_model, k_future, k_set, k_actor = keys(key, "behavior", "target", "set_loss", "actor_loss")
        state, metrics = self.learn_values(state, batch, k_model, k_future)
        opts = dict(state.opts)

        grads, (divergence, spread) = jax.grad(self.set_loss, has_aux=True)(state.set_policy, state, batch, step, k_set)
        set_policy, opts["set_policy"] = apply_gradients(state.set_policy, grads, opts["set_policy"], self.actor_lr)
        log_multiplier, opts["multiplier"] = self.dual_step(state, divergence, step)
        state = state._replace(set_policy=set_policy)
        loss, grads = jax.value_and_grad(self.weighted_loss)(state.actor, state, batch, step, k_actor)
        actor, opts["actor"] = apply_gradients(state.actor, grads, opts["actor"], self.actor_lr)

        targets = polyak_update((state.target_actor, state.target_critics), (actor, state.critics), self.tau)
        metrics |= {
            "actor_loss": loss, "critic_spread": spread, self.constraint: divergence,
            "multiplier": jnp.exp(log_multiplier),
        }  # fmt: skip
        state = state._replace(
            actor=actor, log_multiplier=log_multiplier, target_actor=targets[0], target_critics=targets[1], opts=opts
        )
        return state, metrics
