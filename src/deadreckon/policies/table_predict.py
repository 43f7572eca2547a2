"""What a policy does in rows of a table: named actions, probabilities, and which rows lie outside its log.

With the other modules called `table_` it needs numpy alone, so that they can be copied beside `portable.py`. What acts is
`portable.NumpyPolicy` or, in JAX, `loaded.JaxPlayer`.
"""

import hashlib
from collections.abc import Callable, Hashable, Mapping
from datetime import datetime
from typing import Any, NamedTuple, Protocol

import numpy as np

if __package__:
    from deadreckon.policies.table_encoder import Encoded, TableEncoder, like
    from deadreckon.policies.table_rows import RowsError, first, flags_of, is_missing, shown, text_of
    from deadreckon.policies.table_times import times_of
else:  # copied beside `portable.py`
    from table_encoder import Encoded, TableEncoder, like  # pyrefly: ignore[missing-import]
    from table_rows import RowsError, first, flags_of, is_missing, shown, text_of  # pyrefly: ignore[missing-import]
    from table_times import times_of  # pyrefly: ignore[missing-import]

_ROWS, _NUMBERS = 2**15, 2**22  # largest sizes of a block of observations
OUTSIDE = "outside_the_log"  # the column of a table of predictions


class Player(Protocol):
    """What acts on arrays.

    Attributes:
        members: of a mixture, one of which acts in an episode; else none.
        member: of a policy on histories, what acts on them; else None.
        steps: observations in a history.
        action_size: numbers of an action in a history.
    """

    members: list[Any]
    member: Any
    steps: int
    action_size: int

    def act(self, observations: np.ndarray, rng: np.random.Generator, greedy: bool) -> np.ndarray:
        """Actions (rows, size), or (rows,) codes, of a policy without memory."""
        ...

    def probs(self, observations: np.ndarray) -> np.ndarray | None:
        """(rows, actions) probabilities; None of continuous actions."""
        ...

    def done(self, actions: np.ndarray) -> np.ndarray:
        """Actions as a history has them: in [-1, 1], or one-hot."""
        ...


class Prediction(NamedTuple):
    """The actions of a policy, and further results.

    Attributes:
        actions: (rows,) names or numbers of one action column, {column: (rows,) numbers} of several; of one row, single values.
        probabilities: {action: (rows,) probability} of discrete actions; None if not requested.
        outside: (rows,) bool, which rows are outside the log; None if not requested.
    """

    actions: Any
    probabilities: dict[Any, Any] | None = None
    outside: Any = None


class Predictor:
    """A policy that takes rows of a table.

    Args:
        player: what acts.
        log: what its file keeps of its log; see `TableEncoder`.
        name: of the rows, for errors.

    Attributes:
        encoder: between rows and observations, codes and named actions.
        steps: last observations of an episode that it acts on.
        drawing: what draws where no seed is given, from call to call, and differently in each process.
    """

    def __init__(self, player: Player, log: Mapping[str, Any], name: str = "rows"):
        self.player, self.encoder = player, TableEncoder(log, name)
        self.steps = max(each.steps for each in (player, *player.members))
        self.drawing = np.random.default_rng()

    @property
    def by_episode(self) -> bool:
        """Whether what it does in a row depends on its episode: it acts on several steps, or is a mixture."""
        return (self.steps > 1 or bool(self.player.members)) and not self.encoder.alone

    def predict(
        self, rows: Any, *, probabilities: bool = False, greedy: bool = True, seed: int | np.random.Generator | None = None,
        outside: str = "raise", legal: Any = None,
    ) -> Any:  # fmt: skip
        """The actions in rows of a table.

        A mixture, and a policy on the last steps of episodes, needs the log's column of the episode, if that has one, else for
        several rows those that say where episodes end. A policy on the last steps also needs each episode's rows in order of
        time, from its first row on. Where the rows say what was done in them, by the columns of the actions, that is taken for
        the past; else what the policy does itself.

        Args:
            rows: a data frame (pandas, polars, Arrow), a dictionary of columns, a list of dictionaries or one dictionary, with
                the columns that the log's observations had, in any order; further ones do not matter. Or arrays (rows, size)
                of observations as they are encoded.
            probabilities: also gives the probability of every discrete action.
            greedy: take the deterministic (greedy) actions instead of sampled ones.
            seed: of sampled actions, and of which member of a mixture acts in episodes without a name; the same one samples the
                same, so use another each time, or a Generator. None: a generator that continues from call to call, and
                differs from process to process.
            outside: "raise" refuses unknown levels, missing values where the log had none and values outside the schema's
                range; "flag" marks such rows, and those with a value beyond the log's. What cannot be encoded at all, such as a
                text where a number is needed, is always refused.
            legal: (rows, actions) truth values, where the rows have no columns that say which actions are legal.

        Returns:
            The actions: (rows,) names or numbers of one action column, {column: (rows,) numbers} of several; of one dictionary
            single values. With `probabilities` or `outside="flag"` a `Prediction`, which holds them.

        Raises:
            RowsError: one line with the column, the row (counted from 0) and what would be right; a `UserError` within the
                package.
        """
        found = self.encoder.encode(rows, outside=outside, legal=legal)
        if probabilities and not self.encoder.discrete:
            raise RowsError("probabilities are those of discrete actions, and this policy's are continuous")
        rng = self.drawing if seed is None else np.random.default_rng(seed)
        remembers = self.steps > 1 or self.player.members
        episodes = _Episodes.of(self.encoder, found, self.steps, bool(self.player.members)) if remembers else None
        actions, probs = acted(self.player, found.observations, episodes, rng, greedy, probabilities)
        for values in (actions, probs):
            if values is not None and (wrong := ~np.isfinite(values)).any():
                raise RowsError(f"{self.encoder.name}: no finite action in row {first(wrong)}, which may be too large")
        named = self.encoder.named(actions)
        if not probabilities and outside == "raise":
            return _row(named) if found.single else named
        told = None
        if probabilities and probs is not None:
            told = dict(zip(self.encoder.names or range(probs.shape[1]), probs.T))
        flags = found.outside if outside == "flag" else None
        if not found.single:
            return Prediction(named, told, flags)
        return Prediction(_row(named), None if told is None else _row(told), None if flags is None else bool(flags[0]))

    def misfit(self) -> str:
        """How the policy differs from what its file says of its log, in words; empty where it does not, or nothing is said."""
        encoder = self.encoder
        if encoder.shape is None:
            return ""
        width = encoder.width + encoder.count * encoder.masked
        if encoder.observed and encoder.shape != (width,):
            return f"observations of its log have the shape {encoder.shape}, and the columns of its schema make {width} numbers"
        if strange := encoder.allowed.strangers:
            return f"column {strange[0]} of its schema says where an action is legal that is none of its log's"
        size, chosen = self._acts()
        acts = f"one of {chosen or 'several'} actions" if size is None else f"{size} numbers"
        if encoder.discrete and encoder.count and (size is not None or (chosen or encoder.count) != encoder.count):
            return f"it acts by {acts}, and its log has {encoder.count} discrete actions"
        if encoder.actions and not encoder.discrete and size != len(encoder.actions):
            return f"it acts by {acts}, and its log has {len(encoder.actions)} columns of continuous actions"
        return ""

    def _acts(self) -> tuple[int | None, int | None]:
        """How many numbers its actions are, None of discrete ones, and how many of these there are, None where not told."""
        first = _Episodes(np.zeros(1, int), np.zeros(1, int), None)
        seen = np.ones((1, *(shape := self.encoder.shape or ())), like(shape))  # of ones, so that every action is legal
        with np.errstate(all="ignore"):
            actions, probs = acted(self.player, seen, first, np.random.default_rng(0), True, self.encoder.discrete)
        return actions.shape[1] if actions.ndim > 1 else None, None if probs is None else probs.shape[1]

    def columns(self, done: Any) -> dict[str, Any]:
        """What `predict` gave by columns: those of the actions, then `probability=ACTION` and `outside_the_log`."""
        told = done if isinstance(done, Prediction) else Prediction(done)
        out = told.actions
        if not isinstance(out, dict):
            several = not self.encoder.actions and not self.encoder.discrete  # numbers of a log without a schema
            names = [*self.encoder.actions, "action"]
            out = {f"action_{i}": column for i, column in enumerate(np.moveaxis(out, -1, 0))} if several else {names[0]: out}
        out = out | {f"probability={name}": values for name, values in (told.probabilities or {}).items()}
        return out if told.outside is None else {**out, OUTSIDE: told.outside}


def _row(values: Any) -> Any:
    """The first row of columns, as plain values."""
    if isinstance(values, dict):
        return {key: _row(column) for key, column in values.items()}
    return values[0] if values[0].ndim else values[0].item()


class _Episodes(NamedTuple):
    """How rows follow one another.

    Attributes:
        number: (rows,) of each row's episode.
        position: (rows,) its place in it.
        logged: (rows,) codes or (rows, size) numbers of what was done; None where the rows do not say it.
        names: of the episodes by number, from the log's column of the episode; None where rows do not have it.
    """

    number: np.ndarray
    position: np.ndarray
    logged: np.ndarray | None
    names: list[Any] | None = None

    def members(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """(rows,) which of `count` members of a mixture acts: one in all rows of an episode, all with equal probabilities.

        That of an episode with a name follows from the name, so that calls which ask for one row after the other, in whatever
        process, have the same member to the end of the episode.
        """
        drawn = rng.integers(count, size=len(self.number))[self.number]
        if self.names is None:
            return drawn
        texts = (text_of(name).encode("utf-8", "surrogatepass") for name in self.names)
        digests = [hashlib.blake2b(text, digest_size=8).digest() for text in texts]
        return np.array([int.from_bytes(digest, "big") % count for digest in digests], int)[self.number]

    @classmethod
    def of(cls, encoder: TableEncoder, found: Encoded, steps: int, mixture: bool) -> "_Episodes":
        """The episodes of rows.

        Args:
            encoder: says which column tells them apart.
            found: the rows.
            steps: that the policy acts on.
            mixture: whether one of several members acts to the end of an episode; else, if it acts on one step, rows without
                such a column are an episode each, as arrays are.

        Raises:
            RowsError: nothing tells the episodes apart, or their rows are not in order, which one step does not need.
        """
        rows, columns, key, time = len(found.observations), found.columns or {}, *map(encoder.one.get, ("episode", "time"))
        cut = key is None and any(each in columns for each in encoder.ends)  # flags of ends alone tell episodes apart
        apart = steps == 1 and key not in columns and not cut  # nothing says how the rows follow one another
        needed = key if key is not None else next(iter(encoder.ends), None) if rows > 1 else None
        if mixture and apart and not encoder.alone and needed is not None and found.columns is not None:
            what = "of the episode" if key is not None else "which says where one ends (0 where it continues)"
            why = "this policy is a mixture, one member of which acts in all rows of an episode"
            raise RowsError(f"{encoder.name}: {why}: give the column {needed} {what}")
        if encoder.alone or apart:
            return cls(np.arange(rows), np.zeros(rows, int), None)
        where = f"{encoder.name}: this policy acts on the last {steps} steps of an episode"
        if found.columns is None:
            raise RowsError(f"{where}: give rows by the names of their columns, each episode's in order of time")
        if key is not None and key not in columns:
            raise RowsError(f"{where}: give the column {key} of the episode, and each episode's rows in order of time")
        names = _names(columns[key]) if key is not None else [0] * rows
        ended = _ended(encoder, columns, rows, where, key is None and steps > 1) if steps > 1 or cut else np.zeros(rows, bool)
        moments, order = None, (encoder.schema or {}).get("table", {}).get("dates")
        if time is not None and time in columns and steps > 1:
            dates = encoder.times not in ("number", "integer")
            moments = times_of(time, columns[time], encoder.name, dates=dates, order=order)
        number, position = np.zeros(rows, int), np.zeros(rows, int)
        going: dict[Any, int] = {}  # by name the number of the episode that goes on
        last: list[int] = []  # by number the newest row of the episode
        for row, name in enumerate(names):
            if is_missing(name):
                raise RowsError(f"{encoder.name}: column {key} is empty in row {row}; it identifies episodes")
            if not isinstance(name, Hashable):
                raise RowsError(f"{encoder.name}: column {key} has {shown(name)} in row {row}, a text or a number is needed")
            name = text_of(name)  # a request may have 1, and the next one "1"
            before = last[going[name]] if name in going else None
            if before is None or ended[before]:
                going[name], before = len(last), None
                last.append(row)
            number[row] = going[name]
            position[row] = 0 if before is None else position[before] + 1
            if moments is not None and before is not None and moments[before] > moments[row]:
                given = columns[str(time)]
                text = f"column {time} has {given[row]} in row {row}, before the {given[before]} of row {before}"
                raise RowsError(f"{encoder.name}: {text} in the same episode; sort each episode's rows by {time}")
            if moments is not None and before is not None and np.isnan(moments[[before, row]]).any():
                empty = before if np.isnan(moments[before]) else row
                text = f"column {time} is empty in row {empty}; it orders the rows of an episode"
                raise RowsError(f"{encoder.name}: {text}")
            last[going[name]] = row
        told = None if key is None else [names[row] for row in np.flatnonzero(position == 0)]
        logged = encoder.logged(columns) if steps > 1 else None
        if logged is not None:
            unknown = (logged < 0)[:, None] if encoder.discrete else np.isnan(logged)
            absent = np.asarray(unknown.any(1))
            absent[last] = False  # what is done there is asked for
            if unknown.all():  # columns that are to be filled in
                return cls(number, position, None, told)
            if absent.any():
                text = f"row {int(np.argmax(absent))} has no action, and its episode continues"
                raise RowsError(f"{encoder.name}: {text}; give the action of every row but the last, or of none")
        return cls(number, position, logged, told)


def _is_time(value: Any) -> bool:
    """Whether a value of a column of objects is a time without a zone."""
    return isinstance(value, np.datetime64) or (isinstance(value, datetime) and value.tzinfo is None and value == value)


def _names(values: np.ndarray) -> list[Any]:
    """Names of episodes as they are compared and hashed: times as texts, in whatever unit they are given.

    The text of a time does not depend on the other rows: a day at midnight, else with seconds and, if there is one, a fraction.
    """
    if values.dtype.kind != "M":
        return [_names(np.array([one], "datetime64"))[0] if _is_time(one) else one for one in values.tolist()]
    moments = values.astype("datetime64[s]") if np.datetime_data(values.dtype)[0] in ("Y", "M", "W", "D", "h", "m") else values
    texts = np.datetime_as_string(moments).tolist()
    texts = [text.rstrip("0").removesuffix(".") if "." in text else text for text in texts]
    return [None if text == "NaT" else text.removesuffix("T00:00:00").replace("T", " ") for text in texts]


def _ended(encoder: TableEncoder, columns: Mapping[str, np.ndarray], rows: int, where: str, alone: bool) -> np.ndarray:
    """(rows,) whether an episode ends with a row, as it does in training.

    Args:
        encoder: says which columns tell it; where the rows have a column of the episode, they need none of these.
        columns: of the rows.
        rows: how many there are.
        where: begins messages.
        alone: whether nothing else tells episodes apart.

    Raises:
        RowsError: nothing tells it.
    """
    if alone and rows > 1 and (absent := [key for key in encoder.ends if key not in columns]):
        raise RowsError(f"{where}: give the column {absent[0]}, which says where one ends (0 where it continues)")
    out = np.zeros(rows, bool)
    for key in encoder.ends:
        if key in columns:
            values = flags_of(key, columns[key], encoder.name)
            if alone and np.isnan(values[:-1]).any():
                row = first(np.isnan(values))
                raise RowsError(f"{encoder.name}: column {key} is empty in row {row}; it marks where episodes end")
            out |= values > 0.5
    return out


def acted(
    player: Player, found: np.ndarray, episodes: _Episodes | None, rng: np.random.Generator, greedy: bool, tell: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """Actions (rows, size) or (rows,) codes and, where `tell`, (rows, actions) probabilities of discrete ones.

    Args:
        player: what acts.
        found: (rows, *shape) observations.
        episodes: how rows follow one another; None for policies without memory.
        rng: of sampled actions, and of a mixture's members.
        greedy: take the deterministic actions.
        tell: whether probabilities are asked for; those of a mixture are the means of its members', but of the one that acts
            where episodes have names or several rows, since products of means would be no probabilities of what it does.
    """
    if player.members:
        assert episodes is not None
        which = episodes.members(len(player.members), rng)
        parts = [acted(member, found, episodes, rng, greedy, tell) for member in player.members]
        actions = np.stack([part[0] for part in parts])[which, np.arange(len(found))]
        probs = [part[1] for part in parts if part[1] is not None]
        if not probs:
            return actions, None
        named = episodes.names is not None  # then the member is known, also where the call has one row of the episode
        several = (named | (np.bincount(episodes.number)[episodes.number] > 1))[:, None]
        return actions, np.where(several, np.stack(probs)[which, np.arange(len(found))], np.mean(probs, 0))
    if player.steps > 1:
        assert episodes is not None
        return _on_histories(player, found, episodes, rng, greedy, tell)
    probs = None if greedy and not tell else _in_blocks(player.probs, found)
    if greedy or probs is None:
        return _in_blocks(lambda some: player.act(some, rng, greedy), found), probs
    # Drawn here, so that all players draw the same.
    below = np.cumsum(probs.astype(np.float64), 1)
    drawn = (below > rng.random(len(found))[:, None] * below[:, -1:]).argmax(1)
    return drawn.astype(np.int32), probs


def _in_blocks(function: Callable[[np.ndarray], Any], found: np.ndarray) -> Any:
    """What a function gives for each of many rows, in blocks of rows that need little memory in networks; or None."""
    size = min(max(_NUMBERS // max(found[:1].size, 1), 64), _ROWS)
    parts = [function(found[start : start + size]) for start in range(0, max(len(found), 1), size)]
    return None if parts[0] is None else np.concatenate(parts)


def _on_histories(
    player: Player, found: np.ndarray, episodes: _Episodes, rng: np.random.Generator, greedy: bool, tell: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """What a policy on the last steps does: the first rows of all episodes, then their second ones, and so on."""
    width = found.shape[1] + player.action_size  # of what a step adds to a history
    past = np.zeros((len(found), (player.steps - 1) * width), np.float32)
    if not len(found):
        return acted(player.member, np.concatenate([past, found], 1), None, rng, greedy, tell)
    actions, probs = [], []
    order = np.argsort(episodes.position, kind="stable")
    ends = np.cumsum(np.bincount(episodes.position[order]))
    for start, end in zip([0, *ends[:-1]], ends):
        rows = order[start:end]
        who, seen = episodes.number[rows], found[rows]
        if not start:
            none = np.zeros((len(rows), player.action_size), np.float32)
            past[who] = np.tile(np.concatenate([seen, none], 1), player.steps - 1)
        history = np.concatenate([past[who], seen], 1)
        taken, told = acted(player.member, history, None, rng, greedy, tell)
        done = player.done(taken if episodes.logged is None else episodes.logged[rows])
        past[who] = np.concatenate([history, done], 1)[:, width:]
        actions.append(taken)
        probs += [] if told is None else [told]
    back = np.argsort(order)
    return np.concatenate(actions)[back], np.concatenate(probs)[back] if probs else None
