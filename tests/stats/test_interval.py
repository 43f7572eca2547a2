"""Numbers as they are shown beside their intervals."""

import math

import pytest

from deadreckon.stats.interval import decimals, fixed


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ((12.3, -4.0), 2), ((0.11, 0.0), 2), ((0.0046, -0.0002), 4), ((0.099, 0.01), 3), ((0.0,), 2), ((math.nan, math.inf), 2),
        ((), 2),
    ],
)  # fmt: skip
def test_numbers_that_stand_together_keep_two_digits_of_the_largest(values, shown):
    assert decimals(*values) == shown


@pytest.mark.parametrize(
    ("value", "digits", "sign", "text"),
    [
        (12.345, 1, "+", "+12.3"), (-3.2e12, 2, "+", "-3.20e+12"), (1e300, 4, "", "1.00e+300"), (math.inf, 2, "+", "+inf"),
        (-0.001, 2, "", "0.00"), (-0.001, 2, "+", "+0.00"),
    ],
)  # fmt: skip
def test_numbers_of_any_size_stay_short(value, digits, sign, text):
    assert fixed(value, digits, sign) == text
