"""One suite for agents that learn by acting: two seeds in one program are what each is alone, and a bad one stops alone."""

import jax
import numpy as np
import pytest

from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.model_based import ModelBasedAgent
from deadreckon.data.spec import Spec
from deadreckon.online import Online
from deadreckon.online.experience import experience_of
from deadreckon.policies import EnvPolicy
from deadreckon.tasks import task
from deadreckon.training.fit import Fit
from deadreckon.training.learner import unstack
from tests.agents.tiny import assert_function_of_state
from tests.agents.worlds import swinging

PENDULUM = task("inverted-pendulum")
SETTINGS = Online(copies=2, explore=40, updates_per_step=0.5, block=20)
UPDATES = SETTINGS.updates(100)
MODEL = {"model_hidden": (8,), "model_weight_decay": (), "members": 3, "elites": 2, "model_epochs": 2, "model_train_freq": 20}
OWN = {
    "cal_ql": {"critic_hidden": (8,), "samples": 2}, "rlpd": {"critics": 3, "policy_freq": 2},
    "d4pg": {"critic_hidden": (8, 8), "n_step": 3},
    "mbpo": {"rollouts_per_step": 3, "retain_steps": 40},
    "slbo": {"members": 1, "elites": 1, "rollouts": 2, "rollout_length": 10},
    "pets": {"horizon": 3, "population": 10, "cem_elites": 2, "cem_iterations": 2, "particles": 2},
}
ONLINE = [name for name in AGENTS if agent_class(name).online]
ONLINE = [name for name in ONLINE if not (issubclass(agent_class(name), ModelBasedAgent) and agent_class(name).offline)]


LOG = swinging()
FINE_TUNED = [name for name in AGENTS if agent_class(name).fine_tunes]


def job(name, seeds, bad=None, log=None, folder=None, chunk=10, **fields):
    """A fit that has not begun, and its experience."""
    kind = agent_class(name)
    sizes = {} if name == "pets" else {"hidden": (8,), "batch_size": 16}
    sizes |= MODEL if issubclass(kind, ModelBasedAgent) else {}
    spec = Spec.empty(PENDULUM.observation_shape, PENDULUM.action_space, PENDULUM.name) if log is None else log.spec
    agents = [kind(**sizes | OWN.get(name, {}) | fields).resolve(spec, UPDATES) for _ in seeds]
    if bad is not None:
        field = next(f for f in ("critic_lr", "lr", "model_lr") if hasattr(agents[bad], f))
        agents[bad] = agents[bad].replace(**{field: 1e30})
    paths = [] if folder is None else [folder / f"{seed}.bin" for seed in seeds]
    options = {} if log is None else {"log": log, "share": 0.25}
    kind_of_rows = experience_of(agents[0], log is not None)
    experience = kind_of_rows(PENDULUM, agents[0], seeds, UPDATES, SETTINGS, paths, threads=1, **options)
    return Fit(agents, experience, seeds, UPDATES, chunk, folder), experience


def done(name, seeds, bad=None, **options):
    """A fit that has come to its end, and its experience."""
    found, experience = job(name, seeds, bad, **options)
    for _ in found.chunks():
        pass
    return found, experience


# Two kinds of policies that no offline agent has; the others' are tried there too.
@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in ("pets", "dapg") else pytest.mark.slow) for n in ONLINE])
def test_greedy_actions_are_a_function_of_the_state(name):
    """Of networks as they begin, which is all that a policy is made of."""
    fitted, experience = job(name, [3])
    policy = EnvPolicy.of(unstack(fitted.learner, 1)[0].policy(unstack(fitted.states, 1)[0]), experience.view)
    assert_function_of_state(policy, np.random.default_rng(0).uniform(-0.2, 0.2, (9, 4)).astype(np.float32))


def test_all_are_looked_at():
    assert set(ONLINE) == {"d4pg", "sac", "ppo", "dapg", "mbpo", "pets", "slbo", "mve", "steve", "rlpd"}
    assert set(FINE_TUNED) == {"sac", "td3", "td3_bc", "iql", "xql", "awac", "crr", "cql", "cal_ql", "rlpd", "sac_n", "edac"}


@pytest.mark.slow
@pytest.mark.parametrize("name", FINE_TUNED)
def test_beside_a_log_a_run_that_was_stopped_goes_on_to_the_same_bits(name, tmp_path):
    whole, experience = done(name, [3, 4], log=LOG)
    assert whole.failures == (None, None)
    first, _ = job(name, [3, 4], log=LOG, folder=tmp_path)
    walk = first.chunks()
    next(walk)
    next(walk)
    walk.close()
    again, other = job(name, [3, 4], log=LOG, folder=tmp_path)
    again.resume()
    assert again.step == 10
    seen = list(again.chunks())
    assert all(np.isfinite(value).all() for p in seen for value in p.metrics.values())
    np.testing.assert_array_equal(other.replay.buffer, experience.replay.buffer)
    for a, b in zip(jax.tree.leaves(again.states), jax.tree.leaves(whole.states), strict=True):
        np.testing.assert_array_equal(a, b)
    acted = np.asarray(other.replay.buffer)[:, 40:100, 4]  # after the random steps: the policies, which explore
    assert acted.std(1).min() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", FINE_TUNED)
def test_beside_a_log_a_lane_with_bad_numbers_stops_and_the_other_goes_on(name):
    found, experience = done(name, [3, 4], bad=1, log=LOG)
    assert found.failures[0] is None
    assert found.failures[1] is not None
    assert experience.environment_steps == 100


@pytest.mark.slow
@pytest.mark.parametrize("name", ONLINE)
def test_a_lane_equals_the_single_run_within_tolerance(name):
    (both, together), (_, single) = done(name, [3, 4]), done(name, [4])
    assert both.failures == (None, None)
    np.testing.assert_allclose(together.replay.buffer[1, :50], single.replay.buffer[0, :50], atol=1e-3)
    assert np.abs(np.asarray(together.replay.buffer[0, :50] - together.replay.buffer[1, :50])).max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", ONLINE)
def test_a_lane_with_bad_numbers_stops_and_the_other_goes_on(name):
    found, experience = done(name, [3, 4], bad=1)
    assert found.failures[0] is None
    assert found.failures[1] is not None
    assert experience.environment_steps == 100
    assert np.isfinite(np.asarray(experience.replay.buffer)).all()
