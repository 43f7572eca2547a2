"""How often the intervals of estimates cover the true value."""

from functools import partial

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.ope import FQE, DoublyRobust, ImportanceSampling, OPEInput
from deadreckon.ope.weights import Episodes
from deadreckon.theory import garnet
from tests.ope.worlds import as_policy, keep_nuisances, tables

COVERED = {
    "pdis, t": ImportanceSampling(normalised=False, interval="t"),
    "pdis, bootstrap": ImportanceSampling(normalised=False),
    "wpdis, t": ImportanceSampling(interval="t"),
    "wpdis, bootstrap": ImportanceSampling(),
    "dr, t": DoublyRobust(kind="dr", folds=1),
    "wdr, bootstrap": DoublyRobust(kind="wdr", folds=1),
}


@pytest.fixture(scope="module")
def logs():
    """Logs of one world, as functions that make cases, with a value function that knows nothing of them."""
    true = garnet(states=4, actions=2, ending=0.3, noise=0.3)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.5, seed=1)[0]
    rng = np.random.default_rng(0)
    policy = as_policy(target)

    def make(log):
        case = OPEInput(log, [policy], discount=0.9)
        # The true values with an error, as a fit of another log might have them.
        q = 0.8 * true.q(target, 0.9) + 0.2
        state, after = case.data.observations.argmax(1), case.data.next_observations.argmax(1)
        v = (target * q).sum(1)
        errors = case.data.rewards + 0.9 * np.where(case.data.terminals, 0.0, v[after]) - q[state, case.data.actions]
        for each in ("dr, t", "wdr, bootstrap"):
            keep_nuisances(case, COVERED[each], v[state[case.data.starts]][None, None], errors[None].astype(float))
        return case

    return [partial(make, true.log(behavior, 100, 60, rng)) for _ in range(LOGS)], true.value(target, 0.9)


LOGS, FEWER, FEWEST = 400, 200, 150


@pytest.mark.parametrize("name", ["pdis, bootstrap", "wpdis, bootstrap"])
def test_coverage_of_the_first_logs(logs, name):
    """Not less than 95 % by more than three standard deviations of 150 draws, and not always; more logs are below."""
    makers, exact = logs[0][:FEWEST], logs[1]
    inside = [found.low[0] <= exact <= found.high[0] for found in (COVERED[name].on(make()) for make in makers)]
    assert 0.897 <= np.mean(inside) < 1.0, np.mean(inside)


@pytest.mark.slow
@pytest.mark.parametrize("name", COVERED)
def test_coverage(logs, name):
    makers, exact = logs
    inside = [found.low[0] <= exact <= found.high[0] for found in (COVERED[name].on(make()) for make in makers)]
    assert 0.92 <= np.mean(inside) <= 0.98, np.mean(inside)


@pytest.mark.slow
@pytest.mark.parametrize("normalised", [True, False])
def test_coverage_of_whole_episodes(logs, normalised):
    """Their weights spread further: intervals are a little short, as the documentation says."""
    makers, exact = logs[0][:FEWER], logs[1]
    estimator = ImportanceSampling(kind="trajectory", normalised=normalised)
    inside = [found.low[0] <= exact <= found.high[0] for found in (estimator.on(make()) for make in makers)]
    assert 0.89 <= np.mean(inside) <= 0.96, np.mean(inside)


@pytest.mark.slow
@pytest.mark.parametrize("interval", ["hoeffding", "bernstein"])
def test_bounds_hold_more_often_than_promised(interval):
    """One step of a reward of 0 or 1, half as likely again under the policy: a return of 0 to 1, a weight of 1.5 at most."""
    rng = np.random.default_rng(0)
    estimator = ImportanceSampling(normalised=False, interval=interval, return_range=(0.0, 1.0), max_weight=1.5)
    inside, widths = [], []
    for _ in range(80):
        log = one_state(200, np.ones(200, int), np.ones(200, bool), 0.5, rng)
        found = estimator.estimate(log, as_policy(np.array([[0.75, 0.25]])), discount=0.0)
        inside.append(found.low[0] <= 0.75 <= found.high[0])
        widths.append(found.high[0] - found.low[0])
    assert np.mean(inside) >= 0.95
    if interval == "hoeffding":
        np.testing.assert_allclose(widths, 2 * 1.5 * np.sqrt(np.log(40) / 400), rtol=1e-6)
    assert max(widths) < 0.5  # and still say something


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_coverage_of_an_ensemble():
    """Members on redrawn episodes: 300 logs of equal shape, so that one compiled program does all (minutes)."""
    true = garnet(states=4, actions=2, noise=0.3)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.5, seed=1)[0]
    fqe = FQE(hidden=(), steps=1500, lr=1e-2, weight_decay=0.0, tau=0.05, batch_size=256)
    rng = np.random.default_rng(0)
    exact, policy, inside = true.value(target, 0.9), as_policy(target), []
    for seed in range(300):
        found = fqe.estimate(true.log(behavior, 60, 8, rng), policy, discount=0.9, seed=seed)
        inside.append(found.low[0] <= exact <= found.high[0])
    assert 0.92 <= np.mean(inside) <= 0.98, np.mean(inside)


def test_bounds_that_hold_for_every_number_of_episodes(logs):
    makers, exact = logs
    case = makers[0]()
    bounded = {"return_range": (-20.0, 20.0), "max_weight": 8.0, "normalised": False, "kind": "trajectory"}
    wide = {}
    for interval in ("t", "bernstein", "hoeffding"):
        found = ImportanceSampling(interval=interval, **bounded).on(case)
        assert found.low[0] < exact < found.high[0]
        wide[interval] = found.high[0] - found.low[0]
    assert wide["t"] < wide["bernstein"]
    assert wide["t"] < wide["hoeffding"]
    with pytest.raises(UserError, match="needs normalised=False, return_range"):
        ImportanceSampling(interval="hoeffding").on(case)
    with pytest.raises(UserError, match=r"return_range must be \(least, greatest\) and max_weight above 0, got 20, -20 and 8"):
        ImportanceSampling(interval="hoeffding", **{**bounded, "return_range": (20.0, -20.0)}).on(case)
    with pytest.raises(UserError, match="an episode adds .*, outside the 0 .. 0.01 that return_range and max_weight allow"):
        ImportanceSampling(interval="hoeffding", **{**bounded, "return_range": (0.0, 0.01), "max_weight": 1.0}).on(case)


def test_sums_by_hand():
    """Two episodes, one ended after its first step: its weight counts at the second step too."""
    true = garnet(states=3, actions=2, ending=0.4)
    log = true.log(tables(true, 1, 0.1)[0], 400, 10, np.random.default_rng(0))
    pick = [int(np.flatnonzero((log.lengths == 1) & log.terminals[log.ends])[0]), int(np.flatnonzero(log.lengths == 2)[0])]
    two = log.select(pick)
    episodes = Episodes(two, 0.5, 0, np.arange(2))
    log_rho = episodes.cumulate(np.log([3.0, 2.0, 0.5]))
    np.testing.assert_allclose(np.exp(log_rho), [3.0, 2.0, 1.0])
    x = np.array([10.0, 20.0, 40.0])
    plain = episodes.sums(log_rho, x, normalised=False)
    assert plain.value() == pytest.approx((30 + 40) / 2 + 0.5 * 40 / 2)
    weighted = episodes.sums(log_rho, x, normalised=True)
    assert weighted.value() == pytest.approx((30 + 40) / 5 + 0.5 * 40 / (3 + 1))
    public = episodes.sums(log_rho, x, normalised=True, alive_only=True)
    assert public.value() == pytest.approx((30 + 40) / 5 + 0.5 * 40 / 1)
    assert weighted.ess == pytest.approx(16 / 10)  # at the second step; 25 / 13 at the first
    whole = episodes.whole(log_rho, x, normalised=True)
    assert whole.value() == pytest.approx((3 * 10 + 1 * (20 + 20)) / 4)
    np.testing.assert_allclose(episodes.contributions(log_rho, x, whole=False), [30, 40 + 20])
    # Redrawing every episode once is the estimate itself.
    assert weighted.redraw(np.ones((1, 2)))[0] == pytest.approx(weighted.value())
    assert abs(weighted.influence().sum()) < 1e-12


def test_weights_do_not_overflow():
    """A thousand steps, each e^2 times likelier: self-normalised weights stay finite."""
    true = garnet(states=3, actions=2)
    log = true.log(tables(true, 1, 0.1)[0], 5, 1000, np.random.default_rng(0))
    episodes = Episodes(log, 0.99, 0, np.arange(5))
    ratios = np.full(len(log), 2.0) + np.repeat(np.arange(5), 1000) * 1e-3
    sums = episodes.sums(episodes.cumulate(ratios), np.asarray(log.rewards, float), normalised=True)
    assert np.isfinite(sums.value())
    assert np.isfinite(sums.redraw(episodes.counts)).all()
    assert 1.0 <= sums.ess <= 5.0
    # An action that the policy never takes leaves the episode without weight from there on.
    ratios[3000] = -np.inf
    log_rho = episodes.cumulate(ratios)
    assert np.isneginf(log_rho[3000:4000]).all()
    assert np.isfinite(log_rho[2000:3000]).all()
    assert np.isfinite(log_rho[4000:]).all()


def one_state(count, lengths, terminal, chance, rng):
    """Episodes of given lengths in one state with two actions, of which the first, drawn with `chance`, is rewarded with 1."""
    rows = int(lengths.sum())
    ends = np.cumsum(lengths) - 1
    actions = (rng.random(rows) >= chance).astype(int)
    terminals, timeouts = np.zeros(rows, bool), np.zeros(rows, bool)
    terminals[ends], timeouts[ends] = terminal, ~terminal
    return Dataset.from_arrays(
        observations=np.ones((rows, 1), np.float32), actions=actions, rewards=(actions == 0).astype(np.float32),
        terminals=terminals, timeouts=timeouts, action_space=Discrete(2),
        behavior_log_probs=np.log(np.where(actions == 0, chance, 1 - chance)),
    )  # fmt: skip


def test_weights_that_collapse_late_are_told():
    """Over 300 steps the weights come to rest on one episode; the first steps alone would hide it."""
    rng = np.random.default_rng(0)
    log = one_state(1000, np.full(1000, 300), np.zeros(1000, bool), 0.5, rng)
    found = ImportanceSampling().estimate(log, as_policy(np.array([[0.75, 0.25]])), discount=0.995)
    assert found.ess[0] < 5
    assert any("the weights of policy 0 rest on" in line for line in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", [ImportanceSampling(), ImportanceSampling(normalised=False)], ids=["wpdis", "pdis"])
def test_cut_offs_do_not_favour_episodes_that_end_early(estimator):
    """Half of the log may be cut off after 5 steps; on-policy, with episodes that end with a chance of 0.1 a step."""
    rng = np.random.default_rng(1)
    lives, cuts = rng.geometric(0.1, 4000), np.where(rng.random(4000) < 0.5, 5, 200)
    log = one_state(4000, np.minimum(lives, cuts), lives <= cuts, 0.7, rng)
    found = estimator.estimate(log, as_policy(np.array([[0.7, 0.3]])), discount=0.99)
    exact = 0.7 / (1 - 0.9 * 0.99)
    assert found.low[0] < exact < found.high[0]
    assert found.high[0] - found.low[0] < 0.6
    trajectory = ImportanceSampling(kind="trajectory").estimate(log, as_policy(np.array([[0.7, 0.3]])), discount=0.99)
    assert any("cut off at different steps" in line for line in trajectory.warnings)
    # Half of the log's cut-offs leave 0.99^5 of the time, not 0.99 to their mean length.
    assert any("95 % of the discounted time" in line for line in found.warnings)


def test_chances_of_being_cut_off_by_hand():
    """Lengths 1 (ended), 2 (cut), 3 (ended), 3 (cut): after two steps one of three that still went on was cut off."""
    log = one_state(4, np.array([1, 2, 3, 3]), np.array([True, False, True, False]), 0.5, np.random.default_rng(0))
    np.testing.assert_allclose(Episodes(log, 0.9, 0, np.arange(4)).uncensored, [1.0, 1.0, 2 / 3, 0.0])


def test_the_share_of_the_policys_episodes_that_go_on_by_hand():
    """Of the same episodes, with weights: ended ones keep their last, and cut-off ones go on."""
    log = one_state(4, np.array([1, 2, 3, 3]), np.array([True, False, True, False]), 0.5, np.random.default_rng(0))
    episodes = Episodes(log, 0.9, 0, np.arange(4))
    log_rho = np.log([2.0, 3.0, 4.0, 1.0, 2.0, 5.0, 6.0, 7.0, 8.0])
    expected = [10 / 12, 13 / 15, 1.5 * 8 / (2 + 1.5 * (5 + 8))]
    np.testing.assert_allclose(episodes.going_on(log_rho), expected)
    nothing = np.full(9, -np.inf)
    np.testing.assert_array_equal(episodes.going_on(nothing), np.ones(3))
    np.testing.assert_array_equal(episodes.going_on(np.where(np.arange(9) == 0, 0.0, -np.inf)), np.zeros(3))


def test_one_episode_knows_no_interval():
    log = one_state(1, np.array([20]), np.array([False]), 0.5, np.random.default_rng(0))
    found = ImportanceSampling().estimate(log, as_policy(np.array([[0.5, 0.5]])), discount=0.9)
    assert (found.low[0], found.high[0]) == (-np.inf, np.inf)
    assert any("rest on 1.0 of 1 episodes" in line for line in found.warnings)
