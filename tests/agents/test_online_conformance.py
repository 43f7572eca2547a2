"""One suite for agents that learn by acting: two seeds in one program are what each is alone, and a bad one stops alone."""

import numpy as np
import pytest

from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.model_based import ModelBasedAgent
from deadreckon.data.spec import Spec
from deadreckon.online import Online
from deadreckon.online.experience import experience_of
from deadreckon.tasks import task
from deadreckon.training.fit import Fit

PENDULUM = task("inverted-pendulum")
SETTINGS = Online(copies=2, explore=40, updates_per_step=0.5, block=20)
UPDATES = SETTINGS.updates(100)
MODEL = {"model_hidden": (8,), "model_weight_decay": (), "members": 3, "elites": 2, "model_epochs": 2, "model_train_freq": 20}
OWN = {
    "mbpo": {"rollouts_per_step": 3, "retain_steps": 40},
    "slbo": {"members": 1, "elites": 1, "rollouts": 2, "rollout_length": 10},
    "pets": {"horizon": 3, "population": 10, "cem_elites": 2, "cem_iterations": 2, "particles": 2},
}
ONLINE = [name for name in AGENTS if agent_class(name).online]
ONLINE = [name for name in ONLINE if not (issubclass(agent_class(name), ModelBasedAgent) and agent_class(name).offline)]


def job(name, seeds, bad=None, **fields):
    kind = agent_class(name)
    sizes = {} if name == "pets" else {"hidden": (8,), "batch_size": 16}
    sizes |= MODEL if issubclass(kind, ModelBasedAgent) else {}
    spec = Spec.empty(PENDULUM.observation_shape, PENDULUM.action_space, PENDULUM.name)
    agents = [kind(**sizes | OWN.get(name, {}) | fields).resolve(spec, UPDATES) for _ in seeds]
    if bad is not None:
        field = next(f for f in ("critic_lr", "lr", "model_lr") if hasattr(agents[bad], f))
        agents[bad] = agents[bad].replace(**{field: 1e30})
    experience = experience_of(agents[0])(PENDULUM, agents[0], seeds, UPDATES, SETTINGS, threads=1)
    found = Fit(agents, experience, seeds, UPDATES, 10)
    for _ in found.chunks():
        pass
    return found, experience


def test_all_are_looked_at():
    assert set(ONLINE) == {"sac", "ppo", "dapg", "mbpo", "pets", "slbo", "mve", "steve"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ONLINE)
def test_a_lane_equals_the_single_run_within_tolerance(name):
    (both, together), (_, single) = job(name, [3, 4]), job(name, [4])
    assert both.failures == (None, None)
    np.testing.assert_allclose(together.replay.buffer[1, :50], single.replay.buffer[0, :50], atol=1e-3)
    assert np.abs(np.asarray(together.replay.buffer[0, :50] - together.replay.buffer[1, :50])).max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", ONLINE)
def test_a_lane_with_bad_numbers_stops_and_the_other_goes_on(name):
    found, experience = job(name, [3, 4], bad=1)
    assert found.failures[0] is None
    assert found.failures[1] is not None
    assert experience.environment_steps == 100
    assert np.isfinite(np.asarray(experience.replay.buffer)).all()
