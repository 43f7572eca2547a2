"""BEAR against numpy written from thesis 4.3, A.3 and A.4; and the two ends of its constraint."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents.agent import backup, bellman_loss
from deadreckon.agents.bear import BEAR, State
from deadreckon.agents.bear_is import ISBEAR
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import q_values
from deadreckon.nets.mmd import squared_mmd
from deadreckon.policies import EnvPolicy
from deadreckon.randomness import key_for, keys
from deadreckon.training.fit import fit
from tests.agents.compiled import Compiled
from tests.agents.worlds import corridor
from tests.nets.test_mlp import numpy_mlp
from tests.nets.test_mmd import reference_mmd

KEY = jax.random.key(11)
KEYS = jax.random.key(0), jax.random.key(1)  # of the behaviour model's draws, and of its copies
LOG = corridor()
SPEC = LOG.spec


def setup(steps=100, **fields):
    agent = BEAR(**({"hidden": (16, 16)} | fields)).resolve(SPEC, steps)
    state = agent.init(SPEC, jax.random.key(0))
    rng = np.random.default_rng(0)
    batch = Batch(
        observation=jnp.asarray(rng.normal(size=(6, 1)), jnp.float32), action=jnp.asarray(rng.uniform(-0.9, 0.9, (6, 1))),
        reward=jnp.asarray(rng.normal(size=6)), next_observation=jnp.asarray(rng.normal(size=(6, 1)), jnp.float32),
        terminal=jnp.asarray([0.0, 1.0, 0.0, 0.0, 1.0, 0.0]),
    )  # fmt: skip
    return Compiled(agent), state, batch


def numpy_gaussian(net, obs):
    mean, log_std = np.split(numpy_mlp(net, np.asarray(obs)), 2, -1)
    return mean, np.clip(log_std, -5, 2)


def lane(tree, i):
    return jax.tree.map(lambda w: np.asarray(w)[i], tree)


@pytest.mark.slow
@pytest.mark.parametrize(("critics", "weight"), [(2, 0.75), (3, 0.4)])
def test_target_is_the_best_mixed_value_and_stops_at_terminals(critics, weight):
    agent, state, batch = setup(critics=critics, min_weight=weight, target_samples=5, discount=0.9)
    key = jax.random.key(7)
    got = backup(batch, agent.discount, agent.future(state, batch, key))
    mean, log_std = numpy_gaussian(state.target_actor, batch.next_observation)
    noise = np.asarray(jax.random.normal(key, (5, 6, 1)))
    actions = np.tanh(mean + np.exp(log_std) * noise)
    y = np.full(6, -np.inf)
    for i in range(5):  # Algorithm 1, lines 4-5, one sample after another
        pair = np.concatenate([batch.next_observation, actions[i]], -1)
        q = np.stack([numpy_mlp(lane(state.target_critics, j), pair)[:, 0] for j in range(critics)])
        y = np.maximum(y, weight * q.min(0) + (1 - weight) * q.max(0))
    expected = np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * y
    np.testing.assert_allclose(got, expected, atol=1e-5)
    np.testing.assert_array_equal(got[1], batch.reward[1])  # the mask that line 6 forgets


def test_bellman_loss_is_the_squared_error_with_no_gradient_through_the_target():
    agent, state, batch = setup()
    target = jnp.arange(6.0)
    loss, through = jax.jit(jax.value_and_grad(lambda t: bellman_loss(state.critics, batch, t)[0]))(target)
    pair = np.concatenate([batch.observation, batch.action], -1)
    q = np.stack([numpy_mlp(lane(state.critics, j), pair)[:, 0] for j in range(2)])
    np.testing.assert_allclose(loss, ((q - np.arange(6)) ** 2).mean(-1).sum(), rtol=1e-5)
    np.testing.assert_array_equal(through, 0.0)


@pytest.mark.parametrize("value", ["min", "mean"])
def test_actor_loss_is_the_lagrangian(value):
    agent, state, batch = setup(actor_value=value, kernel="gaussian", multiplier=3.0, warm_start=10, policy_samples=4,
                                behavior_samples=5, actor_samples=2)  # fmt: skip
    key = jax.random.key(5)
    k_policy, k_behavior = keys(key, "policy", "behavior")
    loss, (divergence, _, q_mean) = agent.actor_loss(state.actor, state, batch, jnp.int32(10), key)
    mean, log_std = numpy_gaussian(state.actor, batch.observation)
    pre = mean + np.exp(log_std) * np.asarray(jax.random.normal(k_policy, (4, 6, 1)))
    bm, bs = numpy_gaussian(state.behavior, batch.observation)
    logged = bm + np.exp(bs) * np.asarray(jax.random.normal(k_behavior, (5, 6, 1)))
    mmds = [reference_mmd("gaussian", pre[:, s], logged[:, s], 20.0) for s in range(6)]  # pre-tanh (A.4)
    np.testing.assert_allclose(divergence, np.mean(mmds), rtol=2e-3)
    q = []
    for i in range(2):
        pair = np.concatenate([batch.observation, np.tanh(pre[i])], -1)
        each = np.stack([numpy_mlp(lane(state.critics, j), pair)[:, 0] for j in range(2)])
        q.append(each.min(0) if value == "min" else each.mean(0))
    np.testing.assert_allclose(q_mean, np.mean(q), rtol=1e-4)
    np.testing.assert_allclose(loss, -np.mean(q) + 3.0 * np.mean(mmds), rtol=2e-3)
    warm, _ = agent.actor_loss(state.actor, state, batch, jnp.int32(9), key)
    np.testing.assert_allclose(warm, np.mean(mmds), rtol=2e-3)  # the constraint alone


@pytest.mark.slow
def test_mmd_gradient_reaches_the_actor_and_never_the_behaviour_model():
    """A public implementation loses it: the multiplier's backward pass cancels the gradient."""
    agent, state, batch = setup(warm_start=10)
    key = jax.random.key(0)
    loss = lambda actor, model: agent.actor_loss(actor, state._replace(behavior=model), batch, jnp.int32(0), key)[0]  # noqa: E731
    to_actor, to_model = jax.jit(jax.grad(loss, (0, 1)))(state.actor, state.behavior)
    assert all(np.abs(g).max() > 1e-6 for g in jax.tree.leaves(to_actor))
    assert all(np.abs(g).max() == 0 for g in jax.tree.leaves(to_model))
    after, _ = jax.jit(lambda s: agent.update(s, batch, step=jnp.int32(0), key=key))(state)
    assert not np.array_equal(after.actor.weights[0], state.actor.weights[0])


def test_dual_step_ascends_clips_and_rests():
    agent, state, _ = setup(threshold=0.05, multiplier_lr=1e-3, warm_start=10)
    dual_step = jax.jit(agent.dual_step)
    up, _ = dual_step(state, jnp.float32(0.2), jnp.int32(10))
    down, _ = dual_step(state, jnp.float32(0.01), jnp.int32(10))
    rest, _ = dual_step(state, jnp.float32(0.2), jnp.int32(9))
    # Adam's first step has the size of the learning rate; the slope is -alpha (MMD - threshold).
    np.testing.assert_allclose([up, down, rest], [1e-3, -1e-3, 0.0], atol=1e-6)
    high = state._replace(log_multiplier=jnp.float32(10.0))
    assert float(dual_step(high, jnp.float32(1.0), jnp.int32(10))[0]) == 10.0
    low = state._replace(log_multiplier=jnp.float32(-5.0))
    assert float(dual_step(low, jnp.float32(0.0), jnp.int32(10))[0]) == -5.0
    frozen, *_ = setup(dual=False)
    assert float(frozen.dual_step(state, jnp.float32(9.0), jnp.int32(99))[0]) == 0.0


def test_inverse_density_weights_have_a_ceiling():
    agent, state, batch = setup(density_weighting=True, density_clip=2.0)
    weight = np.asarray(agent.bellman_weight(state, batch))
    mean, log_std = numpy_gaussian(state.behavior, batch.observation)
    pre = np.arctanh(np.asarray(batch.action))
    log_density = (-0.5 * ((pre - mean) / np.exp(log_std)) ** 2 - log_std - 0.5 * np.log(2 * np.pi)
                   - np.log(1 - np.tanh(pre) ** 2)).sum(-1)  # fmt: skip
    raw = np.exp(-log_density)
    np.testing.assert_allclose(weight, np.minimum(raw / raw.mean(), 2.0), rtol=1e-4)
    one_dominates = batch._replace(action=jnp.asarray([[0.1], [0.1], [0.1], [0.1], [0.1], [1 - 1e-6]]))
    assert np.asarray(agent.bellman_weight(state, one_dominates)).max() <= 2.0


def test_kl_and_cross_entropy_constraints():
    agent, state, batch = setup(constraint="kl", threshold=0.1, policy_samples=2)
    other, *_ = setup(constraint="cross_entropy")
    assert other.threshold == -2.0

    @jax.jit
    def found(state):
        d, b = (dist.gaussian_head(net(batch.observation)) for net in (state.actor, state.behavior))
        pre = dist.sample(d, jax.random.key(1), (2,))
        kl, cross_entropy = (each.divergence(d, pre, state, batch, *KEYS) for each in (agent, other))
        return kl, dist.kl(d, b), cross_entropy, dist.log_prob(b, pre)

    kl, wanted, cross_entropy, log_prob = found(state)
    np.testing.assert_allclose(kl, wanted)
    np.testing.assert_allclose(cross_entropy, -np.asarray(log_prob).mean(0), rtol=1e-5)


def test_warm_start_and_defaults_come_from_the_run():
    assert BEAR().resolve(SPEC, 1_000).warm_start == 200
    assert BEAR().resolve(SPEC, 1_000_000).warm_start == 40_000
    assert BEAR().resolve(SPEC, 1_000).threshold == 0.05
    assert BEAR(behavior="vae").resolve(SPEC, 1_000).behavior_hidden == (750, 750)
    with pytest.raises(UserError, match="needs densities"):
        BEAR(behavior="vae", constraint="kl").resolve(SPEC, 10)
    with pytest.raises(UserError, match=r"BEAR.actor_samples \(9\) must not exceed policy_samples \(4\)"):
        BEAR(actor_samples=9).resolve(SPEC, 10)
    with pytest.raises(UserError, match="ISBEAR has no use for actor_samples; leave it out, got 2"):
        ISBEAR(actor_samples=2).resolve(SPEC, 10)
    with pytest.raises(UserError, match="BEAR.mixture needs at least one bandwidth"):
        BEAR(kernel="mixture", mixture=()).resolve(SPEC, 10)
    unbiased = {"mmd_estimate": "unbiased", "policy_samples": 1}
    with pytest.raises(UserError, match="mmd_estimate='unbiased' needs policy_samples"):
        BEAR(**unbiased).resolve(SPEC, 10)
    BEAR(constraint="kl", **unbiased).resolve(SPEC, 10)  # which has no MMD
    assert BEAR(behavior_hidden=()).resolve(SPEC, 10).behavior_hidden == ()
    with pytest.raises(UserError, match="ISBEAR: ratio_min must be below ratio_max, got 3 and 2"):
        ISBEAR(ratio_min=3.0).resolve(SPEC, 10)
    with pytest.raises(UserError, match=r"BEAR.multiplier_min \(2\) must not exceed multiplier_max \(1\)"):
        BEAR(multiplier_min=2.0, multiplier_max=1.0).resolve(SPEC, 10)
    with pytest.raises(UserError, match="BEAR.threshold must be 0 or more, as no MMD is less, got -1"):
        BEAR(threshold=-1.0).resolve(SPEC, 10)
    assert BEAR(threshold=-1.0, constraint="cross_entropy").resolve(SPEC, 10).threshold == -1.0
    with pytest.raises(UserError, match="kernel takes"):
        BEAR(kernel="cosine").resolve(SPEC, 10)
    for kind in (BEAR, ISBEAR):
        with pytest.raises(UserError, match="of 2 or more, with mmd_reference='model'"):
            kind(mmd_estimate="unbiased", mmd_reference="logged").resolve(SPEC, 10)


@pytest.fixture(scope="module")
def half_support():
    """Two lanes of one program on a log whose actions lie in [-0.5, 0]: multiplier frozen at 100, and at 0."""
    log = corridor(actions="half")
    agent = BEAR(hidden=(32, 32), batch_size=128, actor_lr=1e-3, critic_lr=1e-3, behavior_lr=1e-3, discount=0.9, warm_start=100,
                 dual=False, multiplier=100.0, test_action="actor", kernel="laplacian").resolve(log.spec, 1500)  # fmt: skip
    free = agent.replace(multiplier=0.0)
    rows = TransitionSource(log, agent.needs(log.spec))
    result = fit([agent, free], rows, [0, 0], 1500, chunk=500)
    return [EnvPolicy.of(a.policy(result.lane(i)), rows.view) for i, a in enumerate((agent, free))]


@pytest.mark.slow
def test_a_large_multiplier_keeps_the_support_and_zero_forgets_it(half_support):
    from deadreckon.policies import Step

    states = np.linspace(-0.9, -0.3, 32, dtype=np.float32)[:, None]  # here the best actions are positive, out of support
    drawn = []
    for policy in half_support:
        step = Step(jnp.asarray(np.repeat(states, 50, 0)), None, None)
        drawn.append(np.asarray(policy.act(step, (), jax.random.key(1), greedy=False)[0]))
    held, free = drawn
    assert (held < 0.1).mean() > 0.95
    assert (held > -0.75).mean() > 0.95
    assert -0.5 < held.mean() < 0.0
    # The unconstrained actor goes where the critics point, out of the support for about half of its draws.
    assert (free > 0.1).mean() > 0.3
    assert free.mean() > held.mean() + 0.2


@pytest.mark.slow
def test_multiplier_zero_is_the_unconstrained_actor_exactly():
    agent, state, batch = setup(dual=False, multiplier=0.0, warm_start=0)
    key = jax.random.key(4)
    k_policy = key_for(key, "policy")

    def unconstrained(actor):
        pre = dist.sample(dist.gaussian_head(actor(batch.observation)), k_policy, (4,))[0]
        return -q_values(state.critics, batch.observation, jnp.tanh(pre)).min(0).mean()

    got = jax.jit(jax.grad(lambda actor: agent.actor_loss(actor, state, batch, jnp.int32(0), key)[0]))(state.actor)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(jax.jit(jax.grad(unconstrained))(state.actor)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


@pytest.mark.slow
def test_importance_sampled_losses_equal_numpy():
    agent = Compiled(ISBEAR(hidden=(16, 16), policy_samples=3, delta=0.25, warm_start=0).resolve(SPEC, 100))
    state = agent.init(SPEC, jax.random.key(0))
    # Another actor, so that ratios are not one.
    state = state._replace(actor=jax.tree.map(lambda w: w * 1.3, state.actor))
    _, _, batch = setup()
    key = jax.random.key(2)
    mean, log_std = numpy_gaussian(state.set_policy, batch.observation)
    pre = mean + np.exp(log_std) * np.asarray(jax.random.normal(key, (3, 6, 1)))
    am, als = numpy_gaussian(state.actor, batch.observation)
    density = lambda m, s: (-0.5 * ((pre - m) / np.exp(s)) ** 2 - s).sum(-1)  # noqa: E731
    ratio = np.clip(np.exp(density(am, als) - density(mean, log_std)), 0.5, 2.0)
    pairs = [np.concatenate([batch.observation, np.tanh(pre[i])], -1) for i in range(3)]
    q = np.stack([[numpy_mlp(lane(state.critics, j), p)[:, 0] for p in pairs] for j in range(2)])
    low = q.min(0)
    np.testing.assert_allclose(
        agent.weighted_loss(state.actor, state, batch, jnp.int32(1), key), -(ratio * (low - low.mean(0))).mean(), atol=1e-5
    )
    loss, (divergence, spread) = agent.set_loss(state.set_policy, state, batch, jnp.int32(1), key)
    k_policy = key_for(key, "policy")
    pre = mean + np.exp(log_std) * np.asarray(jax.random.normal(k_policy, (3, 6, 1)))
    pairs = [np.concatenate([batch.observation, np.tanh(pre[i])], -1) for i in range(3)]
    q = np.stack([[numpy_mlp(lane(state.critics, j), p)[:, 0] for p in pairs] for j in range(2)])
    np.testing.assert_allclose(spread, np.sqrt(3.0 * q.mean(1).var(0) + 1e-6).mean(), rtol=1e-4)
    np.testing.assert_allclose(loss, spread + divergence, rtol=1e-4)
    got = agent.future(state, batch, key)
    m, s = numpy_gaussian(state.target_actor, batch.next_observation)
    actions = np.tanh(m + np.exp(s) * np.asarray(jax.random.normal(key, (agent.target_samples, 6, 1))))
    q = np.stack([[numpy_mlp(lane(state.target_critics, j), np.concatenate([batch.next_observation, a], -1))[:, 0]
                   for a in actions] for j in range(2)])  # fmt: skip
    np.testing.assert_allclose(got, (0.75 * q.min(0) + 0.25 * q.max(0)).mean(0), atol=1e-5)  # a mean, line 5


@pytest.mark.slow
def test_sac_base_adds_entropy():
    agent, state, batch = setup(base="sac")
    assert isinstance(state, State)
    key = jax.random.key(3)
    plain = BEAR(hidden=(16, 16)).resolve(SPEC, 100)
    assert not np.allclose(agent.future(state, batch, key), plain.future(state, batch, key))
    after, metrics = jax.jit(lambda s: agent.update(s, batch, step=jnp.int32(50), key=key))(state)
    assert float(after.log_temperature) != float(state.log_temperature)
    assert np.isfinite(list(metrics.values())).all()
    warm, _ = jax.jit(lambda s: agent.update(s, batch, step=jnp.int32(0), key=key))(state)
    assert float(warm.log_temperature) == float(state.log_temperature)  # it rests while the actor cannot answer


@pytest.mark.slow
def test_mmd_after_the_tanh_and_against_the_logged_action():
    agent, state, batch = setup(mmd_actions="after_tanh", mmd_reference="logged", kernel="gaussian", policy_samples=3)
    pre = jnp.asarray(np.random.default_rng(1).normal(size=(3, 6, 1)), jnp.float32)
    got = agent.divergence(None, pre, state, batch, *KEYS)
    action = np.asarray(batch.action)
    expected = [reference_mmd("gaussian", np.tanh(pre[:, s]), action[None, s], 20.0) for s in range(6)]
    np.testing.assert_allclose(got, expected, rtol=5e-3)


@pytest.mark.slow
def test_an_unbiased_constraint_is_the_root_of_the_mean_square_over_states():
    agent, state, batch = setup(mmd_estimate="unbiased", actor_samples=1)
    loss, (divergence, _, value) = agent.actor_loss(state.actor, state, batch, jnp.int32(10**6), KEY)
    k_policy, k_behavior = keys(KEY, "policy", "behavior")
    pre = dist.sample(dist.gaussian_head(state.actor(batch.observation)), k_policy, (4,))
    logged = dist.sample(dist.gaussian_head(state.behavior(batch.observation)), k_behavior, (4,))
    squares = squared_mmd(pre, logged, agent.kernel, agent.bandwidth, unbiased=True)
    assert float(squares.min()) < 0.0  # single states may be below zero
    np.testing.assert_allclose(divergence, np.sqrt(max(float(squares.mean()), 0.0) + 1e-6), rtol=1e-4)
    np.testing.assert_allclose(loss, -value + np.exp(state.log_multiplier) * divergence, rtol=1e-4)
    with pytest.raises(UserError, match="needs policy_samples and behavior_samples of 2 or more"):
        setup(mmd_estimate="unbiased", behavior_samples=1)


@pytest.mark.parametrize("reference", ["model", "logged"])
def test_a_relative_constraint_is_less_the_distance_of_the_models_own_draws(reference):
    more = {"policy_samples": 3, "behavior_samples": 5, "mmd_actions": "after_tanh", "mmd_reference": reference}
    agent, state, batch = setup(mmd_estimate="relative", **more)
    d, model = (dist.gaussian_head(net(batch.observation)) for net in (state.actor, state.behavior))
    pre = dist.sample(d, KEY, (3,))
    got = agent.divergence(d, pre, state, batch, *KEYS)
    logged, copies = (dist.sample(model, key, (count,)) for key, count in zip(KEYS, (5, 3)))
    if reference == "logged":
        logged = jnp.arctanh(batch.action)[None]
    apart = lambda x, s: reference_mmd("laplacian", np.tanh(x[:, s]), np.tanh(logged[:, s]), 20.0)  # noqa: E731
    np.testing.assert_allclose(got, [apart(pre, s) - apart(copies, s) for s in range(6)], atol=2e-3)
    assert agent.constrained(got) == pytest.approx(float(np.mean(got)), abs=1e-6)


@pytest.mark.slow
def test_a_relative_constraint_has_the_slope_of_the_biased_one_and_a_threshold_of_zero():
    (agent, state, batch), (biased, *_) = setup(mmd_estimate="relative"), setup()
    slope = lambda of: jax.grad(of.actor_loss, has_aux=True)(state.actor, state, batch, jnp.int32(0), KEY)[0]  # noqa: E731
    slopes = slope(agent), slope(biased)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-7), *slopes)
    assert BEAR(mmd_estimate="relative").resolve(SPEC, 10).threshold == 0.0
    assert BEAR(mmd_estimate="relative", threshold=-0.01).resolve(SPEC, 10).threshold == -0.01
    assert BEAR(mmd_estimate="relative", constraint="kl").resolve(SPEC, 10).threshold == 0.05


def test_the_multiplier_may_be_adapted_in_the_warm_start():
    for adapted in (False, True):
        agent, state, _ = setup(warm_start=10, dual_warm_start=adapted, threshold=0.05)
        value, _ = agent.dual_step(state, jnp.asarray(1.0), jnp.int32(3))
        assert bool(value > state.log_multiplier) == adapted
        value, _ = agent.dual_step(state, jnp.asarray(1.0), jnp.int32(10))
        assert value > state.log_multiplier
