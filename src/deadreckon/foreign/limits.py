"""How much a file that comes from elsewhere may take. Each limit is settable, and the error that tells of it says how."""

import os
from pathlib import Path
from typing import NamedTuple

from deadreckon.errors import UserError

_UNITS = {"k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12}


class Limit(NamedTuple):
    """A limit.

    Attributes:
        variable: of the environment, which sets it.
        usual: its value where that is not set.
        unit: of the value, in words.
    """

    variable: str
    usual: float
    unit: str

    @property
    def value(self) -> float:
        """What holds now.

        Raises:
            UserError: the variable is set to something else than a number.
        """
        text = os.environ.get(self.variable, "").strip()
        if not text:
            return self.usual
        scale = _UNITS.get(text[-1].lower(), 1.0)
        try:
            found = float(text[:-1] if scale > 1.0 else text) * scale
        except ValueError:
            found = 0.0
        if not found > 0.0:
            raise UserError(f"{self.variable} must be a number of {self.unit} above 0, such as 8G or 5000, got {text!r}")
        return found


UNPACKED = Limit("DEADRECKON_MAX_UNPACKED", 4e9, "bytes")  # that a file unpacks to; `RATIO` times its size where that is more
MEMBERS = Limit("DEADRECKON_MAX_MEMBERS", 100_000, "members")  # of an archive, objects of an HDF5 file, parts of a pickle
DEPTH = Limit("DEADRECKON_MAX_DEPTH", 100, "levels")  # of JSON, TOML, pickles and groups of HDF5
TEXT = Limit("DEADRECKON_MAX_TEXT", 256e6, "bytes")  # of a JSON or TOML file
SECONDS = Limit("DEADRECKON_MAX_SECONDS", 20.0, "seconds")  # that a reading process may be silent, and 1 s for each 5 MB more
LIMITS = (UNPACKED, MEMBERS, DEPTH, TEXT, SECONDS)
RATIO = 50  # between what a file unpacks to and its size: measured logs have 1 to 20, and bombs 1,000
RATE = 5e6  # bytes a second, which a slow disk has


def check(path: Path | str, found: float, limit: Limit, what: str) -> None:
    """Refuses what is beyond a limit.

    Args:
        path: of the file.
        found: how much there is.
        limit: that holds.
        what: there is, in words: "unpacks to" or such, before the number.

    Raises:
        UserError: names both numbers, and the variable that sets the limit.
    """
    if found > (most := limit.value):
        raise beyond(path, found, most, limit, what)


def check_unpacked(path: Path | str, unpacked: float, size: float) -> None:
    """Refuses a file of `size` bytes that unpacks to more than it may; raises as `check`."""
    if unpacked > (most := max_unpacked(size)):
        raise beyond(path, unpacked, most, UNPACKED, "unpacks to")


def max_unpacked(size: float) -> float:
    """Bytes that a file of `size` bytes may unpack to."""
    most = UNPACKED.value
    return most if os.environ.get(UNPACKED.variable) else max(most, RATIO * size)


def beyond(path: Path | str, found: float, most: float, limit: Limit, what: str) -> UserError:
    """The error for what is beyond a limit."""
    bytes_ = limit.unit == "bytes"
    numbers = [f"{each / 1e9:,.3g} GB" if bytes_ else f"{each:,.0f} {limit.unit}" for each in (found, most)]
    return UserError(
        f"{path}: {what} {numbers[0]}, more than the {numbers[1]} that are read; if you trust the file, "
        f"{limit.variable} sets another limit"
    )
