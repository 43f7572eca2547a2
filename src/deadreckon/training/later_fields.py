"""Fields that were added to a class of learners later, so that earlier runs and results keep their names."""

import dataclasses
from typing import Any

import equinox as eqx


def later(default: Any) -> Any:
    """A static field that was added to its class later: see `told`."""
    return eqx.field(static=True, default=default, metadata={"later": True})


def told(*learners: Any) -> list[dataclasses.Field]:
    """Fields that identify learners of one class: all except later ones that have their defaults in all of them.

    In the order in which they are declared, except for fields in the class's `told_after`, which have moved to a base class
    since: each follows the field that it maps to, as it did before.
    """
    own = lambda f: any(getattr(each, f.name) != f.default for each in learners)  # noqa: E731
    found = {f.name: f for f in dataclasses.fields(learners[0]) if not f.metadata.get("later") or own(f)}
    names = list(found)
    for name, before in getattr(type(learners[0]), "told_after", {}).items():
        names.remove(name)
        names.insert(names.index(before) + 1, name)
    return [found[name] for name in names]
