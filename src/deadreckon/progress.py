"""How long work tells how far it has come: what is called, now and then, by the thread that works."""

from collections.abc import Callable
from typing import Any

Progress = Callable[[int, int | None], Any]  # of one piece of work: how much is done, and in all; None: not known
Watcher = Callable[[str, int, int | None], Any]  # of several, one after another: which, and as above


def unwatched(*told: Any) -> None:
    """Ignores what it is told."""
