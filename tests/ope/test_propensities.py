"""Calibration of propensities: known scales are recovered, and a model that was fitted too long is made less sure."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.ope.propensities import calibration_error, gaussian_scale, temperature, vector_scaling


def log_softmax(z):
    return z - z.max(1, keepdims=True) - np.log(np.exp(z - z.max(1, keepdims=True)).sum(1, keepdims=True))


def drawn(logits, rng):
    edges = np.exp(log_softmax(logits)).cumsum(1)
    return (rng.random(len(logits))[:, None] >= edges[:, :-1]).sum(1)


def likelihood(logits, taken):
    return log_softmax(logits)[np.arange(len(taken)), taken].mean()


@pytest.mark.parametrize("true", [0.5, 1.0, 3.0])
def test_a_known_temperature_is_recovered(true):
    """Within four standard errors of 50,000 rows, and no other is likelier."""
    rng = np.random.default_rng(0)
    logits = 2.0 * rng.standard_normal((50_000, 4))
    taken = drawn(logits / true, rng)
    found = temperature(logits, taken)
    assert found == pytest.approx(true, rel=0.04)
    assert temperature(log_softmax(logits), taken) == pytest.approx(found)  # logits or log-probabilities
    best = likelihood(logits / found, taken)
    assert best >= max(likelihood(logits / (found * (1 + x)), taken) for x in (-0.01, 0.01))


def test_the_exact_optimum_of_two_actions():
    """Logits of log 4 either way, and three of four rows as said: odds of 3, so T = log 4 / log 3."""
    logits = np.array([[np.log(4), 0.0]] * 4)
    assert temperature(logits, np.array([0, 0, 0, 1])) == pytest.approx(np.log(4) / np.log(3))
    # An action that is excluded changes nothing.
    more = np.concatenate([logits, np.full((4, 1), -np.inf)], 1)
    assert temperature(more, np.array([0, 0, 0, 1])) == pytest.approx(np.log(4) / np.log(3))
    assert temperature(logits, np.zeros(4, int)) == 0.01  # all as said: the surer the better
    assert temperature(logits, np.ones(4, int)) == 100.0
    assert temperature(np.zeros((4, 2)), np.ones(4, int)) == 100.0  # says nothing at any temperature


def test_an_overfitted_model_is_too_sure():
    """Logistic regression on as many features as rows: out of fold T is far above one, and calibration improves."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(0)
    x = rng.standard_normal((1200, 100))
    taken = drawn(np.stack([0.7 * x[:, 0], np.zeros(1200)], 1), rng)
    fit, fold, test = np.split(np.arange(1200), [150, 650])
    sign = np.where(taken[fit] == 0, 1.0, -1.0)
    w = minimize(lambda w: np.logaddexp(0, -sign * (x[fit] @ w)).sum() + 0.05 * w @ w, np.zeros(100)).x
    logits = np.stack([x @ w, np.zeros(1200)], 1)
    t = temperature(logits[fold], taken[fold])
    assert t > 2.0
    assert temperature(logits[fit], taken[fit]) < 1.0  # what it was fitted to shows the opposite
    assert likelihood(logits[test] / t, taken[test]) > likelihood(logits[test], taken[test]) + 0.1
    before, after = (calibration_error(log_softmax(logits[test] / each), taken[test]) for each in (1.0, t))
    assert after < 0.5 * before


def test_vector_scaling_recovers_scales_and_shifts():
    rng = np.random.default_rng(1)
    logits = rng.standard_normal((30_000, 3))
    scale, shift = np.array([0.5, 1.0, 2.0]), np.array([0.3, -0.5, 0.2])
    taken = drawn(scale * logits + shift, rng)
    a, b = vector_scaling(logits, taken)
    assert a == pytest.approx(scale, abs=0.08)
    assert b - b.mean() == pytest.approx(shift - shift.mean(), abs=0.04)  # a shift of all changes nothing
    # With few rows it stays near the one temperature.
    a, b = vector_scaling(logits[:4], taken[:4], ridge=1e6)
    assert a == pytest.approx(np.full(3, 1 / temperature(logits[:4], taken[:4])), abs=1e-3)
    assert b == pytest.approx(np.zeros(3), abs=1e-3)


def test_calibration_error_by_hand():
    """Two groups of rows: said 0.8 and 0.4, taken 0.5 and 0.5; for both actions."""
    probs = np.array([[0.8, 0.2]] * 4 + [[0.4, 0.6]] * 4)
    taken = np.array([0, 0, 1, 1, 0, 0, 1, 1])
    assert calibration_error(np.log(probs), taken, bins=2) == pytest.approx(2 * (0.3 + 0.1) / 2)
    assert calibration_error(np.log(np.full((8, 2), 0.5)), taken) == pytest.approx(0.0)
    rng = np.random.default_rng(0)
    logits = rng.standard_normal((20_000, 4))
    right = drawn(logits, rng)
    assert calibration_error(log_softmax(logits), right) < 0.045
    assert calibration_error(log_softmax(3 * logits), right) > 0.3


def test_gaussian_scale():
    rng = np.random.default_rng(0)
    residuals = rng.standard_normal((40_000, 2)) * [1.5, 0.7]
    found = gaussian_scale(residuals)
    assert found == pytest.approx([1.5, 0.7], rel=0.02)
    density = lambda s: (-0.5 * (residuals / s) ** 2 - np.log(s)).sum()  # noqa: E731
    assert density(found) > max(density(found * 1.001), density(found * 0.999))


def test_what_cannot_be_calibrated():
    z = np.zeros((2, 2))
    for logits, taken, match in (
        (z, np.zeros(3, int), "shapes"), (z, np.array([0, 2]), "0 .. 1"), (z * np.nan, np.zeros(2, int), "numbers"),
        (np.array([[-np.inf, 0.0], [0.0, 0.0]]), np.zeros(2, int), "excludes"), (z[:0], np.zeros(0, int), "shapes"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=match):
            temperature(logits, taken)
    with pytest.raises(UserError, match="finite residuals"):
        gaussian_scale(np.zeros((0, 2)))
    with pytest.raises(UserError, match="finite logits"):
        vector_scaling(np.array([[0.0, -np.inf]]), np.zeros(1, int))
