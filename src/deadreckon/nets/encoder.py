"""Networks that make features of pictures: what stands before the dense layers of agents that see.

All end alike: a dense layer, layer normalisation and tanh, as DrQ-v2 has it (Yarats et al. 2022, appendix B).
"""

import math
from functools import partial
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Num, PRNGKeyArray, UInt8

from deadreckon.errors import UserError
from deadreckon.nets.mlp import standardised

Kind = Literal["patches", "drq", "impala"]
"""`patches`: products with ever larger squares of pixels, which CPUs do fast; `drq`: four 3 x 3 convolutions (Yarats et al.
2022); `impala`: three stages of residual blocks (Espeholt et al. 2018)."""

PATCHES = ((4, 32), (2, 64), (2, 64))  # side of the squares, and outputs, of each layer
CONVOLUTIONS = ((2, 32), (1, 32), (1, 32), (1, 32))  # stride, and outputs
STAGES = (16, 32, 32)  # outputs
LEAST = 16  # pixels of height and width, below which convolutions without a margin leave nothing


class Encoder(eqx.Module):
    """Pictures (..., height, width, channels) of uint8 to features.

    Attributes:
        kernels: of its layers: (inputs, outputs) of patches, (3, 3, inputs, outputs) of convolutions, and of the last layer.
        biases: one (outputs,) a layer.
        network: see `Kind`.
        shape: of a picture: height, width, channels.
    """

    kernels: tuple[Float[Array, "..."], ...]
    biases: tuple[Float[Array, "*stack _"], ...]
    network: Kind = eqx.field(static=True)
    shape: tuple[int, int, int] = eqx.field(static=True)

    @classmethod
    def create(cls, kind: Kind, shape: tuple[int, ...], features: int, key: PRNGKeyArray) -> "Encoder":
        """A fresh network of orthogonal weights and biases of zero, as DrQ-v2's.

        Args:
            kind: see `Kind`.
            shape: of a picture: height, width, channels.
            features: that it gives.
            key: of the weights.

        Raises:
            UserError: an unknown kind, or not the shape of pictures.
        """
        if kind not in get_args(Kind):
            raise UserError(f"encoder is {kind!r}, one of {', '.join(get_args(Kind))} is needed")
        if len(shape) != 3 or min(shape[:2]) < LEAST:
            raise UserError(f"pictures have a height and a width of {LEAST} or more, and channels; got the shape {shape}")
        shapes = _shapes(kind, shape[-1])
        seen = (shape[0], shape[1], shape[2])

        def maps(pictures: Array) -> Array:  # of zeros, which are made nowhere: their shapes alone are asked for
            bare = cls(tuple(jnp.zeros(each) for each in shapes), tuple(jnp.zeros(each[-1]) for each in shapes), kind, seen)
            return bare.maps(pictures)

        flat = jax.eval_shape(maps, jax.ShapeDtypeStruct((1, *shape), jnp.uint8)).shape[1:]
        shapes.append((math.prod(flat), features))
        keys = jax.random.split(key, len(shapes))
        weights = [_orthogonal(k, each) for k, each in zip(keys, shapes)]
        return cls(tuple(weights), tuple(jnp.zeros(each[-1]) for each in shapes), kind, seen)

    @property
    def features(self) -> int:
        """Numbers that it makes of a picture."""
        return self.biases[-1].shape[-1]

    def __call__(self, pictures: Num[Array, "*b h w c"]) -> Float[Array, "*b f"]:
        """Features in (-1, 1) of numbers from 0 to 255."""
        lead = pictures.shape[:-3]
        maps = self.maps(pictures.reshape(-1, *pictures.shape[-3:]))
        out = maps.reshape(maps.shape[0], -1) @ self.kernels[-1] + self.biases[-1]
        return jnp.tanh(standardised(out)).reshape(*lead, -1)

    def maps(self, pictures: Num[Array, "n h w c"]) -> Float[Array, "n i j k"]:
        """What the last layer sees."""
        x = pictures.astype(jnp.float32) / 255.0 - 0.5
        if self.network == "patches":
            for (side, _), kernel, bias in zip(PATCHES, self.kernels, self.biases):
                x = jax.nn.relu(patches(x, side) @ kernel + bias)
            return x
        layers = iter(zip(self.kernels, self.biases))
        if self.network == "drq":
            for (stride, _), (kernel, bias) in zip(CONVOLUTIONS, layers):
                x = jax.nn.relu(_convolve(x, kernel, stride, "VALID") + bias)
            return x
        for _ in STAGES:
            x = _pool(_same(x, *next(layers)))
            for _ in range(2):
                inner = _same(jax.nn.relu(x), *next(layers))
                x = x + _same(jax.nn.relu(inner), *next(layers))
        return jax.nn.relu(x)


def patches(x: Float[Array, "n h w c"], side: int) -> Float[Array, "n i j k"]:
    """Squares of `side` x `side` pixels as one row each; pictures are filled up with zeros below and to the right."""
    n, height, width, channels = x.shape
    down, across = -(-height // side), -(-width // side)
    x = jnp.pad(x, ((0, 0), (0, down * side - height), (0, across * side - width), (0, 0)))
    x = x.reshape(n, down, side, across, side, channels).transpose(0, 1, 3, 2, 4, 5)
    return x.reshape(n, down, across, side * side * channels)


def shifted(pictures: UInt8[Array, "b h w c"], key: PRNGKeyArray, most: Any) -> UInt8[Array, "b h w c"]:
    """Each picture moved by up to `most` pixels either way, its edge repeated (Yarats et al. 2021, section 4.1)."""
    count, height, width, _ = pictures.shape
    moves = jax.random.randint(key, (2, count), -most, most + 1)
    rows = jnp.clip(jnp.arange(height) + moves[0, :, None], 0, height - 1)
    columns = jnp.clip(jnp.arange(width) + moves[1, :, None], 0, width - 1)
    return pictures[jnp.arange(count)[:, None, None], rows[:, :, None], columns[:, None, :]]


def _shapes(kind: Kind, channels: int) -> list[tuple[int, ...]]:
    """Of the kernels before the last layer."""
    shapes: list[tuple[int, ...]] = []
    if kind == "patches":
        for side, outputs in PATCHES:
            shapes.append((side * side * channels, outputs))
            channels = outputs
        return shapes
    if kind == "drq":
        for _, outputs in CONVOLUTIONS:
            shapes.append((3, 3, channels, outputs))
            channels = outputs
        return shapes
    for outputs in STAGES:
        shapes += [(3, 3, channels, outputs), *[(3, 3, outputs, outputs)] * 4]
        channels = outputs
    return shapes


@partial(jax.jit, static_argnames="shape")
def _orthogonal(key: PRNGKeyArray, shape: tuple[int, ...]) -> Array:
    flat = jax.nn.initializers.orthogonal(2.0**0.5)(key, (math.prod(shape[:-1]), shape[-1]))
    return flat.reshape(shape)


def _convolve(x: Array, kernel: Array, stride: int, padding: Any) -> Array:
    return jax.lax.conv_general_dilated(x, kernel, (stride, stride), padding, dimension_numbers=("NHWC", "HWIO", "NHWC"))


def _same(x: Array, kernel: Array, bias: Array) -> Array:
    return _convolve(x, kernel, 1, "SAME") + bias


def _pool(x: Array) -> Array:
    """The largest of 3 x 3, at every second place."""
    return jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (1, 3, 3, 1), (1, 2, 2, 1), "SAME")
