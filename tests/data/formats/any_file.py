"""A table of a file whose format is detected."""

from pathlib import Path
from typing import Any

from deadreckon.data.formats.any_table import table_of_kind
from deadreckon.data.formats.kind import sniff


def read_table(path: Path | str, **ways: Any) -> Any:
    """As `table_of_kind`, of any format."""
    return table_of_kind(path, sniff(path, ways.get("separator")), ways)
