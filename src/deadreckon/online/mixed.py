"""Experience beside a log: every batch has a given share of logged rows; the rest is the agents' own experience."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.agent import Agent
from deadreckon.data.batch import BatchSpec, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import continued_returns
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.online.exploration import Exploration
from deadreckon.online.turns import Online
from deadreckon.tasks.task import Task
from deadreckon.training.program import layout_of
from deadreckon.training.replay import read_rows
from deadreckon.training.sources import packed_rows


class MixedReplay(Exploration):
    """The agents' rows from a task, in the coordinates of a log, and the log.

    Rows in the files are as in `Exploration`; learners receive them without the timeout, and, if they request `monte_carlo`,
    with the returns of episodes, which are -inf until an episode has ended.

    Args:
        log: beside the experience; observations are standardised by it, and actions have its bounds.
        share: of logged rows in each batch.

    Raises:
        UserError: as `Exploration`; a log of other sizes or of wider bounds than the task; a share that is no whole number of
            rows.
    """

    revision: ClassVar[int] = 1
    _as_it_is = False
    _sums = False
    _learning = "learn from rows of a log and of its own alone"

    def __init__(
        self, task: Task, agent: Agent, seeds: Sequence[int], updates: int, settings: Online, paths: Sequence[Path] = (),
        threads: int | None = None, *, log: Dataset, share: float = 0.5,
    ):  # fmt: skip
        check_sizes(log, task)
        check_bounds(log, task)
        self.log, self.share = log, share
        super().__init__(task, agent, seeds, updates, settings, paths, threads)

    def _spec(self):
        return self.log.spec

    def _fits(self, agent: Agent) -> bool:
        check_agent(agent)
        return True

    def _further(self, needs: BatchSpec) -> dict[str, tuple[int, ...]]:
        return {"monte_carlo": (2,)} if "monte_carlo" in needs.columns else {}

    @property
    def _learned(self) -> int:
        return sum(int(np.prod(shape)) for shape, _ in self.fields.values())

    def _begin(self, agent: Agent) -> None:
        self.logged = logged_rows(self.share, self.needs.batch_size)
        rows = TransitionSource(self.log, replace(self.needs, columns=tuple(self.fields)))
        packed = packed_rows([rows], layout_of(self.fields)) if self.logged else {}
        self._logged = {"logged": (jax.device_put(packed), jnp.int32(rows.count))} if self.logged else {}
        lanes, capacity = self.replay.buffer.shape[:2]
        self._returns = Returns(lanes, self.copies, capacity, self.needs.gamma) if "monte_carlo" in self.fields else None

    def _learnable(self, rows: np.ndarray) -> np.ndarray:
        out = super()._learnable(rows)[..., :-1]
        size = self.spec.observation_size
        following = slice(out.shape[-1] - 1 - size, out.shape[-1] - 1)  # before the terminal
        for part in (slice(0, size), following):
            out[..., part] = self.view.observe(out[..., part])
        if "monte_carlo" not in self.fields:
            return out
        return np.concatenate([out, np.broadcast_to(UNKNOWN, (*out.shape[:-1], 2))], -1)

    def extend(self, learner: Any, states: Any, roots: Key[Array, "l"], step: int) -> tuple[Any, dict[str, Any]]:
        """See `Experience`."""
        states, data = super().extend(learner, states, roots, step)
        return states, data | self._logged

    def _keep(self, rows: Float[np.ndarray, "l n w"]) -> None:
        first = self.replay.count
        super()._keep(rows)
        self._note_returns(rows, first)

    def _note_returns(self, rows: Float[np.ndarray, "l n w"], first: int) -> None:
        """Updates the returns of episodes that ended in new rows."""
        if self._returns is None:
            return
        reward = rows[..., self._action.stop]
        changed = self._returns.see(first, reward, rows[..., -2] > 0, rows[..., -1] > 0)
        self.replay.amend(changed, self._returns.values)

    def restore(self, state: dict[str, Any]) -> None:
        """See `Experience`; returns are computed again from the rows."""
        super().restore(state)
        if self._returns is not None and (count := self.replay.count):
            rows = [np.asarray(read_rows(path, self.replay.width, count)) for path in self.paths]
            self._returns.clear()
            self._note_returns(np.stack(rows), 0)


UNKNOWN = np.array([-np.inf, 0.0], np.float32)  # the return of an episode that has not ended


class Returns:
    """The returns of the episodes of several copies, whose rows are interleaved; see `continued_returns`.

    Attributes:
        values: (lanes, capacity, 2) discounted rewards and steps from each row on; `UNKNOWN` until its episode has ended.
    """

    def __init__(self, lanes: int, copies: int, capacity: int, discount: float):
        self.copies, self.discount = copies, discount
        self.values = np.empty((lanes, capacity, 2), np.float32)
        self._rewards = np.zeros((lanes, capacity), np.float32)
        self._begun = np.zeros((lanes, copies), np.int64)  # the first row of each copy's episode
        self.clear()

    def clear(self) -> None:
        """Drops all rows."""
        self.values[:] = UNKNOWN
        self._begun[:] = np.arange(self.copies)

    def see(
        self, first: int, reward: Float[np.ndarray, "l n"], terminal: np.ndarray, timeout: np.ndarray
    ) -> int:  # fmt: skip
        """Adds new rows.

        Args:
            first: index of the first of them.
            reward: of each row.
            terminal: (l, n) truth values.
            timeout: (l, n) truth values.

        Returns:
            The first row whose values have changed.
        """
        self._rewards[:, first : first + reward.shape[1]] = reward
        changed = first
        for lane, at in np.argwhere(terminal | timeout):
            row = first + at
            copy = row % self.copies
            rows = np.arange(int(self._begun[lane, copy]), int(row) + 1, self.copies)
            last, length = np.array([len(rows) - 1]), np.array([len(rows)])
            own = self._rewards[lane, rows]
            self.values[lane, rows] = continued_returns(own, last, length, terminal[lane, at : at + 1], self.discount)
            changed = min(changed, int(rows[0]))
            self._begun[lane, copy] = row + self.copies
        return changed


def check_agent(agent: Agent) -> None:
    """Refuses an agent that cannot continue with a log in its replay.

    Raises:
        UserError: names those that can.
    """
    if not agent.fine_tunes:
        able = ", ".join(name for name in AGENTS if agent_class(name).fine_tunes)
        raise UserError(f"{type(agent).__name__} does not learn online with a log in its replay; these agents do: {able}")


def check_sizes(log: Dataset, task: Task) -> None:
    """Refuses a log that cannot be combined with experience in a task.

    Raises:
        UserError: its observations or actions have other sizes than those of the task.
    """
    space = task.action_space
    if not isinstance(space, Box) or not isinstance(log.action_space, Box):
        raise UserError(f"{log.name} and {task.name}: a log in a task needs continuous actions, in both")
    asked, found = (task.observation_shape, space.size), (log.spec.observation_shape, log.spec.action_size)
    if asked != found:
        sizes = f"{found[0]} and {found[1]} actions, {task.name} has {asked[0]} and {asked[1]}"
        raise UserError(f"{log.name} has observations {sizes}")


def check_bounds(log: Dataset, task: Task) -> None:
    """Refuses a log whose bounds of actions, which the policy also has, are wider than those of a task of the same sizes.

    Raises:
        UserError: its actions have wider bounds.
    """
    space = task.action_space
    assert isinstance(space, Box)
    assert isinstance(log.action_space, Box)
    low, high = np.subtract(log.action_space.low, space.low), np.subtract(space.high, log.action_space.high)
    if min(low.min(), high.min()) < -1e-6:
        raise UserError(f"{log.name}: actions have the bounds {log.action_space}, beyond those of {task.name}, {space}")


def logged_rows(share: float, batch_size: int) -> int:
    """Number of rows of a batch that come from the log.

    Raises:
        UserError: a share out of range, or one that gives no whole number of rows.
    """
    if not 0 <= share < 1:
        raise UserError(f"log_share must be 0 or more and below 1, got {share}")
    rows = round(share * batch_size)
    if abs(rows - share * batch_size) > 1e-9:
        nearest = f"{rows / batch_size} is the nearest share"
        raise UserError(f"log_share * batch_size must be a whole number, got {share} * {batch_size}; {nearest}")
    return rows
