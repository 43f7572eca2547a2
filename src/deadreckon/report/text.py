"""Numbers as people read them."""

import math
from collections.abc import Callable, Sequence
from functools import partial

from deadreckon.stats.interval import Interval, decimals

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


def score(value: Interval | float | None, *, signed: bool = False, beside: Sequence[float] = ()) -> str:
    """A score or return with one decimal, or with more where nothing that is shown together reaches 10, such as success rates.

    Args:
        value: the number; of an interval its value, beside its ends.
        signed: whether positive numbers have a sign.
        beside: what else is shown with it.
    """
    if isinstance(value, Interval):
        value, beside = value.value, (value.low, value.high, *beside)
    if value is None or not math.isfinite(value):
        return NONE
    together = [each for each in (value, *beside) if math.isfinite(each)]
    digits = 1 if max(map(abs, together)) >= 10 or not any(together) else decimals(*together)
    return (f"{value:+,.{digits}f}" if signed else f"{value:,.{digits}f}").replace("-", "\N{MINUS SIGN}")


def brackets(interval: Interval | None, *, signed: bool = False, shown: Callable[..., str] | None = None) -> str:
    """The two ends of an interval, infinite ones as such; nothing where there is none.

    Args:
        interval: the interval.
        signed: whether positive numbers have a sign.
        shown: how a number is shown; None: as a `score` beside the interval's other numbers.
    """
    if interval is None or not math.isfinite(interval.value) or math.isnan(interval.low):
        return ""
    ends = (interval.low, interval.high)
    shown = partial(score, beside=(interval.value, *ends)) if shown is None else shown
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
