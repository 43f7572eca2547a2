"""Estimators that weight logged rewards, by name, against exact values of a small world; and what they know of nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.ope import FQE, LOGGED, BehaviorModel, DoublyRobust, LinearFQE, OPEInput, estimator
from deadreckon.ope import linear as linear_critics
from deadreckon.ope.registry import ESTIMATORS, PUBLIC, with_fields
from deadreckon.theory import MDP, chain, garnet
from tests.ope.test_case import linear, lqr
from tests.ope.worlds import as_policy, tables

NEW = ("switch", "dros", "mrdr", "smis")
SOLVED = ("is", "pdis", "wis", "dr-linear", "drl", *NEW)  # nothing to train where propensities are logged
SMALL = {"steps": 150, "members": 2, "hidden": (8,), "batch_size": 64}
WORLDS = {  # of a discount, a horizon, and whether episodes end by themselves
    "ends": (0.9, None, 0.3),
    "horizon": (1.0, 4, 0.1),
    "one step": (0.0, 1, 0.0),
}


def exact(true, policy, discount, horizon):
    if horizon is None:
        return true.value(policy, discount)
    value, reach = 0.0, true.initial
    for t in range(horizon):
        value += discount**t * float((reach[:, None] * policy * true.rewards).sum())
        reach = np.einsum("s,sa,sat->t", reach, policy, true.transitions)
    return value


@pytest.fixture(scope="module", params=WORLDS)
def world(request):
    discount, horizon, ending = WORLDS[request.param]
    true = garnet(states=5, actions=2, ending=ending, noise=0.3)
    policies = [*tables(true, 1, 0.2), *tables(true, 1, 0.7, seed=1)]
    log = true.log(policies[0], 1500, horizon or 60, np.random.default_rng(3))
    case = OPEInput(log, [as_policy(p) for p in policies], discount=discount, horizon=horizon, logged=True)
    return case, np.array([exact(true, p, discount, horizon) for p in (*policies, policies[0])])


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVED)
def test_values_are_true_within_their_intervals(world, name):
    case, values = world
    found = estimator(name).on(case)
    half = (found.high - found.low) / 2
    assert found.corrected
    assert (np.abs(found.value - values) < 2.0 * half).all(), (found.value, values, half)
    assert (half < 6.0 * case.data.returns(case.discount).std() / np.sqrt(case.data.episodes)).all()
    assert found.influence.shape == (case.episodes.groups, 3)
    np.testing.assert_allclose(found.influence.mean(0), 0.0, atol=1e-9)
    # The behaviour policy is worth what the log got, and paired gains are surer than values.
    assert found.value[2] == pytest.approx(case.data.returns(case.discount).mean(), rel=1e-4 if name != "drl" else 0.1)
    assert found.diagnostics.get("pareto k", np.zeros(3))[2] <= 0.0


# Those with critics fit them in each of the logs; the fast one is of fewer logs.
@pytest.mark.parametrize(
    ("name", "logs"), [("smis", 60), *(pytest.param(n, 200, marks=pytest.mark.slow) for n in NEW)], ids=str
)
def test_the_truth_lies_within_hardly_less_often_than_promised(name, logs):
    """In 53 of 60 logs, or 182 of 200: of intervals of 95 %, fewer are within with a chance of one in a hundred."""
    true = garnet(states=4, actions=2, ending=0.3, noise=0.3)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.5, seed=1)[0]
    rng, truth = np.random.default_rng(1), true.value(target, 0.9)
    inside = []
    for _ in range(logs):
        case = OPEInput(true.log(behavior, 200, 60, rng), [as_policy(target)], discount=0.9)
        found = with_fields(estimator(name), {"ridge": 1.0}).on(case)
        inside.append(found.low[0] <= truth <= found.high[0])
    assert sum(inside) >= stats.binom.ppf(0.01, logs, 0.95), np.mean(inside)


@pytest.mark.slow
def test_critics_of_least_variance_have_less_of_it():
    """One step, an action that the log seldom takes and the policy always: what matters is the fit there."""
    rng = np.random.default_rng(0)
    n, x = 400, None
    errors = {"dr-linear": [], "mrdr": []}
    for _ in range(25):
        x = rng.uniform(-1, 1, n)
        rare = rng.random(n) < np.where(x > 0, 0.05, 0.5)
        action = np.where(rare, 1, 0)
        reward = np.where(action == 1, np.where(x > 0, 3.0 * x, -1.0), x**2) + 0.1 * rng.standard_normal(n)
        chance = np.where(x > 0, 0.05, 0.5)
        log = one_step(x[:, None], action, reward, np.where(rare, chance, 1 - chance))
        always = as_policy_of(lambda seen: np.tile([0.0, 1.0], (len(seen), 1)))
        for name in errors:
            made = with_fields(estimator(name), {"fourier_features": 1, "ridge": 1e-3})
            found = made.on(OPEInput(log, [always], discount=0.0))
            errors[name].append(found.value[0] - (3.0 * 0.25 - 0.5))
    spread = {name: np.std(values) for name, values in errors.items()}
    assert spread["mrdr"] < spread["dr-linear"], spread


def as_policy_of(probs):
    from deadreckon.policies import BlackBoxPolicy

    return BlackBoxPolicy(lambda seen, rng: probs(seen).argmax(1), action_probs=probs)


def one_step(observations, actions, rewards, chances, **extras):
    n = len(actions)
    return Dataset.from_arrays(
        observations=observations.astype(np.float32), actions=actions.astype(np.int64), rewards=rewards.astype(np.float32),
        terminals=np.ones(n, bool), timeouts=np.zeros(n, bool), final_observations=observations.astype(np.float32),
        action_space=Discrete(2), behavior_log_probs=np.log(chances).astype(np.float32), name="one step", **extras,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SOLVED, "plain-dr", "magic", "dr"])
def test_no_overlap_is_no_knowledge(name):
    """A policy that takes no logged action: its interval is endless, whatever the critics make up."""
    rng = np.random.default_rng(0)
    seen = np.eye(3)[rng.integers(0, 3, 200)]
    log = one_step(seen, np.zeros(200), rng.random(200), np.full(200, 0.5))
    never = as_policy(np.tile([0.0, 1.0], (3, 1)))
    case = OPEInput(log, [never, as_policy(np.full((3, 2), 0.5))], discount=0.0, names=["never", "half"], logged=True)
    found = with_fields(estimator(name), SMALL).on(case)
    assert found.ess[0] == 0.0
    assert (found.low[0], found.high[0]) == (-np.inf, np.inf)
    assert np.isfinite([found.low[1], found.high[1], found.low[2], found.high[2]]).all() or name == "magic"


def test_what_cannot_be_done_is_said_in_a_line():
    log = lqr(-0.5, 0.5, 30, 10)  # continuous, cut off
    log = replace(log, extras={"behavior_log_probs": linear(-0.5, 0.5).log_prob(log.observations, log.actions)})
    case = OPEInput(log, [linear(-0.5, 0.5)], discount=0.9)
    with pytest.raises(UserError, match="smis needs discrete actions and few different observations"):
        estimator("smis").on(case)
    with pytest.raises(UserError, match="mrdr is fitted to returns, and 30 episodes are cut off"):
        estimator("mrdr").on(case)
    short = OPEInput(log, [linear(-0.6, 0.5)], discount=0.9, horizon=3)
    assert np.isfinite(with_fields(estimator("mrdr"), {"ridge": 10.0}).on(short).value).all()
    for kind in ("switch", "mrdr"):
        with pytest.raises(UserError, match="folds of 2 or more"):
            DoublyRobust(kind=kind, fqe=LinearFQE(), folds=1).on(case)
    with pytest.raises(UserError, match="needs fqe=LinearFQE"):
        DoublyRobust(kind="mrdr").on(case)


@pytest.mark.slow
def test_cut_off_episodes_count_by_their_chance_to_go_on():
    """Episodes that are cut at random: doubly robust ones with a trusted weight agree with the world that goes on."""
    true = garnet(states=4, actions=2, ending=0.15, noise=0.2)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.5, seed=1)[0]
    rng = np.random.default_rng(1)
    parts = [true.log(behavior, 600, steps, rng) for steps in (3, 8, 60)]
    columns = ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations")
    log = Dataset.from_arrays(
        **{key: np.concatenate([getattr(part, key) for part in parts]) for key in columns},
        action_space=parts[0].action_space,
        behavior_log_probs=np.concatenate([part.extras["behavior_log_probs"] for part in parts]),
    )
    case = OPEInput(log, [as_policy(target)], discount=0.9)
    assert not case.episodes.even
    for name in ("switch", "dros", "dr-linear"):
        found = estimator(name).on(case)
        assert found.low[0] < true.value(target, 0.9) < found.high[0], name
        assert found.value[0] == pytest.approx(true.value(target, 0.9), abs=0.25 * abs(true.value(target, 0.9)) + 0.1)


@pytest.mark.slow
def test_a_critic_that_memorises_is_told():
    rng = np.random.default_rng(0)
    seen = rng.standard_normal((120, 4))
    log = one_step(seen, rng.integers(0, 2, 120), rng.standard_normal(120), np.full(120, 0.5))
    half = as_policy_of(lambda x: np.full((len(x), 2), 0.5))
    loud = DoublyRobust(kind="dr", fqe=LinearFQE(ridge=1e-6)).on(OPEInput(log, [half], discount=0.0, logged=True))
    assert loud.diagnostics["residual"][0] > 1.5 * loud.diagnostics["training residual"][0]
    assert any("overfit" in line for line in loud.warnings)
    quiet = DoublyRobust(kind="dr", fqe=LinearFQE(ridge=1e5)).on(OPEInput(log, [half], discount=0.0, logged=True))
    assert not any("overfit" in line for line in quiet.warnings)
    assert LOGGED in quiet.names
    assert set(NEW) <= set(ESTIMATORS)


@pytest.mark.slow
def test_linear_critics_of_one_fold_are_those_of_the_world_in_the_log():
    """As the public code has it: fitted to the rows that they correct. A table's are exact there."""
    world = garnet(states=4, actions=2, ending=0.3, noise=0.3)
    behavior, target = tables(world, 2, 0.5)
    log = world.log(behavior, 100, 40, np.random.default_rng(0))
    case = OPEInput(log, [as_policy(target)], discount=0.9)
    one = DoublyRobust(kind="dr", fqe=LinearFQE(ridge=1e-6), folds=1)
    assert one.nuisances(case)[0].begins.mean() == pytest.approx(MDP.of(log).value(target, 0.9), rel=1e-4)
    assert np.isfinite(one.replace(behavior="learned", model=BehaviorModel(steps=10)).on(case).low).all()
    public = with_fields(estimator("dr-linear", **PUBLIC), {"model": {"steps": 10}})
    assert np.isfinite(public.on(case).value).all()
    assert np.isnan(one.replace(kind="magic").on(case).low).all()  # one critic, whose error nobody knows


def test_critics_of_folds_know_what_taught_them(monkeypatch):
    """The share that each lacks is of what teaches, and each says of all starts what it says of its own, which are alike."""
    monkeypatch.setattr(linear_critics, "TAUGHT", 100)
    world = chain(4, slip=0.2, noise=0.3)
    behavior, target = tables(world, 2, 0.5)
    log = world.log(behavior, 200, 40, np.random.default_rng(0))
    case = OPEInput(log, [as_policy(target)], discount=0.9, held=np.arange(30), logged=True)
    taught = case.teaching(100).data.episodes
    assert taught < 170
    told = DoublyRobust(kind="magic", fqe=LinearFQE(), folds=3).nuisances(case)[0]
    assert told.left_out == pytest.approx(10 / (30 + taught))
    fold = case.folds(3)
    assert (case.data.observations[case.data.starts] == case.data.observations[0]).all()
    own = [told.begins[0, fold == k].mean() for k in range(3)]
    np.testing.assert_allclose(told.by_fold()[:, 0], own, rtol=1e-6)
    networks = FQE(hidden=(4,), steps=2).out_of_fold(case, 3, 1)
    assert networks.left_out == pytest.approx(10 / 200)
    assert networks.by_fold().shape == (3, 2)
