"""The Decision Transformer: attention against numpy, who sees what, acting as trained, and the return that is asked for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import softmax

from deadreckon.agents import DecisionTransformer
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.nets.optim import clip_by_norm
from deadreckon.nets.transformer import Block, Transformer, dropped
from deadreckon.policies import EnvPolicy
from deadreckon.training.fit import fit
from tests.agents.worlds import corridor
from tests.nets.test_mlp import numpy_mlp

SPEC = corridor().spec
KEY = jax.random.key(3)
TINY = {"context_length": 4, "layers": 2, "heads": 2, "hidden": (8,)}


def made(**fields):
    agent = DecisionTransformer(**TINY | fields).resolve(SPEC, 10)
    return agent, agent.init(SPEC, jax.random.key(0))


def windows(steps=4):
    rng = np.random.default_rng(1)
    draw = lambda *shape: jnp.asarray(rng.normal(size=shape), jnp.float32)  # noqa: E731
    return draw(2, steps), draw(2, steps, 1), jnp.tanh(draw(2, steps, 1)), jnp.arange(steps) * jnp.ones((2, 1))


@pytest.mark.slow
def test_a_block_against_numpy():
    block = Block.create(6, 2, jax.random.key(1))
    x = np.random.default_rng(0).normal(size=(2, 3, 6)).astype(np.float32)
    seen = np.array([[True, False, False], [True, True, False], [False, True, True]])
    standard = lambda v: (v - v.mean(-1, keepdims=True)) / np.sqrt(v.var(-1, keepdims=True) + 1e-6)  # noqa: E731
    parts = numpy_mlp(block.attend, standard(x)).reshape(2, 3, 3, 2, 3)
    found = np.zeros((2, 3, 2, 3))
    for b in range(2):
        for h in range(2):
            query, key, value = (parts[b, :, i, h] for i in range(3))
            weight = softmax(np.where(seen, query @ key.T / np.sqrt(3), -np.inf), -1)
            found[b, :, h] = weight @ value
    expected = x + numpy_mlp(block.merge, found.reshape(2, 3, 6))
    expected = expected + numpy_mlp(block.feed, standard(expected))
    got = jax.jit(lambda x, seen: block(x, seen, lambda part, _: part))(x, np.tile(seen, (2, 1, 1)))
    np.testing.assert_allclose(got, expected, atol=1e-5)


@pytest.mark.slow
def test_no_token_looks_ahead_or_at_what_is_not_there():
    net = eqx.filter_jit(Transformer.create(2, 8, 2, jax.random.key(1)))
    x = jax.random.normal(KEY, (1, 5, 8))
    there = jnp.asarray([[True, True, True, False, True]])
    out = net(x, there)
    later = net(x.at[0, 4].multiply(-2.0), there)
    np.testing.assert_array_equal(out[0, :4], later[0, :4])
    absent = net(x.at[0, 3].multiply(-2.0), there)
    np.testing.assert_array_equal(out[0, [0, 1, 2, 4]], absent[0, [0, 1, 2, 4]])
    assert np.abs(out[0, 4] - net(x.at[0, 1].multiply(-2.0), there)[0, 4]).max() > 1e-4


def test_dropping_keeps_the_mean_and_nothing_is_dropped_without_a_key():
    x = jnp.ones((200, 200))
    out = dropped(x, 0.3, KEY)
    np.testing.assert_allclose((out == 0).mean(), 0.3, atol=0.01)
    np.testing.assert_allclose(out.mean(), 1.0, atol=0.02)
    assert dropped(x, 0.3, None) is x


def test_gradients_are_made_shorter_together():
    grads = {"a": jnp.asarray([3.0]), "b": jnp.asarray([4.0])}
    np.testing.assert_allclose(clip_by_norm(grads, 1.0)["b"], [0.8], rtol=1e-5)
    np.testing.assert_allclose(clip_by_norm(grads, 10.0)["b"], [4.0], rtol=1e-5)


@pytest.mark.slow
def test_an_action_sees_its_return_and_observation_and_all_before_but_not_itself():
    _, state = made()
    wanted, observation, action, time = windows()
    net = jax.jit(lambda w, o, a: state.net(w, o, a, time, jnp.ones((2, 4)))[:, 2])
    out = net(wanted, observation, action)
    assert (np.abs(out) < 1).all()
    for changed in (net(wanted.at[:, 3].add(1.0), observation, action), net(wanted, observation, action.at[:, 2:].add(0.5))):
        np.testing.assert_array_equal(out, changed)
    for i in (1, 2):
        assert np.abs(out - net(wanted.at[:, i].add(1.0), observation, action)).max() > 1e-4
        assert np.abs(out - net(wanted, observation.at[:, i].add(1.0), action)).max() > 1e-4
    assert np.abs(out - net(wanted, observation, action.at[:, 1].add(0.5))).max() > 1e-4


@pytest.mark.slow
def test_the_loss_is_of_the_steps_that_are_there():
    agent, state = made(dropout=0.0)
    wanted, observation, action, time = windows()
    mask = jnp.asarray([[1.0, 1, 0, 0], [1, 1, 1, 1]])
    batch = Batch(observation=observation, action=action, return_to_go=5.0 * wanted, time=time, mask=mask)
    found = np.asarray(eqx.filter_jit(state.net)(wanted, observation, action, time, mask))
    expected = np.square(found - np.asarray(action))[np.asarray(mask, bool)].mean()
    loss = eqx.filter_jit(agent.loss)(state.net, jnp.asarray(5.0), batch, KEY)
    np.testing.assert_allclose(loss, expected, rtol=1e-4)


@pytest.mark.slow
def test_it_acts_as_it_was_trained_with_what_is_left_of_the_return():
    """Step by step in two environments, the second of which begins anew; beyond the window the oldest step is forgotten."""
    agent, state = made()
    policy = agent.policy(state._replace(best=jnp.asarray(10.0), worst=jnp.asarray(2.0), scale=jnp.asarray(4.0)))
    rng = np.random.default_rng(2)
    seen, reward = rng.normal(size=(6, 2, 1)).astype(np.float32), rng.normal(size=(6, 2)).astype(np.float32)
    first = np.zeros((6, 2), bool)
    first[0] = first[3, 1] = True
    carry, done = policy.start(2), []
    act = jax.jit(lambda step, carry: policy.act(step, carry, KEY, greedy=True))
    for t in range(6):
        step = Step(jnp.asarray(seen[t]), jnp.asarray(reward[t]), jnp.asarray(first[t]))
        action, carry = act(step, carry)
        done.append(np.asarray(action))
    for env, begin in ((0, 0), (1, 3)):
        left = (10.0 - np.concatenate([[0.0], np.cumsum(reward[begin + 1 :, env])])) / 4.0
        k = min(4, 6 - begin)
        last = slice(6 - k, 6)
        acted = np.stack([d[env] for d in done])[last]
        time = np.arange(6 - begin)[-k:]
        alone = eqx.filter_jit(state.net)(
            jnp.asarray(left[-k:])[None], jnp.asarray(seen[last, env])[None], jnp.asarray(acted)[None], jnp.asarray(time)[None],
            jnp.ones((1, k)),
        )  # fmt: skip
        np.testing.assert_allclose(alone[0, -1], done[-1][env], atol=1e-5)


def two_ways(episodes=200, length=8):
    """Episodes that do 0.8 all along, or -0.8, and are paid what they do."""
    rng = np.random.default_rng(0)
    way = np.where(rng.uniform(size=episodes) < 0.5, 0.8, -0.8)
    actions = np.repeat(way, length)[:, None] + 0.05 * rng.normal(size=(episodes * length, 1))
    ends = np.tile(np.arange(length) == length - 1, episodes)
    return Dataset.from_arrays(
        observations=rng.normal(size=(episodes * length, 1)), actions=actions, rewards=actions[:, 0], terminals=ends,
        action_space=SPEC.action,
    )  # fmt: skip


@pytest.mark.slow
def test_does_what_brought_the_return_that_is_asked_for():
    log = two_ways()
    agent = DecisionTransformer(**TINY | {"hidden": (16,)}, lr=3e-3, warmup_steps=50, batch_size=32).resolve(log.spec, 600)
    rows = TransitionSource(log, agent.needs(log.spec))
    state = fit([agent], rows, [0], 600, chunk=200).lane(0)
    np.testing.assert_allclose([state.best, state.worst], [log.returns().max(), log.returns().min()], rtol=1e-5)
    seen = np.linspace(-1, 1, 5, dtype=np.float32)[:, None]
    for ask, way in ((1.0, 0.8), (0.0, -0.8)):
        policy = EnvPolicy.of(agent.replace(target_return=ask).policy(state), rows.view)
        np.testing.assert_allclose(policy(seen), way, atol=0.25)


def test_takes_one_width_for_all_heads():
    with pytest.raises(UserError, match=r"hidden takes one width, a multiple of heads \(3\), got \(128,\)"):
        DecisionTransformer(heads=3).resolve(SPEC, 10)
    for fields, words in (({"heads": 0}, "heads takes a whole number >= 1, got 0"), ({"hidden": 128}, "hidden takes a tuple")):
        with pytest.raises(UserError, match=f"DecisionTransformer.{words}"):
            DecisionTransformer(**fields).resolve(SPEC, 10)
