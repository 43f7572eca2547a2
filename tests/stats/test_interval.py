"""Numbers as they are shown beside their intervals."""

import math

import pytest

from deadreckon.stats.interval import decimals


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ((12.3, -4.0), 2), ((0.11, 0.0), 2), ((0.0046, -0.0002), 4), ((0.099, 0.01), 3), ((0.0,), 2), ((math.nan, math.inf), 2),
        ((), 2),
    ],
)  # fmt: skip
def test_numbers_that_stand_together_keep_two_digits_of_the_largest(values, shown):
    assert decimals(*values) == shown
