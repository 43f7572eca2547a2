"""The ranges of hyperparameters, declared at the fields, and their check.

A field declares its range by its type, `discount: UnitInterval = 0.99`, and the comment after it is its help text.
"""

import dataclasses
import math
import typing
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

import equinox as eqx

from deadreckon.errors import UserError


@dataclass(frozen=True)
class Range:
    """The numbers that a field takes.

    Attributes:
        ge, gt: lower bound, included (ge) or excluded (gt).
        le, lt: upper bound, included (le) or excluded (lt).
    """

    ge: float = -math.inf
    gt: float = -math.inf
    le: float = math.inf
    lt: float = math.inf

    def __contains__(self, value: float) -> bool:
        return self.ge <= value <= self.le and self.gt < value < self.lt

    def __str__(self) -> str:
        bounds = {">=": self.ge, ">": self.gt, "<=": self.le, "<": self.lt}
        return " and ".join(f"{sign} {bound:g}" for sign, bound in bounds.items() if math.isfinite(bound))


Number = Annotated[float, Range()]
NonNegative = Annotated[float, Range(ge=0)]
Positive = Annotated[float, Range(gt=0)]
UnitInterval = Annotated[float, Range(ge=0, le=1)]
Count = Annotated[int, Range(ge=1)]
TwoOrMore = Annotated[int, Range(ge=2)]
CountOrZero = Annotated[int, Range(ge=0)]
Fraction = Annotated[float, Range(gt=0, le=1)]
Sizes = Annotated[tuple[int, ...], Range(ge=1)]  # widths of hidden layers
Weights = Annotated[tuple[float, ...], Range(ge=0)]  # one per layer


def static(default: Any) -> Any:
    """A field that is part of the program's shape: not traced, and the same in all lanes of one program."""
    return eqx.field(static=True, default=default)


def host(default: Any) -> Any:
    """A field that the host alone reads, such as the number of updates: compiled programs do not depend on its value."""
    return eqx.field(static=True, default=default, metadata={"host": True})


class _HostOnly:
    """The value that a compiled program gets for a field of the host; computing with it raises a `TypeError`."""

    def __repr__(self) -> str:
        return "read by the host alone"


HOST_ONLY = _HostOnly()


def on_device(learner: Any) -> Any:
    """A learner as its compiled program gets it, without the values of fields of the host, also in nested settings."""
    changes = {}
    for field in dataclasses.fields(learner):
        value = getattr(learner, field.name)
        if field.metadata.get("host"):
            changes[field.name] = HOST_ONLY
        elif isinstance(value, eqx.Module) and (inner := on_device(value)) is not value:
            changes[field.name] = inner
    return dataclasses.replace(learner, **changes) if changes else learner


def range_of(kind: type, field: str) -> Range | None:
    """The range of a field of a class; None if it has none."""
    return _hints(kind)[field][1]


@cache
def _hints(kind: type) -> dict[str, tuple[Any, Range | None, bool]]:
    """The result of `_parted` for every annotation of a class."""
    return {name: _parted(hint) for name, hint in typing.get_type_hints(kind, include_extras=True).items()}


def _parted(hint: Any) -> tuple[Any, Range | None, bool]:
    """A type without its range, the range, and whether None is allowed."""
    optional = type(None) in typing.get_args(hint)
    if optional:
        hint = next(part for part in typing.get_args(hint) if part is not type(None))
    if typing.get_origin(hint) is not Annotated:
        return hint, None, optional
    kind, *more = typing.get_args(hint)
    return kind, next((each for each in more if isinstance(each, Range)), None), optional


def check_fields(learner: eqx.Module) -> None:
    """Refuses hyperparameters of the wrong type or size before anything is compiled. None passes where it is allowed.

    Raises:
        UserError: names the field and what it takes.
    """
    hints = _hints(type(learner))
    for field in dataclasses.fields(learner):
        value, name = getattr(learner, field.name), f"{type(learner).__name__}.{field.name}"
        kind, range_, optional = hints[field.name]
        if value is None and optional:
            continue
        if typing.get_origin(kind) is typing.Literal and value not in typing.get_args(kind):
            raise UserError(f"{name} takes {' or '.join(map(repr, typing.get_args(kind)))}, got {value!r}")
        if kind is bool and not isinstance(value, bool):
            raise UserError(f"{name} takes true or false, got {value!r}")
        if typing.get_origin(kind) is tuple:
            if not isinstance(value, tuple):
                raise UserError(f"{name} takes a tuple of numbers, got {value!r}")
            for entry in value:
                _check(name, entry, typing.get_args(kind)[0], range_ or Range())
        elif kind in (int, float):
            _check(name, value, kind, range_ or Range())


def _check(name: str, value: Any, kind: type, range_: Range) -> None:
    what = "a whole number" if kind is int else "a finite number"
    right = isinstance(value, int if kind is int else (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if not right or value not in range_:
        raise UserError(f"{name} takes {what} {range_}".rstrip() + f", got {value!r}")


def described(learner: eqx.Module) -> str:
    """All hyperparameters as text, which identifies results; `str` leaves out those that have their default."""
    values = ((f.name, getattr(learner, f.name)) for f in dataclasses.fields(learner))
    parts = (f"{name}={described(value) if isinstance(value, eqx.Module) else repr(value)}" for name, value in values)
    return f"{type(learner).__name__}({', '.join(parts)})"
