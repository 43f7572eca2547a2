"""What the fitted model is asked about: effects of variables, cuts, the one to try, and the columns beside proposals."""

import dataclasses

import jax
import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.mbo import designer, effects, process
from deadreckon.mbo.calibration import OWN, Calibration
from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.first_choice import first_choice, shown_interval
from deadreckon.mbo.fitted import BLOCK, Fitted, covariance_of_members, in_blocks
from deadreckon.mbo.forward import Forward, believed
from deadreckon.mbo.nn_distance import neighbours, usual_distance
from deadreckon.mbo.proposal_table import about, added_columns, rounded
from deadreckon.mbo.rules import written
from deadreckon.mbo.validation import cross_validated, judged
from deadreckon.nets.mlp import MLP, ensemble
from deadreckon.report.design_asked import broken_rule
from deadreckon.training.learner import unstack
from tests.mbo.practice import TABLES

TESTED = Calibration(0.0, 1.0, OWN**0.5, 0.0)  # leaves predictions and their deviations as they are


def plane(rows=40, seed=0, **options):
    """Three numbers and a category, of which the last number is the same everywhere."""
    rng = np.random.default_rng(seed)
    frame = {"a": rng.uniform(0, 4, rows), "b": rng.uniform(-1, 1, rows), "c": rng.choice(["x", "y"], rows), "d": np.ones(rows)}
    return Designs.from_frame(frame | {"y": rng.normal(size=rows)}, "y", **options)


def told(x):
    """The model of these tests: 2 a + a b, and 5 for level y."""
    return 2 * x[..., 0] + x[..., 0] * x[..., 1] + 5 * x[..., 2]


def known(std=0.1):
    """A model that knows how its averages go together: each has an error of its own."""
    return Fitted(lambda x: (told(x), np.full(len(x), std)), lambda x: (told(x), std**2 * np.eye(len(x))), TESTED)


def test_averages_are_those_of_the_model_over_the_rows():
    data = plane()
    found = effects.averages(data, known())
    assert [data.variables[each.column].name for each in found] == ["a", "c", "b"]  # nothing is known of d
    a, c, b = found
    mean_b = float(data.x[:, 1].mean())
    np.testing.assert_allclose(a.mean, a.values * (2 + mean_b) + 5 * data.x[:, 2].mean(), rtol=1e-5)
    assert a.change == pytest.approx(np.ptp(data.x[:, 0]) * (2 + mean_b), rel=1e-5)
    assert c.change == pytest.approx(5.0)
    assert c.rows == pytest.approx((5.0, 5.0))
    assert a.change_std == pytest.approx(0.1 * 2**0.5)
    # What b does in single rows is a times its range: the percentiles of a say how far it differs.
    low, high = np.percentile(data.x[:, 0], [10, 90], method="nearest") * np.ptp(data.x[:, 1])
    assert b.rows == pytest.approx((low, high), rel=1e-4)


def test_rows_are_drawn_where_they_are_many():
    data = plane(rows=150)
    assert len(effects.drawn(data, 100)) == 100
    assert effects.averages(data, known())[1].change == pytest.approx(5.0)


def test_an_effect_is_told_from_none_or_depends_on_others():
    data = plane(rows=60)
    crossed = lambda x: (x[..., 0] - 2) * x[..., 1]  # noqa: E731
    fitted = Fitted(lambda x: (crossed(x), None), lambda x: (crossed(x), 0.3**2 * np.eye(len(x))), TESTED)
    found = {data.variables[each.column].name: each for each in effects.averages(data, fitted)}
    assert found["b"].distinct(3) is False
    assert found["b"].depends(3)
    assert not found["c"].depends(3)
    assert found["c"].distinct(3) is False
    sure = {data.variables[each.column].name: each for each in effects.averages(data, known())}
    assert sure["a"].distinct(3) is True
    assert not sure["a"].depends(3)
    unsure = effects.averages(data, Fitted(lambda x: (told(x), None)))
    assert {each.distinct(3) for each in unsure} == {None}
    untested = effects.averages(data, dataclasses.replace(known(), calibration=None))
    assert {(each.distinct(3), each.depends(3), each.std) for each in untested} == {(None, False, None)}
    assert [each.change for each in untested] == [each.change for each in effects.averages(data, known())]
    assert effects.critical(1) == pytest.approx(1.959964)
    assert effects.critical(5) == pytest.approx(2.575829)
    assert effects.critical(1, 4) == pytest.approx(2.776445)  # of five members


def test_few_members_are_no_known_deviation():
    """A slope that is chance alone, and five members that differ from it as it differs from zero: one in twenty is told."""
    rng, wrong = np.random.default_rng(0), {4: 0, np.inf: 0}
    data = Designs.from_arrays(rng.normal(size=(40, 1)), rng.normal(size=40))
    for slope in rng.standard_normal(400):
        members = rng.standard_normal((5, 1, 1))

        def averages(x, slope=slope, members=members):
            return slope * x[..., 0], covariance_of_members(members * x[..., 0])

        for freedom in wrong:
            fitted = Fitted(lambda x, slope=slope: (slope * x[:, 0], None), averages, TESTED, freedom=freedom)
            wrong[freedom] += effects.averages(data, fitted)[0].distinct(1)
    assert wrong[4] < 0.08 * 400
    assert wrong[np.inf] > 0.09 * 400  # 12 % by the quantile of a deviation that is known


def test_averages_of_the_process_have_the_covariance_of_its_posterior():
    data = TABLES["mixed"](40).designs()
    found = process.fit(data)
    groups = np.stack([effects.with_value(data, data.x[:6], 0, value) for value in (10.0, 40.0, 90.0)])
    mean, covariance = found.averages(groups)
    flat = groups.reshape(-1, groups.shape[-1])
    np.testing.assert_allclose(mean.reshape(-1), found.posterior(flat)[0], rtol=1e-8)
    whole = found.covariance(flat).reshape(3, 6, 3, 6).mean((1, 3)) * found.y_std**2
    np.testing.assert_allclose(covariance, whole, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_of_noise_no_effect_is_told_from_none():
    """With calibrated deviations at 5 % a table or so (`benchmarks/effects.py`); of these two in none."""
    wrong = 0
    for seed in range(2):
        rng = np.random.default_rng(seed)
        data = Designs.from_arrays(rng.normal(size=(40, 2)), rng.normal(size=40))
        quality = cross_validated(data, designer("gp").predictor, "GP", folds=3)
        found = process.fit(data)
        shown = effects.averages(data, Fitted(found.posterior, found.averages, quality.calibration))
        wrong += any(each.distinct(2) for each in shown)
    assert wrong == 0
    data = TABLES["wide"](80, variables=6).designs()
    found = process.fit(data)
    shown = effects.averages(data, Fitted(found.posterior, found.averages, TESTED))
    assert {each.column for each in shown if each.distinct(6)} >= {0, 1, 2}


def test_parts_of_a_mixture_make_room_for_one_another():
    data = TABLES["mixture"]().designs()
    low, high = (np.array([getattr(v, end) for v in data.variables]) for end in ("low", "high"))
    x = effects.with_value(data, data.x[:30], 0, 0.5)
    np.testing.assert_allclose(x[:, :4].sum(1), 1.0, atol=1e-9)
    assert (x[:, 0] == 0.5).all()
    np.testing.assert_array_equal(x[:, 4], data.x[:30, 4])
    inside = effects.allowed(data, x)
    assert inside.any()
    assert ((x[inside] >= low - 1e-3) & (x[inside] <= high + 1e-3)).all()
    free = np.abs(x[:, 1:4, None] - np.stack([low[1:4], high[1:4]], 1)[None]).min(2) > 1e-9
    both = free.all(1)  # where no part is at a bound, proportions are kept
    assert both.any()
    ratio = x[both, 1] / x[both, 2]
    np.testing.assert_allclose(ratio, data.x[:30][both, 1] / data.x[:30][both, 2], rtol=1e-5)
    # Where the others are all 0 they share what is left.
    shared = effects._scaled(np.zeros((1, 2)), np.ones(2), np.array([0.4]), np.zeros(2), np.ones(2))
    np.testing.assert_allclose(shared, [[0.2, 0.2]])
    # What one cannot take, since it is at its bound, others do.
    capped = effects._scaled(np.array([[0.4, 0.2]]), np.ones(2), np.array([0.9]), np.zeros(2), np.array([0.5, 1.0]))
    np.testing.assert_allclose(capped, [[0.5, 0.4]])


def test_cuts_go_to_the_bounds_and_know_what_is_allowed():
    data = plane(bounds={"a": (0, 8)}, constraints=["a + b <= 5"], forbidden=["c = y & a > 3"])
    design = np.array([4.0, 0.5, 0.0, 1.0], np.float32)
    a, c = effects.cuts(data, known(), design, [0, 2])
    assert a.values[0] == pytest.approx(0)
    assert a.values[-1] == pytest.approx(8)
    assert 4.0 in a.values
    np.testing.assert_array_equal(a.allowed, a.values <= 4.5)
    np.testing.assert_array_equal(c.allowed, [True, False])
    np.testing.assert_allclose(c.mean, [10.0, 15.0])


def test_cuts_move_nothing_that_is_fixed():
    """Of a mixture with one part fixed the other makes room alone, and where it cannot, the design is not allowed."""
    rng = np.random.default_rng(0)
    parts = np.sort(rng.dirichlet(np.ones(3), 20))[:, [2, 0, 1]]
    columns = {**dict(zip("abc", parts.T)), "y": rng.normal(size=20)}
    bounds = {name: (0, 1) for name in "ac"} | {"b": (0, 0.6)}
    data = Designs.from_frame(columns, "y", bounds=bounds, mixtures=[["a", "b", "c"]], fixed=["c = 0.2"])
    seen = Fitted(lambda x: (x[:, 1] + 10 * x[:, 2], None))
    [a, c] = effects.cuts(data, seen, np.array([0.5, 0.3, 0.2], np.float32), [0, 2])
    np.testing.assert_allclose(a.mean, 0.8 - a.values + 2.0, atol=1e-6)
    np.testing.assert_array_equal(a.allowed, (a.values >= 0.2) & (a.values <= 0.8))
    assert 3 < a.allowed.sum() < len(a.values)
    np.testing.assert_array_equal(c.allowed, c.values == np.float32(0.2))
    alone = Designs.from_frame(columns, "y", bounds=bounds, mixtures=[["a", "b", "c"]], fixed=["c = 0.2", "b = 0.3"])
    [a] = effects.cuts(alone, seen, np.array([0.5, 0.3, 0.2], np.float32), [0])
    np.testing.assert_array_equal(a.allowed, a.values == 0.5)
    # Rows of the data, over which effects are averaged, have other values.
    np.testing.assert_allclose(effects.with_value(data, data.x, 0, 0.5)[:, 1:].sum(1), 0.5)


def test_the_most_changing_variables_are_chosen_where_they_are_many(monkeypatch):
    monkeypatch.setattr(effects, "MOST", 2)
    data = plane()
    assert [data.variables[each.column].name for each in effects.averages(data, known())] == ["a", "c"]


def test_the_model_that_comes_with_proposals_is_the_one_that_made_them():
    data = TABLES["mixed"](40).designs()
    made = designer("gp", rounds=2, folds=2).propose(data, 4)
    mean, std = made.fitted.predict(made.x)
    np.testing.assert_allclose(mean, made.predicted, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(std, made.predicted_std, rtol=1e-4, atol=1e-5)
    each, covariance = made.fitted.average(made.x[:, None])
    np.testing.assert_allclose(each[:, 0], mean, rtol=1e-4, atol=1e-4)
    # The average of a group of one is a true score, of which the noise of a measurement is no part.
    plain = made.fitted.averages(made.x[:, None])[1]
    true = process.fit(data).posterior(made.x)[1]
    np.testing.assert_allclose(np.sqrt(np.diag(plain)), true, rtol=1e-3)
    np.testing.assert_allclose(covariance, made.quality.calibration.scale**2 / OWN * plain, rtol=1e-6)


@pytest.mark.parametrize("rows", [1, BLOCK, BLOCK + 1])
def test_blocks_have_one_shape_and_lose_nothing(rows):
    z, shapes = np.arange(rows, dtype=np.float32)[:, None], []
    parts = in_blocks(lambda z: shapes.append(z.shape) or np.asarray(z), z)
    assert set(shapes) == {(BLOCK, 1)}
    np.testing.assert_array_equal(np.concatenate(parts)[:rows], z)


@pytest.mark.slow
def test_averages_of_an_ensemble_go_together_as_its_members_do():
    data = TABLES["mixed"](40).designs()
    nets = ensemble(lambda key: MLP.create(data.coordinates.size, (4,), 2, key), 3, jax.random.key(0))
    plain = Fitted(lambda x: (x[:, 0], None))
    fitted = Forward(members=3)._fitted(plain, data, nets)
    assert fitted.freedom == 2
    mean, covariance = fitted.averages(np.stack([data.x[:5], data.x[5:10]]))
    each = [believed(member, data.coordinates.encode(data.x[:10]))[0] for member in unstack(nets, 3)]
    values = data.coordinates.score(np.stack(each)).reshape(3, 2, 5)
    np.testing.assert_allclose(mean, values.mean(0), rtol=1e-4)
    np.testing.assert_allclose(covariance, np.cov(values.mean(2).T), rtol=1e-3, atol=1e-6)
    assert Forward(members=3, objective="min")._fitted(plain, data, nets) is plain


def test_members_give_the_covariance_of_averages():
    means = np.array([[[1.0, 3.0], [0.0, 0.0]], [[2.0, 6.0], [4.0, 0.0]]])  # averages (2, 0) and (4, 2)
    np.testing.assert_allclose(covariance_of_members(means), [[2.0, 2.0], [2.0, 2.0]])


def test_neighbours_are_the_nearest_rows():
    data = TABLES["mixed"](50).designs()
    far, rows = neighbours(data, data.x[:5], 3)
    z = data.coordinates.place(data.x)
    apart = np.linalg.norm(z[:5, None] - z, axis=2)
    np.testing.assert_array_equal(rows[:, 0], np.arange(5))
    np.testing.assert_allclose(far, np.sort(apart, 1)[:, :3] / usual_distance(data), atol=1e-6)


SKILLED = judged(np.arange(10.0), np.arange(10.0), np.ones(10), np.arange(10) % 5, "m")


def proposed(mean, std, quality=SKILLED):
    return Proposals("m", np.zeros((3, 4)), np.array(mean), np.array(std), 0, quality=quality, fitted=known())


def test_the_one_to_try_is_that_of_the_best_lower_end_near_the_data():
    near = np.zeros(3)
    made = proposed([1.0, 2.0, 3.0], [0.1, 0.1, 2.0])
    assert first_choice(made, near) == 1
    assert first_choice(made, np.array([0.0, 9.0, 9.0])) == 0
    assert first_choice(made, np.full(3, 9.0)) == 1
    assert first_choice(proposed([1.0, 2.0, 3.0], [np.nan] * 3), near) == 2
    assert first_choice(dataclasses.replace(made, quality=None), near) == 2  # what its intervals cover is not known
    assert first_choice(dataclasses.replace(made, fitted=None), near) is None
    order = Fitted(lambda x: (np.array([1.0, 3.0, 2.0]), None), is_order=True)
    assert first_choice(dataclasses.replace(proposed([np.nan] * 3, [np.nan] * 3), fitted=order), near) == 1
    rng = np.random.default_rng(0)
    noise = judged(rng.normal(size=60), rng.normal(size=60), np.ones(60), np.arange(60) % 5, "m")
    assert not noise.skilled
    assert first_choice(proposed([1.0, 2.0, 3.0], [0.1] * 3, noise), near) is None


def test_columns_beside_proposals_are_in_the_targets_sign():
    """Costs that are to be small, with replicates: rows are counted as the table has them."""
    a = np.repeat(np.arange(12.0), 2)
    frame = {"a": a, "distance": np.zeros(24), "cost": 10 - a + np.tile([-0.1, 0.1], 12)}
    with pytest.warns(UserWarning, match="pooled"):
        data = Designs.from_frame(frame, "cost", minimise=True)
    made = Proposals("m", np.array([[5.1, 0.0], [11.0, 0.0]]), np.array([-4.0, 1.0]), np.array([1.0, 2.0]), 0)
    more = added_columns(data, made)
    assert list(more) == [
        "predicted", "predicted_std", "predicted_low", "predicted_high", "distance_", "nearest_row", "nearest_score",
    ]  # fmt: skip
    assert more["predicted"] == [4.0, -1.0]
    assert more["predicted_low"] == pytest.approx([4 - 1.959964, -1 - 2 * 1.959964], rel=1e-5)
    assert more["predicted_high"] == pytest.approx([4 + 1.959964, -1 + 2 * 1.959964], rel=1e-5)
    assert more["nearest_row"] == [10, 22]
    assert more["nearest_score"] == [5.0, -1.0]
    np.testing.assert_array_equal(data.part(np.arange(12)[::-1]).numbered(np.array([8, 11])), [6, 0])
    low, high = shown_interval(data, np.zeros(2), None)
    assert np.isnan([low, high]).all()
    said = about(data, made)
    assert said["value"][said["what"].index("target")] == "cost, to be made small"


def test_predictions_are_written_with_six_digits_and_scores_without_the_noise_of_sums():
    third = 200 / 3
    assert rounded(np.array([third, 0.0, np.nan, 1e-9 / 3]), 5.0)[:2] == [66.6667, 0.0]
    assert rounded(np.array([-1e-9 / 3]), 5.0) == [-3.33333e-10]
    assert rounded(np.array([1064.00123456]), 1e-3) == [1064.001235]  # scores that differ by little beside their size
    a = np.arange(12.0)
    data = Designs.from_frame({"a": a, "y": a + 0.1 + 0.2}, "y")  # 0.1 + 0.2 is 0.30000000000000004
    made = Proposals("m", np.array([[0.2]], np.float32), np.array([third]), np.array([third]), 0)
    more = added_columns(data, made)
    assert more["nearest_score"] == [0.3]
    assert more["predicted"] == more["predicted_std"] == [66.6667]
    assert len(str(more["distance"][0])) <= 8


def test_levels_that_are_numbers_count_in_sums_by_their_values():
    rng = np.random.default_rng(0)
    level = np.array([10, 20, 50] * 8)
    data = Designs.from_frame({"lv": level, "a": 100.0 - level, "b": rng.uniform(size=24), "y": rng.normal(size=24)}, "y",
                              kinds={"lv": "ordinal"}, constraints=["a + lv = 100"], bounds={"a": (0, 100)})  # fmt: skip
    assert data.noticed == ()
    assert effects.allowed(data, data.x).all()
    assert effects.with_value(data, data.x, 0, 2.0)[:, 1].tolist() == [50.0] * 24
    assert not effects.allowed(data, data.x + np.array([0, 1, 0])).any()


@pytest.mark.filterwarnings("ignore:frame")
def test_sums_and_relations_of_a_table_count_levels_by_their_values_too():
    rng = np.random.default_rng(0)
    level, y = np.array([10, 20, 50] * 8), rng.normal(size=24)
    by_value, by_index = (
        {"lv": level, "a": 100.0 - other, "b": rng.uniform(size=24), "y": y} for other in (level, np.array([0, 1, 2] * 8))
    )
    kinds, bounds = {"lv": "ordinal"}, {"a": (0, 100)}
    [line] = Designs.from_frame(by_index, "y", kinds=kinds, bounds=bounds, constraints=["a + lv = 100"]).noticed
    assert line.startswith("a + lv = 100 does not hold in 24 of 24 rows, where the sum is 110 to 148 instead of 100")
    [line] = Designs.from_frame(by_value, "y", kinds=kinds, bounds=bounds).noticed
    assert line.startswith("lv and a satisfy a linear relation in every row")
    assert Designs.from_frame(by_index, "y", kinds=kinds, bounds=bounds).noticed == ()
    with pytest.raises(UserError, match=r"in the data they sum to 100, so say --constraints 'lv \+ a = 100' instead"):
        Designs.from_frame(by_value, "y", kinds=kinds, mixtures=[["lv", "a"]])


@pytest.mark.parametrize("unit", [1.0, 1e-7, 1e6])
def test_rules_count_in_any_unit(unit):
    """Which rows satisfy them does not depend on whether amounts are in moles or in nanomoles."""
    a, b = np.linspace(1, 20, 20), np.tile([1.0, 2.0, 4.0, 8.0], 5)
    frame = {"a": (a * unit).astype(np.float32), "b": (b * unit).astype(np.float32), "y": a}
    data = Designs.from_frame(frame, "y", constraints=[f"a + b <= {10 * unit!r}"])
    np.testing.assert_array_equal(effects.keeping(data), a + b <= 10)
    assert effects.best_permitted(data) == np.flatnonzero(a + b <= 10)[-1]
    data = Designs.from_frame(frame, "y", fixed=[f"b = {4 * unit!r}"])
    np.testing.assert_array_equal(effects.keeping(data), b == 4)
    assert [broken_rule(data, i) is None for i in range(20)] == (b == 4).tolist()
    assert [data.rules.broken(data.variables, row) is None for row in written(data.variables, data.x)] == (b == 4).tolist()
    assert designer("best").propose(data, 5).x[:, 1] == pytest.approx(4 * unit)
    made = designer("random").propose(data, 3)  # what is fixed is so exactly
    np.testing.assert_array_equal(made.x[:, 1], np.float32(4 * unit))
