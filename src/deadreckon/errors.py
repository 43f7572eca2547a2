"""The one exception that users meet, and the words it is made of."""

import contextlib
import difflib
import re
import unicodedata
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

_LONGEST = 2_000  # characters of a message
# Characters that are not seen and reorder those around them, so that a text reads as another one.
_REORDERING = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


class UserError(ValueError):
    """Bad input, told in one line that names what is wrong and what would be right.

    The command line prints the message and leaves with exit code 2; from Python it is an ordinary `ValueError`. What a message
    quotes from a file can neither break the line nor speak to the terminal: control characters are shown as escapes.
    """

    def __init__(self, message: str = ""):
        super().__init__(printable(message))


def printable(text: str) -> str:
    """`text` in one line, with control characters and halves of characters as escapes, and its middle left out beyond 2,000."""
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST // 2]} ... {text[-_LONGEST // 2 + 9 :]}"
    return shown(" ".join(text.split()) if any(c in text for c in "\n\r\v\f\x85\u2028\u2029") else text)


def shown(text: Any, keep: str = "") -> str:
    """`text` as it is shown on a terminal or a page: control characters, which could steer either, appear as escapes.

    Args:
        text: to be shown; anything else is made a text first.
        keep: control characters that stay.
    """
    text = str(text)
    if text.isprintable():  # nearly always, and quickly found
        return text
    return "".join(c.encode("unicode_escape").decode() if is_control(c) and c not in keep else c for c in text)


def is_control(c: str) -> bool:
    """Whether a character does something instead of being seen."""
    # Also halves of characters, which no encoding has, and the separators of lines and paragraphs.
    return unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") or c in _REORDERING


def as_one_line(error: BaseException) -> str:
    """What an exception of a library says, in one line that is not long; its kind where it says nothing."""
    text = " ".join(str(error).split()) or type(error).__name__
    if type(error).__name__ in ("KeyError", "IndexError", "TypeError", "AttributeError", "AssertionError", "RecursionError"):
        text = f"{type(error).__name__}: {text}"
    return text if len(text) <= 200 else f"{text[:197]}..."


class BusyError(UserError):
    """Another process is at work on the same, and will bring it to its end."""


class DivergedError(UserError):
    """A fit diverged (NaN or infinite numbers), which other settings may mend and other fits need not share; exit code 1."""


def unknown(kind: str, name: str, known: Iterable[str]) -> UserError:
    """The error for a name that is not in `known`, with the nearest known ones.

    Args:
        kind: what the name stands for, such as "task".
        name: what was given.
        known: the names that exist.
    """
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    near = [n if n == n.strip() else repr(n) for n in near]  # a blank at an end would not be seen
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
    return UserError(f"unknown {kind} {name!r}: {hint}")


def cannot_write(path: Path | str, error: OSError) -> UserError:
    """The error for a path that the system lets nobody write; NumPy's says of a full disk how much it has written alone."""
    full = re.search(r"\d requested and \d+ written", str(error))
    return UserError(f"cannot write {path}: {error.strerror or error}{', the disk may be full' if full else ''}")


@contextlib.contextmanager
def naming(path: Path | str, name: str) -> Iterator[None]:
    """Errors about the log `name` name the file instead."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{path}: {str(error).removeprefix(f'{name}: ')}") from error


@contextlib.contextmanager
def reading(path: Path | str, kind: str) -> Iterator[None]:
    """Whatever a library raises on a damaged or unreadable file becomes one line.

    Which exceptions these are no library says, and fuzzing has found a dozen kinds: so all are taken for damage, and the cause
    stays with the error. What is written around a library's calls should be little, for its own mistakes read alike.
    """
    try:
        yield
    except UserError:
        raise
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise UserError(f"{path}: {(error.strerror or 'cannot be opened').lower()}") from error
    except MemoryError as error:
        raise UserError(f"{path}: cannot be read as {kind}, it needs more memory than there is") from error
    except Exception as error:
        raise UserError(f"{path}: cannot be read as {kind}, it is damaged or cut short ({as_one_line(error)})") from error
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # of a library in Rust, which is no Exception
            raise
        raise UserError(f"{path}: cannot be read as {kind}, it is damaged ({as_one_line(error)})") from error


def extra(name: str) -> str:
    """How to install one of the package's extras; not from an index, on which the package is not."""
    return f"install the extra {name} (in a clone of the repository: pip install '.[{name}]')"
