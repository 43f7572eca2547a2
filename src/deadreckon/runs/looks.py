"""How often the held-out episodes of a log have been looked at, so that the error of all looks together is bounded.

An interval that may miss in 5 % of logs does so for what it was computed for. Who judges twenty settings one after the other on
the same episodes and keeps the best has looked twenty times. So each look spends half of what is left of the 5 %: 2.5 % the
first, 1.25 % the second, ...; within a look all policies share its level (`stats.inference.simultaneous`). The same policies
under the same estimand, judged by the same estimator and clusters, are one look, however often that is done. This bounds the
error for policies that were learned without regard to earlier answers.
"""

from pathlib import Path
from typing import NamedTuple, NotRequired, TypedDict

import numpy as np

from deadreckon.errors import UserError
from deadreckon.files import alone, digest, home, read_json, write_json
from deadreckon.stats.interval import ALPHA

MOST = 10_000  # episodes by whose ids a set is known: the least ones of a larger set


class Look(NamedTuple):
    """A look at held-out episodes.

    Attributes:
        number: 1 for the first.
        alpha: share of logs for which one of its intervals may miss.
        policies: that have been judged on some of these episodes by now, in all looks.
    """

    number: int
    alpha: float
    policies: int


class _Told(TypedDict):
    """A note, as its file has it."""

    looks: dict[str, tuple[int, int] | int]
    episodes: NotRequired[list[int]]


class Note(NamedTuple):
    """What is known of the looks at one set of episodes.

    Attributes:
        episodes: their ids, the least `MOST` of them.
        looks: digest of what was judged -> how many policies, and the number of the look.
    """

    episodes: set[int]
    looks: dict[str, tuple[int, int]]


def look(episodes: np.ndarray, policies: str, count: int) -> Look:
    """Takes note of a look, in the folder of collected and downloaded logs.

    Whoever has looked at some of the episodes has looked: looks at overlapping sets count together. Of sets of more than `MOST`
    episodes the least ids stand for all, by which sets are found to overlap unless they share a few episodes alone.

    Args:
        episodes: (n,) uint64 ids of the episodes that policies are judged on.
        policies: digest of what is judged and how: the policies, the estimand, the estimator and the clusters.
        count: of the policies.

    Raises:
        UserError: a note cannot be read or written.
    """
    least = np.sort(episodes)[:MOST].tolist()
    folder = home() / "looks"
    path = folder / f"{digest(least if len(episodes) <= MOST else [len(episodes), *least], 12)}.json"
    with alone(folder / "all", "notes a look"):
        notes = {other: _read(other) for other in sorted(folder.glob("*.json"))}
        own = notes.pop(path, Note(set(least), {}))
        others = [note for note in notes.values() if not note.episodes.isdisjoint(least)]
        if policies not in own.looks:
            own.looks[policies] = count, 1 + len(own.looks) + sum(len(note.looks) for note in others)
            write_json(path, {"episodes": least, "looks": own.looks})
    number = own.looks[policies][1]
    judged = sum(each for note in (own, *others) for each, _ in note.looks.values())
    return Look(number, ALPHA / 2.0 ** min(number, 40), judged)


def _read(path: Path) -> Note:
    try:
        told = read_json(path, _Told)
    except UserError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise UserError(f"{path} is not a note of looks ({why}); remove it if its counts do not matter") from error
    # Notes of before knew exactly one set of episodes, by the file's name, and counts alone.
    known = {what: (at, i) if isinstance(at, int) else at for i, (what, at) in enumerate(told["looks"].items(), 1)}
    return Note(set(told.get("episodes", [])), {what: (count, number) for what, (count, number) in known.items()})
