"""Estimators by name, and the sizes that a machine without a GPU takes."""

import dataclasses

import pytest

from deadreckon.cli.ope import Fits, _estimators
from deadreckon.ope.registry import CPU_BUDGET, ESTIMATORS, estimator


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_budget_of_a_cpu_changes_fields_that_are_there(name):
    """Fields that nobody has would be passed over in silence."""
    found = estimator(name, **CPU_BUDGET.get(name, {}))
    own = vars(found) | vars(getattr(found, "fqe", found))
    assert {field: own[field] for field in CPU_BUDGET.get(name, {})} == CPU_BUDGET.get(name, {})
    fitted = "steps" in {field.name for field in dataclasses.fields(found)} or hasattr(found, "fqe")
    assert (name in CPU_BUDGET) == fitted


def test_what_is_asked_for_goes_before_the_budget():
    distributional, doubly = _estimators("fqe-d, dr", Fits(members=2), CPU_BUDGET)
    assert (distributional.steps, distributional.members) == (10_000, 2)
    assert (doubly.fqe.steps, doubly.fqe.members) == (20_000, 2)
