"""Numbers in rules of designs are exact, and so must not be longer than anybody writes them."""

from fractions import Fraction

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.mbo import designer
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.rules import Rules
from deadreckon.mbo.variables import Variable

A, B = (Variable(name, "continuous", 0.0, 1.0) for name in "ab")


@pytest.mark.parametrize("number", ["1e999999", "1e-999999", "1e400", "1E+400", "9" * 5_000, "1." + "0" * 5_000, "99999e299"])
@pytest.mark.parametrize("way", ["constraints", "forbidden", "fixed"])
def test_a_number_that_is_too_large_or_too_long(number, way):
    text = {"constraints": f"a + b <= {number}", "forbidden": f"a > {number}", "fixed": f"a = {number}"}[way]
    with pytest.raises(UserError, match="^mine: the number .* is too (long or too )?large; numbers (have|are)"):
        Rules.of([A, B], **{way: [text]}, name="mine")


def test_numbers_as_people_write_them():
    found = Rules.of([A, B], constraints=["1.5e-3 a + .25 b <= 1e2"], forbidden=["a > 1/3"], fixed=["b = 1E-1"])
    assert found.linear[0].weights == ((0, Fraction(3, 2000)), (1, Fraction(1, 4)))
    assert found.linear[0].bound == 100
    assert found.forbidden[0].clauses[0].value == Fraction(1, 3)
    assert found.fixed == ((1, 0.1),)
    with pytest.raises(UserError, match="a number is needed"):
        Rules.of([A, B], fixed=["a = x"])


@pytest.mark.parametrize("levels", [(1, 2, 3), (3, 2, 1), (2, 1, 3)])
@pytest.mark.parametrize(
    ("relation", "bad"), [(">", [3]), (">=", [2, 3]), ("<", [1]), ("<=", [1, 2]), ("=", [2]), ("!=", [1, 3])]
)
def test_levels_that_are_numbers_are_compared_as_numbers_in_whatever_order_they_stand(levels, relation, bad):
    dose = Variable("dose", "ordinal", levels=levels)
    [clause] = Rules.of([A, dose], forbidden=[f"dose {relation} 2"]).forbidden[0].clauses
    assert sorted(level for i, level in enumerate(levels) if clause.holds(Fraction(i))) == bad
    np.testing.assert_array_equal(clause.met(np.arange(3.0)), [level in bad for level in levels])


@pytest.mark.parametrize("rule", [{"constraints": ["a + b <= -5"]}, {"forbidden": ["a > -1"]}])
def test_a_rule_of_numbers_that_nothing_satisfies_is_blamed(rule):
    rng = np.random.default_rng(0)
    frame = {"a": rng.uniform(size=20), "b": rng.uniform(size=20), "y": rng.normal(size=20)}
    with pytest.raises(UserError, match="no design within the bounds satisfies all constraints; without '.*' there would"):
        Designs.from_frame(frame, "y", **rule)


def test_the_best_of_the_data_are_those_that_the_rules_allow():
    rng = np.random.default_rng(0)
    frame = {"a": rng.uniform(size=20).round(3), "y": np.arange(20.0)}
    data = Designs.from_frame(frame, "y", forbidden=["a > 0.5"])
    allowed = np.flatnonzero(frame["a"] <= 0.5)
    made = designer("best").propose(data, 3)
    np.testing.assert_allclose(made.x[:, 0], frame["a"][allowed[::-1][:3]], rtol=1e-6)
    assert np.isnan(made.predicted_std).all()  # they were measured
    assert made.warning is None
    with pytest.raises(UserError, match=rf"has {len(allowed)} designs that satisfy the rules, fewer than the 20 asked for"):
        designer("best").propose(data, 20)


def test_an_ampersand_within_a_name_separates_no_conditions():
    salt = Variable("salt & pepper", "continuous", 0.0, 1.0)
    [found] = Rules.of([salt, B], forbidden=["`salt & pepper` > 0.5 & b > 0.2"]).forbidden
    assert [(each.column, each.relation) for each in found.clauses] == [(0, ">"), (1, ">")]
