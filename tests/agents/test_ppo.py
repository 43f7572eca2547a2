"""PPO: moments, advantages and losses against numpy; whose rows it learns from; a run that goes on where it stopped."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import PPO
from deadreckon.agents.on_policy import Moments, folded
from deadreckon.data.batch import Batch
from deadreckon.data.spec import Box, Spec
from deadreckon.online import Online
from deadreckon.online.on_policy import OnPolicy
from deadreckon.tasks import task
from deadreckon.training.fit import Fit
from tests.agents.compiled import Compiled, begun
from tests.agents.resumed import whole_and_resumed

SPEC = Spec.empty((3,), Box((-1.0, -1.0), (1.0, 1.0)), "nowhere")
AGENT = Compiled(PPO(hidden=(8,), batch_size=16, discount=0.9, gae_lambda=0.8).resolve(SPEC, 10))
LIKELIHOOD = jax.jit(lambda state, *given: AGENT.policy(state).log_prob(*given))


@pytest.fixture(scope="module")
def fresh():
    return begun(AGENT, SPEC)


def block(seed=0, steps=6, copies=2):
    rng = np.random.default_rng(seed)
    seen = rng.standard_normal((steps + 1, copies, 3)).astype(np.float32)
    terminal, timeout = np.zeros((2, steps, copies), np.float32)
    terminal[2, 0], timeout[3, 1] = 1.0, 1.0
    return {
        "observation": seen[:-1], "action": rng.uniform(-0.9, 0.9, (steps, copies, 2)).astype(np.float32),
        "reward": rng.standard_normal((steps, copies)).astype(np.float32), "next_observation": seen[1:],
        "terminal": terminal, "timeout": timeout,
    }  # fmt: skip


def test_moments_are_those_of_all_rows(fresh):
    rng = np.random.default_rng(0)
    parts = [3.0 + rng.standard_normal((n, 3)) for n in (5, 1, 40)]
    seen, seeing = Moments.none(3), jax.jit(Moments.seeing)
    for part in parts:
        seen = seeing(seen, part)
    whole = np.concatenate(parts)
    np.testing.assert_allclose(seen.mean, whole.mean(0), rtol=1e-5)
    np.testing.assert_allclose(seen.variance, whole.var(0), rtol=1e-4)
    both = jax.jit(lambda net, seen, x: (folded(net, seen)(x), net((x - seen.mean) / seen.deviation)))
    np.testing.assert_allclose(*both(fresh.actor, seen, whole), rtol=1e-3, atol=1e-5)


def test_advantages_are_the_sums_by_hand(fresh):
    state = AGENT.observing(fresh, block(1)["observation"].reshape(-1, 3))
    rows = block()
    value = lambda seen: np.asarray(AGENT.value(state, seen))  # noqa: E731
    now, following = value(rows["observation"]), value(rows["next_observation"])
    wanted = np.zeros_like(now)
    for copy in range(2):
        later = 0.0
        for t in reversed(range(6)):
            end, cut = rows["terminal"][t, copy], rows["timeout"][t, copy]
            error = rows["reward"][t, copy] + (0.0 if end else 0.9 * following[t, copy]) - now[t, copy]
            later = error + (0.0 if end or cut else 0.9 * 0.8 * later)
            wanted[t, copy] = later
    new, columns = jax.jit(AGENT.digest)(state, rows)
    np.testing.assert_allclose(columns["advantage"], wanted, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(columns["return_to_go"], wanted + now, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(new.returns.mean, (wanted + now).mean(), rtol=1e-4)
    told = LIKELIHOOD(state, rows["observation"], rows["action"])
    np.testing.assert_allclose(columns["behavior_log_prob"], told, rtol=1e-5)
    np.testing.assert_array_equal(new.observations.mean, state.observations.mean)


def test_what_is_gained_beyond_the_clip_counts_no_more(fresh):
    rng = np.random.default_rng(2)
    seen, action = jnp.asarray(rng.standard_normal((16, 3))), jnp.asarray(rng.uniform(-0.9, 0.9, (16, 2)))
    log_ratio, advantage = rng.uniform(-0.6, 0.6, 16), rng.standard_normal(16)
    own = np.asarray(LIKELIHOOD(fresh, seen, action))
    batch = Batch(observation=seen, action=action, behavior_log_prob=jnp.asarray(own - log_ratio),
                  return_to_go=jnp.asarray(rng.standard_normal(16)), extra={"advantage": jnp.asarray(advantage)})  # fmt: skip
    _, metrics = AGENT.loss((fresh.actor, fresh.critic), fresh, batch, jax.random.key(1))
    gain, ratio = (advantage - advantage.mean()) / advantage.std(), np.exp(log_ratio)
    wanted = -np.where(gain > 0, np.minimum(ratio, 1.2), np.maximum(ratio, 0.8)) * gain
    np.testing.assert_allclose(metrics["actor_loss"], wanted.mean(), rtol=1e-3)
    np.testing.assert_allclose(metrics["clipped"], (np.abs(ratio - 1) > 0.2).mean(), rtol=1e-6)
    np.testing.assert_allclose(metrics["kl"], (ratio - 1 - log_ratio).mean(), rtol=1e-3)
    error = np.asarray(AGENT.value(fresh, seen)) - np.asarray(batch.return_to_go)
    np.testing.assert_allclose(metrics["critic_loss"], (error**2).mean(), rtol=1e-4)


SETTINGS = Online(copies=2, explore=30, updates_per_step=0.25, block=20)
PENDULUM = task("inverted-pendulum")


@pytest.mark.slow
def test_it_learns_from_the_last_block_alone():
    updates = SETTINGS.updates(110)
    agent = PPO(hidden=(8,), batch_size=16).resolve(Spec.empty((4,), PENDULUM.action_space, PENDULUM.name), updates)
    experience = OnPolicy(PENDULUM, agent, [0], updates, SETTINGS, threads=1)
    job = Fit([agent], experience, [0], updates, 5)
    walk = job.chunks()
    next(walk)
    roots, seen = job.roots, float(job.states.observations.number[0])
    assert seen == 30  # the random steps
    states, data = experience.extend(job.learner, job.states, roots, 5)
    assert float(states.observations.number[0]) == 50
    assert experience.environment_steps == 70
    rows = np.asarray(data["packed"][0])
    assert rows.shape == (20, 4 + 1 + 3) == (experience.count, rows.shape[1])
    last = np.asarray(experience.replay.buffer[0, 50:70])
    np.testing.assert_array_equal(rows[:, :5], last[:, :5])
    policy = agent.policy(jax.tree.map(lambda leaf: leaf[0], states))
    np.testing.assert_allclose(rows[:, 5], policy.log_prob(last[:, :4], last[:, 4:5]), rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_a_run_goes_on_where_it_stopped(tmp_path):
    whole, again = whole_and_resumed(PPO(hidden=(8,), batch_size=16), SETTINGS, tmp_path, 70, 110, 10)
    seen = np.ones((1, 4), np.float32)
    np.testing.assert_array_equal(whole.policy(seen), again.policy(seen))
    assert set(whole.metrics.to_pydict()) >= {"actor_loss", "critic_loss", "entropy", "kl", "clipped"}
