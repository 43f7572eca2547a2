"""What is said of a model out of fold, where the table is an awkward one."""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from scipy.cluster.hierarchy import fcluster
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import cdist

from deadreckon.errors import UserError
from deadreckon.mbo import designer
from deadreckon.mbo.auto import standard_error
from deadreckon.mbo.calibration import Calibration, conformal_factor
from deadreckon.mbo.designer import DesignInput, Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.first_choice import interval
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.forward import Forward, on_held_out
from deadreckon.mbo.front import propose_front
from deadreckon.mbo.gp import GP
from deadreckon.mbo.proposal_table import about, about_front
from deadreckon.mbo.replicates import _joined, units_told
from deadreckon.mbo.validation import checkable, judged
from deadreckon.mbo.variables import Variable
from deadreckon.report.design_advice import rule_note
from deadreckon.report.design_front import _observed
from deadreckon.stats.interval import NORMAL
from tests.mbo.practice import hill

AB = (Variable("a", low=0.0, high=1.0), Variable("b", low=0.0, high=1.0))


def table(rows=40, scale=1.0):
    rng = np.random.default_rng(0)
    x = rng.uniform(size=(rows, 2))
    return Designs(x, scale * (np.sin(3 * x[:, 0]) + x[:, 1] + 0.1 * rng.standard_normal(rows)), AB)


def test_the_unit_of_the_scores_does_not_matter():
    """Femtofarads or farads: deviations of 1e-12 and less were cut off, and held 0 % of new scores."""
    one, tiny = (designer("gp", rounds=5).propose(table(scale=scale), 4, validate=True) for scale in (1.0, 1e-15))
    assert tiny.quality.r2 == pytest.approx(one.quality.r2, abs=0.02)
    assert tiny.quality.coverage == pytest.approx(one.quality.coverage, abs=0.03)
    assert tiny.predicted_std.mean() == pytest.approx(1e-15 * one.predicted_std.mean(), rel=0.1, abs=0.0)


@pytest.mark.filterwarnings("ignore:.*replicate")
def test_replicates_of_few_designs_are_not_taken_for_rows_that_the_model_has_not_seen():
    """Their means are noise, which a model that has seen one of four replicates knows: R2 was 0.9."""
    rng = np.random.default_rng(0)
    x = np.repeat(rng.uniform(size=(8, 2)), 4, axis=0)
    y = np.repeat(rng.standard_normal(8), 4) + 0.1 * rng.standard_normal(32)
    made = designer("gp", rounds=5).propose(Designs(x, y, AB), 3, validate=True)
    assert made.quality is None
    assert "was not tested" in made.warning
    # Nor of many, where they were not pooled: those of a design lay in different folds.
    many = np.repeat(rng.uniform(size=(25, 2)), 4, axis=0)
    assert not checkable(Designs(many, np.repeat(rng.standard_normal(25), 4) + 0.1 * rng.standard_normal(100), AB))
    assert checkable(table(25))
    assert designer("random").propose(Designs(x, y, AB), 3).warning is None  # predicts nothing


@pytest.mark.parametrize("where", ["held out", "learned from"])
def test_one_score_that_differs_is_no_reason_to_stop(where):
    """Wherever it falls: what is left of the scores is flat."""
    data = table(60)
    setting = DesignInput(data, 4, [0], None, lambda what, step, steps: None)
    order = np.random.default_rng(0)  # any table will do of which the one row lies on either side
    found = {}
    for row in order.permutation(60):
        rare = Designs(data.x, (np.arange(60) == row).astype(float), AB)
        with np.errstate(divide="raise", invalid="raise"):
            quality = on_held_out(GP(), setting._replace(data=rare))
        found["held out" if quality.observed.any() else "learned from"] = quality
        if where in found:
            break
    assert found[where].r2 <= 0.05
    assert not found[where].skilled
    assert "R2" in str(found[where])


def test_scores_whose_squares_overflow_are_refused():
    with pytest.raises(UserError, match=r"y is 1e\+200 in row 3, and may be 1e\+150 at most"):
        Designs(table().x, np.where(np.arange(40) == 3, 1e200, 0.0), AB)


def test_intervals_are_said_to_be_of_what_they_are_of():
    """A measurement's, but for gp-bo's, which are of the true score."""
    told = {}
    for name, fields in (("gp", {"rounds": 5}), ("gp-bo", {"ascent_steps": 5})):
        made = designer(name, **fields).propose(table(), 3)
        lines = about(table(), made)
        told[name] = dict(zip(lines["what"], lines["value"]))["predicted_low, predicted_high"], str(rule_note(made))
    assert all("of a new measurement, noise included" in text for text in told["gp"])
    assert all("of the true score, without a measurement" in text for text in told["gp-bo"])


@pytest.mark.parametrize("objective", ["mean", "min"])
def test_an_ensemble_is_judged_by_what_it_predicts(objective):
    """The least of the members' predictions is below their mean, out of fold too."""
    method = Forward(members=3, objective=objective, hidden=(16,), steps=60)
    setting = DesignInput(table(60), 4, [0], None, lambda what, step, steps: None)
    nets_mean = method.replace(objective="mean").unseen(setting, table(60).x[:20], None)[0]
    found = method.unseen(setting, table(60).x[:20], None)[0]
    assert (found < nets_mean).all() == (objective == "min")


def test_a_method_that_is_fitted_once_holds_out_enough_to_calibrate_by():
    """Of 45 rows a fifth is 9, of which none holds 95 %."""
    setting = DesignInput(table(45), 4, [0], None, lambda what, step, steps: None)
    assert len(on_held_out(Forward(hidden=(8,), steps=20), setting).observed) == 20
    few = Forward(hidden=(8,), steps=20, ascent_steps=5).propose(table(39), 3, validate=True)
    assert few.quality is None


@pytest.mark.filterwarnings("ignore:.*are pooled")
def test_what_was_not_tested_is_told_of_several_targets_and_in_spreadsheets_too():
    rng = np.random.default_rng(0)
    a = np.repeat(rng.uniform(size=10), 2)
    frame = {"a": a, "y": rng.normal(size=20), "z": rng.normal(size=20)}
    front = propose_front([Designs.from_frame(frame, target, ignore=(other,)) for target, other in ("yz", "zy")], 2)
    assert [line.partition(":")[0] for line in front.warnings] == ["y", "z"]
    assert all("was not tested" in line for line in front.warnings)
    assert {"warning, y", "warning, z"} <= set(about_front(front)["what"])
    assert "warning" in about(front.data[0], front.made[0])["what"]
    shown = re.findall(r'scope="row">(\d+)<', str(_observed(front)))
    assert set(map(int, shown)) <= set(range(0, 20, 2))  # rows of the table, of which every other one is pooled
    assert max(map(int, shown)) > 9


# ---- models whose order may be chance ---------------------------------------------------------------------------------


def quality(observed, predicted, **more):
    """Of given predictions out of fold, none of them skilled unless it is said."""
    fold = np.arange(len(observed)) % 5
    return replace(judged(observed, predicted, np.ones(len(observed)), fold, "GP"), crossed=True, **more)


def test_what_predictions_out_of_fold_are_worth_is_their_regression():
    rng = np.random.default_rng(0)
    m = rng.normal(size=30)
    y = 5.0 + 0.6 * m + 0.5 * rng.normal(size=30)
    line = scipy.stats.linregress(m, y)
    found = quality(y, m).calibration
    assert (found.a, found.b) == pytest.approx((line.intercept, line.slope))
    wrong = quality(y, -m).calibration
    assert (wrong.a, wrong.b) == (pytest.approx(y.mean()), 0.0)  # a false order is worth nothing
    assert quality(5.0 * m, m).calibration.b == 1.0  # nor does it widen predictions
    flat = quality(y, np.full(30, 0.1)).calibration
    assert (flat.a, flat.b) == (pytest.approx(y.mean()), 0.0)
    # Rows that vary more count less, by their variances.
    std = np.where(np.arange(30) % 3, 1.0, 4.0)
    rough = y + np.where(np.arange(30) % 3, 0.0, 3.0 * m)
    found = Calibration.of(rough, m, std, skilled=True)
    slope, intercept = np.polyfit(m, rough, 1, w=1 / std)
    assert (found.a, found.b) == (pytest.approx(intercept), pytest.approx(slope))


def test_half_of_a_skilled_models_own_variance_counts():
    rng = np.random.default_rng(0)
    std = rng.uniform(0.5, 1.5, 200)
    m = 3.0 * rng.normal(size=200)
    y = m + 1.0 * std * rng.normal(size=200)
    found = Calibration.of(y, 0.9 * m, std, skilled=True)
    mean, width = found(0.9 * m, std)
    assert found.b == 1.0
    error, weight = y - mean, 1 / std**2
    error /= 1 - weight / weight.sum()  # as if the intercept had not seen it
    usual = (weight / len(weight)).sum() ** -0.5  # the harmonic mean, above which its own counts in full
    half = np.sqrt((np.square(std) + usual**2) / 2)
    np.testing.assert_allclose(width / np.maximum(half, std), (width / np.maximum(half, std))[0])
    width = width / np.maximum(half, std) * half
    # 191 is ceil(0.95 x 201): the correction for few rows.
    assert (np.abs(error) <= 1.959964 * width * (1 + 1e-9)).sum() == 191
    assert np.ptp(Calibration.of(y, m, std, skilled=False)(m, std)[1]) == 0


def test_errors_are_those_of_a_regression_that_has_not_seen_the_row():
    rng = np.random.default_rng(0)
    m = rng.normal(size=15)
    y = 0.7 * m + rng.normal(size=15)
    found = Calibration.of(y, m, np.ones(15), skilled=False)
    assert 0 < found.b < 1
    left = []
    for i in range(15):
        slope, intercept = np.polyfit(np.delete(m, i), np.delete(y, i), 1)
        left.append(abs(y[i] - intercept - slope * m[i]))
    assert 1.959964 * found.scatter == pytest.approx(max(left))  # of 15 rows the greatest error


def test_a_model_without_skill_keeps_what_its_predictions_were_worth():
    rng = np.random.default_rng(1)
    noise = quality(60.0 + 8.0 * rng.normal(size=40), 60.0 + rng.normal(size=40))
    assert not noise.skilled
    worth = noise.calibration
    assert worth.scale == 0.0
    x = np.zeros((3, 2), np.float32)
    averages = lambda x: (np.full(x.shape[:2], 76.0), np.eye(len(x)))  # noqa: E731
    fitted = Fitted(lambda x: (np.full(len(x), 76.0), np.full(len(x), 0.5)), averages)
    made = Proposals("GP", x, np.full(3, 76.0), np.full(3, 0.5), 0, fitted=fitted, mean_std=np.full(3, 0.3))
    found = made.calibrated(noise)
    assert found.predicted == pytest.approx(worth.a + 76.0 * worth.b)
    assert found.predicted_std == pytest.approx(worth.scatter)
    assert found.mean_std == pytest.approx(0.6 * worth.scatter)  # a true score's deviation is multiplied as that of a row is
    assert found.fitted.predict(x)[0] == pytest.approx(worth.a + 76.0 * worth.b)
    assert found.fitted.predict(x)[1] == pytest.approx(worth.scatter)
    mean, covariance = found.fitted.average(np.zeros((2, 3, 2)))
    assert mean == pytest.approx(worth.a + 76.0 * worth.b)
    assert covariance is None  # how sure it is of an average is nothing that it knows
    # One measurement varies more than pooled rows, of which the model knows the noise.
    single = replace(made, predicted_std=np.full(3, 1.3), beyond=1.2).calibrated(noise)
    assert single.predicted_std == pytest.approx(np.hypot(worth.scatter, 1.2))
    assert single.mean_std == pytest.approx(0.3 * worth.scatter / 0.5)
    assert single.fitted.beyond == 1.2


def test_an_order_whose_predictions_do_not_go_with_the_scores_is_none():
    m = np.arange(40.0)
    y = m.copy()
    y[0] = 1e4  # a slip
    found = quality(y, m)
    assert found.rank_correlation > found.limit
    assert not found.skilled
    assert "one score may be an error" in found.warning


def test_predictions_of_scores_most_of_which_are_nothing_are_no_chance():
    """Where most scores are about 0, as of experiments that fail, their order is noise however well they are predicted."""
    rng = np.random.default_rng(0)
    y = np.where(np.arange(40) % 5 == 0, np.arange(40.0), 0.0) + 0.1 * rng.standard_normal(40)
    m = np.where(np.arange(40) % 5 == 0, np.arange(40.0), 0.0) + 0.1 * rng.standard_normal(40)
    found = quality(y, m)
    assert found.rank_correlation < found.limit
    assert found.skilled
    assert found.warning is None
    assert not any(quality(y, m[rng.permutation(40)]).skilled for _ in range(200))


def test_intervals_hold_new_measurements_of_what_is_proposed_from_much_noise():
    """Of the best of many predictions more is luck the more noise there is, of models that rank well enough too."""
    inside = []
    for seed in (2007, 2001, 2008):  # of `benchmarks/noise_levels.py`; the model's own deviations hold 6 to 12 % there
        rng = np.random.default_rng(seed)
        rows, inputs = (40, 3) if seed == 2001 else (60, 6)
        scores, x = hill(rng, inputs), rng.uniform(size=(rows, inputs))
        variables = [Variable(f"x{i}", low=0.0, high=1.0) for i in range(inputs)]
        made = GP(rounds=10).propose(Designs.from_arrays(x, scores(x) + rng.standard_normal(rows), variables), 4)
        assert made.quality.skilled
        assert made.quality.calibration.b < 0.8
        low, high = interval(made.predicted, made.predicted_std)
        true = scores(made.x.astype(float))
        inside.append((scipy.stats.norm.cdf(high - true) - scipy.stats.norm.cdf(low - true)).mean())
    assert np.mean(inside) > 0.6


def test_intervals_hold_new_measurements_of_what_is_proposed_from_noise():
    """The process is surest beside rows it has seen, and proposes what lies beside those that were lucky."""
    shares = []
    for seed in (1000, 1001):
        rng = np.random.default_rng(seed)
        variables = [Variable(f"x{i}", low=0.0, high=1.0) for i in range(4)]
        made = GP().propose(Designs.from_arrays(rng.uniform(size=(40, 4)), 60.0 + 8.0 * rng.normal(size=40), variables), 4)
        low, high = interval(made.predicted, made.predicted_std)
        shares.append((scipy.stats.norm.cdf(high, 60.0, 8.0) - scipy.stats.norm.cdf(low, 60.0, 8.0)).mean())
    assert min(shares) > 0.8


def nearly_repeated(recipes=15, repeats=4, jitter=1e-3, seed=0):
    """Recipes whose settings are logged with an instrument's noise, and whose scores have nothing to do with them."""
    rng = np.random.default_rng(seed)
    x = np.repeat(rng.uniform(size=(recipes, 2)), repeats, axis=0)
    x += jitter * rng.standard_normal(x.shape)
    y = np.repeat(rng.standard_normal(recipes), repeats) + 0.1 * rng.standard_normal(len(x))
    return Designs(x, y, AB)


def test_rows_of_a_recipe_lie_in_one_fold_though_their_settings_differ_slightly():
    data = nearly_repeated()
    np.testing.assert_array_equal(data.recipes, np.repeat(np.arange(15), 4))
    quality = designer("gp", rounds=5).propose(data, 3, validate=True).quality
    np.testing.assert_array_equal(quality.units, data.recipes)
    assert all(len(set(quality.fold[data.recipes == k])) == 1 for k in range(15))
    assert not quality.skilled  # R2 was 0.97
    assert quality.limit > 0.6  # of 15 and not of 60
    assert checkable(data)
    assert not checkable(nearly_repeated(8))


@pytest.mark.parametrize("kind", ["uniform", "grid", "one number and a category", "walk", "steps", "clusters"])
def test_designs_that_are_spread_otherwise_are_recipes_of_their_own(kind):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        spread, level = rng.uniform(size=(60, 2)), rng.integers(0, 3, 60)
        x = {
            "uniform": spread, "grid": np.indices((6, 10)).reshape(2, -1).T * [0.001, 1.0],
            "one number and a category": np.stack([spread[:, 0], level], 1), "walk": np.cumsum(spread - 0.5, 0),
            "steps": np.unique(np.stack([rng.integers(0, 400, 60), level], 1), axis=0),
            "clusters": np.repeat(spread[:6], 10, 0) + 0.05 * rng.standard_normal((60, 2)),
        }[kind]  # fmt: skip
        letter = Variable("b", "categorical", levels=("x", "y", "z"))
        variables = (Variable("a"), letter if kind == "one number and a category" else Variable("b"))
        data = Designs(x, rng.standard_normal(len(x)), variables)
        np.testing.assert_array_equal(data.recipes, np.arange(len(x)))


def test_the_tree_that_joins_designs_is_minimal():
    rng = np.random.default_rng(0)
    for z in (rng.normal(size=(60, 3)), rng.integers(0, 9, (60, 2)).astype(float), nearly_repeated().x.astype(float)):
        distance, tree = _joined(z)
        np.testing.assert_array_equal(distance, cdist(z, z))
        least = minimum_spanning_tree(distance).tocoo()
        np.testing.assert_array_equal(tree[:, 2], np.sort(least.data))
        assert fcluster(tree, tree[-1, 2], "distance").max() == 1
        for height in tree[[5, 20, 40], 2]:  # what is joined up to a distance are the tree's components
            near = least.data <= height
            parts = connected_components(coo_matrix((least.data[near], (least.row[near], least.col[near])), distance.shape))[1]
            group = fcluster(tree, height, "distance")
            np.testing.assert_array_equal(group[:, None] == group, parts[:, None] == parts)


def test_scores_that_are_equal_to_the_last_digit_are_told():
    """Each row twice, with another value of an input that means nothing: a model predicts one of the two from the other."""
    rng = np.random.default_rng(0)
    y, x = rng.normal(size=40), rng.uniform(size=(80, 2))
    x[:, 0] = np.repeat(rng.uniform(size=40), 2)
    for scores, told in (
        (np.repeat(y, 2), True), (rng.normal(size=80), False), (rng.normal(size=80).round(1), False),
        (np.where(rng.random(80) < 0.5, 0.0, rng.normal(size=80)), False), (np.repeat(y, 2).round(3), True),
        (100.0 * rng.integers(0, 600, 80), False), (0.25 * rng.integers(0, 90, 80), False),
    ):  # fmt: skip
        assert any("have exactly the score of another one" in line for line in units_told(Designs(x, scores, AB), None)) is told


def test_a_table_of_recipes_says_so():
    data = nearly_repeated()
    frame = {"a": data.x[:, 0], "b": data.x[:, 1], "y": data.y}
    with pytest.warns(UserWarning, match="60 different designs are 15 recipes whose settings differ slightly"):
        read = Designs.from_frame(frame, "y")
    assert any("15 recipes" in line for line in read.noticed)


def test_a_row_far_away_and_two_regions_are_no_recipes():
    rng = np.random.default_rng(0)
    far = np.append(rng.uniform(42, 110, 14).round(1), 900.0)
    two = np.concatenate([rng.uniform(0, 1, 15), rng.uniform(1e4, 1e4 + 1, 15)])
    for x in (far, two):
        data = Designs(x[:, None], rng.standard_normal(len(x)), (Variable("a"),))
        np.testing.assert_array_equal(data.recipes, np.arange(len(x)))


def test_what_is_independent_are_recipes():
    """Of 20 recipes of ten rows the greatest error counts, as of 20 rows; and the order of two methods is as uncertain."""
    error = np.random.default_rng(0).uniform(size=200)
    assert conformal_factor(error, independent=20) == error.max() / NORMAL
    assert conformal_factor(error) < error.max() / NORMAL
    codes = np.repeat(np.arange(20), 10)
    rng = np.random.default_rng(1)
    y, a, b = (np.repeat(rng.standard_normal(20), 10) for _ in range(3))
    assert standard_error(y, a, b, codes) > 2 * standard_error(y, a, b)
