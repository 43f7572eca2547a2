"""Tiny logs with known answers, for tests of agents."""

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Discrete


def corridor(rows: int = 4000, seed: int = 0, actions: str = "uniform") -> Dataset:
    """A point on a line: s' = s + 0.2 a, reward -s'^2, episodes of 20 steps. The best action is -5 s, clipped.

    `actions`: "uniform" over [-1, 1]; "half": only [-0.5, 0], a support that an agent can be seen to leave; "choices": 0, 1
    and 2, which are -1, 0 and 1.
    """
    rng = np.random.default_rng(seed)
    length = 20
    episodes = rows // length
    s = rng.uniform(-1, 1, episodes)
    draw = {
        "uniform": lambda: rng.uniform(-1, 1, episodes),
        "half": lambda: rng.uniform(-0.5, 0.0, episodes),
        "choices": lambda: rng.integers(0, 3, episodes),
    }[actions]
    choices = actions == "choices"
    observations, acts, rewards, finals = [], [], [], []
    for _ in range(length):
        a = draw()
        observations.append(s)
        acts.append(a)
        s = np.clip(s + 0.2 * (a - 1.0 if choices else a), -2, 2)
        rewards.append(-(s**2))
    finals = s
    flat = lambda parts: np.stack(parts, 1).reshape(-1)  # noqa: E731
    timeouts = np.tile(np.arange(length) == length - 1, episodes)
    return Dataset.from_arrays(
        observations=flat(observations)[:, None], actions=flat(acts) if choices else flat(acts)[:, None], rewards=flat(rewards),
        timeouts=timeouts, final_observations=finals[:, None],
        action_space=Discrete(3) if choices else Box((-1.0,), (1.0,)), name="corridor",
    )  # fmt: skip


def swinging(rows: int = 200, seed: int = 0) -> Dataset:
    """Numbers of the shapes of the inverted pendulum; every second episode of ten steps ends with a terminal."""
    rng = np.random.default_rng(seed)
    last = np.arange(rows) % 10 == 9
    even = np.arange(rows) // 10 % 2 == 0
    return Dataset.from_arrays(
        observations=rng.normal(0.2, 1.5, (rows, 4)), actions=rng.uniform(-3, 3, (rows, 1)), rewards=rng.uniform(size=rows),
        terminals=last & even, timeouts=last & ~even, final_observations=rng.normal(0.2, 1.5, (rows // 10, 4)),
        action_space=Box((-3.0,), (3.0,)), name="swinging",
    )  # fmt: skip
