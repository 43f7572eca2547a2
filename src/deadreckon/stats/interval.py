"""A number with its interval, and the default level of intervals."""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

REVISION = 3  # of the computation of intervals in all of `stats`; raised when their ends change (see bench/identity.py)
ALPHA = 0.05  # share of cases in which an interval misses
LEVEL = 1.0 - ALPHA
NORMAL = NormalDist().inv_cdf(1.0 - ALPHA / 2)  # half of a normal's interval at `LEVEL`, in standard deviations
ROUNDING = 1e-12  # of the largest number: values that vary by less are the same
PERCENT = f"{100 * LEVEL:g} %"  # the level in words


@dataclass(frozen=True)
class Interval:
    """A number with its confidence interval.

    Attributes:
        value: the estimate.
        low, high: ends of the interval; NaN where there is none, infinite where nothing is known.
    """

    value: float
    low: float
    high: float

    def __format__(self, spec: str) -> str:
        """`value [low, high]`, each number by `spec`; without brackets where there is no interval."""
        if math.isnan(self.low):
            return f"{self.value:{spec}}"
        return f"{self.value:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"

    def __str__(self) -> str:
        return f"{self:.4g}"


def same(values: np.ndarray, size: float = 0.0) -> bool:
    """Whether values are the same but for rounding, so that they show no spread.

    Args:
        values: finite ones, at least one.
        size: of the largest number that they were computed from, if that is more.
    """
    return bool(np.ptp(values) <= ROUNDING * max(float(np.abs(values).max()), size))


def decimals(*values: float) -> int:
    """Number of decimals for numbers that are shown together: two, or more if all are too small for two.

    The largest in size keeps two significant digits.
    """
    most = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    return 2 if most == 0.0 else max(2, 1 - math.floor(math.log10(most)))


def fixed(value: float, digits: int, sign: str = "") -> str:
    """A number with so many decimals, zero without a minus; from 1e9 on in scientific notation, as products of weights can be
    far larger."""
    large = math.isfinite(value) and abs(value) >= 1e9
    return f"{value:{sign}.2e}" if large else f"{value:{sign}z.{digits}f}"


def signed(value: float, low: float, high: float) -> str:
    """A difference and the ends of its interval, with their signs."""
    d = decimals(value, low, high)
    return f"{fixed(value, d, '+')} [{fixed(low, d, '+')}, {fixed(high, d, '+')}]"


def level_in_words(level: float) -> str:
    """A level in words, with enough digits not to show 100 %, to which levels of late looks would be rounded."""
    digits = next((d for d in range(3, 17) if float(f"{100 * level:.{d}g}") < 100), 17)
    return f"{100 * level:.{digits}g} %"


def p_in_words(p_value: float) -> str:
    """A p-value as text."""
    return f"p = {p_value:.2g}" if p_value >= 0.001 else "p < 0.001"
