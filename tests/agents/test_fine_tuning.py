"""Cal-QL and RLPD against numpy written from their equations, and what agents change when they go on online."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp

from deadreckon.agents import CQL, IQL, RLPD, CalQL
from deadreckon.errors import UserError
from deadreckon.nets.mlp import minimum, q_values
from deadreckon.randomness import keys
from tests.agents.test_actor_critics import log_prob, q, transitions
from tests.agents.test_bear import lane, numpy_gaussian
from tests.agents.test_offline import KEY, SPEC, made, updated
from tests.nets.test_mlp import numpy_mlp

RETURNS = np.array([[0.3, 2.0], [-0.4, 1.0], [0.1, 5.0], [0.0, 3.0], [0.2, 1.0], [-np.inf, 0.0]], np.float32)
CALIBRATED = {"hidden": (16, 16), "critic_hidden": (16, 16), "samples": 2, "max_target_backup": False}


@pytest.fixture(scope="module")
def batch():
    return transitions()._replace(monte_carlo=jnp.asarray(RETURNS))


# ---- Cal-QL -----------------------------------------------------------------------------------------------------------


def test_cal_qls_term_holds_the_policys_actions_down_to_the_return_and_no_further(batch):
    agent, state = made(CalQL(cql_weight=3.0, reward_scale=2.0, reward_shift=-0.1, **CALIBRATED))
    target = jnp.arange(6.0)
    loss, _ = agent.critic_loss(state.critics, state, batch, target, KEY)
    reference = 2.0 * RETURNS[:, 0] - 0.1 * RETURNS[:, 1]  # in the units that are learned from
    k_uniform, k_now, k_next = keys(KEY, "uniform", "now", "next")
    uniform = np.asarray(jax.random.uniform(k_uniform, (2, 6, 1), minval=-1.0, maxval=1.0))
    expected, lifted = 0.0, []
    for j in range(2):
        parts = [q(state.critics, j, batch.observation, a) + np.log(2) for a in uniform]
        for k, seen in ((k_now, batch.observation), (k_next, batch.next_observation)):
            mean, log_std = numpy_gaussian(state.actor, seen)
            for noise in np.asarray(jax.random.normal(k, (2, 6, 1))):
                pre = mean + np.exp(log_std) * noise
                value = q(state.critics, j, batch.observation, np.tanh(pre))
                lifted.append(value < reference)
                parts.append(np.maximum(value, reference) - log_prob(mean, log_std, pre))
        logged = q(state.critics, j, batch.observation, batch.action)
        expected += ((logged - np.arange(6)) ** 2).mean() + 3.0 * (logsumexp(parts, 0) - logged).mean()
    assert 0 < np.mean(lifted) < 1
    np.testing.assert_allclose(loss, expected, rtol=1e-4)


@pytest.mark.slow
def test_where_no_return_is_known_cal_ql_is_cql_to_the_bit(batch):
    unknown = batch._replace(monte_carlo=jnp.tile(jnp.asarray([-jnp.inf, 0.0]), (6, 1)))
    fields = {"hidden": (16, 16), "samples": 2, "reward_shift": -1.0, "temperature_lr": 1e-4, "max_target_backup": True}
    calibrated, state = made(CalQL(critic_hidden=(16, 16), **fields))
    plain, other = made(CQL(**fields))
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True))
    ours, metrics = updated(calibrated.agent, state, unknown)
    theirs, same = updated(plain.agent, state, unknown)
    assert metrics == same
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True))
    high = unknown._replace(monte_carlo=jnp.asarray([[50.0, 0.0]] * 6))
    assert updated(calibrated.agent, state, high)[1]["gap"] > 10.0 > metrics["gap"]


@pytest.mark.slow
def test_critics_of_cal_ql_may_be_deeper_than_its_actor():
    _, state = made(CalQL(hidden=(8,), critic_hidden=(8, 8, 8)))
    assert (len(state.actor.weights), len(state.critics.weights), len(state.target_critics.weights)) == (2, 4, 4)


@pytest.mark.parametrize(("agent", "words"), [
    (CalQL(form="rho"), "CalQL.form takes 'H', got 'rho'"),
    (CalQL(discount=1.0), "CalQL.discount takes a number below 1, got 1.0"),
    (RLPD(subset="2"), "RLPD.subset takes a whole number >= 1, got '2'"),
    (RLPD(critics=3, subset=4), r"RLPD.subset takes a number up to critics \(3\), got 4"),
])  # fmt: skip
def test_refuses(agent, words):
    with pytest.raises(UserError, match=words):
        agent.resolve(SPEC, 10)


# ---- RLPD -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rlpd():
    return made(RLPD(hidden=(16, 16), critics=5, discount=0.9, policy_freq=3, temperature=0.5))


def test_rlpds_target_is_the_least_of_a_random_pair_of_normalised_critics(rlpd, batch):
    agent, state = rlpd
    assert state.critics.normalise
    assert agent.target_entropy == -0.5
    chosen, apart = set(), 0.0
    for key in jax.random.split(jax.random.key(3), 8):
        k_subset, k_noise = keys(key, "subset", "noise")
        mean, log_std = numpy_gaussian(state.actor, batch.next_observation)
        pre = mean + np.exp(log_std) * np.asarray(jax.random.normal(k_noise, (6, 1)))
        values = np.stack([q(state.target_critics, j, batch.next_observation, np.tanh(pre)) for j in range(5)])
        drawn = np.asarray(jax.random.choice(k_subset, 5, (2,), replace=False))
        future = values[drawn].min(0) - 0.5 * log_prob(mean, log_std, pre)
        expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * future
        np.testing.assert_allclose(agent.target(state, batch, key), expected, atol=1e-5)
        chosen.add(tuple(sorted(drawn.tolist())))
        apart = max(apart, (values[drawn].min(0) - values.min(0)).max())
    assert len(chosen) > 3
    assert apart > 1e-3


def test_rlpds_actor_climbs_the_mean_of_all_critics(rlpd, batch):
    agent, state = rlpd
    loss, entropy = agent.actor_loss(state.actor, state, batch, KEY)
    mean, log_std = numpy_gaussian(state.actor, batch.observation)
    pre = mean + np.exp(log_std) * np.asarray(jax.random.normal(KEY, (6, 1)))
    value = np.mean([q(state.critics, j, batch.observation, np.tanh(pre)) for j in range(5)], 0)
    np.testing.assert_allclose(loss, (0.5 * log_prob(mean, log_std, pre) - value).mean(), rtol=1e-4)
    np.testing.assert_allclose(entropy, log_prob(mean, log_std, pre).mean(), rtol=1e-4)


@pytest.mark.slow
def test_rlpds_actor_and_temperature_move_at_the_end_of_every_so_many_updates(rlpd, batch):
    agent, state = rlpd
    update = jax.jit(lambda s, step: agent.update(s, batch, step=step, key=KEY))
    for step, moves in ((0, False), (1, False), (2, True), (3, False), (5, True)):
        new, metrics = update(state, jnp.int32(step))
        still = [np.array_equal(a, b) for a, b in zip(jax.tree.leaves(new.actor), jax.tree.leaves(state.actor))]
        assert all(still) != moves
        assert (new.log_temperature != state.log_temperature) == moves
        assert (metrics["actor_loss"] != 0) == moves
        assert not np.array_equal(new.critics.weights[0], state.critics.weights[0])
    np.testing.assert_allclose(
        new.target_critics.weights[0], 0.995 * state.target_critics.weights[0] + 0.005 * new.critics.weights[0], atol=1e-6
    )


@pytest.mark.slow
def test_values_of_rlpd_are_means_in_the_units_of_the_log(batch):
    agent, state = made(RLPD(hidden=(16, 16), critics=3, reward_scale=4.0))
    value = q_values(state.critics, batch.observation, batch.action)
    np.testing.assert_allclose(agent.q_value(state, batch.observation, batch.action), value.mean(0) / 4.0, rtol=1e-5)
    np.testing.assert_array_equal(agent.target_q(value), minimum(value))
    hidden = numpy_mlp(lane(state.critics, 0), np.concatenate([batch.observation, batch.action], -1))[:, 0]
    np.testing.assert_allclose(value[0], hidden, atol=1e-5)


# ---- what changes when they go on ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_schedules_of_the_run_on_the_log_are_over(batch):
    agent, state = made(IQL(hidden=(16, 16)))
    assert agent.actor_decay_steps == 10.0
    late = jax.jit(lambda a, s: a.update(s, batch, step=jnp.int32(10), key=KEY)[0].actor, static_argnums=())
    still = [np.array_equal(a, b) for a, b in zip(jax.tree.leaves(late(agent.agent, state)), jax.tree.leaves(state.actor))]
    assert all(still)
    moved = jax.tree.leaves(late(agent.going_on(), state))
    assert not all(np.array_equal(a, b) for a, b in zip(moved, jax.tree.leaves(state.actor)))
    assert made(CQL(warm_start=5))[0].going_on().warm_start == 0
    assert made(CalQL(warm_start=5))[0].going_on().warm_start == 0
