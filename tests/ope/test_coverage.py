"""How much of what policies do a log covers, against shares known in closed form, and what a choice makes of it."""

import numpy as np
import pytest
from scipy.stats import norm

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.ope import OPEInput, coverage, select
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.support import MISSING, Support
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


def likely(seen: np.ndarray, pre: np.ndarray) -> np.ndarray:
    """The log's own log-density of tanh(pre); what is beyond 0.95 counts as that."""
    pre = np.clip(pre, -np.arctanh(0.95), np.arctanh(0.95))
    return norm.logpdf(pre, 0.5 * seen, STD) - np.log(1 - np.tanh(pre) ** 2)


@pytest.mark.slow
def test_shares_of_gaussian_policies():
    asked = {"same": (0.0, STD), "wider": (0.0, 3 * STD), "mean": (0.0, 0.0), "beside": (2.0 * STD, STD), "far": (4 * STD, 0.0)}
    case = OPEInput(log(2000, 40), [bent(*each) for each in asked.values()], names=list(asked))
    model = BehaviorModel(hidden=(), steps=3000, lr=3e-3)
    found = coverage(case, model)
    rng = np.random.default_rng(1)
    seen, noise = rng.standard_normal((2, 400_000))
    bound = np.quantile(likely(seen, 0.5 * seen + STD * noise), 0.01)
    exact = [(likely(seen, 0.5 * seen + shift + std * noise) >= bound).mean() for shift, std in asked.values()]
    assert 0.5 < exact[1] < 0.9
    assert 0.5 < exact[3] < 0.9
    np.testing.assert_allclose(found, exact, atol=0.05)
    assert coverage(case, model) is found  # made once


@pytest.mark.slow
def test_a_model_that_knows_its_few_rows_by_heart_does_not_rule_out_the_logs_own_policy():
    model = BehaviorModel(hidden=(64, 64), steps=2000, lr=3e-3)
    same, far = coverage(OPEInput(log(40, 20), [bent(0.0, STD), bent(6 * STD, 0.0)]), model)
    assert same > 0.95
    assert far < 0.4


@pytest.mark.slow
def test_actions_at_the_bounds_are_like_those_beside_them():
    """Draws that are cut at the bounds, as many a controller's are: a tanh's density has no limit there."""
    rng = np.random.default_rng(0)
    seen = rng.standard_normal((4000, 1))
    cut = Dataset.from_arrays(
        observations=seen, actions=np.clip(0.6 * rng.standard_normal((4000, 1)), -1, 1), rewards=seen[:, 0],
        timeouts=np.arange(4000) % 20 == 19, final_observations=np.zeros((200, 1)), action_space=Box([-1.0], [1.0]), name="cut",
    )  # fmt: skip
    still = [BlackBoxPolicy(lambda seen, rng, a=a: np.full_like(seen, a)) for a in (0.0, 0.5, 0.96, 0.999, 1.0)]
    assert (coverage(OPEInput(cut, still), BehaviorModel(hidden=(), steps=2000, lr=3e-3)) > 0.9).all()


@pytest.mark.slow
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
    found = coverage(OPEInput(taken, policies, discount=0.0), BehaviorModel(hidden=(), steps=1500, lr=1e-2))
    np.testing.assert_allclose(found, [0.5, 1.0, 0.0], atol=0.02)


@pytest.mark.parametrize(("episodes", "length"), [(1, 500), (9, 10)])
def test_short_logs_tell_nothing(episodes, length):
    assert np.isnan(coverage(OPEInput(log(episodes, length), [bent(0.0, STD)]))).all()


@pytest.mark.slow
def test_a_long_episode_among_short_ones_is_learned_from():
    """Held out it would leave the model too few rows."""
    short, rng = log(60, 20), np.random.default_rng(1)
    seen = rng.standard_normal((9000, 1))
    actions = 2 * np.tanh(0.5 * seen + STD * rng.standard_normal(seen.shape))
    long = Dataset.from_arrays(
        observations=np.concatenate([short.observations, seen]), actions=np.concatenate([short.actions, actions]),
        rewards=np.zeros(10_200), timeouts=np.concatenate([short.timeouts, np.arange(9000) == 8999]),
        final_observations=np.zeros((61, 1)), action_space=Box([-2.0], [2.0]), name="long",
    )  # fmt: skip
    model, policies = BehaviorModel(hidden=(), steps=2000, lr=3e-3), [bent(0.0, STD), bent(6 * STD, 0.0)]
    for seed in range(3):
        same, far = coverage(OPEInput(long, policies, seed=seed), model)
        assert same > 0.9
        assert far < 0.2


def test_what_the_log_does_not_cover_comes_last():
    draws = np.random.default_rng(0).standard_normal((200, 2)) * 0.1 + [18.0, 3.0]
    found = estimates("FQE-L2", [18.0, 3.0], draws)
    assert select([found]).name == "a"
    choice = select([found], lacking([MISSING + 0.01, MISSING]))
    assert choice.name == "b"
    assert choice.deploy
    assert choice.warnings == ("a: 11 % of its actions have no support in the log",)
    alone = select([found], lacking([0.8, 0.9]))
    assert not alone.deploy
    assert alone.name == "a"
    assert "but 80 % of its actions have no support in the log" in alone.reason
    short = select([found], Support(np.zeros(2), np.full(2, 0.7), np.array([0.94, 0.96]), np.zeros(2, bool)))
    assert short.objections[0][0].startswith("its importance weights average 0.70 per step instead of 1 (at most 0.94")
    assert not short.objections[1]
    unknown = select([found], lacking(np.full(2, np.nan)))
    assert (unknown.name, unknown.warnings) == ("a", ("the log is too short to tell how many of a's actions have support",))
    with pytest.raises(UserError, match="a number for each of 2 policies, got 3"):
        select([found], lacking(np.zeros(3)))


def lacking(missing):
    """Support by the share of actions without it alone."""
    nothing = np.full(len(missing), np.nan)
    return Support(np.asarray(missing, float), nothing, nothing, np.zeros(len(missing), bool))
