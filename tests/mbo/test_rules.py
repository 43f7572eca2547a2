"""Numbers in rules of designs are exact, and so must not be longer than anybody writes them."""

from fractions import Fraction

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.mbo import designer
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import best_permitted
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
    with pytest.raises(UserError, match="a is fixed at 'x', a number is needed"):
        Rules.of([A, B], fixed=["a = x"])
    with pytest.raises(UserError, match="a is compared with '0,5', a number with a decimal point is needed"):
        Rules.of([A, B], forbidden=["a > 0,5"])


@pytest.mark.parametrize("levels", [(1, 2, 3), (3, 2, 1), (2, 1, 3)])
@pytest.mark.parametrize(
    ("relation", "bad"), [(">", [3]), (">=", [2, 3]), ("<", [1]), ("<=", [1, 2]), ("=", [2]), ("!=", [1, 3])]
)
def test_levels_that_are_numbers_are_compared_as_numbers_in_whatever_order_they_stand(levels, relation, bad):
    dose = Variable("dose", "ordinal", levels=levels)
    [clause] = Rules.of([A, dose], forbidden=[f"dose {relation} 2"]).forbidden[0].clauses
    assert sorted(level for i, level in enumerate(levels) if clause.holds(Fraction(i))) == bad
    np.testing.assert_array_equal(clause.met(np.arange(3.0)), [level in bad for level in levels])


@pytest.mark.parametrize(("relation", "at"), [("<", False), ("<=", True), (">", False), (">=", True)])
def test_a_value_at_a_threshold_is_compared_as_32_bits_hold_both(relation, at):
    [clause] = Rules.of([A, B], forbidden=[f"a {relation} 0.3"]).forbidden[0].clauses
    for kind in (np.float32, np.float64):  # float64(float32(0.3)) is greater than 0.3
        assert clause.met(np.array([0.3], np.float32).astype(kind)).tolist() == [at]
        assert clause.met(np.array([0.2, 0.4], kind)).tolist() == ["<" in relation, ">" in relation]
    assert clause.holds(Fraction(3, 10)) == at
    [far] = Rules.of([A, B], forbidden=[f"a {relation} 1e200"]).forbidden[0].clauses
    assert far.met(np.array([0.3])).tolist() == ["<" in relation]


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


def test_the_best_of_the_data_are_those_that_the_page_calls_so():
    """Mixtures whose decimals are rounded count; steps and fixed values do as well."""
    rng = np.random.default_rng(0)
    parts = rng.dirichlet(np.ones(3), 20).round(3)
    parts[:, 2] = 1 - parts[:, 0] - parts[:, 1]
    parts[:3] = (0.33, 0.33, 0.33), (0.5, 0.2, 0.25), (0.66, 0.17, 0.17)
    heat = np.r_[40.0, 40, 43, 50, np.full(16, 40)]
    frame = dict(zip("abc", parts.T)) | {"heat": heat, "y": np.arange(20.0)[::-1]}
    data = Designs.from_frame(frame, "y", mixtures=["abc"], steps={"heat": 5})
    made = designer("best").propose(data, 2)
    np.testing.assert_allclose(made.x, data.x[[0, 3]])  # row 1 sums to 0.95, and 43 is no multiple of 5
    assert best_permitted(data) == 0
    data = Designs.from_frame(frame, "y", mixtures=["abc"], fixed=["heat = 50"])
    np.testing.assert_allclose(designer("best").propose(data, 1).x, data.x[[3]])


def test_an_ampersand_within_a_name_separates_no_conditions():
    salt = Variable("salt & pepper", "continuous", 0.0, 1.0)
    [found] = Rules.of([salt, B], forbidden=["`salt & pepper` > 0.5 & b > 0.2"]).forbidden
    assert [(each.column, each.relation) for each in found.clauses] == [(0, ">"), (1, ">")]


def mixture(**rules) -> Designs:
    rng = np.random.default_rng(0)
    parts = rng.dirichlet([1, 1, 1], 40).round(4)
    parts[:, 2] = (1 - parts[:, 0] - parts[:, 1]).round(4)
    frame = dict(zip("pqr", parts.T)) | {"kind": ["u", "v"] * 20, "y": rng.normal(size=40)}
    return Designs.from_frame(frame, "y", **rules)


@pytest.mark.parametrize(
    "rules",
    [{"mixtures": ["pqr"], "fixed": ["p=0.333333"]}, {"mixtures": ["pqr"], "fixed": ["p=0.3333333"]},
     {"constraints": ["p + q = 0.123456"]}, {"constraints": ["2.5 p + q = 1.234567"]},
     {"constraints": ["p + q = 0.8", "q + r = 0.7"], "fixed": ["p=0.333333"]}],
)  # fmt: skip
def test_what_must_be_equal_has_as_many_decimals_as_it_takes(rules):
    data = mixture(**rules)
    found, good = data.repair.exact(data.x)
    assert good.all()
    assert data.repair.good(found).all()
    assert len(np.unique(found[:, 1])) > 5 or "q + r = 0.7" in rules.get("constraints", ())  # not one way out for all


def test_levels_and_steps_of_many_decimals_are_met_too():
    rng = np.random.default_rng(0)
    frame = {"dose": rng.choice([0.123456, 0.654321], 30), "a": rng.uniform(size=30), "b": rng.uniform(size=30)}
    rules = {"kinds": {"dose": "ordinal"}, "bounds": {"a": (0.0, 1.0), "b": (0.0, 1.0)}, "constraints": ["dose + a + b = 1"]}
    for fixed in ((), ("dose=0.123456",)):
        data = Designs.from_frame(frame | {"y": rng.normal(size=30)}, "y", fixed=fixed, **rules)
        assert data.repair.exact(data.x)[1].all()
    stepped = {"bounds": {"a": (0.0, 1.0), "b": (0.0, 2.0)}, "steps": {"a": 0.333333}, "constraints": ["a + b = 1.1"]}
    data = Designs.from_frame({"a": [0.0, 0.333333] * 10, "b": rng.uniform(size=20), "y": rng.normal(size=20)}, "y", **stepped)
    assert data.repair.exact(data.x)[1].all()


@pytest.mark.parametrize(
    ("rules", "told"),
    [({"constraints": ["a + b >= 3"]}, False), ({"constraints": ["a - 0.333333 b = 0"], "bounds": {"b": (0.001, 0.9)}}, True),
     ({"constraints": ["a + b = 0.123456789"]}, True)],
)  # fmt: skip
def test_the_hint_on_digits_is_told_where_they_are_to_blame(rules, told):
    rng = np.random.default_rng(0)
    frame = {"a": rng.uniform(0.01, 0.8, 20), "b": rng.uniform(0.01, 0.8, 20), "y": rng.normal(size=20)}
    with pytest.raises(UserError, match="(no design|few designs) within the bounds") as error:
        Designs.from_frame(frame, "y", **rules)
    assert ("seven digits" in str(error.value)) == told


def test_bounds_beyond_32_bits_and_values_fixed_at_a_bound():
    frame = {"t": np.linspace(0.0, 123456.789, 20), "u": np.arange(20.0), "y": np.arange(20.0)}
    assert Designs.from_frame(frame, "y", bounds={"t": (-1e39, 1e39)}).variables[0].high < 1e39
    data = Designs.from_frame(frame, "y", bounds={"t": (0.0, 123456.789)}, fixed=["t=123456.789"])
    np.testing.assert_allclose(data.repair.exact(data.x)[0][:, 0], 123456.789)


def test_a_ratio_of_more_decimals_than_32_bits_hold_is_refused_with_the_way_to_write_it():
    with pytest.raises(UserError, match="few designs .* satisfy 'p - 0.333333 q = 0'; .* in whole numbers, such as 3 a"):
        mixture(constraints=["p - 0.333333 q = 0"], bounds={"q": (0.001, 0.9)})
    data = mixture(constraints=["3 p - q = 0"])
    assert data.repair.exact(data.x)[1].all()


def test_rules_that_leave_no_candidate_of_a_search_crash_nothing():
    data = mixture(bounds={"p": (0.0, 1.0), "q": (0.0, 1.0)})
    assert data.coordinates.encode(data.x[:0]).shape == (0, 4)


@pytest.mark.parametrize("high", [0.999999999, 0.9876543, 16777216.3, 1.0])
def test_proposals_do_not_lie_beyond_bounds_as_they_are_written(high):
    data = mixture(bounds={"p": (-high, high)})
    v = data.variables[0]
    assert abs(v.high - high) < 1e-6 * high
    far = np.array([[-9 * high, 0.5, 0.5, 0], [9 * high, 0.5, 0.5, 0]])
    free = data.coordinates.decode(data.coordinates.encode(far))
    ruled = mixture(bounds={"p": (-high, high)}, constraints=["p + q <= 2"]).repair.exact(far)[0]
    for end in (*free[:, 0], *ruled[:, 0]):
        assert abs(Fraction(str(end))) <= Fraction(str(high))


def test_bounds_between_which_32_bits_hold_no_number():
    with pytest.raises(UserError, match="column a: 32 bits hold no number between its bounds 0.30000001 and 0.30000002"):
        Designs.from_frame({"a": [0.30000001] * 16, "y": np.arange(16.0)}, "y", bounds={"a": (0.30000001, 0.30000002)})
    for constant in (1 / 3, 1234.56789, 0.1):  # which the nearest number stands for
        frame = {"a": [constant] * 20, "b": np.arange(20.0), "y": np.arange(20.0)}
        data = Designs.from_frame(frame, "y", bounds={"a": (constant, constant)})
        assert data.variables[0].low == float(str(np.float32(constant)))
        for constraints in ((), ("a + b <= 1240",), ("a - 1000 b <= -1",)):
            data = Designs.from_frame(frame, "y", constraints=constraints)
            assert data.repair.exact(data.x)[1].all()


def test_levels_are_told_apart_by_their_values():
    for levels in (("A", "B", "A"), (1, 1.0, 2)):
        with pytest.raises(UserError, match="s: its level .* is listed twice; levels must differ"):
            Variable("s", "ordinal", levels=levels)
    with pytest.raises(UserError, match="s: a level must be finite, got inf"):
        Variable("s", "ordinal", levels=(1.0, float("inf")))
    s = Variable("s", "categorical", levels=(1.0, 2.5))
    assert Rules.of([s], fixed=["s = 1"]).fixed == Rules.of([s], fixed=["s = 1.0"]).fixed == ((0, 0.0),)
    assert Rules.of([s], forbidden=["s = 2.50"]).forbidden[0].clauses[0].levels == (1,)
    signs = Variable("s", "categorical", levels=("a=1", "A&B", "<5", "5'"))
    for level, name in enumerate(signs.levels):
        assert Rules.of([signs], fixed=[f's = "{name}"']).fixed == ((0, level),)
        assert Rules.of([signs], forbidden=[f's = "{name}" & s != `{name}`']).forbidden[0].clauses[0].levels == (level,)
    marked = Variable("d'x", "continuous", 0.0, 9.0), Variable("e'y", "continuous", 0.0, 9.0)
    assert len(Rules.of(marked, forbidden=["d'x > 3 & e'y < 2"]).forbidden[0].clauses) == 2
    pipe = Variable("pipe", "categorical", levels=('3"', '5"', '7"'))
    assert [c.levels for c in Rules.of([pipe], forbidden=['pipe != 5" & pipe != 3"']).forbidden[0].clauses] == [(0, 2), (1, 2)]
    with pytest.raises(UserError, match="needs one relation, got 's = a=1'; levels that hold such signs stand in quotes"):
        Rules.of([signs], fixed=["s = a=1"])


def test_truth_values_in_an_order_are_no_numbers():
    frame = {"stirred": [True, False] * 10, "t": np.arange(20.0), "y": np.arange(20.0)}
    data = Designs.from_frame(frame, "y", levels={"stirred": [False, True]}, kinds={"stirred": "ordinal"}, steps={"t": 5},
                              fixed=["stirred = false"])  # fmt: skip
    assert data.repair.exact(data.x)[1].all()
    assert not any(data.decode(data.repair.exact(data.x)[0])["stirred"])
    with pytest.raises(UserError, match="and stirred has levels; use a forbidden combination"):
        Designs.from_frame(frame, "y", levels={"stirred": [False, True]}, kinds={"stirred": "ordinal"},
                             constraints=["t + stirred <= 5"])  # fmt: skip


def test_a_factor_that_may_be_a_power_of_ten_is_refused():
    a, e1 = A, Variable("e1", "continuous", 0.0, 100.0)
    with pytest.raises(UserError, match=r"'a \+ 2e1 <= 100': 2e1 is a number, or 2 \* e1; write one or the other"):
        Rules.of([a, e1], constraints=["a + 2e1 <= 100"])
    assert Rules.of([a, e1], constraints=["a + 2 e1 <= 100"]).linear[0].weights == ((0, 1), (1, 2))
    e = Variable("e", "continuous", 0.0, 1.0)
    for text in ("a + 2e-1 <= 3", "a <= 2e-1", "2E+1 a <= 3"):
        named = Variable("E", "continuous", 0.0, 1.0) if "E" in text else e
        with pytest.raises(UserError, match="is a number, or 2 "):
            Rules.of([a, named], constraints=[text])
    assert Rules.of([a, B], constraints=["a + 2e1 b <= 100"]).linear[0].weights == ((0, 1), (1, 20))


def test_a_log_scale_that_32_bits_do_not_hold_is_refused():
    with pytest.raises(UserError, match=r"s: a log scale begins at 1.18e-38 \(32 bits\), got 1e-40; take another unit"):
        Variable("s", low=1e-40, high=1.0, log=True)


def test_rules_leave_a_variable_on_a_log_scale_all_its_decades():
    rng = np.random.default_rng(0)
    rate, b = np.r_[1e-6, 1.0, 10 ** rng.uniform(-6, 0, 38)], rng.uniform(size=40).round(3)
    frame = {"rate": rate, "b": b, "c": rng.uniform(size=40), "y": rng.normal(size=40)}
    near = np.array([[3.2e-6, 0.8, 0.7]], np.float32)
    for rule in ({"forbidden": ["rate > 0.1 & b > 0.3"]}, {"constraints": ["rate + b <= 1.5"]}):
        data = Designs.from_frame(frame, "y", logs=["rate"], **rule)
        found, good = data.repair.exact(data.x)
        assert good.all()
        kept = data.repair.good(data.x)
        np.testing.assert_allclose(found[kept, 0], data.x[kept, 0], rtol=1e-6)  # as they were measured
    data = Designs.from_frame(frame, "y", logs=["rate"], forbidden=["rate > 0.1 & b > 0.3", "b > 0.5 & c > 0.3"])
    found, good = data.repair.exact(near)
    assert good.all()
    np.testing.assert_allclose(found, [[3.2e-6, 0.5, 0.7]], rtol=1e-5)  # what breaks the rule moves, on the grid
    bounds = {"rate": (1e-6, 1), "b": (0, 1), "c": (0, 1)}
    data = Designs.from_frame(frame, "y", logs=["rate"], bounds=bounds, mixtures=[["rate", "b", "c"]])
    found, good = data.repair.exact(np.array([[3.24e-6, 0.6, 0.399997]]))
    assert good.all()
    np.testing.assert_allclose(found[0, 0], 3.2e-6, rtol=1e-5)  # beside parts of 0.6 32 bits hold seven decimals


def test_rules_move_a_variable_on_a_log_scale_by_shares_of_its_value():
    """By deviations of the values, small ones would lose decades, which are much to a model; the others would hardly move."""
    rng = np.random.default_rng(0)
    frame = {"cat": 10 ** rng.uniform(-4, 1, 40), "t": rng.uniform(0, 10, 40), "y": rng.normal(size=40)}
    bounds = {"cat": (1e-4, 10), "t": (0, 10)}
    data = Designs.from_frame(frame, "y", logs=["cat"], constraints=["cat + t <= 8"], bounds=bounds)
    ratio, x = data.coordinates.std[0], np.array([[0.01, 8.5], [2.0, 6.5], [0.5, 9.0], [5.0, 9.0], [5.0, 2.0]])
    found = data.repair.relaxed(x)
    np.testing.assert_allclose(found[0], [0.00993, 7.99007], atol=1e-5)
    scale = np.array([2 * ratio, data.repair.scale[1]])  # by hand: (2, 6.5) is moved by 0.5 across the line
    np.testing.assert_allclose(found[1], x[1] - 0.5 * scale**2 / (scale**2).sum(), atol=1e-5)
    np.testing.assert_allclose(found[:4].sum(1), 8.0)
    np.testing.assert_allclose(found[4], x[4])
    for row, end in zip(x[2:4], found[2:4]):  # far moves: nearly as near as the nearest design of the line
        cat = np.geomspace(1e-4, 8, 2001)
        far = lambda c, t, row=row: np.hypot(np.log(c / row[0]) / ratio, (t - row[1]) / scale[1])  # noqa: E731
        assert far(*end) < 1.15 * far(cat, 8 - cat).min()
    # What a program or steps on a grid add to that is as small beside each value.
    frame = {"cat": frame["cat"], "b": rng.uniform(3, 3.1, 40), "t": rng.uniform(6.9, 7.1, 40), "y": frame["y"]}
    x = np.stack([10 ** rng.uniform(-4, -2, 20), rng.uniform(3, 3.1, 20), rng.uniform(6.9, 7.1, 20)], 1)
    for rule in ("cat + t + b <= 10", "cat + 7 b + 11 t = 98"):
        wide = {"cat": (1e-4, 10), "b": (2, 4), "t": (6, 8)}
        data = Designs.from_frame(frame, "y", logs=["cat"], constraints=[rule], bounds=wide)
        found, good = data.repair.exact(x)
        assert good.all()
        assert np.abs(np.log(found[:, 0] / data.repair.relaxed(x.copy())[:, 0])).max() < 0.01


def test_the_best_design_on_a_grid_with_a_sum_is_found():
    """Of numbers in steps the climb would leave the grid, and its end moved to the nearest allowed design is a poor one."""
    rng = np.random.default_rng(3)
    a, b, c = rng.integers(0, 11, (3, 50))
    y = 2 * a + 3 * b - 0.3 * (b - 6) ** 2 + c - 0.5 * (a - 5) ** 2 + rng.normal(0, 0.3, 50)
    with pytest.warns(UserWarning, match="replicates"):
        data = Designs.from_frame({"a": a, "b": b, "c": c, "y": y}, "y", constraints=["a + b + c <= 12"])
    made = designer("gp", folds=0).propose(data, n=4)
    grid = np.stack(np.meshgrid(*[np.arange(11)] * 3), -1).reshape(-1, 3).astype(np.float32)
    grid = grid[grid.sum(1) <= 12]
    assert made.predicted[0] == pytest.approx(made.fitted.predict(grid)[0].max())
    parts = rng.dirichlet([1, 1, 1], 40)
    frame = dict(zip("abc", parts.T)) | {"y": -np.square(parts - [0.52, 0.43, 0.05]).sum(1)}
    rules = {"mixtures": [["a", "b", "c"]], "steps": dict.fromkeys("abc", 0.05), "bounds": dict.fromkeys("abc", (0, 1))}
    data = Designs.from_frame(frame, "y", **rules)
    made = designer("gp", folds=0).propose(data, n=3)
    np.testing.assert_allclose(made.x.sum(1), 1.0, atol=1e-6)
    shares = np.stack(np.meshgrid(*[np.arange(21)] * 3), -1).reshape(-1, 3) / 20
    shares = shares[np.abs(shares.sum(1) - 1) < 1e-9].astype(np.float32)
    assert made.predicted[0] == pytest.approx(made.fitted.predict(shares)[0].max(), abs=1e-3)


@pytest.mark.parametrize(("name", "more"), [("ensemble", {"members": 2}), ("ram", {"list_size": 40})])
def test_networks_find_good_designs_on_a_grid_with_a_sum(name, more):
    """They climb as if there were no grid; what they propose are the designs of the grid that they predict to be best."""
    rng = np.random.default_rng(3)
    parts = rng.dirichlet([1, 1, 1, 1], 60)
    frame = dict(zip("abcd", parts.T)) | {"y": -np.square(parts - [0.32, 0.23, 0.33, 0.12]).sum(1)}
    rules = {"mixtures": [list("abcd")], "steps": dict.fromkeys("abcd", 0.05), "bounds": dict.fromkeys("abcd", (0, 1))}
    data = Designs.from_frame(frame, "y", **rules)
    made = designer(name, hidden=(32,), steps=200, lr=3e-3, **more).propose(data, n=4)
    grid = np.stack(np.meshgrid(*[np.arange(21)] * 4), -1).reshape(-1, 4) / 20
    grid = grid[np.abs(grid.sum(1) - 1) < 1e-9].astype(np.float32)
    best = np.sort(made.fitted.predict(grid)[0])[::-1]
    assert made.fitted.predict(made.x)[0] == pytest.approx(best[:4], abs=1e-5 * np.ptp(best))


def test_a_constant_that_is_no_whole_number_meets_a_condition_by_its_value():
    frame = {"pressure": [1.5] * 40, "temp": np.linspace(20, 90, 40), "solvent": ["water", "dmf"] * 20, "y": np.arange(40.0)}
    never = ["pressure > 1.8 & solvent = water", "temp > 60 & solvent = water"]  # the first of which never holds
    data = Designs.from_frame(frame, "y", forbidden=never)
    np.testing.assert_allclose(data.repair.exact(np.array([[1.5, 88, 1]]))[0], [[1.5, 60, 1]], rtol=1e-6)
    data = Designs.from_frame(frame | {"solvent": ["water"] * 40}, "y", forbidden=never)  # there is no other solvent
    assert data.repair.exact(data.x)[1].all()
    with pytest.raises(UserError, match="without 'forbidding pressure > 1.2 & temp < 99' there would be some"):
        Designs.from_frame(frame, "y", forbidden=["pressure > 1.2 & temp < 99"])


def test_a_number_that_no_rule_holds_stays_however_small_it_is():
    """The solver's tolerance is 1e-6: values below it came back as others, on a log scale by decades."""
    rng = np.random.default_rng(0)
    frame = {"cat": 10 ** rng.uniform(-9, -3, 60), "b": rng.uniform(0, 8, 60), "t": rng.uniform(0, 8, 60)}
    frame["y"] = rng.normal(size=60)
    data = Designs.from_frame(frame, "y", logs=["cat"], forbidden=["b > 3.5 & t > 3"])
    moved, good = data.repair.exact(data.x.astype(np.float64))
    assert good.all()
    assert (moved != data.x).any()
    np.testing.assert_allclose(moved[:, 0], data.x[:, 0], rtol=1e-5)
