"""Bounds under confounding: those of linear programs, of nothing at Gamma = 1, and of a world that is confounded."""

import numpy as np
import pytest
from scipy.optimize import linprog

from deadreckon.errors import UserError
from deadreckon.ope.sensitivity import bounds, tipping, weight_box


def program(y, low, high, sign):
    """The fractional program as a linear one (Charnes and Cooper): z = w t, sum z = 1, low t <= z <= high t."""
    n = len(y)
    box = np.block([[np.eye(n), -high[:, None]], [-np.eye(n), low[:, None]]])
    found = linprog(np.append(sign * y, 0.0), box, np.zeros(2 * n), np.append(np.ones(n), 0.0)[None], [1.0])
    return sign * found.fun


def small(seed, n=12):
    rng = np.random.default_rng(seed)
    beta, pi = rng.uniform(0.1, 0.9, n), rng.uniform(0.05, 0.95, n)
    return np.round(rng.standard_normal(n), 1), np.log(pi / beta), np.log(beta)  # rounded: with ties


@pytest.mark.parametrize("seed", range(6))
def test_bounds_are_those_of_linear_programs(seed):
    y, ratios, behavior = small(seed)
    for gamma in (1.5, 4.0):
        low, high = weight_box(ratios, gamma, behavior)
        least, most = bounds(y, low, high)
        assert least == pytest.approx(program(y, np.exp(low), np.exp(high), 1))
        assert most == pytest.approx(program(y, np.exp(low), np.exp(high), -1))
        assert bounds(y, low, high, baseline=y) == pytest.approx((y.mean() + least, y.mean() + most))


def test_the_box_is_that_of_odds():
    """Weights at which the odds of the action are Gamma times larger or smaller."""
    beta, pi, gamma = np.array([0.2, 0.9]), np.array([0.5, 0.3]), 3.0
    for end, odds in zip(weight_box(np.log(pi / beta), gamma, np.log(beta)), (gamma, 1 / gamma)):
        true = odds * beta / (1 - beta) / (1 + odds * beta / (1 - beta))
        assert np.exp(end) == pytest.approx(pi / true)
    for end, factor in zip(weight_box(np.log(pi / beta), gamma), (1 / gamma, gamma)):
        assert np.exp(end) == pytest.approx(factor * pi / beta)
    for bad in ((0.5, None), (2.0, np.log([1.5, 0.5]))):
        with pytest.raises(UserError, match="Gamma|probability"):
            weight_box(np.zeros(2), *bad)


def test_no_confounding_is_the_estimate_and_more_is_wider():
    y, ratios, behavior = small(0, 200)
    w = np.exp(ratios)
    before = None
    for gamma in (1.0, 1.1, 2.0, 10.0, 1000.0):
        least, most = bounds(y, *weight_box(ratios, gamma, behavior), baseline=0.25)
        if gamma == 1.0:
            assert (least, most) == pytest.approx((0.25 + (w * y).sum() / w.sum(),) * 2)
        else:
            assert least < before[0]
            assert most > before[1]
        before = least, most
        assert 0.25 + y.min() <= least <= most <= 0.25 + y.max()


def test_zero_weights_and_none():
    y = np.array([-5.0, 1.0, 2.0])
    logs = np.array([-np.inf, 0.0, 0.0])
    found = bounds(y, logs - np.log(2), logs + np.log(2))
    assert found == pytest.approx(((2 * 1 + 0.5 * 2) / 2.5, (0.5 * 1 + 2 * 2) / 2.5))
    with pytest.raises(UserError, match="no episode"):
        bounds(y, np.full(3, -np.inf), np.full(3, -np.inf))


def confounded(rng, n, strength):
    """A binary confounder that moves the odds of the action by `strength` either way, and the outcome by one."""
    u = rng.random(n) < 0.5
    # Odds of `strength` and 1 / strength average to a nominal probability of one half.
    chance = np.where(u, strength, 1 / strength) / (1 + np.where(u, strength, 1 / strength))
    action = rng.random(n) < chance
    y = u + 0.3 * action + 0.1 * rng.standard_normal(n)
    return action, y


def test_a_confounded_world_is_inside_its_box_alone():
    """Always acting is worth 0.8. The plain estimate says more; the bounds at the true Gamma hold it."""
    action, y = confounded(np.random.default_rng(0), 100_000, 2.0)
    ratios, behavior = np.where(action, np.log(2.0), -np.inf), np.full(len(y), np.log(0.5))
    low, high = bounds(y, *weight_box(ratios, 2.0, behavior))
    assert low - 0.01 < 0.8 < high
    assert bounds(y, *weight_box(ratios, 1.0, behavior))[0] > 0.9


def test_a_critic_narrows_the_bounds():
    """The outcome is mostly known from the state: only what is left of it is uncertain."""
    rng = np.random.default_rng(0)
    state = rng.standard_normal(500)
    y = 3 * state + 0.1 * rng.standard_normal(500)
    box = weight_box(np.zeros(500), 2.0, np.full(500, np.log(0.5)))
    plain, robust = bounds(y, *box), bounds(y - 3 * state, *box, baseline=3 * state)
    assert robust[1] - robust[0] < 0.1 * (plain[1] - plain[0])


def test_tipping():
    assert tipping(lambda gamma: 1.5 - gamma) == pytest.approx(1.5, abs=1.1e-2)
    assert np.isnan(tipping(lambda gamma: -gamma))
    assert tipping(lambda gamma: 1.0) == np.inf
    y, ratios, behavior = small(3, 100)
    gain = lambda gamma: bounds(y + 0.5, *weight_box(ratios, gamma, behavior), baseline=-y)[0]  # noqa: E731
    most = tipping(gain)
    assert gain(most) > 0 > gain(most + 2e-2)
