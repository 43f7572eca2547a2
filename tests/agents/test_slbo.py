"""SLBO: episodes made up in the model from real starts, and a run that goes on where it stopped."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import SLBO
from deadreckon.data.spec import Spec
from deadreckon.online import Online
from deadreckon.online.model_rollouts import ModelRollouts, _lived
from deadreckon.tasks import task
from deadreckon.training.fit import Fit
from tests.agents.resumed import whole_and_resumed

PENDULUM = task("inverted-pendulum")
SETTINGS = Online(copies=2, explore=60, updates_per_step=0.5, block=20)
MODEL = {"model_hidden": (16,), "model_weight_decay": (), "model_epochs": 3, "model_train_freq": 40}
SMALL = SLBO(hidden=(8,), batch_size=16, rollouts=3, rollout_length=12, **MODEL)


@pytest.fixture(scope="module")
def made():
    """The experience in the middle of a run, the states that acted, and what they are given to learn from."""
    updates = SETTINGS.updates(160)
    agent = SMALL.resolve(Spec.empty((4,), PENDULUM.action_space, PENDULUM.name), updates)
    experience = ModelRollouts(PENDULUM, agent, [0], updates, SETTINGS, threads=1)
    job = Fit([agent], experience, [0], updates, 10)
    next(job.chunks())
    states, data = experience.extend(job.learner, job.states, job.roots, 10)
    return experience, agent, jax.tree.map(lambda leaf: leaf[0], states), np.asarray(data["packed"][0]).reshape(12, 3, -1)


@pytest.mark.slow
def test_episodes_begin_where_real_ones_do(made):
    experience, _, _, rows = made
    real = experience.real(0)
    over = np.flatnonzero((real[:60, -2:] > 0).any(1))
    assert len(over) > 2  # random actions do not balance
    starts = {tuple(real[i, :4]) for i in [0, 1, *(over + 2)] if i < 60}
    assert {tuple(row) for row in experience._starts[0].tolist()} <= {tuple(float(x) for x in start) for start in starts}
    assert all(tuple(row) in starts for row in rows[0, :, :4])


@pytest.mark.slow
def test_steps_follow_each_other_as_the_model_says(made):
    """A step leads to what the network says, without chance; where that is the end, another real start follows."""
    experience, agent, state, rows = made
    seen, action = rows[:-1, :, :4].reshape(-1, 4), rows[:-1, :, 4:5].reshape(-1, 1)
    inputs = state.model.standardise(np.concatenate([seen, action], 1))
    drawn, _ = agent.model.sample(state.model.best(), inputs[None], jax.random.key(0))
    wanted, found = seen + np.asarray(drawn[0])[:, :-1], rows[1:, :, :4].reshape(-1, 4)
    begun = np.array([tuple(row) in {tuple(s) for s in np.asarray(experience._starts[0])} for row in found])
    over = np.asarray(agent.over(wanted))
    np.testing.assert_array_equal(begun, over)
    np.testing.assert_allclose(found[~over], wanted[~over], rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_real_observations_are_standardised_with_and_probabilities_told(made):
    experience, agent, state, rows = made
    assert float(state.observations.number) == experience.environment_steps == 100
    told = agent.policy(state).log_prob(rows[..., :4].reshape(-1, 4), rows[..., 4:5].reshape(-1, 1))
    np.testing.assert_allclose(rows[..., 5].reshape(-1), told, rtol=1e-3, atol=1e-4)
    assert experience.count == 36


@pytest.mark.slow
def test_what_goes_out_of_all_bounds_is_cut_off(made):
    experience, agent, state, _ = made
    last = state.model.params["nets"].biases[-1].at[..., 0].set(1e8)
    nets = dataclasses.replace(state.model.params["nets"], biases=(*state.model.params["nets"].biases[:-1], last))
    wild = state._replace(model=state.model._replace(params=state.model.params | {"nets": nets}))
    lane = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (agent, wild))
    rows = _lived(*lane, experience._starts, jax.random.split(jax.random.key(0), 1), 0, 3, 5)
    assert (np.asarray(rows["timeout"]) == 1).all()
    np.testing.assert_array_equal(rows["next_observation"], rows["observation"])
    assert not np.asarray(rows["reward"]).any()


@pytest.mark.slow
def test_a_run_goes_on_where_it_stopped(tmp_path):
    whole, again = whole_and_resumed(SMALL, SETTINGS, tmp_path, 120, 160, 10)
    for a, b in zip(jax.tree.leaves(whole.policy), jax.tree.leaves(again.policy)):
        np.testing.assert_array_equal(a, b)
