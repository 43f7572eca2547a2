"""Where a log comes from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Provenance:
    """Where a log comes from. `extra` holds whatever else the source says, as JSON values."""

    source: str = "arrays"  # "collected", "d4rl-hdf5", "minari", "csv", ...
    recipe: str | None = None  # name that `deadreckon data collect` takes
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)  # of the simulator and of deadreckon
    path: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)
