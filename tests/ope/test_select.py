"""Decisions from estimates, estimators by name, and the DOPE protocol on little."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.ope import (
    ESTIMATORS,
    FQE,
    LOGGED,
    DoublyRobust,
    ImportanceSampling,
    ModelBased,
    OPEInput,
    dope,
    estimator,
    select,
)
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.metrics import published
from deadreckon.ope.registry import PUBLIC, as_estimator, with_fields
from deadreckon.ope.select import gains, unbounded_where_unsupported
from deadreckon.policies import BlackBoxPolicy, library
from deadreckon.report.dope import write_bench
from deadreckon.report.text import number
from deadreckon.theory import garnet
from deadreckon.theory.tabular import softmax
from tests.ope.test_case import TINY, linear, lqr, riccati
from tests.ope.worlds import as_policy, tables

TABULAR = FQE(members=4, hidden=(), steps=2000, lr=2e-2, weight_decay=0.0, tau=0.05)


@pytest.fixture(scope="module")
def case():
    """A log, a policy that is clearly better, and one that is clearly worse."""
    true = garnet(states=6, actions=3, noise=0.3)
    behavior = tables(true, 1, 0.3)[0]
    best = true.optimal(0.9)
    policies = [softmax(-best, 2.0), softmax(best, 2.0)]
    log = true.log(behavior, 300, 60, np.random.default_rng(0))
    made = OPEInput(log, [as_policy(p) for p in policies], discount=0.9, names=["worse", "better"], logged=True)
    made.exact = [true.value(p, 0.9) for p in (*policies, behavior)]
    return made


@pytest.mark.slow
@pytest.mark.parametrize("estimator", [ImportanceSampling(), TABULAR, DoublyRobust(fqe=TABULAR)], ids=["is", "fqe", "dr"])
def test_the_logs_own_policy_is_judged_like_the_others(case, estimator):
    found = estimator.on(case)
    assert found.names == ("worse", "better", LOGGED)
    assert abs(found.value[2] - case.exact[2]) < 0.1 * abs(case.exact[1] - case.exact[0])
    choice = select([found], accept_model_based=True)
    assert choice.name == "better"
    assert choice.deploy
    assert choice.low < case.exact[1] - case.exact[2] < choice.high
    assert "DEPLOY better: +" in str(choice)
    # Nothing corrects an error of a fitted model, so it decides only where that is accepted.
    assert select([found]).deploy == found.corrected


@pytest.mark.slow
def test_a_paired_difference_is_surer_than_two_values(case):
    """What a redrawn log does to both cancels in their difference."""
    found = ImportanceSampling().on(case)
    apart = found.bootstrap[:, 1].std() ** 2 + found.bootstrap[:, 2].std() ** 2
    assert (found.bootstrap[:, 1] - found.bootstrap[:, 2]).std() ** 2 < apart


@pytest.mark.slow
def test_decisions_against_deploying(case):
    only_worse = OPEInput(case.data, case.policies[:1], discount=0.9, names=["worse"], logged=True)
    choice = select([TABULAR.on(only_worse)], accept_model_based=True)
    assert not choice.deploy
    assert "the lower end is not above zero" in choice.reason
    assert "model-based only" in select([TABULAR.on(only_worse)]).reason
    sharp = as_policy(np.eye(3)[np.random.default_rng(1).integers(0, 3, 6)])
    few = ImportanceSampling(kind="trajectory").on(OPEInput(case.data, [sharp], discount=0.9, names=["sharp"], logged=True))
    assert not select([few]).deploy
    assert "its weights rest on" in select([few]).reason
    with pytest.raises(UserError, match="has no estimate of the behaviour policy"):
        select([ImportanceSampling().on(OPEInput(case.data, case.policies, discount=0.9))])
    with pytest.raises(UserError, match="different policies"):
        select([few, ImportanceSampling().on(case)])


@pytest.mark.slow
def test_others_are_evidence(case):
    choice = select([ImportanceSampling().on(case), TABULAR.on(case)])
    assert choice.evidence[0].startswith("FQE-L2: +")
    assert choice.evidence[0].endswith("ranks it first, too")


def estimates(method, gains, bootstrap, ess=None, corrected=True):
    """Of policies a, b, ... and the log's own, which has 0."""
    value = np.array([*gains, 0.0])
    names = (*"abcdef"[: len(gains)], LOGGED)
    ess = None if ess is None else np.array([*ess, 1000.0])
    bootstrap = np.concatenate([bootstrap, np.zeros((len(bootstrap), 1))], 1)
    known = {"bootstrap": bootstrap, "ess": ess, "corrected": corrected}
    return Estimates(method, names, value, value, value, Estimand(0.9), **known)


def test_the_behaviour_policy_is_the_last_of_an_estimate():
    """Else the gain of another policy, or what speaks against it, was told of the one that is chosen."""
    found = estimates("DR", [1.0, -1.0], np.random.default_rng(0).normal([1.0, -1.0], size=(1000, 2)))
    assert select([found]).name == "a"
    first = dataclasses.replace(found, names=(LOGGED, "a", "b"))
    with pytest.raises(UserError, match="must be the last policy of an estimate, got behaviour policy, a, b"):
        select([first])


def test_a_gain_that_is_a_rounding_error_is_not_above_zero():
    """Of values around 7 a gain of 2e-7, always the same, is what 32-bit numbers make; one of 1e-4 is none of theirs."""
    for gain, above in ((2e-7, False), (1e-4, True)):
        found = estimates("DR", [gain], np.full((1000, 1), gain))
        found = dataclasses.replace(found, value=found.value + 7.3, bootstrap=found.bootstrap + 7.3)
        assert (gains(found)[0, 1] > 0) == above


def test_an_estimate_without_an_interval_is_not_conclusive():
    """One member of an ensemble has none: its ends are not a rounding error away from the estimate."""
    found = estimates("FQE", [0.5], np.full((1, 1), 0.5))
    assert np.isnan(gains(found)[0, 1:]).all()
    assert not select([found], accept_model_based=True).deploy


def test_the_lower_end_decides_and_not_the_estimate():
    draws = np.random.default_rng(0).standard_normal((1000, 1))
    wide, narrow = (select([estimates("DR", [1.0], 1.0 + spread * draws, ess=[900.0])]) for spread in (1.0, 0.1))
    assert (wide.gain, narrow.gain) == (1.0, 1.0)
    assert wide.low < 0 < narrow.low
    assert (wide.deploy, narrow.deploy) == (False, True)


def test_the_level_that_is_asked_for_decides():
    """The lower end of a gain of 2.2 standard errors is above zero at 95 %, and below at 98.75 %."""
    found = weighted(0.22, 0.1, {})
    usual, stricter = (select([found], alpha=alpha) for alpha in (0.05, 0.0125))
    assert (usual.deploy, stricter.deploy) == (True, False)
    np.testing.assert_array_equal(stricter.gains, gains(found, 0.0125)[:1])
    np.testing.assert_array_equal([stricter.gain, stricter.low, stricter.high], gains(found, 0.0125)[0])
    assert stricter.level == 1 - 0.0125


@pytest.mark.parametrize("count", [1000, 5], ids=["bootstrap", "ensemble"])
def test_intervals_by_draws_share_the_level_among_all_policies(count):
    """Each of six has the interval of one alone at a sixth of the level."""
    draws = 1.0 + np.random.default_rng(0).standard_normal((count, 6))
    six = gains(estimates("FQE-L2", [1.0] * 6, draws), 0.06)
    for i in range(6):
        np.testing.assert_allclose(six[i], gains(estimates("FQE-L2", [1.0], draws[:, [i]]), 0.01)[0])


def test_errors_of_fitted_models_share_the_level_among_all_policies():
    """Three groups deviate by 3, -3 and 0 from the value of each policy, and by nothing from that of the behaviour policy."""
    value, deviations = np.zeros(7), np.outer([3.0, -3.0, 0.0], [1.0] * 6 + [0.0])
    found = Estimates("DR", (*"abcdef", LOGGED), value, value, value, Estimand(0.9), influence=np.zeros((50, 7)),
                      nuisance=deviations)  # fmt: skip
    half = stats.t.ppf(1 - 0.05 / 6 / 2, 2) * np.sqrt(18)
    np.testing.assert_allclose(gains(found)[:6], [[0.0, -half, half]] * 6)


def test_a_policy_that_something_speaks_against_is_not_chosen_before_one_without():
    draws = np.random.default_rng(0).standard_normal((1000, 2))
    found = estimates("DR", [2.0, 1.0], np.array([2.0, 1.0]) + 0.1 * draws, ess=[900.0, 900.0])
    assert select([found]).name == "a"
    choice = select([found], seen=["it was trained on these episodes", None])
    assert (choice.name, choice.deploy) == ("b", True)
    assert choice.objections == (("it was trained on these episodes",), ())


def test_a_policy_without_overlap_comes_last():
    """Where rewards are negative, one that never acts as the log did has a value of 0."""
    rng = np.random.default_rng(0)
    draws = np.stack([np.full(200, 18.0), 3 + 0.1 * rng.standard_normal(200)], 1)
    choice = select([estimates("WPDIS", [18.0, 3.0], draws, ess=[0.0, 200.0])])
    assert choice.name == "b"
    assert choice.deploy
    alone = select([estimates("WPDIS", [18.0], draws[:, :1], ess=[0.0])])
    assert not alone.deploy
    assert "its weights rest on 0.0 episodes" in alone.reason


def test_weights_of_one_episode_tell_no_interval():
    """Normalised, its value is the estimate, and nothing is left that varies."""
    found = estimates("WPDIS", [10.0], np.full((1000, 1), 10.0), ess=[1.2])
    np.testing.assert_array_equal(gains(found)[0], [10.0, -np.inf, np.inf])
    case = SimpleNamespace(names=("a", "b"), seed=0, estimand=Estimand(0.9))
    one, ten = np.zeros((40, 2)), np.random.default_rng(0).normal(size=(40, 2))
    for influence, ess, known in ((one, [1.2, 40.0], [False, True]), (ten, [2.0, 40.0], [True, True])):
        found = Estimates.of_influence("WPDIS", case, np.array([10.0, 0.0]), influence, ess=np.array(ess))
        assert np.isfinite(found.low).tolist() == np.isfinite(found.high).tolist() == known


def test_few_members_choose_by_their_mean():
    """The spread of three members is a matter of chance: the surest by it may be the worst."""
    draws = np.array([[10.0, 1.01], [12.0, 1.0], [14.0, 0.99]])
    assert select([estimates("FQE-L2", [12.0, 1.0], draws)]).name == "a"
    many = np.repeat(draws, 100, 0) + np.random.default_rng(0).standard_normal((300, 1)) * [6.0, 0.0]
    assert select([estimates("WPDIS", [12.0, 1.0], many, ess=[100.0, 100.0])]).name == "b"


def test_estimates_that_speak_against_the_choice():
    rng = np.random.default_rng(0)
    good, bad = (g + 0.1 * rng.standard_normal((200, 1)) for g in (2.0, -2.0))
    for ess, deploy in (([100.0], False), ([3.0], True)):
        choice = select([estimates("FQE-L2", [2.0], good), estimates("WDR", [-2.0], bad, ess=ess)])
        assert choice.deploy == deploy
        assert ("but WDR finds it worse" in choice.reason) != deploy
        assert any("the weights of a in WDR rest on 3.0 episodes" in line for line in choice.warnings) == deploy


@pytest.mark.parametrize("objection", [(), ("it costs too much",)])
def test_a_policy_that_objections_hold_back_is_named(objection):
    """The best of the others has not the highest lower end of all."""
    draws = [2.0, 0.0] + 0.1 * np.random.default_rng(0).standard_normal((200, 2))
    choice = select([estimates("FQE-L2", [2.0, 0.0], draws)], accept_model_based=True, against=[objection, ()])
    assert choice.deploy == (not objection)
    if objection:
        assert "b has the highest lower end of the policies without objections, with" in choice.reason
        assert choice.reason.endswith("the lower end is not above zero; a would be deployed without objections")
    none = select([estimates("FQE-L2", [0.0, 0.0], draws * 0.0)], accept_model_based=True, against=[objection, ()])
    assert "would be deployed" not in none.reason


def weighted(gain, spread, diagnostics, ess=100.0, count=200):
    """Of one policy by influence functions, and the log's own."""
    psi = np.random.default_rng(0).standard_normal(count)
    psi = spread * np.sqrt(count) * (psi - psi.mean()) / psi.std()
    value, ess = np.array([gain, 0.0]), np.array([ess, float(count)])
    influence = np.stack([psi, np.zeros(count)], 1)
    more = {name: np.array([number, float(name != "normalising")]) for name, number in diagnostics.items()}
    return Estimates("DR", ("a", LOGGED), value, value, value, Estimand(0.9), influence=influence, ess=ess,
                     corrected=True, diagnostics=more)  # fmt: skip


@pytest.mark.parametrize(
    ("diagnostics", "ess", "why"),
    [
        ({}, 100.0, None),
        ({"effective share": 0.1}, 40.0, "rest on 40.0 episodes, 50 or 20 % of all"),
        ({"effective share": 0.1}, 4.0, "policy; if an action has no effect on later rows, read each row as an episode"),
        ({}, 4.0, "10 are needed; record more episodes, or evaluate a policy closer to the behaviour policy"),
        ({"effective share": 0.1}, 60.0, None),
        ({"effective share": 0.3}, 40.0, None),
        ({"mean weight": 0.6, "mean weight high": 0.9}, 100.0, "average 0.60 instead of 1"),
        ({"mean weight": 0.6, "mean weight high": 1.1}, 100.0, None),
        ({"pareto k": 0.9, "pareto k low": 0.8}, 40.0, "too heavy a tail"),
        ({"pareto k": 0.9, "pareto k low": 0.8}, 60.0, None),
        ({"pareto k": 0.9, "pareto k low": 0.6}, 40.0, None),
        ({"settled": 0.0}, 100.0, "has not converged"),
    ],
)
def test_what_an_interval_does_not_know_makes_it_endless(diagnostics, ess, why):
    choice = select([weighted(1.0, 0.1, diagnostics, ess)])
    assert choice.deploy == (why is None)
    if why is None:
        assert 0.7 < choice.low < choice.high < 1.3
    else:
        assert why in choice.reason
        assert (choice.low, choice.high) == (-np.inf, np.inf)
        assert choice.gains[0, 1] == -np.inf


@pytest.mark.parametrize(("episodes", "why"), [(10, "there are only 10 episodes or clusters"), (40, "has not converged")])
def test_accepting_what_is_model_based_accepts_neither_few_episodes_nor_a_fit_that_goes_on(episodes, why):
    """Critics of two updates, of a policy that earns more."""
    case = OPEInput(lqr(-0.5, 0.5, episodes, 5), linear(-1.0, 0.1), discount=0.5, logged=True)
    found = FQE(members=2, hidden=(), steps=10, lr=0.3, batch_size=16).on(case)
    choice = select([found], accept_model_based=True)
    assert why in choice.reason
    assert (choice.deploy, choice.low) == (False, -np.inf)


def test_gains_of_few_clusters_by_the_bootstrap_are_students():
    """Five clusters that are redrawn many times are five."""
    draws = np.random.default_rng(0).standard_normal((4000, 1))
    found = estimates("FQE-linear", [1.0], 1.0 + draws, corrected=False)
    (five, many) = (gains(dataclasses.replace(found, units=count))[0] for count in (5, 10_000))
    wider = np.sqrt(5 / 4) * stats.t.ppf(0.975, 4) / stats.norm.ppf(0.975)
    assert five[2] - five[1] == pytest.approx(wider * (many[2] - many[1]), rel=1e-2)


@pytest.mark.parametrize(
    ("diagnostics", "ess", "bounded"),
    [
        ({}, 100.0, True),
        ({}, 1.0, False),
        ({"effective share": 0.1}, 40.0, False),
        ({"mean weight": 0.6, "mean weight high": 0.9}, 100.0, False),
        ({"mean weight": 0.6, "mean weight high": 1.1}, 100.0, True),
    ],
)
def test_values_have_no_interval_either_where_weights_miss_the_policy(diagnostics, ess, bounded):
    found = weighted(1.0, 0.1, diagnostics, ess)
    found = dataclasses.replace(found, low=found.value - 0.2, high=found.value + 0.2)
    shown = unbounded_where_unsupported(found, None)
    assert (shown.low[0], shown.high[0]) == ((0.8, 1.2) if bounded else (-np.inf, np.inf))
    assert (shown.low[1], shown.high[1]) == (-0.2, 0.2)  # the log's own


def test_learned_propensities_that_do_not_fit_widen_intervals():
    right, wrong = (select([weighted(1.0, 0.1, {"normalising": shift})]) for shift in (0.0, -0.3))
    assert wrong.high - wrong.low == pytest.approx(right.high - right.low + 4 * 0.3)
    assert wrong.low + wrong.high == pytest.approx(right.low + right.high)
    assert any("do not fit the log" in line for line in wrong.warnings)
    assert not right.warnings


def test_errors_of_cross_fitted_policies_count_more():
    """Two folds whose policies copy each other's luck: the variance of the estimate is twice that of independent folds."""
    rng, luck = np.random.default_rng(0), []
    for _ in range(4_000):
        a, b = rng.standard_normal(2)
        luck.append(a * b + b * a)
    assert np.var(luck) == pytest.approx(2 * 2, rel=0.15)
    found = weighted(1.0, 0.1, {})
    wide = select([dataclasses.replace(found, inflation=np.array([np.sqrt(2), 1.0]))])
    plain = select([found])
    assert wide.high - wide.low == pytest.approx(np.sqrt(2) * (plain.high - plain.low))


@pytest.mark.slow  # whether it learns is looked at below too; its numbers are golden
@pytest.mark.parametrize("kind", ["feedforward", "autoregressive"])
def test_model_based_on_lqr(kind):
    log = lqr(-0.5, 0.5, 300, 40)
    steps = {"feedforward": 2500, "autoregressive": 1500}[kind]
    model = BehaviorModel(hidden=(16,), steps=500, lr=1e-2)
    found = ModelBased(kind=kind, members=2, hidden=(32, 32), steps=steps, lr=2e-3, episodes=300, model=model).estimate(
        log, [linear(-0.5, 0.5), linear(-1.0, 0.2), linear(0.0, 0.3)], discount=0.9, logged=True
    )
    exact = [riccati(-0.5, 0.5, 0.9), riccati(-1.0, 0.2, 0.9), riccati(0.0, 0.3, 0.9)]
    np.testing.assert_allclose(found.value[:3], exact, rtol=0.25)
    assert found.best == 1
    assert abs(found.value[3] - found.value[0]) < 0.3  # the first made the log


@pytest.mark.slow
def test_model_based_compares_with_what_the_logs_policy_makes_up():
    """Episodes are cut off after 10 steps of a reward of 1: what the log got says nothing of what goes on without end."""
    rng = np.random.default_rng(0)
    rows, cut = 1000, np.arange(1000) % 10 == 9
    log = Dataset.from_arrays(
        observations=rng.standard_normal((rows, 1)), actions=rng.uniform(-1, 1, (rows, 1)), timeouts=cut,
        rewards=1.0 + 0.3 * rng.standard_normal(rows), final_observations=rng.standard_normal((100, 1)),
        action_space=Box([-1.0], [1.0]), name="cut",
    )  # fmt: skip
    same = BlackBoxPolicy(lambda seen, rng: rng.uniform(-1, 1, seen.shape))
    model = ModelBased(members=2, hidden=(8,), steps=300, lr=1e-2, model=BehaviorModel(hidden=(8,), steps=200, lr=1e-2))
    found = model.estimate(log, same, discount=0.97, logged=True)
    np.testing.assert_allclose(found.value, 1 / 0.03, rtol=0.05)
    assert not select([found]).deploy


@pytest.mark.slow
def test_one_member_says_that_it_gives_no_interval():
    log = lqr(-0.5, 0.5, 10, 5)
    model = BehaviorModel(hidden=(4,), steps=10)
    found = ModelBased(members=1, hidden=(4,), steps=10, episodes=5, model=model).estimate(log, linear(-0.5, 0.5), discount=0.5)
    assert np.isnan(found.low[0])
    assert "MB-FF has one member, which gives no interval; more members do" in found.warnings


@pytest.mark.slow
def test_model_based_where_episodes_end():
    """A chance of an end shortens made-up episodes as it does true ones."""
    true = garnet(states=4, actions=2, ending=0.3)
    policy = tables(true, 1, 0.3)[0]
    log = true.log(policy, 800, 60, np.random.default_rng(0))
    model = ModelBased(members=2, hidden=(32,), steps=2500, lr=2e-3, episodes=300)
    found = model.estimate(log, as_policy(policy), discount=0.9)
    assert abs(found.value[0] - true.value(policy, 0.9)) < 0.25 * np.abs(true.q(policy, 0.9)).max()


@pytest.mark.parametrize("name", ESTIMATORS)
def test_estimators_by_name(name):
    found = estimator(name, steps=7, members=2)
    public = with_fields(found, PUBLIC)
    assert getattr(public, "alive_only", True)
    fitted = [each for each in (found, getattr(found, "fqe", None), getattr(found, "model", None)) if hasattr(each, "steps")]
    assert fitted or name == "fqe-linear"  # which is solved
    assert all(each.steps == 7 for each in fitted)
    assert ESTIMATORS[name][1]


def test_names_that_are_none():
    with pytest.raises(UserError, match="unknown estimator 'fqa': did you mean fqe"):
        estimator("fqa")
    with pytest.raises(UserError, match="estimators are names, Estimator objects or functions, got int"):
        as_estimator(3)


def little(rows):
    rng = np.random.default_rng(0)
    return Dataset.from_arrays(
        observations=rng.standard_normal((rows, 11)), actions=rng.uniform(-1, 1, (rows, 3)), rewards=rng.random(rows),
        timeouts=np.arange(rows) % 20 == 19, final_observations=rng.standard_normal((rows // 20, 11)), name="little",
    )  # fmt: skip


@pytest.mark.slow
def test_the_protocol_with_a_function_of_ones_own(tmp_path, monkeypatch):
    """One line for a user's own estimator; what has been computed is not computed again."""
    data = little(200)
    truth = [s.sampled.discounted for s in library.evaluated("hopper")]
    calls = []

    def perfect(data, policies, discount):
        calls.append(discount)
        return np.array(truth)

    options = {"out": tmp_path / "dope"}
    results = dope.evaluate_log(data, "hopper", [perfect, TINY], **options)
    assert [r.method for r in results] == ["perfect", "FQE-L2"]
    assert results[0].metrics().absolute_error == (0.0, 0.0, 0.0)
    assert results[0].metrics().rank_correlation.value == pytest.approx(1.0)
    assert results[0].metrics().regret.value == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(results[1].truth, truth)
    again = dope.evaluate_log(data, "hopper", [perfect, TINY], **options)
    assert calls == [0.995, 0.995]  # what a function does is not in its name
    np.testing.assert_array_equal(again[1].estimates, results[1].estimates)
    assert [p.name.split("-")[0] for p in (tmp_path / "dope").glob("*/*.json")] == ["FQE"]
    table = dope.markdown(results, "rank_correlation")
    assert "| little | 1.00 ± 0.00 |" in table
    assert table.splitlines()[-1].startswith("| median | 1.00 |")
    # A method whose numbers go bad holds nobody up, and has no median that only its easy logs make.
    bad = dope.evaluate_log(data, "hopper", [TINY.replace(lr=1e30)], **options)
    assert np.isnan(bad[0].estimates).all()
    assert "no estimates: fqe: " in bad[0].warnings[0]
    assert bad[0].method == "FQE-L2"
    mixed = dope.markdown([results[0], dataclasses.replace(results[0], log="other"), bad[0]], "regret")
    assert mixed.endswith("|  |")
    # A log's name is whatever its file says, and leads nowhere.
    dope.evaluate_log(dataclasses.replace(data, name="../../x"), "hopper", [TINY], **options)
    assert sorted(p.name for p in (tmp_path / "dope").iterdir()) == ["..-..-x", "little"]
    other = dataclasses.replace(results[1], settings="another width")
    with pytest.raises(UserError, match="FQE-L2 on little has results of several settings"):
        dope.markdown([*results, other], "regret")
    with pytest.raises(UserError, match="gave values of shape"):
        dope.evaluate_log(data, "hopper", [lambda data, policies, discount: [1.0]])


@pytest.mark.parametrize(("what", "fits"), [
    pytest.param("ope.fqe.FQE.revision", 2, marks=pytest.mark.slow), ("training.program.REVISION", 2),
    pytest.param("ope.dope.REVISION", 1, marks=pytest.mark.slow),
    pytest.param("stats.interval.REVISION", 1, marks=pytest.mark.slow),
])  # fmt: skip
def test_results_of_other_revisions_are_computed_again(tmp_path, monkeypatch, what, fits):
    """A folder of results gives those of today's code alone; fits are made again where the code behind them is another."""
    data, told = little(60), []
    options = {"out": tmp_path, "told": told.append}
    dope.evaluate_log(data, "hopper", [TINY], **options)
    [kept] = tmp_path.glob("little/*.json")
    values = read_json(kept)
    values["result"]["estimates"] = [7.0] * 11
    write_json(kept, values)
    assert dope.evaluate_log(data, "hopper", [TINY], **options)[0].estimates.tolist() == [7.0] * 11
    monkeypatch.setattr(f"deadreckon.{what}", 99)
    [again] = dope.evaluate_log(data, "hopper", [TINY], **options)
    np.testing.assert_array_equal(again.estimates, told[0].estimates)
    assert len(list(tmp_path.glob("little/*.json"))) == 2
    assert len(list(tmp_path.glob("little/fits-*"))) == fits


def test_published_values_stand_below_ours(tmp_path):
    """Rank correlations and regrets of thesis E.2 by name; absolute errors only in returns, which is what it prints."""
    truth = np.linspace(0.0, 3000.0, 11)
    names = tuple(f"snapshot-{i}" for i in range(11))
    made = dope.Result("hopper-medium-v2@dr1", "WDR", names, 1500.0, truth, truth * 0, truth[::-1], truth, truth, 1.0, (), "")
    cell = dope.cells([made], "rank_correlation")["hopper-medium-v2@dr1"]["WDR"]
    assert cell.value == cell.mean == pytest.approx(-1.0)
    assert cell.printed == tuple(published()["rank_correlation"]["d4rl"]["hopper-medium"]["DR"])
    # The one that seems best is the worst: a regret of the whole range, which redrawn sets that lack the extremes do not have.
    cell = dope.cells([made], "regret")["hopper-medium-v2@dr1"]["WDR"]
    assert cell.value == 1.0
    assert cell.mean < 0.95
    rows = [line.split("|")[1:3] for line in dope.markdown([made], "regret").splitlines()]
    assert rows[2:5] == [
        [" hopper-medium-v2@dr1 ", f" 1.00 ± {cell.spread:.2f} "],
        [" over redrawn policies ", f" {cell.mean:.2f} ± {cell.spread:.2f} "],
        [" thesis E.2 ", " {:.2f} ± {:.2f} ".format(*cell.printed)],
    ]
    page = write_bench([made], tmp_path / "page.html").read_text()
    own = [number(x) for x in (cell.value, cell.spread, cell.mean)]
    shown = "<b>{}</b><small>±{}</small><small>redrawn {}</small><small>thesis ".format(*own)
    assert shown in page
    assert "The thesis (E.2) prints means over redrawn policies" in page
    assert "| thesis E.2 |" not in dope.markdown([made], "absolute_error")
    raw = dope.markdown([made], "absolute_error", normalised=False)
    assert "| thesis E.2 |" in raw
    # The five that seem best are the five worst; all that is truly above 1,500 is estimated below it, save the one there.
    best = truth[:5].max() - 1500.0
    np.testing.assert_allclose(made.risks(), (best / truth[:5].std(), 1.0, 5 / 6))
    assert f"| WDR | {best / truth[:5].std():.2f} | 1.00 | 0.83 |" in dope.risks([made])
    lost = dataclasses.replace(made, estimates=np.full(11, np.nan))
    assert np.isnan(dope.cells([lost], "regret")["hopper-medium-v2@dr1"]["WDR"].value)


@pytest.mark.parametrize(
    ("setting", "kind"),
    [({"alive_only": True}, "switch"), ({"alive_only": True}, "marginal"), ({"behavior": "logged"}, "marginal"),
     ({"log_ratio_range": (-6.0, 2.0)}, "marginal")],
)  # fmt: skip
def test_settings_that_a_kind_does_not_use_are_refused(setting, kind):
    with pytest.raises(UserError, match=f"DoublyRobust.{next(iter(setting))} is not used with kind='{kind}'; leave it out"):
        DoublyRobust(kind=kind, fqe=LinearFQE(), **setting).check_settings()


def test_gains_over_a_behaviour_policy_whose_fit_has_not_converged_are_not_known():
    """Its value is in all of them; where logged returns correct it, it does not matter."""
    draws = np.random.default_rng(0).normal(size=(200, 2))
    found = estimates("fqe", [2.0, 3.0], 0.1 * draws + [2.0, 3.0])
    why = "the fit of the behaviour policy's estimate has not converged"
    for settled, words in (([1.0, 1.0, 1.0], ()), ([1.0, 1.0, 0.0], (why,))):
        choice = select([dataclasses.replace(found, diagnostics={"settled": np.array(settled)})], accept_model_based=True)
        assert choice.objections[1] == words
        assert choice.deploy == (not words)
