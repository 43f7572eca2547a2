import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.nets.encoder import Encoder, patches, shifted
from deadreckon.policies import portable_pictures
from tests.marks import slow


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_patches_are_squares_of_pixels(rng):
    x = rng.normal(size=(2, 5, 6, 3)).astype(np.float32)
    found = np.asarray(jax.jit(patches, static_argnums=1)(x, 4))
    assert found.shape == (2, 2, 2, 48)
    np.testing.assert_array_equal(found[1, 0, 0], x[1, :4, :4].reshape(-1))
    last = np.zeros((4, 4, 3), np.float32)  # one row and two columns are left, the rest is filled up
    last[:1, :2] = x[1, 4:, 4:]
    np.testing.assert_array_equal(found[1, 1, 1], last.reshape(-1))


def test_shifts_move_pictures_and_repeat_their_edge(rng):
    pictures = rng.integers(0, 256, (64, 7, 9, 2)).astype(np.uint8)
    moved = np.asarray(jax.jit(shifted, static_argnums=2)(pictures, jax.random.key(0), 2))
    padded = np.pad(pictures, ((0, 0), (2, 2), (2, 2), (0, 0)), mode="edge")
    places = set()
    for before, after in zip(padded, moved):
        fits = [
            (row, column)
            for row, column in itertools.product(range(5), repeat=2)
            if (before[row : row + 7, column : column + 9] == after).all()
        ]
        assert len(fits) == 1
        places.add(fits[0])
    assert len(places) > 15  # of 25


@pytest.mark.parametrize(("kind", "shape"), [
    ("impala", (19, 24, 3)), *slow(("patches", (48, 48, 3)), ("drq", (20, 31, 6))),
])  # fmt: skip
def test_numpy_makes_the_same_features(kind, shape, rng):
    noise = lambda leaf: 0.01 * np.asarray(jax.random.normal(jax.random.key(1), leaf.shape))  # noqa: E731
    encoder = jax.tree.map(lambda leaf: np.asarray(leaf) + noise(leaf), Encoder.create(kind, shape, 12, jax.random.key(3)))
    pictures = rng.integers(0, 256, (4, *shape)).astype(np.uint8)
    arrays = {f"k{i}": np.asarray(k) for i, k in enumerate(encoder.kernels)}
    arrays |= {f"b{i}": np.asarray(b) for i, b in enumerate(encoder.biases)}
    node = {"network": kind, "shape": list(shape), "kernels": [f"@k{i}" for i in range(len(encoder.kernels))],
            "biases": [f"@b{i}" for i in range(len(encoder.biases))]}  # fmt: skip
    found = np.asarray(jax.jit(lambda encoder, x: encoder(x))(encoder, pictures))
    assert found.shape == (4, encoder.features) == (4, 12)
    np.testing.assert_allclose(portable_pictures.features(node, arrays, pictures), found, atol=2e-6)
    assert np.abs(found).max() < 1.0
    with pytest.raises(ValueError, match="takes images of shape"):
        portable_pictures.features(node, arrays, pictures[:, 1:])


@pytest.mark.parametrize("kind", ["patches", *slow("drq", "impala")])
def test_features_tell_pictures_apart_and_have_slopes(kind, rng):
    encoder = Encoder.create(kind, (24, 24, 3), 16, jax.random.key(0))
    pictures = jnp.asarray(rng.integers(0, 256, (3, 2, 24, 24, 3)), jnp.uint8)

    @partial(jax.value_and_grad, has_aux=True)
    def loss(encoder):
        found = encoder(pictures)  # any leading axes
        return (found**2).sum(), (found, encoder(pictures[1]))

    (_, (found, alone)), slopes = jax.jit(loss)(encoder)
    found = np.asarray(found)
    assert found.shape == (3, 2, 16)
    np.testing.assert_allclose(found[1], alone, atol=1e-6)
    assert float(np.std(found.reshape(6, 16), 0).mean()) > 1e-3
    assert all(np.abs(leaf).max() > 0 for leaf in jax.tree.leaves(slopes.kernels))


def test_what_it_refuses():
    with pytest.raises(UserError, match="encoder is 'resnet', one of patches, drq, impala is needed"):
        Encoder.create("resnet", (48, 48, 3), 8, jax.random.key(0))
    with pytest.raises(UserError, match=r"16 or more, and channels; got the shape \(8, 48, 3\)"):
        Encoder.create("patches", (8, 48, 3), 8, jax.random.key(0))
