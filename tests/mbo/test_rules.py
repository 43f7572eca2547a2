"""Numbers in rules of designs are exact, and so must not be longer than anybody writes them."""

from fractions import Fraction

import pytest

from deadreckon.errors import UserError
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
