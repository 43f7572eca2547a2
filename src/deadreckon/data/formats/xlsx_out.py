"""Writing of spreadsheets: texts are cells of text, and those that would be evaluated get an apostrophe as in CSV."""

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from deadreckon.data.formats.csv_out import cell
from deadreckon.errors import UserError, extra
from deadreckon.names import shown

LONGEST = 32_767  # largest number of characters of a cell
LARGEST = 1_048_576, 16_384  # largest numbers of rows and columns of a sheet
MADE = datetime(2000, 1, 1)  # creation date of every file, so that the same table gives the same file


def check_writer() -> None:
    """Checks that XlsxWriter, which writes spreadsheets, is installed.

    Raises:
        UserError: it is not.
    """
    try:
        import xlsxwriter  # noqa: F401
    except ImportError:
        raise UserError(f"spreadsheets are written with XlsxWriter: {extra('tables')}") from None


def write_sheets(sheets: Mapping[str, Mapping[str, Sequence[Any]]], path: Path | str) -> None:
    """Writes tables to a spreadsheet (.xlsx), one sheet each, with a first row of names that stays visible.

    Numbers that are not finite, and None, are empty cells.

    Args:
        sheets: names of sheets to columns by name.
        path: of the file; see `files.replacing`.

    Raises:
        UserError: XlsxWriter is missing, or a table or text is larger than a sheet or cell may be.
    """
    check_writer()
    import xlsxwriter

    for name, table in sheets.items():
        _check(name, table)
    with xlsxwriter.Workbook(str(path), {"in_memory": True}) as book:
        book.set_properties({"created": MADE})
        bold = book.add_format({"bold": True, "bottom": 1})
        for name, table in sheets.items():
            sheet = book.add_worksheet(name)
            sheet.freeze_panes(1, 0)
            for j, (column, values) in enumerate(table.items()):
                sheet.write_string(0, j, _text(column), bold)
                for i, value in enumerate(values, 1):
                    _write(sheet, i, j, value)
                widest = max([len(_text(column)), *(len(_shown(value)) for value in values)])
                sheet.set_column(j, j, min(max(widest + 2, 8), 60))


def _write(sheet: Any, i: int, j: int, value: Any) -> None:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return
    if isinstance(value, bool):
        sheet.write_boolean(i, j, value)
    elif isinstance(value, int | float):
        sheet.write_number(i, j, value)
    else:
        sheet.write_string(i, j, _text(value))


def _text(value: Any) -> str:
    """A text as a cell: control characters and lone surrogates are shown as escapes, formulas are neutralised."""
    return cell(shown(str(value), keep="\n\t"))


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else _text(value)


def _check(name: str, table: Mapping[str, Sequence[Any]]) -> None:
    rows = max((len(values) for values in table.values()), default=0) + 1
    for many, most, what in ((rows, LARGEST[0], "rows"), (len(table), LARGEST[1], "columns")):
        if many > most:
            raise UserError(f"sheet {name} would have {many:,} {what}, and a spreadsheet holds {most:,}; take the CSV")
    for column, values in table.items():
        for i, value in enumerate([column, *values]):
            if isinstance(value, str) and len(_text(value)) > LONGEST:
                where = "its name" if i == 0 else f"row {i - 1}"
                raise UserError(f"column {column[:40]} has a text of more than {LONGEST:,} letters in {where}; take the CSV")
