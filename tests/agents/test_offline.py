"""BCQ, BRAC, IQL, XQL, AWAC, CRR, ReBRAC, CQL, SAC-N and EDAC against numpy written from their equations, on fixed numbers."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from scipy.special import logsumexp, softmax

from deadreckon.agents import AWAC, BCQ, BRAC, CQL, CRR, EDAC, IQL, SACN, XQL, ReBRAC
from deadreckon.agents.cql import soft_maximum, weighted_mean
from deadreckon.agents.edac import likeness
from deadreckon.data.batch import Batch
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, ensemble, minimum
from deadreckon.policies.kinds import TanhMeanGaussian
from deadreckon.randomness import key_for, keys
from tests.agents.compiled import Compiled
from tests.agents.test_actor_critics import log_prob, q, transitions
from tests.agents.test_bear import lane, numpy_gaussian
from tests.agents.worlds import corridor
from tests.nets.test_mlp import numpy_mlp

SPEC = corridor().spec
KEY = jax.random.key(5)
SMALL = {"hidden": (16, 16)}


@pytest.fixture(scope="module")
def batch():
    following = jnp.asarray([[0.3], [0.0], [0.0], [0.9], [0.0], [0.0]])
    return transitions()._replace(next_action=following, follows=jnp.asarray([1.0, 0, 1, 1, 0, 0]))


def made(agent):
    agent = agent.resolve(SPEC, 10)
    return Compiled(agent), agent.init(SPEC, jax.random.key(0))


def updated(agent, state, batch):
    return jax.jit(lambda s: agent.update(s, batch, step=jnp.int32(0), key=KEY))(state)


def least_q(critics, observation, action):
    return np.minimum(*(q(critics, j, observation, action) for j in range(2)))


def logged_log_prob(actor, batch):
    """Of the likelihood that the actor was created with."""
    if isinstance(actor, TanhMeanGaussian):
        mean = np.tanh(numpy_mlp(actor.net, np.asarray(batch.observation)))
        return scipy.stats.norm(mean, np.exp(np.asarray(actor.log_std))).logpdf(np.asarray(batch.action)).sum(-1)
    mean, log_std = numpy_gaussian(actor, batch.observation)
    return log_prob(mean, log_std, np.arctanh(np.asarray(batch.action)))


def drawn_actions(actor, observation, noise):
    """What a stochastic actor does with standard normal noise."""
    if isinstance(actor, TanhMeanGaussian):
        mean = np.tanh(numpy_mlp(actor.net, np.asarray(observation)))
        return np.clip(mean + np.exp(np.asarray(actor.log_std)) * np.asarray(noise), -1.0, 1.0)
    mean, log_std = numpy_gaussian(actor, observation)
    return np.tanh(mean + np.exp(log_std) * np.asarray(noise))


both_likelihoods = pytest.mark.parametrize("likelihood", ["normal", "tanh_normal"])


def test_bcq_target_is_the_best_of_perturbed_actions_by_a_mixture(batch):
    agent, state = made(BCQ(discount=0.9, samples=3, max_perturbation=0.4, min_weight=0.7, behavior_hidden=(8,), **SMALL))
    after = np.asarray(batch.next_observation)
    latent = np.clip(np.asarray(jax.random.normal(KEY, (3, 6, 2))), -0.5, 0.5)
    values = []
    for z in latent:
        action = np.tanh(numpy_mlp(state.behavior.decoder, np.concatenate([after, z], -1)))
        move = np.tanh(numpy_mlp(state.target_mover, np.concatenate([after, action], -1)))
        action = np.clip(action + 0.4 * move, -1, 1)
        both = [q(state.target_critics, j, after, action) for j in range(2)]
        values.append(0.7 * np.minimum(*both) + 0.3 * np.maximum(*both))
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * np.max(values, 0)
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)


@pytest.mark.slow
def test_bcq_moves_towards_the_first_critic_and_leaves_the_vae_alone(batch):
    agent, state = made(BCQ(max_perturbation=0.4, behavior_hidden=(8,), **SMALL))
    seen = np.asarray(batch.observation)
    latent = np.clip(np.asarray(jax.random.normal(KEY, (6, 2))), -0.5, 0.5)
    action = np.tanh(numpy_mlp(state.behavior.decoder, np.concatenate([seen, latent], -1)))
    action = np.clip(action + 0.4 * np.tanh(numpy_mlp(state.mover, np.concatenate([seen, action], -1))), -1, 1)
    loss = agent.mover_loss(state.mover, state, batch, KEY)
    np.testing.assert_allclose(loss, -q(state.critics, 0, seen, action).mean(), atol=1e-5)
    slope = jax.grad(lambda vae: agent.mover_loss(state.mover, state._replace(behavior=vae), batch, KEY))(state.behavior)
    assert all((np.asarray(leaf) == 0).all() for leaf in jax.tree.leaves(slope))


def gaussian_kl(p, q):
    (mean, log_std), (other, log_other) = p, q
    ratio = np.exp(2 * (log_std - log_other))
    return (0.5 * (ratio + ((mean - other) / np.exp(log_other)) ** 2 - 1) + log_other - log_std).sum(-1)


@pytest.mark.parametrize("value_penalty", [True, False])
def test_brac_pays_in_the_actor_and_where_it_is_asked_in_targets(batch, value_penalty):
    agent, state = made(BRAC(discount=0.9, penalty=0.6, value_penalty=value_penalty, warm_start=5, **SMALL))
    k_act = key_for(KEY, "act")
    noise = np.asarray(jax.random.normal(k_act, (6, 1)))

    def parts(observation, critics):
        own, model = numpy_gaussian(state.actor, observation), numpy_gaussian(state.behavior, observation)
        action = np.tanh(own[0] + np.exp(own[1]) * noise)
        return least_q(critics, observation, action), gaussian_kl(own, model)

    value, away = parts(batch.next_observation, state.target_critics)
    assert away.max() > 1e-3
    future = value - 0.6 * away if value_penalty else value
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * future
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)
    value, away = parts(batch.observation, state.critics)
    loss, mean = agent.actor_loss(state.actor, state, batch, 5, KEY)
    np.testing.assert_allclose(loss, (0.6 * away - value).mean(), rtol=1e-3)
    np.testing.assert_allclose(mean, away.mean(), rtol=1e-3)
    loss, mean = agent.actor_loss(state.actor, state, batch, 4, KEY)  # the last update of the warm start
    np.testing.assert_allclose(loss, 0.6 * mean, rtol=1e-6)


def test_bracs_warm_start_is_a_part_of_the_run():
    assert [BRAC().resolve(SPEC, steps).warm_start for steps in (1_000, 1_000_000)] == [200, 20_000]
    assert BRAC(warm_start=7).resolve(SPEC, 1_000).warm_start == 7


def test_brac_with_the_mmd_sees_how_far_two_policies_are_apart(batch):
    agent, state = made(BRAC(divergence="mmd", samples=200, bandwidth=1.0, **SMALL))
    d = dist.gaussian_head(state.behavior(batch.observation))
    same = agent.away(d, state.behavior, batch.observation, KEY)
    other = agent.away(d._replace(mean=d.mean + 2.0), state.behavior, batch.observation, KEY)
    assert float(same.max()) < 0.2 < float(other.min())


def test_brac_begins_as_the_model_of_the_log_that_it_is_held_to():
    agent, state = made(BRAC(behavior_steps=30, **SMALL))
    asked = []

    def fit(learner, steps, key):
        asked.append((learner.hidden, learner.batch_size, steps))
        return learner.init(SPEC, key)

    state = agent.prepare(state, None, KEY, fit)
    assert asked == [((16, 16), 256, 30)]
    for a, b in zip(jax.tree.leaves(state.actor), jax.tree.leaves(state.behavior), strict=True):
        np.testing.assert_array_equal(a, b)


@both_likelihoods
def test_iql_losses(batch, likelihood):
    agent, state = made(IQL(expectile=0.8, beta=4.0, max_weight=2.0, likelihood=likelihood, **SMALL))
    target_q = least_q(state.target_critics, batch.observation, batch.action) + np.linspace(-0.5, 0.9, 6)
    gap = target_q - numpy_mlp(state.value, np.asarray(batch.observation))[:, 0]
    assert (gap > 0).any()
    assert (gap < 0).any()
    expected = np.where(gap < 0, 0.2, 0.8) * gap**2
    np.testing.assert_allclose(agent.value_loss(state.value, batch, jnp.asarray(target_q)), expected.mean(), rtol=1e-4)
    weight = np.minimum(np.exp(4 * gap), 2.0)
    expected = -(weight * logged_log_prob(state.actor, batch)).mean()
    np.testing.assert_allclose(agent.actor_loss(state.actor, batch, jnp.asarray(gap)), expected, rtol=1e-3)


@pytest.mark.slow
def test_iql_critics_look_forward_to_the_new_value_but_not_behind_a_terminal(batch):
    agent, state = made(IQL(discount=0.9, **SMALL))
    after, metrics = updated(agent, state, batch)
    future = numpy_mlp(after.value, np.asarray(batch.next_observation))[:, 0]
    target = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * future
    errors = [(q(state.critics, j, batch.observation, batch.action) - target) ** 2 for j in range(2)]
    np.testing.assert_allclose(metrics["critic_loss"], np.mean(errors), rtol=1e-3)
    # The actor by the new values and the critics' targets.
    advantage = least_q(state.target_critics, batch.observation, batch.action)
    advantage = advantage - numpy_mlp(after.value, np.asarray(batch.observation))[:, 0]
    np.testing.assert_allclose(metrics["advantage"], advantage.mean(), rtol=1e-4)
    expected = -(np.exp(3 * advantage) * logged_log_prob(state.actor, batch)).mean()
    np.testing.assert_allclose(metrics["actor_loss"], expected, rtol=1e-3)
    expected = 0.995 * np.asarray(state.target_critics.weights[0]) + 0.005 * np.asarray(after.critics.weights[0])
    np.testing.assert_allclose(after.target_critics.weights[0], expected, rtol=1e-5, atol=1e-7)


@pytest.mark.slow
def test_an_expectile_of_a_half_is_the_mean_and_of_one_nearly_the_greatest():
    """Of one state with three actions, of known worth: what the value loss is least at."""
    worth = jnp.asarray([0.0, 1.0, 4.0])
    one = Batch(observation=jnp.zeros((3, 1)))
    grid = np.linspace(0, 4, 4001)

    def best(agent):
        losses = jax.vmap(lambda v: agent.value_loss(lambda s: jnp.full((3, 1), v), one, worth))(grid)
        return grid[np.argmin(np.asarray(losses))]

    assert best(IQL(expectile=0.5)) == pytest.approx(5 / 3, abs=0.02)
    assert best(IQL(expectile=0.999)) == pytest.approx(4.0, abs=0.02)
    # XQL's, whose scale changes with V, has no slope there: temperature log mean exp(Q / temperature).
    soft = 2 * np.log(np.exp(np.array([0, 1, 4]) / 2).mean())
    slope = jax.grad(lambda v: XQL(loss_temperature=2.0).value_loss(lambda s: jnp.full((3, 1), v), one, worth))
    assert slope(soft) == pytest.approx(0.0, abs=1e-5)
    assert slope(soft - 0.1) < -1e-3
    assert slope(soft + 0.1) > 1e-3


def test_xql_loss_by_hand():
    one = Batch(observation=jnp.zeros((3, 1)))
    z = np.array([-2.0, 0.5, 7.0])  # the last of them cut
    found = XQL(loss_temperature=2.0).value_loss(lambda s: jnp.zeros((3, 1)), one, jnp.asarray([-4.0, 1.0, 99.0]))
    assert found == pytest.approx(((np.exp(z) - z - 1) / np.exp(7)).mean(), rel=1e-4)
    low = XQL(loss_temperature=2.0).value_loss(lambda s: jnp.zeros((3, 1)), one, jnp.asarray([-4.0, -8.0, -6.0]))
    z = np.array([-2.0, -4.0, -3.0])
    assert low == pytest.approx(((np.exp(z) - z - 1) * np.e).mean(), rel=1e-4)


def test_xql_loss_is_finite_however_wrong_a_value_is(batch):
    agent, state = made(XQL(**SMALL))
    far = jnp.full(6, 1e6)
    loss, slope = jax.jit(jax.value_and_grad(agent.value_loss))(state.value, batch, far)
    assert np.isfinite(loss)
    assert all((np.asarray(leaf) == 0).all() for leaf in jax.tree.leaves(slope))


@pytest.mark.slow
@both_likelihoods
def test_awac_target_advantage_and_weights(batch, likelihood):
    agent, state = made(AWAC(discount=0.9, temperature=0.5, max_weight=1.3, samples=3, likelihood=likelihood, **SMALL))
    action = drawn_actions(state.actor, batch.next_observation, jax.random.normal(KEY, (6, 1)))
    future = least_q(state.target_critics, batch.next_observation, action)
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * future
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)
    drawn = drawn_actions(state.actor, batch.observation, jax.random.normal(KEY, (3, 6, 1)))
    own = np.mean([least_q(state.critics, batch.observation, a) for a in drawn], 0)
    advantage = least_q(state.critics, batch.observation, batch.action) - own
    found = agent.advantage(state, batch, KEY)
    np.testing.assert_allclose(found, advantage, atol=1e-5)
    np.testing.assert_allclose(agent.weights(found), np.minimum(np.exp(advantage / 0.5), 1.3), rtol=1e-4)
    np.testing.assert_allclose(agent.weights(jnp.asarray([1e9])), 1.3, rtol=1e-6)


@pytest.mark.slow
def test_crr_counts_what_is_better_or_weighs_it(batch):
    advantage = jnp.asarray([-1.0, 0.0, 0.2, 9.0])
    np.testing.assert_array_equal(CRR().weights(advantage), [0, 0, 1, 1])
    np.testing.assert_allclose(CRR(filter="exp").weights(advantage), [np.exp(-1), 1, np.exp(0.2), 20], rtol=1e-6)
    agent, state = made(CRR(**SMALL))
    k_actor = key_for(KEY, "actor_loss")
    after, metrics = updated(agent, state, batch)
    weight = np.asarray(agent.advantage(state._replace(critics=after.critics), batch, k_actor)) > 0
    np.testing.assert_allclose(metrics["weight"], weight.mean(), rtol=1e-6)
    expected = -(weight * logged_log_prob(state.actor, batch)).mean()
    np.testing.assert_allclose(metrics["actor_loss"], expected, rtol=1e-3)


def normalised_mlp(net, x):
    """With the units behind each activation standardised."""
    for i, (w, b) in enumerate(zip(net.weights, net.biases)):
        if i:
            x = np.maximum(x, 0)
            x = (x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-6)
        x = x @ np.asarray(w) + np.asarray(b)
    return x[:, 0]


@pytest.mark.slow
def test_rebrac_target_and_actor_loss(batch):
    agent, state = made(ReBRAC(discount=0.9, policy_noise=0.0, actor_penalty=0.3, critic_penalty=0.7, **SMALL))
    assert "next_action" in agent.needs(SPEC).columns
    assert float(jnp.abs(state.actor.weights[-1]).max()) <= 1e-3  # it begins close to zero, as in the public code
    grown = dataclasses.replace(state.actor, weights=(*state.actor.weights[:-1], 1e3 * state.actor.weights[-1]))
    state = state._replace(actor=grown, target_actor=grown)

    def least(critics, observation, action):
        joined = np.concatenate([np.asarray(observation), action], -1)
        return np.minimum(*(normalised_mlp(lane(critics, j), joined) for j in range(2)))

    action = np.tanh(numpy_mlp(state.target_actor, np.asarray(batch.next_observation)))
    penalty = ((action - np.asarray(batch.next_action)) ** 2).sum(-1)
    assert penalty[2] > 1e-4  # a logged action of 0
    penalty[[1, 4, 5]] = 0  # nothing is known of what came next
    future = least(state.target_critics, batch.next_observation, action) - 0.7 * penalty
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * future
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)
    action = np.tanh(numpy_mlp(state.actor, np.asarray(batch.observation)))
    values = least(state.critics, batch.observation, action)
    expected = (0.3 * ((action - np.asarray(batch.action)) ** 2).sum(-1) - values / np.abs(values).mean()).mean()
    np.testing.assert_allclose(agent.actor_loss(state.actor, state, batch), expected, rtol=1e-3)


def with_held(state, **changes):
    return state._replace(model=state.model._replace(**changes))


def test_cqls_targets_may_take_the_best_of_several_actions(batch):
    agent, state = made(CQL(discount=0.9, max_target_backup=True, samples=3, **SMALL))
    mean, log_std = numpy_gaussian(state.actor, batch.next_observation)
    drawn = np.tanh(mean + np.exp(log_std) * np.asarray(jax.random.normal(KEY, (3, 6, 1))))
    best = np.max([least_q(state.target_critics, batch.next_observation, action) for action in drawn], 0)
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * best
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)


def test_cqls_difference_has_a_lower_limit_row_by_row(batch):
    agent, state = made(CQL(samples=2, **SMALL))
    high = np.asarray(jax.jit(lambda s: soft_maximum(s.critics, s.actor, batch, 2, KEY))(state))
    gaps = high - np.stack([q(state.critics, j, batch.observation, batch.action) for j in range(2)])
    limit = float(np.median(gaps))
    for least in (-1e9, limit):
        _, metrics = agent.replace(min_gap=least).critic_loss(state.critics, state, batch, jnp.arange(6.0), KEY)
        np.testing.assert_allclose(metrics["gap"], np.maximum(gaps, least).mean(), rtol=1e-4)


def test_cql_penalty(batch):
    agent, state = made(CQL(cql_weight=3.0, samples=2, **SMALL))
    target = jnp.arange(6.0)
    loss, metrics = agent.critic_loss(state.critics, state, batch, target, KEY)
    k_uniform, k_now, k_next = keys(KEY, "uniform", "now", "next")
    uniform = np.asarray(jax.random.uniform(k_uniform, (2, 6, 1), minval=-1.0, maxval=1.0))
    expected = 0.0
    for j in range(2):
        parts = [q(state.critics, j, batch.observation, a) + np.log(2) for a in uniform]
        for k, seen in ((k_now, batch.observation), (k_next, batch.next_observation)):
            mean, log_std = numpy_gaussian(state.actor, seen)
            for noise in np.asarray(jax.random.normal(k, (2, 6, 1))):
                pre = mean + np.exp(log_std) * noise
                parts.append(q(state.critics, j, batch.observation, np.tanh(pre)) - log_prob(mean, log_std, pre))
        logged = q(state.critics, j, batch.observation, batch.action)
        expected += ((logged - np.arange(6)) ** 2).mean() + 3.0 * (logsumexp(parts, 0) - logged).mean()
    np.testing.assert_allclose(loss, expected, rtol=1e-4)
    assert not agent.entropy_backup
    held = Compiled(CQL(cql_weight=1.0, lagrange=True, samples=2, **SMALL))
    twice = held.critic_loss(state.critics, with_held(state, log_weight=jnp.float32(np.log(2.0))), batch, target, KEY)[0]
    once = held.critic_loss(state.critics, with_held(state, log_weight=jnp.float32(0.0)), batch, target, KEY)[0]
    np.testing.assert_allclose(twice - once, 2 * metrics["gap"], rtol=1e-3)  # a difference for each critic


@pytest.mark.slow
def test_cql_rho_holds_down_what_the_policy_likes(batch):
    agent, state = made(CQL(form="rho", cql_weight=3.0, samples=3, **SMALL))
    plain, _ = CQL(form="rho", cql_weight=0.0, samples=3, **SMALL).critic_loss(state.critics, state, batch, jnp.zeros(6), KEY)
    high = weighted_mean(state.critics, state.actor, batch, 3, KEY).mean(-1)
    logged = [q(state.critics, j, batch.observation, batch.action).mean() for j in range(2)]
    loss, _ = agent.critic_loss(state.critics, state, batch, jnp.zeros(6), KEY)
    np.testing.assert_allclose(loss, plain + 3.0 * (high - np.array(logged)).sum(), rtol=1e-4)


@pytest.mark.slow
def test_cql_rho_weighs_the_policys_actions_by_their_worth(batch):
    agent, state = made(CQL(form="rho", samples=3, **SMALL))
    mean, log_std = numpy_gaussian(state.actor, batch.observation)
    drawn = np.tanh(mean + np.exp(log_std) * np.asarray(jax.random.normal(KEY, (3, 6, 1))))
    values = np.stack([q(state.critics, 0, batch.observation, a) for a in drawn])
    expected = (softmax(values, 0) * values).sum(0)
    np.testing.assert_allclose(weighted_mean(state.critics, state.actor, batch, 3, KEY)[0], expected, atol=1e-5)

    def soft(critics):
        first = jax.tree.map(lambda w: w[0], critics)
        each = [first(jnp.concatenate([batch.observation, a], -1))[:, 0] for a in drawn]
        return jax.nn.logsumexp(jnp.stack(each), 0)

    found = jax.jit(jax.grad(lambda c: weighted_mean(c, state.actor, batch, 3, KEY)[0].sum()))(state.critics)
    wanted = jax.jit(jax.grad(lambda c: soft(c).sum()))(state.critics)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):  # the slope of the soft maximum
        np.testing.assert_allclose(a[0], b[0], atol=1e-4)


@pytest.mark.parametrize(("threshold", "rises"), [(0.0, True), (50.0, False)])
def test_cql_multiplier_rises_where_the_difference_is_too_large(batch, threshold, rises):
    agent, state = made(CQL(lagrange=True, threshold=threshold, **SMALL))
    after, metrics = updated(agent, state, batch)
    assert (float(metrics["gap"]) > threshold) is rises
    assert (float(after.model.log_weight) > float(state.model.log_weight)) is rises


@pytest.mark.slow
def test_cql_imitates_before_it_improves(batch):
    agent, state = made(CQL(warm_start=5, temperature=0.4, **SMALL))
    update = jax.jit(lambda s, step: agent.update(s, batch, step=step, key=KEY)[0])
    assert bool(update(state, jnp.int32(4)).model.imitates)
    assert not bool(update(state, jnp.int32(5)).model.imitates)
    noise = np.asarray(jax.random.normal(KEY, (6, 1)))
    mean, log_std = numpy_gaussian(state.actor, batch.observation)
    pre = mean + np.exp(log_std) * noise
    own = log_prob(mean, log_std, pre)
    loss, _ = agent.actor_loss(state.actor, with_held(state, imitates=jnp.asarray(True)), batch, KEY)
    np.testing.assert_allclose(loss, 0.4 * own.mean() - logged_log_prob(state.actor, batch).mean(), rtol=1e-3)
    loss, _ = agent.actor_loss(state.actor, with_held(state, imitates=jnp.asarray(False)), batch, KEY)
    np.testing.assert_allclose(loss, (0.4 * own - least_q(state.critics, batch.observation, np.tanh(pre))).mean(), rtol=1e-3)


@pytest.mark.slow
def test_sac_n_believes_the_least_of_all_its_critics(batch):
    agent, state = made(SACN(critics=5, temperature=1e-20, **SMALL))
    mean, log_std = numpy_gaussian(state.actor, batch.next_observation)
    action = np.tanh(mean + np.exp(log_std) * np.asarray(jax.random.normal(KEY, (6, 1))))
    future = np.min([q(state.target_critics, j, batch.next_observation, action) for j in range(5)], 0)
    expected = np.asarray(batch.reward) + 0.99 * (1 - np.asarray(batch.terminal)) * future
    np.testing.assert_allclose(agent.target(state, batch, KEY), expected, atol=1e-5)
    assert SACN().critics == 10


def test_the_least_of_many_is_that_of_few_with_a_slope_of_one_of_them():
    values = np.random.default_rng(0).normal(size=(300, 7)).astype(np.float32)
    np.testing.assert_array_equal(jax.jit(minimum)(values), values.min(0))
    slope = jax.jit(jax.grad(lambda v: (minimum(v) * np.arange(1.0, 8.0)).sum()))(np.zeros((300, 7)))  # all are the least
    slope = np.asarray(slope)
    np.testing.assert_array_equal(slope.sum(0), np.arange(1.0, 8.0))
    assert ((slope != 0).sum(0) == 1).all()


def test_edac_likeness_by_hand_and_by_pairs():
    rng = np.random.default_rng(1)
    critics = ensemble(lambda k: MLP.create(3, (16,), 1, k), 4, jax.random.key(0))
    observation, action = (jnp.asarray(rng.normal(size=(5, n)), jnp.float32) for n in (1, 2))
    batch = Batch(observation=observation, action=action)
    step = 1e-2
    slopes = np.zeros((4, 5, 2))
    for j in range(4):
        net = lane(critics, j)
        for k in range(2):
            up, down = (np.array(action), np.array(action))
            up[:, k] += step
            down[:, k] -= step
            joined = [numpy_mlp(net, np.concatenate([observation, a], -1))[:, 0] for a in (up, down)]
            slopes[j, :, k] = (joined[0] - joined[1]) / (2 * step)
    unit = slopes / np.linalg.norm(slopes, axis=-1, keepdims=True)
    pairs = sum((unit[i] * unit[j]).sum(-1) for i in range(4) for j in range(4) if i != j)
    alike = jax.jit(likeness)
    np.testing.assert_allclose(alike(critics, batch), pairs.mean() / 3, atol=0.03)
    same = jax.tree.map(lambda w: np.stack([np.asarray(w)[0]] * 4), critics)
    np.testing.assert_allclose(alike(same, batch), 4.0, rtol=1e-4)  # 4 x 3 pairs of 1, over 3


@pytest.mark.slow
def test_edac_adds_it_to_the_critics_loss(batch):
    agent, state = made(EDAC(critics=3, diversity=2.0, **SMALL))
    of = lambda each: jax.jit(each.critic_loss)(state.critics, state, batch, jnp.zeros(6), KEY)  # noqa: E731
    (plain, _), (loss, metrics) = of(SACN(critics=3, **SMALL)), of(agent)
    np.testing.assert_allclose(loss, plain + 2.0 * metrics["likeness"], rtol=1e-5)
