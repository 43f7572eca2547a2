"""The shape of what a policy file keeps of its log, by which rows become observations: checked on reading."""

import math
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict

from deadreckon.data.provenance import Extra
from deadreckon.data.schema import Schema
from deadreckon.data.spec import MOST_ACTIONS
from deadreckon.errors import UserError
from deadreckon.foreign.shapes import wrong

MOST_NUMBERS = 10_000_000  # of an observation


class _Space(TypedDict):
    kind: Literal["Discrete", "Box"]
    n: NotRequired[int]
    masked: NotRequired[bool]
    low: NotRequired[list[float]]
    high: NotRequired[list[float]]


class LogValues(TypedDict):
    """`meta["log"]` of a policy file, see `runs.reading.noted`."""

    extra: NotRequired[Extra | None]
    action_space: NotRequired[_Space | None]
    observation_shape: NotRequired[list[int]]


def check_log(path: Path | str, log: dict[str, Any]) -> None:
    """Refuses values of the shape of `LogValues` that no log has.

    Args:
        path: of the policy file, for errors.
        log: the values.

    Raises:
        UserError: names the file and the field.
    """
    space, extra = log.get("action_space") or {}, log.get("extra") or {}
    if space.get("kind") == "Discrete" and not 0 < space.get("n", 0) <= MOST_ACTIONS:
        raise wrong(path, "meta.log.action_space.n", f"a whole number from 1 to {MOST_ACTIONS:,}", space.get("n"))
    shape = log.get("observation_shape", [])
    if any(size < 0 for size in shape) or math.prod(shape) > MOST_NUMBERS:
        raise UserError(f"{path}: meta.log.observation_shape must be of up to {MOST_NUMBERS:,} numbers, got {shape!r:.60}")
    if (given := extra.get("schema")) is None:
        return
    try:
        schema = Schema.from_json(given)
    except UserError as error:
        raise UserError(f"{path}: meta.log.extra: {error}") from error
    for column in schema.having("observation"):
        if column.kind == "category" and column.levels is None:
            raise UserError(f"{path}: meta.log.extra: schema, column {column.name}: a category that is observed needs levels")
