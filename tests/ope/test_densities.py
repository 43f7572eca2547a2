"""Learned densities of continuous actions: no row of a small log has all of the weight."""

import jax
import numpy as np
import pytest
import scipy.stats

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box
from deadreckon.ope import OPEInput
from deadreckon.ope.behavior import SHARES, normal, out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.decide import decide
from deadreckon.ope.ends import NEAR, within_bounds
from deadreckon.ope.importance import log_ratios
from deadreckon.ope.propensities import stacked
from deadreckon.policies import behavior as models

from .worlds import Tanh

MODEL = BehaviorModel(hidden=(32, 32), steps=1_000, lr=3e-3)


def doses(rows, seed=0, **more):
    """A dose around half of an observation; 0.7 more would be best."""
    rng = np.random.default_rng(seed)
    seen = rng.normal(size=(rows, 2))
    actions = 0.5 * seen[:, 0] + rng.normal(size=rows)
    rewards = -np.square(actions - 0.5 * seen[:, 0] - 0.7) + rng.normal(size=rows)
    return Dataset.from_arrays(
        observations=seen, actions=actions[:, None], rewards=rewards, terminals=np.ones(rows), **more
    )  # fmt: skip


def test_policies_of_a_small_table_of_continuous_actions_can_be_evaluated():
    """The bounds are those of the log. One row had all of the weight in each, and nothing was said of any policy."""
    for seed in range(3):
        log = doses(600, seed)
        low, high = float(log.actions.min()), float(log.actions.max())
        scale = 2 / (high - low)  # about as wide as the log's own, and higher by 0.4
        policy = Tanh(scale * (0.4 - (high + low) / 2), scale, low, high, slope=0.5 * scale)
        case = OPEInput(log, [policy], logged=True, discount=0.0)
        found = decide(case, model=MODEL)
        assert found.choice.deploy, found.choice.reason
        assert found.estimates[0].ess[0] > 150
        seen = np.random.default_rng(0).normal(size=(100_000, 2))
        drawn = policy.fn(seen, np.random.default_rng(1))[:, 0]
        true = 1.49 - np.square(drawn - 0.5 * seen[:, 0] - 0.7).mean()  # the log's own loses 1 + 0.7^2
        gain, lower, upper = found.choice.gains[0]
        assert lower < true < upper
        assert gain == pytest.approx(true, abs=0.25)


def narrow(rows, size, outliers=0, seed=0):
    """An action that follows the first of some observations closely, but for a few rows."""
    rng = np.random.default_rng(seed)
    seen = rng.normal(size=(rows, size))
    actions = 0.5 * seen[:, :1] + 0.2 * rng.normal(size=(rows, 1))
    actions[:outliers] = 4.0
    log = Dataset.from_arrays(
        observations=seen, actions=actions, rewards=np.zeros(rows), terminals=np.ones(rows), action_space=Box((-6.0,), (6.0,))
    )
    return OPEInput(log, [Tanh(0.0, 0.5, -6.0, 6.0)], logged=True, discount=0.0)


def test_a_few_actions_near_a_bound_are_moved_and_many_are_left():
    rng = np.random.default_rng(0)
    actions = np.stack([rng.normal(size=1000), rng.normal(size=1000).clip(-1, 1)], 1)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(1000, 2)), actions=actions, rewards=np.zeros(1000), terminals=np.ones(1000)
    )
    found = within_bounds(log)
    low, high = log.actions[:, 0].min(), log.actions[:, 0].max()
    unit = 2 * (log.actions[:, 0] - low) / (high - low) - 1
    assert 2 <= (np.abs(unit) > NEAR).sum() <= 10
    np.testing.assert_allclose(found.actions[:, 0], low + (np.clip(unit, -NEAR, NEAR) + 1) * (high - low) / 2, atol=1e-6)
    np.testing.assert_array_equal(found.actions[np.abs(unit) <= NEAR, 0], log.actions[np.abs(unit) <= NEAR, 0])
    np.testing.assert_array_equal(found.actions[:, 1], log.actions[:, 1])
    assert found.spec.action == log.spec.action
    np.testing.assert_array_equal(found.episode_ids, log.episode_ids)
    case = narrow(100, 2)  # with bounds that no action attains
    assert within_bounds(case.data) is case.data


def test_the_least_and_the_greatest_action_do_not_disturb_what_is_learned_of_the_others():
    rng = np.random.default_rng(1)
    seen = rng.normal(size=(1000, 2))
    actions = np.sin(2 * seen[:, 0]) + 0.5 * rng.normal(size=1000)
    log = Dataset.from_arrays(
        observations=seen, actions=actions[:, None], rewards=np.zeros(1000), terminals=np.ones(1000)
    )  # fmt: skip
    case = OPEInput(log, [Tanh(0.0, 0.3, float(actions.min()), float(actions.max()))], logged=True, discount=0.0)
    true = scipy.stats.norm.logpdf(actions, np.sin(2 * seen[:, 0]), 0.5)
    assert np.sort(out_of_fold(case, MODEL, 5).log_probs - true)[2:].mean() > -0.16


def test_densities_are_smoothed_towards_the_overall_density():
    """No row has less than its share of it, however impossible a network finds the action."""
    case = narrow(300, 2, outliers=3)
    found, fold = out_of_fold(case, MODEL, 5).log_probs, case.folds(5)
    pre = np.arctanh(case.data.actions.astype(np.float64) / 6)
    for row in range(3):
        others = pre[fold != fold[row]]
        overall = normal(pre[row : row + 1], others.mean(0), others.std(0)) - np.log(1 - np.tanh(pre[row]) ** 2) - np.log(6.0)
        assert found[row] > np.log(SHARES / (300 + SHARES)) + overall


def test_densities_of_normal_numbers():
    rng = np.random.default_rng(0)
    x, mean, std = rng.normal(size=(5, 2)), rng.normal(size=(5, 2)), rng.uniform(0.5, 2.0, (5, 2))
    np.testing.assert_allclose(normal(x, mean, std), scipy.stats.norm.logpdf(x, mean, std).sum(1))


def test_shares_of_models_are_those_of_the_highest_likelihood():
    """Rows are of one of two normal distributions, three quarters of them of the second."""
    rng = np.random.default_rng(0)
    x = np.where(rng.random(4_000) < 0.25, rng.normal(-1, 1, 4_000), rng.normal(1, 1, 4_000))
    logs = np.stack([scipy.stats.norm.logpdf(x, -1), scipy.stats.norm.logpdf(x, 1)])
    found = stacked(logs)
    np.testing.assert_allclose(found, [0.25, 0.75], atol=0.03)
    grid = [
        scipy.special.logsumexp(logs, axis=0, b=np.array([[w], [1 - w]])).sum()
        for w in (found[0] - 0.02, found[0], found[0] + 0.02)
    ]
    assert max(grid) == grid[1]
    np.testing.assert_allclose(stacked(np.array([[0.0] * 5, [-50.0] * 5]), 1.0), [5.5 / 6, 0.5 / 6])


def test_ranks_of_a_clipped_gaussian_have_their_middle_at_one_half():
    """What is clipped has the middle of its probability."""
    spec = doses(50).spec
    seen = np.random.default_rng(0).normal(size=(4_000, 2)).astype(np.float32)
    model = models.Clipped.create(spec, (8,), jax.random.key(0))
    draws = np.asarray(models.policy(model).actions(seen, jax.random.key(1), greedy=False))
    rank = np.asarray(models.clipped_rank(model, seen, np.clip(draws, -1 + 1e-6, 1 - 1e-6)))
    np.testing.assert_allclose(rank.mean(), 0.5, atol=0.02)
    upper = rank[draws[:, 0] >= 1 - 1e-6]
    assert 100 < len(upper) < 3_000
    np.testing.assert_allclose(1 - upper.mean(), len(upper) / 4_000 / 2, atol=0.02)


@pytest.mark.parametrize("width", [1.0, 1.25], ids=["own", "wide"])
def test_no_row_has_all_of_the_weight_of_a_policy_as_wide_as_the_log_or_wider(width):
    """Where rows at the bounds have their weight there, the wide one rests on a single row."""
    for seed in range(3):
        log = doses(600, seed)
        low, high = float(log.actions.min()), float(log.actions.max())
        scale = 2 / (high - low)
        case = OPEInput(log, [Tanh(-scale * (high + low) / 2, width * scale, low, high)], logged=True, discount=0.0)
        weights = np.exp(log_ratios(case, "auto", MODEL, None)[0])
        assert weights.max() < 0.05 * weights.sum()
        assert weights[[np.argmin(log.actions), np.argmax(log.actions)]].min() > 1e-6
        assert 0.9 < weights.mean() < 1.2
