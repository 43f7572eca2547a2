"""One-step logs with true propensities: the Open Bandit sample, each policy estimated from the other's log."""

import numpy as np
import pytest
from pyarrow import csv

from deadreckon.data.dataset import Dataset
from deadreckon.ope import FQE, DoublyRobust, ImportanceSampling, OPEInput
from deadreckon.policies import BlackBoxPolicy

ITEMS = 34


def read(folder, name):
    table = csv.read_csv(folder / "open_bandit" / f"{name}_men.csv.gz")
    # All items in both logs' action spaces, whichever were shown.
    return Dataset.from_frame(
        table, action="item_id", reward="click", propensity="propensity_score", observations="position", name=name
    )


@pytest.fixture(scope="module")
def logs(real_data):
    return read(real_data, "random"), read(real_data, "bts")


def as_policy(table: np.ndarray, log: Dataset) -> BlackBoxPolicy:
    """(positions, items) probabilities as a policy of the shown position."""
    places = np.unique(log.observations)
    probs = lambda seen: table[np.searchsorted(places, seen[:, 0])]  # noqa: E731

    def draw(seen, rng):
        return (rng.random(len(seen))[:, None] >= probs(seen).cumsum(1)[:, :-1]).sum(1)

    return BlackBoxPolicy(draw, action_probs=probs)


def shown(log: Dataset) -> np.ndarray:
    """(positions, items) how often each item was shown at each position."""
    places = np.unique(log.observations)
    counts = np.zeros((len(places), ITEMS))
    np.add.at(counts, (np.searchsorted(places, log.observations[:, 0]), log.actions), 1.0)
    return counts / counts.sum(1, keepdims=True)


@pytest.mark.slow
def test_the_logs_are_bandits(logs):
    for log in logs:
        assert log.episodes == len(log) == 10_000
        assert log.terminals.all()
        assert log.spec.action_size == ITEMS
    np.testing.assert_allclose(np.exp(logs[0].extras["behavior_log_probs"]), 1 / ITEMS, rtol=1e-5)


ESTIMATORS = {
    "ips": ImportanceSampling(normalised=False, interval="t"),
    "snips": ImportanceSampling(),
    "dr": DoublyRobust(kind="dr", fqe=FQE(members=2, hidden=(), steps=1500, lr=3e-3)),
}
# Critics are slow to train on these logs, and are looked at where they are exact.
each = pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n == "dr" else ()) for n in ESTIMATORS])


@each
def test_the_uniform_policy_from_the_thompson_sampling_log(logs, name):
    random, bts = logs
    uniform = as_policy(np.full((3, ITEMS), 1 / ITEMS), bts)
    found = ESTIMATORS[name].on(OPEInput(bts, uniform, discount=0.0))
    there = random.rewards.mean()
    error = random.rewards.std() / np.sqrt(len(random))
    # Both are estimates: their difference has the error of both.
    half = (found.high[0] - found.low[0]) / 2 / 1.96
    assert abs(found.value[0] - there) < 2.5 * np.hypot(half, error)
    assert 0.0 < found.value[0] < 0.02
    assert found.ess[0] < 10_000


@each
def test_the_thompson_sampling_policy_from_the_uniform_log(logs, name):
    """Its probabilities changed from round to round; on average it showed what it showed."""
    random, bts = logs
    policy = as_policy(shown(bts), random)
    found = ESTIMATORS[name].on(OPEInput(random, policy, discount=0.0))
    error = bts.rewards.std() / np.sqrt(len(bts))
    half = (found.high[0] - found.low[0]) / 2 / 1.96
    assert abs(found.value[0] - bts.rewards.mean()) < 2.5 * np.hypot(half, error)


def test_a_log_estimates_its_own_policy_as_its_mean(logs):
    for log in logs:
        case = OPEInput(log, as_policy(shown(log), log), discount=0.0, logged=True)
        for estimator in (ESTIMATORS["ips"], ESTIMATORS["snips"]):
            found = estimator.on(case)
            assert found.value[-1] == pytest.approx(log.rewards.mean())
            # How often each item was shown is nearly the policy: its weights are near one.
            assert found.value[0] == pytest.approx(log.rewards.mean(), rel=0.2)
            assert found.low[0] < log.rewards.mean() < found.high[0]
