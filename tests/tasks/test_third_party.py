"""Environments of other packages, which install from the index without PyTorch; skipped where they are absent."""

import importlib

import gymnasium
import numpy as np
import pytest

import deadreckon as dr
from deadreckon.collect import collect_in_task
from deadreckon.data.spec import Discrete
from deadreckon.policies.policy import BlackBoxPolicy
from deadreckon.runs.evaluate import episode_seeds

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:.*texts are not observed")]

TASKS = {
    "minigrid:MiniGrid-Empty-5x5-v0?max_episode_steps=100": ((4 + 147,), Discrete(7)),
    "ale_py:ALE/Freeway-v5?obs_type=ram&max_episode_steps=40": ((128,), Discrete(3)),
    "gymnasium_robotics:FetchReachDense-v4": ((16,), None),
}


@pytest.mark.parametrize("name", TASKS)
def test_another_packages_environment_is_a_task(tmp_path, name):
    module = name.partition(":")[0]
    pytest.importorskip(module, reason=f"{module} is not installed")
    task = dr.task(f"gymnasium:{name}")
    shape, actions = TASKS[name]
    assert task.observation_shape == shape
    assert actions in (task.action_space, None)
    assert {"gymnasium", module.replace("_", "-")} <= set(task.versions)
    log = dr.read(collect_in_task(task, steps=100, out=tmp_path / "log.hdf5"))
    assert len(log) == 100

    def first(observations, generator):
        return np.zeros((len(observations), *(() if actions else (4,))), np.int32 if actions else np.float32)

    found = dr.evaluate(BlackBoxPolicy(first), task, episodes=2, seed=1)
    importlib.import_module(module)
    env_id, _, options = name.removeprefix(f"{module}:").partition("?")
    env = gymnasium.make(env_id, **({"obs_type": "ram"} if "ram" in options else {}))
    returns = []
    for seed in episode_seeds(1, 2):
        env.reset(seed=seed)
        total = 0.0
        for _ in range(task.horizon):
            _, reward, terminated, truncated, _ = env.step(task.spaces.act(first(np.zeros((1, 1)), None)[0]))
            total += float(reward)
            if terminated or truncated:
                break
        returns.append(total)
    assert found.returns[0].tolist() == returns
