"""The one exception that users meet, and the words it is made of."""

import contextlib
import difflib
from collections.abc import Iterable, Iterator
from pathlib import Path


class UserError(ValueError):
    """Bad input, told in one line that names what is wrong and what would be right.

    The command line prints the message and leaves with exit code 2; from Python it is an ordinary `ValueError`.
    """


class BusyError(UserError):
    """Another process is at work on the same, and will bring it to its end."""


class DivergedError(UserError):
    """A fit diverged (NaN or infinite numbers), which other settings may mend and other fits need not share."""


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


@contextlib.contextmanager
def naming(path: Path | str, name: str) -> Iterator[None]:
    """Errors about the log `name` name the file instead."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{path}: {str(error).removeprefix(f'{name}: ')}") from error


@contextlib.contextmanager
def reading(path: Path | str, kind: str, *more: type[Exception]) -> Iterator[None]:
    """What a library raises on a damaged or unreadable file, `more` included, becomes one line."""
    try:
        yield
    except UserError:
        raise
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise UserError(f"{path}: {(error.strerror or 'cannot be opened').lower()}") from error
    except (OSError, *more) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{path}: cannot be read as {kind}, it is damaged or cut short ({text})") from error
