"""From columns to minibatches: the request of a method (`BatchSpec`), the batch (`Batch`) and its source (`BatchSource`)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import continued_returns
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.scratch import BLOCK
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError, unknown
from deadreckon.randomness import generator

REVISION = 1  # of what batches hold for given rows; raised where their numbers change (see bench/identity.py)


class Batch(NamedTuple):
    """A minibatch of `b` rows, or `b, window` with windows; fields that were not requested are None.

    Actions are in [-1, 1] (or int32 indices); `terminal` is 1.0 if there is no future. With n-step rows, `reward` is the
    discounted sum of the steps' rewards, `next_observation` the observation after the last of them, and `discount` the factor
    of the value there, zero at terminals; for one step it is the discount times `1 - terminal`.
    """

    observation: Any = None
    action: Any = None
    reward: Any = None
    next_observation: Any = None
    terminal: Any = None
    discount: Any = None
    next_action: Any = None  # action of the following row; zero after an episode's last
    follows: Any = None  # 1.0 where the log has a following row of the same episode
    return_to_go: Any = None  # discounted, to the end of the recorded episode
    monte_carlo: Any = None  # (b, 2) discounted rewards, and steps, to a terminal or for ever; see `episodes.continued_returns`
    time: Any = None  # steps since the episode's start
    behavior_log_prob: Any = None  # of the logged action, where the log has it
    initial_observation: Any = None  # `initial` rows, drawn from the episodes' starts
    mask: Any = None  # windows: 1.0 inside the episode, 0.0 beyond its end
    extra: dict[str, Any] | None = None  # columns of the method's own, by name


@dataclass(frozen=True)
class BatchSpec:
    """The contents of every batch, as a method requests them.

    Attributes:
        columns: names of `Batch` fields.
        batch_size: rows (or windows) per batch.
        n_step: rewards summed before bootstrapping.
        window: 0 for single rows, else the length of consecutive rows.
        initial: number of initial observations per batch.
        standardise: whether observations have mean 0 and standard deviation 1.
        gamma: discount of `return_to_go`, of `monte_carlo`, of n-step sums and of `discount`.
    """

    columns: tuple[str, ...] = ("observation", "action", "reward", "next_observation", "terminal")
    batch_size: int = 256
    n_step: int = 1
    window: int = 0
    initial: int = 0
    standardise: bool = False
    gamma: float = 0.99

    @property
    def sums(self) -> bool:
        """Whether rows that grow are summed up over `n_step` transitions when they are drawn (`training.program.summed`)."""
        return "discount" in self.columns


def redrawn(count: int, members: int, seed: int) -> np.ndarray:
    """(count, members) count of each of `count` items for each member of an ensemble: resampled with replacement.

    One member alone counts each once.
    """
    if members == 1:
        return np.ones((count, 1), np.float32)
    draws = generator(seed, "redrawn").multinomial(count, np.full(count, 1 / count), members)
    return draws.T.astype(np.float32)


class BatchSource(Protocol):
    """The rows from which batches are drawn: a log's (`TransitionSource`), or designs.

    Attributes:
        needs: the contents of every batch.
        fields: per column its shape and dtype, as returned by `take`.
        initial: (episodes, *shape) initial observations and their further columns, or None.
        count: rows to draw from.
        view: the coordinates of the columns, if policies have some.
    """

    needs: Any
    view: Any
    fields: dict[str, tuple[tuple[int, ...], Any]]
    initial: dict[str, np.ndarray] | None
    count: int

    @property
    def spec(self) -> Any:
        """The spec of the rows, for methods."""
        ...

    @property
    def nbytes(self) -> int:
        """Memory that all columns take."""
        ...

    def take(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Columns at these indices."""
        ...


class TransitionSource:
    """A log as the source of batches: single rows or windows that `take` fetches by index, on the host.

    Training either keeps `take(everything)` on the device or fetches each batch with it; the numbers are the same.

    Args:
        log: where the rows come from.
        needs: the contents of every batch.
        extra: (rows, *shape) further columns of the method, with a row for each row of the log; batches have them in `extra`.
        initial_extra: (episodes, *shape) likewise, drawn with the initial observations.

    Attributes:
        view: the coordinates that the columns are in.
        count: rows to draw from; if successors are requested, those whose successor is known.
        fields: per column its shape and dtype, as `take` gives it.
        initial: (episodes, *shape) initial observations and what goes with them, or None.
    """

    def __init__(
        self,
        log: Dataset,
        needs: BatchSpec,
        extra: dict[str, np.ndarray] | None = None,
        initial_extra: dict[str, np.ndarray] | None = None,
    ):
        self.log, self.needs, self.extra = log, needs, extra or {}
        for name, column in self.extra.items():
            if len(column) != len(log) or name in Batch._fields:
                raise ValueError(f"{name}: an extra column has a name of its own and as many rows as the log")
        for name, column in (initial_extra or {}).items():
            if len(column) != log.episodes or name in Batch._fields or not needs.initial:
                raise ValueError(f"{name}: an extra initial column has a name of its own and as many rows as the log episodes")
        self.view = Normalizer.of(log.spec, needs.standardise)
        for name in needs.columns:
            if name not in _COLUMNS:
                raise unknown("column", name, _COLUMNS)
        if needs.batch_size < 1 or needs.n_step < 1 or needs.window < 0:
            raise UserError(
                f"batch_size and n_step must be >= 1 and window >= 0, got {needs.batch_size}, {needs.n_step}, {needs.window}"
            )
        if log.successors is not None and (needs.n_step > 1 or needs.window):
            raise UserError(f"{log.name}: its rows do not follow each other, so n-step rows and windows cannot be cut from it")
        if log.successors is not None and {"next_action", "follows", "monte_carlo"} & set(needs.columns):
            raise UserError(f"{log.name}: its rows do not follow each other, so the next logged actions are not known")
        # Whoever looks at successors is not shown rows without one. Windows are runs of the log itself, so all rows stay.
        looks_ahead = "next_observation" in needs.columns
        usable = log.usable if looks_ahead else np.ones(len(log), bool)
        if looks_ahead and needs.n_step > 1:
            blocks = (np.arange(start, min(start + BLOCK, len(log))) for start in range(0, len(log), BLOCK))
            usable = np.concatenate([usable[self.last(rows)] for rows in blocks])
        # Rows that are not shown are few, and those that are follow from them: an index of these would grow with the log.
        self._hidden = np.zeros(0, np.int64) if needs.window else np.flatnonzero(~usable)
        self._before = self._hidden - np.arange(len(self._hidden))  # rows that are shown before each hidden one
        self._blind = looks_ahead & ~log.usable[log.ends]  # (episodes,) whose last row has no known successor
        self.count = len(log) - len(self._hidden)
        if self.count == 0 or not usable.any():
            raise UserError(f"{log.name}: no row has a next observation or a terminal")
        self.initial: dict[str, np.ndarray] | None = None
        if needs.initial:
            first = self.view.observe(np.asarray(log.observations[log.starts]))
            self.initial = {"initial_observation": first, **(initial_extra or {})}
        probe = self.take(np.zeros(1, np.int64))
        self.fields = {name: (column.shape[1:], column.dtype) for name, column in probe.items()}

    @property
    def spec(self) -> Spec:
        """The log's."""
        return self.log.spec

    @property
    def nbytes(self) -> int:
        """Memory that all columns take on a device."""
        return self.count * sum(int(np.prod(shape)) * dtype.itemsize for shape, dtype in self.fields.values())

    def take(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Columns at these indices (any shape, each in 0 .. count - 1), the index's axes first."""
        flat = index.reshape(-1)
        rows = flat if not len(self._hidden) else flat + np.searchsorted(self._before, flat, side="right")
        columns = {name: _COLUMNS[name](self, rows) for name in self.needs.columns}
        columns |= {name: column[rows] for name, column in self.extra.items()}
        if self.needs.window:
            columns["_left"] = (self._left(rows) - self._blind[self.log.episode_at(rows)]).astype(np.float32)
        return {name: column.reshape(*index.shape, *column.shape[1:]) for name, column in columns.items()}

    def _left(self, rows: np.ndarray) -> np.ndarray:
        """Steps that follow each row in the same episode."""
        return self.log.ends[self.log.episode_at(rows)] - rows

    @cached_property
    def _returns_to_go(self) -> np.ndarray:
        return self.log.returns_to_go(self.needs.gamma).astype(np.float32)

    @cached_property
    def _monte_carlo(self) -> np.ndarray:
        log = self.log
        ended = np.asarray(log.terminals)[log.ends]
        rewards = np.asarray(log.rewards)
        return continued_returns(rewards, log.ends, log.lengths, ended, self.needs.gamma).astype(np.float32)

    def span(self, rows: np.ndarray) -> np.ndarray:
        """Steps that an n-step backup from each row takes: n, or fewer at an episode's end."""
        return np.minimum(self.needs.n_step, self._left(rows) + 1)

    def reward(self, rows: np.ndarray) -> np.ndarray:
        """Discounted sum of the rewards over the n-step span."""
        total = np.asarray(self.log.rewards[rows], np.float32)
        for k in range(1, self.needs.n_step):
            inside = k < self.span(rows)
            later = self.log.rewards[np.minimum(rows + k, len(self.log) - 1)]
            total = total + np.where(inside, np.float32(self.needs.gamma**k) * later, np.float32(0.0))
        return total

    def last(self, rows: np.ndarray) -> np.ndarray:
        """Last row of each n-step span."""
        return rows if self.needs.n_step == 1 else rows + self.span(rows) - 1


def _discount(r: TransitionSource, rows: np.ndarray) -> np.ndarray:
    steps = r.span(rows) if r.needs.n_step > 1 else np.ones(len(rows))
    return ((r.needs.gamma**steps) * ~np.asarray(r.log.terminals[r.last(rows)])).astype(np.float32)


def _next_action(r: TransitionSource, rows: np.ndarray) -> np.ndarray:
    action = _action(r, np.minimum(rows + 1, len(r.log) - 1))
    inside = ~r.log.is_end[rows]
    return action * inside.reshape(-1, *[1] * (action.ndim - 1)).astype(action.dtype)


def _action(r: TransitionSource, rows: np.ndarray) -> np.ndarray:
    return r.view.to_unit(np.asarray(r.log.actions[rows]))


def _behavior_log_prob(r: TransitionSource, rows: np.ndarray) -> np.ndarray:
    if "behavior_log_probs" not in r.log.extras:
        raise UserError(f"{r.log.name}: no column behavior_log_probs; give the logged propensities or learn them")
    return np.asarray(r.log.extras["behavior_log_probs"][rows], np.float32) + np.float32(r.view.log_scale)


_COLUMNS: dict[str, Callable[[TransitionSource, np.ndarray], np.ndarray]] = {
    "observation": lambda r, i: r.view.observe(np.asarray(r.log.observations[i])),
    "action": _action,
    "reward": lambda r, i: r.reward(i),
    "next_observation": lambda r, i: r.view.observe(r.log.next_observations_at(r.last(i))),
    "terminal": lambda r, i: np.asarray(r.log.terminals[r.last(i)], np.float32),
    "discount": _discount,
    "next_action": _next_action,
    "follows": lambda r, i: (~r.log.is_end[i]).astype(np.float32),
    "return_to_go": lambda r, i: r._returns_to_go[i],
    "monte_carlo": lambda r, i: r._monte_carlo[i],
    "time": lambda r, i: (i - r.log.starts[r.log.episode_at(i)]).astype(np.float32),
    "behavior_log_prob": _behavior_log_prob,
}
