"""Fields that a class of learners did not have at first, so that runs and results of before keep their names."""

import dataclasses
from typing import Any

import equinox as eqx


def later(default: Any) -> Any:
    """A static field that its class did not have at first: see `told`."""
    return eqx.field(static=True, default=default, metadata={"later": True})


def told(*learners: Any) -> list[dataclasses.Field]:
    """Fields that tell learners of one class from others: all but later ones that have their defaults.

    In the order in which they are declared, but for those of the class's `told_after`: it had them before a class did that it
    inherits from, and says behind which others they stood.
    """
    own = lambda f: any(getattr(each, f.name) != f.default for each in learners)  # noqa: E731
    found = {f.name: f for f in dataclasses.fields(learners[0]) if not f.metadata.get("later") or own(f)}
    names = list(found)
    for name, before in getattr(type(learners[0]), "told_after", {}).items():
        names.remove(name)
        names.insert(names.index(before) + 1, name)
    return [found[name] for name in names]
