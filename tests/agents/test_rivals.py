"""AWR, KL-control, DQfD, REM, AlgaeDICE and FQL against numpy written from their equations, on fixed numbers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from deadreckon.agents import AWR, FQL, IQL, REM, XQL, AlgaeDICE, DQfD, KLControl
from deadreckon.agents.agent import traced_advantage
from deadreckon.agents.rem import simplex
from deadreckon.data.batch import Batch
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import q_values
from deadreckon.policies.candidates import OneStep
from deadreckon.policies.kinds import stochastic
from deadreckon.randomness import key_for, keys
from tests.agents.test_actor_critics import log_prob, q, transitions
from tests.agents.test_bear import numpy_gaussian
from tests.agents.test_offline import KEY, SMALL, SPEC, both_likelihoods, least_q, logged_log_prob, made, updated
from tests.nets.test_mlp import numpy_mlp

K_RESIDUAL = key_for(KEY, "residual")  # of AlgaeDICE's critics


@pytest.fixture(scope="module")
def batch():
    first = jnp.asarray([[0.5], [-0.2], [0.1], [0.7], [-0.9], [0.0]])
    return transitions()._replace(initial_observation=first)


def future(batch, value):
    return np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * value


# ---- AWR


def windows():
    """Two windows of three rows: the first is cut by a terminal after two rows, the second goes on beyond its end."""
    rng = np.random.default_rng(3)
    return Batch(
        observation=jnp.asarray(rng.normal(size=(2, 3, 1)), jnp.float32), reward=jnp.asarray(rng.normal(size=(2, 3))),
        action=jnp.asarray(rng.uniform(-0.9, 0.9, (2, 3, 1))), terminal=jnp.asarray([[0.0, 1, 0], [0, 0, 0]]),
        time=jnp.asarray([[0.0, 1, 2], [7, 8, 9]]),
        next_observation=jnp.asarray(rng.normal(size=(2, 3, 1)), jnp.float32), mask=jnp.asarray([[1.0, 1, 0], [1, 1, 1]]),
    )  # fmt: skip


def test_traced_advantages_are_discounted_sums_that_end_where_rows_do():
    error, goes_on = jnp.asarray([1.0, 2.0, 4.0, 8.0])[:, None], jnp.asarray([1.0, 0.0, 1.0, 0.0])[:, None]
    np.testing.assert_allclose(traced_advantage(error, goes_on, 0.5)[:, 0], [2.0, 2.0, 8.0, 8.0])


def test_awr_returns_are_td_lambda_within_episode_and_window():
    rows = windows()
    agent, state = made(AWR(discount=0.9, td_lambda=0.8, window=3, batch_size=6, **SMALL))
    got, advantage = agent.returns(state.value, rows)
    now, after = (numpy_mlp(state.value, np.asarray(seen))[..., 0] for seen in (rows.observation, rows.next_observation))
    reward = np.asarray(rows.reward)

    def mixed(i, t, later):  # lambda-return from the one of the following row
        return reward[i, t] + 0.9 * (0.2 * after[i, t] + 0.8 * later)

    # Rows of an episode follow each other; here their observations do not, so V(s') stands where the row behind has its own.
    second = reward[0, 1]
    first = reward[0, 0] + 0.9 * after[0, 0] + 0.9 * 0.8 * (second - now[0, 1])
    np.testing.assert_allclose(got[0, :2], [first, second], atol=1e-5)
    last = reward[1, 2] + 0.9 * after[1, 2]
    middle = mixed(1, 1, last) + 0.9 * 0.8 * (after[1, 1] - now[1, 2])
    np.testing.assert_allclose(got[1, 1:], [middle, last], atol=1e-5)
    np.testing.assert_allclose(advantage, np.asarray(got) - now, atol=1e-5)


@pytest.mark.slow
@both_likelihoods
def test_awr_imitates_by_standardised_advantages_of_the_rows_that_are_there(likelihood):
    rows = windows()
    agent = AWR(temperature=0.5, max_weight=3.0, window=3, batch_size=6, likelihood=likelihood, action_std=0.3, **SMALL)
    agent, state = made(agent)
    after, metrics = updated(agent, state, rows)
    if likelihood == "normal":  # its deviation is not learned
        np.testing.assert_array_equal(after.actor.log_std, np.log(np.float32(0.3)))
    there = np.asarray(rows.mask, bool)
    # The first row of an episode is in one window, the second in two, all later ones in three.
    share = np.array([1.0, 1 / 2, 1 / 3, 1 / 3, 1 / 3])
    mean = lambda of: (share * of).sum() / share.sum()  # noqa: E731
    target, _ = agent.returns(state.value, rows)
    error = (numpy_mlp(state.value, np.asarray(rows.observation))[..., 0] - np.asarray(target))[there]
    np.testing.assert_allclose(metrics["value_loss"], mean(np.square(error)), rtol=1e-4)
    advantage = np.asarray(agent.returns(after.value, rows)[1])[there]
    away = advantage - mean(advantage)
    weight = np.minimum(np.exp(away / (np.sqrt(mean(away**2)) + 1e-5) / 0.5), 3.0)
    assert (weight == 3.0).any()
    expected = -mean(weight * logged_log_prob(state.actor, rows)[there])
    np.testing.assert_allclose(metrics["actor_loss"], expected, rtol=1e-3)
    np.testing.assert_allclose(metrics["weight"], mean(weight), rtol=1e-4)


@pytest.mark.slow
def test_awr_learns_nothing_from_a_batch_without_rows():
    rows = windows()
    agent, state = made(AWR(window=3, batch_size=6, **SMALL))
    after, metrics = updated(agent, state, rows._replace(mask=jnp.zeros((2, 3))))
    assert float(metrics["value_loss"]) == 0.0
    for a, b in zip(jax.tree.leaves(after.actor), jax.tree.leaves(state.actor), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


# ---- KL-control


both_models = pytest.mark.parametrize("likelihood", ["truncated_normal", "tanh_normal"])


@pytest.mark.slow
@both_models
def test_kl_control_pays_for_its_divergence_in_targets_and_actor(batch, likelihood):
    agent, state = made(KLControl(discount=0.9, temperature=0.4, likelihood=likelihood, **SMALL))
    noise = np.asarray(jax.random.normal(KEY, (6, 1)))

    def parts(observation, critics):
        mean, log_std = numpy_gaussian(state.actor, observation)
        pre = mean + np.exp(log_std) * noise
        model = logged_log_prob(state.model, Batch(observation=observation, action=np.tanh(pre)))
        if likelihood == "truncated_normal":
            center, std = np.tanh(numpy_mlp(state.model.net, np.asarray(observation))), np.exp(np.asarray(state.model.log_std))
            below = scipy.stats.norm.cdf(np.array([-1.0, 1.0])[:, None, None], center, std)
            assert (below[1] - below[0]).max() < 0.9
            model = model - np.log(below[1] - below[0]).sum(-1)
        away = log_prob(mean, log_std, pre) - model
        return least_q(critics, observation, np.tanh(pre)), away

    value, away = parts(batch.next_observation, state.target_critics)
    assert np.abs(away).max() > 1e-2
    np.testing.assert_allclose(agent.target(state, batch, KEY), future(batch, value - 0.4 * away), atol=1e-4)
    value, away = parts(batch.observation, state.critics)
    loss, mean = agent.actor_loss(state.actor, state, batch, KEY)
    np.testing.assert_allclose(loss, (0.4 * away - value).mean(), atol=1e-4)
    np.testing.assert_allclose(mean, away.mean(), atol=1e-4)


@pytest.mark.slow
def test_kl_control_pays_more_where_it_is_too_far_away(batch):
    for target_kl, more in ((30.0, False), (0.0, True)):
        agent, state = made(KLControl(target_kl=target_kl, temperature=0.4, **SMALL))
        moved = eqx.tree_at(lambda net: net.biases[-1], state.actor, state.actor.biases[-1] + jnp.asarray([4.0, 0.0]))
        state = state._replace(actor=moved)
        after, metrics = updated(agent, state, batch)
        assert 0.0 < float(metrics["divergence"]) < 30.0
        assert bool(after.log_temperature > state.log_temperature) == more


def test_kl_control_may_pay_in_the_actor_alone_and_be_changed_when_resolved(batch):
    agent, state = made(KLControl(discount=0.9, entropy_backup=False, **SMALL))
    mean, log_std = numpy_gaussian(state.actor, batch.next_observation)
    action = np.tanh(mean + np.exp(log_std) * np.asarray(jax.random.normal(KEY, (6, 1))))
    expected = future(batch, least_q(state.target_critics, batch.next_observation, action))
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-4)
    assert agent.replace(target_kl=2.0).resolve(SPEC, 10).entropy_target == -2.0


def test_kl_control_has_no_entropy_to_hold():
    with pytest.raises(UserError, match="set target_kl and leave out target_entropy"):
        KLControl(target_entropy=-3.0, **SMALL).resolve(SPEC, 10)


@pytest.mark.slow
@both_models
def test_kl_control_begins_as_the_model_of_the_log_that_it_is_held_to(likelihood):
    agent, state = made(KLControl(behavior_steps=30, behavior_lr=0.01, likelihood=likelihood, **SMALL))
    asked = []

    def fit(learner, steps, key):
        asked.append((learner.hidden, learner.batch_size, learner.lr, steps))
        return learner.init(SPEC, key)

    state = agent.prepare(state, None, KEY, fit)
    assert asked == [((16, 16), 256, 0.01, 30)]
    seen = jnp.linspace(-1.0, 1.0, 5)[:, None]
    mean = stochastic(state.model).actions(seen, KEY, greedy=True)
    np.testing.assert_allclose(agent.policy(state).actions(seen, KEY, greedy=True), mean, rtol=1e-6)
    if likelihood == "truncated_normal":
        log_std = dist.gaussian_head(state.actor(seen)).log_std
        np.testing.assert_allclose(log_std, np.tile(state.model.log_std, (5, 1)), atol=1e-6)
        return
    for a, b in zip(jax.tree.leaves(state.actor), jax.tree.leaves(state.model), strict=True):
        np.testing.assert_array_equal(a, b)


# ---- DQfD


@pytest.mark.slow
def test_dqfd_wants_the_logged_action_above_all_others_by_a_margin(batch):
    agent, state = made(DQfD(margin=0.3, margin_weight=0.7, samples=4, discount=0.9, **SMALL))
    uniform = np.asarray(jax.random.uniform(KEY, (4, 6, 1), minval=-1.0, maxval=1.0))
    others = [np.tanh(numpy_mlp(state.actor, np.asarray(batch.observation))), *uniform]
    target = np.asarray(agent.target(state, batch, KEY))
    expected = 0.0
    for j in range(2):
        logged = q(state.critics, j, batch.observation, batch.action)
        best = np.max([q(state.critics, j, batch.observation, a) for a in others], 0)
        missed = np.maximum(best + 0.3, logged) - logged
        expected += ((logged - target) ** 2).mean() + 0.7 * missed.mean()
    loss, _ = agent.critic_loss(state.critics, state, batch, jnp.asarray(target), KEY)
    np.testing.assert_allclose(loss, expected, rtol=1e-4)


def test_dqfd_asks_for_nothing_where_the_margin_is_kept(batch):
    agent, state = made(DQfD(margin=0.0, samples=3, **SMALL))
    flat = jax.tree.map(jnp.zeros_like, state.critics)  # all actions are worth the same
    np.testing.assert_array_equal(agent.missed(flat, state.actor, batch, KEY), np.zeros((2, 6)))


# ---- REM


def test_rem_asks_one_random_mixture_to_agree_with_its_own_target(batch):
    agent, state = made(REM(heads=3, discount=0.9, policy_noise=0.0, **SMALL))
    weight = np.asarray(simplex(key_for(KEY, "weights"), 3))

    def heads(critic, observation, action):
        return numpy_mlp(critic, np.concatenate([observation, action], -1))

    action = np.tanh(numpy_mlp(state.target_actor, batch.next_observation))
    expected = future(batch, heads(state.target_critics, batch.next_observation, action) @ weight)
    weights, target = agent.target(state, batch, KEY)
    np.testing.assert_allclose(weights, weight)
    np.testing.assert_allclose(target, expected, atol=1e-5)
    now = heads(state.critics, batch.observation, batch.action)
    loss, _ = agent.critic_loss(state.critics, state, batch, (weights, target), KEY)
    np.testing.assert_allclose(loss, np.square(now @ weight - expected).mean(), rtol=1e-3)
    np.testing.assert_allclose(agent.q_value(state, batch.observation, batch.action), now.mean(1), atol=1e-5)
    own = np.tanh(numpy_mlp(state.actor, batch.observation))
    loss = agent.actor_loss(state.actor, state, batch)
    np.testing.assert_allclose(loss, -heads(state.critics, batch.observation, own).mean(), atol=1e-5)


def test_rem_mixes_on_the_simplex():
    weights = jax.vmap(lambda key: simplex(key, 4))(jax.random.split(KEY, 200))
    np.testing.assert_allclose(weights.sum(1), 1.0, rtol=1e-5)
    assert float(weights.min()) >= 0.0
    np.testing.assert_allclose(weights.mean(0), 0.25, atol=0.03)


# ---- AlgaeDICE


def algae(batch, state, temperature, key):
    """Residuals of both critics and their values at the first observations."""
    k_residual, k_first = keys(key, "residual", "first")
    mean, log_std = numpy_gaussian(state.actor, batch.next_observation)
    pre = mean + np.exp(log_std) * np.asarray(jax.random.normal(k_residual, (6, 1)))
    action = np.tanh(pre)
    old = least_q(state.target_critics, batch.next_observation, action)
    paid = temperature * log_prob(mean, log_std, pre)
    deltas = [
        future(batch, 0.95 * old + 0.05 * q(state.critics, j, batch.next_observation, action) - paid)
        - q(state.critics, j, batch.observation, batch.action)
        for j in range(2)
    ]
    mean, log_std = numpy_gaussian(state.actor, batch.initial_observation)
    action = np.tanh(mean + np.exp(log_std) * np.asarray(jax.random.normal(k_first, (6, 1))))
    return np.stack(deltas), np.stack([q(state.critics, j, batch.initial_observation, action) for j in range(2)])


@pytest.mark.slow
def test_algae_dice_is_a_saddle_point_of_residuals_and_first_values(batch):
    agent, state = made(AlgaeDICE(discount=0.9, temperature=0.3, regularisation=2.0, exponent=1.5, **SMALL))
    state = state._replace(target_critics=jax.tree.map(lambda leaf: 1.1 * leaf, state.critics))
    deltas, first = algae(batch, state, 0.3, KEY)
    assert (deltas > 0).any()
    assert (deltas < 0).any()
    expected = np.abs(deltas) ** 1.5 / 1.5 + 0.1 * 2.0 * first
    loss, _ = agent.critic_loss(state.critics, state, batch, None, KEY)
    np.testing.assert_allclose(loss, expected.mean(1).sum(), rtol=1e-3)
    loss, _ = agent.actor_loss(state.actor, state, batch, KEY)
    expected = np.maximum(deltas, 0) ** 0.5 * deltas + 0.1 * 2.0 * first
    np.testing.assert_allclose(loss, -expected.mean(), rtol=1e-3)


@pytest.mark.slow
def test_algae_dice_critics_are_moved_through_both_ends_of_the_equation(batch):
    agent, state = made(AlgaeDICE(discount=0.9, exponent=2.0, regularisation=0.0, **SMALL))
    residual = lambda critics: agent.residual(critics, state.actor, state, batch, K_RESIDUAL)[0]  # noqa: E731
    value = lambda critics: q_values(critics, batch.observation, batch.action)  # noqa: E731

    def one_end(critics):  # as if what follows did not depend on them
        return residual(state.critics) + value(state.critics) - value(critics)

    def slope(delta):
        return jax.grad(lambda critics: 0.5 * jnp.square(delta(critics)).mean(-1).sum())(state.critics).biases[-1]

    found = jax.grad(lambda critics: agent.critic_loss(critics, state, batch, None, KEY)[0])(state.critics).biases[-1]
    np.testing.assert_allclose(found, slope(residual), atol=1e-5)
    assert np.abs(found - slope(one_end)).min() > 1e-3


# ---- FQL


@pytest.mark.slow
def test_fql_flow_is_fitted_on_straight_lines_from_noise(batch):
    agent, state = made(FQL(**SMALL))
    k_noise, k_time = keys(KEY, "noise", "time")
    noise, time = np.asarray(jax.random.normal(k_noise, (6, 1))), np.asarray(jax.random.uniform(k_time, (6, 1)))
    action = np.asarray(batch.action)
    field = numpy_mlp(state.flow, np.concatenate([batch.observation, (1 - time) * noise + time * action, time], -1))
    np.testing.assert_allclose(agent.flow_loss(state.flow, batch, KEY), np.square(field - (action - noise)).mean(), rtol=1e-3)


def test_fql_follows_a_constant_field_to_its_end():
    agent, state = made(FQL(flow_steps=4, **SMALL))
    still = jax.tree.map(jnp.zeros_like, state.flow)
    flow = type(still)(still.weights, (*still.biases[:-1], jnp.asarray([0.4])), still.activation)
    end = agent.followed(flow, jnp.zeros((3, 1)), jnp.asarray([[-0.2], [0.1], [0.9]]))
    np.testing.assert_allclose(end[:, 0], [0.2, 0.5, 1.0], atol=1e-6)


@pytest.mark.slow
def test_fql_actor_and_targets(batch):
    agent, state = made(FQL(discount=0.9, alpha=3.0, flow_steps=5, scale_q=True, **SMALL))
    noise = np.asarray(jax.random.normal(KEY, (6, 1)))
    action = np.clip(numpy_mlp(state.actor, np.concatenate([batch.next_observation, noise], -1)), -1, 1)
    value = np.mean([q(state.target_critics, j, batch.next_observation, action) for j in range(2)], 0)
    np.testing.assert_allclose(agent.target(state, batch, KEY), future(batch, value), atol=1e-4)
    there = noise
    for i in range(5):
        field = numpy_mlp(state.flow, np.concatenate([batch.observation, there, np.full((6, 1), i / 5)], -1))
        there = there + field / 5
    made_ = numpy_mlp(state.actor, np.concatenate([batch.observation, noise], -1))
    away = np.square(made_ - np.clip(there, -1, 1)).mean()
    value = np.mean([q(state.critics, j, batch.observation, np.clip(made_, -1, 1)) for j in range(2)], 0)
    loss, distance = agent.actor_loss(state.actor, state, batch, KEY)
    np.testing.assert_allclose(distance, away, rtol=1e-3)
    np.testing.assert_allclose(loss, 3.0 * away - value.mean() / np.abs(value).mean(), rtol=1e-3)


def test_fqls_targets_take_the_mean_of_the_critics_or_the_smaller(batch):
    for target_q, of in (("mean", np.mean), ("min", np.min)):
        agent, state = made(FQL(discount=0.9, target_q=target_q, **SMALL))
        noise = np.asarray(jax.random.normal(KEY, batch.action.shape))
        joined = np.concatenate([np.asarray(batch.next_observation), noise], -1)
        action = np.clip(numpy_mlp(state.actor, joined), -1, 1)
        values = np.stack([q(state.target_critics, j, batch.next_observation, action) for j in range(2)])
        np.testing.assert_allclose(agent.target(state, batch, KEY), future(batch, of(values, 0)), atol=1e-4)


@pytest.mark.slow
def test_fql_acts_from_the_middle_of_the_noise_when_it_is_greedy():
    _, state = made(FQL(**SMALL))
    policy = OneStep(state.actor)
    seen = jnp.linspace(-1.0, 1.0, 5)[:, None]
    expected = numpy_mlp(state.actor, np.concatenate([seen, np.zeros((5, 1))], -1))
    act = jax.jit(lambda greedy: policy.pre_actions(seen, KEY, greedy=greedy, count=(7,)), static_argnums=0)
    found = act(True)
    np.testing.assert_allclose(np.tanh(found), np.broadcast_to(np.clip(expected, -1, 1), (7, 5, 1)), atol=1e-5)
    assert float(act(False).std(0).min()) > 0


def test_xql_refuses_an_expectile_which_it_has_no_use_for():
    with pytest.raises(UserError, match="XQL has no expectile but loss_temperature; leave it out, got 0.9"):
        XQL(expectile=0.9).resolve(SPEC, 10)
    assert XQL().resolve(SPEC, 10).expectile == IQL().expectile
