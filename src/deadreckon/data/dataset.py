"""The log: immutable columns in episodes, validated on load."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.spec import Box, Discrete, Spec, Statistics
from deadreckon.errors import UserError, naming

SLACK = 1e-6  # that a logarithm of a probability may lie above 0 by rounding
_BLOCK = 262_144  # rows looked at together, so that checks never load a memory-mapped column whole


@dataclass(frozen=True)
class Provenance:
    """Where a log comes from. `extra` holds whatever else the source says, as JSON values."""

    source: str = "arrays"  # "collected", "d4rl-hdf5", "minari", "csv", ...
    recipe: str | None = None  # name that `deadreckon data collect` takes
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)  # of the simulator and of deadreckon
    path: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Logged steps in episodes. Build one with `Dataset.from_arrays`, `Dataset.from_frame` or `deadreckon.read`.

    Row `t` holds the observation seen, the action taken there, the reward that followed and how the step ended:
    `terminals` (the task ended, no future) or `timeouts` (only the recording ended). Columns may be memory-mapped.

    Attributes:
        observations: (rows, *shape), float32 or uint8.
        actions: (rows, size) float32 for `Box`, (rows,) int32 for `Discrete`. As logged, also where out of bounds.
        rewards: (rows,) float32.
        terminals: (rows,) bool.
        timeouts: (rows,) bool; the last row of the log is one unless it is a terminal.
        final_observations: (episodes, *shape), what was seen after each episode's last action.
        final_known: (episodes,) bool, False where the log does not say.
        successors: (rows, *shape) or None; only for logs whose next observation is not the following row's.
        extras: further columns of `rows` rows: behaviour log-probabilities, goals, simulator state, ...
        action_space: declared bounds, or the range of the data.
        name: such as `maze2d-umaze-v1@dr1`.
        provenance: where the log comes from.
        warnings: what was noticed on load, one line each.
        part_of: where it is a part of another log, what gives the `episode_ids` that its episodes have there.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminals: np.ndarray
    timeouts: np.ndarray
    final_observations: np.ndarray
    final_known: np.ndarray
    successors: np.ndarray | None
    extras: Mapping[str, np.ndarray]
    action_space: Box | Discrete
    name: str
    provenance: Provenance
    warnings: tuple[str, ...] = ()
    part_of: Callable[[], np.ndarray] | None = field(default=None, repr=False)

    # ---- building -------------------------------------------------------------------------------------------------

    @classmethod
    def from_arrays(
        cls,
        *,
        observations: np.ndarray,
        actions: np.ndarray,
        rewards: np.ndarray,
        terminals: np.ndarray | None = None,
        timeouts: np.ndarray | None = None,
        next_observations: np.ndarray | None = None,
        final_observations: np.ndarray | None = None,
        final_known: np.ndarray | None = None,
        action_space: Box | Discrete | None = None,
        name: str = "arrays",
        provenance: Provenance | None = None,
        strict: bool = False,
        **extras: np.ndarray,
    ) -> "Dataset":
        """Checks columns and makes a `Dataset` of them.

        Args:
            observations: (rows, *shape) numbers; uint8 of rank >= 2 per row stays uint8 (images).
            actions: (rows, size) numbers, or (rows,) integers for discrete actions.
            rewards: (rows,) numbers.
            terminals: (rows,) truth values; all false if absent.
            timeouts: (rows,) truth values. If absent, an episode ends at a terminal, at the last row and, where
                `next_observations` is given, wherever the next row does not continue it.
            next_observations: (rows, *shape); kept as a column only if it differs from the following row inside an
                episode, else reduced to the final observation of each episode.
            final_observations: (episodes, *shape), instead of `next_observations`.
            final_known: (episodes,) truth values, false where the log does not say; all true if absent.
            action_space: bounds of the actions; the range of the data if absent.
            name: of the log.
            provenance: where the columns come from.
            strict: refuse actions out of bounds instead of warning.
            **extras: further columns with `rows` rows; `behavior_log_probs` are the logging policy's log-probabilities of the
                logged actions, at most 0 where actions are discrete (of continuous ones they are log-densities).

        Raises:
            UserError: one line that names the column and the row.
        """
        actions = np.asanyarray(actions)
        rows = len(actions) if actions.ndim else 0
        if rows == 0:
            raise UserError(f"{name}: the log has no rows")
        columns: dict[str, Any] = {"observations": observations, "actions": actions, "rewards": rewards, **extras}
        given = {"terminals": terminals, "timeouts": timeouts, "next_observations": next_observations}
        columns |= {key: value for key, value in given.items() if value is not None}
        for key, value in columns.items():
            value = np.asanyarray(value)
            if value.ndim == 0 or len(value) != rows:
                have = 0 if value.ndim == 0 else len(value)
                raise UserError(f"{name}: column {key} has {have} rows, actions have {rows}")
            _check_numbers(name, key, value)

        observations = _observation_column(name, "observations", observations)
        actions, space = _action_column(name, actions, action_space)
        if isinstance(space, Discrete) and LOG_PROBS in extras:
            _check_log_probabilities(name, np.asanyarray(extras[LOG_PROBS]))
        rewards = _flat(name, "rewards", rewards, np.float32)
        terminals = np.zeros(rows, bool) if terminals is None else _flag(name, "terminals", terminals)
        if next_observations is not None:
            next_observations = _observation_column(name, "next_observations", next_observations)
            if next_observations.shape != observations.shape:
                raise UserError(
                    f"{name}: next_observations have shape {next_observations.shape}, observations {observations.shape}"
                )
        if timeouts is not None:
            timeouts = _flag(name, "timeouts", timeouts).copy()
        elif next_observations is not None:
            timeouts = np.append(_breaks(observations, next_observations), True) & ~terminals
        else:
            timeouts = np.zeros(rows, bool)
        timeouts[-1] |= not terminals[-1]
        last = np.flatnonzero(terminals | timeouts)

        successors = None
        if next_observations is not None:
            final, known = np.ascontiguousarray(next_observations[last]), np.ones(len(last), bool)
            successors = _if_needed(next_observations, observations, terminals | timeouts)
        elif final_observations is not None:
            final, known = _observation_column(name, "final_observations", final_observations), np.ones(len(last), bool)
            if final.shape != (len(last), *observations.shape[1:]):
                want = (len(last), *observations.shape[1:])
                raise UserError(f"{name}: final_observations have shape {final.shape}, {want} is needed, one per episode")
            _check_numbers(name, "final_observations", final)
            if final_known is not None:
                known = _flag(name, "final_known", final_known)
                if len(known) != len(last):
                    raise UserError(f"{name}: final_known has {len(known)} values, {len(last)} episodes need one each")
        else:
            final, known = np.ascontiguousarray(observations[last]), np.zeros(len(last), bool)
        if not known.all():
            # A placeholder; nobody bootstraps from it, because these rows are dropped or terminal.
            final = np.where(known.reshape(-1, *[1] * (final.ndim - 1)), final, observations[last])

        warnings = _bounds_warnings(name, actions, space, strict)
        log = cls(
            observations, actions, rewards, terminals, timeouts, final, known, successors,
            {key: np.asanyarray(value) for key, value in extras.items()},
            space, name, provenance or Provenance(), tuple(warnings),
        )  # fmt: skip
        if dropped := log.dropped:
            text = f"{dropped} of {rows} rows have no known successor (the log ends there without a terminal), left out"
            log = replace(log, warnings=(*log.warnings, text))
        return log

    @classmethod
    def from_frame(
        cls, frame: Any, *, name: str = "frame", strict: bool = False, source: str = "frame", **mapping: Any
    ) -> "Dataset":
        """A table of one's own as a log.

        Args:
            frame: a pandas, polars or pyarrow table, or a mapping of column names to sequences of `rows` values.
            name: of the log, used in errors.
            strict: refuse actions out of bounds instead of warning.
            source: kind of table, for the provenance.
            **mapping: which column is what: `action`, `reward`, `episode`, `time`, `observations`, `ignore`, `terminal`,
                `timeout`, `propensity` and `keep`; see `data.frame.frame_columns`.

        Raises:
            UserError: one line with the column and the row (counted from 0, as in the table given).
        """
        from deadreckon.data.frame import frame_columns  # its library of tables takes a while to load

        columns, extra, warnings = frame_columns(frame, name=name, **mapping)
        with naming(name, name):
            log = cls.from_arrays(**columns, name=name, provenance=Provenance(source=source, extra=extra), strict=strict)
        return replace(log, warnings=(*warnings, *log.warnings))

    # ---- shape ----------------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.actions)

    def __repr__(self) -> str:
        return f"Dataset({self.name}: {len(self):,} steps, {self.episodes:,} episodes, {self.action_space})"

    @cached_property
    def _is_end(self) -> np.ndarray:
        return np.asarray(self.terminals) | np.asarray(self.timeouts)

    @cached_property
    def ends(self) -> np.ndarray:
        """(episodes,) index of each episode's last row."""
        return np.flatnonzero(self._is_end)

    @cached_property
    def starts(self) -> np.ndarray:
        """(episodes,) index of each episode's first row."""
        return np.append(0, self.ends[:-1] + 1)

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.ends)

    @property
    def lengths(self) -> np.ndarray:
        """(episodes,) steps in each."""
        return self.ends - self.starts + 1

    @cached_property
    def episode_of(self) -> np.ndarray:
        """(rows,) index of the episode that a row belongs to."""
        return np.repeat(np.arange(self.episodes), self.lengths)

    @cached_property
    def spec(self) -> Spec:
        """Shape, bounds and statistics of the log."""
        return Spec(
            observation_shape=self.observations.shape[1:],
            observation_dtype=str(self.observations.dtype),
            action=self.action_space,
            observation=Statistics.of(self.observations),
            actions=Statistics.of(self.actions),
            reward=Statistics.of(self.rewards),
            rows=len(self),
            episodes=self.episodes,
            longest=int(self.lengths.max()),
            name=self.name,
        )

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of what methods can see of the log: its columns and its action space."""
        digest = hashlib.blake2b(repr(self.action_space).encode(), digest_size=16)
        named = {"observations": self.observations, "actions": self.actions, "rewards": self.rewards,
                 "terminals": self.terminals, "timeouts": self.timeouts, "final_observations": self.final_observations,
                 "final_known": self.final_known, **dict(sorted(self.extras.items()))}  # fmt: skip
        if self.successors is not None:
            named["successors"] = self.successors
        for key, column in named.items():
            digest.update(f"{key}{column.shape}{column.dtype}".encode())
            for start in range(0, len(column), _BLOCK):
                digest.update(np.ascontiguousarray(column[start : start + _BLOCK]).tobytes())
        return digest.hexdigest()

    @cached_property
    def episode_ids(self) -> np.ndarray:
        """(episodes,) uint64 that tell episodes apart and know them again; see `data.episodes.content_ids`.

        The same content gives the same numbers whatever file it is read from. A part has those of the log it was taken from.
        """
        from deadreckon.data.episodes import content_ids

        if self.part_of is not None and len(ids := self.part_of()) == self.episodes:
            return ids
        return content_ids(self)

    # ---- derived columns --------------------------------------------------------------------------------------------

    @cached_property
    def usable(self) -> np.ndarray:
        """(rows,) bool: the successor is known, or the row is terminal and has none that matters."""
        usable = np.ones(len(self), bool)
        usable[self.ends] = self.final_known | self.terminals[self.ends]
        return usable

    @property
    def dropped(self) -> int:
        """Rows that no method is shown because their successor is unknown."""
        return int(len(self) - self.usable.sum())

    def next_observations_at(self, rows: np.ndarray) -> np.ndarray:
        """Observation after each of `rows`; it never crosses into another episode. Same shape rule as indexing."""
        if self.successors is not None:
            return self.successors[rows]
        ends = self._is_end[rows]
        following = np.asarray(self.observations[np.minimum(rows + 1, len(self) - 1)])
        following[ends] = self.final_observations[self.episode_of[rows[ends]]]
        return following

    @property
    def next_observations(self) -> np.ndarray:
        """(rows, *shape) observation after each row. For rows that are not `usable` it repeats the row's own."""
        return self.next_observations_at(np.arange(len(self)))

    def returns(self, discount: float = 1.0) -> np.ndarray:
        """(episodes,) float64 return of each episode: the sum of discount^t times reward, up to its last row."""
        return self.returns_to_go(discount)[self.starts]

    def returns_to_go(self, discount: float = 1.0) -> np.ndarray:
        """(rows,) float64 return from each row to the end of its episode; nothing is added beyond a timeout."""
        to_go = np.asarray(self.rewards, np.float64).copy()
        # All episodes are walked back together, longest first, so that there are as many numpy calls as steps.
        order = np.argsort(-self.lengths, kind="stable")
        ends, lengths = self.ends[order], self.lengths[order]
        for back in range(1, int(lengths[0])):
            rows = ends[: np.searchsorted(-lengths, -back, side="left")] - back
            to_go[rows] += discount * to_go[rows + 1]
        return to_go

    # ---- parts ----------------------------------------------------------------------------------------------------

    def loaded(self) -> "Dataset":
        """The same log with its memory-mapped columns read into memory, so that their files may go."""
        read = lambda column: np.array(column) if isinstance(column, np.memmap) else column  # noqa: E731
        fields = ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations", "final_known")
        return replace(
            self,
            **{name: read(getattr(self, name)) for name in (*fields, "successors")},
            extras={key: read(value) for key, value in self.extras.items()},
            part_of=None if self.part_of is None else _given(self.episode_ids),
        )

    def select(self, episodes: Sequence[int] | np.ndarray, name: str | None = None) -> "Dataset":
        """The log with only these episodes, in this order."""
        episodes = np.asarray(episodes)
        if episodes.size == 0:
            raise UserError(f"{self.name}: a part with no episodes was asked for")
        lengths = self.lengths[episodes]
        offsets = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        rows: Any = np.repeat(self.starts[episodes], lengths) + offsets
        if (np.diff(rows) == 1).all():  # neighbours are not copied, so that memory maps stay such
            rows = slice(int(rows[0]), int(rows[-1]) + 1)
        observations, terminals, timeouts = self.observations[rows], self.terminals[rows], self.timeouts[rows]
        successors = None
        if self.successors is not None:
            successors = _if_needed(self.successors[rows], observations, terminals | timeouts)
        return replace(
            self,
            observations=observations, actions=self.actions[rows], rewards=self.rewards[rows],
            terminals=terminals, timeouts=timeouts,
            final_observations=self.final_observations[episodes], final_known=self.final_known[episodes],
            successors=successors,
            extras={key: value[rows] for key, value in self.extras.items()},
            name=name or self.name,
            part_of=lambda: self.episode_ids[episodes],
        )  # fmt: skip

    def split(self, fraction: float = 0.8, seed: int = 0, by: str = "episode") -> tuple["Dataset", "Dataset"]:
        """Two parts of whole episodes: about `fraction` of the episodes, and the rest.

        Args:
            fraction: share of the first part, between 0 and 1.
            seed: of the shuffle.
            by: "episode" draws at random, "time" takes the earliest (rows are in the order of time), the name of an extra
                column keeps episodes of one value together.
        """
        from deadreckon.data.split import Holdout

        if not 0 < fraction < 1 or self.episodes < 2:
            raise UserError(f"split needs 0 < fraction < 1 and 2 episodes, got {fraction} and {self.episodes}")
        parts = Holdout(1 - fraction, "random" if by == "episode" else by, seed).parts(self)
        return self.select(parts.learning), self.select(parts.held)

    def with_action_space(self, space: Box | Discrete, strict: bool = False) -> "Dataset":
        """The same log under other bounds, such as those of the environment that it will be judged in.

        Raises:
            UserError: other kinds of actions; or, where `strict`, actions out of bounds, also of the log's own.
        """
        if space.size != self.action_space.size or type(space) is not type(self.action_space):
            raise UserError(f"{self.name}: actions are {self.action_space}, {space} was asked for")
        if space == self.action_space:
            if strict:
                _bounds_warnings(self.name, self.actions, space, strict)
            return self
        warnings = _bounds_warnings(self.name, self.actions, space, strict)
        told = (*self.warnings, *warnings)
        return replace(self, action_space=space, warnings=told, part_of=lambda: self.episode_ids)


def _given(ids: np.ndarray) -> Callable[[], np.ndarray]:
    return lambda: ids


# ---- checks on load ---------------------------------------------------------------------------------------------


def _blocks(column: np.ndarray) -> range:
    return range(0, len(column), _BLOCK)


def _check_numbers(log: str, key: str, column: np.ndarray) -> None:
    if column.dtype.kind not in "fiub":
        raise UserError(f"{log}: column {key} holds {column.dtype}, numbers are needed")
    if column.dtype.kind != "f":
        return
    for start in _blocks(column):
        bad = ~np.isfinite(column[start : start + _BLOCK])
        if bad.any():
            where = np.argwhere(bad)[0]
            value = column[start + where[0]][tuple(where[1:])]
            never = ", as if the logged action had had no probability" if key == LOG_PROBS and value == -np.inf else ""
            raise UserError(f"{log}: column {key} has {value} in row {start + where[0]}{never}")


def _check_log_probabilities(log: str, column: np.ndarray) -> None:
    """Refuses probabilities given as their logarithms: every weight made of them would be wrong, and none would show it."""
    row, value, low, high = -1, 0.0, np.inf, -np.inf
    for start in _blocks(column):
        part = column[start : start + _BLOCK]
        low, high = min(low, float(part.min())), max(high, float(part.max()))
        if row < 0 and high > SLACK:
            first = np.argwhere(part > SLACK)[0]
            row, value = start + int(first[0]), float(part[tuple(first)])
    if row < 0:
        return
    like = "; all values lie in 0 .. 1 and look like probabilities, give their logarithms" if low >= 0 and high <= 1 else ""
    found = f"column {LOG_PROBS} has {value:g} in row {row}"
    raise UserError(f"{log}: {found}, a log-probability of a discrete action is <= 0{like}")


def _observation_column(log: str, key: str, column: np.ndarray) -> np.ndarray:
    column = np.asanyarray(column)
    if column.ndim == 1:
        column = column[:, None]
    if column.dtype == np.uint8 and column.ndim >= 3:
        return column
    return _float32(log, key, column)


def _flat(log: str, key: str, column: np.ndarray, dtype: Any) -> np.ndarray:
    column = np.asanyarray(column)
    if column.size != len(column):
        raise UserError(f"{log}: column {key} has shape {column.shape}, one value a row is needed")
    column = column.reshape(len(column))
    if dtype == np.float32:
        return _float32(log, key, column)
    return column if column.dtype == dtype else column.astype(dtype)


def _float32(log: str, key: str, column: np.ndarray) -> np.ndarray:
    if column.dtype == np.float32:
        return column
    with np.errstate(over="ignore"):
        small = column.astype(np.float32)
    if column.dtype.itemsize > 4 and np.isinf(small).any():
        row = int(np.argwhere(np.isinf(small))[0][0])
        raise UserError(f"{log}: column {key} has a number in row {row} that float32 cannot hold; rescale it")
    return small


def _flag(log: str, key: str, column: np.ndarray) -> np.ndarray:
    column = np.asanyarray(column)
    if column.dtype != bool:
        wrong = ~np.isin(column, (0, 1))
        if wrong.any():
            row = np.argwhere(wrong)[0][0]
            raise UserError(f"{log}: column {key} has {column[row]} in row {row}, 0 or 1 is needed")
    return _flat(log, key, column, bool)


def _action_column(log: str, column: np.ndarray, space: Box | Discrete | None) -> tuple[np.ndarray, Box | Discrete]:
    integers = column.dtype.kind in "iub" and column.size == len(column)
    if isinstance(space, Discrete) or (space is None and integers):
        broken = column != np.floor(column) if column.dtype.kind == "f" else np.zeros(1, bool)
        if broken.any():
            row = int(np.argwhere(broken)[0][0])
            raise UserError(f"{log}: column actions has {column[row]} in row {row}, an integer is needed")
        column = _flat(log, "actions", column, np.int32)
        n = space.n if space else int(column.max()) + 1
        wrong = (column < 0) | (column >= n)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise UserError(f"{log}: column actions has {column[row]} in row {row}, 0 .. {n - 1} is needed")
        return column, space or Discrete(max(n, 2))
    column = _float32(log, "actions", column.reshape(len(column), -1))
    if space is None:
        low, high = column.min(0).astype(float), column.max(0).astype(float)
        flat = low == high  # a dimension that never moves still needs a width
        space = Box(tuple((low - flat).tolist()), tuple((high + flat).tolist()))
    if column.shape[1] != space.size:
        raise UserError(f"{log}: actions have {column.shape[1]} dimensions, the bounds have {space.size}")
    return column, space


def _bounds_warnings(log: str, actions: np.ndarray, space: Box | Discrete, strict: bool) -> list[str]:
    if isinstance(space, Discrete):
        return []
    low, high = np.asarray(space.low, np.float32), np.asarray(space.high, np.float32)
    count, first = 0, -1
    for start in _blocks(actions):
        part = actions[start : start + _BLOCK]
        outside = ((part < low) | (part > high)).any(1)
        if first < 0 and outside.any():
            first = start + int(np.argmax(outside))
        count += int(outside.sum())
    if not count:
        return []
    share = f"{count} of {len(actions)} rows ({100 * count / len(actions):.0f} %)"
    text = f"{share} have actions out of bounds, first row {first}"
    if strict:
        raise UserError(f"{log}: {text}; without --strict they are clipped")
    return [f"{text}; methods see them clipped"]


def _if_needed(following: np.ndarray, observations: np.ndarray, ends: np.ndarray) -> np.ndarray | None:
    """`following`, or None where the next row says the same: one log has one form, and one fingerprint."""
    return following if (_breaks(observations, following) & ~ends[:-1]).any() else None


def _breaks(observations: np.ndarray, following: np.ndarray) -> np.ndarray:
    """(rows - 1,) bool: the next row's observation is not this row's next observation."""
    out = np.empty(len(observations) - 1, bool)
    for start in range(0, len(out), _BLOCK):
        stop = min(start + _BLOCK, len(out))
        differs = observations[start + 1 : stop + 1] != following[start:stop]
        out[start:stop] = differs.reshape(stop - start, -1).any(1)
    return out
