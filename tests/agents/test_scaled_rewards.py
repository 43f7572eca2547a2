"""Rewards in other units: resolved from the log, applied to every batch, and gone where values are told."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from deadreckon.agents import AWAC, CQL, FQL, IQL, SACN, ReBRAC
from deadreckon.data.batch import Batch
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Spec
from deadreckon.errors import UserError
from deadreckon.nets.optim import cosine_decay
from deadreckon.training.fit import fit
from tests.agents import tiny

AGENTS = [IQL, AWAC, CQL, FQL, ReBRAC, SACN]


def log_of(rewards, ends):
    rng = np.random.default_rng(0)
    n = len(rewards)
    return Dataset.from_arrays(
        observations=rng.normal(size=(n, 1)), actions=rng.uniform(-0.9, 0.9, (n, 1)), rewards=rewards, terminals=ends,
        action_space=Box((-1.0,), (1.0,)),
    )  # fmt: skip


LOG = log_of([1.0, 2.0, 3.0, 0.5, 0.5, 4.0], [False, False, True, False, True, True])  # returns 6, 1 and 4


@pytest.mark.parametrize("kind", AGENTS)
def test_the_scale_is_of_the_logs_returns(kind):
    assert LOG.spec.returns == (1.0, 6.0)
    agent = kind(normalized_return_range=1000.0, reward_shift=-1.0).resolve(LOG.spec, 10)
    assert agent.reward_scale == pytest.approx(200.0)
    np.testing.assert_allclose(agent.learned(Batch(reward=jnp.asarray([1.0, 0.5]))).reward, [199.0, 99.0])
    assert kind().resolve(LOG.spec, 10).reward_scale == 1.0
    assert kind(reward_scale=3.0).resolve(LOG.spec, 10).reward_scale == 3.0
    assert agent.resolve(LOG.spec, 10).reward_scale == agent.reward_scale  # resolved once more, as on resume


def test_standardised_rewards_have_mean_zero_and_deviation_one():
    agent = SACN(standardise_rewards=True).resolve(LOG.spec, 10)
    rewards = np.asarray(LOG.rewards)
    learned = agent.learned(Batch(reward=jnp.asarray(rewards))).reward
    np.testing.assert_allclose(learned, (rewards - rewards.mean()) / rewards.std(), rtol=1e-5)
    assert agent.resolve(LOG.spec, 10) == agent  # as on resume


def test_what_cannot_be_is_refused_in_one_line():
    both = "IQL takes reward_scale or normalized_return_range, got both; reward_scale=None leaves the scale to the other"
    with pytest.raises(UserError, match=both):
        IQL(reward_scale=2.0, normalized_return_range=5.0).resolve(LOG.spec, 10)
    with pytest.raises(UserError, match="standardise_rewards sets the scale .* of rewards: .* and set reward_scale to None"):
        IQL(standardise_rewards=True, reward_scale=2.0).resolve(LOG.spec, 10)
    with pytest.raises(UserError, match="IQL.standardise_rewards needs a log, whose rewards it standardises"):
        IQL(standardise_rewards=True).resolve(Spec.empty((1,), Box((-1.0,), (1.0,)), "online"), 10)
    even = log_of([1.0, 1.0], [True, True])
    with pytest.raises(UserError, match=r"standardise_rewards needs rewards that differ; all of .* are 1"):
        IQL(standardise_rewards=True).resolve(even.spec, 10)
    same = log_of([1.0, 2.0, 3.0], [False, True, True])
    with pytest.raises(UserError, match=r"needs episodes with different returns; all of .* have 3: give reward_scale instead"):
        IQL(normalized_return_range=5.0).resolve(same.spec, 10)


@pytest.mark.parametrize("name", [
    pytest.param(name, id=kind.__name__, marks=() if kind is IQL else pytest.mark.slow)
    for name, kind in zip(("iql", "awac", "cql", "fql", "rebrac", "sac_n"), AGENTS, strict=True)
])  # fmt: skip
def test_training_on_scaled_rewards_is_training_on_a_log_that_has_them(name):
    """The same log in two units: agents that scale the one learn the same networks as those that are given the other.

    The programs are those of the conformance tests.
    """
    scaled = dataclasses.replace(tiny.LOG, rewards=10.0 * np.asarray(tiny.LOG.rewards, np.float32) - 5.0, part_of=None)

    def learned(log, **fields):
        agent = tiny.small(name, **fields)
        return fit([agent, agent], tiny.rows_of(agent, log), [0, 1], 6, chunk=3).states

    ours, theirs = learned(tiny.LOG, reward_scale=10.0, reward_shift=-5.0), learned(scaled)
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", AGENTS)
def test_values_are_told_in_the_logs_units(kind):
    plain = kind(hidden=(8, 8)).resolve(LOG.spec, 6)
    state = jax.jit(lambda key: plain.init(LOG.spec, key))(jax.random.key(0))
    value = jax.jit(lambda agent, state: agent.q_value(state, jnp.ones((3, 1)), jnp.zeros((3, 1))))
    told = value(plain, state)
    assert np.isfinite(told).all()
    assert np.abs(told).max() > 0
    shifted = plain.replace(reward_scale=10.0, reward_shift=-5.0)
    assert np.isnan(value(shifted, state)).all()  # a shift counts by how long episodes last
    np.testing.assert_allclose(value(plain.replace(reward_scale=0.5), state), 2.0 * told, rtol=1e-6)


def test_a_learning_rate_falls_along_a_cosine_as_optax_has_it():
    schedule = optax.cosine_decay_schedule(3e-4, 1000)
    for step in (0, 1, 250, 500, 999, 1000, 5000):
        np.testing.assert_allclose(cosine_decay(3e-4, jnp.int32(step), 1000.0), schedule(step), rtol=1e-5, atol=1e-10)
        np.testing.assert_allclose(cosine_decay(3e-4, jnp.int32(step), 0.0), 3e-4)


def test_iqls_actor_rests_when_its_learning_rate_has_fallen():
    agent = IQL(hidden=(8, 8), batch_size=4).resolve(LOG.spec, 6)
    assert agent.actor_decay_steps == 6.0
    assert IQL(actor_decay_steps=0.0).resolve(LOG.spec, 6).actor_decay_steps == 0.0
    small = tiny.small("iql", actor_decay_steps=6.0)
    at_the_end, later = (fit([small, small], tiny.rows_of(small), [0, 1], steps, chunk=6).states for steps in (6, 12))
    for a, b in zip(jax.tree.leaves(at_the_end.actor), jax.tree.leaves(later.actor), strict=True):
        np.testing.assert_array_equal(a, b)
    assert any(map(lambda a, b: bool((a != b).any()), jax.tree.leaves(at_the_end.value), jax.tree.leaves(later.value)))
