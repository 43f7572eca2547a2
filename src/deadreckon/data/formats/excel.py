"""Reading of spreadsheets (.xlsx, and .xls and .ods, which the same library reads) as pyarrow tables.

The library allocates memory for all cells up to the last one, and without enough of it the process is killed: so files are read
in a separate process.
"""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.data.formats.values import as_text, column_of
from deadreckon.errors import UserError, extra, reading, unknown
from deadreckon.foreign.child import read_apart
from deadreckon.foreign.door import file_size
from deadreckon.foreign.limits import check_unpacked, max_unpacked
from deadreckon.foreign.reader import alive, bound_memory


def read_excel(path: Path | str, sheet: str | int | None = None) -> tuple[pa.Table, list[str]]:
    """Reads a sheet: its first row that is not empty holds the names of the columns; empty rows are left out.

    Args:
        path: of the file.
        sheet: name, or number counted from 1; may be left out if only one sheet is visible.

    Returns:
        The table, and messages.

    Raises:
        UserError: one line with the cell, or with the sheets if one must be named.
    """
    try:
        import python_calamine  # noqa: F401 - whether it is there
    except ImportError as error:
        raise UserError(f"{path}: spreadsheets are read with python-calamine: {extra('tables')}") from error
    found = read_apart("excel", path, "a spreadsheet", size=file_size(path), file=str(path), sheet=sheet)
    return pa.ipc.open_stream(pa.py_buffer(found["table"])).read_all(), found["told"]


def contents(file: str, sheet: str | int | None, shared: Any) -> dict[str, Any]:
    """The result of `read_excel` in the process that reads: `table`, the bytes of an Arrow stream, and `told`, the messages.

    Args:
        file: its path.
        sheet: see `read_excel`.
        shared: not used, because the table is assembled in memory.

    Raises:
        UserError: see `read_excel`.
    """
    bound_memory(int(max_unpacked(file_size(file))))
    table, told = _read(file, sheet)
    alive()
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return {"table": np.frombuffer(sink.getvalue(), np.uint8), "told": told}


def _read(path: str, sheet: str | int | None) -> tuple[pa.Table, list[str]]:
    import python_calamine as calamine

    size = file_size(path)
    with reading(path, "a spreadsheet"):
        if zipfile.is_zipfile(path):  # all but .xls
            with zipfile.ZipFile(path) as archive:
                check_unpacked(path, sum(each.file_size for each in archive.infolist()), size)
        try:
            book = calamine.CalamineWorkbook.from_path(path)
        except calamine.PasswordError as error:
            raise UserError(f"{path}: the spreadsheet needs a password; save it without one") from error
        with book:
            shown = [
                each.name
                for each in book.sheets_metadata
                if each.typ == calamine.SheetTypeEnum.WorkSheet and each.visible == calamine.SheetVisibleEnum.Visible
            ]
            found = book.get_sheet_by_name(_chosen(path, sheet, book.sheet_names, shown))
            cells = found.to_python(skip_empty_area=False)  # from A1 on, so that errors can name cells
            rows = [(line, row) for line, row in enumerate(cells, 1) if any(cell != "" for cell in row)]
            merged = sorted(getattr(found, "merged_cell_ranges", None) or ())
    if len(rows) < 2:
        raise UserError(f"{path}: sheet {found.name!r} has no rows below a row of names")
    table, told = _table(path, rows)
    gaps = rows[-1][0] - rows[0][0] + 1 - len(rows)
    told += _of_merged([ends for ends in merged if ends[1][0] >= rows[0][0]])
    return table, [*([f"empty rows are left out: {gaps}"] if gaps else []), *told]


def _of_merged(ranges: list[tuple[tuple[int, int], tuple[int, int]]]) -> list[str]:
    """Messages on merged cells below the line of names; `ranges`: (row, column) of the first and the last cell of each."""
    if not ranges:
        return []
    shown = ":".join(f"{letters_of(column)}{row + 1}" for row, column in ranges[0])
    text = f"{len(ranges)} ranges of cells are merged, such as {shown}, and only the first cell of each has its value"
    return [f"{text}; unmerge them and fill the others, or they are missing"]


def _chosen(path: Path | str, sheet: str | int | None, names: list[str], shown: list[str]) -> str:
    if sheet is None:
        if len(shown) == 1:
            return shown[0]
        listed = ", ".join(repr(name) for name in shown or names)
        raise UserError(f"{path}: which sheet holds the table? --sheet NAME, or its number; it has {listed}")
    if str(sheet) in names:
        return str(sheet)
    if str(sheet).isdecimal():
        if not 1 <= int(sheet) <= len(names):
            raise UserError(f"{path}: there is no sheet {sheet}; it has {len(names)}: {', '.join(map(repr, names))}")
        return names[int(sheet) - 1]
    raise UserError(f"{path}: {unknown('sheet', str(sheet), names)}")


def _table(path: Path | str, rows: list[tuple[int, list[Any]]]) -> tuple[pa.Table, list[str]]:
    (header, names), *body = rows
    lines_of = [line for line, _ in body]
    columns: dict[str, Any] = {}
    told: list[str] = []
    for index, raw in enumerate(names):
        letters = letters_of(index)
        name = " ".join(as_text(raw).split())
        values = [row[index] for _, row in body]
        if not name:
            filled = next((line for line, row in body if row[index] != ""), None)
            if filled is None:
                continue
            raise UserError(f"{path}: cell {letters}{header} is empty, where the name of column {letters} is needed; "
                            f"{letters}{filled} holds a value")  # fmt: skip
        if name in columns:
            raise UserError(f"{path}: the name {name!r} in cell {letters}{header} is that of another column too; rename one")
        columns[name], lines = column_of(path, f"column {name}", values, _where(letters, lines_of))
        told += lines
    return pa.table(columns), told


def _where(letters: str, lines: list[int]) -> Callable[[int], str]:
    return lambda row: f"cell {letters}{lines[row]}"


def letters_of(column: int) -> str:
    """The letters of a column counted from 0: A, B, ..., Z, AA, ..."""
    letters = ""
    column += 1
    while column:
        column, rest = divmod(column - 1, 26)
        letters = chr(ord("A") + rest) + letters
    return letters
