"""Equalities with weights such as molar masses, parts of very different sizes, and chains, which proposals meet exactly."""

import time
from fractions import Fraction

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.mbo.batch import batch, check_batch
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.lattice import System, moved


def uniform(ends, rows=20, **rules):
    rng = np.random.default_rng(0)
    frame = {name: rng.uniform(low, high, rows).round(digits) for name, (low, high, digits) in ends.items()}
    return Designs.from_frame(frame | {"y": rng.normal(size=rows)}, "y", **rules)


def sums(weights, bounds, rest=()):
    rows = tuple(tuple(map(Fraction, row)) for row in weights)
    count = len(weights[0])
    return System(tuple(range(count)), (Fraction(1),) * count, rows, (rest,) * len(rows), tuple(map(Fraction, bounds)))


@pytest.mark.parametrize("weights", [(7, 11, 13), (789, 997, 1260), (18015, 46069, 58080), (1, 1, 1), (2, 4, 6), (30, 7, 1)])
def test_what_is_moved_in_steps_sums_to_the_bound_and_stays_near(weights):
    rng = np.random.default_rng(0)
    each = sums([weights], [2 * 10**9], rest=((3, Fraction(1)),))
    for _ in range(20):
        steps = rng.integers(0, 20_000, 3).tolist()
        steps[2] += (2 * 10**9 - int(np.dot(weights, steps))) // weights[2]
        ends = [(0, 10**6), (0, 10**6), (-(10**10), 10**10)]
        found = moved(each, steps, ends, [Fraction(0)] * 3 + [Fraction(4)], [1.0, 1.0, 1.0])
        assert np.dot(weights, found) + 4 == 2 * 10**9
        assert np.abs(np.subtract(found, steps)).max() < 3_000
        assert min(found[:2]) >= 0


def test_sums_that_nothing_meets_and_sums_of_one_number():
    odd = sums([(2, 4)], [7])
    assert moved(odd, [1, 1], [(0, 9)] * 2, [], [1.0, 1.0]) is None
    alone = sums([(2,)], [8])
    assert moved(alone, [3], [(0, 9)], [], [1.0]) == [4]
    assert moved(alone, [3], [(0, 3)], [], [1.0]) is None


@pytest.mark.parametrize("second", [(18015, 46069, 98079, 60052), (2, 3, 5, 7), (1, 1, 0, 0)])
def test_two_sums_of_the_same_numbers_are_met_together(second):
    rng = np.random.default_rng(0)
    for _ in range(10):
        there = rng.integers(1_000, 9_000, 4)
        both = sums([(1, 1, 1, 1), second], [int(there.sum()), int(np.dot(second, there))])
        near = (there + rng.integers(-5, 6, 4)).tolist()
        found = np.array(moved(both, near, [(0, 10_000)] * 4, [], [1.0] * 4))
        assert found.sum() == there.sum()
        assert np.dot(second, found) == np.dot(second, there)
        assert np.abs(found - near).max() < 1_000
    assert moved(sums([(1, 1), (2, 2)], [3, 7]), [1, 2], [(0, 9)] * 2, [], [1.0] * 2) is None


@pytest.mark.parametrize(
    "text", ["18.015 a + 46.069 b + 58.08 c = 100", "18.02 a + 46.07 b + 58.08 c = 100", "0.789 a + 0.997 b + 1.26 c = 4"]
)
def test_molar_masses_are_met_in_little_time(text):
    begun = time.process_time()
    data = uniform(dict.fromkeys("abc", (0, 5, 2)), constraints=[text])
    found, good = data.repair.exact(np.repeat(data.x, 4, 0))
    assert good.all()
    away = np.abs(found - data.repair.relaxed(np.repeat(data.x, 4, 0))) / data.repair.scale
    assert np.median(away.max(1)) < 0.02
    assert time.process_time() - begun < 20  # a program took 5 s for each of the 80, and found nothing


def test_parts_of_very_different_sizes_sum_to_the_whole():
    rng = np.random.default_rng(0)
    water, catalyst = rng.uniform(500, 900, 24).round(1), rng.uniform(0.01, 0.05, 24).round(3)
    solvent = (1000 - water - catalyst).round(3)
    frame = {"water": water, "solvent": solvent, "catalyst": catalyst, "y": rng.normal(size=24)}
    for bounds in ({}, {"water": (0, 1000), "solvent": (0, 1000)}):
        data = Designs.from_frame(frame, "y", constraints=["water + solvent + catalyst = 1000"], bounds=bounds)
        x = batch(data, data.x + rng.normal(0, 0.3, data.x.shape) * data.repair.scale, 24)
        check_batch(data, x, False)
        assert len(np.unique(x[:, 2])) > 15  # the small part is not held on the grid of the large ones
    fine = rng.uniform(1e-5, 5e-5, 24).round(6)
    a, b = rng.uniform(0.1, 0.4, 24).round(3), rng.uniform(0.1, 0.4, 24).round(3)
    parts = {"a": a, "b": b, "c": (1 - a - b - fine).round(6), "dopant": fine, "y": water}
    data = Designs.from_frame(parts, "y", mixtures=[["a", "b", "c", "dopant"]])
    found, good = data.repair.exact(data.x)
    assert good.all()
    assert len(np.unique(found[:, 3])) > 10


def test_chains_whose_parts_differ_in_size_and_weights_that_need_a_finer_grid():
    ends = {"a": (0, 7, 2), "b": (2, 7, 0), "c": (0.00438, 0.00535, 5), "d": (1.13, 4.796, 3)}
    bounds = {name: (low, high) for name, (low, high, _) in ends.items()}
    chain = ["7 d + 3 a - b - 2 c = 39.41278", "0.5 d + 2 a = 13.7445"]
    data = uniform(ends, bounds=bounds, constraints=chain, fixed=["b = 3"])
    assert data.repair.exact(data.x)[1].any()
    data = uniform(
        {"a": (0, 10_000, 1), "b": (0, 10_000, 1)}, bounds=dict.fromkeys("ab", (0, 10_000)), constraints=["2 a + 4 b = 10001"]
    )
    assert data.repair.exact(data.x)[1].all()


@pytest.mark.parametrize("relation", [">", "<", ">=", "<="])
def test_a_fixed_value_beside_a_grid_is_what_it_is_to_forbidden_combinations(relation):
    rules = {"bounds": {"rpm": (0, 10_000)}, "fixed": ["rpm = 2500.5"], "forbidden": [f"rpm {relation} 2500.5"]}
    ends = {"rpm": (0, 10_000, 0), "t": (0, 90, 1)}
    if relation in (">", "<"):
        assert uniform(ends, **rules).repair.exact(uniform(ends).x)[1].all()
    else:
        with pytest.raises(UserError, match="no design within the bounds satisfies all constraints; without 'forbidding rpm"):
            uniform(ends, **rules)


@pytest.mark.parametrize(
    ("ends", "rules"),
    [
        (dict.fromkeys("abc", (0, 5, 2)), {"constraints": ["18.015 a + 46.069 b + 98.079 c = 300"], "steps": {"b": 0.5}}),
        ({"n": (0, 10, 0), "m": (0, 10, 0), "z": (0, 5, 2), "w": (0, 5, 2)},
         {"constraints": ["18.015 n + 46.069 m + 98.079 z + 60.052 w = 300"], "kinds": dict.fromkeys("nm", "integer")}),
        (dict.fromkeys("abcd", (0, 1, 3)),
         {"constraints": ["a + b + c + d = 1", "18.015 a + 46.069 b + 98.079 c + 60.052 d = 50"]}),
    ],
)  # fmt: skip
def test_few_values_of_one_part_and_two_sums_take_little_time(ends, rules):
    rng = np.random.default_rng(0)
    steps = rules.get("steps", {})
    frame = {name: rng.uniform(low, high, 20).round(digits) for name, (low, high, digits) in ends.items()}
    frame |= {name: np.round(frame[name] / step) * step for name, step in steps.items()}
    frame |= {name: frame[name].astype(int) for name in rules.get("kinds", {})}
    begun = time.process_time()
    bounds = {name: (low, high) for name, (low, high, _) in ends.items()}
    data = Designs.from_frame(frame | {"y": rng.normal(size=20)}, "y", bounds=bounds, **rules)
    good = data.repair.exact(data.x)[1]
    assert good.mean() > 0.8
    assert time.process_time() - begun < 20


def test_a_step_whose_multiples_32_bits_do_not_hold_is_refused():
    frame = {"a": [0.0, 1 / 3, 2 / 3, 1.0] * 5, "y": np.arange(20.0)}
    with pytest.raises(UserError, match="most multiples of the step 0.3333333333333333 of a have more than the seven digits"):
        Designs.from_frame(frame, "y", steps={"a": 1 / 3})
    assert Designs.from_frame(frame, "y", steps={"a": 0.1}).repair.exact(np.zeros((1, 1)))[1].all()
