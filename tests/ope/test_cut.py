"""Episodes that the recording cuts off while much is to come, and what a ridge must leave alone."""

from dataclasses import replace

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.ope import OPEInput
from deadreckon.ope.decide import automatic
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.features import Table
from deadreckon.ope.fqe import FQE
from deadreckon.ope.linear import Fit, LinearFQE
from deadreckon.ope.registry import estimator
from deadreckon.ope.select import gains, select
from deadreckon.theory.tabular import garnet
from tests.ope.worlds import as_policy, tables

DISCOUNT, STEPS = 0.95, 5


@pytest.fixture(scope="module")
def recorded():
    """A world whose episodes end with probability 0.05 a step, recorded for five steps at most; its own policy and another."""
    world = garnet(8, 3, 3, ending=0.05, noise=0.3, seed=4)
    own, other = tables(world, 2, 0.7)
    return world, own, other, world.log(own, 6_000, STEPS, np.random.default_rng(0), "cut")


def exact(world, table):
    """The value of all that follows, from the first states."""
    flow = np.einsum("sat,sa->st", world.transitions, table)
    return float(world.initial @ np.linalg.solve(np.eye(world.states) - DISCOUNT * flow, (table * world.rewards).sum(1)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dr", "marginal"])
def test_the_value_beyond_the_recording_is_that_of_the_world(recorded, kind):
    """Most of it lies beyond. Rows at the end of the recording count for the behaviour policy too, or it would end oftener."""
    world, own, other, log = recorded
    case = OPEInput(log, [as_policy(other)], discount=DISCOUNT, horizon=None, logged=True, names=["other"])
    found = DoublyRobust(kind=kind, fqe=LinearFQE()).on(case)
    errors = found.influence.std(0, ddof=1) / np.sqrt(len(found.influence))
    truth = np.array([exact(world, other), exact(world, own)])
    assert (np.abs(found.value - truth) < 4 * errors + 0.05 * np.abs(truth)).all()
    gain = found.influence[:, 0] - found.influence[:, 1]
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    assert abs((found.value[0] - found.value[1]) - (truth[0] - truth[1])) < 3 * error
    assert found.corrected == (kind == "marginal")


@pytest.mark.slow
def test_errors_beyond_the_recording_are_those_within_it(recorded):
    """Of `dr`, whose corrections end there: a share b beyond makes them 1 / (1 - b) times as large. `drl` corrects all."""
    _, _, other, log = recorded
    for horizon, share in ((None, None), (STEPS, 0.0)):
        case = OPEInput(log, [as_policy(other)], discount=DISCOUNT, horizon=horizon, logged=True, names=["other"])
        share = case.beyond if share is None else share
        plain, marginal = (DoublyRobust(kind=kind, fqe=LinearFQE()).on(case) for kind in ("dr", "marginal"))
        assert marginal.inflation is None
        errors = plain.influence.std(0, ddof=1) / np.sqrt(len(plain.influence))
        assert (plain.high - plain.low) / errors == pytest.approx(2 * 1.96 / (1 - share), rel=0.05)
        low, high = gains(plain)[0, 1:]
        gain = (plain.influence[:, 0] - plain.influence[:, 1]).std(ddof=1) / np.sqrt(len(plain.influence))
        assert (high - low) / gain == pytest.approx(2 * 1.96 / (1 - share), rel=0.05)


def test_estimators_are_chosen_by_how_much_lies_beyond(recorded):
    world, own, other, log = recorded
    asked = {"discount": DISCOUNT, "logged": True, "names": ["own"]}
    case = OPEInput(log, [as_policy(own)], horizon=None, **asked)
    assert case.beyond > TAIL
    assert [each.label for each in automatic(case)] == ["DRL", "DR-linear"]
    within = OPEInput(log, [as_policy(own)], horizon=STEPS, **asked)
    assert within.beyond == 0.0
    assert [each.label for each in automatic(within)] == ["DR-linear", "DRL"]


@pytest.mark.parametrize("name", ["is", "wis", "pdis", "smis"])
def test_weights_correct_nothing_beyond_the_recording(recorded, name):
    """A policy that earns the same sooner would seem to be better, where what comes later is not counted."""
    _, _, other, log = recorded
    for horizon in (STEPS, None):
        case = OPEInput(log, [as_policy(other)], discount=DISCOUNT, horizon=horizon, logged=True, names=["other"])
        found = estimator(name).on(case)
        assert found.corrected == (horizon == STEPS)
        assert any("model-based only" in line for line in select([found]).objections[0]) == (horizon is None)


def test_what_the_behaviour_policy_would_do_next(recorded):
    """In a table by how often it does so; elsewhere nobody knows, and its critic does not learn from such rows."""
    world, own, other, log = recorded
    case = OPEInput(log, [as_policy(other)], discount=DISCOUNT, horizon=None, logged=True)
    table = Table.of(log)
    assert table is not None
    cut = ~np.asarray(log.terminals)[log.ends]
    states = np.asarray(log.final_observations).argmax(1)[cut]
    assert np.abs(case.final_actions(1)[cut, -1] - own[states]).max() < 0.1
    assert np.allclose(case.next_actions(1)[log.ends[cut], -1], case.final_actions(1)[cut, -1])
    assert case.shown.all()

    # Observations that differ in every row are no table.
    many = replace(log, observations=log.observations + 1e-3 * np.random.default_rng(0).standard_normal(log.observations.shape))
    case = OPEInput(many, [as_policy(other)], discount=DISCOUNT, horizon=None, logged=True)
    assert Table.of(many) is None
    assert (case.shown == (~many._is_end | np.asarray(many.terminals))).all()
    known = FQE(steps=10).problem(case)[1].extra["known"]
    assert known[:, 0].all()
    assert (known[:, 1] == case.shown).all()


@pytest.mark.parametrize("horizon", [STEPS, None])
def test_a_ridge_leaves_the_mean_alone(recorded, horizon):
    """Where all rewards are one, values are discounted steps, however strong the ridge; ratios average one at every step."""
    world, own, other, _ = recorded
    endless = garnet(8, 3, 3, noise=0.0, seed=4)
    log = endless.log(own, 200, STEPS, np.random.default_rng(1), "ones")
    log = replace(log, rewards=np.ones_like(log.rewards))
    case = OPEInput(log, [as_policy(other)], discount=0.9, horizon=horizon, names=["other"])
    fit = Fit(LinearFQE(ridge=1e4), case)
    sums = fit.sums(case, np.zeros(log.episodes, int), 1)
    critic = fit.critic(sums, np.ones(1), 0, 1e4)
    steps = STEPS if horizon else np.inf
    value = float(sums.start[0, 0] @ critic.weights[-1]) / log.episodes * fit.std
    assert value == pytest.approx((1 - 0.9**steps) / 0.1, rel=1e-4)
    phi = fit.features.taken(log.observations, log.actions)
    mean = (phi @ critic.ratios.T).mean(0)
    expected = 0.9 ** np.arange(STEPS) if horizon else np.array([10.0])
    assert np.allclose(mean, expected, rtol=1e-4)


def test_time_that_is_not_asked_for_is_not_beyond(recorded):
    """A twentieth of the episodes is cut one step early: of a hundred steps that is next to nothing."""
    world, own, _, _ = recorded
    log = garnet(8, 3, 3, noise=0.3, seed=4).log(own, 40, 100, np.random.default_rng(0), "long")
    rows = np.delete(np.arange(len(log)), log.ends[:2])
    ends = np.isin(rows, np.concatenate([log.ends[2:], log.ends[:2] - 1]))
    final = np.array(log.final_observations)
    final[:2] = log.observations[log.ends[:2]]
    cut = Dataset.from_arrays(
        observations=log.observations[rows], actions=log.actions[rows], rewards=log.rewards[rows], timeouts=ends,
        final_observations=final, action_space=log.action_space,
    )  # fmt: skip
    for discount, share in ((1.0, 0.05 / 100), (0.9, 0.05 * 0.9**99 * 0.1 / (1 - 0.9**100))):
        case = OPEInput(cut, [as_policy(own)], discount=discount, horizon=100, logged=True)
        assert case.beyond == pytest.approx(share, rel=1e-6)


def test_the_behaviour_policy_has_its_last_step_where_the_horizon_ends_episodes():
    """Time-outs at the horizon and terminals there are the same log."""
    rng = np.random.default_rng(0)
    seen, actions = rng.standard_normal((600, 2)), rng.integers(0, 2, 600)
    rewards, last = 2.0 + 0.1 * rng.standard_normal(600), np.arange(600) % 2 == 1
    flat = as_policy(np.full((2, 2), 0.5))
    found = []
    for kind in ("timeouts", "terminals"):
        log = Dataset.from_arrays(
            observations=seen, actions=actions, rewards=rewards, final_observations=seen[last], action_space=Discrete(2),
            behavior_log_probs=np.full(600, np.log(0.5)), **{kind: last},
        )  # fmt: skip
        case = OPEInput(log, [flat], discount=1.0, horizon=2, logged=True)
        small = FQE(members=2, hidden=(8,), steps=300, lr=1e-2, tau=0.1)
        assert "known" not in small.problem(case)[1].extra
        found.append(small.on(case).value)
        errors = DoublyRobust(kind="dr", fqe=small, folds=1).nuisances(case)[0].errors
        assert (errors[-1, 1::2] != 0.0).all()
    assert np.allclose(found[0], found[1], atol=0.3)
    assert abs(found[0][1] - found[0][0]) < 0.5
