"""The Gaussian process for tables, its batch, and what is said of it out of fold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import check_grad

from deadreckon.errors import UserError
from deadreckon.mbo import designer, process
from deadreckon.mbo.batch import check_batch, keys
from deadreckon.mbo.calibration import conformal_factor
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.gp import greedy
from deadreckon.mbo.local_search import spaced
from deadreckon.mbo.replicates import row_weights
from deadreckon.mbo.validation import CHANCE, cross_validated, judged
from deadreckon.mbo.variables import Variable
from tests.mbo.practice import TABLES

pytestmark = pytest.mark.filterwarnings("ignore:.*are pooled")


def test_the_gradient_of_the_likelihood_is_that_of_its_value():
    data = TABLES["mixed"](40).designs()
    features = process.Features.of(data)
    y = (data.y - data.y.mean()) / data.y.std()
    ratio = np.linspace(0.5, 1.5, len(y))
    of = (features(data.x), y, ratio, features.owner, np.zeros(6), np.full(6, 2.0))
    at = np.array([1.0, 0.5, 0.8, 1.2, 0.1, -2.0])
    error = check_grad(lambda v: process._loss(v, *of)[0], lambda v: process._loss(v, *of)[1], at)
    assert error < 1e-4


def test_the_posterior_is_the_textbook_s():
    """Against the formulas written out, with noise that differs between rows and a category."""
    rng = np.random.default_rng(0)
    x = np.stack([rng.uniform(-1, 1, 12), rng.integers(0, 3, 12)], 1)
    variables = (Variable("a", low=-1, high=1), Variable("c", "categorical", levels=tuple("xyz")))
    error = rng.uniform(0.1, 0.3, 12)
    data = Designs(x, rng.normal(size=12), variables, std_error=error)
    found = process.fit(data)
    length, new = np.exp(found.hyper.lengths), np.array([[0.3, 1.0], [2.0, 2.0]])

    def kernel(a, b):
        number = (a[:, None, 0] - b[None, :, 0]) / data.x[:, 0].std() / length[0]
        r = np.sqrt(5 * (number**2 + (a[:, None, 1] != b[None, :, 1]) / length[1] ** 2))
        return np.exp(found.hyper.signal) * (1 + r + r**2 / 3) * np.exp(-r)

    weight = row_weights(data)
    y_mean = np.average(data.y, weights=weight)
    y_std = np.average((data.y - y_mean) ** 2, weights=weight) ** 0.5
    noise = np.exp(found.hyper.noise) * error**2 / np.average(error**2, weights=weight)
    inverse = np.linalg.inv(kernel(data.x, data.x) + np.diag(noise))
    k = kernel(new, data.x)
    mean = y_mean + k @ inverse @ (data.y - y_mean)
    std = y_std * np.sqrt(np.exp(found.hyper.signal) - np.einsum("ij,jk,ik->i", k, inverse, k))
    np.testing.assert_allclose(found.posterior(new)[0], mean, rtol=1e-4)
    np.testing.assert_allclose(found.posterior(new)[1], std, rtol=1e-4)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance(new))) * y_std, std, rtol=1e-4)


def test_the_slope_is_that_of_the_prediction():
    data = TABLES["wide"](40, variables=3 + 1).designs()
    found = process.fit(data)
    x, away = data.x[:3].astype(np.float64) * 0.9, np.array([0.0, 0.0, 1e-2, 0.0])
    value = lambda x: (found.posterior(x)[0] + 0.7 * found.posterior(x)[1]) / found.y_std  # noqa: E731
    change = (value(x + away) - value(x - away)) / 2e-2 * data.coordinates.std[2]
    np.testing.assert_allclose(found.slope(x, 0.7)[:, 2], change, rtol=2e-3, atol=1e-4)


def test_measurements_that_are_repeated_count_more():
    frame = {"a": [0.0, 1.0, *np.linspace(2, 9, 10)], "y": [3.0, -3.0, *[0.0, 1.0] * 5], "se": [0.01, 3.0, *[1.0] * 10]}
    data = Designs.from_frame(frame, "y", std_error="se")
    mean = process.fit(data).mean(data.x[:2])
    assert abs(mean[0] - 3.0) < 0.01
    assert abs(mean[1] + 3.0) > 0.1


def test_one_row_with_a_very_large_error_leaves_the_fit_to_the_others():
    """Its ratio to the mean of all squared errors was the noise of the others: none."""
    rng = np.random.default_rng(0)
    x, error = rng.uniform(-1, 1, (50, 2)), np.where(np.arange(50) == 7, 300.0, 0.3)
    data = Designs.from_frame(
        {"a": x[:, 0], "b": x[:, 1], "y": x.sum(1) + error * rng.standard_normal(50), "se": error}, "y", std_error="se"
    )
    without = process.fit(data.part(np.arange(50) != 7))
    found = process.fit(data)
    assert found.noise == pytest.approx(without.noise, rel=0.1)
    assert found.y_std == pytest.approx(without.y_std, rel=0.05)
    new = rng.uniform(-1, 1, (50, 2))
    assert np.abs(found.mean(new) - without.mean(new)).max() < 0.1
    quality = cross_validated(data, designer("gp").predictor, "GP")
    assert quality.r2 > 0.7
    assert quality.skilled


def test_rows_count_by_their_errors_beside_the_spread_of_the_scores():
    y, error = np.array([1.0, -1.0] * 10 + [500.0]), np.array([1e-3, *[0.5] * 19, 500.0])
    data = Designs(np.arange(21)[:, None], y, (Variable("a", low=0, high=20),), std_error=error)
    weight = row_weights(data)
    v = np.average((y - np.average(y, weights=weight)) ** 2, weights=weight)
    np.testing.assert_allclose(weight, (v / (v + error**2)) ** 2)
    assert v == pytest.approx(1.0, rel=0.05)
    large = row_weights(replace(data, std_error=1e3 * error))  # none counts more than four times as much as a usual one
    assert large.max() / np.median(large) == pytest.approx(4.0, rel=1e-3)
    np.testing.assert_array_equal(row_weights(replace(data, std_error=None)), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_proposals_of_the_default_are_within_the_rules_and_better_than_the_data(name):
    table = TABLES[name]()
    data = table.designs()
    made = designer("gp", rounds=15).propose(data, 12)
    check_batch(data, made.x, repeat=False)
    assert len(set(keys(data, made.x))) == 12
    allowed = data.x[data.repair.good(data.x)]  # mixtures and constraints leave out some of the data, or all of it
    best = table.true(data, allowed).max() if len(allowed) else -np.inf
    true = table.true(data, made.x)
    assert true.max() >= best
    assert np.median(true) >= np.median(table.true(data, designer("random").propose(data, 12).x))
    assert made.quality.rank_correlation > 0.8
    assert 0.9 <= made.quality.coverage <= 1.0


def test_intervals_are_for_one_new_measurement():
    """Calibrated is what was calibrated: deviations with noise, that of one measurement where rows are means of several."""
    rng = np.random.default_rng(0)
    x = np.repeat(rng.uniform(-1, 1, (60, 1)), np.arange(60) % 3 + 1, 0)
    data = Designs.from_frame({"x": x[:, 0], "y": 2 * x[:, 0] + 0.5 * rng.standard_normal(len(x))}, "y")
    found = process.fit(data)
    assert found.noise == pytest.approx(0.5, rel=0.15)
    row = found.y_std * np.exp(0.5 * found.hyper.noise)  # of the noise of a usual row, a mean of some measurements
    weight = row_weights(data)
    usual = np.average(np.square(data.std_error), weights=weight) ** 0.5
    np.testing.assert_allclose(found.noise_of(data.std_error), row * data.std_error / usual, rtol=1e-6)
    scatter = data.std_error[0] * data.replicates[0] ** 0.5  # between replicates
    assert found.beyond == pytest.approx(scatter * (1 - np.average(1 / data.replicates, weights=weight)) ** 0.5)
    made = designer("gp", rounds=5).propose(data, 30)
    mean, std = found.posterior(made.x)
    assert found.noise**2 == pytest.approx(row**2 + found.beyond**2)
    expected, width = made.quality.calibration(mean, np.hypot(std, row))
    np.testing.assert_allclose(made.predicted, expected, rtol=1e-6)
    np.testing.assert_allclose(made.predicted_std, np.hypot(width, found.beyond), rtol=1e-6)
    np.testing.assert_allclose(made.mean_std / std, width / np.hypot(std, row), rtol=1e-6)
    np.testing.assert_allclose(made.fitted.predict(made.x), [made.predicted, made.predicted_std], rtol=1e-4)
    measured = 2 * made.x[:, 0] + 0.5 * rng.standard_normal((200, 30))
    assert 0.9 <= (np.abs(measured - made.predicted) <= 1.96 * made.predicted_std).mean() <= 0.99


def test_a_row_out_of_fold_is_judged_by_its_own_noise():
    rng = np.random.default_rng(0)
    error = np.where(np.arange(80) % 2, 0.1, 2.0)
    x = rng.uniform(-1, 1, 80)
    data = Designs.from_frame({"x": x, "y": 3 * x + error * rng.standard_normal(80), "se": error}, "y", std_error="se")
    found = cross_validated(data, designer("gp").predictor, "GP")
    assert np.median(found.std[::2]) > 5 * np.median(found.std[1::2])
    scaled = np.abs(found.observed - found.predicted) / found.std
    assert 0.5 < np.median(scaled[::2]) / np.median(scaled[1::2]) < 2


@pytest.mark.slow
def test_of_noise_no_skill_is_claimed():
    """At most one table in forty is taken for more than noise on average; of these four none is."""
    praised = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        data = Designs.from_arrays(rng.normal(size=(60, 3)), rng.normal(size=60))
        quality = cross_validated(data, designer("gp").predictor, "GP")
        assert quality.r2 < 0.1
        assert 0.85 <= quality.coverage <= 1.0
        praised += quality.skilled
        assert (quality.warning is None) == quality.skilled
    assert praised == 0
    data = TABLES["wide"](60, variables=6).designs()
    assert cross_validated(data, designer("gp").predictor, "GP").skilled


def test_what_is_used_for_its_scores_does_not_calibrate():
    """Of many rows of noise the best half of those that are used lies above 0 by luck; new ones do not."""
    rng = np.random.default_rng(0)
    variables = [Variable(name, low=-2, high=2) for name in "ab"]
    data = Designs.from_arrays(rng.uniform(-2, 2, (3000, 2)), rng.standard_normal(3000), variables)
    method = designer("gp", max_rows=60, rounds=2)
    assert method.used(data).y.mean() > 0.8
    made, plain = method.propose(data, 4), method.replace(folds=0).propose(data, 4)
    np.testing.assert_array_equal(made.x, plain.x)
    assert plain.predicted.min() > 0.5
    assert np.abs(made.predicted).max() < 0.3
    assert len(made.quality.observed) == 600
    assert made.by_chance
    new = rng.standard_normal((1000, 1))
    assert (np.abs(new - made.predicted) <= 1.96 * made.predicted_std).mean() > 0.9


def test_of_many_rows_with_few_low_scores_some_of_these_are_used():
    """Else all that is used would have the same score, and the table would be refused for that."""
    rng = np.random.default_rng(0)
    y = -np.isin(np.arange(400), [5, 77]).astype(float)
    data = Designs.from_arrays(rng.uniform(-2, 2, (400, 2)), y)
    method = designer("gp", max_rows=20, fit_rows=20, rounds=1, folds=0)
    assert sorted(method.used(data).y)[:3] == [-1, -1, 0]
    assert len(method.propose(data, 2)) == 2
    # Where the rows that are drawn differ, they are the ones.
    spread = data.best_and_others(20, np.random.default_rng(1))
    other = Designs.from_arrays(data.x, np.arange(400.0)).best_and_others(20, np.random.default_rng(1))
    np.testing.assert_array_equal(other[:10], np.arange(399, 389, -1))
    np.testing.assert_array_equal(other[10:], np.random.default_rng(1).choice(np.arange(389, -1, -1), 10, replace=False))
    assert len(spread) == len(set(spread.tolist())) == 20
    np.testing.assert_array_equal(data.best_and_others(400, rng), data.best(400))


def test_settings_of_the_process_that_test_nothing_are_refused():
    """A single fold was none at all, and too few rows were said to be those of the table."""
    data = Designs.from_arrays(np.arange(60.0)[:, None], np.arange(60.0))
    with pytest.raises(UserError, match=r"GP.folds must be 0, for no cross-validation, or 2 or more, got 1"):
        designer("gp", folds=1).propose(data, 3)
    with pytest.raises(UserError, match=r"GP.max_rows takes a whole number >= 10, got 8"):
        designer("gp", max_rows=8).propose(data, 3)


def test_of_tables_without_any_relation_few_pass_for_some():
    """At most the share that is promised, of a model that fits noise well: pairs of rows that agree by chance count twice."""

    def ridge(data):
        x = np.c_[np.ones(len(data)), data.x]
        weight = np.linalg.solve(x.T @ x + 1e-6 * np.eye(x.shape[1]), x.T @ data.y)
        return lambda new, error: (np.c_[np.ones(len(new)), new] @ weight, np.ones(len(new)))

    rng, praised = np.random.default_rng(0), 0
    for _ in range(200):
        data = Designs.from_arrays(rng.uniform(size=(40, 15)), rng.standard_normal(40))
        praised += cross_validated(data, ridge, "ridge").skilled
    assert praised <= CHANCE * 200


def test_the_factor_is_the_quantile_with_its_correction():
    error = np.arange(1.0, 41.0)
    assert conformal_factor(error) == pytest.approx(39 / 1.959964)  # ceil(41 x 0.95) = 39
    assert conformal_factor(error[:10]) == pytest.approx(10 / 1.959964)  # too few: the greatest
    # Crosswise: a fold whose errors are all larger is outside the interval that the others give.
    fold, sign = np.repeat([0, 1], 20), np.tile([1.0, -1.0], 20)
    y = sign * np.concatenate([np.linspace(0.1, 0.2, 20), np.linspace(3, 4, 20)])
    found = judged(y, np.zeros(40), np.ones(40), fold, "m")
    assert found.coverage == 0.5


def test_caution_and_boldness():
    data = TABLES["replicated"]().designs()
    safe, bold = (designer("gp", kappa=kappa, folds=0).propose(data, 8) for kappa in (-2.0, 2.0))
    assert np.median(safe.predicted_std) < np.median(bold.predicted_std)
    assert safe.quality is None


def test_a_bold_batch_is_chosen_given_those_before():
    data = TABLES["wide"](30, variables=4).designs()
    found = process.fit(data)
    x = np.stack([data.x[0] * 3, data.x[0] * 3 + 1e-4, data.x[1] * -2.9])
    found_order = greedy(found, x, 50.0, 3)
    assert set(found_order[:2].tolist()) != {0, 1}  # the twin of the first knows no more


def test_designs_that_are_kept_lie_apart():
    data = TABLES["wide"](30, variables=4).designs()
    x = np.concatenate([data.x[:5], data.x[:5] + 1e-4])
    order = spaced(data, x, np.arange(10.0), 0.1, 10)
    assert sorted(order.tolist()) == [5, 6, 7, 8, 9]


@pytest.mark.slow
def test_networks_are_judged_on_designs_that_they_have_not_seen():
    data = TABLES["wide"](100, variables=4).designs()
    small = designer("forward", hidden=(16,), steps=300, lr=0.01, ascent_steps=5)
    made, plain = small.propose(data, 4, validate=True), small.propose(data, 4)
    assert len(made.quality.observed) == 20
    assert made.quality.rank_correlation > 0.5
    expected = made.quality.calibration(plain.predicted, plain.predicted_std)
    np.testing.assert_allclose([made.predicted, made.predicted_std], expected, rtol=1e-5)
    np.testing.assert_allclose(made.fitted.predict(made.x)[1], made.predicted_std, rtol=1e-4)
    assert plain.quality is None


def test_of_few_rows_each_is_left_out_by_itself():
    rng = np.random.default_rng(0)
    variables = [Variable(name, low=-3, high=3) for name in "ab"]
    data = Designs.from_arrays(rng.normal(size=(12, 2)), rng.normal(size=12), variables)
    made = designer("gp", rounds=5).propose(data, 3)
    assert len(set(made.quality.fold)) == 12
    assert made.by_chance
    assert designer("gp", rounds=5).propose(data.part(np.arange(10)), 3).quality is None
    with pytest.raises(UserError, match="kappa"):
        designer("gp", kappa=float("nan")).propose(data, 3)


@pytest.mark.slow
def test_intervals_of_replicated_rows_hold_single_measurements_of_strong_noise():
    """The scatter between replicates is known, also where the process takes noise for signal and believes in none."""
    held = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        x = np.repeat(rng.uniform(size=(30, 3)), 4, 0)
        columns = {f"x{i}": x[:, i] for i in range(3)}
        data = Designs.from_frame(columns | {"y": rng.standard_normal(len(x))}, "y")
        made = designer("gp", rounds=2).propose(data, 4)
        new = rng.standard_normal((200, 1))
        held.append((np.abs(new - made.predicted) <= 1.96 * made.predicted_std).mean())
    assert np.mean(held) > 0.87
