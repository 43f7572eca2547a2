"""First states of the optimiser and copies of parameters, made on the host or within a program."""

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import ADAM, copy, init_opt
from deadreckon.training.learner import lane_of, stack, unstack


def kinds(tree):
    return [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(tree)]


def test_the_first_state_is_that_of_optax_within_a_program_and_without():
    net = MLP.create(3, (4,), 2, jax.random.key(0))
    for given in (net, jnp.log(jnp.asarray(2.0)), {"scale": jnp.ones((), jnp.bfloat16)}):
        theirs = ADAM.init(given)
        for ours in (init_opt(given), jax.jit(init_opt)(given)):
            assert jax.tree.structure(ours) == jax.tree.structure(theirs)
            assert kinds(ours) == kinds(theirs)
            assert not any(np.asarray(leaf).any() for leaf in jax.tree.leaves(ours))


def test_copies_share_no_memory():
    net = MLP.create(3, (4,), 2, jax.random.key(0))
    for own in (copy(net), jax.jit(copy)(net)):
        assert kinds(own) == kinds(net)
        for a, b in zip(jax.tree.leaves(own), jax.tree.leaves(net), strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.unsafe_buffer_pointer() != b.unsafe_buffer_pointer()


def test_lanes_come_apart_and_together():
    parts = [{"w": jnp.full((2, 3), i), "n": jnp.int32(i)} for i in range(3)]
    whole = stack(parts)
    assert whole["w"].shape == (3, 2, 3)
    for i, part in enumerate(unstack(whole, 3)):
        assert isinstance(part["w"], jax.Array)
        assert jax.tree.all(jax.tree.map(np.array_equal, part, parts[i]))
        assert jax.tree.all(jax.tree.map(np.array_equal, lane_of(whole, i), parts[i]))
