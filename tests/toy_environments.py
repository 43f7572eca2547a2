"""Small Gymnasium environments whose every number is known, as users' modules have them: `tests.toy_environments:Goal`."""

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces


class Goal(gymnasium.Env):
    """Dict observations with a text among them, MultiDiscrete actions, and no time limit."""

    def __init__(self, size: int = 2):
        place = spaces.Dict({"at": spaces.Box(-9, 9, (size,), np.float64), "mode": spaces.Discrete(3, start=1)})
        self.observation_space = spaces.Dict({"place": place, "flags": spaces.MultiBinary(2), "note": spaces.Text(5)})
        self.action_space = spaces.MultiDiscrete([2, 3], start=[0, -1])

    def _see(self) -> dict[str, Any]:
        place = {"at": self.at, "mode": 1 + int(self.at.sum()) % 3}
        return {"place": place, "flags": np.array([1, 0], np.int8), "note": "go"}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = self.np_random.uniform(-1, 1, self.observation_space["place"]["at"].shape)
        return self._see(), {}

    def step(self, action):
        assert action in self.action_space
        self.at = self.at + [action[0], action[1]] + 0.01 * self.np_random.normal(size=2)
        return self._see(), float(10 * action[0] + action[1]), bool(abs(self.at).max() > 8), False, {}


class Shifted(gymnasium.Env):
    """Discrete observations and actions that do not begin at 0; ends when action 7 is taken in the last state."""

    observation_space: ClassVar = spaces.Discrete(4, start=2)
    action_space: ClassVar = spaces.Discrete(3, start=5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = 2
        return self.state, {}

    def step(self, action):
        assert action in self.action_space
        over = self.state == 5 and action == 7
        self.state = min(self.state + int(action == 7), 5)
        return self.state, float(action), over, False, {}


class Unseeded(Shifted):
    """Draws from elsewhere than its seed."""

    observation_space: ClassVar = spaces.Box(0, 1, (1,), np.float32)
    noise: ClassVar = np.random.default_rng(0)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.noise.random(1, np.float32), {}

    def step(self, action):
        return self.noise.random(1, np.float32), 1.0, False, False, {}


class Failing(Shifted):
    """Raises an error when it is stepped."""

    def step(self, action):
        raise RuntimeError("the pump is dry")


class Crowd:
    """Looks like an environment of PettingZoo."""

    possible_agents = ("a", "b")


def short_cart() -> gymnasium.Env:
    """CartPole with a time limit of 9 steps."""
    return gymnasium.make("CartPole-v1", max_episode_steps=9)


def the_same() -> gymnasium.Env:
    """One environment with every call."""
    return _ONE


def the_same_in_a_wrapper() -> gymnasium.Env:
    """One environment in a new wrapper with every call."""
    return gymnasium.wrappers.TimeLimit(_ONE, 9)


_ONE = gymnasium.make("CartPole-v1")
