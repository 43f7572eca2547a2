"""A causal transformer, whose every layer is an `MLP`, so that it can be carried, stacked, saved and vmapped as those are."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from deadreckon.nets.mlp import MLP, standardised
from deadreckon.randomness import key_for, keys


class Block(eqx.Module):
    """Attention, then a network of one hidden layer, each beside a way around it; their inputs are standardised.

    Attributes:
        attend: to queries, keys and values, side by side.
        merge: of what all heads found.
        feed: of one hidden layer, four times as wide.
        heads: that attend side by side.
    """

    attend: MLP
    merge: MLP
    feed: MLP
    heads: int = eqx.field(static=True)

    @classmethod
    def create(cls, width: int, heads: int, key: PRNGKeyArray) -> "Block":
        """A fresh block; `heads` must divide `width`."""
        ka, km, kf = keys(key, "attend", "merge", "feed")
        feed = MLP.create(width, (4 * width,), width, kf)
        return cls(MLP.create(width, (), 3 * width, ka), MLP.create(width, (), width, km), feed, heads)

    def __call__(
        self, x: Float[Array, "b t w"], seen: Bool[Array, "b t t"], drop: Callable[[Array, str], Array]
    ) -> Float[Array, "b t w"]:
        """What becomes of tokens; `seen` tells which of them (last axis) each may look at; see `Transformer`."""
        parts = self.attend(standardised(x)).reshape(*x.shape[:-1], 3, self.heads, -1)
        found = jax.nn.dot_product_attention(parts[:, :, 0], parts[:, :, 1], parts[:, :, 2], mask=seen[:, None])
        x = x + drop(self.merge(found.reshape(x.shape)), "merge")
        return x + drop(self.feed(standardised(x)), "feed")


class Transformer(eqx.Module):
    """Blocks one after the other, each token looking at itself and what comes before it."""

    blocks: tuple[Block, ...]

    @classmethod
    def create(cls, layers: int, width: int, heads: int, key: PRNGKeyArray) -> "Transformer":
        """Fresh blocks."""
        return cls(tuple(Block.create(width, heads, k) for k in jax.random.split(key, layers)))

    def __call__(
        self, x: Float[Array, "b t w"], there: Bool[Array, "b t"], rate: Array | float = 0.0, key: PRNGKeyArray | None = None
    ) -> Float[Array, "b t w"]:
        """Standardised tokens behind the last block.

        Args:
            x: tokens.
            there: which of them are; nobody looks at the others.
            rate: share of numbers that are dropped behind every layer, where a key is given.
            key: of what is dropped; None drops nothing.
        """
        count = x.shape[1]
        before = jnp.tril(jnp.ones((count, count), bool))
        # Each may look at itself, so that no token looks at nothing.
        seen = (before & there[:, None, :]) | jnp.eye(count, dtype=bool)
        for i, block in enumerate(self.blocks):

            def drop(part: Array, which: str, i: int = i) -> Array:
                return dropped(part, rate, None if key is None else key_for(key, which, i))

            x = block(x, seen, drop)
        return standardised(x)


def dropped(x: Array, rate: Array | float, key: PRNGKeyArray | None) -> Array:
    """Each number zero with probability `rate`, the others made larger so that their mean stays; unchanged without a key."""
    if key is None:
        return x
    return jnp.where(jax.random.uniform(key, x.shape) < rate, 0.0, x / (1.0 - rate))
