"""Scores that change along a table beyond what inputs explain, and tables of which this must not be said."""

import warnings

import numpy as np
import pytest

from benchmarks.design_order import TABLES, rising, told
from deadreckon.mbo import over_time
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.gp import GP
from deadreckon.mbo.over_time import left_out
from deadreckon.stats.products import p_of_products


def table(seed=0, rows=80, **more):
    """A campaign whose heat rises from run to run, and whose yield rises with time alone."""
    rng = np.random.default_rng(seed)
    x, time = rising(rng, rows)
    y = 2 * time + 0.3 * rng.standard_normal(rows)
    return {"heat": x[:, 0], "acid": x[:, 1], "speed": x[:, 2], "yield": y} | more


def read(columns, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = Designs.from_frame(columns, "yield", **options)
    return data, [str(each.message) for each in caught if "changed along the table" in str(each.message)]


def test_a_drift_is_told_with_the_inputs_that_changed_along_with_it():
    data, lines = read(table())
    assert len(lines) == 1
    assert "yield changed along the table beyond what the inputs explain (p < 0.001), and so did heat: if" in lines[0]
    assert "acid" not in lines[0]
    assert "fix it at its latest value (--fix COLUMN=VALUE)" in lines[0]
    assert any("changed along the table" in each for each in data.noticed)  # on the page


def test_the_number_of_the_run_as_a_fixed_input_takes_the_drift_away():
    """Without it, heat seems to be worth half of what time is."""
    plain, _ = read(table())
    with_run, lines = read(table(run=np.arange(1, 81)), fixed=["run = 80"])
    assert not lines
    effect = []
    for data in (plain, with_run):
        low, high = (np.array(data.x[-1:]) for _ in range(2))
        low[0, 0], high[0, 0] = 0.2, 0.8
        fitted = GP().propose(data, 4, validate=False).fitted
        effect.append(float(np.diff(fitted.predict(np.concatenate([low, high]))[0])[0]))
    assert effect[0] > 0.5
    assert abs(effect[1]) < 0.3


@pytest.mark.parametrize("name", [name for name in TABLES if "drift" in name])
def test_drifts_of_other_tables_are_told(name):
    assert sum(told(name, seed, 80) for seed in range(4)) >= 3


@pytest.mark.parametrize("name", [name for name in TABLES if "drift" not in name])
def test_other_tables_give_no_message(name):
    assert sum(told(name, seed, 80) for seed in range(8)) <= 1


def test_tables_in_the_order_of_their_scores_or_of_inputs_say_nothing_of_time():
    columns = table()
    by_score = np.argsort(columns["yield"])
    assert not read({name: values[by_score] for name, values in columns.items()})[1]
    by_heat = np.argsort(columns["heat"])
    assert not read({name: values[by_heat] for name, values in columns.items()})[1]
    assert not read({name: values[:29] for name, values in columns.items()})[1]  # too few rows


def test_replicates_do_not_hide_a_drift():
    """Each recipe twice in a row: one tells the time of the other."""
    columns = table()
    for name in ("heat", "acid", "speed"):
        columns[name] = np.repeat(columns[name][::2], 2)
    assert len(read(columns)[1]) == 1


def test_a_drift_without_a_change_of_inputs_biases_nothing():
    columns = table()
    columns["heat"] = np.random.default_rng(1).permutation(columns["heat"])
    assert not read(columns)[1]


def test_a_category_is_named():
    rng = np.random.default_rng(0)
    columns = table()
    columns["heat"] = rng.permutation(columns["heat"])
    columns["catalyst"] = np.where(rng.random(80) < np.arange(80) / 80, "B", "A")
    (line,) = read(columns)[1]
    assert "and so did catalyst: if" in line


def test_few_groups_say_nothing_and_many_do():
    """Rows of a group are not independent."""
    for count, lines in ((5, 0), (20, 1)):
        columns = table(batch=np.arange(80) * count // 80)
        assert len(read(columns, groups="batch")[1]) == lines


def test_long_tables_are_tested_by_a_part():
    columns = table(rows=3 * over_time.MOST)
    assert len(read(columns)[1]) == 1


@pytest.mark.parametrize("several", [1, 3])
def test_errors_of_left_out_units_are_those_of_fits_to_the_others(several):
    rng = np.random.default_rng(0)
    units = np.arange(25) // several
    z, y = rng.standard_normal((25, 2)), rng.standard_normal((25, 2))
    y[:, 0] += 3.0 * np.sin(2.0 * z[:, 0])
    apart = np.square(z[:, None] - z).sum(-1)
    usual = np.median(apart[np.triu_indices(25, 1)])
    linear = 1.0 + 0.3 * z @ z.T / np.square(z).sum(1).mean()
    errors = {}
    for scale in over_time._SCALES:
        kernel = np.exp(-apart / (2 * scale**2 * usual)) + linear
        for ridge in over_time._RIDGES:
            own = np.empty_like(y)
            for unit in range(units.max() + 1):
                rest = units != unit
                weights = np.linalg.solve(kernel[np.ix_(rest, rest)] + 25 * ridge * np.eye(rest.sum()), y[rest])
                own[~rest] = y[~rest] - kernel[np.ix_(~rest, rest)] @ weights
            errors[scale, ridge] = own
    means = np.stack([y[i] - y[units != units[i]].mean(0) for i in range(25)])
    found = left_out([z], y, units)
    for k in range(2):
        best = min([means[:, k], *(own[:, k] for own in errors.values())], key=lambda each: np.square(each).mean())
        np.testing.assert_allclose(found[:, k], best, atol=1e-6)


def test_products_by_hand():
    """Two clusters of sums 3 and 1: t = 4 / sqrt(10) with one degree of freedom, the tails of Cauchy's distribution."""
    one, other = np.array([[1.0], [2.0], [1.0]]), np.array([[1.0], [1.0], [1.0]])
    expected = 1 - 2 / np.pi * np.arctan(4 / np.sqrt(10))
    np.testing.assert_allclose(p_of_products(one, other, np.array([5, 5, 7])), expected)
    twice = p_of_products(one, np.repeat(other, 2, 1), np.array([5, 5, 7]))
    np.testing.assert_allclose(twice, 2 * expected)
    centred = p_of_products(one, other, np.array([5, 5, 7]), centred=True)  # t = 2 / (sqrt(2) / sqrt(2))
    np.testing.assert_allclose(centred, 1 - 2 / np.pi * np.arctan(2.0))
    assert p_of_products(0 * one, other, np.array([5, 5, 7])) == 1.0
