"""Policies as DOPE published them."""

import pickle

import jax
import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.policies import Step, load, load_dope, portable, save


def written(folder, **changes):
    rng = np.random.default_rng(0)
    layers = {"fc0": (5, 4), "fc1": (6, 5), "last_fc": (2, 6), "last_fc_log_std": (2, 6)}
    found = {f"{name}/weight": rng.standard_normal(shape) for name, shape in layers.items()}
    found |= {f"{name}/bias": rng.standard_normal(shape[0]) for name, shape in layers.items()}
    found |= {"nonlinearity": "relu", "output_distribution": "tanh_gaussian"} | changes
    path = folder / "policy.pkl"
    path.write_bytes(pickle.dumps({key: value for key, value in found.items() if value is not None}))
    return path, found


def by_hand(found, x):
    """The published arithmetic: mean and deviation before the squashing."""
    f = np.tanh if found["nonlinearity"] == "tanh" else lambda h: np.maximum(h, 0)
    for name in ("fc0", "fc1"):
        x = f(x @ found[f"{name}/weight"].T + found[f"{name}/bias"])
    mean = x @ found["last_fc/weight"].T + found["last_fc/bias"]
    log_std = x @ found["last_fc_log_std/weight"].T + found["last_fc_log_std/bias"]
    return mean, np.exp(log_std)


KINDS = [("relu", "tanh_gaussian"), ("tanh", "tanh_gaussian"), ("tanh", "gaussian")]


@pytest.mark.slow
@pytest.mark.parametrize(("nonlinearity", "output"), KINDS)
def test_acts_as_published(tmp_path, nonlinearity, output):
    path, found = written(tmp_path, nonlinearity=nonlinearity, output_distribution=output)
    policy = load_dope(path)
    x = 0.3 * np.random.default_rng(1).standard_normal((50, 4)).astype(np.float32)
    mean, std = by_hand(found, x)
    squash = np.tanh if output == "tanh_gaussian" else lambda a: a
    np.testing.assert_allclose(policy(x), squash(mean), atol=1e-4)
    assert policy.has_log_prob
    if output == "gaussian":
        action = mean + 0.5 * std
        density = (-0.5 * 0.25 - np.log(std) - 0.5 * np.log(2 * np.pi)).sum(1)
        np.testing.assert_allclose(policy.log_prob(x, action), density, rtol=1e-3, atol=1e-3)
    keys = jax.random.split(jax.random.key(0), 2000)
    step = Step(x[:1], np.zeros(1), np.ones(1, bool))
    drawn = np.asarray(jax.vmap(lambda key: policy.act(step, (), key, greedy=False)[0][0])(keys))
    inside = 1.96 if output == "gaussian" else 2.5
    low, high = squash(mean[0] - inside * std[0]), squash(mean[0] + inside * std[0])
    assert 0.93 < ((low <= drawn) & (drawn <= high)).mean() <= 1.0
    # It is a policy like any other: saved, read back, and run by numpy alone.
    save(tmp_path / "policy.npz", policy)
    np.testing.assert_allclose(load(tmp_path / "policy.npz")(x), policy(x), atol=1e-6)
    np.testing.assert_allclose(portable.load(tmp_path / "policy.npz")(x), policy(x), atol=1e-5)


def test_a_policy_without_deviations_acts_by_its_mean_and_has_no_densities(tmp_path):
    path, found = written(
        tmp_path, output_distribution="gaussian", **{"last_fc_log_std/weight": None, "last_fc_log_std/bias": None}
    )
    policy = load_dope(path)
    assert not policy.has_log_prob
    x = np.random.default_rng(1).standard_normal((50, 4)).astype(np.float32)
    zeros = {"last_fc_log_std/weight": np.zeros((2, 6)), "last_fc_log_std/bias": np.zeros(2)}
    mean = by_hand(found | zeros, x)[0]
    assert np.abs(mean).max() > 1  # not squashed
    np.testing.assert_allclose(policy(x), mean, atol=1e-4)
    step = Step(x, np.zeros(50), np.ones(50, bool))
    np.testing.assert_allclose(policy.act(step, (), jax.random.key(0), greedy=False)[0], mean, atol=1e-4)
    save(tmp_path / "policy.npz", policy)
    np.testing.assert_allclose(load(tmp_path / "policy.npz")(x), mean, atol=1e-4)
    np.testing.assert_allclose(portable.load(tmp_path / "policy.npz")(x), mean, atol=1e-4)


def test_files_that_are_no_policies(tmp_path):
    path, _ = written(tmp_path, **{"fc1/weight": None})
    with pytest.raises(UserError, match="last_fc/weight has shape"):
        load_dope(path)
    path, _ = written(tmp_path, **{"fc0/weight": None})
    with pytest.raises(UserError, match="the layers are fc1, one is missing"):
        load_dope(path)
    path, _ = written(tmp_path, **{"last_fc/weight": None})
    with pytest.raises(UserError, match="holds no policy of DOPE"):
        load_dope(path)
    path.write_bytes(pickle.dumps({"last_fc/weight": print}))
    with pytest.raises(UserError, match="the pickle asks for builtins.print"):
        load_dope(path)
