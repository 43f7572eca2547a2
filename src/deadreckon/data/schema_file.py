"""Files of schemas in the place of the tables that they name."""

from pathlib import Path
from typing import Any

from deadreckon.data.schema import Schema


def table_of(path: Path | str) -> tuple[Path | str, dict[str, Any] | None]:
    """The table that is meant by a path, and how it is read where the path is the file of a schema, which says so.

    Returns:
        The table beside a schema that it names, and the schema's `options`; of any other path itself, and None.

    Raises:
        UserError: see `Schema.file_beside`.
    """
    if not is_schema(path):
        return path, None
    schema = Schema.load(path)
    return schema.file_beside(path), schema.options()


def is_schema(path: Path | str) -> bool:
    """Whether a file is a schema, which stands for the table beside it that it names."""
    return str(path).endswith(".toml") and Path(path).is_file()
