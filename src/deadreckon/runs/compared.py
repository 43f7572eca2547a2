"""Compares a new log with an earlier one, column by column: the size of a difference, and whether it can be chance.

The tests, which may be repeated, are in `stats.drift`; this module has the data that they compare: the rows of whole episodes,
or of whole clusters of them if the log has a group column. Of a long episode, `WITHIN` rows at regular distances are used.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.encode import OTHERS
from deadreckon.data.neighbours import in_order, origin
from deadreckon.data.split import units_of
from deadreckon.data.told import action_names, columns_of, observation_names, schema_of
from deadreckon.errors import UserError
from deadreckon.randomness import generator
from deadreckon.runs.subject import GAPS
from deadreckon.stats import drift, serial

WITHIN = 100  # most rows of an episode that are compared
FEWEST = 5  # fewest units of either sample: with fewer, permutations show nothing
FOLLOWS = (
    "in the new log, and not in the reference, values follow those of the episode before, and the test needs independent "
    "episodes; name the column that tells which belong together (--group, when the reference is read)"
)
UNKNOWN, MISSING = "a level that the log does not have", "a missing value"


class What(NamedTuple):
    """A column to compare.

    Attributes:
        about: "observation" or "action".
        name: of the column, or of the dimension where there are no columns.
        kind: "number", or "category" where each dimension is the 0/1 number of a level.
        dimensions: of the flattened observation, or of the action.
        levels: their names, of a category.
        marked: whether the last dimension is 1 where the value is missing.
    """

    about: str
    name: str
    kind: str
    dimensions: tuple[int, ...]
    levels: tuple[str, ...] = ()
    marked: bool = False


@dataclass(frozen=True)
class Sample:
    """Rows of whole units.

    Attributes:
        observations: (rows, size), flattened.
        actions: (rows, size) numbers, or (rows, actions) 0/1 numbers of discrete ones.
        starts: (units,) the first row of each unit; its rows follow.
        episode: (rows,) the episode of each row, or the one that this is a copy of.
        gaps: (rows,) bool by column: where it had no value, of columns that the reference had complete.
    """

    observations: np.ndarray
    actions: np.ndarray
    starts: np.ndarray
    episode: np.ndarray
    gaps: Mapping[str, np.ndarray]

    @property
    def sizes(self) -> np.ndarray:
        """(units,) rows of each."""
        return np.diff(np.append(self.starts, len(self.observations)))

    def in_parts(self, length: int) -> "Sample":
        """The same in units of so many successive episodes."""
        order = np.argsort(self.episode // length, kind="stable")
        gaps = {name: flags[order] for name, flags in self.gaps.items()}
        starts = np.unique(self.episode[order] // length, return_index=True)[1]
        return Sample(self.observations[order], self.actions[order], starts, self.episode[order], gaps)

    def means(self, what: What) -> np.ndarray:
        """(units, dimensions) means of a column."""
        return np.add.reduceat(self.of(what), self.starts) / self.sizes[:, None]

    def of(self, what: What) -> np.ndarray:
        """(rows, dimensions) of a column, in float64."""
        table = self.observations if what.about == "observation" else self.actions
        return table[:, list(what.dimensions)].astype(np.float64)

    def missing(self, what: What) -> float:
        """The share of rows in which the table had no value in this column."""
        return float((self.of(what)[:, -1] if what.marked else self.gaps.get(what.name, np.zeros(1))).mean())


@dataclass(frozen=True)
class Compared:
    """A column of the new log against the same of the reference.

    Attributes:
        what: the column.
        distance: largest difference of the shares of rows at most some value (Kolmogorov and Smirnov); of a category half the
            sum of the differences of its levels' shares (total variation). 0 .. 1.
        shift: difference of the means in standard deviations of the reference; NaN for a category, infinite if the reference
            did not vary.
        before, now: mean of the reference and of the new log; of a category the share of the level that differs most.
        level: that level; empty of numbers.
        missing: share of the rows without a value, in the reference and in the new log.
        others: values of the new log that are none of the reference's levels, as texts.
        found: the number of new episodes at which a test first found a change in the column, and which part of them it had
            compared; None if no test did.
        length: number of successive episodes that are compared as one, since values depend on those before; None: each by
            itself.
        untested: the reason why the last test that was due was not made; empty if it was, or none was due.
    """

    what: What
    distance: float
    shift: float
    before: float
    now: float
    level: str
    missing: tuple[float, float]
    others: tuple[str, ...]
    found: tuple[int, int] | None
    length: int | None = None
    untested: str = ""


class Order(NamedTuple):
    """The new log's episodes in their order, if no group column tells which belong together.

    Attributes:
        episodes: (n,) different ones.
        means: (n, dimensions) of each column, over the rows that are compared.
    """

    episodes: np.ndarray
    means: Mapping[What, np.ndarray]

    @classmethod
    def of(cls, log: Dataset, which: Sequence[What], first: bool) -> "Order | None":
        """None if a group column tells which belong together; `first` as for `rows_of`."""
        if (episodes := in_order(log)) is None:
            return None
        rows = sample(log, episodes, first)
        return cls(episodes, {what: rows.means(what) for what in which})

    def follows(self, what: What, episodes: int) -> bool:
        """Whether means of a column follow those of the episode before, in the first so many episodes."""
        values = self.means[what][self.episodes < episodes]
        return any(serial.follows(column) for column in values.T)


def lengths_of(
    log: Dataset, which: Sequence[What], first: bool, acts: Callable[[np.ndarray], np.ndarray] | None = None
) -> dict[What, int]:
    """The columns of a reference that depend on the episodes before, each with the number of episodes to compare as one.

    Args:
        log: the reference.
        which: columns.
        first: as for `rows_of`.
        acts: function from (n, size) observations to the (n, size) actions to look at instead of those in the log; see `acted`.
    """
    if (episodes := in_order(log)) is None:
        return {}
    rows = sample(log, episodes, first)
    if acts is not None:
        rows = replace(rows, actions=acts(rows.observations))
    found = {what: [column for column in rows.means(what).T if serial.depends(column)] for what in which}
    return {what: max(map(serial.together, columns)) for what, columns in found.items() if columns}


def whats(log: Dataset) -> list[What]:
    """The columns of a log's observations, then its actions.

    Raises:
        UserError: image observations.
    """
    names, out, taken = observation_names(log), [], set()
    if len(log.spec.observation_shape) > 1:
        raise UserError(f"{log.name}: image observations (shape {log.spec.observation_shape}) cannot be monitored")
    for each in columns_of(log):
        if each.role == "observation" and each.dimensions:
            kind = "category" if each.kind == "category" else "number"
            own = (names[i].removeprefix(f"{each.name}=") for i in each.dimensions)
            levels = tuple(name.replace(f"{each.name}_missing", "missing") for name in own)
            out.append(What("observation", each.name, kind, each.dimensions, levels, each.marked))
            taken |= set(each.dimensions)
    out += [What("observation", name, "number", (i,)) for i, name in enumerate(names) if i not in taken]  # legal actions
    if log.spec.discrete:
        schema = schema_of(log)
        name = schema.named("action")[0] if schema else "actions"
        return [*out, What("action", name, "category", tuple(range(log.spec.action_size)), tuple(action_names(log)))]
    return [*out, *(What("action", name, "number", (i,)) for i, name in enumerate(action_names(log)))]


def rows_of(log: Dataset, episodes: np.ndarray, first: bool) -> tuple[np.ndarray, np.ndarray]:
    """The rows of these episodes that are compared, unit by unit, and (units,) where each unit begins among them.

    Args:
        log: with a group column, its values are the units.
        episodes: indices.
        first: whether only the first row of each episode is compared.
    """
    unit = units_of(log)[episodes]
    episodes = episodes[order := np.argsort(unit, kind="stable")]
    counts = np.ones(len(episodes), int) if first else np.minimum(log.lengths[episodes], WITHIN)
    rows = np.repeat(log.starts[episodes], counts)
    place = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows = rows + place * np.repeat(log.lengths[episodes], counts) // np.repeat(counts, counts)
    _, begins = np.unique(unit[order], return_index=True)
    return rows, (np.cumsum(counts) - counts)[begins]


def sample(log: Dataset, episodes: np.ndarray, first: bool) -> Sample:
    """The sample of these episodes; see `rows_of`."""
    rows, starts = rows_of(log, episodes, first)
    observations = np.asarray(log.observations[rows], np.float32).reshape(len(rows), -1)
    gaps = {name.removeprefix(GAPS): np.asarray(flags)[rows] for name, flags in log.extras.items() if name.startswith(GAPS)}
    return Sample(observations, acted(log, np.asarray(log.actions[rows])), starts, origin(log)[log.episode_at(rows)], gaps)


def acted(log: Dataset, actions: np.ndarray) -> np.ndarray:
    """(rows, size) numbers: continuous actions as they are, discrete ones as 0/1 numbers."""
    if not log.spec.discrete:
        return np.asarray(actions, np.float32).reshape(len(actions), -1)
    return (actions.reshape(-1, 1) == np.arange(log.spec.action_size)).astype(np.float32)


def some(episodes: np.ndarray, purpose: str, *counters: int) -> np.ndarray:
    """At most `drift.MOST` of these episodes, always the same ones, in order."""
    if len(episodes) <= drift.MOST:
        return episodes
    return np.sort(generator(0, purpose, *counters).choice(episodes, drift.MOST, replace=False))


def drifts(
    old: Sample, new: Dataset, which: Sequence[What], first: bool, alpha: float, length: int | None = None,
    order: Order | None = None,
) -> tuple[list[Compared], int]:  # fmt: skip
    """Compares every column with the reference; also returns the number of tests that were due. The probability that any column
    is ever reported without a change is at most `alpha`.

    Args:
        old: the reference.
        new: the new log, of finished episodes in the order of time.
        which: columns.
        first: whether only first rows are compared.
        alpha: over all tests that can ever be made of this log as it grows.
        length: successive episodes that are one unit, in columns that depend on the episodes before; None: see `rows_of`.
        order: of the new episodes: while those of a column follow the ones before, it is not tested; None: tested anyway.
    """
    found: dict[int, tuple[int, int]] = {}
    tests, tested = 0, np.zeros(len(which), bool)
    old = old if length is None else old.in_parts(length)
    if len(old.starts) >= FEWEST:
        for number, epoch in enumerate(drift.epochs(new.episodes, alpha)):
            window = some(np.arange(epoch.start, epoch.stop), "new episodes", number)
            now = sample(new, window, first)
            now = now if length is None else now.in_parts(length)
            if len(now.starts) < FEWEST:
                continue
            tests += 1
            left = [i for i in range(len(which)) if i not in found]  # reported columns stay reported, and cannot hide others
            if order is not None:
                left = [i for i in left if not order.follows(which[i], epoch.stop)]
            tested = np.isin(np.arange(len(which)), [*left, *found])
            if not left:
                continue
            pairs = [_features(which[i], old, now) for i in left]
            sums = [[np.add.reduceat(pair[side], both.starts) for pair in pairs] for side, both in enumerate((old, now))]
            p = drift.test(sums[0], sums[1], (old.sizes, now.sizes), epoch.alpha, generator(0, "permutations", number))
            found |= {left[i]: (epoch.stop, epoch.stop - epoch.start) for i in np.flatnonzero(p <= epoch.alpha)}
    now = sample(new, some(np.arange(new.episodes), "all new episodes"), first)
    others = new.provenance.extra.get(OTHERS, {})
    every = [_compared(what, old, now, tuple(others.get(what.name, ())), found.get(i)) for i, what in enumerate(which)]
    why = FOLLOWS if tests else ""
    if length is not None:
        units = f"values depend on those of the episodes before, so parts of {length:,} episodes are compared"
        due = next(stop for stop in (drift.FIRST * 2**k for k in range(64)) if stop > (FEWEST - 1) * length)
        why = f"{units}, and the first test is made after {due:,} episodes"
        if len(old.starts) < FEWEST:
            why = f"{units}, of which the reference has {len(old.starts)}, and {FEWEST} are needed"
        every = [replace(each, length=length) for each in every]
    return [each if known else replace(each, untested=why) for each, known in zip(every, tested)], tests


def _features(what: What, old: Sample, now: Sample) -> tuple[np.ndarray, np.ndarray]:
    """(rows, features) 0/1 features of a column in both samples."""
    a, b = old.of(what), now.of(what)
    if what.kind == "category":
        return a.astype(np.float32), b.astype(np.float32)
    parts = [drift.number_features(a[:, i], b[:, i]) for i in range(a.shape[1])]
    return np.concatenate([part[0] for part in parts], 1), np.concatenate([part[1] for part in parts], 1)


def _compared(what: What, old: Sample, now: Sample, others: tuple[str, ...], found: tuple[int, int] | None) -> Compared:
    a, b, missing = old.of(what), now.of(what), (old.missing(what), now.missing(what))
    if what.kind == "category":
        before, after = a.mean(0), b.mean(0)
        most = int(np.argmax(np.abs(after - before)))
        rest = abs(before.sum() - after.sum())  # rows of no level
        distance = float(np.abs(after - before).sum() + rest) / 2
        level, share = what.levels[most], (float(before[most]), float(after[most]))
        return Compared(what, distance, np.nan, *share, level, missing, others, found)
    features = _features(what, old, now)
    distance = float(np.abs(features[0].mean(0) - features[1].mean(0)).max(initial=0.0))
    before, after, spread = float(a[:, 0].mean()), float(b[:, 0].mean()), float(a[:, 0].std())
    shift = (after - before) / spread if spread > 0 else 0.0 if after == before else np.copysign(np.inf, after - before)
    return Compared(what, distance, float(shift), before, after, "", missing, others, found)


class Outside(NamedTuple):
    """Rows of the new log that lie outside the reference: with a number beyond its smallest or largest value, a level that it
    does not have, or a missing value in a column that has none there.

    Attributes:
        share: of the new log's rows, 0 .. 1.
        columns: name, in which way, in how many rows, and whether that is more than chance can explain; only columns with such
            rows.
    """

    share: float
    columns: tuple[tuple[str, str, int, bool], ...]


def outside(
    old: Dataset, new: Dataset, which: Sequence[What], first: bool, alpha: float, lengths: Mapping[What, int] | None = None,
    order: Order | None = None,
) -> Outside:  # fmt: skip
    """How much of a new log lies outside the reference; see `drifts` for the arguments. `lengths` are the numbers of successive
    episodes that are one unit, of columns that depend on those before.

    All rows are counted. `stats.drift.beyond` tests, on the compared rows alone, what cannot be chance: the probability that
    any column is reported without a change is at most `alpha`.
    """
    names = [name for what in which for name in _sides(what)]
    tables = [_extremes(log, which) for log in (old, new)]
    over = tables[1] > tables[0].max(0)
    largest = [table[log.starts] if first else np.maximum.reduceat(table, log.starts) for table, log in zip(tables, (old, new))]
    of, lengths = [what for what in which for _ in _sides(what)], lengths or {}
    families = []
    for length in sorted({lengths.get(what, 0) for what in of}):
        own = np.array([lengths.get(what, 0) == length for what in of])
        unit = [origin(log) // length if length else units_of(log) for log in (old, new)]
        families.append((own, _largest(largest[0][:, own], unit[0]), unit[1], length == 0))
    guilty = np.zeros(len(names), bool)
    for epoch in drift.epochs(new.episodes, alpha) if names else ():
        if epoch.start:
            continue
        for own, before, unit, single in families:
            if len(before) < FEWEST:
                continue
            now = _largest(largest[1][: epoch.stop, own], unit[: epoch.stop])
            sure = drift.beyond(before, now) <= epoch.alpha / len(names)
            if single and order is not None and sure.any():
                named = [what for what, mine in zip(of, own) if mine]
                sure &= [not (one and order.follows(what, epoch.stop)) for what, one in zip(named, sure)]
            guilty[own] |= sure
    found = tuple((*names[i], int(over[:, i].sum()), bool(guilty[i])) for i in np.flatnonzero(over.any(0) | guilty))
    return Outside(float(over.any(1).mean()), found)


def _sides(what: What) -> list[tuple[str, str]]:
    """In which ways a value of the column can lie outside."""
    if what.about != "observation":
        return []
    ways = [UNKNOWN] if what.kind == "category" else ["above", "below"]
    return [(what.name, way) for way in (*ways, MISSING)]


def _extremes(log: Dataset, which: Sequence[What]) -> np.ndarray:
    """(rows, sides) numbers that are larger the further outside a row lies."""
    flat = np.asarray(log.observations[:], np.float32).reshape(len(log), -1)
    sides = [np.zeros((len(log), 0), np.float32)]
    for what in which:
        if what.about != "observation":
            continue
        missing = np.asarray(log.extras.get(f"{GAPS}{what.name}", np.zeros(len(log), bool)), np.float32)[:, None]
        if what.kind == "category":
            unknown = (flat[:, list(what.dimensions)].sum(1, keepdims=True) < 0.5).astype(np.float32)
            sides += [unknown - missing, missing]
        else:
            column = flat[:, what.dimensions[:1]]
            sides += [column, -column, missing]
    return np.concatenate(sides, 1)


def _largest(values: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """(units, sides) the largest of each unit's episodes."""
    order = np.argsort(unit, kind="stable")
    return np.maximum.reduceat(values[order], np.unique(unit[order], return_index=True)[1])
