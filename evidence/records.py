"""What was measured before there was a ledger, or by other commands than `deadreckon bench`: tables that are kept as data.

A file of `records` is CSV (RFC 4180) under lines that begin with `#`, of which the first two say

    # command: what printed the numbers
    # of: when, by which code, on which machine

Cells are text as pages show it.
"""

import csv
import re
from pathlib import Path
from typing import NamedTuple

from deadreckon.errors import UserError
from deadreckon.names import safe_name

FOLDER = Path(__file__).resolve().parent / "records"
_HEAD = re.compile(r"# command: (?P<command>.+)\n# of: (?P<of>.+)\n")
_NUMBER = re.compile(r"[-+–]?\d[\d,.]*")


class Record(NamedTuple):
    """A file of `records`: what printed its numbers, what they are of, and its cells."""

    command: str
    of: str
    header: list[str]
    rows: list[list[str]]


def read(name: str) -> Record:
    """A record.

    Args:
        name: of the file, without its ending.

    Raises:
        UserError: there is no such record, it does not say what it is of, it is no table, or its rows differ in length.
    """
    path = FOLDER / f"{safe_name(name, 'a record')}.csv"
    if not path.exists():
        raise UserError(f"there is no record {path.name} in {FOLDER.name}")
    text = path.read_text()
    head = _HEAD.match(text)
    if head is None:
        raise UserError(f"{path.name} does not begin with the lines '# command: ...' and '# of: ...'")
    try:
        header, *rows = csv.reader(text[head.end() :].splitlines(), strict=True)
        if not rows:
            raise ValueError("it has no rows")
    except (ValueError, csv.Error) as error:
        raise UserError(f"{path.name} is no table: {error}") from error
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise UserError(f"{path.name}: row {number} has {len(row)} cells, the header {len(header)}")
    return Record(head["command"], head["of"], header, rows)


def record(name: str, files: dict[str, bytes]) -> str:
    """A record in Markdown: its command, its table, and what its numbers are of; columns that begin with numbers to the right.

    Args:
        name: of the file, without its ending.
        files: gets pictures; there are none.

    Raises:
        UserError: as `read` does.
    """
    command, of, header, rows = read(name)
    columns = [[cell for cell in column if cell] for column in zip(*rows, strict=True)]
    right = [i > 0 and bool(cells) and all(map(_NUMBER.match, cells)) for i, cells in enumerate(columns)]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in (header, *rows)]
    lines.insert(1, "|" + "".join("---:|" if each else "---|" for each in right))
    gone = re.search(r"examples/(\w+_tables?|mbpo_curves)\.py", command)
    where = f" (`{gone[0]}` is in the history of the repository, commit f2f17e3)" if gone else ""
    return "\n".join([f"`{command}`{where}", "", *lines, "", f"- {of}; kept in `evidence/records/{name}.csv`", ""])
