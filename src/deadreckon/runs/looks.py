"""Counts the evaluations ("looks") on held-out episodes of a log, so that the error of all looks together is bounded.

A 95 % interval is valid for a single evaluation. Evaluating twenty settings one after the other on the same episodes and
keeping the best amounts to twenty looks. So each look uses half of the remaining error probability of 5 %: 2.5 % the first,
1.25 % the second, ...; within a look all policies share its level (`stats.inference.simultaneous`). Repeated evaluations of the
same policies under the same estimand, with the same estimator and clusters, are one look. This bounds the error for policies
that were trained without using earlier results.
"""

import hashlib
from pathlib import Path
from typing import NamedTuple, NotRequired, TypedDict

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import alike_in
from deadreckon.errors import UserError
from deadreckon.files import alone, digest, home, read_json, write_json
from deadreckon.stats.interval import ALPHA

MOSTLY = 0.95  # share of common episodes from which sets are the same ones, whatever equals what
MOST = 10_000  # most ids that identify a set of episodes: the smallest ones of a larger set


class Look(NamedTuple):
    """A look: one evaluation on held-out episodes.

    Attributes:
        number: 1 for the first.
        alpha: share of logs for which one of its intervals may miss.
        policies: number evaluated on some of these episodes so far, in all looks.
    """

    number: int
    alpha: float
    policies: int


class _Told(TypedDict):
    """A record, as stored in its file."""

    looks: dict[str, tuple[int, int] | int]
    episodes: NotRequired[list[int]]
    log: NotRequired[str]
    alike: NotRequired[float]


class Note(NamedTuple):
    """The record of the looks at one set of episodes.

    Attributes:
        episodes: their ids, the smallest `MOST` of them.
        looks: digest of the evaluation -> number of policies, and the number of the look.
        log: digest of the ids of all episodes of their log; "" if they are a part of a log, and in older records.
        alike: share of them that equal another episode of their log, if that is whole.
    """

    episodes: set[int]
    looks: dict[str, tuple[int, int]]
    log: str = ""
    alike: float = 0.0

    def overlaps(self, other: "Note") -> bool:
        """Whether both are of some of the same episodes. Two whole logs in which many episodes are equal, such as those of few
        contexts, share by chance about as many as are equal within a log: only more than that, or nearly all, is an overlap."""
        shared = len(self.episodes & other.episodes) / max(min(len(self.episodes), len(other.episodes)), 1)
        two_logs = self.log and other.log and self.log != other.log
        return shared > (min(self.alike, other.alike, MOSTLY) if two_logs else 0.0)


def look(log: Dataset, held: np.ndarray, policies: str, count: int) -> Look:
    """Records a look, in the folder of collected and downloaded logs.

    Looks at overlapping sets of episodes count together. For sets of more than `MOST` episodes only the smallest ids are kept,
    so an overlap is found unless the sets share only a few episodes.

    Args:
        log: the log.
        held: (n,) indices of the episodes that policies are evaluated on.
        policies: digest of the evaluation: the policies, the estimand, the estimator and the clusters.
        count: of the policies.

    Raises:
        UserError: a record cannot be read or written.
    """
    episodes = log.episode_ids[held]
    least = np.sort(episodes)[:MOST].tolist()
    whole, alike = "", 0.0
    if not log.selected:
        whole = hashlib.blake2b(np.sort(log.episode_ids).astype("<u8").tobytes(), digest_size=12).hexdigest()
        alike = float(alike_in(log, log.episode_ids)[held].mean())
    folder = home() / "looks"
    path = folder / f"{digest(least if len(episodes) <= MOST else [len(episodes), *least], 12)}.json"
    with alone(folder / "all", "notes a look"):
        notes = {other: _read(other) for other in sorted(folder.glob("*.json"))}
        own = notes.pop(path, Note(set(least), {}))._replace(log=whole, alike=alike)
        others = [note for note in notes.values() if note.overlaps(own)]
        if policies not in own.looks:
            own.looks[policies] = count, 1 + len(own.looks) + sum(len(note.looks) for note in others)
            write_json(path, {"episodes": least, "looks": own.looks, "log": whole, "alike": alike})
    number = own.looks[policies][1]
    judged = sum(each for note in (own, *others) for each, _ in note.looks.values())
    return Look(number, ALPHA / 2.0 ** min(number, 40), judged)


def _read(path: Path) -> Note:
    try:
        told = read_json(path, _Told)
    except UserError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise UserError(f"{path} is not a note of looks ({why}); remove it if its counts do not matter") from error
    # Older records have only counts, for the set of episodes that the file's name identifies.
    known = {what: (at, i) if isinstance(at, int) else at for i, (what, at) in enumerate(told["looks"].items(), 1)}
    return Note(set(told.get("episodes", [])), {what: (count, number) for what, (count, number) in known.items()},
                told.get("log", ""), told.get("alike", 0.0))  # fmt: skip
