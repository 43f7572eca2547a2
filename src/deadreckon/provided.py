"""What lower layers may ask for of higher ones, by name: the package's root, which knows all layers, provides it.

So `agent.fit(log)` is `deadreckon.train(agent, log)`, and a log shows itself in a notebook as a report would, although neither
agents nor logs import anything above them.
"""

from collections.abc import Callable
from typing import Any

_PROVIDED: dict[str, Callable[[], Any]] = {}  # name: what finds it, which imports its module


def provide(name: str, find: Callable[[], Any]) -> None:
    """Says how `provided(name)` is found; called by the root alone."""
    _PROVIDED[name] = find


def provided(name: str) -> Any:
    """What the root has provided under a name."""
    return _PROVIDED[name]()


class Shown:
    """Base of what shows itself in notebooks by the report's own drawings (`report.notebook`)."""

    def _repr_html_(self) -> str | None:
        return provided("notebook")(self)
