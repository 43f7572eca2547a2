"""A behaviour policy and outcomes that change along the log: what is noise is not praised, and what needs nothing is left."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from deadreckon.data.dataset import Dataset
from deadreckon.data.history import stacked
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.ope import FQE, DoublyRobust, LinearFQE, OPEInput
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.decide import automatic, decide
from deadreckon.ope.over_time import adjusted, change_of, p_value
from deadreckon.ope.positions import PLACES, WAVES, places, waves, with_positions
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.offline import grounds, judge

MODEL = BehaviorModel(hidden=(16,), steps=400, lr=1e-2)
DR = DoublyRobust(kind="dr", fqe=LinearFQE(fourier_features=16), model=MODEL)


def constant(chances):
    """A policy of two actions with the same probabilities everywhere."""
    table = np.array([chances])
    return BlackBoxPolicy(
        lambda seen, rng: (rng.random(len(seen)) < chances[1]).astype(int),
        action_probs=lambda seen: np.repeat(table, len(seen), 0),
    )


OFTEN, SELDOM = constant((0.1, 0.9)), constant((0.9, 0.1))


def campaign(seed, rows=1500, by=0.6, trend=0.5, known=False, effect=0.0, order=None, **more):
    """One-step log in which the second action is taken more and more often, and rewards rise whatever is done."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) / rows
    chance = 0.5 + by * (time - 0.5)
    actions = (rng.random(rows) < chance).astype(int)
    rewards = (rng.random(rows) < 0.2 + trend * time + effect * actions).astype(float)
    if known:
        more["behavior_log_probs"] = np.log(np.where(actions == 1, chance, 1 - chance))
    which = slice(None) if order is None else order(rng, actions, rewards)
    columns = {"observations": rng.normal(size=(rows, 2)), "actions": actions, "rewards": rewards, **more}
    return Dataset.from_arrays(**{name: own[which] for name, own in columns.items()}, terminals=np.ones(rows))


def case_of(log, **options):
    """With both policies, of the immediate reward."""
    return OPEInput(log, [OFTEN, SELDOM], names=["often", "seldom"], logged=True, discount=0.0, **options)


def test_an_action_of_good_times_is_not_praised():
    """Rewards do not depend on the action; before, the policy that takes what was taken in good times was deployed."""
    for seed in range(3):
        log = campaign(seed)
        found = decide(case_of(log), [DR], model=MODEL)
        assert not found.choice.deploy
        assert (found.choice.gains[:, 1] <= 0).all()
        assert (found.choice.gains[:, 2] >= 0).all()
        p = change_of(case_of(log)).p_value
        over = found.more["over_time"]
        assert (over["stationary"], over["p_value"], over["adjusted"]) == (False, p, True)
        [line] = [each for each in found.choice.warnings if "changed along the log" in each]
        assert "(p < 0.001)" in line
        assert "--stationary" in line
        unadjusted = decide(case_of(log), [DR], model=MODEL, stationary=True)
        assert unadjusted.choice.deploy
        assert unadjusted.choice.name == "often"
        expected = {"stationary": True, "p_value": None, "adjusted": False, "within_clusters": False}
        assert unadjusted.more["over_time"] == expected


def test_logged_propensities_of_their_time_are_right_with_positions_too():
    case = case_of(campaign(0, known=True))
    assert adjusted(case).positions
    found = decide(case, [DR], model=MODEL)
    assert not found.choice.deploy
    assert (found.choice.gains[:, 1] <= 0).all()
    assert (found.choice.gains[:, 2] >= 0).all()


def contacts(seed, users=500, effect=0.0, shuffled=True):
    """One-step log of users who are contacted until they answer, up to six times, and called more and more often; how readily
    they answer is not recorded. Also the user of each row."""
    rng = np.random.default_rng(seed)
    contact, user = np.tile(np.arange(6), users), np.repeat(np.arange(users), 6)
    actions = (rng.random(6 * users) < np.array([0.15, 0.3, 0.5, 0.65, 0.8, 0.85])[contact]).astype(int)
    answered = rng.random(6 * users) < np.repeat(rng.beta(0.5, 0.8, users), 6) * 0.8 + effect * actions
    before = np.cumsum(answered.reshape(users, 6), 1) - answered.reshape(users, 6)
    rows = np.flatnonzero(before.ravel() == 0)
    if shuffled:  # users come and go, and their contacts stay in order
        mixed = rng.permutation(user[rows])
        rows = rows[np.argsort(np.argsort(mixed, kind="stable"), kind="stable")]
    log = Dataset.from_arrays(
        observations=rng.normal(size=(len(rows), 2)), actions=actions[rows], rewards=answered[rows].astype(float),
        terminals=np.ones(len(rows)),
    )  # fmt: skip
    return log, user[rows]


def test_an_action_of_first_contacts_is_not_praised():
    """Whoever is left for later contacts answers less often; before, the policy that seldom calls was deployed."""
    for seed in range(3):
        log, user = contacts(seed, shuffled=bool(seed))
        case = case_of(log, clusters=user)
        found = decide(case, [DR], model=MODEL)
        assert not found.choice.deploy
        assert (found.choice.gains[:, 1] <= 0).all()
        assert (found.choice.gains[:, 2] >= 0).all()
        assert found.more["over_time"]["adjusted"]
        assert found.more["over_time"]["within_clusters"]
        [line] = [each for each in found.choice.warnings if "differs between first and later episodes of clusters" in each]
        assert "(p < 0.001)" in line
        assert "same position in their cluster" in line
        unadjusted = decide(case, [DR], model=MODEL, stationary=True).choice
        assert unadjusted.name == "seldom"
        assert unadjusted.low > 0
    assert not change_of(case_of(log)).within  # no cluster, no position in it
    better, user = contacts(0, users=1500, effect=0.2)
    found = decide(case_of(better, clusters=user), [DR], model=MODEL)
    assert found.choice.deploy
    assert found.choice.name == "often"


def test_a_change_along_the_log_is_told_where_users_come_in_turns():
    log = campaign(0, rows=1200)
    change = change_of(case_of(log, clusters=np.arange(1200) % 100))
    assert change.found
    assert not change.within


def test_places_are_cosines_of_their_ranks():
    """Of clusters of one to three episodes: three first ones, two second ones and a third one."""
    clusters = np.array([1, 0, 1, 2, 0, 1])
    rank = np.array([1.5, 1.5, 4.0, 1.5, 4.0, 5.5]) / 6
    expected = np.cos(np.pi * rank[:, None] * np.arange(1, PLACES + 1))
    np.testing.assert_allclose(places(clusters, np.arange(6)), expected, atol=1e-6)
    np.testing.assert_allclose(places(clusters, np.array([5, 0])), expected[[5, 0]], atol=1e-6)
    assert places(np.arange(6), np.arange(6)).shape == (6, 0)
    log = campaign(0, rows=6)
    found, [part] = with_positions(log, clusters, None, 1)
    assert part.start == WAVES + PLACES + 6  # and indicators of different observations
    np.testing.assert_allclose(found.observations[:, WAVES : WAVES + PLACES], expected, atol=1e-6)


def test_a_true_effect_is_found_beside_the_changes():
    """The second action adds 0.2 at all times, and the policy takes it in 90 % of the rows instead of half."""
    gains = []
    for seed in range(1, 4):
        found = decide(case_of(campaign(seed, rows=3000, trend=0.4, effect=0.2)), [DR], model=MODEL)
        assert found.choice.deploy
        assert found.choice.name == "often"
        gain, low, high = found.choice.gains[0]
        assert low < 0.4 * 0.2 < high
        gains.append(gain)
    assert np.mean(gains) == pytest.approx(0.08, abs=0.02)


@pytest.mark.parametrize(
    ("log", "options"),
    [
        (campaign(0, by=0.0), {}),  # the behaviour policy is the same all the time
        (campaign(0), {"stationary": True}),
        (campaign(0, order=lambda rng, actions, rewards: rng.permutation(len(actions))), {}),
    ],
    ids=["same behaviour", "stationary", "shuffled"],
)
def test_what_needs_no_adjustment_is_left(log, options):
    case = case_of(log)
    assert adjusted(case, **options) is case


def test_the_behaviour_policy_may_change_in_continuous_actions():
    """In the mean, or in the spread alone."""
    rng = np.random.default_rng(0)
    time = np.arange(2000) / 2000
    for actions in (time + rng.normal(size=2000), (0.2 + time) * rng.normal(size=2000)):
        log = Dataset.from_arrays(
            observations=rng.normal(size=(2000, 2)), actions=actions[:, None], rewards=np.zeros(2000), terminals=np.ones(2000)
        )
        case = OPEInput(log, [BlackBoxPolicy(lambda seen, rng: np.zeros((len(seen), 1)))], logged=True, discount=0.0)
        assert change_of(case).p_value < 1e-6
        assert adjusted(case).positions


def test_gains_of_a_log_sorted_by_reward_are_too_small_and_the_card_says_what_to_do():
    """The second action adds 0.2, so that the policy gains 0.08; at one position of the sorted log all rewards are alike."""
    sort = lambda rng, actions, rewards: np.argsort(rewards, kind="stable")  # noqa: E731
    log = campaign(0, by=0.0, trend=0.0, effect=0.2, order=sort)
    found = decide(case_of(log), [DR], model=MODEL)
    assert found.choice.gains[0, 2] < 0.04
    assert any("if the order of rows says nothing of time" in line for line in found.choice.warnings)
    gain, low, high = decide(case_of(log), [DR], model=MODEL, stationary=True).choice.gains[0]
    assert low < 0.08 < high


def test_clusters_and_not_rows_count():
    """Of twelve users nothing is said; users with tastes of their own, in any order, are no change."""
    log = campaign(0)
    twelve = case_of(log, clusters=np.arange(len(log)) * 12 // len(log))
    assert change_of(twelve) is None
    assert adjusted(twelve) is twelve
    rng, users = np.random.default_rng(1), np.repeat(np.arange(40), 50)
    alarms = []
    for _ in range(40):
        taste = rng.uniform(0.1, 0.9, 40)[users]
        log = Dataset.from_arrays(
            observations=rng.normal(size=(2000, 1)), actions=(rng.random(2000) < taste).astype(int),
            rewards=rng.normal(size=2000), terminals=np.ones(2000),
        )  # fmt: skip
        alarms.append([change_of(case_of(log, clusters=own)).found for own in (users, None)])
    by_cluster, by_row = np.sum(alarms, 0)
    assert scipy.stats.binomtest(int(by_cluster), 40, 0.1, "greater").pvalue > 0.01
    assert by_row > 35


@pytest.mark.parametrize(("rows", "size"), [(300, 2), (300, 12), (1000, 40)])
def test_the_test_has_its_level(rows, size):
    """Nothing changes; actions depend on observations, and there may be many regressors."""
    p = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        seen = rng.normal(size=(rows, size))
        actions = (rng.random(rows) < 1 / (1 + np.exp(-seen[:, 0]))).astype(int)
        log = Dataset.from_arrays(observations=seen, actions=actions, rewards=np.zeros(rows), terminals=np.ones(rows))
        p.append(change_of(case_of(log)).p_value)
    assert (np.array(p) < 0.1).sum() > 5
    assert scipy.stats.binomtest(int((np.array(p) < 0.1).sum()), 200, 0.1, "greater").pvalue > 0.01


def test_steps_of_episodes_are_no_times():
    """In many rows of episodes of ten steps actions depend on the step alone, which the tested rows must not follow."""
    rng = np.random.default_rng(0)
    step = np.tile(np.arange(10), 40_000)
    actions = (rng.random(400_000) < 0.1 + 0.08 * step).astype(int)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(400_000, 1)), actions=actions, rewards=np.zeros(400_000), terminals=step == 9
    )
    assert change_of(OPEInput(log, [OFTEN], logged=True, discount=0.9)).p_value > 0.1


def test_a_small_log_is_tested_too():
    """Of 180 rows, each of which has an observation of its own."""
    assert change_of(case_of(campaign(0, rows=180, by=0.9))).found
    same = Dataset.from_arrays(
        observations=np.zeros((150, 1)), actions=np.arange(150) % 2, rewards=np.zeros(150), terminals=np.ones(150)
    )
    assert case_of(same).table is not None
    assert case_of(same).with_positions().table is None  # it would have a cell for each episode


def test_the_p_value_is_that_of_a_regression_with_robust_errors():
    """Of one column and one wave it is the score test of the wave's coefficient with clustered errors, up to the ridge."""
    rng = np.random.default_rng(3)
    n, cluster = 400, np.repeat(np.arange(100), 4)
    given, time = rng.normal(size=(n, 2)), rng.normal(size=(n, 1))
    column = given @ [[1.0], [-2.0]] + 0.15 * time + rng.normal(size=(n, 1)) + rng.normal(size=100)[cluster, None]
    null = np.concatenate([np.ones((n, 1)), given], 1)
    # Residuals without the wave, times what of the wave the others do not explain.
    left = column - null @ np.linalg.lstsq(null, column, rcond=None)[0]
    own = time - null @ np.linalg.lstsq(null, time, rcond=None)[0]
    sums = np.array([(left * own)[cluster == c].sum() for c in range(100)])
    error = np.sqrt(np.square(sums).sum() * n / (n - 3))
    expected = 2 * scipy.stats.t.sf(abs(sums.sum()) / error, 99)
    assert p_value(given, time, column, cluster) == pytest.approx(expected, rel=1e-3)
    both = np.concatenate([column, rng.normal(size=(n, 1))], 1)
    assert p_value(given, time, both, cluster) == pytest.approx(min(2 * expected, 1.0), rel=1e-3)  # Bonferroni
    assert p_value(given, time, given @ [[1.0], [2.0]], cluster) == 1.0  # nothing is left of it
    assert p_value(given, time, np.ones((n, 1)), cluster) == 1.0


def test_few_observations_are_regressed_on_one_by_one():
    """Actions depend on the number of a state in no linear way, and the states change along the log."""
    rng = np.random.default_rng(0)
    rows = 4000
    states = (rng.random(rows) * (1 + 5 * np.arange(rows) / rows)).astype(int)  # 0, then also 1 to 5
    actions = (rng.random(rows) < np.array([0.1, 0.9, 0.1, 0.1, 0.9, 0.1])[states]).astype(int)
    log = Dataset.from_arrays(observations=states[:, None], actions=actions, rewards=np.zeros(rows), terminals=np.ones(rows))
    assert change_of(case_of(log)).p_value > 0.1


def test_many_numbers_of_an_observation_are_projected():
    rng = np.random.default_rng(0)
    seen, time = rng.normal(size=(600, 300)), np.arange(600) / 600
    for by in (0.0, 0.8):
        log = Dataset.from_arrays(
            observations=seen, actions=(rng.random(600) < 0.5 + by * (time - 0.5)).astype(int), rewards=np.zeros(600),
            terminals=np.ones(600),
        )  # fmt: skip
        assert change_of(case_of(log)).found == (by > 0)


@pytest.mark.parametrize("known", [True, False])
def test_episodes_of_several_steps_are_not_praised(known):
    """Of few states, with noise as rewards that rise along the log: `drl`, which has no propensities, was deployed."""
    rng = np.random.default_rng(2)
    episodes, steps = 300, 6
    time = np.repeat(np.arange(episodes) / episodes, steps)
    chance = 0.2 + 0.6 * time
    actions = (rng.random(len(time)) < chance).astype(int)
    more = {"behavior_log_probs": np.log(np.where(actions == 1, chance, 1 - chance))} if known else {}
    log = Dataset.from_arrays(
        observations=rng.integers(0, 3, (len(time), 1)), actions=actions, terminals=np.zeros(len(time)),
        timeouts=np.tile(np.arange(steps) == steps - 1, episodes), final_observations=rng.integers(0, 3, (episodes, 1)),
        rewards=(rng.random(len(time)) < 0.2 + 0.5 * time).astype(float), **more,
    )  # fmt: skip
    options = {"names": ["often"], "logged": True, "discount": 0.9, "horizon": steps}
    drl = DoublyRobust(kind="marginal", fqe=LinearFQE())
    before = decide(OPEInput(log, [constant((0.4, 0.6))], **options), [drl], model=MODEL, stationary=True)
    assert before.choice.deploy
    found = decide(OPEInput(log, [constant((0.4, 0.6))], **options), [DR, drl], model=MODEL)
    assert not found.choice.deploy
    assert found.choice.low <= 0 <= found.choice.high
    case = OPEInput(log, [constant((0.4, 0.6))], **options).with_positions()
    assert case.table is None
    assert automatic(case, MODEL)[0].kind == "dr"
    with pytest.raises(UserError, match="smis cannot adjust for a behaviour policy that changed along the log"):
        decide(case, ["smis"], model=MODEL)


@pytest.mark.slow
def test_critics_alone_do_not_praise_actions_of_good_times():
    """Continuous actions, and a deterministic policy, of which no logged reward corrects an estimate."""
    rng = np.random.default_rng(0)
    episodes, steps = 300, 4
    time = np.repeat(np.arange(episodes) / episodes, steps)
    actions = time - 0.5 + 0.4 * rng.normal(size=len(time))
    log = Dataset.from_arrays(
        observations=rng.normal(size=(len(time), 2)), actions=actions[:, None], rewards=time + 0.1 * rng.normal(size=len(time)),
        terminals=np.tile(np.arange(steps) == steps - 1, episodes),
    )  # fmt: skip
    policy = BlackBoxPolicy(lambda seen, rng: np.full((len(seen), 1), 0.5))
    critics = FQE(hidden=(32,), members=3, steps=1500, lr=1e-3, tau=0.02)
    for stationary in (True, False):
        case = OPEInput(log, [policy], names=["high"], logged=True, discount=0.9)
        found = decide(case, [critics], model=MODEL, accept_model_based=True, stationary=stationary)
        assert found.choice.deploy == stationary


def test_functions_of_users_see_the_log_and_what_is_asked_for_is_not_called_a_finding():
    log = campaign(0, by=0.0, rows=300)
    seen = []

    def mine(data, policies, discount):
        seen.append(data.observations.shape)
        return np.zeros(len(policies))

    found = decide(OPEInput(log, [OFTEN], logged=True, discount=0.0, positions=True), [DR, mine], model=MODEL)
    assert seen == [(300, 2)]
    assert not any("changed along the log" in line for line in found.choice.warnings)
    held = OPEInput(log, [OFTEN], logged=True, discount=0.0, positions=True, held=np.arange(100))
    decide(held, [DR, mine], model=MODEL)
    assert seen[1] == (100, 2)


def test_next_actions_that_the_log_does_not_show_are_known_by_the_state_with_positions_too():
    rng = np.random.default_rng(0)
    states = rng.integers(0, 4, 400)
    log = Dataset.from_arrays(
        observations=states[:, None], actions=(rng.random(400) < 0.2 + 0.2 * states).astype(int), rewards=np.zeros(400),
        terminals=np.zeros(400), timeouts=np.arange(400) % 8 == 7, final_observations=rng.integers(0, 4, (50, 1)),
    )  # fmt: skip
    plain = OPEInput(log, [OFTEN], logged=True, discount=0.9)
    placed = plain.with_positions()
    assert placed.shown.all()
    np.testing.assert_array_equal(placed.final_actions(1), plain.final_actions(1))


def test_policies_do_not_see_positions_and_models_do():
    log = campaign(0, rows=300, by=0.5)
    first = BlackBoxPolicy(
        lambda seen, rng: (seen[:, 0] > 0).astype(int),
        action_probs=lambda seen: np.where(seen[:, :1] > 0, [[0.1, 0.9]], [[0.7, 0.3]]),
    )
    plain = OPEInput(log, [first], logged=True, discount=0.0)
    case = plain.with_positions()
    assert case.positions
    assert case.log.spec.observation_size == log.spec.observation_size + WAVES
    np.testing.assert_array_equal(case.log.observations[:, WAVES:], log.observations)
    np.testing.assert_array_equal(case.log.observations[:, :WAVES], waves(log, np.arange(300)))
    np.testing.assert_array_equal(case.log_probs, plain.log_probs)
    np.testing.assert_array_equal(case.current_actions(1), plain.current_actions(1))
    assert case.policies_digest == plain.policies_digest
    np.testing.assert_array_equal(case.log.episode_ids, plain.log.episode_ids)
    part = case_of(log, held=np.arange(200, 300)).with_positions()
    np.testing.assert_array_equal(part.data.observations, case.log.observations[200:])  # positions are those of the whole log
    np.testing.assert_array_equal(part.teaching().data.observations, case.log.observations[:200])
    assert part.whole().positions
    np.testing.assert_array_equal(case.plain.observations, log.observations)
    rows = np.array([3, 250])
    np.testing.assert_array_equal(case.log.observations[rows, WAVES:], log.observations[rows])
    every = np.asarray(case.log.observations)
    columns = [(rows, slice(-2, None)), (rows, rows % 2), (slice(None), 1)]
    for index in (5, -1, rows, np.arange(300) % 2 == 0, slice(3, 9), *columns):
        np.testing.assert_array_equal(case.log.observations[index], every[index])
    assert part.of_rewards(np.zeros(300), ()).positions


def test_waves_are_cosines_of_the_middle_of_each_episode():
    lengths = np.array([2, 4, 2])
    log = Dataset.from_arrays(
        observations=np.zeros((8, 1)), actions=np.array([0, 1] * 4), rewards=np.zeros(8),
        terminals=np.isin(np.arange(8), np.cumsum(lengths) - 1),
    )  # fmt: skip
    half = np.array([1 / 8, 1 / 2, 7 / 8])
    np.testing.assert_allclose(waves(log, np.arange(3)), np.cos(np.pi * half[:, None] * np.arange(1, WAVES + 1)), atol=1e-6)
    np.testing.assert_allclose(waves(log, np.array([2])), waves(log, np.arange(3))[2:])


def test_positions_stand_before_histories_legal_actions_and_indicators_of_few_observations():
    rng = np.random.default_rng(0)
    states = rng.integers(0, 3, 40)
    log = Dataset.from_arrays(
        observations=states[:, None], actions=rng.integers(0, 2, 40), rewards=np.zeros(40),
        terminals=np.arange(40) % 4 == 3, final_observations=states[3::4, None],
    )  # fmt: skip
    found, [part] = with_positions(log, np.arange(10), None, 1)
    np.testing.assert_array_equal(found.observations[:, WAVES : WAVES + 3], np.eye(3)[states])
    np.testing.assert_array_equal(found.observations[:, part], log.observations)
    np.testing.assert_array_equal(found.final_observations[:, part], log.final_observations)
    np.testing.assert_array_equal(found.final_observations[:, :WAVES], found.observations[3::4, :WAVES])
    pair = stacked(campaign(0, rows=50), 2)
    found, parts = with_positions(pair, np.arange(50), [slice(4, 6), slice(0, 6)], 2)
    np.testing.assert_array_equal(found.observations[:, parts[0]], pair.observations[:, 4:6])
    np.testing.assert_array_equal(found.observations[:, parts[1]], np.asarray(pair.observations))
    mask = np.array([[1.0, 1.0], [1.0, 0.0]] * 30, np.float32)
    seen = np.concatenate([rng.normal(size=(60, 1)), mask], 1)
    masked = Dataset.from_arrays(
        observations=seen, actions=np.zeros(60, int), rewards=np.zeros(60), terminals=np.ones(60), next_observations=seen,
        action_space=Discrete(2, masked=True),
    )  # fmt: skip
    found, _ = with_positions(masked, np.arange(60), None, 1)
    np.testing.assert_array_equal(found.observations[:, -2:], mask)
    assert found.spec.mask_size == 2


def test_a_log_of_the_catalogue_is_that_of_a_simulator_and_stationary(tmp_path):
    """Its behaviour policy may change, as in a replay buffer. What was tested is among the grounds."""
    log = campaign(0, rows=400)
    options = {"discount": 0.0, "model": MODEL}

    def judged(log=log, **more):
        found = judge([OFTEN], log, [DR], **options, **more).results
        told = dict(grounds(found))["over time"].partition(";")[0]  # what follows is of the gain
        return found["choice"]["over_time"]["adjusted"], told, found["looks"]["number"]

    out = tmp_path / "estimates"
    told = "the behaviour policy changed along the log (p < 0.001), and actions of about the same position are compared"
    assert judged(out=out) == (True, told, 1)
    assert judged(out=out) == (True, told, 1)
    assert judged(out=out, stationary=True) == (False, "the system is taken for stationary", 2)  # which is another look
    collected = replace(log.provenance, source="collected")
    for known in (replace(log, name="hopper-medium-v2@dr1"), replace(log, provenance=collected)):
        assert judged(known, counted=False)[:2] == (False, "the system is taken for stationary")
    told = judged(campaign(0, rows=400, by=0.0), counted=False)[1]
    assert told.startswith("no change of the behaviour policy along the log is found (p = ")
    few = "there are too few episodes or clusters to test whether the behaviour policy changed: 20 are needed"
    assert judged(campaign(0, rows=400, user=np.arange(400) // 50), counted=False, cluster="user")[1] == few
