"""Branched rollouts of a model whose members each do something else, so that it can be seen whose step it was."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.dynamics import Ensemble, Model, branches, rollout, transition
from deadreckon.policies.policy import NormalizedPolicy


class Counting(Model):
    """Member i adds `params[i]` to the first number and half the action to the second; the reward is the action."""

    def sample(self, params, inputs, key):
        """See `Model`."""
        steps = jnp.broadcast_to(params[:, None], inputs.shape[:2])
        action = inputs[..., 2]
        return jnp.stack([steps, 0.5 * action, action], -1), jnp.full(inputs.shape[:2], jnp.inf)


class Half(NormalizedPolicy):
    """Always one half."""

    def pre_actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`."""
        return jnp.full((*observation.shape[:-1], 1), jnp.arctanh(0.5))


def ensemble(members, elites):
    return Ensemble(jnp.asarray(members, jnp.float32), None, jnp.zeros(3), jnp.ones(3), jnp.asarray(elites))


def test_elites_predict_equally_often_where_rows_do_not_divide():
    """Six rows and five elites: shares of two, of which the last two elites of the order have none."""
    model, states, times = Counting(members=5), ensemble(10.0 ** np.arange(5), [0, 1, 2, 3, 4]), 200
    step = jax.jit(
        jax.vmap(lambda key: transition(model, states, lambda o: o[:, 0] < 0, jnp.zeros((6, 2)), jnp.zeros((6, 1)), key))
    )
    moved = np.asarray(step(jax.random.split(jax.random.key(0), times))[1])[..., 0]
    steps, counts = np.unique(moved, return_counts=True)
    np.testing.assert_array_equal(steps, 10.0 ** np.arange(5))
    np.testing.assert_allclose(counts / times, 6 / 5, atol=0.3)


@pytest.mark.slow
def test_every_step_is_an_elites_and_all_have_equal_shares():
    starts = jnp.zeros((60, 2))
    found = branches(Counting(members=4), ensemble([1, 10, 100, 1000], [0, 2, 3]), Half(), starts, 3, jax.random.key(0),
                     lambda following: jnp.zeros(len(following), bool))  # fmt: skip
    steps = np.stack([np.asarray(b.next_observation - b.observation)[:, 0] for b in found], 1)
    for t in range(3):
        assert dict(zip(*np.unique(steps[:, t], return_counts=True))) == {1.0: 20, 100.0: 20, 1000.0: 20}
    assert len(np.unique(steps, axis=0)) > 15  # not the same elite all the way
    for before, after in pairwise(found):
        np.testing.assert_array_equal(after.observation, before.next_observation)
    np.testing.assert_allclose(found[2].next_observation[:, 1], 3 * 0.25, rtol=1e-6)
    np.testing.assert_allclose(found[1].reward, 0.5, rtol=1e-6)
    assert all(b.running.all() for b in found)


@pytest.mark.slow
def test_blocks_of_rows_are_put_together_again(monkeypatch):
    """Rows stand where they stood, also where blocks do not divide them."""
    monkeypatch.setattr(rollout, "BLOCK", 5)
    starts = jnp.stack([jnp.arange(23.0), jnp.zeros(23)], 1)
    found = branches(Counting(members=2), ensemble([100, 200], [0, 1]), Half(), starts, 2, jax.random.key(0),
                     lambda following: following[:, 0] % 100 == 7)  # fmt: skip
    np.testing.assert_array_equal(found[0].observation, starts)
    np.testing.assert_array_equal(np.asarray(found[0].next_observation)[:, 0] % 100, np.arange(23))
    assert set(np.unique(found[0].next_observation[:, 0] // 100)) == {1.0, 2.0}
    np.testing.assert_array_equal(found[0].terminal, np.arange(23) == 7)
    np.testing.assert_array_equal(found[1].running, np.arange(23) != 7)


class Drawing(Counting):
    """Changes are draws."""

    def sample(self, params, inputs, key):
        """See `Model`."""
        return jax.random.normal(key, (*inputs.shape[:2], 3)), jnp.full(inputs.shape[:2], -jnp.inf)


@pytest.mark.slow
def test_blocks_draw_on_their_own(monkeypatch):
    monkeypatch.setattr(rollout, "BLOCK", 6)
    found = branches(Drawing(members=2), ensemble([1, 2], [0, 1]), Half(), jnp.zeros((12, 2)), 1, jax.random.key(0))
    assert len(np.unique(np.asarray(found[0].reward))) == 12


@pytest.mark.slow
def test_what_has_ended_runs_no_more():
    starts = jnp.stack([jnp.arange(6.0), jnp.zeros(6)], 1)
    found = branches(Counting(members=1), ensemble([1], [0]), Half(), starts, 3, jax.random.key(0),
                     lambda following: following[:, 0] >= 5.0)  # fmt: skip
    running = np.stack([b.running for b in found], 1)
    np.testing.assert_array_equal(running.sum(1), [3, 3, 3, 2, 1, 1])
    np.testing.assert_array_equal(found[0].terminal, [False] * 4 + [True] * 2)
    # Asked itself, this model is sure that everything ends.
    alone = branches(Counting(members=1), ensemble([1], [0]), Half(), starts, 2, jax.random.key(0))
    assert alone[0].terminal.all()
    assert not alone[1].running.any()


@pytest.mark.slow
def test_numbers_that_go_bad_are_no_rows():
    found = branches(Counting(members=2), ensemble([1, np.nan], [0, 1]), Half(), jnp.zeros((10, 2)), 2, jax.random.key(0),
                     lambda following: jnp.zeros(len(following), bool))  # fmt: skip
    assert np.asarray(found[0].running).sum() == 5
    assert np.asarray(found[1].running).sum() <= 5
    assert np.isfinite(np.asarray(found[1].next_observation)[np.asarray(found[1].running)]).all()


@pytest.mark.slow
def test_the_same_key_gives_the_same_rollouts():
    run = lambda key: branches(Counting(members=2), ensemble([1, 2], [0, 1]), Half(), jnp.zeros((8, 2)), 2, key)  # noqa: E731
    one, two, other = run(jax.random.key(0)), run(jax.random.key(0)), run(jax.random.key(1))
    np.testing.assert_array_equal(one[1].next_observation, two[1].next_observation)
    assert (np.asarray(one[0].next_observation) != np.asarray(other[0].next_observation)).any()
