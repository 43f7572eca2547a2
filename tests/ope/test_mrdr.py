"""More robust doubly robust critics: by hand, and against the exact variance over all episodes of a small world."""

import itertools

import numpy as np
import pytest

from deadreckon.ope.mrdr import log_weights, mrdr_targets
from deadreckon.ope.sequences import corrected, cumulate

STATES, ACTIONS, STEPS, DISCOUNT = 3, 2, 3, 0.9


def test_weights_and_targets_by_hand():
    lengths, ratios, beta = np.array([2, 1]), np.array([2.0, 3.0, 0.5]), np.array([0.4, 0.2, 0.75])
    found = np.exp(log_weights(np.log(ratios), lengths, 0.5, np.log(beta)))
    assert found == pytest.approx([4 * 0.6, 0.25 * 36 * 0.8, 0.25 * 0.25])
    assert np.exp(log_weights(np.log(ratios), lengths, 0.5)) == pytest.approx([4, 0.25 * 36, 0.25])
    assert np.exp(log_weights(np.log(ratios), lengths, 0.0)) == pytest.approx([4, 0, 0.25])
    # (1 - beta) / beta^2 of a deterministic policy, as in the paper.
    beta, ones = np.array([0.2, 0.5]), np.ones(2, int)
    assert np.exp(log_weights(-np.log(beta), ones, 1.0, np.log(beta))) == pytest.approx((1 - beta) / beta**2)
    assert log_weights(np.full(4000, 5.0), np.array([4000]), 1.0)[-1] == pytest.approx(40_000)
    rewards = np.array([1.0, 2.0, 5.0])
    assert mrdr_targets(np.log(ratios), rewards, lengths, 0.5) == pytest.approx([1 + 0.5 * 3 * 2, 2, 5])
    for given in ((np.full(2, -np.inf), None), (np.zeros(2), np.zeros(2))):
        assert np.isneginf(log_weights(given[0], ones, 1.0, given[1])).all()


class World:
    """All episodes of three steps in a world of three states, with their probabilities under the log."""

    def __init__(self, deterministic: bool):
        rng = np.random.default_rng(3)
        flow = rng.dirichlet(np.ones(STATES), (STATES, ACTIONS))
        pay = rng.standard_normal((STATES, ACTIONS))
        beta = rng.dirichlet(np.full(ACTIONS, 2.0), STATES)
        pi = rng.dirichlet(np.full(ACTIONS, 2.0), STATES)
        pi = np.eye(ACTIONS)[pi.argmax(1)] if deterministic else pi
        self.s, self.a, self.p = [], [], []
        for path in itertools.product(range(STATES), range(ACTIONS), repeat=STEPS):
            s, a = path[::2], path[1::2]
            p = np.prod(beta[s, a]) / STATES * np.prod([flow[s[t], a[t], s[t + 1]] for t in range(STEPS - 1)])
            self.s.append(s)
            self.a.append(a)
            self.p.append(p)
        self.s, self.a, self.p = np.ravel(self.s), np.ravel(self.a), np.array(self.p)
        self.pi, self.beta, self.rewards = pi, beta, pay[self.s, self.a]
        with np.errstate(divide="ignore"):
            self.ratios = np.log(pi / beta)[self.s, self.a]
        self.lengths = np.full(len(self.p), STEPS)
        # Too few features for the truth: a constant, and the number of the state plus the action.
        state, action = np.meshgrid(np.arange(STATES), np.arange(ACTIONS), indexing="ij")
        self.features = np.stack([np.ones_like(state), state + action], -1).astype(float)
        self.targets = mrdr_targets(self.ratios, self.rewards, self.lengths, DISCOUNT)

    def variance(self, theta):
        """Of the doubly robust score of one episode, with that critic."""
        q = self.features @ theta
        v = (self.pi * q).sum(1)[self.s].reshape(-1, STEPS)
        after = np.concatenate([v[:, 1:], np.zeros((len(v), 1))], 1).ravel()
        errors = self.rewards + DISCOUNT * after - q[self.s, self.a]
        scores = corrected(v[:, 0], np.exp(cumulate(self.ratios, self.lengths)), errors, self.lengths, DISCOUNT)
        return self.p @ (scores - self.p @ scores) ** 2, self.p @ scores

    def least_squares(self, weights):
        """The reference solver: any weighted fit of the targets at the logged actions."""
        x, w = self.features[self.s, self.a], weights * np.repeat(self.p, STEPS)
        return np.linalg.lstsq(x.T @ (w[:, None] * x), x.T @ (w * self.targets), rcond=None)[0]


@pytest.fixture(scope="module", params=[True, False], ids=["deterministic", "stochastic"])
def world(request):
    return request.param, World(request.param)


def test_the_critic_of_least_variance(world):
    """For a deterministic policy nothing near has less than that of these weights; plain least squares has more for any."""
    deterministic, world = world
    behavior = np.log(world.beta)[world.s, world.a]
    best = world.least_squares(np.exp(log_weights(world.ratios, world.lengths, DISCOUNT, behavior)))
    least, value = world.variance(best)
    rng = np.random.default_rng(0)
    for _ in range(50):
        near, same = world.variance(best + 0.1 * rng.standard_normal(2))
        if deterministic:
            assert near >= least - 1e-9
        assert same == pytest.approx(value)  # without bias, whatever the critic
    plain = world.variance(world.least_squares(np.ones(len(world.s))))[0]
    assert least < plain
    assert world.variance(world.least_squares(np.exp(log_weights(world.ratios, world.lengths, DISCOUNT))))[0] < plain
