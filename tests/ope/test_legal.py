"""Estimates where some actions are illegal: exact in finite worlds, of what is legal alone, and illegal mass is told."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Discrete
from deadreckon.dynamics.model import Change, Limits
from deadreckon.errors import UserError
from deadreckon.ope import FQE, ImportanceSampling, LinearFQE, OPEInput
from deadreckon.ope import tables as op_tables
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.policies import BlackBoxPolicy
from deadreckon.theory import MDP, garnet
from tests.ope.worlds import as_policy, tables

DISCOUNT, ACTIONS, STATES = 0.9, 4, 5
FQE_L2 = FQE(members=1, hidden=(), steps=3000, lr=2e-2, weight_decay=0.0, tau=0.05, batch_size=256)


@cache
def masked():
    """A world, (states, actions) what is legal, a log of uniform legal actions, and two policies that know of no mask."""
    rng = np.random.default_rng(1)
    true = garnet(states=STATES, actions=ACTIONS, ending=0.15, noise=0.3)
    legal = rng.random((STATES, ACTIONS)) < 0.5
    legal[np.arange(STATES), rng.integers(0, ACTIONS, STATES)] = True
    seen = true.log(legal / legal.sum(1, keepdims=True), 800, 40, rng)
    columns = {key: getattr(seen, key) for key in ("observations", "actions", "rewards", "terminals", "timeouts")}
    log = Dataset.from_arrays(
        **columns, final_observations=seen.final_observations, legal=lambda s: legal[s.argmax(1)],
        behavior_log_probs=-np.log(legal[seen.observations.argmax(1)].sum(1)),
    )  # fmt: skip
    return true, legal, log, tables(true, 2, 0.6, seed=1)


@cache
def case():
    _, _, log, policies = masked()
    # The policies see the whole observation, whose first numbers are the state.
    return OPEInput(log, [as_policy_of_state(p) for p in policies], discount=DISCOUNT)


def as_policy_of_state(table):
    inner = as_policy(table)
    probs = lambda seen: inner.action_probs(seen[:, :STATES])  # noqa: E731
    return BlackBoxPolicy(lambda seen, rng: inner.fn(seen[:, :STATES], rng), action_probs=probs)


def values_of(world):
    """Of the policies, where what they give to illegal actions is drawn again."""
    _, legal, _, policies = masked()
    kept = [np.where(legal, p, 0.0) for p in policies]
    return np.array([world.value(p / p.sum(1, keepdims=True), DISCOUNT) for p in kept])


@pytest.mark.parametrize("estimator", [FQE_L2, pytest.param(LinearFQE(), marks=pytest.mark.slow)], ids=["fqe", "linear"])
def test_fitted_values_are_those_of_the_world_in_the_log(estimator):
    """What policies give to illegal actions is drawn again; the world is the one that the log itself describes."""
    true, _, log, policies = masked()
    plain = {key: getattr(log, key) for key in ("actions", "rewards", "terminals", "timeouts", "final_known")}
    states, last = log.observations[:, :STATES], log.final_observations[:, :STATES]
    seen = MDP.of(Dataset.from_arrays(observations=states, final_observations=last, action_space=Discrete(ACTIONS), **plain))
    found, exact = estimator.on(case()), values_of(seen)
    np.testing.assert_allclose(found.value, exact, atol=0.03)
    assert np.abs(exact - [seen.value(p, DISCOUNT) for p in policies]).min() > 0.1  # not the value of the policies as they are
    told = [line for line in found.warnings if "of its probability to illegal actions" in line]
    assert len(told) == 2
    assert "it is estimated as if it drew again until an action is legal" in told[0]


@pytest.mark.parametrize(
    "estimator",
    [ImportanceSampling(), pytest.param(DoublyRobust(kind="dr", fqe=FQE_L2), marks=pytest.mark.slow)], ids=["pdis", "dr"],
)  # fmt: skip
def test_weighted_values_are_true_within_their_intervals(estimator):
    found = estimator.on(case())
    half = (found.high - found.low) / 2
    assert (half > 0).all()
    assert (np.abs(found.value - values_of(masked()[0])) < 2.0 * half).all()


def test_how_much_is_illegal_is_told_exactly(monkeypatch):
    monkeypatch.setattr(op_tables, "BLOCK", 1000)
    _, legal, log, policies = masked()
    own = OPEInput(log, [as_policy_of_state(policies[0])], discount=DISCOUNT)
    table = own.current_actions(1)[:, 0]
    state = log.observations[:, :STATES].argmax(1)
    kept = np.where(legal, policies[0], 0.0)
    np.testing.assert_allclose(table, (kept / kept.sum(1, keepdims=True))[state], atol=1e-6)
    share = np.where(legal, 0.0, policies[0]).sum(1)[state].mean()
    (told,) = own.actor.warnings()
    assert told.startswith(f"policy 0 gives {share:.2%} of its probability to illegal actions")


def test_a_policy_that_obeys_is_not_warned_of():
    _, legal, log, _ = masked()
    chances = lambda seen: seen[:, STATES:] / seen[:, STATES:].sum(1, keepdims=True)  # noqa: E731
    uniform = BlackBoxPolicy(lambda seen, rng: seen[:, STATES:].argmax(1), action_probs=chances)
    assert ImportanceSampling().on(OPEInput(log, [uniform], discount=DISCOUNT)).warnings == ()


def test_a_policy_of_illegal_actions_alone_is_refused():
    _, legal, log, _ = masked()
    worst = (~legal).argmax(1)
    policy = BlackBoxPolicy(lambda seen, rng: worst[seen[:, :STATES].argmax(1)])
    with pytest.raises(UserError, match=r"policy 0 gives only illegal actions at an observation where the legal ones are \d"):
        ImportanceSampling().on(OPEInput(log, [policy], discount=DISCOUNT))


def test_the_behaviour_policy_is_learned_over_legal_actions():
    _, legal, log, _ = masked()
    chances = out_of_fold(case(), BehaviorModel(hidden=(16,), steps=300, lr=1e-2), 2).chances
    mask = log.observations[:, STATES:] > 0
    assert (chances[~mask] == 0).all()
    np.testing.assert_allclose(chances.sum(1), 1, atol=1e-6)
    np.testing.assert_allclose(chances, mask / mask.sum(1, keepdims=True), atol=0.12)


def test_a_model_believes_what_is_legal_where_it_mostly_is():
    """An action that is legal in nearly all rows was clipped below what counts as legal, one that always is to 0."""
    rng = np.random.default_rng(0)
    legal = np.stack([np.ones(200), rng.random(200) < 0.95, np.arange(200) % 5 == 0], 1).astype(bool)
    actions = np.array([rng.choice(np.flatnonzero(row)) for row in legal])
    data = Dataset.from_arrays(
        observations=rng.normal(3.0, 2.0, (200, 2)), actions=actions, rewards=rng.normal(size=200), legal=legal,
        terminals=np.arange(200) % 10 == 9,
    )  # fmt: skip
    limits = Limits.of(data.spec)
    np.testing.assert_array_equal(limits.high[-3:], [1, 1, 1])
    np.testing.assert_array_equal(limits.low[-3:], [1, 0, 0])
    view = Normalizer.of(data.spec, standardise=True)
    np.testing.assert_allclose(limits.high[:2], view.observe(data.observations)[:, :2].max(0), rtol=1e-5)
    hold = lambda marks: limits.hold(Change(jnp.array([0.0, 0.0, *marks]), jnp.float32(0), jnp.float32(0))).observation[-3:]  # noqa: E731
    np.testing.assert_array_equal(hold([0.97, 0.9, 0.2]), [1.0, 1.0, 0.0])
    never = limits._replace(low=limits.low.at[-3].set(0.0))  # of a log in which no action is always legal
    np.testing.assert_array_equal(never.hold(Change(jnp.array([0.0, 0.0, 0.1, 0.4, 0.2]), jnp.float32(0), jnp.float32(0)))
                                  .observation[-3:], [0.0, 1.0, 0.0])  # fmt: skip
