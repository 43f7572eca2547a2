"""What a case takes and refuses, and what is shared, resumed and repeated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.batch import Batch
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import init_opt
from deadreckon.ope import FQE, LOGGED, BehaviorModel, DoublyRobust, ImportanceSampling, OPEInput, behavior
from deadreckon.ope.critics import Best
from deadreckon.ope.dice import DICE, Saddle
from deadreckon.ope.fits import Fits
from deadreckon.ope.fqe import Critics, Scale, State
from deadreckon.ope.importance import log_ratios
from deadreckon.ope.tables import NOISE
from deadreckon.policies import BlackBoxPolicy, EnvPolicy, library
from deadreckon.policies.kinds import ClippedGaussian, Deterministic, TanhGaussian
from deadreckon.theory import garnet
from tests.ope.worlds import as_policy, tables

ones = lambda *shape: np.ones(shape, np.float32)  # noqa: E731
zeros = lambda *shape: np.zeros(shape, np.float32)  # noqa: E731
TINY = FQE(members=2, hidden=(8,), steps=60, batch_size=16)


def linear(gain: float, noise: float, low=-5.0, high=5.0) -> BlackBoxPolicy:
    """a = gain s + noise N(0, 1), with its density."""

    def density(seen, actions):
        z = (actions[:, 0] - gain * seen[:, 0]) / noise
        return -0.5 * z**2 - np.log(noise * np.sqrt(2 * np.pi))

    return BlackBoxPolicy(lambda seen, rng: gain * seen + noise * rng.standard_normal(seen.shape), log_prob=density)


def lqr(gain: float, noise: float, episodes: int, steps: int, seed: int = 0) -> Dataset:
    """s' = 0.9 s + 0.5 a + 0.1 N(0, 1), r = -(s^2 + 0.1 a^2), from s = N(0, 1): a log of `linear(gain, noise)`."""
    rng = np.random.default_rng(seed)
    s, columns = rng.standard_normal((episodes, 1)), []
    for _ in range(steps):
        a = gain * s + noise * rng.standard_normal(s.shape)
        after = 0.9 * s + 0.5 * a + 0.1 * rng.standard_normal(s.shape)
        columns.append((s, a, -(s[:, 0] ** 2 + 0.1 * a[:, 0] ** 2)))
        s = after
    seen, taken, got = (np.stack(column, 1) for column in zip(*columns))
    last = np.zeros((episodes, steps), bool)
    last[:, -1] = True
    flat = [x.reshape(episodes * steps, *x.shape[2:]) for x in (seen, taken, got, last)]
    return Dataset.from_arrays(
        observations=flat[0], actions=flat[1], rewards=flat[2], timeouts=flat[3], final_observations=s,
        action_space=Box((-5.0,), (5.0,)), name="lqr",
    )  # fmt: skip


def test_copies_of_episodes_add_nothing():
    """A log that was stored three times has the estimates and errors of the log; independent rows would have smaller errors."""
    once, policy = lqr(-0.5, 0.3, 60, 1), linear(-0.7, 0.3)
    again = lambda name: np.tile(np.asarray(getattr(once, name)).T, 3).T  # noqa: E731
    three = Dataset.from_arrays(
        **{name: again(name) for name in ("observations", "actions", "rewards", "timeouts")},
        final_observations=np.tile(once.final_observations, (3, 1)), action_space=once.action_space, name="lqr",
        behavior_log_probs=np.tile(linear(-0.5, 0.3).log_prob(once.observations, once.actions), 3),
    )  # fmt: skip
    first = three.select(np.arange(60))
    is_ = ImportanceSampling()
    one, copied = (is_.on(OPEInput(log, policy, discount=0.0)) for log in (first, three))
    np.testing.assert_allclose(copied.value, one.value, rtol=1e-5)
    error = [np.sqrt(np.square(each.influence).sum(0)) / len(each.influence) for each in (one, copied)]
    np.testing.assert_allclose(error[1], error[0], rtol=1e-5)
    apart = is_.on(OPEInput(three, policy, discount=0.0, clusters=np.arange(180)))
    np.testing.assert_allclose(error[0] / (np.sqrt(np.square(apart.influence).sum(0)) / 180), np.sqrt(3), rtol=1e-5)


def riccati(gain: float, noise: float, discount: float) -> float:
    """Mean value of `linear(gain, noise)` at s = N(0, 1): -(p s^2 + c) with p and c from the Bellman equation."""
    closed = 0.9 + 0.5 * gain
    p = (1 + 0.1 * gain**2) / (1 - discount * closed**2)
    c = (0.1 * noise**2 + discount * p * ((0.5 * noise) ** 2 + 0.1**2)) / (1 - discount)
    return -(p + c)


@pytest.mark.slow  # in tables it is exact, see test_exact.py; its numbers here are golden
def test_fqe_on_lqr_has_the_riccati_value():
    log = lqr(-0.5, 0.5, 300, 40)
    policies = [linear(-0.5, 0.5), linear(-1.0, 0.2), linear(0.0, 0.3)]
    exact = [riccati(-0.5, 0.5, 0.9), riccati(-1.0, 0.2, 0.9), riccati(0.0, 0.3, 0.9)]
    estimator = FQE(members=2, hidden=(32, 32), steps=2000, lr=3e-3, batch_size=256, tau=0.03)
    found = estimator.estimate(log, policies, discount=0.9, names=["logged", "better", "idle"], seed=5)
    np.testing.assert_allclose(found.value, exact, rtol=0.08)
    assert found.names[found.best] == "better"
    assert "better" in str(found)
    np.testing.assert_allclose(found.average, 0.1 * found.value)


def test_members_learn_each_from_its_own_redrawn_episodes():
    """Critics that say nothing, against targets 1 and 2: squares of 1 and 4, by each member's own weights."""
    learner = Critics(FQE(hidden=()), 0.9, Scale(1.0, 1.0, -9.0, 9.0), share=1.0, first=0.0, members=2, policies=1, stops=False)
    critics = MLP((zeros(2, 1, 2, 1),), (zeros(2, 1, 1),))
    weight = np.array([[2.0, 0.0], [0.0, 3.0]], np.float32)  # (rows, members): the first member has the first row twice
    batch = Batch(ones(2, 1), ones(2, 1), zeros(2), ones(2, 1), zeros(2), extra={"weight": weight})
    target = np.broadcast_to(np.array([1.0, 2.0], np.float32), (2, 1, 2))
    (loss, (metrics, _)), slopes = jax.jit(jax.value_and_grad(learner.loss, has_aux=True))(critics, batch, target)
    assert float(loss) == pytest.approx((2 * 1 + 0 * 4) / 2 + (0 * 1 + 3 * 4) / 2)
    np.testing.assert_allclose(np.asarray(slopes.biases[0])[:, 0, 0], [-2 * (2 * 1) / 2, -2 * (3 * 2) / 2])
    assert float(metrics["loss"]) == pytest.approx((2 + 12) / 4)


def test_targets_of_fitted_values_end_at_terminals(monkeypatch):
    """Critics that say 2 everywhere, rewards of 1: 1 + 0.9 * 2 where the episode goes on, 1 where it has ended."""
    told, loss = [], Critics.loss

    def spy(self, critics, batch, target):
        told.append(target)
        return loss(self, critics, batch, target)

    monkeypatch.setattr(Critics, "loss", spy)
    learner = Critics(FQE(hidden=()), 0.9, Scale(1.0, 1.0, -9.0, 9.0), share=1.0, first=0.0, members=1, policies=1, stops=False)
    critics = MLP((zeros(1, 1, 2, 1),), (2.0 * ones(1, 1, 1),))
    extra = {"weight": ones(2, 1), "policy": zeros(2, 1, 1, 1)}
    batch = Batch(ones(2, 1), ones(2, 1), ones(2), ones(2, 1), np.array([0.0, 1.0], np.float32), extra=extra)

    @jax.jit
    def target(state):
        learner.update(state, batch, step=jnp.int32(0), key=jax.random.key(0))
        return told[0]

    np.testing.assert_allclose(target(State(critics, critics, init_opt(critics), None)), [[[2.8, 1.0]]], rtol=1e-6)


def test_the_saddle_point_looks_ahead_where_the_episode_goes_on_and_nowhere_else():
    rng = np.random.default_rng(0)
    learner = Saddle(DICE(hidden=(), members=1), 0.9, 1.0, 1)
    q, zeta = (MLP((jnp.asarray(rng.normal(size=(1, 1, 2, 1)), jnp.float32),), (zeros(1, 1, 1),)) for _ in range(2))
    one, table = ones(2, 1), zeros(2, 1, 1, 1)
    extra = {"weight": one, "policy": table, "initial_weight": one, "initial_policy": table}
    batch = Batch(one, one, ones(2), one, np.array([0.0, 1.0], np.float32), initial_observation=one, extra=extra)
    lagrangian = jax.jit(lambda batch: learner.lagrangian((q, zeros(1, 1)), zeta, batch)[0])

    def value(following):
        return float(lagrangian(batch._replace(next_observation=np.array(following, np.float32)[:, None])))

    assert value([1.0, 5.0]) == pytest.approx(value([1.0, 1.0]), rel=1e-6)  # the second row is terminal
    assert abs(value([5.0, 1.0]) - value([1.0, 1.0])) > 1e-2


def test_a_clipped_policy_is_divided_by_a_clipped_model():
    """Of the policy that made the log ratios are near one, also at the bounds, where both have probabilities."""
    rng = np.random.default_rng(0)
    seen = rng.uniform(-1, 1, (4000, 1)).astype(np.float32)
    taken = np.clip(1.2 * seen + 0.5 * rng.standard_normal(seen.shape), -1, 1)
    assert 0.2 < (np.abs(taken) == 1.0).mean() < 0.5
    log = Dataset.from_arrays(
        observations=seen, actions=taken, rewards=np.zeros(4000), terminals=np.ones(4000), name="clipped",
        action_space=Box((-1.0,), (1.0,)),
    )  # fmt: skip
    means = MLP((jnp.asarray([[1.2]]),), (jnp.zeros(1),))
    policy = EnvPolicy(ClippedGaussian.of(means, jnp.log(jnp.asarray([0.5]))), None, None, -jnp.ones(1), jnp.ones(1))
    case = OPEInput(log, [policy])
    learned = case.behavior_log_probs("learned", BehaviorModel(hidden=(16,), lr=3e-3, steps=1000), clipped=True)
    ratio = np.exp(case.log_probs[0] - learned)
    bound = np.abs(taken[:, 0]) == 1.0
    for where in (bound, ~bound):
        assert abs(ratio[where].mean() - 1.0) < 0.15
        assert np.abs(np.log(ratio[where])).mean() < 0.25


def test_policies_are_divided_by_models_of_their_own_kind_whatever_the_unit():
    """Actions of 0 to 10, 40 % of them at a bound, where a clipped Gaussian has a probability: the unit does not matter there.

    A policy without such probabilities has the same weights beside one that has them as alone.
    """
    rng = np.random.default_rng(0)
    seen = rng.uniform(-1, 1, (2000, 1)).astype(np.float32)
    taken = 5.0 + 5.0 * np.clip(1.5 * seen + 0.5 * rng.standard_normal(seen.shape), -1, 1)
    assert 0.3 < (np.abs(taken - 5.0) == 5.0).mean() < 0.5
    log = Dataset.from_arrays(
        observations=seen, actions=taken, rewards=np.zeros(2000), terminals=np.ones(2000), action_space=Box((0.0,), (10.0,))
    )
    bounds = jnp.zeros(1), jnp.full(1, 10.0)
    clipped = EnvPolicy(
        ClippedGaussian.of(MLP((jnp.asarray([[1.5]]),), (jnp.zeros(1),)), jnp.log(jnp.asarray([0.5]))), None, None, *bounds
    )
    smooth = EnvPolicy(TanhGaussian(MLP((jnp.asarray([[1.5, 0.0]]),), (jnp.asarray([0.0, -0.7]),))), None, None, *bounds)
    model = BehaviorModel(hidden=(16,), lr=3e-3, steps=400)
    both = log_ratios(OPEInput(log, [clipped, smooth]), "learned", model, None, 2)
    assert np.exp(both[0]).mean() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(np.exp(both[0])[np.abs(taken[:, 0] - 5.0) == 5.0].mean(), 1.0, atol=0.15)
    alone = log_ratios(OPEInput(log, [smooth]), "learned", model, None, 2)
    np.testing.assert_allclose(both[1], alone[0], rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_importance_sampling_with_a_learned_behaviour_policy():
    """With the densities that the log was made with, and with learned ones."""
    log = lqr(-0.5, 0.5, 2000, 8)
    target = linear(-0.6, 0.45)
    true = lqr(-0.6, 0.45, 20_000, 8, seed=1).returns(0.9).mean()
    column = linear(-0.5, 0.5).log_prob(log.observations, log.actions)
    told = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, timeouts=log.timeouts,
        final_observations=log.final_observations, action_space=log.action_space, behavior_log_probs=column,
    )  # fmt: skip
    given = ImportanceSampling().estimate(told, target, discount=0.9)
    model = BehaviorModel(hidden=(32,), steps=3000, lr=3e-3)
    learned = ImportanceSampling(model=model).estimate(log, target, discount=0.9)
    assert given.low[0] < true < given.high[0]
    assert abs(learned.value[0] - given.value[0]) < given.high[0] - given.low[0]
    with pytest.raises(UserError, match="no column behavior_log_probs; ask for behavior='learned'"):
        ImportanceSampling(behavior="logged").estimate(log, target)


def deterministic(size: int, observations: int = 1, scale: float = 5.0) -> EnvPolicy:
    """scale * tanh(-0.1 s), in every number of the action."""
    net = MLP((jnp.full((observations, size), -0.1),), (jnp.zeros(size),))
    return EnvPolicy(Deterministic(net), None, None, -scale * jnp.ones(size), scale * jnp.ones(size))


@pytest.mark.parametrize("greedy", [True, False])
def test_a_policy_that_draws_nothing_gets_noise(greedy):
    log = lqr(-0.5, 0.5, 2, 5)
    done = 5.0 * np.tanh(-0.1 * log.observations[:, 0])
    z = (log.actions[:, 0] - done) / 5.0 / NOISE
    expected = -0.5 * z**2 - np.log(NOISE * np.sqrt(2 * np.pi)) - np.log(5.0)
    np.testing.assert_allclose(OPEInput(log, deterministic(1), greedy=greedy).log_probs[0], expected, rtol=1e-3)
    if greedy:  # of a function it is known only where its greedy action is asked for
        own = BlackBoxPolicy(lambda seen, rng: 5.0 * np.tanh(-0.1 * seen))
        np.testing.assert_allclose(OPEInput(log, own, greedy=True).log_probs[0], expected, rtol=1e-3)


def test_what_one_policy_draws_does_not_depend_on_the_others():
    log = lqr(-0.5, 0.5, 3, 5)
    two = OPEInput(log, [linear(-0.5, 0.5), linear(-1.0, 0.2)], seed=8).next_actions(4)
    one = OPEInput(log, [linear(-0.5, 0.5)], seed=8).next_actions(4)
    assert two.shape == (15, 2, 4, 1)
    np.testing.assert_array_equal(two[:, :1], one)
    assert np.abs(np.diff(one, axis=2)).min() > 0
    # Tables are in [-1, 1]: here the actions over 5.
    assert abs(np.corrcoef(one[:, 0, :, 0].mean(1), log.next_observations[:, 0])[0, 1]) > 0.7


def test_probabilities_that_are_not_told_are_counted():
    true = garnet(states=4, actions=3)
    table = tables(true, 1, 1.0)[0]
    log = true.log(table, 20, 5, np.random.default_rng(0))
    told = as_policy(table)
    silent = BlackBoxPolicy(told.fn)
    found = OPEInput(log, [told, silent]).current_actions(1)
    np.testing.assert_allclose(found[:, 0], table[log.observations.argmax(1)], rtol=1e-6)
    assert 0 < np.abs(found[:, 1] - found[:, 0]).max() < 0.2
    np.testing.assert_allclose(found[:, 1].sum(-1), 1.0, rtol=1e-5)


def test_best_guesses_of_functions_are_their_likeliest_actions():
    true = garnet(states=4, actions=3)
    table = tables(true, 1, 1.0)[0]
    log = true.log(table, 20, 5, np.random.default_rng(0))
    told = as_policy(table)
    found = OPEInput(log, [told, BlackBoxPolicy(told.fn)], greedy=True).current_actions(1)
    likeliest = np.eye(3)[table.argmax(1)][log.observations.argmax(1)]
    np.testing.assert_array_equal(found[:, 0], likeliest)
    assert (found[:, 1] == likeliest).all(1).mean() > 0.9  # counted from draws, among which near ties are chance
    noisy = BlackBoxPolicy(lambda seen, rng: seen + rng.standard_normal(seen.shape), log_prob=lambda seen, a: a[:, 0])
    with pytest.raises(UserError, match="policy 0 samples its actions and has no deterministic"):
        OPEInput(lqr(-0.5, 0.5, 3, 5), noisy, greedy=True)


def test_policies_that_do_not_fit_the_log_are_told_in_a_line():
    log = lqr(-0.5, 0.5, 3, 5)
    snapshot = library.library("hopper")[0].policy()
    with pytest.raises(UserError, match="policy 0 is made for observations of 11 numbers, lqr has 1"):
        OPEInput(log, snapshot)
    column = BlackBoxPolicy(lambda seen, rng: seen, log_prob=lambda seen, a: np.zeros((len(a), 1)))
    with pytest.raises(UserError, match=r"log_prob must give one number per row, \(15,\), got \(15, 1\)"):
        _ = OPEInput(log, column).log_probs
    flat = BlackBoxPolicy(lambda seen, rng: seen[:, 0])
    with pytest.raises(UserError, match=r"policy 0 gives actions that are one number, lqr has shape \(1,\)"):
        TINY.estimate(log, flat)
    wide = BlackBoxPolicy(lambda seen, rng: np.zeros((len(seen), 2)))
    for estimator in (TINY, ImportanceSampling()):  # the second asks what is done, and how likely, only here
        with pytest.raises(UserError, match=r"policy 0 gives actions of shape \(2,\), lqr has shape \(1,\)"):
            estimator.estimate(log, wide, greedy=True)
    for size in (1, 2):
        two = Dataset.from_arrays(
            observations=np.zeros((4, 1)), actions=np.zeros((4, 3 - size)), rewards=np.zeros(4), timeouts=[False, True] * 2,
            action_space=Box([-1.0] * (3 - size), [1.0] * (3 - size)), behavior_log_probs=np.zeros(4), name="other",
        )  # fmt: skip
        with pytest.raises(UserError, match=rf"policy 0 gives actions of shape \({size},\), other has shape \({3 - size},\)"):
            ImportanceSampling().estimate(two, deterministic(size))
    true = garnet(states=4, actions=2)
    discrete = true.log(tables(true, 1, 0.1)[0], 5, 5, np.random.default_rng(0))
    for wrong, text in ((np.full((4, 2), 0.7), "sums from 1.4 to 1.4"), (np.full((4, 3), 1 / 3), r"got shape \(25, 3\)")):
        with pytest.raises(UserError, match=text):
            ImportanceSampling().estimate(discrete, as_policy(wrong))
    with pytest.raises(UserError, match=r"policy 0 gives actions of shape \(1,\), mdp has one of 2 choices"):
        ImportanceSampling().estimate(discrete, deterministic(1, observations=4))
    with pytest.raises(UserError, match="names must differ, and from 'behaviour policy', got behaviour policy"):
        OPEInput(log, flat, names=[LOGGED])


@pytest.mark.slow
def test_estimators_share_what_they_fit(monkeypatch):
    true = garnet(states=4, actions=2, ending=0.2)
    log = true.log(tables(true, 1, 0.3)[0], 30, 20, np.random.default_rng(0))
    case = OPEInput(log, as_policy(tables(true, 1, 0.5, seed=1)[0]), discount=0.9)
    fits = []
    train = OPEInput.train

    def count(self, learner, rows, steps, what):
        fits.append(what)
        return train(self, learner, rows, steps, what)

    monkeypatch.setattr(OPEInput, "train", count)
    for estimator in (TINY, DoublyRobust(fqe=TINY), DoublyRobust(kind="magic", fqe=TINY), ImportanceSampling()):
        estimator.on(case)
    assert fits == ["fqe", "fqe by folds"]
    in_sample = DoublyRobust(fqe=TINY, folds=1)
    in_sample.on(case)
    assert len(fits) == 2  # which shares those of the estimator itself


@pytest.mark.slow
def test_a_killed_fit_goes_on(tmp_path):
    true = garnet(states=4, actions=2, ending=0.2)
    log = true.log(tables(true, 1, 0.3)[0], 30, 20, np.random.default_rng(0))
    policy = as_policy(tables(true, 1, 0.5, seed=1)[0])
    long = TINY.replace(steps=2500)
    whole = long.estimate(log, policy, discount=0.9)

    class Killed(Exception):
        pass

    def kill(what, step, steps):
        if step >= 2000:
            raise Killed

    with pytest.raises(Killed):
        long.estimate(log, policy, discount=0.9, out=tmp_path / "ope", watch=kill)
    seen = []
    rest = long.estimate(log, policy, discount=0.9, out=tmp_path / "ope", watch=lambda what, step, steps: seen.append(step))
    assert seen == [2000, 2250, 2500]
    np.testing.assert_array_equal(rest.value, whole.value)
    other = as_policy(tables(true, 1, 0.5, seed=2)[0])
    for asked in ((log.select(np.arange(20)), policy), (log, other)):  # other fits, beside it
        fresh = long.estimate(*asked, discount=0.9)
        kept = long.estimate(*asked, discount=0.9, out=tmp_path / "ope")
        np.testing.assert_array_equal(kept.value, fresh.value)
        assert abs(kept.value[0] - whole.value[0]) > 0


def test_refusals():
    log = lqr(-0.5, 0.5, 3, 5)
    silent = BlackBoxPolicy(lambda seen, rng: seen)
    with pytest.raises(UserError, match="discount=1 needs episodes that end by a terminal, or a horizon: lqr has timeouts"):
        OPEInput(log, silent, discount=1.0)
    with pytest.raises(UserError, match="no policy to evaluate"):
        OPEInput(log, [])
    with pytest.raises(UserError, match="policies must be policies, policy files or runs, got int"):
        OPEInput(log, 3)
    with pytest.raises(UserError, match="2 policies need as many names, got 1"):
        OPEInput(log, [silent, silent], names=["a"])
    with pytest.raises(UserError, match="policy 0 samples its actions without giving their probabilities"):
        ImportanceSampling(behavior="auto", model=BehaviorModel(steps=1)).estimate(log, silent)
    with pytest.raises(UserError, match=r"policy 0 gives actions of shape \(2,\), lqr has shape \(1,\)"):
        TINY.estimate(log, BlackBoxPolicy(lambda seen, rng: np.tile(seen, 2)))
    with pytest.raises(UserError, match="policy 0 gives actions that are not finite"):
        TINY.estimate(log, BlackBoxPolicy(lambda seen, rng: np.nan * seen))
    with pytest.raises(UserError, match=r"FQE.lr takes a finite number >= 0"):
        FQE(lr=-1.0).estimate(log, silent)
    with pytest.raises(UserError, match="fqe: .* was not finite at update"):
        TINY.replace(lr=1e30).estimate(log, silent)


def test_warnings_say_when_not_to_trust():
    true = garnet(states=4, actions=2)
    log = true.log(tables(true, 1, 0.1)[0], 40, 30, np.random.default_rng(0))
    found = ImportanceSampling(kind="trajectory").estimate(log, as_policy(tables(true, 1, 3.0, seed=1)[0]), discount=0.98)
    assert found.ess[0] < 10
    assert any("the weights of policy 0 rest on" in line for line in found.warnings)
    assert any("40 of 40 episodes are cut off, after 30 steps" in line for line in found.warnings)


@pytest.mark.slow
def test_a_fit_that_still_changes_is_told():
    """A reward a step, and a long horizon: after a few updates the critics have not yet added it up."""
    true = garnet(states=3, actions=2)
    true = type(true)(true.transitions, np.abs(true.rewards) + 1.0, true.initial)
    table = tables(true, 1, 0.1)[0]
    log = true.log(table, 20, 50, np.random.default_rng(0))
    short = FQE(members=1, hidden=(), steps=200, lr=1e-2, tau=0.02).estimate(log, as_policy(table), discount=0.98)
    assert any("fqe still changes: the values of policy 0 by" in line for line in short.warnings)
    long = FQE(members=1, hidden=(), steps=8000, lr=1e-2, tau=0.05).estimate(log, as_policy(table), discount=0.98)
    assert not any("still changes" in line for line in long.warnings)
    assert short.value[0] < 0.7 * long.value[0]


def test_a_fit_has_converged_for_each_policy_by_itself():
    """Relative to the size of the values, so that values around zero do not always change by much."""
    fits = object.__new__(Fits)
    metrics = lambda q, size: {f"q {i}": v for i, v in enumerate(q)} | {f"size {i}": v for i, v in enumerate(size)}  # noqa: E731
    size = [10.0, 1.0, 2.0]
    fits._metrics = {"fqe": {80: metrics([10.0, 1.0, 0.01], size), 100: metrics([10.1, 1.4, -0.03], size)}}
    settled, (line,) = fits.convergence("fqe", ["a", "b", "c"])
    assert settled.tolist() == [True, False, True]
    assert line == "fqe still changes: the values of b by 40 % over its last fifth; more than 100 updates are needed"
    assert fits.convergence("no", ["a"])[0].tolist() == [True]


def test_batches_without_rows_of_early_stopping_say_nothing_about_the_loss():
    best = Best.begin(jnp.zeros(2), (2,))
    batches = [([0.0, 3.0], [False, True]), ([4.0, 1.0], [True, True]), ([0.0, 2.0], [False, True]), ([6.0, 2.0], [True, True])]
    for step, (loss, known) in enumerate(batches):
        best = best.look(jnp.full(2, float(step)), jnp.asarray(loss), jnp.asarray(known), jnp.asarray(50 * step), 0.0)
    np.testing.assert_allclose(best.running, [5.0, 2.0])
    np.testing.assert_allclose(best.loss, [4.0, 2.0])  # of the second batch, the first with such rows, or the mean of 3 and 1
    assert best.params.tolist() == [1.0, 1.0]


def test_early_stopping_has_half_of_its_share_of_the_rows_where_clusters_are_of_unequal_sizes():
    draw = np.array([0.05, 0.5, 0.2, 0.3, 0.9])
    assert behavior._stopping(draw, np.array([1.0, 400.0, 600.0, 100.0, 200.0])).tolist() == [True, False, True, False, False]
    assert behavior._stopping(draw, np.array([1.0, 400.0, 900.0, 100.0, 200.0])).tolist() == [True, False, False, True, False]
    assert behavior._stopping(draw, np.full(5, 100.0)).tolist() == [True, False, False, False, False]


def test_rewards_beyond_float32_are_refused():
    log = lqr(-0.3, 0.5, 3, 5)
    rewards = np.where(np.arange(len(log)) == 7, -1e30, log.rewards)
    log = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=rewards, timeouts=log.timeouts,
        action_space=log.action_space, name="lqr",
    )  # fmt: skip
    with pytest.raises(UserError, match="lqr: rewards reach 1e.30 in size, .* divide the column until they are below 1e.15"):
        OPEInput(log, linear(-0.3, 0.5), discount=0.9)
