"""Names that came from outside: as the names of files, where they are refused or encoded, and as they are shown.

Columns, logs, agents, methods, suites, designs, tasks, repositories and ids are named by whoever made them. None of these names
is ever a path: what makes a file's name of one calls `safe_name`, which refuses, or `file_part`, which encodes.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

from deadreckon.errors import UserError, is_control, shown

_MARKS = re.compile(r"[\\`*<|!\[\]]")


def in_markdown(value: Any) -> Any:
    """`value` for a page in Markdown: its texts, also keys, stay on their line and are taken for no marks of the page's own.

    Args:
        value: a text, or lists and dictionaries with texts in them, as JSON has them; all else stays as it is.
    """
    if isinstance(value, str):
        return _MARKS.sub(r"\\\g<0>", shown(value))
    if isinstance(value, Mapping):
        return {in_markdown(key): in_markdown(each) for key, each in value.items()}
    return list(map(in_markdown, value)) if isinstance(value, list | tuple) else value


def natural(name: str) -> tuple[tuple[bool, int, str], ...]:
    """What names are sorted by so that the numbers in them count as numbers: run_2 comes before run_10."""
    key = []
    for part in re.findall(r"[0-9]+|[^0-9]+", name):
        number = part[0] in "0123456789"
        text = part.lstrip("0") if number else part
        key.append((number, len(text) if number else 0, text))
    return tuple(key)


LONGEST = 200  # bytes of a name; file systems take 255, and endings come behind it
_SEPARATORS = "/\\:"  # on any system; the colon stands behind the letter of a drive
# Names that Windows keeps for devices, whatever ending follows.
_DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³])(?= *(\.|$))", re.IGNORECASE)


def safe_name(name: str, what: str) -> str:
    """`name`, which came from outside and becomes the name of a file: refused where that would not lie where it is made.

    Args:
        name: without an ending.
        what: has that name, for the error.

    Raises:
        UserError: it is empty or too long, leads to another folder on some system, is another name or a device on Windows, or
            holds control characters.
    """
    if not (why := _fault(name)):
        return name
    quoted = repr(name) if len(name) <= 60 else f"{name[:57]!r}..."
    raise UserError(f"{what} {quoted} {why}, so no file can be called that; rename it")


def safe_path(path: str, what: str) -> PurePosixPath:
    """`path`, which a file from outside gives, relative to the folder that the file is in: refused where it leads out of it.

    Args:
        path: names of folders and of a file, with slashes between them.
        what: has that path, for the error.

    Raises:
        UserError: it is absolute, or one of its parts is no name of a file.
    """
    for part in (each for each in path.split("/") if each != "."):
        safe_name(part, f"{what} {shown(path)[:60]!r}: part")
    return PurePosixPath(path)


def file_part(name: str, longest: int = LONGEST) -> str:
    """`name` as the name of a file: itself where it can be one, else with dashes for what cannot, and cut to its length.

    For folders that are called after what is in them; names that become the same here share a folder.

    Args:
        name: any text.
        longest: bytes of what is given back.
    """
    plain = "".join("-" if c in _SEPARATORS or is_control(c) else c for c in name)
    plain = _DEVICE.sub(r"\g<0>-", plain, count=1) if _DEVICE.match(plain) else plain
    plain = plain.encode()[:longest].decode(errors="ignore")
    if plain.endswith((".", " ")):
        plain = plain.rstrip(". ") + "-"
    return plain or "-"


class Terminal:
    """A stream of text, such as `sys.stdout`, on which names from outside appear by `shown`; lines and tabs stay."""

    def __init__(self, stream: Any):
        self.stream = stream

    def write(self, text: str) -> int:
        """Writes `text` as it is shown, and gives its length."""
        self.stream.write(shown(text, keep="\n\t"))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Writes them one after the other."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def repeated(names: Iterable[str]) -> list[str]:
    """The names that occur more than once, in their order."""
    return [name for name, times in Counter(names).items() if times > 1]


def _fault(name: str) -> str | None:
    """Why `name` can be no file's; None where it can."""
    if not name:
        return "is empty"
    if name == ".." or PureWindowsPath(name).name != name:  # Windows knows every separator, and drives
        return "would lead to another folder"
    if any(map(is_control, name)):
        return "has control characters"
    if len(name.encode()) > LONGEST:
        return f"is longer than {LONGEST} bytes"
    if name.endswith((".", " ")):
        return "ends in a dot or a blank, which Windows drops"
    if _DEVICE.match(name):
        return "is the name of a device on Windows"
    return None
