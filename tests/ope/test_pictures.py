"""Policies on pictures are judged by what their encoders make of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.nets.encoder import Encoder
from deadreckon.nets.mlp import MLP
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.fqe import FQE
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.support import support
from deadreckon.policies.deployed import EnvPolicy, Seeing
from deadreckon.policies.kinds import Deterministic, TanhGaussian
from deadreckon.policies.policy import BlackBoxPolicy

SHAPE = (16, 16, 3)
RNG = np.random.default_rng(0)


def policy_of(seed, action, spread=None, encoder=None):
    """Acts alike everywhere: by the bias of its last layer alone."""
    encoder = encoder or Encoder.create("patches", SHAPE, 8, jax.random.key(seed))
    net = MLP.create(8, (4,), 1 if spread is None else 2, jax.random.key(seed))
    last = jnp.array([np.arctanh(action)] + ([] if spread is None else [np.log(spread)]), jnp.float32)
    net = MLP((net.weights[0], net.weights[1] * 0.0), (net.biases[0], last))
    inner = Deterministic(net) if spread is None else TanhGaussian(net)
    member = EnvPolicy(inner, None, None, jnp.array([-2.0]), jnp.array([2.0]))
    return EnvPolicy(Seeing(encoder, member), None, None, None, None)


def log_of(episodes=80, length=5):
    """The reward is the action; pictures say the step, and nothing else follows from them."""
    rows = episodes * length
    step = np.arange(rows) % length
    pictures = (RNG.integers(0, 20, (rows, *SHAPE)) + 40 * step[:, None, None, None]).astype(np.uint8)
    actions = RNG.uniform(-2, 2, (rows, 1)).astype(np.float32)
    return Dataset.from_arrays(
        observations=pictures, actions=actions, rewards=actions[:, 0], terminals=step == length - 1,
        action_space=Box((-2.0,), (2.0,)), name="steps",
    )  # fmt: skip


LOG = log_of()
LONG = log_of(200)


@pytest.mark.slow
def test_each_policy_acts_on_the_features_of_its_own_encoder():
    one, other = policy_of(1, 0.5), policy_of(2, -0.5)
    same = policy_of(3, 0.0, encoder=one.inner.encoder)
    case = OPEInput(LOG, [one, other, same])
    assert case.log.spec.observation_shape == (16,)  # two encoders
    np.testing.assert_allclose(case.log.observations[:, :8], one.inner.encoder(LOG.observations), atol=1e-5)
    np.testing.assert_allclose(case.log.observations[:, 8:], other.inner.encoder(LOG.observations), atol=1e-5)
    np.testing.assert_allclose(case.log.final_observations[:, 8:], other.inner.encoder(LOG.final_observations), atol=1e-5)
    np.testing.assert_array_equal(case.log.episode_ids, LOG.episode_ids)
    np.testing.assert_allclose(case.initial_actions(1)[:, :, 0, 0], np.tile([0.5, -0.5, 0.0], (80, 1)), atol=1e-5)


def test_actions_are_those_that_the_whole_policies_take():
    made = []
    for seed in (1, 2):
        net = MLP.create(8, (16,), 1, jax.random.key(seed))
        member = EnvPolicy(Deterministic(net), None, None, jnp.array([-2.0]), jnp.array([2.0]))
        made.append(EnvPolicy(Seeing(policy_of(seed, 0.0).inner.encoder, member), None, None, None, None))
    case = OPEInput(LOG, made)
    for i, policy in enumerate(made):
        np.testing.assert_allclose(2.0 * case.current_actions(1)[:, i, 0], policy(LOG.observations), atol=1e-5)
    assert np.abs(made[0](LOG.observations) - made[1](LOG.observations)).max() > 0.05


@pytest.mark.slow
def test_values_are_those_of_the_actions():
    """Five steps that pay 1 and -0.5 each, in the log's units 2 x 0.5 and 2 x -0.25."""
    case = OPEInput(LONG, [policy_of(1, 0.5), policy_of(2, -0.25)], discount=0.9)
    found = LinearFQE().on(case)
    np.testing.assert_allclose(found.value, np.array([1.0, -0.5]) * (1 - 0.9**5) / 0.1, atol=0.3)


@pytest.mark.slow
def test_networks_of_values_take_features():
    case = OPEInput(LOG, [policy_of(1, 0.5), policy_of(2, -0.25)], discount=0.9)
    found = FQE(steps=3_000, hidden=(64,), members=2, lr=1e-3).on(case)
    np.testing.assert_allclose(found.value, np.array([1.0, -0.5]) * (1 - 0.9**5) / 0.1, atol=0.6)


@pytest.mark.slow
def test_densities_are_those_of_the_policy():
    policy = policy_of(1, 0.5, spread=0.3)
    case = OPEInput(LOG, [policy], greedy=False)
    expected = policy.log_prob(LOG.observations[:20], LOG.actions[:20])
    np.testing.assert_allclose(case.actor.log_probs(case.data.observations[:20], LOG.actions[:20])[0], expected, atol=1e-5)
    assert support(case, BehaviorModel(steps=300)).missing.shape == (1,)


def test_what_is_refused():
    with pytest.raises(UserError, match="policy 1 has no encoder: estimators evaluate policies with image observations"):
        OPEInput(LOG, [policy_of(1, 0.5), BlackBoxPolicy(lambda seen, rng: np.zeros((len(seen), 1)))])
    larger = policy_of(1, 0.5, encoder=Encoder.create("patches", (20, 16, 3), 8, jax.random.key(0)))
    with pytest.raises(UserError, match=r"mine takes images of shape \(20, 16, 3\), steps has \(16, 16, 3\)"):
        OPEInput(LOG, [larger], names=["mine"])
