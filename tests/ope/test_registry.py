"""Estimators by name, and the sizes that a machine without a GPU takes."""

import dataclasses

import pytest

from deadreckon.cli.fits import Fits, estimators
from deadreckon.errors import UserError
from deadreckon.ope.registry import CPU_BUDGET, ESTIMATORS, estimator, titled


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_budget_of_a_cpu_changes_fields_that_are_there(name):
    """Fields that this one has not would be passed over in silence."""
    found = estimator(name, **CPU_BUDGET.get(name, {}))
    for field, value in CPU_BUDGET.get(name, {}).items():
        own = vars(found)[field]
        assert (own if not isinstance(value, dict) else {inner: vars(own)[inner] for inner in value}) == value
    fitted = "steps" in {field.name for each in (found, getattr(found, "fqe", found)) for field in dataclasses.fields(each)}
    assert (name in CPU_BUDGET) == fitted


def test_a_label_tells_the_name_that_was_asked_for():
    labels = {name: estimator(name).label for name in ESTIMATORS}
    assert len(set(labels.values())) == len(labels)
    shown = [titled(labels[name]) for name in ("is", "dr", "plain-dr", "fqe", "vpm")]
    assert shown == ["is (WPDIS)", "dr (WDR)", "plain-dr (DR)", "fqe (FQE-L2)", "VPM"]
    assert titled("mine") == "mine"  # a function's


def test_what_is_asked_for_goes_before_the_budget():
    distributional, doubly = estimators("fqe-d, dr", Fits(members=2), CPU_BUDGET)
    assert (distributional.steps, distributional.members) == (5_000, 2)
    assert (doubly.fqe.steps, doubly.fqe.members) == (20_000, 2)


def test_a_field_that_nobody_has_is_refused():
    with pytest.raises(UserError, match="unknown field of estimators 'stepz'"):
        estimator("fqe", stepz=5)
    assert estimator("is", hidden=(8,), atoms=5).model.hidden == (8,)  # others have atoms


def test_the_behaviour_model_is_the_same_for_all():
    """It is fitted once for a case, so sizes of other fits must not reach it."""
    doubly = estimator("dr", **CPU_BUDGET["dr"])
    assert doubly.fqe == estimator("fqe", **CPU_BUDGET["fqe"])
    assert doubly.model == estimator("is", **CPU_BUDGET.get("is", {})).model
    assert estimator("dr", steps=7).model == estimator("is", steps=7).model
