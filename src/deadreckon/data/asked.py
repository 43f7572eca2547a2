"""The roles of a table's columns, as given by options of commands and functions."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

WIDTH = 200  # most characters of names that are listed


class Asked(NamedTuple):
    """The given roles: columns, or prefixes that stand for prefix_0, prefix_1, ...; None or empty if names decide."""

    action: str | Sequence[str] | None = None
    reward: str | None = None
    episode: str | None = None
    time: str | None = None
    observations: str | Sequence[str] | None = None
    next_observations: str | Sequence[str] | None = None
    ignore: str | Sequence[str] = ()
    terminal: str | None = None
    timeout: str | None = None
    propensity: str | None = None
    keep: str | Sequence[str] = ()
    group: str | None = None
    cost: str | Sequence[str] = ()
    legal: str | Sequence[str] | None = None
    next_legal: str | Sequence[str] | None = None
    weight: str | None = None
    kinds: Mapping[str, str] | Sequence[str] = ()


def listed(names: Sequence[str]) -> str:
    """The names, as many as fit into `WIDTH` characters."""
    shown = [name for name in names if name]
    all_of_them = len(shown)
    while len(shown) > 1 and len(", ".join(shown)) > WIDTH:
        shown.pop()
    return f"columns: {', '.join(shown)}{', ...' if len(shown) < all_of_them else ''}"
