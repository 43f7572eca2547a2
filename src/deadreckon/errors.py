"""The one exception that users meet, and the words it is made of."""

import difflib
from collections.abc import Iterable


class UserError(ValueError):
    """Bad input, told in one line that names what is wrong and what would be right.

    The command line prints the message and leaves with exit code 2; from Python it is an ordinary `ValueError`.
    """


class BusyError(UserError):
    """Another process is at work on the same, and will bring it to its end."""


class DivergedError(UserError):
    """Numbers of a fit went bad, which other settings may mend and other fits need not share."""


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
