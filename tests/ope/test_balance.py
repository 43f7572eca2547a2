"""Propensities that do not fit the log: a model that has not learned a confounder, and columns that come after the action."""

import jax
import numpy as np
import pytest
from scipy import stats

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Box
from deadreckon.ope import OPEInput, parts
from deadreckon.ope.balance import above, dependent, unbalanced
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.decide import decide
from deadreckon.ope.parts import parts_of
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import TanhMeanGaussian
from tests.ope.test_decide import constant
from tests.ope.worlds import Tanh

SMALL = BehaviorModel(hidden=(16,), steps=300, lr=1e-2)


def case_of(seen, actions, rewards, chance=None, names=("x", "noise"), seed=0):
    """Single steps, with the probability of action 1 (rows,) if propensities are logged."""
    logged = {} if chance is None else {"propensity": np.where(actions == 1, chance, 1.0 - chance)}
    columns = {name: column for name, column in zip(names, seen.T)} | {"action": actions, "reward": rewards} | logged
    log = Dataset.from_frame(
        columns, action="action", reward="reward", observations=list(names), propensity="propensity" if logged else None
    )  # fmt: skip
    return OPEInput(log, [constant([0.1, 0.9]), constant([0.9, 0.1])], discount=0.0, logged=True, seed=seed)


def rush_hours(seed=0, rows=1_000):
    """An action that does nothing and is taken more often in both rush hours, when rewards are low."""
    rng = np.random.default_rng(seed)
    hour = rng.integers(0, 24, rows)
    rush = np.exp(-0.5 * ((hour - 8) / 2) ** 2) + np.exp(-0.5 * ((hour - 18) / 2) ** 2)
    actions = (rng.random(rows) < 0.15 + 0.7 * rush.clip(max=1)).astype(int)
    return np.stack([hour, rng.normal(size=rows)], 1), actions, -0.5 * rush + 0.3 * rng.normal(size=rows)


def measured_after(seed=0, rows=1_500):
    """A fair coin that does nothing for the reward, and a column that it changes and that the reward shares a cause with."""
    rng = np.random.default_rng(seed)
    cause, actions = rng.normal(size=rows), rng.integers(0, 2, rows)
    after = 0.5 * actions + 0.6 * cause + 0.8 * rng.normal(size=rows)
    return np.stack([after, rng.normal(size=rows)], 1), actions, cause + 0.8 * rng.normal(size=rows)


def test_a_confounder_that_the_model_has_not_learned_deploys_nothing():
    case = case_of(*rush_hours(), names=("hour", "noise"))
    found = decide(case, model=SMALL)
    assert found.choice.low > 0  # noise, praised
    assert not found.choice.deploy
    assert "actions depend on hour in a way that the learned propensities do not show (p < 0.001)" in found.choice.reason


def test_a_column_that_was_measured_after_the_action_deploys_nothing():
    seen, actions, rewards = measured_after()
    found = decide(case_of(seen, actions, rewards, np.full(len(actions), 0.5), names=("calls", "noise")), model=SMALL)
    assert found.choice.low > 0
    assert not found.choice.deploy
    assert "taken more often than the logged propensities say (p < 0.001)" in found.choice.reason
    assert "calls was measured after the action (leave it out, --ignore)" in found.choice.reason


def users(seed=0, mixed=False):
    """Ten rows of each of 150 users, who have always the same action, at random, and good or bad outcomes."""
    rng = np.random.default_rng(seed)
    user = np.repeat(np.arange(150), 10)
    if mixed:
        user = rng.permutation(user)
    actions, effect = rng.integers(0, 2, 150)[user], rng.normal(size=150)[user]
    return rng.normal(size=(1_500, 2)), actions, effect + rng.normal(size=1_500), user


def test_rows_of_users_without_a_column_are_told():
    missed = 0
    for seed in (0, 10):
        seen, actions, rewards, user = users(seed)
        found = decide(case_of(seen, actions, rewards, np.full(1_500, 0.5), seed=seed), model=SMALL, stationary=True)
        assert "episodes that follow each other in the log go together (p < 0.001)" in str(found.choice.warnings)
        missed += bool((found.choice.gains[:, 1] > 0).any() or (found.choice.gains[:, 2] < 0).any())
        case = case_of(seen, actions, rewards, np.full(1_500, 0.5), seed=seed)
        grouped = OPEInput(case.given, case.policies, discount=0.0, logged=True, clusters=user)
        assert dependent(grouped, SMALL) is None
    assert missed  # of gains of zero, or the warning would not be needed


def test_independent_rows_are_none():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        seen = np.cumsum(rng.normal(size=(1_000, 2)), 0) / 10  # conditions change slowly, actions and rewards follow them
        chance = 1 / (1 + np.exp(-seen[:, 0]))
        actions = (rng.random(1_000) < chance).astype(int)
        rewards = np.round(seen[:, 0] + actions + rng.normal(size=1_000))
        case = case_of(seen, actions, rewards, chance, seed=seed)
        model = BehaviorModel(hidden=(16,), steps=2_000, lr=3e-3)
        assert dependent(case, model) is None
        order = np.argsort(rewards) if seed % 2 else np.argsort(actions, kind="stable")
        assert dependent(case_of(seen[order], actions[order], rewards[order], chance[order], seed=seed), model) is None


@pytest.mark.parametrize("logged", [False, True])
def test_right_propensities_are_balanced(logged):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        seen = rng.normal(size=(1_000, 2))
        chance = 1 / (1 + np.exp(-2 * seen[:, 0] - seen[:, 1]))
        actions = (rng.random(1_000) < chance).astype(int)
        case = case_of(seen, actions, seen[:, 0] + rng.normal(size=1_000), chance if logged else None, seed=seed)
        assert unbalanced(case, SMALL) is None


def test_an_action_that_is_impossible_for_some_rows_is_no_evidence():
    """Where x is below zero only action 0 is possible, and has the propensity 1."""
    rng = np.random.default_rng(0)
    seen = rng.normal(size=(2_000, 2))
    chance = np.where(seen[:, 0] > 0, 0.5, 0.0)
    actions = (rng.random(2_000) < chance).astype(int)
    assert unbalanced(case_of(seen, actions, rng.normal(size=2_000), chance), SMALL) is None


def test_propensities_near_one_are_not_accused_for_few_events():
    """Where an action has the probability 0.85, nearly all of twenty rows may have it: weights of 1.18 with little spread."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        seen = rng.normal(size=(400, 2))
        actions = (rng.random(400) < 0.85).astype(int)
        assert unbalanced(case_of(seen, actions, rng.normal(size=400), np.full(400, 0.85)), SMALL) is None


def apart(taken, chance, part, unit):
    """`parts.apart` of an action by its learned probabilities."""
    share = taken.mean()
    return parts.apart(taken - chance, chance * (1.0 - chance), share * (1.0 - share), part, unit)


def test_rare_actions_are_not_accused():
    """No event where 0.2 are expected is no evidence, although nothing varies there."""
    p_value, _ = apart(np.zeros(40, bool), np.full(40, 0.005), np.repeat([0, 1], 20), np.arange(40))
    assert p_value > 0.5


def test_a_weak_dependence_is_no_objection_however_many_rows_show_it():
    rng = np.random.default_rng(0)
    x = rng.integers(0, 2, 40_000)
    actions = (rng.random(40_000) < np.where(x == 1, 0.53, 0.47)).astype(int)
    p_value, strength = apart(actions == 1, np.full(40_000, 0.5), x, np.arange(40_000))
    assert p_value < 1e-20
    np.testing.assert_allclose(strength, 0.06, atol=0.01)
    case = case_of(np.stack([x, rng.normal(size=40_000)], 1), actions, rng.normal(size=40_000), np.full(40_000, 0.5))
    assert unbalanced(case, SMALL) is None


def test_the_statistics_by_hand():
    """Two parts of two rows, each a cluster: sums of 1 and -0.5, whose variances are 0.5 and 0.5 by the probabilities."""
    part, taken, chance = np.array([0, 0, 1, 1]), np.array([True, True, False, True]), np.array([0.5, 0.5, 0.75, 0.75])
    variance = np.array([0.25 + 0.25, 0.75**2 + 0.25**2])  # the squares, which exceed 2 * 0.1875 in the second part
    square = (np.square([1.0, -0.5]) / variance).sum()
    p_value, strength = apart(taken, chance, part, np.arange(4))
    np.testing.assert_allclose(p_value, stats.chi2.sf(square, 2))
    excess = ((np.square([1.0, -0.5]) - variance) / 2).sum() / 4
    np.testing.assert_allclose(strength, np.sqrt(max(excess, 0) / (0.75 * 0.25)))
    weight = np.array([2.0, 2.0, 0.0, 0.0])
    p_value, mean = above(weight, part, np.arange(4))
    assert mean == 1.0
    error = np.sqrt(4.0)  # of w (w - 1) in the first part; the sums 1, 1, 0, 0 have the variance 4 / 3
    np.testing.assert_allclose(p_value, 4 * stats.t.sf(2.0 / error, 3))


def test_parts_are_levels_or_tenths():
    assert parts_of(np.zeros(100), 100) is None
    np.testing.assert_array_equal(parts_of(np.array([3.0, 7.0, 3.0] * 100), 300), [0, 1, 0] * 100)
    tenths = parts_of(np.random.default_rng(0).permutation(1_000).astype(float), 1_000)
    assert np.bincount(tenths).tolist() == [100] * 10
    assert parts_of(np.arange(60.0), 60).max() == 2  # twenty clusters for each
    assert parts_of(np.arange(30.0), 25).max() == 1  # two at least
    capped = np.append(np.full(95, 9.0), np.arange(5.0))
    np.testing.assert_array_equal(parts_of(capped, 100), np.append(np.ones(95), np.zeros(5)))


def test_propensities_that_are_wrong_everywhere_accuse_no_column():
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 2, 1_000)
    case = case_of(rng.normal(size=(1_000, 2)), actions, rng.normal(size=1_000), np.where(actions == 1, 0.4, 0.6))
    found = unbalanced(case, SMALL)
    assert found is not None
    assert found.words.endswith("is taken more often than the logged propensities say (p < 0.001): they are wrong")


def continuous(seen, actions, rewards):
    """Single steps of a continuous action, with two tanh-Gaussian policies whose means are within the logged actions."""
    low, high = actions.min(), actions.max()
    log = Dataset.from_frame(
        {"hour": seen[:, 0], "noise": seen[:, 1], "dose": actions, "reward": rewards}, action="dose", reward="reward",
        observations=["hour", "noise"],
    )  # fmt: skip
    means = [np.arctanh(2 * (mean - low) / (high - low) - 1) for mean in (0.5, 0.0)]
    return OPEInput(log, [Tanh(mean, 0.25, low, high) for mean in means], discount=0.0, logged=True)


def test_a_confounder_of_continuous_actions_is_named():
    """The dose does nothing and is higher in two rush hours, when rewards are low."""
    rng = np.random.default_rng(0)
    hour = rng.uniform(0, 24, 1_000)
    rush = np.exp(-0.5 * (hour - 8) ** 2) + np.exp(-0.5 * (hour - 17) ** 2)
    seen = np.stack([hour, rng.normal(size=1_000)], 1)
    case = continuous(seen, rush + 0.5 * rng.normal(size=1_000), -2 * rush + rng.normal(size=1_000))
    found = unbalanced(case, SMALL)
    assert (found.column, found.action) == ("hour", "dose")
    assert found.p_value < 1e-6
    decided = decide(case, model=SMALL).choice
    assert not decided.deploy
    assert "actions depend on hour in a way that the learned propensities do not show (p < 0.001)" in decided.reason


@pytest.mark.parametrize("shape", ["skewed", "uniform", "scaled", "rounded"])
def test_other_shapes_of_continuous_actions_are_no_dependence(shape):
    rng, rows = np.random.default_rng(1), 6_000
    seen = rng.normal(size=(rows, 2))
    noise = {
        "skewed": rng.exponential(size=rows) ** 1.5, "uniform": rng.uniform(-2, 2, rows),
        "scaled": np.exp(0.4 * seen[:, 1]) * rng.normal(size=rows), "rounded": np.round(rng.normal(size=rows), 1),
    }[shape]  # fmt: skip
    assert unbalanced(continuous(seen, 0.5 * seen[:, 0] + noise, rng.normal(size=rows)), SMALL) is None


def test_clipped_policies_are_tested_by_the_model_that_their_weights_use():
    rng = np.random.default_rng(0)
    seen = rng.normal(size=(2_000, 2))
    actions = (0.8 * seen[:, :1] + 0.6 * rng.normal(size=(2_000, 1))).clip(-1, 1)
    log = Dataset.from_arrays(
        observations=seen, actions=actions, rewards=rng.normal(size=2_000), terminals=np.ones(2_000),
        action_space=Box((-1.0,), (1.0,)),
    )  # fmt: skip
    inner = TanhMeanGaussian.create(log.spec, (8,), jax.random.key(0), std=0.5)
    case = OPEInput(log, [EnvPolicy.of(inner, Normalizer.of(log.spec))], discount=0.0, logged=True)
    assert case.clips.all()
    assert unbalanced(case, BehaviorModel(hidden=(32,), steps=2_000, lr=3e-3)) is None
