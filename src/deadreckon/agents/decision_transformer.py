"""Decision Transformer (Chen et al. 2021): imitation, given the return that is still to come.

A transformer reads (return-to-go, observation, action) of consecutive steps and says the next action:

    L = E[ | pi(R_{t-k..t}, s_{t-k..t}, a_{t-k..t-1}) - a_t |^2 ],   R_t = r_t + r_{t+1} + ... to the episode's recorded end.

It acts with a target return at an episode's start, from which received rewards are subtracted. No value is learned.
"""

from typing import Annotated, Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from deadreckon.agents.agent import Agent
from deadreckon.data.batch import BatchSpec
from deadreckon.errors import UserError
from deadreckon.nets.optim import apply_gradients, clip_by_norm, init_opt
from deadreckon.policies.sequence import DecisionTransformerNet, DecisionTransformerPolicy
from deadreckon.training.hyperparameters import Count, NonNegative, Number, Positive, Range, Sizes, static


class State(NamedTuple):
    """Network, optimiser, and the log's returns."""

    net: DecisionTransformerNet
    opt: optax.OptState
    best: Array
    worst: Array
    scale: Array


class DecisionTransformer(Agent):
    """Imitation given returns-to-go."""

    revision: ClassVar[int] = 1
    supports_history: ClassVar[bool] = False
    own_history: ClassVar[str] = "it takes the last steps already, see context_length"
    one_log: ClassVar[bool] = True  # it embeds as many times as the longest episode has steps
    other_names: ClassVar[dict[str, str]] = {
        "decay": "weight_decay", "gradient_norm": "max_grad_norm", "ask": "target_return", "warm_up": "warmup_steps",
        "window": "context_length",
    }  # fmt: skip

    lr: NonNegative = 1e-4  # learning rate after the warm-up
    weight_decay: NonNegative = 1e-4  # weight decay of AdamW
    dropout: Annotated[float, Range(ge=0, lt=1)] = 0.1  # dropout probability after every layer
    max_grad_norm: Positive = 0.25  # norm above which gradients are clipped
    target_return: Number = 1.0  # return to condition on: 0 is the worst logged episode, 1 the best, beyond 1 more than any
    warmup_steps: Count = static(10_000)  # updates in which the learning rate rises linearly from 0
    context_length: Count = static(20)  # steps that the transformer attends to
    layers: Count = static(3)  # number of transformer blocks
    heads: Count = static(1)  # number of attention heads
    hidden: Sizes = static((128,))  # width of the token embeddings
    batch_size: Count = static(64)  # batch size (windows per update)

    def resolve(self, spec, steps):
        """One width, in equal parts for all heads."""
        agent = super().resolve(spec, steps)
        if len(self.hidden) != 1 or self.hidden[0] % self.heads:
            takes = f"one width, a multiple of heads ({self.heads})"
            raise UserError(f"DecisionTransformer.hidden takes {takes}, got {self.hidden}")
        return agent

    def needs(self, spec):
        """Windows with returns that are not discounted."""
        columns = ("observation", "action", "return_to_go", "time")
        return BatchSpec(columns, self.batch_size, window=self.context_length, standardise=True, gamma=1.0)

    def init(self, spec, key) -> Any:
        """An initial network; the log's returns are not known yet."""
        net = DecisionTransformerNet.create(spec, self.layers, self.hidden[0], self.heads, key)
        return State(net, init_opt(net), jnp.ones(()), jnp.zeros(()), jnp.ones(()))

    def prepare(self, state, rows, key, fit):
        """Looks at the log's returns."""
        returns = rows.log.returns()
        most = np.abs(returns).max()
        best, worst, scale = (jnp.asarray(x, jnp.float32) for x in (returns.max(), returns.min(), most if most > 0 else 1.0))
        return state._replace(best=best, worst=worst, scale=scale)

    def loss(self, net: DecisionTransformerNet, scale: Array, batch, key) -> Array:
        """Mean squared error of the actions of the steps that are there."""
        found = net(batch.return_to_go / scale, batch.observation, batch.action, batch.time, batch.mask, self.dropout, key)
        return (batch.mask[..., None] * jnp.square(found - batch.action)).mean() / batch.mask.mean()

    def update(self, state, batch, *, step, key):
        """One step of Adam with decoupled weight decay."""
        loss, grads = jax.value_and_grad(self.loss)(state.net, state.scale, batch, key)
        lr = self.lr * jnp.minimum((step + 1) / self.warmup_steps, 1.0)
        net, opt = apply_gradients(state.net, clip_by_norm(grads, self.max_grad_norm), state.opt, lr, self.weight_decay)
        return state._replace(net=net, opt=opt), {"loss": loss}

    def policy(self, state):
        """Asks for the return that `ask` says."""
        wanted = state.worst + self.target_return * (state.best - state.worst)
        return DecisionTransformerPolicy(state.net, wanted, state.scale, self.context_length)
