"""Numbers as people read them."""

import math
from collections.abc import Callable

from deadreckon.stats.interval import Interval

NONE = "\N{EM DASH}"


def number(value: float | None, *, signed: bool = False) -> str:
    """Three or four figures, a real minus sign, and a dash for what is missing or not finite."""
    if value is None or not math.isfinite(value):
        return NONE
    size = abs(value)
    if size >= 1e5 or 0 < size < 1e-4:
        text = f"{value:.2e}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
    elif size >= 10:
        text = f"{value:,.1f}" if size < 1000 else f"{value:,.0f}"
    elif size >= 1 or size == 0:
        text = f"{value:.2f}" if size else "0"
    else:
        text = f"{value:.3f}" if size >= 0.01 else f"{value:.4f}"
    return (f"+{text}" if signed and value > 0 else text).replace("-", "\N{MINUS SIGN}")


def score(value: float | None, *, signed: bool = False) -> str:
    """One digit behind the point."""
    if value is None or not math.isfinite(value):
        return NONE
    return (f"{value:+,.1f}" if signed else f"{value:,.1f}").replace("-", "\N{MINUS SIGN}")


def brackets(interval: Interval | None, *, signed: bool = False, shown: Callable[..., str] = score) -> str:
    """The two ends of an interval, infinite ones as such; nothing where there is none."""
    if interval is None or not math.isfinite(interval.value) or math.isnan(interval.low):
        return ""
    ends = (interval.low, interval.high)
    endless = {-math.inf: "\N{MINUS SIGN}\N{INFINITY}", math.inf: "\N{INFINITY}"}
    low, high = (endless.get(x) or shown(x, signed=signed) for x in ends)
    return f"[{low}, {high}]"


def percent(value: float | None) -> str:
    """A share."""
    return NONE if value is None or not math.isfinite(value) else f"{100 * value:.1f}\N{NO-BREAK SPACE}%"


def count(value: int | None) -> str:
    """A whole number with separators."""
    return NONE if value is None else f"{value:,}"


def words(names: list[str], last: str = "and") -> str:
    """`A, B and C`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"
