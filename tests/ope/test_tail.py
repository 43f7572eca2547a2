"""The lower tail of the return: exact in a world whose episodes can be counted, by hand, and refused where it is thin."""

import itertools

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.ope.tail import lower_tail


def exact(probabilities, returns, share):
    """CVaR of a discrete distribution: what lies below the quantile, and as much of its atom as is missing."""
    order = np.argsort(returns)
    left, value = share, 0.0
    for p, g in zip(probabilities[order], returns[order]):
        value += min(p, left) * g
        left -= min(p, left)
    return value / share


@pytest.fixture(scope="module")
def world():
    """All episodes of three steps of two actions: (8,) probabilities under log and policy, and returns."""
    behavior, target = np.array([0.5, 0.5]), np.array([0.3, 0.7])
    actions = np.array(list(itertools.product((0, 1), repeat=3)))
    returns = (np.array([[0.0, 1.0], [2.0, -1.0], [0.5, 0.3]])[np.arange(3), actions] * 0.9 ** np.arange(3)).sum(1)
    return behavior[actions].prod(1), target[actions].prod(1), returns


@pytest.mark.parametrize("share", [0.05, 0.147, 0.343, 0.5, 1.0])
def test_exact_where_the_log_is_the_distribution(world, share):
    """Each of the eight episodes as often as expected: the tail is that of the policy, also where a share cuts an atom."""
    log, policy, returns = world
    which = np.repeat(np.arange(8), 50)
    found = lower_tail(np.log(policy / log)[which], returns[which], share)
    assert found.value == pytest.approx(exact(policy, returns, share))
    assert found.influence.mean() == pytest.approx(0.0, abs=1e-12)
    assert found.quantile in returns


def test_the_influence_is_that_of_an_episode_s_weight(world):
    """A little more weight for one episode moves the value by its influence."""
    log, policy, returns = world
    which = np.repeat(np.arange(8), 50)
    logs, g = np.log(policy / log)[which], returns[which] + np.linspace(0, 0.01, 400)
    found = lower_tail(logs, g, 0.2)
    for i in (0, 120, 399):
        more = logs + np.where(np.arange(400) == i, np.log1p(1e-5), 0.0)
        moved = (lower_tail(more, g, 0.2).value - found.value) / 1e-5 * 400
        assert moved == pytest.approx(found.influence[i], rel=1e-3, abs=1e-6)


def test_a_tail_rests_on_as_many_episodes_as_fill_it_also_where_many_are_at_the_quantile():
    """A tenth of forty episodes is four, of which two have returned 0; all others are at the quantile."""
    returns = np.repeat([0.0, 1.0], [2, 38])
    assert lower_tail(np.zeros(40), returns, 0.1, least=1).ess == pytest.approx(4.0)
    assert lower_tail(np.zeros(40), returns + 1e-6 * np.arange(40), 0.1, least=1).ess == pytest.approx(4.0)
    with pytest.raises(UserError, match=r"rest on 4\.0 of 40 in the log, fewer than the 10"):
        lower_tail(np.zeros(40), returns, 0.1, least=10)


def test_coverage(world):
    """Value +- 1.96 errors holds the truth in about 95 % of 400 drawn logs."""
    log, policy, returns = world
    rng = np.random.default_rng(0)
    truth, held = exact(policy, returns, 0.25), []
    for _ in range(400):
        which = rng.choice(8, 500, p=log)
        found = lower_tail(np.log(policy / log)[which], returns[which], 0.25)
        held.append(abs(found.value - truth) < 1.96 * found.error)
    assert 0.92 <= np.mean(held) <= 0.98


def test_what_cannot_be_told():
    logs, g = np.zeros(100), np.arange(100.0)
    assert lower_tail(logs, g, 0.1).value == pytest.approx(4.5)
    assert lower_tail(logs, g, 0.1).ess == pytest.approx(10.0)
    with pytest.raises(UserError, match="rest on 9.0 of 100"):
        lower_tail(logs, g, 0.09)
    heavy = logs.copy()
    heavy[0] = 10.0
    with pytest.raises(UserError, match="rest on 0.5"):  # of the first episode, which has nearly all of the weight, a half
        lower_tail(heavy, g, 0.5)
    with pytest.raises(UserError, match="no episode"):
        lower_tail(np.full(100, -np.inf), g, 0.5)
    for share in (0.0, 1.5):
        with pytest.raises(UserError, match="share"):
            lower_tail(logs, g, share)
