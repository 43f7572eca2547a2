"""What is said of open claims: hours of what is missing, or seeds that would decide."""

import dataclasses

import numpy as np
import pytest

from deadreckon.bench import claims as declared
from deadreckon.bench.claims import Claim, Comparison, Verdict
from deadreckon.bench.times import Forecast
from deadreckon.stats.comparison import paired
from deadreckon.stats.interval import Interval
from evidence.closing import hours, to_close

SUITE = """
kind = "learn"
seeds = 4
logs = ["hopper-medium-v2"]

[methods]
BC = { agent = "bc" }
TD3 = { agent = "td3" }
"""
CELLS = frozenset("abcd")
GAPS = np.array([-6.0, -2.0, 2.0, 6.0])  # of mean 0, with an interval of 4 runs that reaches to +-8.2


@pytest.fixture
def said(tmp_path):
    """What is said of a claim whose comparisons have these means, whatever is missing or not finite."""
    (tmp_path / "suite.toml").write_text(SUITE)

    def told(*means, margin=0.0, missing="", undefined="", cost=(), **test):
        one = declared.Test(tmp_path / "suite.toml", ("BC",), ("TD3",), ("hopper-medium-v2",), margin=margin, **test)
        found = []
        for mean in means:
            gain, strict = (paired([mean + GAPS], [np.zeros(4)], 1.0 - 0.05 / k) for k in (1, len(means)))
            lacks = frozenset(missing), frozenset(undefined)
            found.append(Comparison(one, "TD3", one.on, gain, strict, CELLS, *lacks, 0.95))
        return to_close(Verdict(Claim("C", "says", "place", (one,)), tuple(found)), dict(cost))

    return told


def test_hours_say_what_is_left_out_and_what_is_rough():
    close, rough, part = Forecast(3600.0), Forecast(1800.0, close=False), Forecast(1800.0, close=False, whole=False)
    assert hours([close, close]) == "2.0"
    assert hours([close, rough]) == "about 1.5"
    assert hours([close, None]) == "> 1.0"
    assert hours([close, part]) == "> about 1.5"
    assert hours([None]) == "not measured"


def test_of_scores_that_are_missing_the_hours_are_told(said):
    cost = {"a": Forecast(7200.0), "b": Forecast(3600.0)}
    assert said(1.0, missing="ab", cost=cost) == "2 scores, 3.0 core-hours"
    assert said(1.0, 1.0, missing="a", cost=cost) == "1 score, 2.0 core-hours"
    assert said(1.0, missing="a", cost={"a": None}) == "1 score, not measured"


def test_of_what_is_decided_nothing_is_told(said):
    assert said(9.0) == said(-9.0) == said(-12.0, 1.0) == ""
    assert to_close(Verdict(Claim("C", "says", "place"), ()), {}) == ""


def test_seeds_are_those_that_a_second_stage_needs(said):
    """Fresh ones alone, at half the level: of a standard deviation of 5.16, 2.24 x 5.16 / sqrt(137) is 0.99."""
    assert said(1.0) == "about 140 fresh seeds, then holds"  # 137, by Student's t
    assert said(4.0) == "about 12 fresh seeds, then holds"  # 2.59 x 5.16 / sqrt(12) is 3.86
    assert said(-4.0) == "about 12 fresh seeds, then contradicted"
    assert said(-2.0, margin=-3.0) == "about 140 fresh seeds, then holds"
    assert said(1.0, 4.0) == "about 140 fresh seeds, then holds"  # all have to
    assert said(1.0, -4.0) == "about 14 fresh seeds, then contradicted"  # at a level for two
    assert said(0.1) == "more than 1,000 fresh seeds: the difference is too near to the margin"


def test_where_no_seeds_would_decide_it_is_said(said):
    none, more = "no number of seeds", "not estimated: more than seeds vary"
    assert said(0.0) == said(4.0, margin=4.0) == said(0.0, 4.0) == none
    assert said(4.0, among=True) == more
    assert said(1.0, undefined="a") == "not estimated: a score is not finite"
    ranged = Comparison(
        declared.Test("suite.toml", ("BC",), ("TD3",), ("a",), range=(0.0, 1.0)), "TD3", ("a",), Interval(0.1, -0.1, 0.3),
        Interval(0.1, -0.2, 0.4), CELLS, frozenset(), frozenset(), 0.95,
    )  # fmt: skip
    assert to_close(Verdict(Claim("C", "says", "place"), (ranged,)), {}) == more
    gain, test = paired([1.0 + GAPS], [np.zeros(4)]), declared.Test("suite.toml", ("BC",), ("TD3",), ("a",))
    even = Comparison(test, "TD3", ("a",), gain, gain, CELLS, frozenset(), frozenset(), 0.95, ("a",))
    assert to_close(Verdict(Claim("C", "says", "place"), (even,)), {}) == "not estimated: all seeds differ by the same on a log"


def test_what_two_stages_leave_open_a_third_may_decide(tmp_path):
    """Its seeds are those that the second one's difference asks for, at a quarter of the level."""
    (tmp_path / "suite.toml").write_text(SUITE)
    gain = paired([1.0 + GAPS], [np.zeros(4)], 0.975)
    test = declared.Test(tmp_path / "suite.toml", ("BC",), ("TD3",), ("hopper-medium-v2",))
    second = Comparison(test, "TD3", ("a",), gain, gain, CELLS, frozenset(), frozenset(), 0.975)
    first = dataclasses.replace(second, gain=paired([9.0 + GAPS], [np.zeros(4)]), level=0.95, again=second)
    told = to_close(Verdict(Claim("C", "says", "place"), (first,)), {})
    assert told == "about 170 fresh seeds, then holds"  # 2.498 x 5.16 / sqrt(169) is 0.99
