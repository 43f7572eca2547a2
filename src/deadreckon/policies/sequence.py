"""A policy that is a transformer over past steps with a target return (Decision Transformer, Chen et al. 2021)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, Real

from deadreckon.data.spec import Spec
from deadreckon.nets.mlp import MLP, standardised
from deadreckon.nets.transformer import Transformer, dropped
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.randomness import key_for, keys


class DecisionTransformerNet(eqx.Module):
    """A transformer from the returns-to-go, observations and actions of the last steps to actions.

    Attributes:
        of_return, of_observation, of_action: each to a token.
        of_time: (steps, width) what is added to the tokens of each step of an episode; later ones are the last.
        transformer: of three tokens per step.
        head: from an observation's token to its action before the tanh.
    """

    of_return: MLP
    of_observation: MLP
    of_action: MLP
    of_time: Float[Array, "steps width"]
    transformer: Transformer
    head: MLP

    @classmethod
    def create(cls, spec: Spec, layers: int, width: int, heads: int, key: PRNGKeyArray) -> "DecisionTransformerNet":
        """Fresh networks, for episodes as long as the log's."""
        kr, ko, ka, kt, kn, kh = keys(key, "returns", "observations", "actions", "times", "transformer", "head")
        times = 0.02 * jax.random.normal(kt, (max(spec.longest, 1), width))
        embed = lambda size, k: MLP.create(size, (), width, k)  # noqa: E731
        tokens = embed(1, kr), embed(spec.observation_size, ko), embed(spec.action_size, ka)
        return cls(*tokens, times, Transformer.create(layers, width, heads, kn), MLP.create(width, (), spec.action_size, kh))

    def __call__(
        self, return_to_go: Float[Array, "b k"], observation: Float[Array, "b k o"], action: Float[Array, "b k a"],
        time: Real[Array, "b k"], mask: Float[Array, "b k"], rate: Array | float = 0.0, key: PRNGKeyArray | None = None,
    ) -> Float[Array, "b k a"]:  # fmt: skip
        """Actions of all steps; that of a step sees its return-to-go, its observation, and all before them.

        Steps whose `mask` is 0 are not seen.
        """
        when = self.of_time[jnp.minimum(time, len(self.of_time) - 1).astype(jnp.int32)]
        tokens = self.of_return(return_to_go[..., None]), self.of_observation(observation), self.of_action(action)
        rows, steps = return_to_go.shape
        x = jnp.stack([token + when for token in tokens], 2).reshape(rows, 3 * steps, -1)
        x = dropped(standardised(x), rate, None if key is None else key_for(key, "tokens"))
        x = self.transformer(x, jnp.repeat(mask > 0, 3, 1), rate, None if key is None else key_for(key, "transformer"))
        return jnp.tanh(self.head(x[:, 1::3]))


class Memory(NamedTuple):
    """The last steps of each environment, the present one at the end of the window."""

    return_to_go: Float[Array, "n k"]
    observation: Float[Array, "n k o"]
    action: Float[Array, "n k a"]
    time: Float[Array, "n k"]
    mask: Float[Array, "n k"]


class DecisionTransformerPolicy(NormalizedPolicy):
    """Imitates the log's actions that led to the target return.

    Attributes:
        net: says actions.
        target_return: of an episode.
        scale: what returns are divided by.
        window: steps that are remembered.
    """

    net: DecisionTransformerNet
    target_return: Array
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
        return_to_go = jnp.where(first, self.target_return / self.scale, carry.return_to_go[:, -1] - step.reward / self.scale)
        time = jnp.where(first, 0.0, carry.time[:, -1] + 1.0)
        # What is done now is not known yet; nobody looks at its token.
        now = Memory(return_to_go, step.observation, jnp.zeros_like(carry.action[:, 0]), time, jnp.ones_like(time))
        carry = Memory(*(jnp.concatenate([past[:, 1:], new[:, None]], 1) for past, new in zip(carry, now)))
        action = self.net(*carry)[:, -1]
        return action, carry._replace(action=carry.action.at[:, -1].set(action))
