"""Proximal policy optimisation (Schulman et al. 2017), the on-policy baseline of thesis 5.4.

    max E[ min( r A, clip(r, 1 - clip, 1 + clip) A ) ],    r = pi(a|s) / pi_old(a|s)

with advantages by generalised estimation (Schulman et al. 2016). Each block of steps is used for a few passes and then
forgotten; `online.on_policy` makes it.
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent
from deadreckon.agents.on_policy import Moments, advantages, folded, scaled_value
from deadreckon.data.batch import BatchSpec
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, clip_by_norm, init_opt
from deadreckon.policies.kinds import TanhGaussian
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Positive, Sizes, UnitInterval, static

PASSES, MINIBATCH = 10, 64  # of a block, and rows


class State(NamedTuple):
    """Networks, optimisers, and what observations and returns have been like."""

    actor: MLP
    critic: MLP
    opt: optax.OptState
    observations: Moments
    returns: Moments
    model: Any = None  # of agents that learn one


class PPO(Agent):
    """Clipped policy gradients on the policy's last block of steps."""

    revision: ClassVar[int] = 1
    online: ClassVar[bool] = True
    offline: ClassVar[bool] = False
    digests: ClassVar[tuple[str, ...]] = ("observation", "action", "behavior_log_prob", "return_to_go", "advantage")
    other_names: ClassVar[dict[str, str]] = {
        "trace": "gae_lambda", "lambda": "gae_lambda", "clip": "clip_range", "epsilon": "clip_range",
        "gradient_norm": "max_grad_norm", "vf_coef": "value_weight", "ent_coef": "entropy_weight",
    }  # fmt: skip

    lr: NonNegative = 3e-4  # learning rate of actor and critic
    discount: UnitInterval = 0.99  # discount factor per step
    gae_lambda: UnitInterval = 0.95  # lambda of generalised advantage estimation: 0 trusts the critic, 1 the returns
    clip_range: NonNegative = 0.2  # largest deviation of the probability ratio from 1 before it is clipped
    value_weight: NonNegative = 0.5  # weight of the critic loss
    entropy_weight: NonNegative = 0.0  # weight of the entropy bonus
    max_grad_norm: Positive = 0.5  # norm above which gradients are clipped
    hidden: Sizes = static((64, 64))  # width of each hidden layer (tanh)
    batch_size: Count = static(MINIBATCH)
    """batch size (transitions per update); with updates per step as they are, twice 64 is twice as many passes over a block"""

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """How acting and learning take turns: 2,048 steps, then ten passes over them in batches of 64."""
        return {"copies": 8, "explore": 2000, "updates_per_step": PASSES / MINIBATCH, "block": 2048}

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size)

    def init(self, spec, key) -> Any:
        """Fresh networks; the actor's last layer is small, so that it begins without preferences."""
        ka, kc = keys(key, "actor", "critics")
        actor = MLP.create(spec.observation_size, self.hidden, 2 * spec.action_size, ka, activation="tanh")
        actor = MLP((*actor.weights[:-1], 0.01 * actor.weights[-1]), (*actor.biases[:-1], 0.0 * actor.biases[-1]), "tanh")
        critic = MLP.create(spec.observation_size, self.hidden, 1, kc, activation="tanh")
        return State(actor, critic, init_opt((actor, critic)), Moments.none(spec.observation_size), Moments.none())

    def observing(self, state: State, observation: Float[Array, "n o"]) -> State:
        """The state before it acts again, which has seen some more observations."""
        return state._replace(observations=state.observations.seeing(observation))

    def digest(self, state: State, rows: dict[str, Float[Array, "t c *s"]]) -> tuple[State, dict[str, Array]]:
        """What is learned of a block: every row with its advantage, return and probability.

        Args:
            state: of the policy that acted.
            rows: steps of several copies: observation, action, reward, next_observation, terminal and timeout.

        Returns:
            The state, which knows the block's returns, and columns (t, c, *s).
        """
        policy = self.policy(state)
        log_prob = policy.log_prob(rows["observation"], rows["action"])
        advantage, returns = advantages(lambda seen: self.value(state, seen), rows, self.discount, self.gae_lambda)
        new = state._replace(returns=state.returns.seeing(returns.reshape(-1)))
        columns = {"observation": rows["observation"], "action": rows["action"], "behavior_log_prob": log_prob,
                   "return_to_go": returns, "advantage": advantage}  # fmt: skip
        return new, columns

    def update(self, state, batch, *, step, key):
        """Actor and critic."""
        nets = state.actor, state.critic
        grads, metrics = jax.grad(self.loss, has_aux=True)(nets, state, batch, key)
        (actor, critic), opt = apply_gradients(nets, clip_by_norm(grads, self.max_grad_norm), state.opt, self.lr)
        return state._replace(actor=actor, critic=critic, opt=opt), metrics

    def loss(self, nets, state, batch, key):
        """Minus the clipped gain, the critic's squared error and minus the entropy, weighted."""
        actor, critic = nets
        policy = self.policy(state._replace(actor=actor))
        log_ratio = policy.log_prob(batch.observation, batch.action) - batch.behavior_log_prob
        ratio = jnp.exp(log_ratio)
        gain = batch.extra["advantage"]
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        clipped = jnp.clip(ratio, 1.0 - self.clip_range, 1.0 + self.clip_range)
        actor_loss = -jnp.minimum(ratio * gain, clipped * gain).mean()
        error = (self.value(state._replace(critic=critic), batch.observation) - batch.return_to_go) / state.returns.deviation
        critic_loss = jnp.square(error).mean()
        d = dist.gaussian_head(policy.net(batch.observation))
        entropy = -dist.log_prob(d, dist.sample(d, key)).mean()
        loss = actor_loss + self.value_weight * critic_loss - self.entropy_weight * entropy
        apart = ((ratio - 1.0) - log_ratio).mean()  # estimates KL(old || new) without its noise
        cut = (jnp.abs(ratio - 1.0) > self.clip_range).mean()
        return loss, {"actor_loss": actor_loss, "critic_loss": critic_loss, "entropy": entropy, "kl": apart, "clipped": cut}

    def value(self, state: State, observation: Float[Array, "*b o"]) -> Float[Array, "*b"]:
        """The critic, on the scale of returns."""
        return scaled_value(state.critic, state.observations, state.returns, observation)

    def policy(self, state):
        """The actor, which standardises observations in its first layer."""
        return TanhGaussian(folded(state.actor, state.observations))
