"""How much of what policies do a log covers, against shares known in closed form, and what a choice makes of it."""

import numpy as np
import pytest
from scipy.stats import norm

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.ope import Case, coverage, select
from deadreckon.ope.coverage import MOSTLY
from deadreckon.ope.estimate import BehaviorModel
from deadreckon.policies import BlackBoxPolicy
from tests.ope.test_select import estimates

STD = 0.3  # of the logged actions before the tanh, around 0.5 times the observation


def bent(shift: float, std: float) -> BlackBoxPolicy:
    """tanh(0.5 s + shift + std noise), with the log's bounds of -2 .. 2."""
    return BlackBoxPolicy(lambda seen, rng: 2 * np.tanh(0.5 * seen + shift + std * rng.standard_normal(seen.shape)))


def log(episodes: int, length: int) -> Dataset:
    rng = np.random.default_rng(0)
    seen = rng.standard_normal((episodes * length, 1))
    return Dataset.from_arrays(
        observations=seen, actions=2 * np.tanh(0.5 * seen + STD * rng.standard_normal(seen.shape)), rewards=seen[:, 0],
        timeouts=np.arange(len(seen)) % length == length - 1, final_observations=np.zeros((episodes, 1)),
        action_space=Box([-2.0], [2.0]), name="bent",
    )  # fmt: skip


def test_shares_of_gaussian_policies():
    """With the log's deviation 1, an action is covered up to 2.576 from the mean."""
    asked = {"same": (0.0, STD), "wider": (0.0, 2 * STD), "mean": (0.0, 0.0), "beside": (2.0 * STD, STD), "far": (4 * STD, 0.0)}
    case = Case(log(400, 40), [bent(*each) for each in asked.values()], names=list(asked))
    found = coverage(case, BehaviorModel(hidden=(), steps=3000, lr=3e-3))
    edge = norm.ppf(0.995)
    exact = [0.99, 2 * norm.cdf(edge / 2) - 1, 1.0, norm.cdf(edge - 2) - norm.cdf(-edge - 2), 0.0]
    np.testing.assert_allclose(found, exact, atol=0.05)
    assert coverage(case, BehaviorModel(hidden=(), steps=3000, lr=3e-3)) is found  # made once


def test_a_model_that_knows_its_few_rows_by_heart_does_not_rule_out_the_logs_own_policy():
    model = BehaviorModel(hidden=(64, 64), steps=2000, lr=3e-3)
    assert coverage(Case(log(40, 10), [bent(0.0, STD)]), model)[0] > 0.9


def test_discrete_actions():
    """The log takes two of four actions; a policy of all four is covered by half."""
    rng = np.random.default_rng(0)
    rows = 2000
    taken = Dataset.from_arrays(
        observations=rng.standard_normal((rows, 2)), actions=rng.integers(0, 2, rows), rewards=np.zeros(rows),
        timeouts=np.ones(rows, bool), final_observations=np.zeros((rows, 2)), action_space=Discrete(4), name="two of four",
    )  # fmt: skip

    def policy(chances):
        told = lambda seen: np.tile(chances, (len(seen), 1))  # noqa: E731
        return BlackBoxPolicy(lambda seen, rng: rng.choice(4, len(seen), p=chances), action_probs=told)

    policies = [policy(chances) for chances in ([0.25] * 4, [0.9, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])]
    found = coverage(Case(taken, policies, discount=0.0), BehaviorModel(hidden=(), steps=1500, lr=1e-2))
    np.testing.assert_allclose(found, [0.5, 1.0, 0.0], atol=0.02)


def test_one_episode_tells_nothing():
    assert np.isnan(coverage(Case(log(1, 50), [bent(0.0, STD)]))).all()


def test_what_the_log_does_not_cover_comes_last():
    draws = np.random.default_rng(0).standard_normal((200, 2)) * 0.1 + [18.0, 3.0]
    found = estimates("FQE-L2", [18.0, 3.0], draws)
    assert select([found]).name == "a"
    choice = select([found], np.array([MOSTLY - 0.01, MOSTLY]))
    assert choice.name == "b"
    assert choice.deploy
    assert choice.warnings == ("the log covers less than 67 % of what these do, estimates of them are guesses: a (66 %)",)
    alone = select([found], np.array([0.2, 0.1]))
    assert not alone.deploy
    assert alone.name == "a"
    assert "but only 20 % of what it does is covered by the log" in alone.reason
    unknown = select([found], np.full(2, np.nan))
    assert (unknown.name, unknown.warnings) == ("a", ())
    with pytest.raises(UserError, match="a number for each of 2 policies, got 3"):
        select([found], np.ones(3))
