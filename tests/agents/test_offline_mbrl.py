"""Offline agents with a model: what a batch holds, and each one's doubt against numbers by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import COMBO, MOBILE, MOPO, MOReL
from deadreckon.agents.cql import soft_maximum
from deadreckon.agents.mopo import deviation
from deadreckon.agents.morel import units
from deadreckon.agents.offline_mbrl import OfflineMBRL
from deadreckon.agents.sac import HOTTEST
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.dynamics import Branch
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.training.fit import fit
from tests.agents.compiled import begun
from tests.agents.tiny import MODEL
from tests.agents.worlds import corridor

TINY = MODEL | {"hidden": (8,), "batch_size": 16, "real_batch_size": 6, "rollout_batch_size": 8, "retain_rounds": 2}


def walk(n=120, seed=0):
    """A log of a point that is pushed about, in episodes of 20 steps."""
    rng = np.random.default_rng(seed)
    s, a = rng.standard_normal((n, 2)).astype(np.float32), rng.uniform(-1, 1, (n, 1)).astype(np.float32)
    ends = np.arange(n) % 20 == 19
    return Dataset.from_arrays(
        observations=s, actions=a, rewards=s[:, 0], terminals=ends, name="walk",
        final_observations=rng.standard_normal((ends.sum(), 2)).astype(np.float32),
    )  # fmt: skip


LOG = walk()


def prepared(kind, turns=1, **fields):
    agent = kind(**TINY | fields).resolve(LOG.spec, 10)
    rows = TransitionSource(LOG, agent.needs(LOG.spec))
    state = begun(agent, LOG.spec)
    for turn in range(turns):
        state = agent.prepare(state, rows, jax.random.key(turn), None)
    return agent, rows, state


def batch_of(rows, n=16):
    return Batch(**{name: jnp.asarray(column) for name, column in rows.take(np.arange(n)).items()})


@pytest.mark.slow
def test_a_batch_is_logged_rows_and_made_up_ones():
    agent, rows, state = prepared(OfflineMBRL)
    assert int(state.model.turns) == 1
    first = np.asarray(state.model.rows[0])
    assert (np.asarray(state.model.rows[1]) == 0).all()
    logged = batch_of(rows)
    mixed = agent.mixed(state, logged, jax.random.key(3))
    for name in ("observation", "action", "reward", "next_observation", "terminal"):
        np.testing.assert_array_equal(getattr(mixed, name)[:6], getattr(logged, name)[:6])
    made = np.concatenate([np.asarray(getattr(mixed, name)).reshape(16, -1) for name in mixed._fields[:5]], 1)[6:]
    assert all((first == row).all(1).any() for row in made)  # from the slot that is filled alone
    starts = first[(first[:, None, :2] == np.asarray(LOG.observations)).all(-1).any(1)]
    assert len(starts) >= 8  # rollouts begin at logged observations
    _, _, later = prepared(OfflineMBRL, turns=3)
    assert (np.asarray(later.model.rows[0]) != first).any()  # the oldest slot was used again
    for one, other in zip(jax.tree.leaves(later.model.ensemble), jax.tree.leaves(state.model.ensemble)):
        np.testing.assert_array_equal(one, other)  # the model is fitted once


def test_ends_are_known_of_known_logs_and_where_a_task_is_said():
    def agent(name, shape=(11,), **fields):
        return MOPO(**TINY | fields).resolve(dataclasses.replace(LOG.spec, name=name, observation_shape=shape), 10)

    assert (agent("walk").termination, agent("walk").over) == ("learned", None)
    hopper = agent("hopper-medium-v2@dr1")
    standing = np.zeros((2, 11), np.float32)
    standing[0, 0] = 1.25
    np.testing.assert_array_equal(hopper.over(standing), [False, True])
    assert hopper.over == agent("hopper-expert-v2").over == agent("walk", termination="hopper").over
    assert agent("maze2d-umaze-v1").termination == "learned"  # its observations do not tell
    assert agent("hopper").termination == "learned"  # a log that has a task's name is not known to be the task's
    assert agent("ant") == agent("walk")  # nor has it the task's settings
    assert agent("hopper-medium-v2", termination="learned").over is None
    with pytest.raises(UserError, match=r"termination='hopper': its observations are \(11,\), walk has \(2,\)"):
        agent("walk", shape=(2,), termination="hopper")
    with pytest.raises(UserError, match="maze2d-umaze: its observations do not show when an episode ends"):
        agent("walk", termination="maze2d-umaze")


@pytest.mark.slow
def test_mopo_lowers_rewards_by_the_greatest_deviation():
    agent, rows, state = prepared(MOPO)
    logged = batch_of(rows)
    branch = Branch(*logged[:5], jnp.ones(16, bool))
    inputs = np.concatenate([logged.observation, logged.action], 1)
    seen = (inputs - np.asarray(state.model.ensemble.mean)) / np.asarray(state.model.ensemble.std)
    deviations = []
    for i in range(3):
        one = jax.tree.map(lambda leaf, i=i: leaf[i], state.model.ensemble.params)
        log_variance = np.asarray(agent.model._heads(one["nets"], one["bounds"], jnp.asarray(seen, jnp.float32))[1])
        deviations.append(np.sqrt(np.exp(log_variance).sum(1)))
    np.testing.assert_allclose(deviation(agent.model, state.model.ensemble, branch), np.max(deviations, 0), rtol=1e-4)
    lowered = agent.replace(penalty=2.0).penalised(state.model.ensemble, [branch], rows)[0]
    np.testing.assert_allclose(lowered.reward, logged.reward - 2.0 * np.max(deviations, 0), rtol=1e-4)
    np.testing.assert_array_equal(lowered.next_observation, branch.next_observation)


@pytest.mark.slow
def test_mobile_lowers_values_by_the_disagreement_of_backups():
    agent, rows, state = prepared(MOBILE, samples=2000, penalty=3.0)
    logged = batch_of(rows)
    mixed, plain = (each.mixed(state, logged, jax.random.key(3)) for each in (agent, agent.replace(penalty=0.0)))
    np.testing.assert_array_equal(mixed.reward[:6], logged.reward[:6])
    doubt = (plain.reward - mixed.reward)[6:] / 3.0
    assert (doubt > 0).all()
    # A critic that sees the first number alone: the deviation of the networks' means of it.
    first = MLP((jnp.array([[1.0], [0.0], [0.0]])[None].repeat(2, 0),), (jnp.zeros((2, 1)),))
    seen = agent.inconsistency(state._replace(target_critics=first), state.model.ensemble, plain, jax.random.key(0))
    inputs = state.model.ensemble.standardise(jnp.concatenate([plain.observation, plain.action], 1))
    means, log_variance, _ = agent.model.heads(state.model.ensemble.best(), jnp.broadcast_to(inputs, (2, *inputs.shape)))
    wanted = np.asarray(means)[..., 0].std(0, ddof=1)
    noise = float(np.exp(0.5 * np.asarray(log_variance)[..., 0]).max()) / np.sqrt(2000)
    np.testing.assert_allclose(seen, wanted, atol=5 * noise)
    low = agent.replace(min_target=0.5).target(state, plain, jax.random.key(0))
    free = agent.replace(min_target=None).target(state, plain, jax.random.key(0))
    np.testing.assert_allclose(low, np.maximum(free, 0.5))
    assert (np.asarray(free) < 0.5).any()


@pytest.mark.slow
def test_combo_holds_critics_down():
    agent, rows, state = prepared(COMBO, samples=4000)
    batch = batch_of(rows)
    # A critic that is constant has log 2^size of it, and the number of draws.
    flat = MLP((jnp.zeros((2, 3, 1)),), (jnp.full((2, 1), 0.7),))
    wanted = 0.7 + np.log(2.0) + np.log(3 * 4000)
    np.testing.assert_allclose(soft_maximum(flat, state.actor, batch, 4000, jax.random.key(0)), wanted, atol=0.1)
    # One that rises with the action: the integral of exp(a) over [-1, 1].
    rising = MLP((jnp.array([[0.0], [0.0], [1.0]])[None].repeat(2, 0),), (jnp.zeros((2, 1)),))
    wanted = np.log(np.exp(1) - np.exp(-1)) + np.log(3 * 4000)
    np.testing.assert_allclose(soft_maximum(rising, state.actor, batch, 4000, jax.random.key(0)), wanted, atol=0.15)
    critics, target, key = state.critics, jnp.zeros(16), jax.random.key(1)
    with_it, metrics = agent.critic_loss(critics, state, batch, target, key)
    without, _ = agent.replace(cql_weight=0.0).critic_loss(critics, state, batch, target, key)
    high = soft_maximum(critics, state.actor, batch, 4000, key).mean(1)
    logged = q_values(critics, batch.observation[:6], batch.action[:6]).mean(1)
    assert with_it - without == pytest.approx(5.0 * float((high - logged).sum()), rel=1e-4)
    assert metrics["gap"] == pytest.approx(float((high - logged).mean()), rel=1e-5)
    squares = np.square(np.asarray(q_values(critics, batch.observation, batch.action))).mean(1).sum()
    assert without == pytest.approx(squares, rel=1e-5)


@pytest.mark.slow
def test_a_lane_whose_model_goes_bad_fails_alone():
    lanes = [MOPO(**TINY | {"model_lr": lr}).resolve(LOG.spec, 4) for lr in (1e-3, 1e30)]
    fitted = fit(lanes, TransitionSource(LOG, lanes[0].needs(LOG.spec)), [0, 1], 4)
    assert fitted.failures == (None, ("model (while preparing)", 0))
    assert np.isfinite(fitted.lane(0).critics.weights[0]).all()


@pytest.mark.slow
def test_targets_without_the_entropy_bonus():
    agent, rows, state = prepared(COMBO)
    batch, key = batch_of(rows), jax.random.key(5)
    d = dist.gaussian_head(state.actor(batch.next_observation))
    pre = dist.sample(d, key)
    q = q_values(state.target_critics, batch.next_observation, jnp.tanh(pre)).min(0)
    plain = batch.reward + 0.99 * (1 - batch.terminal) * q
    np.testing.assert_allclose(agent.target(state, batch, key), plain, rtol=1e-5)
    bonus = 0.99 * (1 - batch.terminal) * dist.log_prob(d, pre)  # at temperature 1
    np.testing.assert_allclose(agent.replace(entropy_backup=True).target(state, batch, key), plain - bonus, rtol=1e-4)


@pytest.mark.slow
def test_morel_ends_rollouts_that_the_model_does_not_know():
    agent, rows, state = prepared(MOReL, threshold=1.01, penalty=4.0)
    usual = rows.take(np.arange(rows.count))
    far = usual["observation"][:16] + 50.0 * (np.arange(16) % 2)[:, None].astype(np.float32)
    make = lambda seen: Branch(jnp.asarray(seen), jnp.asarray(usual["action"][:16]), jnp.ones(16), jnp.asarray(seen),  # noqa: E731
                               jnp.zeros(16, bool), jnp.ones(16, bool))  # fmt: skip
    first, second = agent.penalised(state.model.ensemble, [make(far), make(usual["observation"][:16])], rows)
    lost = np.asarray(first.terminal)
    assert lost[1::2].all()
    assert not lost[::2].any()  # rows of the log
    wide = agent.replace(threshold=1e6).penalised(state.model.ensemble, [make(far)], rows)[0]
    assert not wide.terminal.any()
    np.testing.assert_allclose(np.asarray(first.reward)[lost], LOG.rewards.min() / (1 - agent.discount) - 4.0, rtol=1e-5)
    assert LOG.rewards.min() < 0  # which would be paid at each step
    np.testing.assert_allclose(np.asarray(first.reward)[~lost], 1.0)
    assert first.running.all()
    np.testing.assert_array_equal(second.running, ~lost)


@pytest.mark.parametrize(("kind", "log_prob", "expected"), [
    (MOBILE, -20.0, -0.1), (MOBILE, 20.0, 0.0), (MOPO, -20.0, -0.1), (MOPO, 20.0, 0.0), (COMBO, 20.0, 0.1),
])  # fmt: skip
def test_the_temperature_of_mobile_and_mopo_is_one_at_most(kind, log_prob, expected):
    agent, _, state = prepared(kind, turns=0, temperature_lr=0.1)
    after = agent.update_temperature(state, jnp.asarray(log_prob)).log_temperature
    np.testing.assert_allclose(after, expected, atol=1e-5)


@pytest.mark.parametrize(("fields", "words"), [
    ({"real_batch_size": 16}, "MOPO.real_batch_size must be fewer than a batch has, 16, got 16"),
    ({"real_batch_size": "6"}, "MOPO.real_batch_size takes a whole number >= 0, got '6'"),
    ({"elites": 4}, "MOPO.elites are members at most, got 4 of 3"),
    ({"model_weight_decay": (0.1,)}, "MOPO.model_weight_decay needs 2 numbers, one a layer of the model, got 1"),
])  # fmt: skip
def test_refusals(fields, words):
    with pytest.raises(UserError, match=words):
        MOPO(**TINY | fields).resolve(LOG.spec, 1)
    with pytest.raises(UserError, match="the model of MOPO needs 10 or more transitions; .* has [0-9]+, and model_rows is 5"):
        MOPO(**TINY | {"model_rows": 5}).resolve(LOG.spec, 1)
    with pytest.raises(UserError, match="COMBO.real_batch_size, the logged rows in a batch, must be 1 or more, got 0"):
        COMBO(**TINY | {"real_batch_size": 0}).resolve(LOG.spec, 1)
    for wrong in (COMBO(**TINY | {"real_batch_size": None}), MOBILE(**TINY | {"elites": None})):
        with pytest.raises(UserError, match="takes a whole number >= ., got None"):
            wrong.resolve(LOG.spec, 1)
    with pytest.raises(UserError, match="MOBILE.min_target is 0, .*: give min_target=None"):
        MOBILE(**TINY).resolve(corridor().spec, 1)
    assert MOBILE(**TINY | {"min_target": None}).resolve(corridor().spec, 1).min_target is None
    with pytest.raises(UserError, match="MOBILE.elites must be 2 or more, got 1"):
        MOBILE(**TINY | {"elites": 1}).resolve(LOG.spec, 1)
    with pytest.raises(UserError, match="MOReL.members must be 2 or more, got 1"):
        MOReL(**TINY | {"members": 1, "elites": 1}).resolve(LOG.spec, 1)



def test_without_a_discount_nothing_is_worse_than_negative_rewards_for_good():
    with pytest.raises(UserError, match="MOReL.discount must be below 1 where rewards are negative"):
        MOReL(**TINY, discount=1.0).resolve(LOG.spec, 1)
    assert MOReL(**TINY).resolve(LOG.spec, 1).discount < 1


def test_morel_counts_disagreement_in_units_of_what_changes():
    """Zeros that pad observations and a reward of 1 a step have none: errors of the fit there would be all that counts."""
    rng = np.random.default_rng(0)
    before = np.concatenate([rng.normal(size=(50, 2)), np.zeros((50, 3))], 1)
    after = before + np.concatenate([rng.normal(0, [0.5, 2.0], (50, 2)), np.zeros((50, 3))], 1)
    after[:5] = before[:5]  # ends of which the log does not say what they led to
    rows = {"observation": before, "next_observation": after, "reward": np.ones(50), "terminal": np.arange(50) < 5}
    scale = np.asarray(units(rows))
    np.testing.assert_allclose(scale, [*(after - before)[5:, :2].std(0), 1.0, 1.0, 1.0, 1.0], rtol=1e-5)


def test_a_temperature_that_no_target_stops_has_an_end():
    agent, _, state = prepared(COMBO, turns=0, temperature_lr=0.1)
    hot = state._replace(log_temperature=jnp.log(jnp.float32(HOTTEST)))
    after = agent.update_temperature(hot, jnp.asarray(1e3)).log_temperature
    np.testing.assert_allclose(after, np.log(HOTTEST), rtol=1e-6)
