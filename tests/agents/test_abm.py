"""ABM against numpy written from the paper's equations, on fixed numbers; what it learns is in the conformance tests."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp, softmax

from deadreckon.agents import ABM
from deadreckon.errors import UserError
from deadreckon.randomness import keys
from tests.agents.compiled import Compiled, begun, moved
from tests.agents.test_actor_critics import q
from tests.agents.test_offline import KEY, SMALL, SPEC, drawn_actions, logged_log_prob, made, updated
from tests.agents.test_rivals import windows

K_VALUE, K_PRIOR = keys(KEY, "value", "prior")
FIELDS = {"discount": 0.9, "window": 3, "batch_size": 6, "samples": 4, "epsilon": 0.2, "eta": 0.5, **SMALL}
# What a row counts for: the last of the first window is of another episode; the first row of an episode is in one window, the
# second in two, all later ones in three.
ROWS = np.array([[1.0, 1 / 2, 0], [1 / 3, 1 / 3, 1 / 3]]) / (2.5 / 6)


@pytest.fixture(scope="module")
def learner():
    agent = ABM(**FIELDS).resolve(SPEC, 10)
    return Compiled(agent), moved(begun(agent, SPEC), ("actor", "prior", "critic", "target_actor", "target_critic"))


def flat(seen):
    return np.asarray(seen, np.float64).reshape(-1, 1)


def of_both(state):
    """V(s) and V(s'): a state between two rows has one value."""
    rows = windows()
    seen = np.concatenate([np.asarray(rows.observation)[:, :1], rows.next_observation], 1)
    drawn = drawn_actions(state.target_actor, flat(seen), jax.random.normal(K_VALUE, (4, 8, 1)))
    found = np.mean([q(state.target_critic, 0, flat(seen), a) for a in drawn], 0).reshape(2, 4)
    return found[:, :-1], found[:, 1:]


def whole_advantages(rows, now, after):
    """R_t - V(s_t), row by row: the first window's episode ends with its second row, by a terminal."""
    r, last = np.asarray(rows.reward), np.asarray(rows.reward)[1, 2] + 0.9 * after[1, 2]
    ended = [r[0, 0] + 0.9 * r[0, 1], r[0, 1], 0.0]
    return np.array([ended, [r[1, 0] + 0.9 * r[1, 1] + 0.81 * last, r[1, 1] + 0.9 * last, last]]) - now


@pytest.mark.slow
def test_values_are_means_over_draws_of_the_target_policy_by_the_target_critic(learner):
    agent, state = learner
    rows = windows()
    now, following = agent.values(state, rows, K_VALUE)
    np.testing.assert_allclose(now, of_both(state)[0], atol=1e-5)
    np.testing.assert_allclose(following, of_both(state)[1], atol=1e-5)
    reward, terminal = np.asarray(rows.reward), np.asarray(rows.terminal)
    np.testing.assert_allclose(agent.target(rows, following), reward + 0.9 * (1 - terminal) * following, atol=1e-5)


def test_advantages_are_of_rewards_to_the_end_of_the_window_or_of_the_episode(learner):
    agent, state = learner
    now, after = map(np.asarray, agent.values(state, windows(), K_VALUE))
    found = np.asarray(agent.advantage(windows(), now, after))
    there = np.asarray(windows().mask, bool)
    np.testing.assert_allclose(found[there], whole_advantages(windows(), now, after)[there], atol=1e-5)


@pytest.mark.parametrize("likelihood", ["normal", pytest.param("tanh_normal", marks=pytest.mark.slow)])
def test_one_update_by_hand(learner, likelihood):
    agent, state = learner if likelihood == "normal" else made(ABM(likelihood=likelihood, **FIELDS))
    rows = windows()
    after, metrics = updated(agent, state, rows)
    now, following = of_both(state)
    target = np.asarray(rows.reward) + 0.9 * (1 - np.asarray(rows.terminal)) * following
    own = q(state.critic, 0, flat(rows.observation), flat(rows.action)).reshape(2, 3)
    assert metrics["critic_loss"] == pytest.approx((ROWS * (own - target) ** 2).mean(), rel=1e-4)
    good = whole_advantages(rows, now, following) > 0
    assert 0 < (good & (ROWS > 0)).sum() < 5
    assert metrics["prior_loss"] == pytest.approx(-(ROWS * good * logged_log_prob(state.prior, rows)).mean(), rel=1e-4)
    # The policy imitates the prior's draws, and the temperature follows its dual, by one step of Adam.
    drawn = drawn_actions(state.prior, flat(rows.observation), jax.random.normal(K_PRIOR, (4, 6, 1)))
    values = np.stack([q(state.target_critic, 0, flat(rows.observation), a) for a in drawn])
    weight = softmax(values / 0.5, axis=0) * ROWS.reshape(-1)
    log_probs = [logged_log_prob(state.actor, rows._replace(action=a.reshape(2, 3, 1))).reshape(-1) for a in drawn]
    assert metrics["actor_loss"] == pytest.approx(-(weight * log_probs).sum(0).mean(), rel=1e-3)
    dual = lambda eta: eta * (0.2 + (ROWS.reshape(-1) * (logsumexp(values / eta, axis=0) - np.log(4))).mean())  # noqa: E731
    slope = (dual(0.5 * np.exp(1e-4)) - dual(0.5 * np.exp(-1e-4))) / 2e-4
    assert after.log_eta == pytest.approx(np.log(0.5) - 0.01 * np.sign(slope), abs=1e-4)
    assert any((a != b).any() for a, b in zip(jax.tree.leaves(after.actor), jax.tree.leaves(state.actor)))


def test_the_temperature_minimises_the_dual_where_the_divergence_is_epsilon():
    agent = ABM(**FIELDS | {"epsilon": 0.3})
    rng = np.random.default_rng(0)
    values, rows = rng.normal(size=(200, 50)), np.ones(50)

    def divergence(eta):  # of the weights over the draws from equal weights
        w = softmax(values / eta, axis=0)
        return (w * np.log(w * len(values))).sum(0).mean()

    grid = np.geomspace(0.2, 20, 2000)
    best = min(grid, key=lambda eta: abs(divergence(eta) - 0.3))
    dual = [eta * (0.3 + (logsumexp(values / eta, axis=0) - np.log(200)).mean()) for eta in grid]
    assert grid[np.argmin(dual)] == pytest.approx(best, rel=0.01)
    eta_loss = jax.jit(jax.value_and_grad(agent.eta_loss))
    loss, slope = eta_loss(np.log(best), values, rows)
    assert loss == pytest.approx(min(dual), rel=1e-4)
    assert abs(slope) < 2e-3
    # Rows that are not there count for nothing.
    half = np.r_[np.zeros(25), 2 * np.ones(25)]
    only, _ = eta_loss(np.log(best), values[:, 25:], np.ones(25))
    assert eta_loss(np.log(best), values, half)[0] == pytest.approx(float(only), rel=1e-5)


@pytest.mark.slow
def test_targets_are_copied_at_the_end_of_every_period(learner):
    agent, state = learner
    agent = agent.replace(target_update_period=2)
    rows = windows()
    update = jax.jit(lambda state, step: agent.update(state, rows, step=step, key=KEY)[0])
    first = update(state, jnp.asarray(0))
    second = update(first, jnp.asarray(1))
    for name in ("actor", "critic"):
        for a, b, c, d in zip(*(jax.tree.leaves(getattr(s, n)) for s, n in (
            (first, f"target_{name}"), (state, f"target_{name}"), (second, f"target_{name}"), (second, name),
        )), strict=True):  # fmt: skip
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(c, d)


@pytest.mark.slow
def test_without_a_row_that_is_there_nothing_is_learned():
    agent, state = made(ABM(**FIELDS))
    after, metrics = updated(agent, state, windows()._replace(mask=jnp.zeros((2, 3))))
    assert float(metrics["critic_loss"]) == 0.0
    for name in ("actor", "prior", "critic"):
        for a, b in zip(jax.tree.leaves(getattr(after, name)), jax.tree.leaves(getattr(state, name)), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6)


@pytest.mark.slow
def test_bm_imitates_all_rows():
    agent, state = made(ABM(prior="all", **FIELDS))
    _, metrics = updated(agent, state, windows())
    assert metrics["imitated"] == pytest.approx(1.0)
    assert metrics["prior_loss"] == pytest.approx(-(ROWS * logged_log_prob(state.prior, windows())).mean(), rel=1e-4)


def test_epsilon_is_what_draws_can_diverge_by():
    with pytest.raises(UserError, match=r"epsilon must be below log\(samples\), the largest divergence of 5 draws, 1.61"):
        ABM(samples=5, epsilon=2.0).resolve(SPEC, 10)
