"""Decisions on logs whose truth is known: what is estimated, out of fold, simultaneous, and what is refused."""

import numpy as np
import pytest
from scipy import stats

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.ope import LOGGED, DoublyRobust, Estimand, ImportanceSampling, LinearFQE, OPEInput, estimator, select
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import CrossFitted
from deadreckon.ope.decide import automatic, decide
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.support import support
from deadreckon.policies import BlackBoxPolicy
from deadreckon.stats import inference
from deadreckon.theory import garnet
from deadreckon.theory.tabular import softmax
from tests.ope.worlds import as_policy, tables

QUICK = BehaviorModel(hidden=(8,), steps=300, lr=1e-2)
DRL, DR = DoublyRobust(kind="marginal", fqe=LinearFQE()), DoublyRobust(kind="dr", fqe=LinearFQE(fourier_features=32))


def finite_value(world, policy, discount, horizon):
    """The value of the first steps, by the distribution of states at each."""
    states, total = world.initial, 0.0
    for t in range(horizon):
        total += discount**t * np.einsum("s,sa,sa->", states, policy, world.rewards)
        states = np.einsum("s,sa,sat->t", states, policy, world.transitions)
    return total


# ---- the estimand -------------------------------------------------------------------------------------------------------


def constant(chances):
    """A policy with the same probabilities everywhere."""
    draw = lambda seen, rng: rng.choice(len(chances), len(seen), p=chances)  # noqa: E731
    return BlackBoxPolicy(draw, action_probs=lambda seen: np.tile(chances, (len(seen), 1)))


def by_hand(horizon=None, discount=0.5):
    """An episode of three rewards 1, 2, 4 that ends, and one of two rewards 8, 16 that is cut off."""
    log = Dataset.from_arrays(
        observations=np.arange(5.0)[:, None], actions=np.zeros(5, int), rewards=np.array([1.0, 2.0, 4.0, 8.0, 16.0]),
        terminals=[0, 0, 1, 0, 0], timeouts=[0, 0, 0, 0, 1], final_observations=np.array([[9.0], [7.0]]),
        action_space=Discrete(2), behavior_log_probs=np.zeros(5),
    )  # fmt: skip
    return OPEInput(log, constant([1.0, 0.0]), discount=discount, horizon=horizon, logged=True)


def test_the_discounted_return_of_an_episode_by_hand():
    """A shift of the exponent by one step would halve or double these."""
    case = by_hand()
    np.testing.assert_allclose(case.data.returns(0.5), [1 + 0.5 * 2 + 0.25 * 4, 8 + 0.5 * 16])
    found = ImportanceSampling(normalised=False).on(by_hand(horizon=2))
    # The first two steps of each: 1 + 1 and 8 + 8, of the policy that acts as logged and of the behaviour policy.
    np.testing.assert_allclose(found.value, [9.0, 9.0])
    assert ImportanceSampling(normalised=False).on(by_hand(horizon=1)).value[0] == pytest.approx((1 + 8) / 2)
    assert ImportanceSampling(normalised=False).on(by_hand(2, discount=1.0)).value[0] == pytest.approx((3 + 24) / 2)


def test_a_horizon_cuts_episodes_and_knows_what_the_task_ended():
    case = by_hand(horizon=2)
    assert case.data.lengths.tolist() == [2, 2]
    assert case.data.terminals.tolist() == [False, True, False, True]
    assert case.ended.tolist() == [False] * 4  # the horizon's ends are none of the task's
    assert case.followed.tolist() == [True] * 4
    np.testing.assert_allclose(case.data.final_observations, [[2.0], [7.0]])  # what follows where the first episode is cut
    assert by_hand(horizon=3).ended.tolist() == [False, False, True, False, False]


def test_estimands_in_words_and_what_has_no_value():
    assert str(Estimand(0.99, 1)) == "expected reward of one step; sampled actions"
    assert "until it ends; rewards after a timeout count; deterministic (greedy)" in str(Estimand(0.9, None, True))
    assert "expected return of the first 7 steps" in str(Estimand(1.0, 7))
    with pytest.raises(UserError, match=r"discount=1 needs episodes that end by a terminal, or a horizon: .* longest episode"):
        by_hand(discount=1.0)
    with pytest.raises(UserError, match=r"discount must be in \[0, 1\], got 1.5"):
        Estimand(1.5)
    log = garnet(states=3, actions=2).log(np.full((3, 2), 0.5), 20, 7, np.random.default_rng(0))
    assert Estimand.of(log, 0.9).horizon == 7  # all were cut there, and half of the time was left
    assert Estimand.of(log, 0.5).horizon is None  # next to nothing was
    assert Estimand.of(log, 0.9, None).horizon is None
    assert ImportanceSampling().estimate(log, as_policy(np.full((3, 2), 0.5)), discount=1.0, horizon=7).estimand.horizon == 7


# ---- critics and ratios that are solved ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [None, 6])
@pytest.mark.parametrize("estimator", [LinearFQE(n_bootstrap=200), DRL, DR], ids=["fqe-linear", "drl", "dr-linear"])
def test_linear_estimates_are_exact_in_a_table(horizon, estimator):
    true = garnet(states=5, actions=3, ending=0.1, noise=0.2)
    behavior, target = tables(true, 1, 0.3)[0], tables(true, 1, 1.0, seed=1)[0]
    discount = 0.9 if horizon is None else 1.0
    log = true.log(behavior, 3000, 12 if horizon is None else horizon, np.random.default_rng(0))
    case = OPEInput(log, as_policy(target), discount=discount, horizon=horizon, logged=True)
    exact = [
        true.value(p, discount) if horizon is None else finite_value(true, p, discount, horizon) for p in (target, behavior)
    ]
    found = estimator.on(case)
    if horizon is None and estimator is DR:  # weights stop where the log is cut off
        assert abs(found.value[0] - exact[0]) < 0.15
    else:
        np.testing.assert_allclose(found.value, exact, atol=0.06)
    assert (found.low < found.value).all()
    if estimator is not DR:
        assert (found.low < exact).all()
        assert (exact < found.high).all()


@pytest.mark.slow
def test_ratios_of_occupancies_are_those_of_the_world():
    true = garnet(states=4, actions=2, noise=0.1)
    behavior, target = tables(true, 1, 0.3)[0], tables(true, 1, 1.0, seed=1)[0]
    log = true.log(behavior, 4000, 20, np.random.default_rng(0))
    case = OPEInput(log, as_policy(target), discount=0.8, logged=True)
    weights = DRL.nuisances(case)[0].weights[0]
    state = log.observations.argmax(1)
    logged = np.bincount(state * 2 + log.actions, minlength=8).reshape(4, 2) / len(log)
    exact = true.occupancy(target, 0.8) / logged
    told = [[weights[(state == s) & (log.actions == a)].mean() for a in range(2)] for s in range(4)]
    np.testing.assert_allclose(told, exact, rtol=0.08)
    assert weights.mean() == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_a_linear_quadratic_problem_is_solved_by_products_of_features():
    """x' = 0.8 x + u + noise, reward -(x^2 + u^2), u = -0.5 x + noise of 0.3, five steps from x = 1."""
    rng = np.random.default_rng(0)
    n, steps, noise = 4000, 5, 0.1
    x, seen, did, got = np.ones(n), [], [], []
    for _ in range(steps):
        u = -0.2 * x + 0.5 * rng.standard_normal(n)
        seen.append(x), did.append(u), got.append(-(x**2 + u**2))
        x = 0.8 * x + u + noise * rng.standard_normal(n)
    flat = lambda rows: np.stack(rows, 1).reshape(-1)  # noqa: E731
    ends = np.tile(np.arange(steps) == steps - 1, n)
    log = Dataset.from_arrays(
        observations=flat(seen)[:, None], actions=flat(did)[:, None], rewards=flat(got), timeouts=ends,
        final_observations=x[:, None], action_space=Box([-4.0], [4.0]),
    )  # fmt: skip
    draw = lambda seen, rng: -0.5 * seen + 0.3 * rng.standard_normal(seen.shape)  # noqa: E731
    density = lambda seen, a: stats.norm.logpdf(a, -0.5 * seen, 0.3)[:, 0]  # noqa: E731
    few = DoublyRobust(kind="marginal", fqe=LinearFQE(fourier_features=16))  # the products are all that it needs
    found = few.on(OPEInput(log, BlackBoxPolicy(draw, density), discount=1.0, horizon=steps, logged=True))
    mean, variance, exact = 1.0, 0.0, 0.0
    for _ in range(steps):
        second = mean**2 + variance
        exact -= second + 0.25 * second + 0.09
        mean, variance = 0.3 * mean, 0.09 * variance + 0.09 + noise**2
    assert found.value[0] == pytest.approx(exact, abs=0.05)
    assert found.low[0] < exact < found.high[0]


# ---- out of fold --------------------------------------------------------------------------------------------------------


def bandit(rng, rows=1000, actions=4, noise=1.0, known=True, size=6):
    """One step, uniform actions, and rewards that are noise."""
    extras = {"behavior_log_probs": np.full(rows, -np.log(actions))} if known else {}
    return Dataset.from_arrays(
        observations=rng.standard_normal((rows, size)), actions=rng.integers(0, actions, rows),
        rewards=noise * rng.standard_normal(rows), terminals=np.ones(rows, bool), action_space=Discrete(actions), **extras,
    )  # fmt: skip


def memory(log, share=0.9):
    """A policy that has learned by heart which logged actions paid."""
    keys = {row.tobytes(): (a, r) for row, a, r in zip(log.observations, log.actions, log.rewards)}

    def probs(seen):
        out = np.full((len(seen), log.spec.action_size), (1 - share) / (log.spec.action_size - 1))
        for i, row in enumerate(np.asarray(seen, np.float32)):
            action, reward = keys.get(row.tobytes(), (0, 0.0))
            out[i] = 1.0 / log.spec.action_size
            if reward > 0:
                out[i] = (1 - share) / (log.spec.action_size - 1)
                out[i, action] = share
        return out

    def draw(seen, rng):
        return (rng.random(len(seen))[:, None] >= probs(seen).cumsum(1)[:, :-1]).sum(1)

    return BlackBoxPolicy(draw, action_probs=probs)


@pytest.mark.slow
def test_a_policy_that_memorised_noise_is_praised_on_its_own_rows_alone():
    log = bandit(np.random.default_rng(0))
    part, held = log.split(0.8)
    policy = memory(part)
    case = OPEInput(part, policy, discount=0.0, logged=True, noise=None)
    own = decide(case, [DR], model=QUICK)
    assert own.choice.gain > 0.2  # which is why it must be told; here weights that do not average to 1 give it away, too
    assert "propensities are wrong" in own.choice.reason
    assert not own.choice.deploy
    known = ["it was trained on these episodes"]
    told = decide(case, [DR], seen=known, model=QUICK)
    assert not told.choice.deploy
    assert "it was trained on these episodes" in told.choice.reason
    fresh = np.isin(log.episode_ids, held.episode_ids)
    new = decide(OPEInput(log, policy, discount=0.0, logged=True, held=np.flatnonzero(fresh), noise=None), model=QUICK)
    assert not new.choice.deploy
    assert new.choice.low < 0.0 < new.choice.high


@pytest.mark.slow
def test_critics_out_of_fold_leave_the_noise_to_be_corrected():
    """In sample a critic of many features explains noise; out of fold it cannot."""
    log = bandit(np.random.default_rng(1), rows=400)
    case = OPEInput(log, as_uniform(4), discount=0.0, logged=True)
    flexible = LinearFQE(ridge=1e-2)
    residual = DoublyRobust(kind="dr", fqe=flexible).on(case).diagnostics["residual"][0]
    assert residual > 0.9
    assert LinearFQE().label == "FQE-linear"
    network = DoublyRobust(kind="dr", fqe=estimator_of(steps=1500, hidden=(32,), lr=1e-2, batch_size=64, members=2))
    assert network.on(case).diagnostics["residual"][0] > 0.9
    assert network.replace(folds=1).on(case).diagnostics["residual"][0] < 0.9


def estimator_of(**fields):
    from deadreckon.ope import FQE

    return FQE(**fields)


def as_uniform(actions):
    probs = lambda seen: np.full((len(seen), actions), 1 / actions)  # noqa: E731
    return BlackBoxPolicy(lambda seen, rng: rng.integers(0, actions, len(seen)), action_probs=probs)


@pytest.mark.parametrize("kind", ["dr", "mrdr"])
def test_values_are_means_of_action_values(kind):
    """Every context is logged with every action, so that whatever the critics say cancels: the estimate is the exact mean.

    Rewards are rare, so that critics say less than zero of some actions; cutting these at zero would be a bias.
    """
    rng = np.random.default_rng(8)
    seen, paid = rng.standard_normal((150, 5)), (rng.random((150, 4)) < 0.15).astype(float)
    log = Dataset.from_arrays(
        observations=np.repeat(seen, 4, 0), actions=np.tile(np.arange(4), 150), rewards=paid.reshape(-1),
        terminals=np.ones(600, bool), action_space=Discrete(4), behavior_log_probs=np.full(600, -np.log(4)),
    )  # fmt: skip
    weights = rng.standard_normal((5, 4))
    probs = lambda x: softmax(x @ weights)  # noqa: E731
    policy = BlackBoxPolicy(lambda x, rng: probs(x).argmax(1), action_probs=probs)
    case = OPEInput(log, policy, discount=0.0, horizon=1, logged=True, clusters=np.repeat(np.arange(150), 4))
    found = DoublyRobust(kind=kind, fqe=LinearFQE(fourier_features=32, ridge=0.1)).on(case)
    assert found.value[0] == pytest.approx((probs(seen) * paid).sum(1).mean(), abs=1e-5)


@pytest.mark.slow
def test_learned_propensities_come_from_other_folds():
    """A model that is fitted for long memorises; of rows it has not seen it says what it knows, which is next to nothing."""
    log = bandit(np.random.default_rng(2), rows=300, known=False)
    case = OPEInput(log, as_uniform(4), discount=0.0, logged=True)
    long = BehaviorModel(hidden=(64,), steps=2000, lr=1e-2, batch_size=64)
    held = out_of_fold(case, long, 5)
    assert held.log_probs.mean() == pytest.approx(np.log(0.25), abs=0.1)
    assert held.chances.sum(1) == pytest.approx(np.ones(300))
    assert case.behavior_log_probs("learned", long).mean() > np.log(0.25) + 0.3  # in sample it believes far more
    weights = ImportanceSampling(normalised=False, model=long).on(case)
    assert weights.value[0] == pytest.approx(weights.value[1], abs=0.1)


def test_a_mixture_over_folds_is_judged_by_the_policy_that_has_not_seen_the_episode():
    log = bandit(np.random.default_rng(3), rows=900)
    which = np.random.default_rng(0).permutation(np.arange(900) % 3)
    policies = tuple(memory(log.select(np.flatnonzero(which != k))) for k in range(3))
    crossed = CrossFitted(policies, which)
    case = OPEInput(log, [crossed, policies[0]], discount=0.0, logged=True, names=["crossed", "seen"])
    found = ImportanceSampling(normalised=False).on(case)
    assert abs(found.value[0] - found.value[-1]) < 0.25
    assert found.value[1] > 0.4
    # By hand: each row's weight is that of the policy of its fold.
    probs = np.stack([p.action_probs(log.observations) for p in policies])[which, np.arange(900), log.actions]
    assert found.value[0] == pytest.approx((4 * probs * log.rewards).mean(), rel=1e-5)
    # Folds judge each other's policies: errors count more.
    assert case.inflation.tolist() == [np.sqrt(2), 1.0, 1.0]
    alone = ImportanceSampling(normalised=False).on(OPEInput(log, [policies[0]], discount=0.0, logged=True, names=["seen"]))
    assert found.high[1] - found.low[1] == pytest.approx(alone.high[0] - alone.low[0])
    plain = inference.intervals(found.value, found.influence, seed=case.seed)
    assert found.high[0] - found.low[0] == pytest.approx(np.sqrt(2) * (plain[1][0] - plain[0][0]))
    # What is fitted to all folds for a policy has the rewards that taught it, and is not corrected.
    assert [each.label for each in automatic(case)] == ["DR-linear", "WPDIS"]
    for name in ("fqe", "fqe-linear", "fqe-d", "drl", "smis", "dual-dice", "vpm", "mb-ff"):
        with pytest.raises(UserError, match="cross-fitted ones differ by fold"):
            estimator(name).on(case)
    drawn = OPEInput(log, [CrossFitted(policies, which, drawn=True)], discount=0.0)
    with pytest.raises(UserError, match="FQE-linear evaluates .*, and those of a mixture differ by episode"):
        estimator("fqe-linear").on(drawn)
    with pytest.raises(UserError, match="has no policy for some evaluated episodes"):
        OPEInput(log, [CrossFitted(policies, which - 1)], discount=0.0)


# ---- simultaneous -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_intervals_of_all_policies_at_once_by_simulation():
    """Eight estimates of skewed scores that vary together, of 60 units: all inside in 95 % of logs, each alone in more."""
    rng, hits, alone, count = np.random.default_rng(0), 0, 0, 300
    for seed in range(count):
        scores = rng.exponential(size=(60, 9)) - 1.0
        scores[:, :8] = 0.5 * scores[:, [8]] + scores[:, :8]
        mean = scores[:, :8].mean(0)
        value, psi = np.append(mean, 0.0), np.concatenate([scores[:, :8] - mean, np.zeros((60, 1))], 1)
        _, low, high = inference.gains(value, psi, 8, seed=seed)
        hits += bool(((low <= 0) & (high >= 0)).all())
        one_low, one_high = inference.intervals(mean, scores[:, :8] - mean, seed=seed)
        alone += np.mean((one_low <= 0) & (one_high >= 0))
    assert 0.915 <= hits / count <= 0.985, hits / count  # three deviations of 300 draws
    assert 0.93 <= alone / count <= 0.975, alone / count


def test_a_look_that_has_little_error_left_still_has_an_interval():
    """Beyond the bootstrap the quantile goes on as Student's: it grows with every halving of alpha, by little."""
    psi = np.random.default_rng(0).standard_normal((400, 5))
    reach = [inference.simultaneous(psi, 0.05 / 2**k) for k in range(1, 12)]
    assert (np.diff(reach) > 0).all()
    assert np.diff(reach).max() < 0.5
    assert reach[-1] < 6.0


def test_the_factor_is_students_for_one_normal_estimate_and_more_for_many():
    rng = np.random.default_rng(0)
    one = rng.standard_normal((500, 1))
    assert inference.simultaneous(one) == pytest.approx(stats.t.ppf(0.975, 499), rel=0.08)
    many = rng.standard_normal((500, 10))
    assert inference.simultaneous(many) == pytest.approx(stats.norm.ppf(1 - 0.025 / 10), rel=0.08)
    assert inference.simultaneous(np.repeat(one, 10, 1)) == pytest.approx(inference.simultaneous(one), rel=1e-6)
    assert inference.simultaneous(one[:1]) == np.inf
    low, high = inference.intervals(np.zeros(1), one[:1])
    assert (low[0], high[0]) == (-np.inf, np.inf)


def test_clusters_are_redrawn_as_one():
    """Users whose rewards are alike: by episodes the interval is far too short."""
    rng = np.random.default_rng(0)
    users = np.repeat(np.arange(40), 25)
    log = bandit(rng, rows=1000)
    rewards = log.rewards * 0.1 + rng.standard_normal(40)[users]
    log = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=rewards, terminals=log.terminals,
        action_space=Discrete(4), behavior_log_probs=np.full(1000, -np.log(4)),
    )  # fmt: skip
    errors, half = {}, {}
    for name, clusters in (("episodes", None), ("users", users)):
        case = OPEInput(log, as_uniform(4), discount=0.0, logged=True, clusters=clusters)
        errors[name] = inference.errors(ImportanceSampling(normalised=False).on(case).influence)[-1]
        assert len(np.unique(case.units)) == (1000 if clusters is None else 40)
        students = ImportanceSampling(normalised=False, interval="t").on(case)
        half[name] = (students.high - students.low)[-1] / 2
        assert clusters is None or all(len(set(case.folds(5)[users == u])) == 1 for u in range(40))
    assert errors["users"] == pytest.approx(1.0 / np.sqrt(40), rel=0.3)
    assert errors["users"] > 3 * errors["episodes"]
    assert half["users"] == pytest.approx(stats.t.ppf(0.975, 39) * errors["users"])
    assert half["episodes"] == pytest.approx(stats.t.ppf(0.975, 999) * errors["episodes"])
    bound = ImportanceSampling(normalised=False, interval="hoeffding", return_range=(-9.0, 9.0), max_weight=4.0)
    with pytest.raises(UserError, match="interval='hoeffding' needs independent episodes, which those of a cluster are not"):
        bound.on(case)


@pytest.mark.parametrize("judge", [ImportanceSampling(), ImportanceSampling(kind="trajectory"), DR, DRL], ids=lambda x: x.label)
def test_weights_rest_on_clusters_and_not_on_their_episodes(judge):
    """Forty stores with one action each, which four of them take: a thousand customers of these are four."""
    rng = np.random.default_rng(0)
    store, actions = np.repeat(np.arange(40), 25), np.repeat(np.arange(40) % 10 == 0, 25).astype(int)
    log = Dataset.from_arrays(
        observations=np.ones((1000, 1)), actions=actions, rewards=actions + rng.standard_normal(1000),
        terminals=np.ones(1000, bool), action_space=Discrete(2), behavior_log_probs=np.log(np.where(actions == 1, 0.1, 0.9)),
    )  # fmt: skip
    for clusters in (None, store):
        found = judge.on(OPEInput(log, constant([0.0, 1.0]), discount=0.0, horizon=1, logged=True, clusters=clusters))
        assert found.ess[0] == pytest.approx(100.0, rel=0.1)
        amount = found.diagnostics.get("effective clusters", [np.inf])[0]
        assert amount == (np.inf if clusters is None else pytest.approx(4.0, rel=0.05))
        told = f"its weights rest on {amount:.1f} clusters, 10 are needed"
        assert any(told in line for line in select([found]).objections[0]) == (clusters is not None)


# ---- checks -------------------------------------------------------------------------------------------------------------


def lacking(rng, rows, logged, known=True):
    """Three actions of which the log takes the last with probability `logged`."""
    chances = np.array([(1 - logged) / 2, (1 - logged) / 2, logged])
    actions = rng.choice(3, rows, p=chances)
    extras = {"behavior_log_probs": np.log(chances[actions])} if known else {}
    rewards = np.array([0.0, 0.0, 5.0])[actions] + rng.standard_normal(rows)
    return Dataset.from_arrays(
        observations=rng.standard_normal((rows, 2)), actions=actions, rewards=rewards, terminals=np.ones(rows, bool),
        action_space=Discrete(3), **extras,
    )  # fmt: skip


@pytest.mark.parametrize("known", [True, False])
def test_actions_that_the_log_never_takes_are_told(known):
    policy = constant([0.35, 0.35, 0.3])
    for logged in (0.0, 0.15):
        log = lacking(np.random.default_rng(4), 1500, logged, known)
        case = OPEInput(log, policy, discount=0.0, logged=True, noise=None)
        found = support(case, QUICK)
        if logged:
            assert found.missing[0] < 0.02
            assert found.ratio[0] == pytest.approx(1.0, abs=0.12)
            assert not found.objections(0)
        else:
            assert found.missing[0] == pytest.approx(0.3, abs=0.01)
            assert found.ratio[0] == pytest.approx(0.7, abs=0.1)
            assert any("have no support" in line for line in found.objections(0))
            assert any("instead of 1" in line for line in found.objections(0))
            assert not decide(case, model=QUICK).choice.deploy


@pytest.mark.slow
def test_no_overlap_knows_nothing():
    """A policy that never does what was logged: minus to plus infinity, not zero to zero."""
    log = lacking(np.random.default_rng(5), 200, 0.0)
    case = OPEInput(log, constant([0.0, 0.0, 1.0]), discount=0.0, logged=True)
    for each in (ImportanceSampling(), ImportanceSampling(normalised=False), ImportanceSampling(kind="trajectory"), DR):
        found = each.on(case)
        assert (found.low[0], found.high[0]) == (-np.inf, np.inf)
        gain = decide(case, [each], model=QUICK).choice
        assert (gain.low, gain.high) == (-np.inf, np.inf)
        assert not gain.deploy


@pytest.mark.slow
def test_deterministic_continuous_policies_are_model_based_only():
    rng = np.random.default_rng(6)
    seen, did = rng.standard_normal((400, 1)), rng.uniform(-1, 1, (400, 1))
    log = Dataset.from_arrays(
        observations=seen, actions=did, rewards=did[:, 0], terminals=np.ones(400, bool), action_space=Box([-1.0], [1.0]),
        behavior_log_probs=np.full(400, -np.log(2.0)),
    )  # fmt: skip
    up = BlackBoxPolicy(lambda seen, rng: np.full((len(seen), 1), 0.9))
    half = BlackBoxPolicy(lambda seen, rng: rng.uniform(0, 1, (len(seen), 1)),
                          lambda seen, a: np.where(a[:, 0] >= 0, 0.0, -np.inf))  # fmt: skip
    case = OPEInput(log, [up, half], discount=0.0, logged=True, noise=None, names=["up", "half"])
    assert case.degenerate.tolist() == [True, False]
    found = decide(case, model=QUICK)
    assert any("model-based only" in line for line in found.choice.objections[0])
    assert found.choice.name == "half"
    assert found.choice.deploy
    alone = OPEInput(log, [up], discount=0.0, logged=True, noise=None, names=["up"])
    assert [type(e).__name__ for e in automatic(alone)] == ["FQE"]


@pytest.mark.slow
def test_few_clusters_decide_nothing():
    log = lacking(np.random.default_rng(7), 19, 0.4)
    choice = decide(OPEInput(log, constant([0.1, 0.1, 0.8]), discount=0.0, logged=True), model=QUICK).choice
    assert not choice.deploy
    assert "only 19 episodes or clusters" in choice.reason


# ---- the promise --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_cross_fitted_estimates_are_unbiased_and_cover_on_generated_bandits():
    """Rewards depend on the context and the action; 200 logs, known propensities (learned ones in the study)."""
    logs, rng, errors, hits = 200, np.random.default_rng(0), [], 0
    weights = np.random.default_rng(1).standard_normal((4, 3))
    probs = lambda seen: softmax(2.0 * seen @ weights)  # noqa: E731
    policy = BlackBoxPolicy(lambda seen, rng: probs(seen).argmax(1), action_probs=probs)
    many = rng.standard_normal((100_000, 4))
    exact = (probs(many) * (many @ weights)).sum(1).mean()
    for seed in range(logs):
        seen = rng.standard_normal((500, 4))
        base = softmax(seen @ weights[:, ::-1])
        actions = (rng.random(500)[:, None] >= base.cumsum(1)[:, :-1]).sum(1)
        rewards = (seen @ weights)[np.arange(500), actions] + rng.standard_normal(500)
        log = Dataset.from_arrays(
            observations=seen, actions=actions, rewards=rewards, terminals=np.ones(500, bool), action_space=Discrete(3),
            behavior_log_probs=np.log(base[np.arange(500), actions]),
        )  # fmt: skip
        found = DR.on(OPEInput(log, policy, discount=0.0, logged=True, seed=seed))
        errors.append(found.value[0] - exact)
        hits += found.low[0] <= exact <= found.high[0]
    assert abs(np.mean(errors)) < 3 * np.std(errors) / np.sqrt(logs) + 0.01
    assert stats.binom.cdf(hits, logs, 0.95) > 0.01, hits


@pytest.mark.parametrize("differ", [True, False])
def test_rows_of_different_weights_deploy_nothing(differ):
    """Successes were recorded always, and failures one time in ten: rates of the rows are not those of the population."""
    rng = np.random.default_rng(0)
    actions, rewards = np.tile([0, 1], 200), np.repeat([0.0, 1.0], 200)
    rewards[1::2] = 1.0
    columns = {"x": rng.normal(size=400), "action": actions, "reward": rewards, "propensity": np.full(400, 0.5)}
    columns["w"] = np.where(rewards > 0, 1.0, 10.0) if differ else np.full(400, 3.0)
    log = Dataset.from_frame(
        columns, action="action", reward="reward", observations=["x"], propensity="propensity", weight="w"
    )  # fmt: skip
    found = decide(OPEInput(log, constant([0.2, 0.8]), discount=0.0, logged=True), stationary=True)
    assert found.choice.low > 0
    assert found.choice.deploy is not differ
    told = "the weights in column w are not used: keep each episode with a probability proportional to its weight"
    assert (told in found.choice.reason) is differ


def test_gains_of_nothing_are_above_zero_as_often_as_promised():
    """Scores of noise of three policies and the log's own, 25 units each: the level of 5 % is that of both ends together."""
    rng, above, logs = np.random.default_rng(0), 0, 1000
    for _ in range(logs):
        scores = rng.standard_normal((25, 4))
        mean = scores.mean(0)
        _, low, _ = inference.gains(mean, scores - mean, 3)
        above += bool((low[:3] > 0).any())
    least, most = stats.binom.ppf([0.01, 0.99], logs, 0.025)
    assert least <= above <= most, above


@pytest.mark.slow
def test_policies_that_memorised_noise_are_not_deployed():
    """On the other part of 12 logs; how often a gain of nothing is above zero is counted above."""
    deployed = 0
    for seed in range(12):
        log = bandit(np.random.default_rng(seed), rows=500)
        part, _ = log.split(0.8, seed=seed)
        held = np.flatnonzero(~np.isin(log.episode_ids, part.episode_ids))
        case = OPEInput(log, [memory(part), memory(part, 0.6)], discount=0.0, logged=True, held=held, seed=seed, noise=None)
        assert LOGGED in case.names
        deployed += decide(case, [DR], alpha=0.025, model=BehaviorModel(hidden=(4,), steps=50, lr=1e-2)).choice.deploy
    assert deployed == 0


def test_an_estimator_that_cannot_answer_is_told_before_anything_is_fitted(monkeypatch):
    def never(*given):
        raise AssertionError("support was looked at")

    monkeypatch.setattr("deadreckon.ope.decide.support", never)
    with pytest.raises(UserError, match="MB-FF does not take a horizon"):
        decide(by_hand(horizon=2), ["is", "mb-ff"])


@pytest.mark.filterwarnings("error")
def test_weights_that_overflow_are_told_and_leave_an_unbounded_interval():
    # Two episodes of 400 rare actions that pay 1 and -1: the policy takes them 99 times as often, and 99^400 is no float64.
    log = Dataset.from_arrays(
        observations=np.zeros((800, 1)), actions=np.zeros(800, int), rewards=np.repeat([1.0, -1.0], 400),
        terminals=np.arange(800) % 400 == 399, timeouts=np.zeros(800, bool), action_space=Discrete(2),
        behavior_log_probs=np.full(800, np.log(0.01)),
    )  # fmt: skip
    found = ImportanceSampling(normalised=False).on(OPEInput(log, constant([0.99, 0.01]), discount=1.0))
    assert np.isnan(found.value[0])
    assert (found.low[0], found.high[0]) == (-np.inf, np.inf)
    assert any("no finite estimate of" in text for text in found.warnings)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_no_inflation_brings_an_interval_back(value):
    class Overflowing(Estimator):
        @property
        def label(self):
            return "overflowing"

        def solve(self, case):
            ends = np.array([value, 1.0])
            return Estimates("overflowing", ("a", "b"), ends, ends - 1, ends + 1, case.estimand, inflation=np.array([2.0, 2.0]))

    found = Overflowing().on(by_hand())
    assert (found.low.tolist(), found.high.tolist()) == ([-np.inf, -1.0], [np.inf, 3.0])
    assert found.warnings == ("no finite estimate of a",)
