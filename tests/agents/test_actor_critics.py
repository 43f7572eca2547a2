"""TD3, TD3+BC and SAC against numpy written from their equations, on fixed numbers."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import AWR, BRAC, MBPO, SAC, SACN, TD3, TD3BC, KLControl
from deadreckon.data.batch import Batch
from deadreckon.data.spec import Discrete
from deadreckon.randomness import keys
from tests.agents.compiled import Compiled
from tests.agents.test_bear import lane, numpy_gaussian
from tests.agents.worlds import corridor
from tests.nets.test_mlp import numpy_mlp

SPEC = corridor().spec
KEY = jax.random.key(5)


def transitions():
    rng = np.random.default_rng(0)
    return Batch(
        observation=jnp.asarray(rng.normal(size=(6, 1)), jnp.float32), action=jnp.asarray(rng.uniform(-0.9, 0.9, (6, 1))),
        reward=jnp.asarray(rng.normal(size=6)), next_observation=jnp.asarray(rng.normal(size=(6, 1)), jnp.float32),
        terminal=jnp.asarray([0.0, 1.0, 0.0, 0.0, 1.0, 0.0]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def batch():
    return transitions()


def q(critics, j, observation, action):
    return numpy_mlp(lane(critics, j), np.concatenate([observation, action], -1))[:, 0]


def log_prob(mean, log_std, pre):
    normal = -0.5 * ((pre - mean) / np.exp(log_std)) ** 2 - log_std - 0.5 * np.log(2 * np.pi)
    return (normal - np.log(1 - np.tanh(pre) ** 2)).sum(-1)


def test_td3_target_is_smoothed_clipped_masked_and_the_smaller(batch):
    agent = Compiled(TD3(hidden=(16, 16), discount=0.9, policy_noise=1.0, noise_clip=0.3).resolve(SPEC, 10))
    state = agent.init(SPEC, jax.random.key(0))
    noise = np.clip(np.asarray(jax.random.normal(KEY, (6, 1))), -0.3, 0.3)
    assert (noise.min(), noise.max()) == (np.float32(-0.3), np.float32(0.3))  # clipped on both sides
    action = np.clip(np.tanh(numpy_mlp(state.target_actor, np.asarray(batch.next_observation))) + noise, -1, 1)
    least = np.minimum(*(q(state.target_critics, j, batch.next_observation, action) for j in range(2)))
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * least
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)


def test_td3_actor_follows_the_first_critic_and_moves_every_other_update(batch):
    agent = Compiled(TD3(hidden=(16, 16), actor_lr=0.1, tau=0.5).resolve(SPEC, 10))
    state = agent.init(SPEC, jax.random.key(0))
    action = np.tanh(numpy_mlp(state.actor, np.asarray(batch.observation)))
    loss = agent.actor_loss(state.actor, state, batch)
    np.testing.assert_allclose(loss, -q(state.critics, 0, batch.observation, action).mean(), atol=1e-5)
    update = jax.jit(lambda s, step: agent.update(s, batch, step=step, key=KEY))
    even, _ = update(state, jnp.int32(0))
    odd, metrics = update(state, jnp.int32(1))
    assert not np.array_equal(even.actor.weights[0], state.actor.weights[0])
    moved = (state.target_critics, even.critics, even.target_critics), (state.target_actor, even.actor, even.target_actor)
    for before, online, after in moved:  # towards what the networks have become in this update
        expected = 0.5 * (np.asarray(before.weights[0]) + np.asarray(online.weights[0]))
        np.testing.assert_allclose(after.weights[0], expected, rtol=1e-5, atol=1e-7)
    assert float(metrics["actor_loss"]) == 0.0
    np.testing.assert_array_equal(odd.actor.weights[0], state.actor.weights[0])
    np.testing.assert_array_equal(odd.target_critics.weights[0], state.target_critics.weights[0])
    assert not np.array_equal(odd.critics.weights[0], state.critics.weights[0])


def test_td3_bc_weight_has_no_gradient(batch):
    agent = Compiled(TD3BC(hidden=(16, 16), alpha=2.5).resolve(SPEC, 10))
    state = agent.init(SPEC, jax.random.key(0))
    action = np.tanh(numpy_mlp(state.actor, np.asarray(batch.observation)))
    values = q(state.critics, 0, batch.observation, action)
    weight = 2.5 / np.abs(values).mean()
    expected = -weight * values.mean() + ((action - np.asarray(batch.action)) ** 2).mean()
    np.testing.assert_allclose(agent.actor_loss(state.actor, state, batch), expected, rtol=1e-4)

    def fixed_weight(actor):
        a = jnp.tanh(actor(batch.observation))
        net = lane(state.critics, 0)
        value = net(jnp.concatenate([batch.observation, a], -1))[:, 0]
        return -float(weight) * value.mean() + jnp.square(a - batch.action).mean()

    got = jax.jit(jax.grad(lambda actor: agent.actor_loss(actor, state, batch)))(state.actor)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(jax.jit(jax.grad(fixed_weight))(state.actor)), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=1e-5)
    assert agent.needs(SPEC).standardise


def test_sac_target_and_actor_loss(batch):
    agent = Compiled(SAC(hidden=(16, 16), discount=0.9, temperature=0.3).resolve(SPEC, 10))
    assert agent.target_entropy == -1.0
    state = agent.init(SPEC, jax.random.key(0))
    noise = np.asarray(jax.random.normal(KEY, (6, 1)))
    mean, log_std = numpy_gaussian(state.actor, batch.next_observation)
    pre = mean + np.exp(log_std) * noise
    least = np.minimum(*(q(state.target_critics, j, batch.next_observation, np.tanh(pre)) for j in range(2)))
    soft = least - 0.3 * log_prob(mean, log_std, pre)
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * soft
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)
    mean, log_std = numpy_gaussian(state.actor, batch.observation)
    pre = mean + np.exp(log_std) * noise
    least = np.minimum(*(q(state.critics, j, batch.observation, np.tanh(pre)) for j in range(2)))
    loss, mean_log_prob = agent.actor_loss(state.actor, state, batch, KEY)
    np.testing.assert_allclose(mean_log_prob, log_prob(mean, log_std, pre).mean(), rtol=1e-4)
    np.testing.assert_allclose(loss, (0.3 * log_prob(mean, log_std, pre) - least).mean(), rtol=1e-4)


def test_sac_draws_of_targets_and_actor_have_keys_of_their_own(batch):
    agent = Compiled(SAC(hidden=(4,)).resolve(SPEC, 10))
    state = agent.init(SPEC, jax.random.key(0))
    new, metrics = jax.jit(lambda s: agent.update(s, batch, step=jnp.int32(0), key=KEY))(state)
    first, second = keys(KEY, "target", "actor_loss")
    critic_loss = agent.critic_loss(state.critics, state, batch, agent.target(state, batch, first), KEY)[1]["critic_loss"]
    np.testing.assert_allclose(metrics["critic_loss"], critic_loss, rtol=1e-5)
    of_actor = [float(agent.actor_loss(state.actor, state._replace(critics=new.critics), batch, k)[0]) for k in (first, second)]
    assert float(metrics["actor_loss"]) == pytest.approx(of_actor[1], rel=1e-5)
    assert abs(of_actor[0] - of_actor[1]) > 1e-3


@pytest.mark.parametrize(("target", "rises"), [(-50.0, False), pytest.param(50.0, True, marks=pytest.mark.slow)])
def test_sac_temperature_falls_when_the_policy_is_more_random_than_asked(batch, target, rises):
    agent = SAC(hidden=(16, 16), target_entropy=target).resolve(SPEC, 10)
    state = agent.init(SPEC, jax.random.key(0))
    after, _ = jax.jit(lambda s: agent.update(s, batch, step=jnp.int32(0), key=KEY))(state)
    assert (float(after.log_temperature) > float(state.log_temperature)) is rises


@pytest.mark.slow
def test_sac_n_steps_temperature_then_actor_then_critics(batch):
    """Each step by what those before it have become, as in the public code."""
    agent = Compiled(SACN(hidden=(16, 16), critics=3, actor_lr=0.01, critic_lr=0.01, temperature_lr=0.1).resolve(SPEC, 10))
    state = agent.init(SPEC, jax.random.key(0))
    k_target, k_critics, k_entropy, k_actor = keys(KEY, "target", "critic_loss", "entropy", "actor_loss")
    after, metrics = jax.jit(lambda s: agent.update(s, batch, step=jnp.int32(0), key=KEY))(state)

    @jax.jit
    def by_hand(state):
        first = agent.update_temperature(state, agent.actor_loss(state.actor, state, batch, k_entropy)[1])
        second, loss, _ = agent.update_actor(first, batch, jnp.int32(0), k_actor)  # the critics have not moved
        return first, loss, agent.target(second, batch, k_target)  # by the new actor

    first, loss, target = by_hand(state)
    assert float(first.log_temperature) != float(state.log_temperature)
    np.testing.assert_allclose(after.log_temperature, first.log_temperature, rtol=1e-6)
    np.testing.assert_allclose(metrics["actor_loss"], loss, rtol=1e-5)
    errors = [(q(state.critics, j, batch.observation, batch.action) - np.asarray(target)) ** 2 for j in range(3)]
    np.testing.assert_allclose(metrics["critic_loss"], np.mean(errors), rtol=1e-3)
    rate = agent.tau
    for a, b, c in zip(after.target_critics.weights, state.critics.weights, after.critics.weights, strict=True):
        np.testing.assert_allclose(a, (1 - rate) * b + rate * c, rtol=1e-4, atol=1e-6)


def biases(net):
    return np.concatenate([np.ravel(bias) for bias in net.biases])


@pytest.mark.parametrize("kind", [SAC, AWR, BRAC])
def test_first_weights_by_glorots_rule_have_no_biases(kind):
    both = kind(hidden=(8, 8)), kind(hidden=(8, 8), first_weights="glorot")
    plain, asked = (agent.resolve(SPEC, 10).init(SPEC, KEY) for agent in both)
    nets = ["actor", "value"] if kind is AWR else ["actor", "critics"]
    net_of = lambda state, name: getattr(getattr(state, name), "net", getattr(state, name))  # noqa: E731
    for name in nets:
        last = kind is AWR and name == "actor"  # within 0.01, biases too
        assert np.abs(biases(net_of(plain, name))).max() > 0.02
        assert np.abs(biases(net_of(asked, name))).max() <= (0.01 if last else 0.0)
        assert not last or 0.0 < np.abs(net_of(asked, name).weights[-1]).max() <= 0.01


@pytest.mark.parametrize(("asked", "least", "most"), [("uniform", 0.02, 1.0), ("glorot", 0.0, 0.0)])
def test_first_weights_of_a_clone_are_those_of_the_agent(asked, least, most):
    """BRAC's behaviour model, as which its actor begins, is a clone of the log."""
    agent = BRAC(hidden=(8, 8), behavior_steps=3, first_weights=asked).resolve(SPEC, 10)
    begun = lambda clone, steps, key: clone.init(SPEC, key)  # noqa: E731 - as if it learned nothing
    state = agent.prepare(agent.init(SPEC, KEY), None, KEY, begun)
    for net in (state.behavior, state.actor):
        assert least <= np.abs(biases(net)).max() <= most


@pytest.mark.parametrize("kind", [BRAC, KLControl])
@pytest.mark.parametrize("standardise", [False, True])
def test_a_clone_learns_from_what_its_agent_sees(kind, standardise):
    agent = kind(hidden=(8,), behavior_steps=3, standardise=standardise).resolve(SPEC, 10)
    asked = []
    begun = lambda clone, steps, key: (asked.append(clone.needs(SPEC)), clone.init(SPEC, key))[1]  # noqa: E731
    agent.prepare(agent.init(SPEC, KEY), None, KEY, begun)
    assert [needs.standardise for needs in asked] == [standardise]


def test_first_weights_of_discrete_actions_are_those_asked_for():
    spec = dataclasses.replace(SPEC, action=Discrete(3))
    plain, asked = (SAC(hidden=(8, 8), first_weights=each).resolve(spec, 10).init(spec, KEY) for each in ("uniform", "glorot"))
    assert np.abs(biases(plain.actor.net)).max() > 0.02
    assert np.abs(biases(asked.actor.net)).max() == 0.0


def test_first_weights_of_mbpos_model_are_its_own():
    agent = MBPO(hidden=(8, 8), model_hidden=(8,), model_weight_decay=(0.0, 0.0), rollout_length=(1, 1, 1, 2), retain_steps=1)
    plain, asked = (agent.replace(**fields).model.create(SPEC, KEY)["nets"]
                    for fields in ({}, {"model_first_weights": "truncated_normal"}))  # fmt: skip
    assert np.abs(biases(plain)).max() > 0.02
    assert (biases(asked) == 0.0).all()
    assert np.abs(asked.weights[0]).max() <= 1.0 / np.sqrt(asked.weights[0].shape[-2])
