"""What may be asked of a case and of a decision, and what is refused before anything is fitted."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.ope import FQE, BehaviorModel, DoublyRobust, Estimand, ImportanceSampling, LinearFQE, OPEInput
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.decide import decide
from deadreckon.ope.dope import evaluate_log
from deadreckon.ope.fits import Fits
from deadreckon.ope.groups import Groups, by_group
from deadreckon.ope.guarantee import refuse
from deadreckon.ope.metrics import compare
from deadreckon.ope.registry import as_estimators
from deadreckon.policies import BlackBoxPolicy
from deadreckon.theory import garnet
from tests.ope.test_case import linear, lqr
from tests.ope.worlds import as_policy, tables

TINY = FQE(members=2, hidden=(8,), steps=60, batch_size=16)


def test_fits_that_learn_from_other_episodes_have_other_checkpoints(tmp_path, monkeypatch):
    """Held episodes and clusters say which rows teach the models of a fold; a policy that does the same everywhere does not."""
    world = garnet(states=3, actions=2, ending=0.3)
    log = world.log(tables(world, 1, 0.2)[0], 60, 10, np.random.default_rng(0))
    same = as_policy(np.tile([0.3, 0.7], (3, 1)))
    folders = []

    def stop(self, learner, rows, steps, what, folder):
        folders.append(folder)
        raise InterruptedError

    monkeypatch.setattr(Fits, "_train", stop)
    asked = [{}, {"clusters": np.arange(60) // 4}, {"held": np.arange(30)}, {"held": np.arange(30, 60)}, {}]
    for options in asked:
        case = OPEInput(log, same, discount=0.9, out=tmp_path, **options)
        for fit in (lambda case=case: TINY.out_of_fold(case, 3, 1), lambda case=case: out_of_fold(case, BehaviorModel(), 3)):
            with pytest.raises(InterruptedError):
                fit()
    assert len(set(folders[:-2])) == 8
    assert folders[-2:] == folders[:2]


@pytest.mark.parametrize("held", [[-1], [0, 60], [3, 3], [0.5], np.ones(60, bool), [], [[1]]])
def test_held_episodes_are_different_ones_of_the_log(held):
    """-1 would be judged as the last episode, and teach as one that is not judged."""
    world = garnet(states=3, actions=2, ending=0.3)
    log = world.log(tables(world, 1, 0.2)[0], 60, 10, np.random.default_rng(0))
    with pytest.raises(UserError, match="held must be"):
        OPEInput(log, as_policy(np.full((3, 2), 0.5)), discount=0.9, held=held)


@pytest.fixture(scope="module")
def case():
    world = garnet(states=3, actions=2, ending=0.3)
    behavior, target = tables(world, 2, 0.2)
    log = world.log(behavior, 60, 10, np.random.default_rng(0))
    return OPEInput(log, as_policy(target), discount=0.9, logged=True)


@pytest.mark.parametrize(("name", "value", "right"), [
    ("discount", None, "a number"), ("discount", "0.9", "a number"), ("discount", True, "a number"),
    ("discount", np.nan, "a number"),
    ("horizon", "abc", "a whole number or 'auto' or None"), ("horizon", 2.7, "a whole number"),
    ("seed", 1.5, "a whole number"), ("seed", None, "a whole number"), ("seed", True, "a whole number"),
    ("greedy", "x", "True or False"), ("greedy", 1, "True or False"), ("watch", None, "a function"),
    ("out", 3, "a text or None"),
])  # fmt: skip
def test_settings_of_another_kind_are_refused(case, name, value, right):
    with pytest.raises(UserError, match=f"^{name} takes .*{right}"):
        OPEInput(case.log, case.policies, **{name: value})


def test_numbers_of_numpy_are_numbers(case):
    found = OPEInput(case.log, case.policies, discount=np.float32(0.5), horizon=np.int64(3), greedy=np.False_, seed=np.uint8(1))
    assert found.estimand == Estimand(0.5, 3, False)
    assert isinstance(found.estimand.horizon, int)
    with pytest.raises(UserError, match="horizon takes a whole number or None, got 2.5"):
        Estimand(0.9, 2.5)


@pytest.mark.parametrize(("options", "told"), [
    ({"tail": "x"}, "tail takes a number or None, got 'x'"), ({"confounding": (2,)}, "confounding takes a number or None"),
    ({"accept_model_based": "no"}, "accept_model_based takes True or False"),
    ({"model": 3}, "model takes BehaviorModel, got 3"),
    ({"guarantee": True, "return_range": (0, 1, 2)}, r"return_range takes 2 numbers or None, got \(0, 1, 2\)"),
    ({"guarantee": True, "return_range": ("a", "b")}, "return_range takes 2 numbers or None"),
    ({"return_range": (0.0, 1.0)}, "return_range is used only with a guarantee"),
    ({"alpha": 0}, "alpha, .*, must lie between 0 and 1, got 0"), ({"alpha": 2.0}, "must lie between 0 and 1, got 2.0"),
    ({"alpha": "x"}, "alpha takes a number"),
    ({"groups": Groups("site", ("a",), np.zeros(61, int))}, r"groups by site must be .* each of 60 episodes .*\(61,\)"),
    ({"estimators": []}, "no estimator; give names"), ({"estimators": 3}, "estimators are names, .* got int"),
    ({"estimators": ["is", "nope"]}, "unknown estimator 'nope'"),
])  # fmt: skip
def test_what_a_decision_cannot_be_asked_is_refused_before_anything_is_fitted(case, options, told, monkeypatch):
    monkeypatch.setattr("deadreckon.ope.decide.support", lambda *_: pytest.fail("something was looked at"))
    with pytest.raises(UserError, match=told):
        decide(case, **{"estimators": ["is"], **options})


@pytest.mark.parametrize(("judge", "told"), [
    (LinearFQE(ridge=0.0), "LinearFQE.ridge takes a finite number > 0, got 0.0"),
    (DoublyRobust(fqe=LinearFQE(ridge=0.0)), "LinearFQE.ridge takes a finite number > 0, got 0.0"),
    (ImportanceSampling(log_ratio_range=(2.0, -6.0)), r"log_ratio_range must be \(least, greatest\), got 2, -6"),
    (DoublyRobust(log_ratio_range=(0.0, 1.0, 2.0)), r"log_ratio_range takes 2 numbers or None, got \(0.0, 1.0, 2.0\)"),
])  # fmt: skip
def test_settings_of_estimators_that_are_none_are_refused(judge, told):
    with pytest.raises(UserError, match=told):
        judge.check_settings()


def test_ranges_and_groups_are_refused_wherever_they_are_given(case):
    with pytest.raises(UserError, match="return_range takes 2 numbers or None, got 3"):
        refuse(case, 3)
    with pytest.raises(UserError, match="groups by site must be a number for each of 60 episodes"):
        by_group(case, 0, Groups("site", ("a",), np.zeros(500, int)), BehaviorModel())


def test_one_estimator_may_stand_alone():
    one, given = ImportanceSampling(), lambda data, policies, discount: [0.0]
    assert [each.label for each in as_estimators("is")] == [each.label for each in as_estimators(["is"])] == [one.label]
    assert as_estimators(one) == [one]
    assert as_estimators(given)[0].fn is given


def test_the_protocol_knows_all_estimators_before_it_fits_one(case, monkeypatch):
    monkeypatch.setattr("deadreckon.ope.dope.library.library", lambda task: pytest.fail("something was read"))
    with pytest.raises(UserError, match="unknown estimator 'nope'"):
        evaluate_log(case.log, "hopper", ["is", "nope"])


@pytest.mark.parametrize(("options", "told"), [
    ({"seed": -1}, r"seed must be 0 .. 2\^32 - 1, got -1"), ({"resamples": -1}, "resamples must be 1 or more, got -1"),
    ({"resamples": 0}, "resamples must be 1 or more, got 0"),
])  # fmt: skip
def test_a_comparison_refuses_what_no_bootstrap_can_draw(options, told):
    with pytest.raises(UserError, match=told):
        compare(np.arange(4.0), np.arange(4.0), **options)


def test_the_same_policies_are_one_set_whatever_the_seed(case):
    """Also those that draw and do not tell their probabilities: looks at the same episodes are counted by it."""
    draws = [BlackBoxPolicy(lambda seen, rng, p=p: (rng.random(len(seen)) < p).astype(int)) for p in (0.4, 0.5)]
    first, again, other = (OPEInput(case.log, draws[i], seed=seed).policies_digest for i, seed in ((0, 0), (0, 1), (1, 0)))
    assert first == again != other


def test_judged_rows_and_those_that_teach_have_draws_of_their_own():
    log, policy = lqr(-0.5, 0.5, 40, 5), linear(0.0, 0.5)  # which does the same everywhere, but for its draws
    case = OPEInput(log, policy, discount=0.9, held=np.arange(20))
    teach = case.teaching()
    assert np.abs(case.next_actions(2) - teach.next_actions(2)).min() > 0
    np.testing.assert_array_equal(teach.next_actions(2), OPEInput(log, policy, held=np.arange(20)).teaching().next_actions(2))
