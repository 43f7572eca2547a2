"""Other names of hyperparameters: those of older versions, which files may contain, and those of publications.

A setting from a file, a suite or the command line is found by the name of its field; else by the other names that its class
or a base class has in `other_names`; else by `COMMON`, if exactly one field of the class is meant. Python calls take only the
names of fields.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

from deadreckon.errors import UserError

# What publications and other packages call hyperparameters, and the fields that may be meant. A name that means several fields
# of a class is not accepted; the command line suggests these fields.
COMMON = {
    "alpha": ("cql_weight", "penalty", "regularisation", "multiplier", "temperature"),
    "gamma": ("discount",),
    "hidden_dim": ("hidden",),
    "hidden_dims": ("hidden",),
    "hidden_size": ("hidden",),
    "hidden_sizes": ("hidden",),
    "learning_rate": ("lr", "actor_lr", "critic_lr"),
    "lr": ("actor_lr", "critic_lr"),
    "num_critics": ("critics",),
    "polyak": ("tau",),
    "target_rate": ("tau",),
}


def meant(kind: type, name: str) -> list[str]:
    """The fields of a class that a name may mean: one if the name is unambiguous, none if it is unknown."""
    fields = {field.name for field in dataclasses.fields(kind)}
    if name in fields:
        return [name]
    for base in kind.__mro__:
        known = vars(base).get("other_names", {})
        if known.get(name) in fields:
            return [known[name]]
    return [field for field in COMMON.get(name, ()) if field in fields]


def with_field_names(kind: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a class under the names of its fields; names that mean no field, or several, are left as they are.

    Raises:
        UserError: a field is set twice, under two names.
    """
    found: dict[str, Any] = {}
    for name, value in given.items():
        fields = meant(kind, name)
        field = fields[0] if len(fields) == 1 else name
        if field in found:
            both = [each for each in given if each == field or meant(kind, each) == [field]]
            raise UserError(f"{kind.__name__}: {' and '.join(both)} are one setting; give one of them")
        found[field] = value
    return found
