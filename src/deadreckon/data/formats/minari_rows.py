"""The spaces and episodes of a log for a Minari data set."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.environments import Environment
from deadreckon.data.spec import Discrete


def spaces_of(log: Dataset, environment: Environment | None) -> tuple[Any, Any]:
    """The spaces of observations and actions: those of the environment if it is known, widened to contain all rows."""
    from gymnasium import spaces

    space, shape = log.action_space, log.observations.shape[1:]
    if log.observations.dtype == np.uint8:
        observations = spaces.Box(0, 255, shape, np.uint8)
    elif environment is None:
        observations = spaces.Box(-np.inf, np.inf, shape, np.float32)
    else:
        seen = log.spec.observation
        low, high = np.minimum(environment.low, seen.min), np.maximum(environment.high, seen.max)
        observations = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
    if isinstance(space, Discrete):
        levels = _levels(log)
        if levels is None:
            return observations, spaces.Discrete(space.n)
        low = levels.min(0)
        if levels.shape[1] == 1:
            return observations, spaces.Discrete(space.n, start=low[0])
        return observations, spaces.MultiDiscrete(levels.max(0) - low + 1, start=low)
    return observations, spaces.Box(np.asarray(space.low, np.float32), np.asarray(space.high, np.float32))


def _levels(log: Dataset) -> np.ndarray | None:
    """(actions, integers) the environment's integers for each discrete action; None if they are the action's number, and for
    actions that are texts, or integers with gaps, in their table, which are written as numbers."""
    levels = np.asarray(log.provenance.extra.get("action_levels", ()))
    if not isinstance(log.action_space, Discrete) or levels.shape[:1] != (log.action_space.n,):
        return None
    if levels.dtype.kind not in "iu":
        return None
    if levels.ndim == 1:  # of a table; Gymnasium has a space for consecutive integers only
        return levels[:, None] if (np.diff(levels) == 1).all() else None
    return levels


def buffers(log: Dataset) -> Iterator[Any]:
    """The episodes of a log as Minari's `EpisodeBuffer`s."""
    from minari.data_collector import EpisodeBuffer

    known = log.final_known | log.terminals[log.ends]
    starts, ends = log.starts, log.ends
    levels = _levels(log)
    for index in range(log.episodes):
        rows = slice(starts[index], ends[index] + (1 if known[index] else 0))
        if rows.start == rows.stop:
            continue
        observations = log.observations[starts[index] : ends[index] + 1]
        if known[index]:
            observations = np.concatenate([observations, log.final_observations[index : index + 1]])
        truncations = np.array(log.timeouts[rows])
        truncations[-1] |= not log.terminals[rows.stop - 1]
        actions = np.asarray(log.actions[rows])
        if levels is not None:
            actions = levels[actions, 0] if levels.shape[1] == 1 else levels[actions]
        yield EpisodeBuffer(
            observations=observations,  # pyrefly: ignore[bad-argument-type]  # an array is stored as it is, and fast
            actions=actions,  # pyrefly: ignore[bad-argument-type]
            rewards=np.asarray(log.rewards[rows]),  # pyrefly: ignore[bad-argument-type]
            terminations=np.asarray(log.terminals[rows]),  # pyrefly: ignore[bad-argument-type]
            truncations=truncations,  # pyrefly: ignore[bad-argument-type]
            infos={key: np.asarray(value[rows]) for key, value in log.extras.items()},
        )
