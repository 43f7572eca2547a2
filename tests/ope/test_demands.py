"""What a decision may be asked for beyond a gain: a guarantee, confounding, groups and tails."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.ope import OPEInput
from deadreckon.ope.behavior_model import PROPENSITIES, BehaviorModel
from deadreckon.ope.case import CrossFitted
from deadreckon.ope.confounding import Confounding
from deadreckon.ope.costs import totals
from deadreckon.ope.decide import UNSEEN, decide
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.groups import Groups, by_group
from deadreckon.ope.guarantee import guaranteed, refuse
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.registry import estimator, with_fields
from deadreckon.ope.select import MOVED, gains
from deadreckon.ope.support import Support
from deadreckon.ope.tail import lower_tail, tails
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.offline import groups
from deadreckon.stats import inference
from deadreckon.stats.betting import lower
from deadreckon.theory import garnet
from tests.ope.test_case import linear, lqr
from tests.ope.test_corrected import one_step
from tests.ope.worlds import as_policy, tables

MODEL = BehaviorModel(hidden=(8,), steps=50)
LINEAR = with_fields(estimator("dr-linear"), {"ridge": 1.0})


@pytest.fixture(autouse=True)
def supported(monkeypatch):
    """Checks of support fit models, which are not looked at here."""

    def told(case, model):
        nothing = np.zeros(len(case.policies))
        return Support(nothing, nothing + 1.0, nothing + 1.0, case.degenerate)

    monkeypatch.setattr("deadreckon.ope.decide.support", told)


def trials(n, rng, lift=0.3, **extras):
    """Two arms of a trial, drawn by a coin; the second succeeds more often by `lift`, in states 0 and 1 alike."""
    state, arm = rng.integers(0, 2, n), rng.integers(0, 2, n)
    success = rng.random(n) < 0.3 + lift * arm + 0.1 * state
    return one_step(np.eye(2)[state], arm, success.astype(float), np.full(n, 0.5), **extras)


SECOND, FIRST = as_policy(np.array([[0.0, 1.0], [0.0, 1.0]])), as_policy(np.array([[1.0, 0.0], [1.0, 0.0]]))
MOSTLY = as_policy(np.array([[0.2, 0.8], [0.2, 0.8]]))


def case_of(log, policies=(SECOND, FIRST), **options):
    names = ["second", "first", "third"][: len(policies)]
    return OPEInput(log, policies, discount=0.0, horizon=1, names=names, logged=True, **options)


@pytest.mark.slow
def test_a_guarantee_holds_as_often_as_promised():
    """A policy whose gain is a little: its lower bound lies above in no more than 1 of 10 of logs, short ones too."""
    rng, missed, useful = np.random.default_rng(0), [], []
    for n, lift in ((15, 0.4), (400, 0.4)):
        for _ in range(150):
            bound = guaranteed(case_of(trials(n, rng, lift), [MOSTLY]), 0, (0.0, 1.0), 0.1)
            missed.append(bound > 0.3 * lift)  # the coin takes the second arm in half of the cases, the policy in 0.8
            useful.append(n == 400 and bound > 0)
    assert np.mean(missed) <= 0.1
    assert np.sum(useful) > 100  # and says something
    # Whatever a return is shifted by, and for several steps.
    true = garnet(states=3, actions=2, ending=0.3, noise=0.0)
    true = replace(true, rewards=true.rewards - 1.0)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.4, seed=1)[0]
    missed = []
    for _ in range(100):
        case = OPEInput(true.log(behavior, 100, 4, rng), [as_policy(target)], discount=0.9, horizon=4, logged=True)
        gain = exact(true, target) - exact(true, behavior)
        missed.append(guaranteed(case, 0, (-12.0, 8.0), 0.1) > gain)
    assert np.mean(missed) <= 0.1


def test_a_guarantee_shares_its_chance_of_failing_among_all_policies():
    log = trials(400, np.random.default_rng(0))
    alone = guaranteed(case_of(log, [MOSTLY]), 0, (0.0, 1.0), 0.05)
    assert guaranteed(case_of(log, [MOSTLY, FIRST]), 0, (0.0, 1.0), 0.1) == pytest.approx(alone, abs=1e-9)
    assert alone < guaranteed(case_of(log, [MOSTLY]), 0, (0.0, 1.0), 0.1) - 1e-4


def test_a_guarantee_by_hand():
    """Five patients; the policy takes the second arm 1.6 times as often as the coin, and the first 0.4 times."""
    log = one_step(np.ones((5, 1)), np.array([0, 1, 1, 0, 1]), np.array([0.0, 1.0, 1.0, 1.0, -1.0]), np.full(5, 0.5))
    policy = as_policy(np.array([[0.2, 0.8]]))
    # (w - 1) (G - low) + (high - low), with returns of -1 to 2.
    x = [-0.6 * 1 + 3, 0.6 * 2 + 3, 0.6 * 2 + 3, -0.6 * 2 + 3, 0.6 * 0 + 3]
    assert guaranteed(case_of(log, [policy]), 0, (-1.0, 2.0), 0.4) == pytest.approx(lower(np.array(x), 0.4) - 3)


def exact(true, policy):
    value, reach = 0.0, true.initial
    for t in range(4):
        value += 0.9**t * float((reach[:, None] * policy * true.rewards).sum())
        reach = np.einsum("s,sa,sat->t", reach, policy, true.transitions)
    return value


def test_what_a_guarantee_lacks():
    rng = np.random.default_rng(0)
    log = trials(60, rng)
    for case, wanted, words in [
        (case_of(log), None, "a guarantee needs the least and the greatest possible return of an episode"),
        (case_of(log), (1.0, 0.0), "instead of 1 .. 0"),
        (case_of(replace(log, extras={})), (0.0, 1.0), "logged propensities"),
        (case_of(log, clusters=np.arange(60) // 2), (0.0, 1.0), "independent episodes"),
        (case_of(log, [CrossFitted((SECOND, FIRST), np.arange(60) % 2)]), (0.0, 1.0), "those of a cross-fit"),
        (OPEInput(lqr(-0.5, 0.5, 30, 10), [linear(-0.5, 0.5)], discount=0.9), (0.0, 1.0), "30 are cut off; give a horizon"),
    ]:
        with pytest.raises(UserError, match=words) as error:
            refuse(case, wanted)
        assert "\n" not in str(error.value)
    with pytest.raises(UserError, match="an episode returns 1, outside of the range 0 .. 0.5"):
        refuse(case_of(log), (0.0, 0.5))
    lacks_all = case_of(replace(log, extras={}), clusters=np.arange(60) // 2)
    with pytest.raises(UserError, match=r"\(--return-range LOW HIGH\); and logged propensities .*; and independent"):
        decide(lacks_all, [LINEAR], guarantee=True, model=MODEL)


@pytest.mark.slow
def test_decisions_by_a_guarantee_and_under_confounding():
    rng = np.random.default_rng(1)
    clear = decide(case_of(trials(1000, rng, 0.5)), [LINEAR], model=MODEL, guarantee=True, return_range=(0.0, 1.0))
    assert clear.choice.deploy
    assert 0 < clear.more["guarantee"] < clear.choice.gain
    assert any("for any number of episodes, not only for many, its gain is at" in line for line in clear.choice.evidence)
    # What is significant need not be guaranteed.
    faint = case_of(trials(300, np.random.default_rng(2), 0.22))
    plain = decide(faint, [LINEAR], model=MODEL)
    assert plain.choice.deploy
    assert "guarantee" not in plain.more
    kept = decide(faint, [LINEAR], model=MODEL, guarantee=True, return_range=(0.0, 3.0))
    assert not kept.choice.deploy
    assert "but for any number of episodes, not only for many, its gain is at least -" in kept.choice.reason
    # The tipping point is on every card of one-step logs, and with a factor it is what decides.
    tipping = plain.more["confounding"]["tipping"]
    assert 1.0 < tipping < 3.0
    words = f"{UNSEEN}; its gain is no longer significant if the odds of logged actions are wrong by a factor of {tipping:.3g}"
    assert words in plain.choice.evidence
    for gamma, deploy in ((0.98 * tipping, True), (1.05 * tipping, False)):
        found = decide(faint, [LINEAR], model=MODEL, confounding=gamma)
        assert found.choice.deploy == deploy
        assert len(found.more["confounding"]["bounds"]) == 2
        assert (found.more["confounding"]["bounds"][0][0] > 0) == deploy
    with pytest.raises(UserError, match="Gamma, a ratio of odds, must be 1 or more, got 0.5"):
        decide(faint, [LINEAR], model=MODEL, confounding=0.5)


@pytest.mark.slow
def test_bounds_for_confounding_hold_where_there_is_some():
    """Someone saw what is not recorded, and gave the second arm more often where it fares better: odds of 2 between the two."""
    rng, inside, naive, tight = np.random.default_rng(0), [], [], []
    for _ in range(40):
        n = 600
        hidden = rng.random(n) < 0.5
        chance = np.where(hidden, 2 / 3, 1 / 2)  # odds of 2 and of 1; the nominal 7 / 12 has 1.4: off by 10 / 7 and by 1 / 1.4
        arm = (rng.random(n) < chance).astype(int)
        reward = 1.0 * (rng.random(n) < 0.2 + 0.4 * arm * hidden)  # the second arm is worth 0.4, a fifth on average
        nominal = np.where(arm == 1, 7 / 12, 5 / 12)
        case = case_of(one_step(np.eye(2)[np.zeros(n, int)], arm, reward, nominal), [SECOND])
        gain = 0.2 - 0.4 * 0.5 * 2 / 3  # of always the second arm over what was done
        found = Confounding(case, PROPENSITIES)
        low, high = found.gain(0, 10 / 7)
        inside.append(low <= gain <= high)
        naive.append(np.diff(found.gain(0, 1.0))[0])
        tight.append(high - low)
    assert np.mean(inside) >= 0.95
    assert np.mean(tight) > 1.5 * np.mean(naive)


def test_bounds_of_a_policy_do_not_depend_on_one_whose_weights_are_lost():
    """Also the tipping point is told beside a deterministic candidate with continuous actions."""
    both = case_of(trials(1000, np.random.default_rng(0)), [SECOND, as_policy(np.eye(2)[[0, 0]])])
    both.__dict__["degenerate"] = np.array([False, True])
    alone = case_of(trials(1000, np.random.default_rng(0)), [SECOND])
    found = Confounding(both, MODEL)
    assert found.lost[0] == []
    assert found.lost[1] == ["its importance weights are degenerate, because it is deterministic with continuous actions"]
    assert found.gain(1, 1.0) == (-np.inf, np.inf)
    np.testing.assert_allclose(found.gain(0, 1.2), Confounding(alone, MODEL).gain(0, 1.2), rtol=1e-6)


def test_no_confounding_is_the_gain_itself():
    """A factor of one gives the doubly robust gain, self-normalised, with the interval of gains; a larger one contains it."""
    true = garnet(states=3, actions=2, ending=0.3, noise=0.1)
    behavior, target = tables(true, 1, 0.2)[0], tables(true, 1, 0.5, seed=1)[0]
    log = true.log(behavior, 500, 4, np.random.default_rng(0))
    for case in (
        OPEInput(log, [as_policy(target)], discount=0.9, horizon=4, logged=True),
        OPEInput(log, [as_policy(target)], discount=0.0, horizon=1, logged=True),
    ):
        found = Confounding(case, PROPENSITIES)
        one, more = found.gain(0, 1.0), found.gain(0, 1.2)
        assert more[0] < one[0] < one[1] < more[1]
        whole = estimator("wis" if case.estimand.horizon == 4 else "dr-linear").on(case)
        assert one == pytest.approx(gains(whole)[0, 1:], abs=1e-3 * (one[1] - one[0]))
        wider = Confounding(case, PROPENSITIES, wider=0.3).gain(0, 1.0)
        assert wider == pytest.approx((one[0] - 0.3, one[1] + 0.3))


def test_the_level_of_a_decision_is_that_of_its_gains():
    case = case_of(trials(200, np.random.default_rng(0)))
    choice = decide(case, [LINEAR], alpha=0.0125, model=MODEL).choice
    np.testing.assert_array_equal(choice.gains, gains(LINEAR.on(case), 0.0125)[:2])
    assert choice.level == 1 - 0.0125


def test_gains_by_group():
    rng = np.random.default_rng(0)
    site = np.repeat(["a", "b", "c"], [900, 900, 10])
    log = trials(1810, rng, 0.0)
    better = (site == "a") & (log.actions == 1)  # the second arm is better at one site alone
    log = replace(log, rewards=np.where(better, 1.0, log.rewards).astype(np.float32))
    names, codes = np.unique(site, return_inverse=True)
    found = decide(case_of(log), [LINEAR], model=MODEL, groups=Groups("site", tuple(names), codes))
    table = found.more["groups"]["values"]
    assert [each["episodes"] for each in table] == [900, 900, 10]
    a, b, c = table
    assert a["low"] < 0.5 * (1.0 - 0.35) < a["high"]
    assert a["low"] > 0.2
    assert b["low"] < 0.0 < b["high"] < 0.12
    assert (c["low"], c["high"]) == (None, None)
    together = sum(each["episodes"] * each["gain"] for each in table) / 1810
    assert together == pytest.approx(found.choice.gain, abs=0.01)
    with pytest.raises(UserError, match="has 1,810 values; at most 50 subgroups"):
        decide(case_of(log), [LINEAR], groups=Groups("row", tuple(map(str, range(1810))), np.arange(1810)))
    with pytest.raises(UserError, match="above 0 and at most 1, got 2"):
        decide(case_of(log), [LINEAR], tail=2.0)


def test_groups_and_tails_know_among_how_many_the_policy_was_chosen():
    """The better of two has the intervals of one alone at half of the level."""
    log = trials(400, np.random.default_rng(0))
    groups = Groups("g", ("a", "b"), np.arange(400) % 2)
    two, one = case_of(log, [MOSTLY, FIRST]), case_of(log, [MOSTLY])
    chosen, alone, twice = (by_group(each, 0, groups, MODEL, alpha)[0] for each, alpha in ((two, 0.1), (one, 0.05), (one, 0.1)))
    assert chosen["high"] - chosen["low"] == pytest.approx(alone["high"] - alone["low"], rel=0.02)
    assert chosen["high"] - chosen["low"] > 1.1 * (twice["high"] - twice["low"])
    chosen, alone = tails(two, 0, 0.5, MODEL, 0.1), tails(one, 0, 0.5, MODEL, 0.05)
    assert (chosen["low"], chosen["high"]) == pytest.approx((alone["low"], alone["high"]))
    wider = tails(one, 0, 0.5, MODEL, 0.05, wider=0.2)
    assert (wider["low"], wider["high"]) == pytest.approx((alone["low"] - 0.2, alone["high"] + 0.2))


def test_the_interval_of_a_tail_is_students_of_paired_influences():
    """The policy takes the second arm 1.6 times as often as the coin, and the first 0.4 times."""
    rng = np.random.default_rng(0)
    log = replace(trials(400, rng), rewards=rng.standard_normal(400).astype(np.float32))
    own = lower_tail(np.log(np.where(log.actions == 1, 1.6, 0.4)), log.rewards, 0.5)
    logged = lower_tail(np.zeros(400), log.rewards, 0.5)
    half = stats.t.ppf(0.95, 399) * (own.influence - logged.influence).std(ddof=1) / np.sqrt(400)
    told = tails(case_of(log, [MOSTLY]), 0, 0.5, MODEL, 0.1)
    assert told["gain"] == pytest.approx(own.value - logged.value)
    assert (told["low"], told["high"]) == pytest.approx((told["gain"] - half, told["gain"] + half))


@pytest.mark.parametrize(("seed", "students"), [(0, True), (1, False)])
def test_the_interval_of_a_group_is_by_the_larger_of_two_factors(monkeypatch, seed, students):
    """Of 60 episodes in two equal groups: Student's quantile of a group's 30 at half of the level, or the factor at which both
    intervals hold at once."""
    monkeypatch.setattr("deadreckon.ope.groups.missing_by_row", lambda case, model: np.zeros((60, 1)))
    log = trials(60, np.random.default_rng(seed))
    case, second = case_of(log, [MOSTLY]), np.arange(60) % 2 == 1
    found, _ = DoublyRobust(kind="dr", fqe=LinearFQE(), model=MODEL).nuisances(case)
    weight = np.where(log.actions == 1, 1.6, 0.4)
    score = found.begins[0] + weight * found.errors[0] - found.begins[1] - found.errors[1]
    # The mean of a group moves with one of its episodes twice as much as the mean of all would. In the order of units, by which
    # they are resampled.
    influence = np.zeros((60, 2))
    for i, own in enumerate((~second, second)):
        influence[case.units, i] = np.where(own, 2 * (score - score[own].mean()), 0.0)
    factors = inference.simultaneous(influence, 0.05), stats.t.ppf(1 - 0.05 / 4, 29)
    assert (factors[1] > factors[0]) == students
    error = inference.errors(influence) * np.sqrt(30 / 29)  # with the degrees of freedom of a group
    shown = by_group(case, 0, Groups("g", ("a", "b"), second.astype(int)), MODEL)
    for told, own, half in zip(shown, (~second, second), max(factors) * error):
        assert told["gain"] == pytest.approx(score[own].mean())
        assert (told["low"], told["high"]) == pytest.approx((told["gain"] - half, told["gain"] + half))


@pytest.mark.slow  # simultaneous intervals are looked at in test_decide.py, on which these rest
def test_intervals_of_groups_hold_at_once():
    rng, missed, refused = np.random.default_rng(0), [], 0
    for _ in range(60):
        log = trials(240, rng, 0.2)
        codes = np.arange(240) % 4
        table = by_group(case_of(log, [SECOND]), 0, Groups("g", tuple("abcd"), codes), MODEL)
        shown = [each for each in table if each["why"] is None]
        refused += 4 - len(shown)
        missed.append(any(not each["low"] <= 0.1 <= each["high"] for each in shown))
    assert np.mean(missed) <= 0.13, np.mean(missed)
    assert refused <= 4


def test_the_tail_beside_that_of_the_log():
    """The second arm has half of the failures of the first: the worst half of its episodes fare better."""
    rng = np.random.default_rng(0)
    log = trials(4000, rng, 0.4)
    decision = decide(case_of(log), [LINEAR], model=MODEL, tail=0.5)
    told = decision.more["tail"]
    assert told["value"] == pytest.approx(1 - 0.25 / 0.5, abs=0.06)  # it fails in 0.25 of cases, all among its worst half
    assert told["logged"] == pytest.approx(1 - 0.45 / 0.5, abs=0.06)
    assert told["low"] < told["gain"] < told["high"]
    assert told["gain"] == pytest.approx(told["value"] - told["logged"])
    assert any(line.startswith("its worst 50 % of episodes return 0.") for line in decision.choice.evidence)
    few = decide(case_of(trials(60, rng)), [LINEAR], model=MODEL, tail=0.01)
    assert "rest on" in few.more["tail"]["refused"]
    assert any(line.startswith("its worst 1 % of episodes are not known: ") for line in few.choice.evidence)
    ends = garnet(states=3, actions=2, ending=0.1)
    cut = ends.log(np.full((3, 2), 0.5), 30, 5, np.random.default_rng(0)), ends.log(np.full((3, 2), 0.5), 30, 9, rng)
    columns = ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations")
    log = Dataset.from_arrays(
        **{key: np.concatenate([getattr(part, key) for part in cut]) for key in columns}, action_space=Discrete(2),
        behavior_log_probs=np.full(sum(map(len, cut)), np.log(0.5)),
    )  # fmt: skip
    case = OPEInput(log, [as_policy(np.full((3, 2), 0.5))], discount=0.9, logged=True)
    with pytest.raises(UserError, match="tails need whole episodes"):
        tails(case, 0, 0.5, MODEL)
    with pytest.raises(UserError, match="bounds for confounding need whole episodes"):
        Confounding(case, MODEL)
    draws_nothing = OPEInput(lqr(-0.5, 0.5, 30, 10), [BlackBoxPolicy(lambda seen, rng: -seen)], discount=0.9, noise=None)
    for ask in (lambda: tails(draws_nothing, 0, 0.1, MODEL), lambda: Confounding(draws_nothing, MODEL)):
        with pytest.raises(UserError, match="need importance weights, which are degenerate for deterministic policies"):
            ask()


def test_a_group_that_the_log_does_not_show_has_no_interval():
    """At the second site the policy always does what was never done there: 5 % of all rows, and all of that group's."""
    rng = np.random.default_rng(0)
    site = np.repeat([0, 1], [950, 50])
    log = trials(1000, rng)
    seen = np.column_stack([log.observations, site]).astype(np.float32)
    arm, told = np.where(site == 1, 0, log.actions), np.where(site == 1, 0.0, np.log(0.5))
    log = replace(log, observations=seen, final_observations=seen, actions=arm, extras={"behavior_log_probs": told})
    second = BlackBoxPolicy(
        lambda seen, rng: np.ones(len(seen), int), action_probs=lambda seen: np.tile([0.0, 1.0], (len(seen), 1))
    )
    case = OPEInput(log, [second], discount=0.0, horizon=1, logged=True)
    shown, lost = by_group(case, 0, Groups("site", ("a", "b"), site), MODEL)
    assert shown["low"] < 0.5 * 0.3 < shown["high"]
    assert shown["why"] is None
    assert (lost["low"], lost["high"]) == (None, None)
    assert lost["why"].startswith("its weights rest on 0.0 episodes")
    assert "its importance weights average 0.00 per step instead of 1" in lost["why"]
    words = groups({"choice": {"name": "second", "level": 0.95, "groups": {"column": "site", "values": [shown, lost]}}})
    assert "  b        50 episodes  " in words
    assert "without an interval: its weights rest on 0.0 episodes" in words


def test_what_rests_on_whole_episodes_needs_enough_of_them():
    """Products of forty weights rest on a few of the episodes, whatever the estimator that decides rests on."""
    world = garnet(states=3, actions=2, noise=0.5)
    log = world.log(np.full((3, 2), 0.5), 200, 40, np.random.default_rng(0))
    case = OPEInput(log, [as_policy(np.tile([0.9, 0.1], (3, 1)))], discount=0.9, horizon=40, logged=True)
    drl = estimator("drl")
    choice = decide(case, [drl], model=MODEL, confounding=1.2, tail=0.2)
    assert np.isfinite(choice.choice.low)
    assert choice.more["confounding"]["bounds"] is None
    assert not choice.choice.deploy
    assert any("is not known: by whole episodes its weights rest on" in line for line in choice.choice.evidence)
    assert choice.more["tail"]["refused"].startswith("by whole episodes its weights rest on")
    assert Confounding(case, MODEL).gain(0, 1.0) == (-np.inf, np.inf)
    endless = OPEInput(log, [as_policy(np.full((3, 2), 0.5))], discount=0.99, horizon=None, logged=True)
    with pytest.raises(UserError, match="tails need whole episodes"):  # all are cut off, at one length
        tails(endless, 0, 0.5, MODEL)


def misfit():
    """A case of arms that depend on whether two numbers are alike, and a model that cannot know it."""
    rng = np.random.default_rng(0)
    seen = rng.choice([-1.0, 1.0], (800, 2))
    arm = (rng.random(800) < np.where(seen.prod(1) > 0, 0.8, 0.2)).astype(int)
    log = replace(one_step(seen, arm, rng.normal(1.0 + arm), np.full(800, 0.5)), extras={})
    alike = BlackBoxPolicy(
        lambda seen, rng: (seen.prod(1) > 0).astype(int), action_probs=lambda seen: np.eye(2)[(seen.prod(1) > 0).astype(int)]
    )
    return OPEInput(log, [alike], discount=0.0, horizon=1, logged=True), BehaviorModel(hidden=(), steps=1)


@pytest.mark.parametrize("name", ["switch", "dros", "pdis", "dr-linear"])
def test_learned_propensities_that_do_not_fit_widen_what_does_not_normalise(name):
    case, blind = misfit()
    found = dataclasses.replace(estimator(name), model=blind).on(case)
    moved = found.diagnostics["normalising"]
    assert abs(moved[0]) > 1e-3
    more = {key: each for key, each in found.diagnostics.items() if key != "normalising"}
    plain, known = replace(found, diagnostics=more), np.ones(2, bool)
    widened = MOVED * np.abs(moved).max()
    assert gains(found)[0, 2] - gains(plain)[0, 2] == pytest.approx(widened)
    assert totals(found, 0.05, known)[0, 2] - totals(plain, 0.05, known)[0, 2] == pytest.approx(widened)


@pytest.mark.parametrize("name", ["is", "dr-linear"])
def test_learned_propensities_that_do_not_fit_widen_all_that_rests_on_whole_episodes(name):
    """Also where the estimator that decides normalises its weights: as much as the gain by `dr-linear`."""
    case, blind = misfit()
    plain = dataclasses.replace(estimator("dr-linear"), model=blind).on(case)
    wider = MOVED * np.abs(plain.diagnostics["normalising"]).max()
    groups = Groups("g", ("a", "b"), np.arange(800) % 2)
    judge = dataclasses.replace(estimator(name), model=blind)
    found = decide(case, [judge], model=blind, groups=groups, tail=0.5, confounding=1.2)
    assert found.choice.wider == pytest.approx(0.0 if name == "is" else wider)
    ends = lambda told: [told["low"], told["high"]]  # noqa: E731
    for told, alone in zip(found.more["groups"]["values"], by_group(case, 0, groups, blind)):
        assert ends(told) == pytest.approx([alone["low"] - wider, alone["high"] + wider])
    low, high = ends(tails(case, 0, 0.5, blind))
    assert ends(found.more["tail"]) == pytest.approx([low - wider, high + wider])
    low, high = Confounding(case, blind).gain(0, 1.2)
    assert found.more["confounding"]["bounds"][0] == pytest.approx([low - wider, high + wider])
