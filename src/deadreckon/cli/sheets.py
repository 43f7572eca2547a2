"""Spreadsheets that stand beside a CSV file."""

import sys
from pathlib import Path
from typing import Any

from deadreckon.errors import UserError
from deadreckon.files import replacing


def write_beside(columns: dict[str, Any], about: dict[str, list[Any]], path: Path) -> None:
    """Proposals as a spreadsheet, with a sheet that says what they are; prints its path, or why it cannot be written."""
    from deadreckon.data.formats.xlsx_out import write_sheets

    try:
        with replacing(path) as temporary:
            write_sheets({"proposals": columns, "about": about}, temporary)
    except UserError as error:
        print(f"! {path.name} is not written: {error}", file=sys.stderr)
    else:
        print(path)
