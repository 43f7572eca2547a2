"""DAPG (Rajeswaran et al. 2018): natural policy gradients with demonstrations (thesis 8.4: DOPE's policies).

The policy first clones the demonstrations. Then each block of its own steps gives one step along the natural gradient (Kakade
2001) of Rajeswaran et al.'s augmented gradient,

    g = sum_{(s, a) of the block} A(s, a) grad log pi(a|s) + lambda0 lambda1^k max A sum_{(s, a) demonstrated} grad log pi(a|s)
    theta <- theta + sqrt(delta / g^T F^-1 g) F^-1 g,      F the Fisher matrix on the block's observations,

with advantages as PPO has them and `k` the steps before. Without demonstrations both sums are one, and it is the natural policy
gradient. `online.demonstrated` makes the blocks.
"""

from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent
from deadreckon.agents.natural import Actor, log_prob, natural_step
from deadreckon.agents.on_policy import Moments, advantages, folded, scaled_value
from deadreckon.data.batch import BatchSpec
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.policies.kinds import Gaussian
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, Fraction, NonNegative, Sizes, UnitInterval, static

LOG_STD_MIN = -3.0  # below which their code lets no log-deviation fall
PASSES, MINIBATCH = 2, 64  # of the critic over a block, and rows
CLONED = 32  # batch size of the cloning
STEP_METRICS = "kl", "improvement", "demonstrations", "deviation", "reward"  # metrics of a natural gradient step


class State(NamedTuple):
    """Networks, the critic's optimiser, statistics of observations and returns, and the last step's metrics."""

    actor: Actor
    critic: MLP
    opt: optax.OptState
    observations: Moments
    returns: Moments
    steps: Array  # along natural gradients so far
    told: dict[str, Array]  # metrics of the last natural gradient step; checkpoints have this name


class DAPG(Agent):
    """Natural policy gradients from cloned demonstrations, whose likelihood counts for a while."""

    revision: ClassVar[int] = 3  # 3: clones see what policies see, and simulators actions within the bounds
    online: ClassVar[bool] = True
    offline: ClassVar[bool] = False
    digests: ClassVar[tuple[str, ...]] = ("observation", "return_to_go")
    other_names: ClassVar[dict[str, str]] = {
        "trace": "gae_lambda", "lambda": "gae_lambda", "iterations": "cg_iterations", "clone_steps": "bc_steps",
        "clone_lr": "bc_lr", "deviation": "init_std", "lambda0": "demonstration_weight", "lambda1": "demonstration_decay",
    }  # fmt: skip

    delta: Fraction = 0.05  # normalised step size: twice the KL divergence that a step is to make
    damping: NonNegative = 1e-4  # constant added to the diagonal of the Fisher matrix
    cg_iterations: Count = static(10)  # iterations of the conjugate gradient method
    demonstration_weight: NonNegative = 0.1
    """weight of demonstrated actions (lambda0), in units of the largest advantage of the block"""
    demonstration_decay: UnitInterval = 0.95  # decay of that weight per step (lambda1)
    discount: UnitInterval = 0.995  # discount factor per step
    gae_lambda: UnitInterval = 0.97  # lambda of generalised advantage estimation: 0 trusts the critic, 1 the returns
    lr: NonNegative = 1e-3  # learning rate of the critic
    bc_steps: Count = static(20_000)  # updates of behaviour cloning on the demonstrations before the first step
    bc_lr: NonNegative = 1e-3  # learning rate of behaviour cloning
    init_std: Literal["residual", "demonstrated"] = static("residual")
    """standard deviation after cloning: that of its residuals, or of the demonstrated actions"""
    hidden: Sizes = static((32, 32))  # width of each hidden layer of the policy (tanh)
    critic_hidden: Sizes = static((128, 128))  # width of each hidden layer of the critic (ReLU)
    batch_size: Count = static(MINIBATCH)
    """batch size of the critic; with updates per step as they are, twice 64 is twice as many passes over a block"""

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """How acting and learning take turns: 40,000 steps (200 episodes of Adroit), one step, two passes of the critic."""
        return {"copies": 200, "explore": 2000, "updates_per_step": PASSES / MINIBATCH, "block": 40_000}

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size)

    def init(self, spec, key) -> Any:
        """Fresh networks; deviations are one until demonstrations tell better."""
        ka, kc = keys(key, "actor", "critics")
        actor = Actor(policy_network(spec, self.hidden, ka), jnp.zeros(spec.action_size))
        critic = MLP.create(spec.observation_size, self.critic_hidden, 1, kc)
        told: dict[str, Array] = {name: jnp.zeros(()) for name in STEP_METRICS}
        seen = Moments.none(spec.observation_size)
        return State(actor, critic, init_opt(critic), seen, Moments.none(), jnp.float32(0.0), told)

    def observing(self, state: State, observation: Float[Array, "n o"]) -> State:
        """The state that standardises observations by these from now on."""
        return state._replace(observations=moments(observation))

    def begun(self, state: State, net: MLP, shown: dict[str, Array]) -> State:
        """The state in which the policy is a clone of what was demonstrated.

        Args:
            state: that standardises observations by the demonstrated ones, as the clone does.
            net: the clone's means.
            shown: observations (n, o) and actions (n, a).
        """
        error = net(standardised(shown["observation"], state.observations)) - shown["action"]
        spread = jnp.sqrt(jnp.square(error).mean(0)) if self.init_std == "residual" else shown["action"].std(0)
        return state._replace(actor=Actor(net, jnp.maximum(jnp.log(spread), LOG_STD_MIN)))

    def digest(
        self, state: State, rows: dict[str, Float[Array, "t c *s"]], shown: dict[str, Array] | None = None
    ) -> tuple[State, dict[str, Array]]:
        """Takes a step along the natural gradient of a block.

        Args:
            state: of the policy that acted.
            rows: steps of several copies: observation, action (as drawn), reward, next_observation, terminal and timeout.
            shown: observations (n, o) and actions (n, a) that were demonstrated, if any.

        Returns:
            The state with the new policy, and columns (t, c, *s) for the critic, whose advantages were those before it sees
            this block.
        """
        advantage, returns = advantages(lambda seen: self.value(state, seen), rows, self.discount, self.gae_lambda)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        observation, action = (rows[name].reshape(-1, rows[name].shape[-1]) for name in ("observation", "action"))
        observation = standardised(observation, state.observations)
        weight = self.demonstration_weight * self.demonstration_decay**state.steps * advantage.max()

        def gain(actor: Actor) -> Array:
            return (advantage.reshape(-1) * log_prob(actor.at(observation), action)).mean()

        def augmented(actor: Actor) -> Array:
            if shown is None:
                return gain(actor)
            demonstrated = standardised(shown["observation"], state.observations)
            likelihood = log_prob(actor.at(demonstrated), shown["action"]).sum()
            return gain(actor) + weight * likelihood / len(observation)

        old = state.actor
        actor = natural_step(old, jax.grad(augmented)(old), observation, self.delta, self.damping, self.cg_iterations)
        actor = actor._replace(log_std=jnp.maximum(actor.log_std, LOG_STD_MIN))
        apart, counted = dist.kl(old.at(observation), actor.at(observation)).mean(), 0.0 if shown is None else 1.0
        numbers = apart, gain(actor) - gain(old), counted * weight, jnp.exp(actor.log_std).mean(), rows["reward"].mean()
        seen_returns = state.returns.seeing(returns.reshape(-1))
        metrics = dict(zip(STEP_METRICS, numbers))
        new = state._replace(actor=actor, returns=seen_returns, steps=state.steps + 1.0, told=metrics)
        return new, {"observation": rows["observation"], "return_to_go": returns}

    def update(self, state, batch, *, step, key):
        """An update of the critic alone; the metrics of the block's natural gradient step are reported with it."""

        def loss(critic: MLP) -> Array:
            error = self.value(state._replace(critic=critic), batch.observation) - batch.return_to_go
            return jnp.square(error / state.returns.deviation).mean()

        value, grads = jax.value_and_grad(loss)(state.critic)
        critic, opt = apply_gradients(state.critic, grads, state.opt, self.lr)
        return state._replace(critic=critic, opt=opt), {"critic_loss": value, **state.told}

    def value(self, state: State, observation: Float[Array, "*b o"]) -> Float[Array, "*b"]:
        """The critic, on the scale of returns."""
        return scaled_value(state.critic, state.observations, state.returns, observation)

    def policy(self, state):
        """The actor, which standardises observations in its first layer."""
        return Gaussian.of(folded(state.actor.net, state.observations), state.actor.log_std)


class Clone(NamedTuple):
    """The network and its optimiser."""

    net: MLP
    opt: optax.OptState


class Cloning(eqx.Module):
    """Fits the means to demonstrated actions, by squared errors in units of their deviations.

    Attributes:
        lr: learning rate.
        seen: what the demonstrated observations are like, by which the policy standardises them too.
        center, spread: (a,) mean and deviation of the demonstrated actions.
        hidden: width of each hidden layer.
    """

    lr: float
    seen: Moments
    center: Array
    spread: Array
    hidden: Sizes = static((32, 32))

    def needs(self, spec):
        """Observations and actions."""
        return BatchSpec(("observation", "action"), CLONED)

    def init(self, spec, key):
        """A fresh network."""
        net = policy_network(spec, self.hidden, key)
        return Clone(net, init_opt(net))

    def update(self, state, batch, *, step, key):
        """One step on the mean squared error."""
        wanted = (batch.action - self.center) / self.spread
        seen = standardised(batch.observation, self.seen)
        error = lambda net: jnp.square(net(seen) - wanted).mean()  # noqa: E731
        value, grads = jax.value_and_grad(error)(state.net)
        return Clone(*apply_gradients(state.net, grads, state.opt, self.lr)), {"behavior_error": value}

    def means(self, state: Clone) -> MLP:
        """The network to actions as they were demonstrated."""
        *weights, last = state.net.weights
        *biases, bias = state.net.biases
        return MLP((*weights, last * self.spread), (*biases, bias * self.spread + self.center), state.net.activation)


def moments(observation: Float[Array, "n o"]) -> Moments:
    """What some observations are like."""
    return Moments.none(observation.shape[-1]).seeing(observation)


def standardised(observation: Float[Array, "n o"], seen: Moments) -> Float[Array, "n o"]:
    """Observations as the networks take them."""
    return (observation - seen.mean) / seen.deviation


def policy_network(spec: Any, hidden: tuple[int, ...], key: Any) -> MLP:
    """A fresh network to means, tanh; its last layer is small, so that it begins without preferences."""
    net = MLP.create(spec.observation_size, hidden, spec.action_size, key, activation="tanh")
    return MLP((*net.weights[:-1], 0.01 * net.weights[-1]), (*net.biases[:-1], 0.01 * net.biases[-1]), "tanh")
