"""Gains that change along the log: what is no longer good is not deployed, and what does not change is left."""

import numpy as np
import pytest
import scipy.stats

from deadreckon.data.dataset import Dataset
from deadreckon.ope import OPEInput
from deadreckon.ope.case import CrossFitted
from deadreckon.ope.decide import decide
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.groups import gains_of_parts
from deadreckon.ope.latest import LEVEL, Latest, latest
from deadreckon.ope.linear import LinearFQE
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.decision_record import read_results
from deadreckon.runs.offline import grounds, judge

from .test_over_time import MODEL, OFTEN, SELDOM, case_of


def log_of(seed, effect, rows=1500, known=True, order=None, **more):
    """One-step log of a fair coin's actions; the second adds `effect` of the time in [0, 1) to rewards that are noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) / rows
    actions = (rng.random(rows) < 0.5).astype(int)
    rewards = effect(time) * actions + rng.normal(size=rows)
    columns = {"observations": rng.normal(size=(rows, 2)), "actions": actions, "rewards": rewards} | more
    columns |= {"behavior_log_probs": np.full(rows, np.log(0.5))} if known else {}
    which = slice(None) if order is None else order(rng, rows)
    return Dataset.from_arrays(**{name: own[which] for name, own in columns.items()}, terminals=np.ones(rows))


def reverses(time):
    return np.where(time < 0.5, 0.8, -0.3)


def constant(time):
    return np.full_like(time, 0.25)


@pytest.mark.parametrize("known", [True, False], ids=["logged", "learned"])
def test_what_was_good_only_before_is_not_deployed(known):
    """The second action is taken in 90 % instead of half of the rows, which loses 0.12 by now."""
    for seed in range(3):
        found = decide(case_of(log_of(seed, reverses, known=known)), model=MODEL)
        choice, told = found.choice, found.more["over_time"]["latest"]
        assert choice.name == "often"
        assert choice.low > 0
        assert not choice.deploy
        assert "the lower end is above zero, but its gain changed along the log (p < 0.001): it is " in choice.reason
        assert "use --stationary if the order of rows says nothing of time" in choice.reason
        assert told["low"] < 0.4 * -0.3 < told["high"] < 0.05
        assert told["before"] == pytest.approx(0.4 * (0.8 * 3 - 0.3) / 4, abs=0.1)
        unasked = decide(case_of(log_of(seed, reverses, known=known)), model=MODEL, stationary=True)
        assert unasked.choice.deploy
        assert "latest" not in unasked.more["over_time"]


@pytest.mark.parametrize(
    ("effect", "order"),
    [(constant, None), (reverses, lambda rng, rows: rng.permutation(rows))],
    ids=["constant", "shuffled"],
)
def test_what_does_not_change_is_left(effect, order):
    for seed in range(3):
        found = decide(case_of(log_of(seed, effect, order=order)), model=MODEL)
        assert found.choice.deploy
        assert found.more["over_time"]["latest"]["p_value"] > LEVEL
        assert not any("in the latest third" in line for line in found.choice.evidence)


def test_a_gain_that_has_grown_is_deployed_and_told():
    found = decide(case_of(log_of(0, lambda time: 1.2 * time)), model=MODEL)
    assert found.choice.deploy
    [line] = [each for each in found.choice.evidence if "in the latest third" in each]
    assert found.more["over_time"]["latest"]["low"] > found.more["over_time"]["latest"]["before"] > 0
    assert line.startswith("its gain changed along the log (p")


def test_the_test_and_the_interval_are_those_of_two_samples():
    """A t-test with unequal variances of the scores of both parts, and Student's interval at the level of two policies."""
    case = case_of(log_of(0, lambda time: 0.3 * time, rows=900))
    found = latest(case, 0, MODEL, 0.05)
    code = (np.arange(900) >= 600).astype(int)
    parts = gains_of_parts(case, 0, code, 2, MODEL)
    own = parts.influence[case.episodes.group]
    one, other = (parts.mean[g] + own[code == g, g] * (code == g).sum() / 900 for g in (0, 1))
    assert found.p_value == pytest.approx(scipy.stats.ttest_ind(one, other, equal_var=False).pvalue, rel=0.02)
    assert (found.before, found.gain) == (pytest.approx(one.mean()), pytest.approx(other.mean()))
    half = scipy.stats.sem(other) * scipy.stats.t.ppf(1 - 0.05 / 2 / 2, 299)
    assert (found.high - found.gain, found.gain - found.low) == (pytest.approx(half, rel=0.01), pytest.approx(half, rel=0.01))
    wider = latest(case, 0, MODEL, 0.05, wider=0.1)
    assert (wider.low, wider.high) == (pytest.approx(found.low - 0.1), pytest.approx(found.high + 0.1))
    assert "changed along the log (p = 0.005)" in Latest("", LEVEL / 2, 0.0, 0.0, 0.0, 0.0).words
    assert Latest("", 2 * LEVEL, 0.0, 0.0, 0.0, 0.0).words is None


def test_gains_that_do_not_change_are_rarely_said_to():
    found = [latest(case_of(log_of(seed, constant, rows=300)), 0, MODEL, 0.05) for seed in range(16)]
    p = [each.p_value for each in found if not each.why]  # in some, a part seems to have wrong propensities
    assert len(p) > 12
    assert sum(each < LEVEL for each in p) <= 1
    assert scipy.stats.kstest(p, "uniform").pvalue > 0.01


def days(seed, effect, episodes=240, steps=20):
    """Days with one of three kinds of load, of which an action of a fair coin adds `effect` of the time to each reward."""
    rng = np.random.default_rng(seed)
    seen, actions = rng.integers(0, 3, (episodes, steps)), rng.integers(0, 2, (episodes, steps))
    time = np.arange(episodes)[:, None] / episodes
    rewards = 1 + effect(time) * actions + 0.3 * rng.normal(size=seen.shape)
    ends = np.tile(np.arange(steps) == steps - 1, episodes)
    log = Dataset.from_arrays(
        observations=np.eye(3)[seen.ravel()], actions=actions.ravel(), rewards=rewards.ravel(), timeouts=ends,
        terminals=np.zeros(len(ends)),
    )  # fmt: skip
    return log


def test_of_long_episodes_parts_are_compared_by_ratios_of_occupancies():
    """Products of weights of twenty steps rest on few days: nothing was compared, and what had reversed was deployed."""
    case = OPEInput(days(0, reverses), [OFTEN, SELDOM], names=["often", "seldom"], logged=True, discount=0.99)
    found = decide(case, model=MODEL)
    assert found.estimates[0].method == "DRL"
    told = found.more["over_time"]["latest"]
    assert told["why"] == ""
    assert told["p_value"] < LEVEL
    assert told["high"] < 0 < told["before"]
    assert not found.choice.deploy
    for seed in range(3):
        case = OPEInput(days(seed, constant), [OFTEN, SELDOM], names=["often", "seldom"], logged=True, discount=0.99)
        found = decide(case, model=MODEL)
        assert found.choice.deploy
        assert found.more["over_time"]["latest"]["p_value"] > LEVEL
        assert latest(case, 0, MODEL, 0.05).why  # by products of weights


def parts_of(log, **options):
    """The comparison by ratios of occupancies, and its case."""
    case = OPEInput(log, [OFTEN, SELDOM], logged=True, discount=0.99, **options)
    found = latest(case, 0, MODEL, 0.05, wider=0.5, decides=DoublyRobust(kind="marginal", fqe=LinearFQE()).nuisances(case)[0])
    return found, case


def test_parts_by_ratios_of_occupancies_are_a_test_of_two_samples():
    """Of what each day adds to the mean over days, and over rows, before and in the latest third."""
    log = days(0, reverses)
    found, case = parts_of(log)
    nuisances, late = DoublyRobust(kind="marginal", fqe=LinearFQE()).nuisances(case)[0], np.arange(240) >= 160
    score = nuisances.begins[0] - nuisances.begins[2]
    for i, sign, known in ((0, 1, case.followed), (2, -1, case.followed & case.shown)):
        rows = np.where(known, nuisances.weighted[i], 0.0).reshape(240, 20).sum(1)
        score += sign * rows / known.reshape(240, 20).sum(1).mean()
    assert (found.before, found.gain) == (pytest.approx(score[~late].mean()), pytest.approx(score[late].mean()))
    errors = [own.std() / len(own) ** 0.5 * (80 / 79) ** 0.5 for own in (score[~late], score[late])]
    t = (found.gain - found.before) / np.hypot(*errors)
    assert found.p_value == pytest.approx(2 * scipy.stats.t.sf(abs(t), 79), rel=0.05)
    half = errors[1] * scipy.stats.t.ppf(1 - 0.05 / 2 / 2, 79) + 0.5
    assert (found.high - found.gain, found.gain - found.low) == (pytest.approx(half, rel=0.02), pytest.approx(half, rel=0.02))
    mixed, _ = parts_of(log, clusters=np.arange(240) % 60)  # users of both parts
    assert (mixed.before, mixed.gain) == (pytest.approx(found.before, abs=0.5), pytest.approx(found.gain, abs=0.5))
    assert mixed.p_value < LEVEL
    few, _ = parts_of(log, clusters=np.arange(240) // 15)
    assert few.why == "there are too few episodes"


def test_users_of_both_parts_are_paired():
    """Every day comes three times, the last time with a little more for an action, which is a change for each of its users."""
    log = days(0, constant, episodes=120)
    more = np.repeat(np.arange(3) == 2, len(log))
    thrice = {name: np.tile(np.asarray(getattr(log, name)), (3, 1) if name == "observations" else 3)
              for name in ("observations", "actions", "rewards", "terminals", "timeouts")}  # fmt: skip
    thrice["rewards"] = thrice["rewards"] + 0.02 * more * thrice["actions"]
    again = Dataset.from_arrays(**thrice)
    paired, _ = parts_of(again, clusters=np.tile(np.arange(120), 3))
    apart, _ = parts_of(again, clusters=np.arange(360))
    assert paired.p_value < LEVEL < apart.p_value
    assert (paired.gain, paired.before) == (pytest.approx(apart.gain, abs=0.3), pytest.approx(apart.before, abs=0.3))


def test_many_days_and_users_of_different_sizes_are_compared_too():
    """More than a thousand units are grouped at random, and a user of many days is one of few users."""
    many, _ = parts_of(days(0, reverses, episodes=1200, steps=8))
    assert many.p_value < LEVEL
    assert many.gain < 0 < many.before
    own, _ = parts_of(days(0, reverses))
    sizes, _ = parts_of(days(0, reverses), clusters=np.where(np.arange(240) < 160, np.arange(240) // 4, np.arange(240)))
    assert sizes.gain == pytest.approx(own.gain, abs=0.5)
    assert sizes.p_value < LEVEL


def test_users_and_not_rows_count():
    """Users who like the second action come in the first part of the log, and others in the last: forty of them say little."""
    rng = np.random.default_rng(0)
    user = np.arange(1500) * 60 // 1500
    likes = rng.normal(0.0, 1.0, 60)[user]
    log = log_of(0, lambda time: likes)
    rows, users = (latest(case_of(log, **more), 0, MODEL, 0.05) for more in ({}, {"clusters": user}))
    assert (rows.before, rows.gain) == (pytest.approx(users.before, abs=0.02), pytest.approx(users.gain, abs=0.02))
    assert users.high - users.low > 2 * (rows.high - rows.low)
    assert users.p_value > 10 * rows.p_value


def test_the_latest_are_those_of_the_log_and_not_of_the_list_of_held_out_episodes():
    log = log_of(0, reverses)
    held = np.random.default_rng(0).permutation(1500)[:900]
    found = latest(case_of(log, held=held), 0, MODEL, 0.05)
    assert found.gain < 0 < found.before


def test_too_few_episodes_or_degenerate_weights_say_nothing():
    few = latest(case_of(log_of(0, reverses, rows=57)), 0, MODEL, 0.05)  # 19 in the latest third
    assert few.why.startswith("there are only 19 episodes or clusters")
    assert few.words is None
    assert latest(case_of(log_of(0, reverses, rows=120)), 0, MODEL, 0.05).why == ""
    rng = np.random.default_rng(0)
    continuous = Dataset.from_arrays(
        observations=rng.normal(size=(600, 2)), actions=rng.normal(size=(600, 1)), rewards=np.zeros(600), terminals=np.ones(600)
    )
    always = OPEInput(continuous, [BlackBoxPolicy(lambda seen, rng: np.zeros((len(seen), 1)))], logged=True, discount=0.0)
    assert latest(always, 0, MODEL, 0.05).why == "it has no importance weights"
    assert latest(always, 0, MODEL, 0.05).as_json() == {
        "why": "it has no importance weights", "p_value": None, "before": None, "gain": None, "low": None, "high": None,
    }  # fmt: skip


def test_an_action_that_was_given_up_is_not_deployed():
    """It is harmful since then, which the few rows that still have it do not show."""
    rng = np.random.default_rng(0)
    rows = 3000
    time = np.arange(rows) / rows
    chance = np.where(time < 0.9, 0.5, 0.02)
    actions = (rng.random(rows) < chance).astype(int)
    rewards = np.where(time < 0.7, 1.5, -0.5) * actions + rng.normal(size=rows)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(rows, 2)), actions=actions, rewards=rewards, terminals=np.ones(rows),
        behavior_log_probs=np.log(np.where(actions == 1, chance, 1 - chance)),
    )  # fmt: skip
    found = decide(case_of(log), model=MODEL)
    assert found.choice.name == "often"
    assert found.choice.low > 0
    assert not found.choice.deploy
    assert "its gain in the latest third of the episodes is not known: " in found.choice.reason
    assert "% of its actions have no support in the log; use --stationary" in found.choice.reason


def test_cross_fitted_policies_have_larger_errors():
    log = log_of(0, lambda time: 0.3 * time, rows=900)
    case = OPEInput(log, [CrossFitted((OFTEN, OFTEN), np.arange(900) % 2)], logged=True, discount=0.0)
    plain = OPEInput(log, [OFTEN], logged=True, discount=0.0)
    crossed, found = (latest(each, 0, MODEL, 0.05) for each in (case, plain))
    assert crossed.high - crossed.low == pytest.approx(np.sqrt(2) * (found.high - found.low), rel=0.02)
    z, other = (abs(scipy.stats.norm.ppf(each.p_value / 2)) for each in (crossed, found))
    assert z == pytest.approx(other / np.sqrt(2), rel=0.02)


def test_what_users_have_in_common_cancels_if_they_are_in_both_parts():
    """Sixty users come all the time and like the second action by very different amounts, which do not change."""
    user = np.random.default_rng(0).permutation(np.arange(1500) % 60)
    likes = np.random.default_rng(1).normal(0.0, 3.0, 60)[user]
    case = case_of(log_of(0, lambda time: likes), clusters=user)
    found = latest(case, 0, MODEL, 0.05)
    influence = gains_of_parts(case, 0, (np.arange(1500) >= 1000).astype(int), 2, MODEL).influence
    paired, each = np.std(influence[:, 1] - influence[:, 0], ddof=1), influence.std(0, ddof=1)
    assert paired < 0.8 * np.hypot(*each)
    t = (found.gain - found.before) / (paired / np.sqrt(60) * np.sqrt(60 / 59))
    assert found.p_value == pytest.approx(2 * scipy.stats.t.sf(abs(t), 59), rel=1e-6)


def test_gains_of_whole_episodes_may_change_too():
    """Three steps each, of which each adds what the second action does at its time."""
    rng = np.random.default_rng(0)
    rows, steps = 3000, 3
    time = np.arange(rows) // steps * steps / rows
    actions = (rng.random(rows) < 0.5).astype(int)
    rewards = reverses(time) * actions + 0.5 * rng.normal(size=rows)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(rows, 2)), actions=actions, rewards=rewards,
        terminals=np.arange(rows) % steps == steps - 1, behavior_log_probs=np.full(rows, np.log(0.5)),
    )  # fmt: skip
    case = OPEInput(log, [OFTEN, SELDOM], names=["often", "seldom"], logged=True, discount=1.0)
    found = decide(case, model=MODEL)
    assert found.choice.low > 0
    assert not found.choice.deploy
    assert found.more["over_time"]["latest"]["high"] < 0


def test_the_record_keeps_the_latest_gain(tmp_path):
    results = judge([OFTEN], log_of(0, reverses, rows=3000), discount=0.0, model=MODEL, out=tmp_path / "estimates").results
    read = read_results(tmp_path / "estimates" / "estimates.json")
    assert read["choice"]["over_time"] == results["choice"]["over_time"]
    assert read["choice"]["over_time"]["latest"]["high"] < 0
    assert not read["choice"]["deploy"]
    assert dict(grounds(read))["over time"].endswith(
        "the gain in the latest third of the episodes differs from that before (p < 0.001)"
    )
    same = judge([OFTEN], log_of(0, constant), discount=0.0, model=MODEL, counted=False).results
    assert "; no change of the gain in the latest third of the episodes is found (p = " in dict(grounds(same))["over time"]
    few = judge([OFTEN], log_of(0, constant, rows=57), discount=0.0, model=MODEL, counted=False).results
    assert "is not compared with that before: there are only 19 episodes" in dict(grounds(few))["over time"]
