"""The log: immutable columns in episodes, validated on load."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from deadreckon.data.checks import bounds_warnings, breaks, checked_columns, if_needed
from deadreckon.data.columns import given_columns, in_memory, unmarked
from deadreckon.data.episodes import content_ids, contents, episode_returns, fingerprint, index_type, returns_to_go, rows_of
from deadreckon.data.legal import check_masks, joined_masks
from deadreckon.data.provenance import Provenance
from deadreckon.data.repeats import copied
from deadreckon.data.spec import Box, Discrete, Spec, spec_of
from deadreckon.data.split import Holdout
from deadreckon.errors import UserError
from deadreckon.provided import Shown


@dataclass(frozen=True, eq=False)
class Dataset(Shown):
    """Logged steps in episodes, made by `Dataset.from_arrays`, `from_dict`, `from_frame` or `deadreckon.read`.

    Row `t` holds the observation, the action taken there, the reward that followed and how the step ended:
    `terminals` (the task ended, no future) or `timeouts` (only the recording ended). Columns may be memory-mapped.

    Attributes:
        observations: (rows, *shape), float32 or uint8.
        actions: (rows, size) float32 for `Box`, (rows,) int32 for `Discrete`. As logged, even if out of bounds.
        rewards: (rows,) float32.
        terminals: (rows,) bool.
        timeouts: (rows,) bool; the last row of the log is a timeout unless it is a terminal.
        final_observations: (episodes, *shape), the observation after each episode's last action.
        final_known: (episodes,) bool, False if it is not in the log.
        successors: (rows, *shape) or None; only for logs whose next observation is not the following row's.
        extras: further columns of `rows` rows: behaviour log-probabilities, goals, simulator state, ...
        action_space: declared bounds, or the range of the data.
        name: such as `maze2d-umaze-v1@dr1`.
        provenance: where the log comes from.
        warnings: messages from loading, one line each.
        part_of: for a part of another log, a function that returns the `episode_ids` of its episodes there.
        selected: whether it is some episodes of another log, by `select`.
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
    selected: bool = field(default=False, repr=False)

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
        legal: np.ndarray | Callable[[np.ndarray], np.ndarray] | None = None,
        next_legal: np.ndarray | None = None,
        final_legal: np.ndarray | None = None,
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
            next_observations: (rows, *shape); kept only if they differ from the following row inside an episode.
            final_observations: (episodes, *shape), instead of `next_observations`.
            final_known: (episodes,) truth values, false for unknown ones; all true if absent.
            legal: (rows, n) truth values of the legal discrete actions, or a function that returns them for observations (rows,
                numbers). They become the last n numbers of the observations; all methods and policies take only legal actions.
            next_legal: (rows, n) truth values of `next_observations`, as `legal` of `observations`; see `legal.joined_masks`.
            final_legal: (episodes, n) truth values of `final_observations`, likewise.
            action_space: bounds of the actions; the range of the data if absent.
            name: of the log.
            provenance: where the columns come from.
            strict: refuse actions out of bounds instead of warning.
            **extras: further columns with `rows` rows; `behavior_log_probs` are the logging policy's log-probabilities of the
                logged actions, at most 0 for discrete actions (for continuous ones they are log-densities).

        Raises:
            UserError: one line that names the column and the row.
        """
        columns = {
            "observations": observations, "actions": actions, "rewards": rewards, **extras, "terminals": terminals,
            "timeouts": timeouts, "next_observations": next_observations, "final_observations": final_observations,
            "final_known": final_known, "legal": legal, "next_legal": next_legal, "final_legal": final_legal,
        }  # fmt: skip
        given = {key: column for key, column in columns.items() if column is not None or key in extras}
        given, action_space = joined_masks(name, given, action_space)
        log = cls(**checked_columns(name, given, action_space), name=name, provenance=provenance or Provenance())
        check_masks(name, log.observations, log.actions, log.action_space)
        warnings = bounds_warnings(name, log.actions, log.action_space, strict, log.provenance.extra)
        if lost := log.dropped:
            warnings += [f"{lost} of {len(log)} rows are left out: they have neither a next observation nor a terminal"]
        return replace(log, warnings=tuple(warnings))

    @classmethod
    def from_dict(
        cls, columns: Mapping[str, Any], *, name: str = "arrays", done: str | None = None, strict: bool = False
    ) -> "Dataset":
        """A log from a mapping of arrays in another library's layout (`data.formats.layouts`), or under our names.

        Args:
            columns: {name: (rows, ...)}, possibly nested, or the fields of a replay buffer.
            name: of the log.
            done: what `done` or `dones` alone marks: "terminals" (the task ended) or "timeouts"; refused if absent.
            strict: refuse actions out of bounds instead of warning.

        Raises:
            UserError: one line that names the column and the row.
        """
        from deadreckon.data.formats.arrange import arranged

        found = arranged(name, columns, done)
        given, about = given_columns(name, found.columns), Provenance(extra=found.extra)
        log = cls.from_arrays(**given, action_space=found.space, name=name, provenance=about, strict=strict)
        return replace(log, warnings=(*found.told, *log.warnings, *unmarked(given, log.lengths)))

    @classmethod
    def from_frame(
        cls, frame: Any, *, name: str = "frame", strict: bool = False, source: str = "frame", **mapping: Any
    ) -> "Dataset":
        """A log from a table.

        Args:
            frame: a pandas, polars or pyarrow table, or a mapping of column names to sequences of `rows` values.
            name: of the log, used in errors.
            strict: refuse actions out of bounds instead of warning.
            source: kind of table, for the provenance.
            **mapping: a `schema`, or the roles of columns (`action`, `reward`, `episode`, ...); see `data.frame.frame_columns`.

        Raises:
            UserError: one line with the column and the row (counted from 0, as in the table given).
        """
        from deadreckon.data.frame import frame_columns  # its library of tables takes a while to load
        given, more, warnings, space = frame_columns(frame, name=name, **mapping)
        log = cls.from_arrays(**given, action_space=space, name=name, strict=strict, provenance=Provenance(source, extra=more))
        return replace(log, warnings=(*warnings, *log.warnings))

    def __len__(self) -> int:
        return len(self.actions)

    def __repr__(self) -> str:
        return f"Dataset({self.name}: {len(self):,} steps, {self.episodes:,} episodes, {self.action_space})"

    @cached_property
    def is_end(self) -> np.ndarray:
        """(rows,) bool: the row is its episode's last, a terminal or a timeout."""
        return np.asarray(self.terminals) | np.asarray(self.timeouts)

    @cached_property
    def ends(self) -> np.ndarray:
        """(episodes,) index of each episode's last row."""
        return np.flatnonzero(self.is_end)

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
        """(rows,) int32 index of the episode that a row belongs to; int64 of more than 2^31 episodes."""
        return np.repeat(np.arange(self.episodes, dtype=index_type(self.episodes)), self.lengths)

    def episode_at(self, rows: np.ndarray) -> np.ndarray:
        """`episode_of[rows]`, the episode that each of `rows` belongs to, without a number for every row of the log."""
        return np.searchsorted(self.ends, rows)

    @cached_property
    def spec(self) -> Spec:
        """Shape, bounds and statistics of the log."""
        return spec_of(self)

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of the log's columns and its action space."""
        return fingerprint(self)

    @cached_property
    def episode_ids(self) -> np.ndarray:
        """(episodes,) uint64 ids that identify episodes by their contents, in any file and part; see `episodes.content_ids`."""
        known = None if self.part_of is None else self.part_of()
        return known if known is not None and len(known) == self.episodes else content_ids(self)

    @cached_property
    def episode_contents(self) -> np.ndarray:
        """(episodes,) uint64, the same for equal episodes, in any log."""
        return contents(self)

    @cached_property
    def copied(self) -> np.ndarray | None:
        """(episodes,) number of each episode, the same for copies of one; None if there are none; see `repeats.copied`."""
        return copied(self)

    @cached_property
    def usable(self) -> np.ndarray:
        """(rows,) bool: the successor is known, or the row is terminal and needs none."""
        usable = np.ones(len(self), bool)
        usable[self.ends] = self.final_known | self.terminals[self.ends]
        return usable

    @cached_property
    def apart(self) -> np.ndarray:
        """(rows,) bool: the row's next observation differs from that of the next row of its episode."""
        apart = np.zeros(len(self), bool)
        if self.successors is not None:
            apart[:-1] = breaks(self.observations, self.successors)
        return apart & ~self.is_end

    @property
    def dropped(self) -> int:
        """Number of rows that are not used for training because their successor is unknown."""
        return int(len(self) - self.usable.sum())

    def next_observations_at(self, rows: np.ndarray) -> np.ndarray:
        """Observation after each of `rows`; it never crosses into another episode. Same shape rule as indexing."""
        if self.successors is not None:
            return self.successors[rows]
        ends = self.is_end[rows]
        following = np.asarray(self.observations[np.minimum(rows + 1, len(self) - 1)])
        following[ends] = self.final_observations[np.searchsorted(self.ends, rows[ends])]
        return following

    @property
    def next_observations(self) -> np.ndarray:
        """(rows, *shape) observation after each row. For rows that are not `usable` it repeats the row's own."""
        return self.next_observations_at(np.arange(len(self)))

    def returns(self, discount: float = 1.0) -> np.ndarray:
        """(episodes,) float64 return of each episode: the sum of discount^t times reward, up to its last row."""
        return episode_returns(self.rewards, self.ends, self.lengths, discount)

    def returns_to_go(self, discount: float = 1.0) -> np.ndarray:
        """(rows,) float64 return from each row to the end of its episode; nothing is added beyond a timeout."""
        return returns_to_go(np.asarray(self.rewards), self.ends, self.lengths, discount)

    def loaded(self) -> "Dataset":
        """The same log with its memory-mapped columns read into memory, so that their files can be deleted."""
        ids = self.episode_ids if self.part_of is not None else None
        return replace(self, **in_memory(vars(self)), part_of=None if ids is None else lambda: ids)

    def select(self, episodes: Sequence[int] | np.ndarray, name: str | None = None) -> "Dataset":
        """The log with only these episodes, in this order."""
        episodes = np.asarray(episodes)
        if episodes.size == 0:
            raise UserError(f"{self.name}: a part with no episodes was asked for")
        rows = rows_of(self.starts[episodes], self.lengths[episodes])
        observations, terminals, timeouts = self.observations[rows], self.terminals[rows], self.timeouts[rows]
        following = None if self.successors is None else self.successors[rows]
        return replace(
            self, observations=observations, actions=self.actions[rows], rewards=self.rewards[rows],
            terminals=terminals, timeouts=timeouts, name=name or self.name,
            final_observations=self.final_observations[episodes], final_known=self.final_known[episodes],
            successors=None if following is None else if_needed(following, observations, terminals | timeouts),
            extras={key: value[rows] for key, value in self.extras.items()},
            part_of=lambda: self.episode_ids[episodes], selected=True,
        )  # fmt: skip

    def split(self, fraction: float = 0.8, seed: int = 0, by: str = "episode") -> tuple["Dataset", "Dataset"]:
        """Two parts of whole episodes: about `fraction` of the episodes, and the rest.

        Args:
            fraction: share of the first part, between 0 and 1.
            seed: of the shuffle.
            by: "episode" draws at random, "time" takes the earliest (rows are in the order of time), the name of an extra
                column keeps episodes of one value together.
        """
        if not 0 < fraction < 1 or self.episodes < 2:
            raise UserError(f"split needs 0 < fraction < 1 and 2 episodes, got {fraction} and {self.episodes}")
        parts = Holdout(1 - fraction, "random" if by == "episode" else by, seed).parts(self)
        return self.select(parts.learning), self.select(parts.held)

    def with_action_space(self, space: Box | Discrete, strict: bool = False) -> "Dataset":
        """The same log with other bounds, such as those of the environment in which policies will be evaluated.

        Raises:
            UserError: other kinds of actions; or, with `strict`, actions out of bounds.
        """
        if space.size != self.action_space.size or type(space) is not type(self.action_space):
            raise UserError(f"{self.name}: actions are {self.action_space}, {space} was asked for")
        same = space == self.action_space
        said = bounds_warnings(self.name, self.actions, space, strict, self.provenance.extra) if strict or not same else []
        told = (*self.warnings, *said)
        return self if same else replace(self, action_space=space, warnings=told, part_of=lambda: self.episode_ids)
