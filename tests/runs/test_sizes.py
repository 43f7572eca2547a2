"""Logs in people's units: what `train` says of them, and what the candidates of `recommend` learn from instead."""

import warnings

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.agents import agent_class
from deadreckon.data.batch import TransitionSource
from deadreckon.policies.deployed import deployed
from deadreckon.runs.candidates import CONTINUOUS, DISCRETE, agent_of, units
from deadreckon.runs.sizes import about_sizes
from deadreckon.training.fit import fit
from tests.agents.tiny import small

ROWS = 400
RNG = np.random.default_rng(0)
SEEN, ACTIONS = RNG.normal(size=(ROWS, 2)), np.tanh(RNG.normal(size=(ROWS, 1)))


def log(unit=1.0, reward=1.0, name="mine"):
    """Actions along the first observation are rewarded."""
    rewards = reward * SEEN[:, 0] * ACTIONS[:, 0]
    columns = {"observations": unit * SEEN, "actions": ACTIONS, "rewards": rewards, "timeouts": np.arange(ROWS) % 10 == 9}
    return dr.Dataset.from_arrays(**columns, name=name)


def test_settings_follow_from_the_log_alone_where_it_is_far_from_one():
    assert units(log()) == {}
    assert units(log(unit=100.0)) == {"standardise": True}
    assert units(log(reward=1000.0)) == {"reward_scale": pytest.approx(1e-3)}
    for candidate in (*CONTINUOUS, *DISCRETE):
        agent = agent_of(candidate, hidden=(8,), discount=0.9, **units(log(100.0, 1000.0)))
        assert agent.needs(log().spec).standardise, candidate.name
        assert getattr(agent, "reward_scale", 1e-3) == pytest.approx(1e-3), candidate.name


def test_an_offset_of_the_rewards_of_single_steps_changes_no_decision():
    """Costs of 23 with a deviation of 4 were divided by ten, so that agents saw differences of a tenth."""
    rewards = 4.0 * SEEN[:, 0] * np.sign(ACTIONS[:, 0])
    one, cost = ({"observations": SEEN, "actions": ACTIONS, "rewards": each} for each in (rewards, rewards - 23.0))
    single = dr.Dataset.from_arrays(**cost, terminals=np.ones(ROWS, bool), name="mine")
    mean = float(single.rewards.mean())
    assert units(single) == {"reward_shift": pytest.approx(-mean)}
    assert units(dr.Dataset.from_arrays(**one, terminals=np.ones(ROWS, bool))) == {}
    assert units(dr.Dataset.from_arrays(**cost, timeouts=np.arange(ROWS) % 10 == 9)) == {"reward_scale": pytest.approx(0.1)}
    assert f"give --agent.reward-shift={-mean:.2f}" in about_sizes(single, dr.agents.IQL().resolve(single.spec, 10))[0]
    assert f"add {-mean:.2f}" in about_sizes(single, dr.agents.BEAR())[0]
    thousands = dr.Dataset.from_arrays(
        observations=SEEN, actions=ACTIONS, rewards=1000 * (rewards - 23.0), terminals=np.ones(ROWS, bool)
    )
    assert units(thousands) == {"reward_scale": pytest.approx(1e-4), "reward_shift": pytest.approx(-0.1 * mean)}
    agent = agent_of(CONTINUOUS[1], **units(single)).resolve(single.spec, 10)
    assert abs(float(agent.reward_scale * single.rewards.mean() + agent.reward_shift)) < 1e-4


@pytest.mark.parametrize("name", ["iql", "bc"])
def test_candidates_learn_the_same_whatever_the_units(name):
    """Units are powers of two, so that only the floor of the deviations differs."""
    candidate, acts = next(each for each in CONTINUOUS if each.name == name), []
    for unit in (2.0**8, 2.0**12):
        own = log(unit)
        agent = agent_of(candidate, hidden=(16,), batch_size=32, **units(own)).resolve(own.spec, 200)
        rows = TransitionSource(own, agent.needs(own.spec))
        policy = deployed(agent, fit([agent], rows, [0], 200).lane(0), rows.view)
        acts.append(policy(own.observations[:50]))
    assert np.ptp(acts[0]) > 0.02
    np.testing.assert_allclose(acts[0], acts[1], atol=2e-3)


@pytest.mark.parametrize(
    ("name", "fields", "own", "lines"),
    [
        ("iql", {}, log(), []),
        ("iql", {}, log(100.0, 1000.0), ["standardise=True", "--agent.reward-scale 0.001"]),
        ("iql", {}, log(100.0, 1000.0, "hopper-medium-v2"), []),  # as its authors learned from it
        ("iql", {"standardise": True, "reward_scale": 0.01}, log(100.0, 1000.0), []),
        ("bear", {}, log(100.0, 1000.0), ["standardise=True", "multiply the column by 0.001"]),
        ("bc", {}, log(100.0, 1000.0), ["standardise=True"]),  # which sees no rewards
    ],
)
def test_what_is_far_from_one_is_told_with_what_to_do(name, fields, own, lines):
    agent = agent_class(name)(**fields).resolve(own.spec, 10)
    told = about_sizes(own, agent)
    assert len(told) == len(lines)
    for text, line in zip(told, lines):
        assert text.startswith("mine: ")
        assert line in text


def test_train_warns(tmp_path):
    with pytest.warns(UserWarning, match=r"mine: observation \d is \d+ in size .* \(--agent.standardise, in Python"):
        dr.train(dr.agents.BC(hidden=(4,), batch_size=8), log(100.0), steps=2, out=tmp_path / "raw", holdout=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        agent = dr.agents.BC(hidden=(4,), batch_size=8, standardise=True)
        dr.train(agent, log(100.0), steps=2, out=tmp_path / "standard", holdout=0.0)


def test_a_rule_that_ends_episodes_reads_observations_as_they_are():
    columns = {"observations": np.zeros((20, 11)), "actions": np.zeros((20, 3)), "rewards": np.zeros(20)}
    own = dr.Dataset.from_arrays(**columns, timeouts=np.arange(20) == 19, name="mine")
    with pytest.raises(dr.UserError, match="MOPO.standardise: the rule that ends episodes of hopper .* 'learned'"):
        dr.agents.MOPO(standardise=True, termination="hopper").resolve(own.spec, 10)
    assert small("mopo", standardise=True, termination="learned").needs(log().spec).standardise
