"""Histories: the last steps of an episode as one observation, for partially observed environments.

A history of K steps is the row o_{t-K+1}, a_{t-K+1}, ..., o_{t-1}, a_{t-1}, o_t: K observations, and between them the actions
taken, continuous ones scaled to [-1, 1], discrete ones one-hot. The state of a partially observed environment is inferred from
both
(Kaelbling, Littman and Cassandra, 1998, section 3). The newest observation is last, so that the end of a row is the history of
fewer steps. Before an episode's start its first observation is repeated, and actions are zeros.
"""

from dataclasses import replace
from typing import Any, cast

import numpy as np

from deadreckon.data.computed import Computed
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError


def stacked(log: Dataset, steps: int, view: Normalizer | None = None) -> Dataset:
    """A log whose observations are histories, computed from its columns when rows are read.

    Args:
        log: with flat observations.
        steps: number of last observations in a history; 1 gives the log itself.
        view: the bounds by which continuous actions are scaled; None: the log's.

    Returns:
        The log with observations (rows, history_size) float32, and final observations likewise; its episodes keep their ids.

    Raises:
        UserError: `steps` is below 1, observations are not flat, or rows do not follow each other.
    """
    if steps < 1:
        raise UserError(f"history must be >= 1, got {steps}")
    if steps == 1:
        return log
    if len(shape := log.observations.shape[1:]) != 1:
        raise UserError(f"history={steps} needs flat observations, {log.name} has shape {shape}")
    if log.successors is not None:
        raise UserError(f"{log.name}: its rows do not follow each other, so it has no histories; leave history at 1")
    rows = Histories(log, steps, view or Normalizer.of(log.spec))
    return replace(log, observations=cast(np.ndarray, rows), final_observations=rows.final(), part_of=lambda: log.episode_ids)


def history_size(observation_size: int, action_size: int, steps: int) -> int:
    """Numbers in a history."""
    return steps * observation_size + (steps - 1) * action_size


def beginning(observation: Any, action_size: int, steps: int) -> Any:
    """(n, history_size) histories at the start of episodes of (n, size) first observations; NumPy's or JAX's arrays."""
    arrays = observation.__array_namespace__()
    past = arrays.concat([observation, arrays.zeros((len(observation), action_size), dtype=observation.dtype)], axis=1)
    return arrays.concat([past] * (steps - 1) + [observation], axis=1)


class Histories(Computed):
    """(rows, history_size) float32 histories of a log, computed when they are read: the log is not copied `steps` times."""

    dtype = np.dtype(np.float32)

    def __init__(self, log: Dataset, steps: int, view: Normalizer):
        spec: Spec = log.spec
        self.log, self.steps, self.view = log, steps, view
        self.actions = spec.action_size if spec.discrete else 0
        self.shape = len(log), history_size(spec.observation_size, spec.action_size, steps)

    def __getitem__(self, index: Any) -> np.ndarray:
        if isinstance(index, tuple):
            return self[index[0]][..., *index[1:]]
        rows = np.arange(*index.indices(len(self))) if isinstance(index, slice) else np.asarray(index)
        rows = np.flatnonzero(rows) if rows.dtype == bool else np.where(rows < 0, rows + len(self), rows)
        flat = rows.reshape(-1)
        newest = np.asarray(self.log.observations[flat], np.float32)
        return self._before(flat, self.log.starts[self.log.episode_at(flat)], newest).reshape(*rows.shape, self.shape[1])

    def final(self) -> np.ndarray:
        """(episodes, history_size) histories after each episode's last action; where it is not known what that led to, the
        last row's own."""
        known, last = self.log.final_known, np.asarray(self.log.observations[self.log.ends], np.float32)
        newest = np.where(known[:, None], np.asarray(self.log.final_observations, np.float32), last)
        return self._before(self.log.ends + known, self.log.starts, newest)

    def _before(self, rows: np.ndarray, starts: np.ndarray, newest: np.ndarray) -> np.ndarray:
        """Histories that end with the observations `newest`, which were seen at `rows` of episodes that begin at `starts`."""
        parts = []
        for back in range(self.steps - 1, 0, -1):
            past = np.maximum(rows - back, starts)
            action = np.asarray(self.log.actions[past])
            action = np.eye(self.actions, dtype=np.float32)[action] if self.actions else self.view.to_unit(action)
            there = (rows - back >= starts)[:, None]
            parts += [np.asarray(self.log.observations[past], np.float32), np.where(there, action, np.float32(0.0))]
        return np.concatenate([*parts, newest], axis=1, dtype=np.float32)
