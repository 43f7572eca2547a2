"""Tables of the Open Bandit Dataset: the roles of their columns, by name."""

import csv
import io
import re
from pathlib import Path
from typing import Any

from deadreckon.foreign.door import opened, unpacked

_NEEDED = ("item_id", "position", "click", "propensity_score")
_CONTEXT = re.compile(r"user_feature_\d+|user-item_affinity_\d+")


def open_bandit(path: Path | str, kind: str, mapping: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The roles of columns in a CSV file if it is a table of the Open Bandit Dataset (`all.csv`, `men.csv`, `women.csv`).

    Args:
        path: of the file, which may be gzipped.
        kind: format of the file; only "csv" is examined.
        mapping: the given options; returned unchanged if there are any.

    Returns:
        The mapping for `Dataset.from_frame`, and a message if it is that of these tables.
    """
    if kind != "csv" or any(value is not None for value in mapping.values()):
        return mapping, []
    with opened(path) as file:
        lines = io.TextIOWrapper(unpacked(path, file), encoding="utf-8", errors="replace", newline="")
        try:
            names = next(csv.reader([lines.readline()]), [])
        except csv.Error:  # many names with another separator than a comma are one cell, longer than the library reads
            return mapping, []
    context = [name for name in names if _CONTEXT.fullmatch(name)]
    if not context or not all(name in names for name in _NEEDED):
        return mapping, []
    found = {"action": "item_id", "reward": "click", "propensity": "propensity_score", "observations": context,
             "keep": "position"}  # fmt: skip
    told = "read as Open Bandit's layout: each row is an episode of one terminal step, position is stored with the log"
    return {**mapping, **found}, [told]
