"""PETS in a world whose best plan is known, what it carries from step to step, and a run that goes on where it stopped."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import PETS
from deadreckon.data.spec import Box, Spec
from deadreckon.data.step import Step
from deadreckon.dynamics import Ensemble
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.online import Online
from deadreckon.online.model_learning import ModelLearning
from deadreckon.policies import EnvPolicy, store
from deadreckon.policies.portable import load as load_portable
from deadreckon.tasks import task
from deadreckon.training.fit import Fit
from tests.agents.resumed import whole_and_resumed

SPEC = Spec.empty((2,), Box((-1.0,), (1.0,)), "line")
SMALL = {"members": 2, "elites": 2, "model_hidden": (4,), "model_weight_decay": (), "particles": 2, "termination": "learned"}


def planner(gain=(0.5, 0.5), tolls=(0.0, 0.0), **fields):
    """A planner on a line: s grows by gain * a, and a second number counts steps; the reward is s, less a toll * a.

    The networks are linear: a layer alone, whose variances are at their least and whose episodes never end.
    """
    agent = PETS.small(**SMALL | fields).resolve(SPEC, 10)
    weights = np.zeros((2, 3, 7), np.float32)
    weights[:, 2, 0], weights[:, 0, 2], weights[:, 2, 2] = gain, 1.0, -np.asarray(tolls)
    biases = np.tile(np.asarray([0, 1, 0, -30, -30, -30, -1e3], np.float32), (2, 1))
    bounds = jnp.tile(jnp.asarray([[-30.0], [-29.0]]), (2, 1, 3))
    params = {"nets": MLP((jnp.asarray(weights),), (jnp.asarray(biases),), "swish"), "bounds": bounds,
              "choices": jnp.zeros((2, 0, 0))}  # fmt: skip
    ensemble = Ensemble(params, None, jnp.zeros(3), jnp.ones(3), jnp.arange(2))
    return agent.policy(agent.init(SPEC, jax.random.key(0))._replace(model=ensemble))


@pytest.mark.slow
def test_returns_are_the_sums_by_hand():
    policy = planner(gain=(0.5, 1.0), horizon=3, population=2, cem_elites=1)
    actions = jnp.asarray([[0.2, -0.4, 0.9], [1.0, 1.0, -1.0]])[..., None]
    found = eqx.filter_jit(policy.returns)(jnp.asarray([2.0, 0.0]), actions, jax.random.key(0))
    # s before each step: 2, 2 + g a0, 2 + g (a0 + a1).
    by_hand = [np.mean([6 + 2 * g * a[0] + g * a[1] for g in (0.5, 1.0)]) for a in np.asarray(actions)[..., 0]]
    np.testing.assert_allclose(found, by_hand, rtol=1e-4)


@pytest.mark.slow
def test_the_plan_goes_where_rewards_are():
    policy = planner(horizon=4)
    plan = np.asarray(policy.plan(jnp.zeros(2), jnp.zeros((4, 1)), jax.random.key(0)))[:, 0]
    assert (plan[:3] > [0.7, 0.6, 0.2]).all()  # each pays for fewer steps, and the last for none
    # An action now pays gain for each of the three steps to come: a toll beyond that turns it round.
    costly = planner(horizon=4, tolls=(1.6, 1.6))
    assert np.asarray(costly.plan(jnp.zeros(2), jnp.zeros((4, 1)), jax.random.key(1)))[0, 0] < -0.1
    # Of two networks that disagree about the way, the mean decides.
    split = planner(horizon=4, gain=(0.5, -1.5))
    assert np.asarray(split.plan(jnp.zeros(2), jnp.zeros((4, 1)), jax.random.key(0)))[0, 0] < -0.3


@pytest.mark.slow
def test_a_plan_is_gone_on_with_and_forgotten_when_an_episode_begins():
    policy = planner(horizon=4)
    before = policy.start(2) + jnp.asarray([0.1, 0.2, 0.3, 0.4])[:, None]
    step = Step(jnp.zeros((2, 2)), jnp.zeros(2), jnp.asarray([False, True]))
    drawn = jax.random.split(jax.random.key(5), 2)
    planned = eqx.filter_jit(policy.plan)
    for greedy, keys in ((False, drawn), (True, [jax.random.key(0)] * 2)):  # greedy plans all draw the same
        actions, after = policy.act(step, before, jax.random.key(5), greedy=greedy)
        for i, begin in enumerate((before[0], jnp.zeros((4, 1)))):
            plan = planned(jnp.zeros(2), begin, keys[i])
            np.testing.assert_allclose(actions[i], plan[0], rtol=1e-4, atol=1e-5)
            np.testing.assert_allclose(after[i], jnp.concatenate([plan[1:], jnp.zeros((1, 1))]), rtol=1e-4, atol=1e-5)
        assert (jnp.abs(actions) <= 1.0).all()


@pytest.mark.slow
def test_a_planner_survives_its_file(tmp_path):
    policy = EnvPolicy(planner(horizon=4), None, None, -2.0 * jnp.ones(1), 2.0 * jnp.ones(1))
    store.save(tmp_path / "p.npz", policy)
    seen = np.ones((3, 2), np.float32)
    np.testing.assert_array_equal(store.load(tmp_path / "p.npz")(seen), policy(seen))
    with pytest.raises(ValueError, match="is of the kind Planner, which numpy alone does not play"):
        load_portable(tmp_path / "p.npz")(seen)


FIELDS = {"termination": None, "horizon": 3, "population": 10, "cem_elites": 2, "model_epochs": 2, "model_train_freq": 20}
SETTINGS = Online(copies=2, explore=40, updates_per_step=0.1, block=10)


@pytest.mark.slow
def test_plans_begin_with_episodes_and_in_a_model_that_was_fitted():
    pendulum = task("inverted-pendulum")
    updates = SETTINGS.updates(90)
    agent = PETS.small(**SMALL | FIELDS).resolve(Spec.empty((4,), pendulum.action_space, pendulum.name), updates)
    experience = ModelLearning(pendulum, agent, [0], updates, SETTINGS, threads=1)
    job = Fit([agent], experience, [0], updates, 1)
    states, _ = experience.extend(job.learner, job.states, job.roots, 0)
    assert experience.environment_steps == 50
    real = np.asarray(experience.replay.buffer[0, :40])  # the random steps are what the first plans rest on
    assert float(states.model.mean[0, 4]) != 0.0
    assert abs(float(states.model.mean[0, 1]) - real[:, 1].mean()) < real[:, 1].std()
    both = 0
    for at in range(50, 120, 2):
        rows = experience._step(job.learner, states, job.roots, at)
        over = rows[0, :, -2] + rows[0, :, -1] > 0
        plans = np.abs(np.asarray(experience.carry[0])).sum((1, 2))
        assert (plans[over] == 0).all()
        assert (plans[~over] > 0).all()
        both += over.sum() == 1
    assert both > 0  # one copy's episode ended while the other's went on


@pytest.mark.slow
def test_a_run_goes_on_where_it_stopped(tmp_path):
    agent = PETS.small(**SMALL | FIELDS)
    whole, again = whole_and_resumed(agent, SETTINGS, tmp_path, 60, 90, 1)
    read = lambda run: np.fromfile(next((run.path / "replay").glob("*.bin")), np.float32)  # noqa: E731
    np.testing.assert_array_equal(read(whole), read(again))
    assert set(whole.metrics.to_pydict()) >= {"model_error", "model_epochs", "environment_steps"}


def test_refusals():
    with pytest.raises(UserError, match=r"PETS.particles must be a multiple of elites \(2\), got 3"):
        PETS(**SMALL | {"particles": 3}).resolve(SPEC, 1)
    with pytest.raises(UserError, match="PETS.cem_elites must be 1 .. population, and horizon 1 or more, got 9 of 8 and 30"):
        PETS(**SMALL | {"population": 8, "cem_elites": 9}).resolve(SPEC, 1)
