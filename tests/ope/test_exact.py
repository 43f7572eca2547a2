"""Every estimator against exact solutions of small worlds.

Those that fit something are compared with the exact solution of the world that the log itself describes (`MDP.of`): with one
parameter for each state and action that is what they must come to, without any sampling error to hide in. Those that weight are
compared with the true world, and are unbiased over many logs or lie within their intervals.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.ope import DICE, FQE, FQED, VPM, DoublyRobust, ImportanceSampling, LinearFQE, OPEInput
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.decide import decide
from deadreckon.ope.estimates import LOGGED
from deadreckon.ope.select import gains
from deadreckon.stats.interval import ALPHA
from deadreckon.theory import MDP, chain, garnet, gridworld
from tests.ope.worlds import as_policy, keep_nuisances, tables

DISCOUNT = 0.9
FQE_L2 = FQE(members=1, hidden=(), steps=3000, lr=2e-2, weight_decay=0.0, tau=0.05, batch_size=256)
DICES = {"members": 1, "hidden": (), "steps": 25_000, "lr": 1e-3, "batch_size": 128, "ema_rate": 2e-4}
FITTED = {
    "fqe": FQE_L2,
    "fqe-d": FQED(members=1, hidden=(), steps=3000, lr=2e-2, batch_size=256, atoms=31, target_update_period=30),
    "best-dice": DICE.preset("best", **DICES),
    "dual-dice": DICE.preset("dual", **DICES | {"lr": 3e-3}),  # without lambda its mass is slow to settle
    "gen-dice": DICE.preset("gen", **DICES),
    "vpm": VPM(members=1, hidden=(), steps=3000, lr=5e-3, batch_size=256),
}
WEIGHTED = {
    "is": ImportanceSampling(kind="trajectory", normalised=False),
    "wis": ImportanceSampling(kind="trajectory"),
    "pdis": ImportanceSampling(normalised=False),
    "wpdis": ImportanceSampling(),
    "dr": DoublyRobust(kind="dr", fqe=FQE_L2),
    "wdr": DoublyRobust(kind="wdr", fqe=FQE_L2),
    "magic": DoublyRobust(kind="magic", fqe=FQE_L2.replace(members=3, lr=3e-3, steps=5000)),
}
WORLDS = {
    "chain": chain(4, slip=0.2, noise=0.3),  # ends, and pays at the end only
    "ends": garnet(states=6, actions=2, ending=0.15, noise=0.5),
    "goes on": garnet(states=6, actions=2, noise=0.5, seed=1),  # timeouts alone
    "grid": gridworld(3, 3, slip=0.3),  # a goal far from the start
}


def cases(names, fast=()):
    """Every method in every world; only those pairs of a world and a method that are `fast` are not slow."""
    pairs = [(world, name) for world in WORLDS for name in names]
    return pytest.mark.parametrize(
        ("world", "name"), indirect=["world"],
        argvalues=[pytest.param(*pair, marks=() if pair in fast else pytest.mark.slow) for pair in pairs],
    )  # fmt: skip


@cache
def case_in(name):
    """A case of three policies, the first of which made the log; tests share what is fitted for it."""
    true = WORLDS[name]
    policies = [*tables(true, 1, 0.2), *tables(true, 2, 0.6, seed=1)]
    log = true.log(policies[0], 800, 40, np.random.default_rng(0), name=name)
    case = OPEInput(log, [as_policy(p) for p in policies], discount=DISCOUNT)
    return case, true, policies


@pytest.fixture
def world(request):
    return case_in(request.param)


# Losses of the DICE family and of VPM are known to golden numbers; distributions of returns have fast tests of their own.
@cases(FITTED, fast=[("ends", "fqe")])
def test_fitted_values_are_those_of_the_world_in_the_log(world, name):
    case, _, policies = world
    seen = MDP.of(case.data)
    exact = np.array([seen.value(p, DISCOUNT) for p in policies])
    scale = np.abs(seen.q(policies[0], DISCOUNT)).max()
    found = FITTED[name].on(case)
    np.testing.assert_allclose(found.value, exact, atol=0.05 * scale, err_msg=name)


def test_distributions_of_one_step_have_its_mean_reward():
    """Whatever the discount, which counts nothing there: action 0 earns -1 and action 1 earns 3."""
    actions = np.arange(200) % 2
    log = Dataset.from_arrays(
        observations=np.ones((200, 1)), actions=actions, rewards=np.array([-1.0, 3.0])[actions], terminals=np.ones(200, bool)
    )
    chances = np.array([[0.5, 0.5], [0.1, 0.9]])
    fitted = FQED(members=1, hidden=(), steps=200, lr=0.1, batch_size=64, atoms=5)
    found = fitted.estimate(log, [as_policy(each[None]) for each in chances], discount=0.9, horizon=1)
    np.testing.assert_allclose(found.value, chances @ [-1.0, 3.0], atol=0.1)


@cases([name for name in FITTED if "dice" in name or name == "vpm"])
def test_ratios_are_those_of_exact_occupancies(world, name):
    case, _, policies = world
    data, seen = case.data, MDP.of(case.data)
    where = data.observations.argmax(1), data.actions
    logged = np.zeros((seen.states, seen.actions))
    np.add.at(logged, where, 1.0 / len(data))
    ratios = FITTED[name].ratios(case)[0]
    for policy, found in zip(policies, ratios):
        exact = (seen.occupancy(policy, DISCOUNT) / np.maximum(logged, 1e-12))[where]
        assert np.abs(found - exact).mean() < 0.1 * exact.mean()


# What corrects critics has to fit them first, and has tests of its own.
@cases(WEIGHTED, fast=[(world, name) for world in ("chain", "ends", "goes on") for name in ("is", "wis", "pdis", "wpdis")])
def test_weighted_values_are_true_within_their_intervals(world, name):
    case, true, policies = world
    exact = np.array([true.value(p, DISCOUNT) for p in policies])
    found = WEIGHTED[name].on(case)
    half = (found.high - found.low) / 2
    assert (half > 0).all()
    assert (np.abs(found.value - exact) < 2.0 * half).all()
    # An interval that is wide enough for anything says nothing.
    assert half[0] < 6.0 * case.data.returns(DISCOUNT).std() / np.sqrt(case.data.episodes)


# That corrections of critics are unbiased is looked at in test_decide.py too, with critics that are solved.
MORE = [pytest.param(name, marks=pytest.mark.slow) for name in ("pdis", "wis", "dr", "wdr")]


@pytest.mark.parametrize("name", ["is", "wpdis", *MORE])
def test_mean_over_many_logs(name):
    """Plain weights are unbiased for the return within the log's horizon; self-normalised ones nearly so."""
    true = garnet(states=4, actions=2, ending=0.3, noise=0.3)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.7, seed=1)[0]
    exact = true.value(target, DISCOUNT)
    rng = np.random.default_rng(0)
    estimator, small = WEIGHTED[name], 0.02 if name.startswith("w") else 0.0
    wrong = FQE_L2.replace(steps=20)  # a poor value function: doubly robust all the same
    if name in ("dr", "wdr"):
        estimator = estimator.replace(fqe=wrong)
        critics = wrong.fitted(OPEInput(true.log(behavior, 50, 60, rng), [as_policy(target)], discount=DISCOUNT))
    values = []
    for _ in range(75):
        case = OPEInput(true.log(behavior, 50, 60, rng), [as_policy(target)], discount=DISCOUNT)
        if name in ("dr", "wdr"):
            case.once(wrong, lambda: critics)  # not of this log: its errors are independent of the log's
        values.append(estimator.on(case).value[0])
    error = np.mean(values) - exact
    assert abs(error) < small * abs(exact) + 3.5 * np.std(values) / np.sqrt(len(values)), (np.mean(values), exact)


def test_ended_episodes_count():
    """Where episodes end early, forgetting the ended ones (as the public code does) is wrong by a factor."""
    true = garnet(ending=0.2, noise=0.5)
    policy = tables(true, 1, 0.3)[0]
    log = true.log(policy, 2000, 60, np.random.default_rng(0))
    exact = true.value(policy, DISCOUNT)
    right = ImportanceSampling().estimate(log, as_policy(policy), discount=DISCOUNT)
    public = ImportanceSampling(alive_only=True).estimate(log, as_policy(policy), discount=DISCOUNT)
    assert right.low[0] < exact < right.high[0]
    assert abs(public.value[0] - exact) > 0.5 * abs(exact)


@pytest.mark.slow  # as the other tests in the grid
def test_on_a_grid_from_another_policy():
    """A sparse reward, far from the start, that the logged policy seldom sees."""
    true = gridworld(3, 3, slip=0.3)
    behavior = tables(true, 1, 0.2)[0]
    better = 0.5 * behavior + 0.5 * np.eye(4)[true.optimal(DISCOUNT).argmax(1)]
    log = true.log(behavior, 400, 60, np.random.default_rng(0))
    found = FQE_L2.estimate(log, [as_policy(behavior), as_policy(better)], discount=DISCOUNT)
    exact = [MDP.of(log).value(p, DISCOUNT) for p in (behavior, better)]
    np.testing.assert_allclose(found.value, exact, rtol=0.05)
    assert found.best == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["best-dice", "vpm"])
def test_members_of_episodes_of_different_lengths(name):
    """A reward of one a step is worth 1 / (1 - discount), however the redrawn episodes' lengths fall."""
    true = garnet(states=3, actions=2)
    true = MDP(true.transitions, np.ones_like(true.rewards), true.initial)
    policy = tables(true, 1, 0.1)[0]
    rng = np.random.default_rng(0)
    parts = [true.log(policy, *shape, rng) for shape in ((20, 5), (5, 200))]
    columns = ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations")
    log = Dataset.from_arrays(
        **{key: np.concatenate([getattr(part, key) for part in parts]) for key in columns}, action_space=parts[0].action_space
    )
    found = FITTED[name].replace(members=3).estimate(log, as_policy(policy), discount=DISCOUNT)
    np.testing.assert_allclose(found.bootstrap[:, 0], 10.0, rtol=0.06)
    # The weights of the behaviour policy are the episodes' lengths: twenty of 5 rows, five of 200.
    assert found.ess[0] == pytest.approx((20 * 5 + 5 * 200) ** 2 / (20 * 5**2 + 5 * 200**2), rel=0.1)
    assert any("the weights of policy 0 rest on 6." in line for line in found.warnings)


@pytest.mark.slow
def test_vpm_where_seldom_an_episode_ends():
    """A terminal's mass is 1 / (1 - discount): the penalty must not be a penalty of its variance."""
    transitions = np.zeros((2, 1, 2))
    transitions[0, 0] = [0.98, 0.02]  # stays, or goes to the state that ends
    true = MDP(transitions, np.array([[1.0], [0.0]]), np.array([1.0, 0.0]))
    policy = np.ones((2, 1))
    log = true.log(policy, 200, 400, np.random.default_rng(0))
    vpm = VPM(members=1, hidden=(), steps=30_000, lr=5e-4, batch_size=512)
    found = vpm.estimate(log, as_policy(policy), discount=0.98)
    assert found.value[0] == pytest.approx(MDP.of(log).value(policy, 0.98), rel=0.1)


MAGIC = WEIGHTED["magic"].replace(folds=1)  # by an ensemble, whose spread is part of its interval


def with_values(log, policy, begin, q):
    """A case of one policy whose critics have been told: (members,) what they say at the start, and Q (states, actions)."""
    case = OPEInput(log, [as_policy(policy)], discount=DISCOUNT)
    state, after = log.observations.argmax(1), log.next_observations.argmax(1)
    v = (policy * q).sum(1)
    errors = log.rewards + DISCOUNT * np.where(log.terminals, 0.0, v[after]) - q[state, log.actions]
    begins = np.stack([v[state[log.starts]] + each for each in begin])
    keep_nuisances(case, MAGIC, begins[:, None], errors[None].astype(float))
    return case


def test_magic_corrects_where_that_is_worth_it():
    true = garnet(states=4, actions=2, ending=0.3, noise=0.3)
    behavior, near, far = tables(true, 1, 0.2)[0], tables(true, 1, 0.5, seed=1)[0], tables(true, 1, 4.0, seed=2)[0]
    log = true.log(behavior, 400, 60, np.random.default_rng(0))
    magic, full = MAGIC, MAGIC.replace(kind="wdr")
    # Critics that are wrong by far, on a log that knows better.
    wrong = with_values(log, near, np.zeros(3), true.q(near, DISCOUNT) + 5.0)
    exact, told = true.value(near, DISCOUNT), full.on(wrong)
    assert abs(magic.on(wrong).value[0] - told.value[0]) < 0.05
    assert abs(told.value[0] - exact) < 0.5
    # Critics that are right, on a log of few episodes that resemble the policy's.
    log = true.log(behavior, 15, 60, np.random.default_rng(1))
    right = with_values(log, far, np.zeros(3), true.q(far, DISCOUNT))
    critics = true.q(far, DISCOUNT)
    promised = (far * critics).sum(1)[log.observations.argmax(1)[log.starts]].mean()
    corrected, blended = full.on(right).value[0] - promised, magic.on(right).value[0] - promised
    assert abs(blended) < 0.5 * abs(corrected)


def test_magic_with_critics_of_folds_lies_within_its_interval_as_often_as_promised():
    """Critics of one log share its luck: an interval that only knows the corrections contained the truth 14 times of 100.

    Where nothing is corrected the critics' error is all that gains have: intervals without it contained the gain 1 time of 4.
    """
    true, inside = WORLDS["chain"], []
    policies = [tables(true, 1, 0.2)[0], tables(true, 2, 0.6, seed=1)[1]]
    exact = np.array([true.value(p, DISCOUNT) for p in policies])
    for seed in range(30):
        log = true.log(policies[0], 200, 40, np.random.default_rng(seed))
        case = OPEInput(log, [as_policy(p) for p in policies], discount=DISCOUNT, logged=True)
        found = DoublyRobust(kind="magic", fqe=LinearFQE()).on(case)
        assert not found.corrected
        gain = gains(found, 2 * ALPHA)[1]  # of two policies, each at `ALPHA`
        low, high = np.array([*found.low[:2], gain[1]]), np.array([*found.high[:2], gain[2]])
        truth = np.array([*exact, exact[1] - exact[0]])
        inside.append((low <= truth) & (truth <= high))
    assert (np.mean(inside, 0) >= 0.85).all()


@pytest.mark.parametrize(("discount", "horizon", "shown"), [(0.95, None, 0.05 * 0.96 / (1 - 0.95 * 0.96)), (1.0, 20, 0.96**20)])
def test_occupancy_ratios_tell_how_much_of_a_policy_the_log_shows(discount, horizon, shown):
    """An action that the log lacks, one time in 25: rare enough at each step, and most of what follows is not known."""
    world = garnet(states=6, actions=3, noise=0.5, seed=1)
    log = world.log(np.tile([0.5, 0.5, 0.0], (6, 1)), 150, 40, np.random.default_rng(0))
    policies = [as_policy(np.tile(each, (6, 1))) for each in ([0.8, 0.16, 0.04], [0.8, 0.2, 0.0])]
    case = OPEInput(log, policies, discount=discount, horizon=horizon, logged=True)
    drl = DoublyRobust(kind="marginal", fqe=LinearFQE())
    found = drl.on(case)
    np.testing.assert_allclose(found.diagnostics["mass"], [shown, 1.0, 1.0], atol=0.01)
    assert found.ess[0] > 50  # which does not tell
    choice = decide(case, [drl], model=BehaviorModel(hidden=(8,), steps=50, lr=1e-2)).choice
    assert "its occupancy ratios amount to" in choice.objections[0][0]
    assert not any("occupancy" in line for line in choice.objections[1])


def test_what_critics_share_falls_out_of_magics_differences():
    """Also of the errors that the bootstrap draws."""
    true = WORLDS["chain"]
    behavior, target = tables(true, 1, 0.2)[0], as_policy(tables(true, 2, 0.6, seed=1)[1])
    log = true.log(behavior, 60, 40, np.random.default_rng(0))
    found = DoublyRobust(kind="magic", fqe=LinearFQE()).on(OPEInput(log, [target, target], discount=DISCOUNT))
    assert found.nuisance is not None
    assert found.bootstrap is not None
    assert (found.diagnostics["uncorrected"] > 0.5).all()
    np.testing.assert_allclose(found.bootstrap[:, 0], found.bootstrap[:, 1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.nuisance[:, 0], found.nuisance[:, 1], rtol=0, atol=1e-12)


def test_magic_of_one_critic_knows_no_interval():
    true = garnet(states=4, actions=2, ending=0.3, noise=0.3)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.5, seed=1)[0]
    log, q = true.log(behavior, 60, 60, np.random.default_rng(0)), true.q(target, DISCOUNT)
    begins = np.zeros(1), np.array([-0.3, 0.0, 0.3])
    one, three = (MAGIC.on(with_values(log, target, begin, q)) for begin in begins)
    assert np.isnan(one.low[0])
    assert np.isfinite(one.value[0])
    assert any("one critic" in line for line in one.warnings)
    both = dataclasses.replace(one, names=("policy", LOGGED), **{
        name: np.repeat(getattr(one, name), 2, -1) for name in ("value", "influence", "nuisance", "ess")
    })  # fmt: skip
    assert np.isinf(gains(dataclasses.replace(both, nuisance=both.nuisance * [1.0, 0.0], diagnostics={}))[0, 1:]).all()
    assert three.low[0] < true.value(target, DISCOUNT) < three.high[0]
