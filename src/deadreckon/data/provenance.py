"""Where a log comes from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NotRequired, TypedDict

from deadreckon.data.schema import Level, SchemaValues


class HeldColumn(TypedDict):
    """What a column of a table held, see `data.held`."""

    missing: NotRequired[int]
    low: NotRequired[float]
    high: NotRequired[float]
    mean: NotRequired[float]
    reason: NotRequired[str]


class Extra(TypedDict):
    """The shape of those entries of `Provenance.extra` that the package looks into; files from elsewhere are checked by it."""

    schema: NotRequired[SchemaValues | None]
    held: NotRequired[dict[str, HeldColumn] | None]
    horizon: NotRequired[int | None]
    group: NotRequired[str | None]
    observation_names: NotRequired[list[str] | None]
    observation_levels: NotRequired[dict[str, list[Any]] | None]
    action_levels: NotRequired[list[Level | list[Level]] | None]
    env_spec: NotRequired[str | None]
    observation_bounds: NotRequired[tuple[list[float | None], list[float | None]] | None]


@dataclass(frozen=True)
class Provenance:
    """Where a log comes from. `extra` holds whatever else the source says, as JSON values."""

    source: str = "arrays"  # "collected", "d4rl-hdf5", "minari", "csv", ...
    recipe: str | None = None  # name that `deadreckon data collect` takes
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)  # of the simulator and of deadreckon
    path: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)
