"""Durations as text, such as `30m`."""

import re

from deadreckon.errors import UserError


def seconds_of(text: str) -> float:
    """Seconds of `90s`, `30m`, `2h` or `1h30m`.

    Raises:
        UserError: another form, or a time of 0.
    """
    found = re.fullmatch(r"(?:([\d.]+)h)?(?:([\d.]+)m)?(?:([\d.]+)s)?", text.strip())
    try:
        seconds = sum(float(part or 0) * unit for part, unit in zip(found.groups(), (3600, 60, 1))) if found else 0.0
    except ValueError:
        seconds = 0.0
    if not seconds > 0:
        raise UserError(f"a time is written 90s, 30m, 2h or 1h30m, got {text!r}")
    return seconds


def in_words(seconds: float) -> str:
    """A duration as text, in seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:,.0f} s"
    return f"{seconds / 60:,.0f} min" if seconds < 5400 else f"{seconds / 3600:,.1f} h"
