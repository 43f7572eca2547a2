"""SWITCH, shrinkage, and the choice of their parameters: by hand, without bias where there is none, and out of fold."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.ope.sequences import corrected, cumulate, times, totals
from deadreckon.ope.shrinkage import shrinkage_scores, shrunk
from deadreckon.ope.switch import beyond, switch_scores
from deadreckon.ope.tuning import bias_bound, cross_fitted, least_bound
from deadreckon.theory import garnet
from tests.ope.worlds import tables

LENGTHS = np.array([3, 1, 2])


def test_sequences_by_hand():
    assert times(LENGTHS).tolist() == [0, 1, 2, 0, 0, 1]
    assert totals(np.arange(6.0), LENGTHS).tolist() == [3.0, 3.0, 9.0]
    logs = np.array([1.0, -np.inf, 2.0, 0.5, 1.0, 1.0])
    assert cumulate(logs, LENGTHS).tolist() == [1.0, -np.inf, -np.inf, 0.5, 1.0, 2.0]
    logs[3:5] = -np.inf  # at a first row, twice: neither touches another episode
    assert cumulate(logs, LENGTHS).tolist() == [1.0, -np.inf, -np.inf, -np.inf, -np.inf, -np.inf]
    logs[4] = 1.0
    assert cumulate(logs, LENGTHS).tolist() == [1.0, -np.inf, -np.inf, -np.inf, 1.0, 2.0]
    with pytest.raises(UserError, match="7"):
        totals(np.arange(7.0), LENGTHS)
    # 10 + 2 * 1 + 0.5 * 3 * 2 + 0.25 * 0 * inf; 20 + 1 * 4; 30 + 1 * 5 + 0.5 * 1 * 6.
    weights, errors = np.array([2.0, 3.0, 0.0, 1.0, 1.0, 1.0]), np.array([1.0, 2.0, np.inf, 4.0, 5.0, 6.0])
    assert corrected(np.array([10.0, 20.0, 30.0]), weights, errors, LENGTHS, 0.5).tolist() == [15.0, 24.0, 38.0]


def test_switch_by_hand():
    """Weights 2, 6 | 0.5 | 3, 3: a threshold of 3 leaves out the second only."""
    lengths, begin = np.array([2, 1, 2]), np.array([1.0, 2.0, 3.0])
    logs = cumulate(np.log([2.0, 3.0, 0.5, 3.0, 1.0]), lengths)
    errors = np.array([1.0, 10.0, 4.0, 1.0, 1.0])
    found = switch_scores(begin, logs, errors, lengths, 0.5, np.array([0.0, 3.0 + 1e-9, np.inf]))
    assert found[0] == pytest.approx(begin)  # the critic alone
    assert found[1] == pytest.approx([1 + 2, 2 + 2, 3 + 3 + 1.5])
    assert found[2] == pytest.approx([1 + 2 + 30, 2 + 2, 3 + 3 + 1.5])  # doubly robust
    over = beyond(logs, lengths, 0.5, np.array([0.0, 3.0 + 1e-9, np.inf]))
    assert over.mean(1) == pytest.approx([(2 + 3 + 0.5 + 3 + 1.5) / 3, 3 / 3, 0.0])
    with pytest.raises(UserError, match="0 or more"):
        switch_scores(begin, logs, errors, lengths, 0.5, np.array([-1.0]))


def test_shrinkage_by_hand():
    w = np.array([0.0, 0.5, 2.0, 100.0])
    with np.errstate(divide="ignore"):
        logs = np.log(w)
    assert shrunk(logs, 4.0) == pytest.approx(4 * w / (w**2 + 4))
    assert shrunk(logs, np.inf) == pytest.approx(w)
    assert not shrunk(logs, 0.0).any()
    # It minimises what the paper says.
    for each in w[1:]:
        grid = np.linspace(0.0, 3.0, 30_001)
        best = grid[np.argmin(4.0 * (grid - each) ** 2 + each**2 * grid**2)]
        assert shrunk(np.log(each), 4.0) == pytest.approx(best, abs=1e-4)
    # Weights beyond all numbers vanish instead of overflowing.
    assert shrunk(np.array([800.0]), 4.0)[0] == 0.0
    with pytest.raises(UserError, match="lambda"):
        shrunk(logs, -1.0)


@pytest.fixture(scope="module")
def world():
    """A log of 4,000 episodes, a policy, and the exact critic and value."""
    true = garnet(states=5, actions=2, ending=0.25, noise=0.3)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.7, seed=1)[0]
    log = true.log(behavior, 4000, 60, np.random.default_rng(0))
    return log, behavior, target, true.q(target, 0.9), true.value(target, 0.9)


def inputs(world, shift=0.0, scale=1.0):
    """What the scores need, with a critic that is wrong by as much."""
    log, behavior, target, q, _ = world
    q = scale * q + shift
    v = (target * q).sum(1)
    state, after = log.observations.argmax(1), log.next_observations.argmax(1)
    ratios = np.log(target / behavior)[state, log.actions]
    errors = log.rewards + 0.9 * np.where(log.terminals, 0.0, v[after]) - q[state, log.actions]
    return v[state[log.starts]], cumulate(ratios, log.lengths), errors, log.lengths, 0.9


def test_no_bias_where_the_critic_has_none(world):
    """Whatever the threshold or lambda is: within 3.5 standard errors of the exact value."""
    for scores in (
        switch_scores(*inputs(world), np.array([0.0, 0.7, 1.5, np.inf])),
        shrinkage_scores(*inputs(world), np.array([0.1, 1.0, np.inf])),
    ):
        off = np.abs(scores.mean(1) - world[-1]) / (scores.std(1) / np.sqrt(scores.shape[1]))
        assert (off < 3.5).all(), off


def test_plain_weights_mend_a_wrong_critic(world):
    """The end of both grids is doubly robust; the critic alone is off by far more."""
    scores = switch_scores(*inputs(world, 1.0, 0.5), np.array([0.0, np.inf]))
    off = (scores.mean(1) - world[-1]) / (scores.std(1) / np.sqrt(scores.shape[1]))
    assert abs(off[1]) < 3.5
    assert abs(off[0]) > 10
    assert shrinkage_scores(*inputs(world, 1.0, 0.5), np.array([np.inf]))[0] == pytest.approx(scores[1])


def test_bounds_choose_what_is_least():
    scores = np.array([[0.0, 2.0, 0.0, 2.0], [0.9, 1.1, 0.9, 1.1]])
    assert least_bound(scores, np.array([0.0, 0.1])) == 1
    assert least_bound(scores, np.array([0.0, 0.7])) == 0
    term = np.log(40)
    gap = np.array([-0.9, 0.9, -0.9, 0.9])
    expected = [0.0, np.sqrt(2 * gap.var() * term / 4) + 2 * 0.9 * term / 12]
    assert bias_bound(scores, scores[0]) == pytest.approx(expected)
    with pytest.raises(UserError, match="1 episode"):
        least_bound(scores[:, :1], np.zeros(2))


def test_parameters_are_chosen_out_of_fold():
    """A choice never sees the fold whose scores it decides on."""
    rng = np.random.default_rng(0)
    scores, folds = rng.standard_normal((3, 30)), np.arange(30) % 3
    seen = []

    def choose(episodes):
        seen.append(episodes)
        return len(seen) - 1

    found, chosen = cross_fitted(scores, folds, choose)
    assert chosen.tolist() == [0, 1, 2]
    for fold, episodes in enumerate(seen):
        assert sorted(episodes) == np.flatnonzero(folds != fold).tolist()
    assert (found == scores[folds, np.arange(30)]).all()
    with pytest.raises(UserError, match="at least two"):
        cross_fitted(scores, np.zeros(30), choose)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["bound", "tail"])
def test_a_chosen_parameter_is_near_the_better_end(way):
    """Heavy one-step weights, and a critic without a flaw or useless: either end of the grid is best, and neither is known.
    """
    rng = np.random.default_rng(0)
    n = 400
    lengths = np.ones(n, int)
    grid = np.concatenate([[0.0], np.geomspace(0.5, 500.0, 12), [np.inf]])
    for shift in (0.0, 1.0):
        errors = []
        for _ in range(150):
            x = rng.standard_normal(n)
            logs = 1.6 * x - 1.6**2 / 2  # of a normal moved by 1.6: weights with mean one
            reward = rng.uniform(size=n)
            begin, error = np.full(n, 0.5 - shift), reward - 0.5 + shift
            scores = switch_scores(begin, logs, error, lengths, 1.0, grid)

            def choose(episodes, scores=scores, logs=logs):
                part = scores[:, episodes]
                if way == "tail":
                    return least_bound(part, beyond(logs[episodes], lengths[episodes], 1.0, grid).mean(1))
                return least_bound(part, bias_bound(part, part[-1]))

            found, _ = cross_fitted(scores, np.arange(n) % 2, choose)
            errors.append([found.mean() - 0.5, *(scores[[0, -1]].mean(1) - 0.5)])
        chosen, critic, robust = np.sqrt(np.mean(np.square(errors), 0))
        if shift == 0.0:
            assert chosen < 0.7 * robust, (chosen, robust)
        else:
            assert chosen < 1.25 * robust, (chosen, critic, robust)
