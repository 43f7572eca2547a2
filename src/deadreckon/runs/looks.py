"""How often the held-out episodes of a log have been looked at, so that the error of all looks together is bounded.

An interval that may miss in 5 % of logs does so for what it was computed for. Who judges twenty settings one after the other on
the same episodes and keeps the best has looked twenty times. So each look spends half of what is left of the 5 %: 2.5 % the
first, 1.25 % the second, ...; within a look all policies share its level (`stats.inference.simultaneous`). The same policies
under the same estimand are one look, however often they are judged. This bounds the error for policies that were learned
without regard to earlier answers.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from deadreckon.errors import UserError
from deadreckon.files import alone, digest, home, read_json, write_json
from deadreckon.stats.interval import ALPHA

MOST = 10_000  # episodes by whose ids a set is known; of a larger one the least of them, and its size


class Look(NamedTuple):
    """A look at held-out episodes.

    Attributes:
        number: 1 for the first.
        alpha: share of logs for which one of its intervals may miss.
        policies: that have been judged on these episodes by now, in all looks.
    """

    number: int
    alpha: float
    policies: int


def look(episodes: np.ndarray, policies: str, count: int) -> Look:
    """Takes note of a look, in the folder of collected and downloaded logs.

    Args:
        episodes: (n,) uint64 ids of the episodes that policies are judged on.
        policies: digest of what is judged, the policies and the estimand.
        count: of the policies.

    Raises:
        UserError: the note cannot be read or written.
    """
    name = digest(np.sort(episodes).tolist() if len(episodes) <= MOST else _short(episodes), 12)
    path = home() / "looks" / f"{name}.json"
    with alone(path, "notes a look at these episodes"):
        known = _read(path)
        if policies not in known:
            known[policies] = count
            write_json(path, {"looks": known})
    number = list(known).index(policies) + 1
    return Look(number, ALPHA / 2.0 ** min(number, 40), sum(known.values()))


def _short(episodes: np.ndarray) -> list[int]:
    """What tells large sets of episodes apart: their number, and the least ids."""
    return [len(episodes), *np.sort(episodes)[:MOST].tolist()]


def _read(path: Path) -> dict[str, int]:
    if not path.exists():
        return {}
    told = read_json(path)
    known = told.get("looks") if isinstance(told, dict) else None
    if not isinstance(known, dict) or not all(isinstance(count, int) for count in known.values()):
        raise UserError(f"{path} is not a note of looks; remove it if its counts do not matter")
    return known
