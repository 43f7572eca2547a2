"""The battery's day: exact values against days that are played, and what every simulator promises."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deadreckon.tasks.envs  # noqa: F401  (gives Gymnasium the ids)
from deadreckon.collect.battery import by_the_clock, collect_battery
from deadreckon.errors import UserError
from deadreckon.tasks import battery, task
from deadreckon.tasks.battery import BLOCKS, BUY, SELL, WAIT

DAYS = 20_000


def played(chances, seed=0):
    """Returns of days that a (8, 4, 4, 3) table of chances plays."""
    simulator, rng = battery.TASK.simulate(range(seed, seed + DAYS)), np.random.default_rng(seed)
    simulator.reset()
    total = np.zeros(DAYS)
    for block in range(BLOCKS):
        likely = chances[block, simulator._charge, simulator._levels[:, block]]
        _, earned, terminal, timeout = simulator.step((rng.random(DAYS)[:, None] > likely.cumsum(1)).sum(1).clip(max=2))
        total += earned
        assert terminal.all() == (block == BLOCKS - 1)
        assert not timeout.any()
    return total


def start_value(found):
    """The mean of the values of the states in which days begin: an empty battery at any level."""
    return found[0, 0].mean()


def test_values_are_those_of_days_that_are_played():
    blocks, _, _ = battery.grid()
    best = battery.values()
    operator = by_the_clock(blocks.ravel()).reshape(*blocks.shape, 3)
    uniform = np.full_like(operator, 1 / 3)
    for chances in (uniform, operator):
        total = played(chances)
        exact = start_value(battery.values(chances))
        assert abs(total.mean() - exact) < 4 * total.std() / np.sqrt(DAYS)
        assert (battery.values(chances) <= best + 1e-9).all()
    reference = battery.TASK.reference
    assert start_value(battery.values(uniform)) == pytest.approx(reference.random, abs=0.001)
    assert start_value(best) == pytest.approx(reference.expert, abs=0.001)


def test_an_outcome_by_hand():
    """Sold at 9 x 1.1 less 5 %; bought at 3.5 x 0.7 and 5 % more; nothing to sell; no room; what is left is worth 2.5 each."""
    of = lambda *x: [float(v[0]) for v in battery.outcome(*(np.array([y]) for y in x))]  # noqa: E731
    assert of(6, 2, 2, SELL) == pytest.approx([0.95 * 9.9, 1])
    assert of(0, 0, 0, BUY) == pytest.approx([-2.45 / 0.95, 1])
    assert of(3, 0, 1, SELL) == [0.0, 0]
    assert of(3, 3, 1, BUY) == [0.0, 3]
    assert of(7, 3, 1, WAIT) == [7.5, 3]


def test_copies_depend_on_their_own_seed_and_go_on_where_they_were():
    rng = np.random.default_rng(0)
    many, few = battery.TASK.simulate(range(9)), battery.TASK.simulate([4])
    np.testing.assert_array_equal(many.reset()[[4]], few.reset())
    for _ in range(3):
        actions = rng.integers(0, 3, 9)
        for ours, theirs in zip(many.step(actions), few.step(actions[[4]])):
            np.testing.assert_array_equal(ours[[4]], theirs)
    again = battery.TASK.simulate(range(9))
    again.restore(many.state())
    for _ in range(BLOCKS - 3):
        actions = rng.integers(0, 3, 9)
        for ours, theirs in zip(many.step(actions), again.step(actions)):
            np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(many.reset([2, 5]), again.reset([2, 5]))
    with pytest.raises(UserError, match=r"9 integers of 0 \.\. 2"):
        many.step(np.full(9, 3))


def test_the_log_repeats_and_tells_its_propensities():
    log, again = collect_battery(300, seed=2), collect_battery(300, seed=2)
    np.testing.assert_array_equal(log.actions, again.actions)
    assert (log.episodes, len(log)) == (300, 300 * BLOCKS)
    assert log.terminals[log.ends].all()
    likely = by_the_clock(np.asarray(log.observations)[:, 0].astype(int))
    np.testing.assert_allclose(np.exp(log.extras["behavior_log_probs"]), likely[np.arange(len(log)), log.actions], rtol=1e-6)
    assert np.bincount(log.actions).min() > 0.13 * len(log)


def test_a_log_of_no_days_is_refused():
    with pytest.raises(UserError, match="days must be 1 or more, got 0"):
        collect_battery(0)


def test_it_is_an_environment():
    assert task("battery") is battery.TASK
    env = gymnasium.make("deadreckon/Battery-v1").unwrapped
    check_env(env, skip_render_check=True)
    assert env.action_space == gymnasium.spaces.Discrete(3)


@pytest.mark.parametrize(
    ("chances", "words"),
    [(np.full((4, 3), 1 / 3), r"must have shape \(8, 4, 4, 3\), got \(4, 3\)"), (np.full((8, 4, 4, 3), 0.5), "sum to 1")],
)
def test_probabilities_that_are_none_are_refused(chances, words):
    with pytest.raises(UserError, match=words):
        battery.values(chances)
