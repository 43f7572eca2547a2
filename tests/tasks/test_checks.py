"""Gymnasium's and Stable-Baselines3's own checks of environments, over all ids of the package.

Stable-Baselines3 needs PyTorch, which no environment of the package installs: its check runs where both are.
"""

import importlib.util
import warnings

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from opengl import draws

from deadreckon.tasks import control, envs

IDS = sorted(name for name in envs.registered if name.startswith("deadreckon/"))
pytestmark = pytest.mark.filterwarnings("ignore:.*Box observation space.*", "ignore:.*infinity.*")


def made(name):
    if "Flow" in name and importlib.util.find_spec("libsumo") is None:
        pytest.skip("SUMO is not installed")
    if name in {task.gym_id for task in control.TASKS} and importlib.util.find_spec("dm_control") is None:
        pytest.skip("dm_control is not installed")
    if name in ("deadreckon/CarlaLane-v0", "deadreckon/CarlaTown-v0") and not draws():
        pytest.skip("MuJoCo finds no OpenGL to draw with")
    return gymnasium.make(name)


def test_no_id_is_forgotten():
    some = {"deadreckon/CarlaLane-v0", "deadreckon/CarlaTownState-v0", "deadreckon/Maze2D-UMaze-v1", "deadreckon/Battery-v1"}
    assert some < set(IDS)


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_gymnasiums_own(name):
    check_env(made(name).unwrapped, skip_render_check=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_stable_baselines3s_own(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="Stable-Baselines3 is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # advice on ranges of actions
        checker.check_env(made(name), skip_render_check=True)
