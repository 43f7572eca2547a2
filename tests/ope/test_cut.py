"""Episodes that the recording cuts off while much is to come, and what a ridge must leave alone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.batch import Batch
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.ope import FQED, ImportanceSampling, OPEInput
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.decide import automatic
from deadreckon.ope.doubly_robust import DoublyRobust, stretched
from deadreckon.ope.estimand import TAIL
from deadreckon.ope.features import Table
from deadreckon.ope.fqe import FQE
from deadreckon.ope.groups import Groups, by_group
from deadreckon.ope.linear import Fit, LinearFQE
from deadreckon.ope.registry import as_estimators, estimator
from deadreckon.ope.select import gains, select
from deadreckon.policies import BlackBoxPolicy
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


def test_the_share_beyond_is_that_of_the_policys_episodes(recorded):
    """Of the log's policy it is the log's own, whatever is cut off when; of one that never ends an episode what cuts leave."""
    world, own, _, log = recorded
    episodes = np.random.default_rng(2).permutation(len(log.ends))[:300]
    log = log.select(np.sort(episodes))
    for horizon in (None, 9):
        case = OPEInput(log, [as_policy(own)], discount=DISCOUNT, horizon=horizon, logged=True)
        assert case.beyond_of(np.zeros(len(log))) == pytest.approx(case.beyond, rel=1e-9)
        most = np.full(len(log), 0.0)
        most[log.ends[np.asarray(log.terminals)[log.ends]]] = -np.inf  # whoever ends an episode has no weight
        left = DISCOUNT**STEPS if horizon is None else 1 - (1 - DISCOUNT**STEPS) / (1 - DISCOUNT**horizon)
        assert case.beyond_of(most) == pytest.approx(left, rel=1e-9)


def ending(episodes: int) -> Dataset:
    """One state, where action 1 ends the episode. The log takes it four times out of five and is cut off after five steps."""
    rng = np.random.default_rng(3)
    actions = (rng.random((episodes, STEPS)) < 0.8).astype(int)
    lengths = np.where(actions.any(1), actions.argmax(1) + 1, STEPS)
    taken = np.concatenate([row[:n] for row, n in zip(actions, lengths)])
    ends = np.zeros(len(taken), bool)
    ends[np.cumsum(lengths) - 1] = True
    return Dataset.from_arrays(
        observations=np.ones((len(taken), 1), np.float32), actions=taken, rewards=rng.normal(1.0, 0.1, len(taken)),
        terminals=ends & (taken == 1), timeouts=ends & (taken == 0), action_space=Discrete(2),
        behavior_log_probs=np.log(np.where(taken == 1, 0.8, 0.2)),
        final_observations=np.ones((episodes, 1), np.float32),
    )  # fmt: skip


@pytest.mark.parametrize("name", ["dr-linear", "wis", "smis", "switch"])
def test_a_policy_that_goes_on_where_the_log_ends_is_judged_beyond_the_recording(name):
    """Three in ten thousand of the log's episodes are cut off, and nearly all of the policy's."""
    log = ending(60_000)
    policy = as_policy(np.array([[0.95, 0.05]]))
    case = OPEInput(log, [policy], discount=DISCOUNT, horizon=None, logged=True, names=["patient"])
    assert case.beyond < TAIL
    found = estimator(name).on(case)
    share = found.diagnostics["beyond"]
    assert share == pytest.approx([(0.95 * DISCOUNT) ** STEPS, case.beyond], rel=0.05)
    assert found.corrected
    assert [found.corrects(i) for i in range(2)] == [False, True]
    told = f"model-based only: {100 * share[0]:.0f} % of its discounted time"
    assert any(told in line for line in select([found]).objections[0])
    if name != "wis" and name != "smis":
        assert found.inflation == pytest.approx([1 / (1 - share[0]), 1.0])
        assert any("of the discounted time of patient lies beyond" in line for line in found.warnings)


def test_gains_by_group_are_less_certain_beyond_the_recording(monkeypatch):
    log = ending(2_000)
    case = OPEInput(log, [as_policy(np.array([[0.5, 0.5]]))], discount=DISCOUNT, horizon=None, logged=True)
    groups = Groups("site", ("a", "b"), np.arange(log.episodes) % 2)
    wide = by_group(case, 0, groups, BehaviorModel(hidden=(8,), steps=50))
    ratios = np.where(np.asarray(log.actions) == 1, np.log(0.5 / 0.8), np.log(0.5 / 0.2))
    parts = [groups.codes == g for g in range(2)]
    episodes = [case.episodes_of(part) for part in parts]
    share = [case.beyond_of(each.cumulate(ratios[part[log.episode_of]]), each) for each, part in zip(episodes, parts)]
    assert max(share) > TAIL
    monkeypatch.setattr(OPEInput, "beyond_of", lambda self, log_rho, part: 0.0)
    narrow = by_group(case, 0, groups, BehaviorModel(hidden=(8,), steps=50))
    for one, other, stretch in zip(wide, narrow, stretched(share)):
        assert one["gain"] == other["gain"]
        assert (one["high"] - one["low"]) / (other["high"] - other["low"]) == pytest.approx(stretch, rel=1e-5)


def test_groups_that_are_recorded_for_different_times_have_their_own_chances_of_a_cut_off():
    """One site is cut off after 2 of 6 steps: at the other an arm pays 1 a step, which observations do not tell apart."""
    rng, count, steps = np.random.default_rng(0), 600, 6
    site = np.arange(count) % 2
    lengths = np.where(site == 1, steps, 2)
    rows, where = int(lengths.sum()), np.repeat(site, lengths)
    actions, ends = rng.integers(0, 2, rows), np.cumsum(lengths) - 1
    last = np.isin(np.arange(rows), ends)
    log = Dataset.from_arrays(
        observations=np.ones((rows, 1)), actions=actions, rewards=where * actions, terminals=last & (where == 1),
        timeouts=last & (where == 0), behavior_log_probs=np.full(rows, np.log(0.5)),
    )  # fmt: skip
    case = OPEInput(log, [as_policy(np.array([[0.4, 0.6]]))], discount=1.0, horizon=steps, logged=True)
    short, long = by_group(case, 0, Groups("site", ("short", "long"), site), BehaviorModel(hidden=(8,), steps=50))
    assert long["low"] < 0.1 * steps < long["high"]
    assert long["high"] - long["low"] < 1.0
    # What is beyond two of six steps is the critics' alone, and is said to be uncertain.
    assert short["high"] - short["low"] > 2 * (long["high"] - long["low"])


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
    assert (case.shown == (~many.is_end | np.asarray(many.terminals))).all()
    settings = {"hidden": (4,), "members": 1, "batch_size": 64}
    for small in (FQE(weight_decay=0.0, **settings), FQED(**settings)):
        learner, rows = small.problem(case)
        known = rows.extra["known"]
        assert known[:, 0].all()
        assert (known[:, 1] == case.shown).all()
        # A batch of rows of which nobody knows it moves the critic of the other policy alone.
        columns = rows.take(np.flatnonzero(~case.shown)[:64])
        batch = Batch(**{name: columns.pop(name) for name in learner.needs(many.spec).columns}, extra=columns)
        first = learner.init(rows.spec, jax.random.key(0))
        after = jax.jit(learner.update)(first, batch, step=jnp.int32(0), key=jax.random.key(1))[0]
        moves = jax.tree.map(lambda a, b: np.abs(b - a).reshape(2, -1).max(1), first.critics, after.critics)
        moved = jax.tree.leaves(moves)
        assert (np.max(moved, 0) > 0).tolist() == [True, False]


def shuffled(log: Dataset) -> Dataset:
    """The same transitions, each episode's in any order behind its first."""
    rng = np.random.default_rng(5)
    order = np.concatenate([[s, *(s + 1 + rng.permutation(n - 1))] for s, n in zip(log.starts, log.lengths)])
    ends = np.zeros(len(log), bool)
    ends[log.ends] = True
    return Dataset.from_arrays(
        observations=log.observations[order], actions=log.actions[order], rewards=log.rewards[order],
        next_observations=log.next_observations[order], terminals=np.asarray(log.terminals)[order],
        timeouts=ends & ~np.asarray(log.terminals)[order], action_space=log.action_space,
        behavior_log_probs=log.extras["behavior_log_probs"][order], name="shuffled",
    )  # fmt: skip


def test_what_follows_a_row_may_not_be_the_next_row():
    """The policy of such a log does what it usually does there, not what the next row says; where nobody knows, it is told."""
    world = garnet(8, 3, 3, noise=0.3, seed=4)
    own, other = tables(world, 2, 0.7)
    log = shuffled(world.log(own, 2_000, 20, np.random.default_rng(0), "in order"))
    assert log.apart.mean() > 0.5
    case = OPEInput(log, [as_policy(other)], discount=DISCOUNT, horizon=None, logged=True, names=["other"])
    states = log.next_observations.argmax(1)
    assert np.abs(case.next_actions(1)[:, -1][log.apart] - own[states[log.apart]]).max() < 0.15
    assert case.shown.all()
    found = estimator("fqe-linear").on(case)
    for value, table in zip(found.value, (other, own)):
        assert value == pytest.approx(exact(world, table), rel=0.05)
    assert [each.label for each in automatic(case)] == ["FQE-L2"]
    for name in ("drl", "wis", "dr-linear"):
        with pytest.raises(UserError, match="shuffled: its rows do not follow each other"):
            estimator(name).on(case)
    (mine,) = as_estimators([lambda data, policies, discount: [1.0]])
    assert np.isnan(mine.on(case).value[-1])

    many = replace(log, observations=log.observations + 1e-3 * np.random.default_rng(0).standard_normal(log.observations.shape))
    with pytest.raises(UserError, match="give the rows in the order in which they were recorded"):
        OPEInput(many, [as_policy(other)], discount=DISCOUNT, horizon=None, logged=True)


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


def test_what_is_still_to_come_is_told_of_what_is_asked_for():
    """With a horizon of 40 steps, episodes that are cut off after 38 of them lack a twentieth and not all of their time."""
    world = garnet(states=3, actions=2)
    both = np.full((3, 2), 0.5)
    parts = world.log(both, 5, 38, np.random.default_rng(0)), world.log(both, 55, 40, np.random.default_rng(1))
    columns = ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations")
    log = Dataset.from_arrays(
        **{key: np.concatenate([getattr(part, key) for part in parts]) for key in columns}, action_space=Discrete(2),
        behavior_log_probs=np.full(sum(map(len, parts)), np.log(0.5)),
    )  # fmt: skip
    case = OPEInput(log, [as_policy(both)], discount=1.0, horizon=40, logged=True)
    assert case.cut_ahead == pytest.approx(0.05)
    assert any("where 5 % of the discounted time remains" in line for line in ImportanceSampling().on(case).warnings)


def blind(log):
    """The log without the observations after its episodes, as a table of rows and no more gives it."""
    columns = {key: getattr(log, key) for key in ("observations", "actions", "rewards", "terminals", "timeouts")}
    return Dataset.from_arrays(**columns, action_space=Discrete(log.spec.action_size), **log.extras)


def test_the_last_step_of_a_horizon_counts_though_nobody_knows_what_follows_it():
    """All episodes are cut off where the horizon ends: with one step to go nothing that follows counts."""
    steps, true = 3, garnet(states=4, actions=2, noise=0.3)
    behavior, target = np.full((4, 2), 0.5), tables(true, 1, 0.5, seed=1)[0]
    log = blind(true.log(behavior, 2000, steps, np.random.default_rng(0)))
    assert not log.usable[log.ends].any()
    case = OPEInput(log, [as_policy(target)], discount=1.0, horizon=steps, logged=True)
    worth = []
    for policy in (target, behavior):
        values = np.zeros(4)
        for _ in range(steps):
            values = (policy * (true.rewards + true.transitions @ values)).sum(1)
        worth.append(float(true.initial @ values))
    for each in (LinearFQE(), DoublyRobust(kind="dr", fqe=LinearFQE()), DoublyRobust(kind="marginal", fqe=LinearFQE())):
        found = each.on(case)
        np.testing.assert_allclose(found.value, worth, atol=0.1)
        assert (found.low - 0.02 <= worth).all()
        assert (found.high + 0.02 >= worth).all()
        np.testing.assert_allclose(found.diagnostics.get("mass", np.ones(2)), 1.0, atol=0.02)


@pytest.mark.parametrize("horizon", [None, 1])
def test_of_rewards_that_nothing_follows_no_row_is_lost(horizon):
    """Single steps, cut off without what follows, and a discount of zero: rewards are 1 for the first action and 0 else."""
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 2, 900)
    ends = np.ones(900, bool) if horizon is None else np.tile([False, False, True], 300)
    log = Dataset.from_arrays(
        observations=np.ones((900, 1)), actions=actions, rewards=(actions == 0).astype(float), terminals=np.zeros(900, bool),
        timeouts=ends, behavior_log_probs=np.full(900, np.log(0.5)),
    )  # fmt: skip
    case = OPEInput(log, [as_policy(np.array([[1.0, 0.0]]))], discount=0.0, horizon=horizon, logged=True)
    for each in (LinearFQE(), DoublyRobust(kind="dr", fqe=LinearFQE()), DoublyRobust(kind="marginal", fqe=LinearFQE())):
        np.testing.assert_allclose(each.on(case).value, [1.0, 0.5], atol=0.06)


def test_the_behaviour_policy_has_a_factor_of_its_own_rows():
    """Some episodes end before the horizon, of which nobody knows what follows, and others go on beyond it: rewards are 1."""
    rng, horizon = np.random.default_rng(0), 4
    lengths = np.tile([2, 8], 150)
    rows = int(lengths.sum())
    ends = np.zeros(rows, bool)
    ends[np.cumsum(lengths) - 1] = True
    log = Dataset.from_arrays(
        observations=rng.normal(size=(rows, 2)), actions=rng.integers(0, 2, rows), rewards=np.ones(rows),
        terminals=np.zeros(rows, bool), timeouts=ends, behavior_log_probs=np.full(rows, np.log(0.5)),
    )  # fmt: skip
    policy = BlackBoxPolicy(
        lambda seen, rng: rng.integers(0, 2, len(seen)), action_probs=lambda seen: np.full((len(seen), 2), 0.5)
    )
    found = LinearFQE(ridge=1.0).on(OPEInput(log, [policy], discount=1.0, horizon=horizon, logged=True))
    np.testing.assert_allclose(found.value, horizon, rtol=0.02)
