"""Numbers as people read them, one by one."""

import pytest

from deadreckon.report.text import brackets, count, number, percent, score, words
from deadreckon.stats.interval import Interval


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "0"), (0.01234, "0.012"), (0.001234, "0.0012"), (0.00001234, "1.23e-5"), (1.234, "1.23"), (-12.34, "-12.3"),
     (1234.4, "1,234"), (123456.0, "1.23e5"), (float("nan"), "—"), (None, "—")],
)  # fmt: skip
def test_numbers(value, shown):
    assert number(value).replace("\N{MINUS SIGN}", "-") == shown


def test_shares_are_shown_in_percent():
    assert percent(0.1234) == "12.3\N{NO-BREAK SPACE}%"
    assert percent(1.0) == "100.0\N{NO-BREAK SPACE}%"
    assert percent(float("nan")) == percent(None) == "\N{EM DASH}"


def test_signs_separators_and_lists():
    assert score(-1234.56) == "\N{MINUS SIGN}1,234.6"
    assert score(20.0, signed=True) == "+20.0"
    assert score(0.0) == "0.0"
    rate = Interval(0.74, 0.66, 0.82)  # of a task without a reference, where one decimal would hide the interval
    assert (score(rate), brackets(rate)) == ("0.74", "[0.66, 0.82]")
    assert (score(2.0, beside=(0.5, 31.0)), brackets(Interval(2.0, -9.5, 13.0))) == ("2.0", "[\N{MINUS SIGN}9.5, 13.0]")
    assert count(1234567) == "1,234,567"
    assert brackets(Interval(1.0, -2.0, float("inf"))) == "[\N{MINUS SIGN}2.00, \N{INFINITY}]"
    assert words(["a", "b", "c"]) == "a, b and c"
