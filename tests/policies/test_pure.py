"""Policies as functions of arrays do what the policies do, or are refused in one line."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.history import history_size
from deadreckon.data.spec import Discrete, Spec
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.nets.encoder import Encoder
from deadreckon.nets.mlp import MLP
from deadreckon.policies.candidates import GreedyActions, ThresholdedPolicy
from deadreckon.policies.deployed import EnvPolicy, History, Mixture, Seeing
from deadreckon.policies.kinds import Categorical, Deterministic
from deadreckon.policies.planner import Planner
from deadreckon.policies.policy import KINDS
from deadreckon.policies.pure import MEMBER, REFUSED, pure
from deadreckon.policies.sequence import DecisionTransformerPolicy
from tests.policies.test_policies import DRAWING, make

KEY = jax.random.key(5)
CHOICE = Categorical(MLP.create(3, (4,), 4, KEY))
OTHER = Categorical(MLP.create(3, (4,), 4, jax.random.key(6)))
DISCRETE = {
    "choice": CHOICE,
    "best": GreedyActions(MLP.create(3, (4,), 4, KEY)),
    "best of the likely": ThresholdedPolicy(MLP.create(3, (4,), 4, KEY), CHOICE, jnp.asarray(0.5)),
}


def of(name):
    return EnvPolicy(DISCRETE[name], None, None, None, None) if name in DISCRETE else make(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["deterministic", "normalised", *DRAWING, *DISCRETE])
def test_it_does_what_the_policy_does(name):
    policy, x = of(name), np.random.default_rng(0).normal(size=(16, 3)).astype("f4")
    found = pure(policy)
    outputs = found.call(jnp.asarray(x))
    assert len(outputs) == len(found.outputs)
    np.testing.assert_allclose(outputs[0], policy(x), atol=1e-6)
    assert (outputs[0].dtype == jnp.int32) == (name in DISCRETE)
    if name == "choice":
        np.testing.assert_allclose(outputs[1], policy.action_probs(x), atol=1e-6)


def test_each_member_of_a_mixture_acts_in_its_rows():
    members = [EnvPolicy(inner, None, None, None, None) for inner in (CHOICE, OTHER)]
    x = np.random.default_rng(1).normal(size=(40, 3)).astype("f4")
    which = np.arange(40) % 2
    found = pure(Mixture.of(members))
    assert (found.inputs, found.members) == (("observation", MEMBER), 2)
    actions, chances = map(np.asarray, jax.jit(found.call)(x, which.astype(np.int32)))
    for i, member in enumerate(members):
        np.testing.assert_array_equal(actions[which == i], member(x[which == i]))
        np.testing.assert_allclose(chances[which == i], member.action_probs(x[which == i]), atol=1e-6)


@pytest.mark.slow
def test_a_history_is_what_its_policy_sees():
    spec = Spec.empty((3,), Discrete(4), "any")
    size = history_size(3, 4, 2)
    policy = History.of(EnvPolicy(Categorical(MLP.create(size, (4,), 4, KEY)), None, None, None, None), 2, spec)
    found = pure(policy)
    assert found.history == 2
    x = np.random.default_rng(2).normal(size=(5, 3)).astype("f4")
    step = Step(jnp.asarray(x), jnp.zeros(5), jnp.ones(5, bool))
    action, (history, _) = policy.act(step, policy.start(5), KEY, greedy=True)
    np.testing.assert_array_equal(found.call(history)[0], action)


@pytest.mark.parametrize("kind", REFUSED)
def test_what_needs_more_than_its_observations_is_refused_in_one_line(kind):
    policy = EnvPolicy(object.__new__(kind), None, None, None, None)
    with pytest.raises(UserError, match=f"policies of the kind {kind.__name__} .*: they cannot be exported"):
        pure(policy)
    assert kind in (Planner, DecisionTransformerPolicy)


def test_every_kind_that_the_package_has_is_exported_or_refused():
    known = {
        "Deterministic", "TanhGaussian", "Gaussian", "ClippedGaussian", "TanhMeanGaussian", "VAEDecoder", "PerturbedPolicy",
        "OneStep", "GreedyQ", "Categorical", "GreedyActions", "ThresholdedPolicy", "Mixture", "History",
        "Seeing", "UnboundedDeterministic",
    }  # fmt: skip
    abstract = {"Sampler"}
    ours = {name for name, kind in KINDS.items() if kind.__module__.startswith("deadreckon.")}
    assert ours == known | abstract | {kind.__name__ for kind in REFUSED}


def test_pictures_go_in_as_numbers():
    encoder = Encoder.create("patches", (16, 16, 3), 8, jax.random.key(0))
    member = EnvPolicy(Deterministic(MLP.create(8, (4,), 2, jax.random.key(1))), None, None, None, None)
    policy = EnvPolicy(Seeing(encoder, member), None, None, None, None)
    pictures = np.random.default_rng(0).integers(0, 256, (5, 16, 16, 3)).astype(np.uint8)
    found = pure(policy)
    assert (found.inputs, found.outputs) == (("observation",), ("action",))
    np.testing.assert_allclose(jax.jit(found.call)(pictures.astype(np.float32))[0], policy(pictures), atol=1e-6)
