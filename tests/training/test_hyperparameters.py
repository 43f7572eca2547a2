"""Ranges of hyperparameters stand at their fields: of every agent, designer and estimator."""

import dataclasses
import math
import typing

import jax
import numpy as np
import pytest

from deadreckon.agents import AGENTS, agent_class
from deadreckon.errors import UserError
from deadreckon.mbo import DESIGNERS, designer
from deadreckon.ope import BehaviorModel
from deadreckon.ope.registry import ESTIMATORS, estimator
from deadreckon.training.hyperparameters import Range, check_fields, range_of

MADE = {
    **{f"agent {name}": agent_class(name) for name in AGENTS},
    **{f"designer {name}": type(designer(name)) for name in DESIGNERS},
    **{f"estimator {name}": type(estimator(name)) for name in ESTIMATORS},
    "behaviour model": BehaviorModel,
}
# Numbers of any sign.
FREE = {
    "kappa", "log_ratio_range", "min_gap", "min_target", "multiplier_max", "multiplier_min", "return_range", "reward_shift",
    "target_entropy", "target_return", "threshold", "v_max", "v_min",
}  # fmt: skip


def numbers(kind):
    """Fields that hold a number or several, with their range."""
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        plain = [each for each in (hints[field.name], *typing.get_args(hints[field.name])) if each in (int, float)]
        parts = [part for each in typing.get_args(hints[field.name]) for part in typing.get_args(each) if part in (int, float)]
        if plain or parts:
            yield field.name, range_of(kind, field.name)


@pytest.mark.parametrize("name", MADE)
def test_every_number_has_a_range(name):
    bare = [field for field, range_ in numbers(MADE[name]) if range_ is None or range_ == Range()]
    assert set(bare) <= FREE


@pytest.mark.parametrize("name", MADE)
def test_defaults_lie_within_and_what_lies_beyond_is_refused(name):
    made = MADE[name]()
    check_fields(made)
    for field, range_ in numbers(MADE[name]):
        default = getattr(made, field)
        for beyond in () if range_ is None else outside(range_):
            wrong = (beyond,) if isinstance(default, tuple) else beyond
            with pytest.raises(UserError, match=rf"{type(made).__name__}\.{field} takes "):
                check_fields(type(made)(**{field: wrong}))


def test_flags_are_true_or_false_and_no_words():
    for name in MADE:
        made = MADE[name]()
        for field in (field for field, hint in typing.get_type_hints(MADE[name]).items() if hint is bool):
            for wrong in ("false", "no", 0):
                with pytest.raises(UserError, match=rf"{type(made).__name__}\.{field} takes true or false, got {wrong!r}"):
                    check_fields(type(made)(**{field: wrong}))


def outside(range_):
    """Numbers that a range leaves out, whole ones where its ends are, so that they are wrong for no other reason."""
    if math.isfinite(range_.ge):
        yield int(range_.ge) - 1
    if math.isfinite(range_.gt):
        yield int(range_.gt)
    if math.isfinite(range_.le):
        yield int(range_.le) + 1
    if math.isfinite(range_.lt):
        yield int(range_.lt)


def test_ranges_in_words():
    assert str(Range(ge=0, lt=1)) == ">= 0 and < 1"
    assert str(Range(gt=0)) == "> 0"
    assert str(Range()) == ""
    assert 0.0 in Range(ge=0)
    assert 0.0 not in Range(gt=0)
    assert np.inf not in Range(lt=1)


def test_what_the_host_alone_reads_shapes_no_program_and_cannot_be_used_in_one():
    from deadreckon.ope.fqe import FQE
    from deadreckon.training.learner import lift

    few, many = (lift([FQE(steps=steps, initial_samples=steps)]) for steps in (3, 5))
    assert jax.tree.structure(few) == jax.tree.structure(many)
    assert jax.tree.structure(few) != jax.tree.structure(lift([FQE(steps=3, hidden=(8,))]))
    with pytest.raises(TypeError):
        _ = few.steps + 1


def test_settings_are_the_keywords_of_the_functions():
    from deadreckon.ope import settings as ope
    from deadreckon.runs import settings as s

    pairs = (
        (s.TrainSettings, s.TrainOptions), (s.OnlineSettings, s.OnlineOptions), (s.JudgeSettings, s.JudgeOptions),
        (s.RecommendSettings, s.RecommendOptions), (s.ReturnSettings, s.ReturnOptions), (ope.FitSettings, ope.FitOptions),
        (ope.EstimateSettings, ope.EstimateOptions), (ope.DecisionSettings, ope.DecisionOptions),
    )  # fmt: skip
    for kind, keywords in pairs:
        assert typing.get_type_hints(kind) == typing.get_type_hints(keywords)
    with pytest.raises(UserError, match="unknown setting 'evaluate_evry': did you mean evaluate_every"):
        s.TrainSettings.of({"evaluate_evry": 3})
