"""CQL (Kumar et al. 2020): SAC whose critics are held down on actions that the log does not show.

To the squared errors of each critic j comes, in the form H,

    cql_weight ( E_s[ log sum_a exp Q_j(s, a) ] - E_log[ Q_j(s, a) ] ),

the sum estimated from `samples` actions each: uniform, of the policy at s, and of the policy at s', each divided by its
density. In the form rho the first term is the mean of Q_j over actions of the present policy, weighted by exp Q_j. With
`lagrange` the weight is a multiplier that rises where the difference is above `threshold`.
"""

from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import backup, create_critics, imitation_loss
from deadreckon.agents.sac import SAC
from deadreckon.agents.scaled_rewards import ScaledRewards
from deadreckon.data.batch import Batch
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, all_q_values, q_values
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.policies.kinds import Categorical
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, Number, Sizes, static
from deadreckon.training.later_fields import later


class CQLState(NamedTuple):
    """The log of the penalty's weight, and whether the actor imitates still: `model` of SAC's state."""

    log_weight: Array
    weight_opt: optax.OptState
    imitates: Array


class CQL(ScaledRewards, SAC):
    """SAC with conservative critics."""

    revision: ClassVar[int] = 1
    online: ClassVar[bool] = False
    supports_discrete: ClassVar[bool] = True
    supports_images: ClassVar[bool] = True
    other_names: ClassVar[dict[str, str]] = {
        "conservatism": "cql_weight", "min_q_weight": "cql_weight", "draws": "samples", "weight_lr": "cql_weight_lr",
    }  # fmt: skip
    told_after: ClassVar[dict[str, str]] = {"standardise": "warm_start"}

    actor_lr: NonNegative = 1e-4  # learning rate of the actor
    temperature_lr: NonNegative = 1e-4  # learning rate of the logarithm of the temperature (public codes: the actor's)
    entropy_backup: bool = static(False)  # whether the critics' targets include the entropy bonus
    hidden: Sizes = static((256, 256, 256))  # width of each hidden layer
    form: Literal["H", "rho"] = static("H")
    """form of the penalty: CQL(H), log-sum-exp over actions, or CQL(rho), weighted actions of the policy"""
    cql_weight: NonNegative = 5.0  # weight of the conservative penalty (alpha in the paper); initial weight with lagrange
    samples: Count = static(10)  # actions sampled from each distribution to estimate the log-sum-exp
    max_target_backup: bool = static(False)
    """whether targets take the best of as many actions of the policy as above (public code on AntMaze), and not one"""
    min_gap: Number = -1e9
    """lower limit of log-sum-exp minus Q of each transition in the penalty, below which its gradient is 0 (AntMaze: -200)"""
    lagrange: bool = static(False)  # whether the weight of the penalty is a Lagrange multiplier
    threshold: NonNegative = 10.0  # value that the penalty is held to, with lagrange
    cql_weight_lr: NonNegative = 3e-4  # learning rate of the multiplier, with lagrange
    warm_start: CountOrZero = static(0)  # updates in which the actor imitates the log at first (public code: 40,000)
    standardise: bool = static(False)  # whether flat observations are standardised to mean 0 and standard deviation 1
    critic_hidden: Sizes | None = later(None)  # width of each hidden layer of the critics; None: as the actor's

    def resolve(self, spec, steps):
        """Refuses to draw actions for targets where the values of all are known."""
        agent = super().resolve(spec, steps)
        if spec.discrete and self.max_target_backup:
            why = "takes the best of sampled actions, and targets of discrete ones are means over all actions"
            raise UserError(f"{type(self).__name__}.max_target_backup {why}; leave it out")
        return agent

    def going_on(self):
        """See `Agent`; the actor does not imitate again at first."""
        return self.replace(warm_start=0)

    def init(self, spec, key) -> Any:
        """SAC's state and the multiplier."""
        log_weight = jnp.log(jnp.maximum(jnp.asarray(self.cql_weight), 1e-6))
        held = CQLState(log_weight, init_opt(log_weight), jnp.asarray(self.warm_start > 0))
        return super().init(spec, key)._replace(model=held)

    def first_critics(self, spec, key):
        """Fresh Q-networks."""
        hidden = self.hidden if self.critic_hidden is None else self.critic_hidden
        return create_critics(spec, hidden, self.critics, key, init=self.critic_init)

    def target(self, state, batch, key):
        """SAC's, or r + discount max_i (min_j Q'_j(s', a_i) + bonus), a_i of the policy."""
        if not self.max_target_backup:
            return super().target(state, batch, key)
        noise = jax.random.normal(key, (self.samples, *batch.action.shape))
        return backup(batch, self.discount, self.value(state, batch.next_observation, noise).max(0))

    def q_value(self, state, observation, action):
        """Minimum over the critics, in the log's units; includes the entropy bonus of later steps where targets do."""
        return self.logged_value(super().q_value(state, observation, action))

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors, and the penalty."""
        loss, metrics = super().critic_loss(critics, state, batch, target, key)
        high = self.held_down(critics, state, batch, key)
        gap = jnp.maximum(high - q_values(critics, batch.observation, batch.action), self.min_gap).mean(-1)
        weight = jax.lax.stop_gradient(jnp.exp(state.model.log_weight)) if self.lagrange else self.cql_weight
        return loss + weight * gap.sum(), metrics | {"gap": gap.mean()}

    def held_down(self, critics, state, batch, key) -> Float[Array, "k b"]:
        """The values that the penalty lowers."""
        measure = soft_maximum if self.form == "H" else weighted_mean
        return measure(critics, state.actor, batch, self.samples, key)

    def actor_loss(self, actor, state, batch, key):
        """SAC's; during the warm start the entropy bonus and the likelihood of the logged actions."""
        loss, log_prob = super().actor_loss(actor, state, batch, key)
        if not self.warm_start:
            return loss, log_prob
        clone = jnp.exp(state.log_temperature) * log_prob + imitation_loss(actor, batch, jnp.ones(len(batch.reward)))
        return jnp.where(state.model.imitates, clone, loss), log_prob

    def update(self, state, batch, *, step, key):
        """SAC's update, and that of the multiplier if there is one."""
        held = state.model._replace(imitates=step < self.warm_start)
        state, metrics = super().update(state._replace(model=held), batch, step=step, key=key)
        if not self.lagrange:
            return state, metrics
        slope = self.threshold - metrics["gap"]  # d/dlog w of -w (gap - threshold), without the factor w > 0
        log_weight, opt = apply_gradients(held.log_weight, slope, held.weight_opt, self.cql_weight_lr)
        log_weight = jnp.minimum(log_weight, jnp.log(1e6))
        held = held._replace(log_weight=log_weight, weight_opt=opt)
        return state._replace(model=held), metrics | {"weight": jnp.exp(log_weight)}


def soft_maximum(
    critics: MLP, actor: MLP | Categorical, batch: Batch, draws: int, key: Array, floor: Float[Array, "b"] | None = None
) -> Float[Array, "k b"]:
    """Estimates log of the integral of exp Q(s, .) over all actions, up to a constant of the number of draws.

    Of discrete actions it is the sum itself, and nothing is drawn. Where there is a `floor`, values of the policy's actions are
    at least that.
    """
    if isinstance(actor, Categorical):
        return jax.nn.logsumexp(all_q_values(critics, batch.observation), axis=-1)
    k_uniform, k_now, k_next = keys(key, "uniform", "now", "next")
    rows, size = batch.action.shape
    uniform = jax.random.uniform(k_uniform, (draws, rows, size), minval=-1.0, maxval=1.0)
    parts = [q_values(critics, batch.observation, uniform) + size * jnp.log(2.0)]
    for k, seen in ((k_now, batch.observation), (k_next, batch.next_observation)):
        d = dist.gaussian_head(jax.lax.stop_gradient(actor(seen)))  # an encoder of pictures learns by values alone
        pre = dist.sample(d, k, (draws,))
        q = q_values(critics, batch.observation, jnp.tanh(pre))
        parts.append((q if floor is None else jnp.maximum(q, floor)) - dist.log_prob(d, pre))
    return jax.nn.logsumexp(jnp.concatenate(parts, 1), axis=1)


def weighted_mean(critics: MLP, actor: MLP | Categorical, batch: Batch, draws: int, key: Array) -> Float[Array, "k b"]:
    """Mean of Q(s, a) over actions of the policy, weighted by exp Q: under the distribution that CQL(rho) holds down."""
    if isinstance(actor, Categorical):
        q = all_q_values(critics, batch.observation)
        weight = jax.nn.softmax(jax.lax.stop_gradient(q + actor.log_probs(batch.observation)))
        return (weight * q).sum(-1)
    head = dist.gaussian_head(jax.lax.stop_gradient(actor(batch.observation)))
    drawn = jnp.tanh(dist.sample(head, key, (draws,)))
    q = q_values(critics, batch.observation, drawn)
    return (jax.lax.stop_gradient(jax.nn.softmax(q, 1)) * q).sum(1)
