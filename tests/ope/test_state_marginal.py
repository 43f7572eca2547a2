"""Marginal ratios: exact where the log is the distribution, the right influence, and a variance that does not explode."""

import dataclasses
import itertools

import numpy as np
import pytest

from deadreckon.data.episodes import rows_of
from deadreckon.errors import UserError
from deadreckon.ope.sequences import cumulate, times, totals
from deadreckon.ope.state_marginal import state_marginal
from deadreckon.theory import garnet
from tests.ope.worlds import tables


def exact(world, policy, steps, discount):
    """Value of so many steps."""
    d, value = world.initial, 0.0
    for t in range(steps):
        value += discount**t * (d[:, None] * policy * world.rewards).sum()
        d = np.einsum("s,sa,sat->t", d, policy, world.transitions)
    return value


def columns(log, target, behavior):
    s = log.observations.argmax(1)
    ended = np.asarray(log.terminals)[log.ends]
    return s, np.log(target / behavior)[s, log.actions], np.asarray(log.rewards, float), log.lengths, ended


def repeated(s, ratios, rewards, lengths, ended, count):
    """The columns of each episode as often as it counts."""
    which = np.repeat(np.arange(len(lengths)), count)
    rows = rows_of((np.cumsum(lengths) - lengths)[which], lengths[which])
    return s[rows], ratios[rows], rewards[rows], lengths[which], ended[which]


@pytest.fixture(scope="module")
def world():
    true = garnet(states=4, actions=2, branches=2, ending=0.2, seed=2)
    return true, tables(true, 1, 0.3)[0], tables(true, 1, 0.8, seed=1)[0]


def paths(world, behavior, steps):
    """All episodes of a world that can be, up to so many steps, and their probabilities."""
    found = []
    for s in np.flatnonzero(world.initial):
        live = [([(s, a)], world.initial[s] * behavior[s, a]) for a in range(world.actions)]
        for t in range(steps):
            found += [(path, p * (1 - world.transitions[path[-1]].sum()), True) for path, p in live]
            if t == steps - 1:
                found += [(path, p * world.transitions[path[-1]].sum(), False) for path, p in live]
                break
            live = [
                ([*path, (n, a)], p * world.transitions[path[-1]][n] * behavior[n, a])
                for path, p in live for n, a in itertools.product(range(world.states), range(world.actions))
                if world.transitions[path[-1]][n] > 0
            ]  # fmt: skip
    return [each for each in found if each[1] > 0]


@pytest.mark.parametrize("normalised", [True, False])
def test_exact_where_the_log_is_the_distribution(world, normalised):
    """Every episode of up to three steps, as often in the log as its probability says, a multiple of 1 / 80,000."""
    true, _, target = world
    true = dataclasses.replace(true, transitions=np.rint(5 * true.transitions) / 5, initial=np.array([0.1, 0.2, 0.3, 0.4]))
    behavior = np.array([[0.25, 0.75], [0.75, 0.25], [0.5, 0.5], [0.25, 0.75]])
    every = paths(true, behavior, 3)
    count = 10 * 20**3 * np.array([each[1] for each in every])
    np.testing.assert_allclose(count, np.rint(count))
    steps = np.array([step for each in every for step in each[0]])
    lengths, ended = np.array([len(each[0]) for each in every]), np.array([each[2] for each in every])
    ratios = np.log(target / behavior)[steps[:, 0], steps[:, 1]]
    rewards = true.rewards[steps[:, 0], steps[:, 1]]
    given = repeated(steps[:, 0], ratios, rewards, lengths, ended, np.rint(count).astype(int))
    found = state_marginal(*given, 0.9, normalised=normalised)
    assert len(found.scores) == 80_000
    assert found.value == pytest.approx(exact(true, target, 3, 0.9))
    assert found.scores.mean() == pytest.approx(found.value)
    assert found.lost == 0.0
    assert found.states.sum(1) == pytest.approx(0.8 ** np.arange(3))


def test_the_log_s_own_policy_has_its_mean_return(world):
    true, behavior, _ = world
    log = true.log(behavior, 300, 12, np.random.default_rng(0))
    for normalised in (True, False):
        found = state_marginal(*columns(log, behavior, behavior), 0.9, normalised=normalised)
        assert found.value == pytest.approx(log.returns(0.9).mean())
        assert found.scores.mean() == pytest.approx(found.value)


@pytest.mark.parametrize("normalised", [True, False])
@pytest.mark.parametrize("cut", [False, True])
def test_the_influence_is_that_of_an_episode_s_weight(world, normalised, cut):
    true, behavior, target = world
    log = true.log(behavior, 80, 6, np.random.default_rng(1))
    s, ratios, rewards, lengths, ended = columns(log, target, behavior)
    if cut:  # episodes that are cut off early, among others that go on
        short = np.where(np.arange(80) % 3 == 0, np.minimum(lengths, 2), lengths)
        kept = times(lengths) < np.repeat(short, lengths)
        s, ratios, rewards, ended, lengths = s[kept], ratios[kept], rewards[kept], ended & (short == lengths), short
    given = s, ratios, rewards, lengths, ended
    found = state_marginal(*given, 0.9, normalised=normalised)
    assert found.scores.mean() == pytest.approx(found.value)
    for i in (0, 3, 17, 50):  # all 500 times, and one of them once more or less
        counts = (500 + x * (np.arange(80) == i) for x in (1, -1))
        ahead, back = (state_marginal(*repeated(*given, own), 0.9, normalised=normalised).value for own in counts)
        assert (ahead - back) / 2 * 500 * 80 == pytest.approx(found.scores[i] - found.value, abs=1e-5)


@pytest.mark.slow
def test_coverage_also_of_logs_that_are_cut_off(world):
    """Value +- 1.96 errors holds the truth in about 95 % of 300 logs, a third of whose episodes are cut off somewhere."""
    true, behavior, target = world
    rng, held = np.random.default_rng(0), []
    truth = exact(true, target, 8, 0.9)
    for _ in range(300):
        log = true.log(behavior, 400, 8, rng)
        s, ratios, rewards, lengths, ended = columns(log, target, behavior)
        short = np.where(rng.random(400) < 0.33, np.minimum(lengths, rng.integers(1, 8, 400)), lengths)
        kept = times(lengths) < np.repeat(short, lengths)
        found = state_marginal(s[kept], ratios[kept], rewards[kept], short, ended & (short == lengths), 0.9)
        held.append(abs(found.value - truth) < 1.96 * found.scores.std(ddof=1) / 20)
    assert 0.91 <= np.mean(held) <= 0.98, np.mean(held)


@pytest.mark.slow
def test_the_variance_grows_with_a_power_of_the_horizon():
    """From 5 to 80 steps the error of products outgrows the return many times over, that of marginal ratios never does."""
    true = garnet(states=4, actions=2, branches=3, noise=0.3, seed=3)
    behavior, target = tables(true, 1, 0.1)[0], tables(true, 1, 1.0, seed=1)[0]
    rng, marginal, products = np.random.default_rng(0), {}, {}
    for steps in (5, 20, 80):
        truth = exact(true, target, steps, 1.0)
        errors = []
        for _ in range(40):
            given = columns(true.log(behavior, 200, steps, rng), target, behavior)
            found = state_marginal(*given, 1.0)
            _, ratios, rewards, lengths, _ = given
            plain = totals(np.exp(cumulate(ratios, lengths)) * rewards, lengths).mean()
            errors.append([found.value - truth, plain - truth])
        marginal[steps], products[steps] = np.sqrt(np.mean(np.square(errors), 0)) / steps
    assert marginal[80] < 1.2 * marginal[5], marginal  # relative to the horizon, over which rewards are summed
    assert products[20] > 1.5 * marginal[20], (marginal, products)
    assert products[80] > 20 * marginal[80], (marginal, products)


def test_episodes_that_are_cut_off_have_not_ended():
    """One state and four episodes alike: one ends, one is cut off after a step, two go on, with ratios of 1 and 3.

    After the first step a third of the probability is over, of those three that tell, and two thirds are on.
    """
    ratios = np.log([1.0, 1.0, 1.0, 1.0, 1.0, 3.0])
    lengths, ended = np.array([1, 1, 2, 2]), np.array([True, False, True, True])
    found = state_marginal(np.zeros(6, int), ratios, np.zeros(6), lengths, ended, 1.0)
    assert found.states[1, 0] == pytest.approx(2 / 3)
    # The weights are 4 times 2/3 a quarter and three quarters of that, and 4/3 episodes that are over with a weight of one.
    weight = 4 * 2 / 3 * np.array([0.25, 0.75])
    assert found.ess[1] == pytest.approx((weight.sum() + 4 / 3) ** 2 / (np.square(weight).sum() + 4 / 3))


def test_what_is_no_table():
    ones = np.ones(2, int)
    with pytest.raises(UserError, match="whole numbers"):
        state_marginal(np.array([0.5, 1.0]), np.zeros(2), np.zeros(2), ones, ones > 0, 0.9)
    with pytest.raises(UserError, match="3 rewards"):
        state_marginal(ones, np.zeros(2), np.zeros(3), ones, ones > 0, 0.9)
    # All that are in a state are cut off there: what follows is lost, and that is said.
    found = state_marginal(
        np.array([0, 1, 1, 1]), np.zeros(4), np.ones(4), np.array([1, 3]), np.array([False, True]), 1.0
    )
    assert found.lost == pytest.approx(0.5)
    assert found.value == pytest.approx(1 + 0.5 * 2)
