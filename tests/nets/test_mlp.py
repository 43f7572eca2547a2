"""Networks against plain numpy; the shared first layer against the plain form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.nets.mlp import GLOROT, MLP, ORTHOGONAL, TRUNCATED, Init, ensemble, joined, minimum, q_values, softplus, split
from deadreckon.nets.optim import ADAM, apply_gradients, copy, polyak_update
from deadreckon.nets.vae import VAE

NUMPY = {
    "relu": lambda x: np.maximum(x, 0),
    "gelu": lambda x: x / 2 * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3))),
}


def numpy_mlp(net, x):
    for i, (w, b) in enumerate(zip(net.weights, net.biases)):
        x = x @ np.asarray(w) + np.asarray(b)
        if i == len(net.weights) - 1:
            return x
        x = NUMPY[net.activation](x)
        if net.normalise:
            x = (x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-6)


@pytest.mark.slow
def test_softplus_and_its_slope():
    x = np.array([-200.0, -20.0, -3.0, -0.5, 0.0, 0.5, 3.0, 20.0, 200.0])
    np.testing.assert_allclose(softplus(jnp.asarray(x)), np.logaddexp(x, 0.0), rtol=1e-6, atol=1e-7)
    slope = jax.vmap(jax.grad(softplus))(jnp.asarray(x, jnp.float32))
    np.testing.assert_allclose(slope, np.exp(x - np.logaddexp(x, 0.0)), rtol=1e-5, atol=1e-30)
    curvature = jax.vmap(jax.grad(jax.grad(softplus)))(jnp.asarray([0.5, -3.0]))
    np.testing.assert_allclose(curvature, 1.0 / (2.0 + 2.0 * np.cosh([0.5, -3.0])), rtol=1e-5)


@pytest.mark.slow
def test_a_stack_split_and_joined():
    nets = ensemble(lambda k: MLP.create(3, (4,), 1, k), 5, jax.random.key(0))
    parts = split(nets, 3)
    assert [len(part.weights[0]) for part in parts] == [1, 2, 2]
    for back, leaf in zip(jax.tree.leaves(joined(parts)), jax.tree.leaves(nets)):
        np.testing.assert_array_equal(back, leaf)
    assert [len(part) for part in split(jnp.arange(2), 4)] == [1, 1]


@pytest.mark.slow
def test_q_values_of_one_and_of_many_actions_agree_with_numpy():
    critics = ensemble(lambda k: MLP.create(5, (16, 16), 1, k), 2, jax.random.key(0))
    obs, actions = np.random.default_rng(0).normal(size=(7, 3)), np.random.default_rng(1).normal(size=(4, 7, 2))
    many = q_values(critics, jnp.asarray(obs), jnp.asarray(actions))
    assert many.shape == (2, 4, 7)
    for k in range(2):
        net = jax.tree.map(lambda w, k=k: w[k], critics)
        for i in range(4):
            expected = numpy_mlp(net, np.concatenate([obs, actions[i]], -1))[:, 0]
            np.testing.assert_allclose(many[k, i], expected, atol=1e-5)
            np.testing.assert_allclose(q_values(critics, jnp.asarray(obs), jnp.asarray(actions[i]))[k], expected, atol=1e-5)


def test_adam_step_and_target_tracking_equal_the_formulas():
    params, grads = {"w": jnp.array([1.0, -2.0])}, {"w": jnp.array([0.5, -0.1])}
    opt = ADAM.init(params)
    m = v = np.zeros(2)
    p = np.array([1.0, -2.0])
    for t in range(1, 4):
        params, opt = apply_gradients(params, grads, opt, 0.01)
        g = np.array([0.5, -0.1])
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
        p = p - 0.01 * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    np.testing.assert_allclose(params["w"], p, rtol=1e-5)
    np.testing.assert_allclose(polyak_update({"w": jnp.zeros(2)}, params, 0.25)["w"], 0.25 * p, rtol=1e-5)
    assert copy(params)["w"] is not params["w"]


def test_adamw_takes_a_share_of_the_parameters_away_in_learning_rates():
    params = {"w": jnp.array([2.0, -4.0])}
    still = {"w": jnp.zeros(2)}
    np.testing.assert_allclose(apply_gradients(params, still, ADAM.init(params), 0.1, 0.5)[0]["w"], [1.9, -3.8], rtol=1e-6)


@pytest.mark.slow
def test_vae_loss_equals_numpy():
    vae = VAE.create(3, 2, (8,), jax.random.key(0))
    obs, act = np.random.default_rng(0).normal(size=(5, 3)), np.tanh(np.random.default_rng(1).normal(size=(5, 2)))
    key = jax.random.key(3)
    loss, metrics = vae.loss(jnp.asarray(obs), jnp.asarray(act), key)
    mean, log_std = np.split(numpy_mlp(vae.encoder, np.concatenate([obs, act], -1)), 2, -1)
    log_std = np.clip(log_std, -4, 15)
    z = mean + np.exp(log_std) * np.asarray(jax.random.normal(key, mean.shape))
    error = ((np.tanh(numpy_mlp(vae.decoder, np.concatenate([obs, z], -1))) - act) ** 2).mean()
    kl = -0.5 * (1 + 2 * log_std - mean**2 - np.exp(2 * log_std)).mean()
    np.testing.assert_allclose(loss, error + 0.5 * kl, rtol=1e-4)
    np.testing.assert_allclose(metrics["behavior_kl"], kl, rtol=1e-4)


def test_the_least_and_its_slope():
    values = jnp.asarray([[3.0, 1.0, 2.0], [2.0, 4.0, 2.0], [5.0, 1.5, 9.0]])
    np.testing.assert_array_equal(minimum(values), [2.0, 1.0, 2.0])
    slope = jax.grad(lambda v: minimum(v).sum())(values)
    np.testing.assert_array_equal(slope, [[0, 1, 1], [1, 0, 0], [0, 0, 0]])  # of two that are equal, the first's


@pytest.mark.slow
def test_networks_begin_as_asked():
    key = jax.random.key(0)
    net = MLP.create(20, (64, 64), 3, key, init=ORTHOGONAL)
    for weight, bias in zip(net.weights, net.biases):
        rows = weight if weight.shape[0] <= weight.shape[1] else weight.T
        np.testing.assert_allclose(rows @ rows.T, 2.0 * np.eye(len(rows)), atol=1e-4)  # gain sqrt(2)
        assert (bias == 0).all()
    net = MLP.create(20, (64, 64), 3, key, init=GLOROT)
    for weight in net.weights:
        bound = np.sqrt(6.0 / sum(weight.shape))
        assert 0.8 * bound < float(jnp.abs(weight).max()) <= bound
    net = MLP.create(20, (64, 64), 3, key, init=TRUNCATED)
    for weight in net.weights[:-1]:  # normal with deviation s, cut at 2 s: 0.88 s is left
        s = 0.5 / np.sqrt(len(weight))
        assert 1.9 * s < float(jnp.abs(weight).max()) <= 2.0 * s
        np.testing.assert_allclose(weight.std(), 0.8796 * s, rtol=0.05)
    assert all((bias == 0).all() for bias in net.biases)
    net = MLP.create(20, (64, 64), 3, key, init=Init(bias=0.1, last=1e-3))
    assert all((bias == np.float32(0.1)).all() for bias in net.biases[:-1])
    for part in (net.weights[-1], net.biases[-1]):
        assert 2e-4 < float(jnp.abs(part).max()) <= 1e-3
    plain = MLP.create(20, (64, 64), 3, key)
    for a, b in zip(net.weights[:-1], plain.weights[:-1]):
        np.testing.assert_array_equal(a, b)
    assert 0.0 < float(jnp.abs(plain.biases[0]).max()) <= 1 / np.sqrt(20)
