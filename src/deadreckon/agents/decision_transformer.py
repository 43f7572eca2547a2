"""Decision Transformer (Chen et al. 2021): imitation, given the return that is still to come.

A transformer reads (return-to-go, observation, action) of consecutive steps and says the next action:

    L = E[ | pi(R_{t-k..t}, s_{t-k..t}, a_{t-k..t-1}) - a_t |^2 ],   R_t = r_t + r_{t+1} + ... to the episode's recorded end.

It acts by asking for a return at an episode's start and taking from it what it has got since. No value is learned.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.agent import Agent
from deadreckon.data.batch import Needs
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP, standardised
from deadreckon.nets.optim import begin, clipped, descend
from deadreckon.nets.transformer import Transformer, dropped
from deadreckon.policies.policy import Inner
from deadreckon.training.learner import static


class Sequence(eqx.Module):
    """To actions of steps from what went before them.

    Attributes:
        of_return, of_observation, of_action: each to a token.
        of_time: (steps, width) what is added to the tokens of each step of an episode; later ones are the last.
        transformer: of three tokens a step.
        head: from an observation's token to its action before the tanh.
    """

    of_return: MLP
    of_observation: MLP
    of_action: MLP
    of_time: Float[Array, "steps width"]
    transformer: Transformer
    head: MLP

    @classmethod
    def create(cls, spec: Spec, layers: int, width: int, heads: int, key: PRNGKeyArray) -> "Sequence":
        """Fresh networks, for episodes as long as the log's."""
        kr, ko, ka, kt, kn, kh = jax.random.split(key, 6)
        times = 0.02 * jax.random.normal(kt, (max(spec.longest, 1), width))
        embed = lambda size, k: MLP.create(size, (), width, k)  # noqa: E731
        tokens = embed(1, kr), embed(spec.observation_size, ko), embed(spec.action_size, ka)
        return cls(*tokens, times, Transformer.create(layers, width, heads, kn), MLP.create(width, (), spec.action_size, kh))

    def __call__(
        self, wanted: Float[Array, "b k"], observation: Float[Array, "b k o"], action: Float[Array, "b k a"],
        time: Float[Array, "b k"], there: Float[Array, "b k"], rate: Array | float = 0.0, key: PRNGKeyArray | None = None,
    ) -> Float[Array, "b k a"]:  # fmt: skip
        """Actions of all steps; that of a step sees its return-to-go, its observation, and all before them."""
        when = self.of_time[jnp.minimum(time, len(self.of_time) - 1).astype(jnp.int32)]
        tokens = self.of_return(wanted[..., None]), self.of_observation(observation), self.of_action(action)
        rows, steps = wanted.shape
        x = jnp.stack([token + when for token in tokens], 2).reshape(rows, 3 * steps, -1)
        x = dropped(standardised(x), rate, None if key is None else jax.random.fold_in(key, 2 * len(self.transformer.blocks)))
        x = self.transformer(x, jnp.repeat(there > 0, 3, 1), rate, key)
        return jnp.tanh(self.head(x[:, 1::3]))


class Memory(NamedTuple):
    """The last steps of each environment, the present one at the end of the window."""

    wanted: Float[Array, "n k"]
    observation: Float[Array, "n k o"]
    action: Float[Array, "n k a"]
    time: Float[Array, "n k"]
    there: Float[Array, "n k"]


class Asking(Inner):
    """Acts as the log did where it got the return that is asked for.

    Attributes:
        net: says actions.
        wanted: return of an episode that is asked for.
        scale: what returns are divided by.
        window: steps that are remembered.
    """

    net: Sequence
    wanted: Array
    scale: Array
    window: int = eqx.field(static=True)

    def start(self, n: int) -> Memory:
        """No steps."""
        steps = jnp.zeros((n, self.window))
        observation, action = (embed.weights[0].shape[0] for embed in (self.net.of_observation, self.net.of_action))
        return Memory(steps, jnp.zeros((*steps.shape, observation)), jnp.zeros((*steps.shape, action)), steps, steps)

    def act(self, step, carry, key, *, greedy):
        """The action of the present step; nothing is drawn."""
        first = jnp.asarray(step.first, bool)
        carry = jax.tree.map(lambda part: jnp.where(first.reshape(-1, *[1] * (part.ndim - 1)), 0.0, part), carry)
        wanted = jnp.where(first, self.wanted / self.scale, carry.wanted[:, -1] - step.reward / self.scale)
        time = jnp.where(first, 0.0, carry.time[:, -1] + 1.0)
        # What is done now is not known yet; nobody looks at its token.
        now = Memory(wanted, step.observation, jnp.zeros_like(carry.action[:, 0]), time, jnp.ones_like(time))
        carry = Memory(*(jnp.concatenate([past[:, 1:], new[:, None]], 1) for past, new in zip(carry, now)))
        action = self.net(*carry)[:, -1]
        return action, carry._replace(action=carry.action.at[:, -1].set(action))


class State(NamedTuple):
    """Network, optimiser, and what the log's returns are."""

    net: Sequence
    opt: optax.OptState
    best: Array
    worst: Array
    scale: Array


class DecisionTransformer(Agent):
    """Imitation given returns-to-go."""

    lr: float = 1e-4  # learning rate
    decay: float = 1e-4  # of the weights, in learning rates
    dropout: float = 0.1  # share of numbers dropped behind every layer
    gradient_norm: float = 0.25  # what a longer gradient is cut to
    ask: float = 1.0  # return asked for: 1 is the log's best episode's, 0 its worst's, beyond 1 more than was seen
    warm_up: int = static(10_000)  # updates in which the learning rate rises from nothing
    window: int = static(20)  # steps that it reads
    layers: int = static(3)  # of the transformer
    heads: int = static(1)  # that attend side by side
    hidden: tuple[int, ...] = static((128,))  # width of the tokens
    batch_size: int = static(64)  # windows a batch

    def resolve(self, spec, steps):
        """One width, in equal parts for all heads."""
        if len(self.hidden) != 1 or self.hidden[0] % self.heads:
            takes = f"one width, a multiple of heads ({self.heads})"
            raise UserError(f"DecisionTransformer.hidden takes {takes}, got {self.hidden}")
        return super().resolve(spec, steps)

    def needs(self, spec):
        """Windows with returns that are not discounted."""
        columns = ("observation", "action", "return_to_go", "time")
        return Needs(columns, self.batch_size, window=self.window, standardise=True, gamma=1.0)

    def init(self, spec, key) -> Any:
        """A fresh network; what the log's returns are is not known yet."""
        net = Sequence.create(spec, self.layers, self.hidden[0], self.heads, key)
        return State(net, begin(net), jnp.ones(()), jnp.zeros(()), jnp.ones(()))

    def prepare(self, state, rows, key, fit):
        """Looks at the log's returns."""
        returns = rows.log.returns()
        most = np.abs(returns).max()
        best, worst, scale = (jnp.asarray(x, jnp.float32) for x in (returns.max(), returns.min(), most if most > 0 else 1.0))
        return state._replace(best=best, worst=worst, scale=scale)

    def loss(self, net: Sequence, scale: Array, batch, key) -> Array:
        """Mean squared error of the actions of the steps that are there."""
        found = net(batch.return_to_go / scale, batch.observation, batch.action, batch.time, batch.mask, self.dropout, key)
        return (batch.mask[..., None] * jnp.square(found - batch.action)).mean() / batch.mask.mean()

    def update(self, state, batch, *, step, key):
        """One step of Adam with decoupled weight decay."""
        loss, grads = jax.value_and_grad(self.loss)(state.net, state.scale, batch, key)
        lr = self.lr * jnp.minimum((step + 1) / self.warm_up, 1.0)
        net, opt = descend(state.net, clipped(grads, self.gradient_norm), state.opt, lr)
        net = jax.tree.map(lambda new, old: new - lr * self.decay * old, net, state.net)
        return state._replace(net=net, opt=opt), {"loss": loss}

    def policy(self, state):
        """Asks for the return that `ask` says."""
        wanted = state.worst + self.ask * (state.best - state.worst)
        return Asking(state.net, wanted, state.scale, self.window)
