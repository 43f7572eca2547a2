"""D4PG: DDPG whose critic learns the distribution of returns (Barth-Maron et al. 2018), in the sizes of RL Unplugged.

The critic gives probabilities of `atoms` returns between `v_min` and `v_max`. With pi' and Z' the copies that targets come
from and P the projection on the atoms,

    L_critic = H( P[ r_1 + ... + gamma^(n-1) r_n + gamma^n Z'(s_n, pi'(s_n)) ], Z(s, a) ),

and the actor follows the slope of the distribution's mean by its action, each row's cut to length one, as in Acme (Hoffman et
al. 2020). Nothing holds it to a log. Sizes are those of Gulcehre et al. (2020).
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.agent import Agent
from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.errors import UserError
from deadreckon.nets.layer_norm_mlp import LayerNormMLP
from deadreckon.nets.optim import apply_gradients, clip_by_norm, copy, init_opt, renewed
from deadreckon.nets.return_distributions import cross_entropy, mean, project, support
from deadreckon.policies.kinds import Deterministic
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Number, Positive, Sizes, TwoOrMore, UnitInterval, static
from deadreckon.training.later_fields import later

SMALL = 0.01  # of the actor's last weights: it begins near the middle of its actions


class State(NamedTuple):
    """Networks, their targets and optimisers."""

    actor: Any  # a LayerNormMLP; of CRR-D the networks of a stochastic policy
    critic: LayerNormMLP
    target_actor: Any
    target_critic: LayerNormMLP
    actor_opt: optax.OptState
    critic_opt: optax.OptState


class D4PG(Agent):
    """A deterministic actor and a critic of return distributions."""

    revision: ClassVar[int] = 1
    online: ClassVar[bool] = True
    exploration_noise: ClassVar[float] = 0.3  # published (Acme: sigma)
    other_names: ClassVar[dict[str, str]] = {
        "vmin": "v_min", "vmax": "v_max", "num_atoms": "atoms", "policy_lr": "actor_lr", "clipping": "max_grad_norm",
    }  # fmt: skip

    actor_lr: NonNegative = 1e-4  # learning rate of the actor
    critic_lr: NonNegative = 1e-4  # learning rate of the critic
    discount: UnitInterval = 0.99  # discount factor per step
    n_step: Count = static(1)  # rewards summed before the value that follows (published for learning online: 5)
    v_min: Number = -150.0  # smallest return that has a probability
    v_max: Number = 150.0  # largest return that has a probability
    atoms: TwoOrMore = static(51)  # number of returns that have a probability
    target_update_period: Count = static(100)  # updates between copies of the networks to their targets
    max_grad_norm: Positive = 40.0  # norm above which the gradients of a network are clipped
    hidden: Sizes = static((300, 200))  # width of each hidden layer of the actor
    critic_hidden: Sizes = static((400, 300))  # width of each hidden layer of the critic
    batch_size: Count = static(256)  # batch size (transitions per update)
    standardise: bool = later(False)  # whether observations are standardised to mean 0 and standard deviation 1

    def resolve(self, spec, steps):
        """See `Agent.resolve`; the returns that have a probability must be a range, in which returns of the log may lie."""
        agent = super().resolve(spec, steps)
        if not self.v_min < self.v_max:
            raise UserError(f"{type(self).__name__}: v_min must be below v_max, got {self.v_min} and {self.v_max}")
        if spec.rows and self.discount < 1.0:
            ahead = 1.0 / (1.0 - self.discount)
            least, most = min(spec.reward.min, spec.reward.min * ahead), max(spec.reward.max, spec.reward.max * ahead)
            if most < self.v_min or least > self.v_max:
                raise UserError(
                    f"{type(self).__name__}: rewards of {spec.name} are {spec.reward.min:.4g} to {spec.reward.max:.4g}, so "
                    f"that every return lies outside v_min = {self.v_min:g} to v_max = {self.v_max:g}; give other limits"
                )
        return agent

    def needs(self, spec):
        """Rows of `n_step` transitions, with the factor of the value after them."""
        columns = ("observation", "action", "reward", "next_observation", "discount")
        return BatchSpec(columns, self.batch_size, n_step=self.n_step, standardise=self.standardise, gamma=self.discount)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        ka, kc = keys(key, "actor", "critic")
        actor = self.create_actor(spec, ka)
        inputs = spec.observation_size + spec.action_size
        critic = LayerNormMLP.create((inputs, *self.critic_hidden, self.atoms), kc)
        return State(actor, critic, copy(actor), copy(critic), init_opt(actor), init_opt(critic))

    def create_actor(self, spec, key) -> Any:
        """A fresh actor."""
        return LayerNormMLP.create((spec.observation_size, *self.hidden, spec.action_size), key, SMALL)

    def actions(self, actor, observation: Float[Array, "b o"], key: PRNGKeyArray) -> Float[Array, "b a"]:
        """What targets value: the actor's."""
        return jnp.tanh(actor(observation))

    @property
    def support(self) -> Float[Array, "z"]:
        """(atoms,) the returns that have a probability."""
        return support(self.v_min, self.v_max, self.atoms)

    def target(self, state: State, batch: Batch, key: PRNGKeyArray) -> Float[Array, "b z"]:
        """The distribution of the rewards plus the target networks' returns after them, on the atoms."""
        action = self.actions(state.target_actor, batch.next_observation, key)
        future = jax.nn.softmax(logits(state.target_critic, batch.next_observation, action))
        return project(future, batch.reward, batch.discount, self.support)

    def critic_loss(self, critic: LayerNormMLP, batch: Batch, target: Float[Array, "b z"]):
        """Cross entropy to the target."""
        found = logits(critic, batch.observation, batch.action)
        loss = cross_entropy(found, target).mean()
        return loss, {"critic_loss": loss, "q": mean(found, self.support).mean()}

    def actor_loss(self, actor, critic: LayerNormMLP, batch: Batch, key: PRNGKeyArray) -> Float[Array, ""]:
        """1/2 |a + g - a|^2 with a = pi(s) and a + g without a slope: its slope is -g, the critic's, of length one at most."""
        action = jnp.tanh(actor(batch.observation))
        fixed = jax.lax.stop_gradient(action)
        value = lambda a: mean(logits(critic, batch.observation, a), self.support).sum()  # noqa: E731
        slope = jax.grad(value)(fixed)
        length = jnp.linalg.norm(slope, axis=-1, keepdims=True)
        return 0.5 * jnp.square(fixed + slope / jnp.maximum(length, 1.0) - action).sum(-1).mean()

    def update(self, state, batch, *, step, key):
        """Critic, actor, and at the end of every period the targets."""
        k_target, k_actor = keys(key, "target", "actor_loss")
        grads, metrics = jax.grad(self.critic_loss, has_aux=True)(state.critic, batch, self.target(state, batch, k_target))
        # By the critic as it was, as published.
        loss, slopes = jax.value_and_grad(self.actor_loss)(state.actor, state.critic, batch, k_actor)
        grads, slopes = clip_by_norm(grads, self.max_grad_norm), clip_by_norm(slopes, self.max_grad_norm)
        critic, critic_opt = apply_gradients(state.critic, grads, state.critic_opt, self.critic_lr)
        actor, actor_opt = apply_gradients(state.actor, slopes, state.actor_opt, self.actor_lr)
        before = state.target_actor, state.target_critic
        target_actor, target_critic = renewed(before, (actor, critic), step, self.target_update_period)
        state = State(actor, critic, target_actor, target_critic, actor_opt, critic_opt)
        return state, metrics | {"actor_loss": loss}

    def policy(self, state) -> Any:
        """The actor."""
        return Deterministic(state.actor)

    def q_value(self, state, observation, action):
        """The mean of the distribution."""
        return mean(logits(state.critic, observation, action), self.support)


def logits(critic: LayerNormMLP, observation: Float[Array, "*#b o"], action: Float[Array, "*b a"]) -> Float[Array, "*b z"]:
    """Of the returns after each row's action, or after several of them (leading axes of `action`)."""
    seen = jnp.broadcast_to(observation, (*action.shape[:-1], observation.shape[-1]))
    return critic(jnp.concatenate([seen, action], -1))
