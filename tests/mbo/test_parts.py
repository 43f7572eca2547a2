"""Losses, weights and densities of designers against numbers by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats

from deadreckon.mbo.cbas import Layout
from deadreckon.mbo.coms import COMs, Conservative
from deadreckon.mbo.ddom import DDOM, sample, variance_left
from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.forward import mixture
from deadreckon.mbo.ram import Ranking, agreement
from deadreckon.mbo.surrogate import score_weights
from deadreckon.mbo.variables import Variable
from deadreckon.nets.mlp import MLP
from deadreckon.progress import unwatched


def linear(weights, bias):
    """A network without hidden layers."""
    weights = np.asarray(weights, np.float32)
    net = MLP.create(weights.shape[0], (), weights.shape[1], jax.random.key(0))
    return MLP((jnp.asarray(weights),), (jnp.asarray(bias, jnp.float32),), net.activation)


@pytest.mark.slow
def test_listnet_equals_numpy():
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((7, 3)).astype(np.float32), rng.standard_normal(7).astype(np.float32)
    weights = rng.standard_normal((3, 1))
    loss, _ = Ranking(1e-3, 1, (), 1, "relu", 7).loss(linear(weights, [0.3]), x, y, None, None)
    assert float(loss) == pytest.approx(-(special.softmax(y) * special.log_softmax((x @ weights)[:, 0])).sum(), rel=1e-5)


def test_a_list_whose_scores_are_all_the_same_has_no_order_and_is_no_failure():
    """Of 120 scores two are hits, so that most lists have none; `auto` ended for this, too."""
    rng = np.random.default_rng(0)
    out, y = rng.standard_normal((2, 9)).astype(np.float32)
    assert float(agreement(out, y)) == pytest.approx(np.corrcoef(out, y)[0, 1], rel=1e-5)
    assert float(agreement(out, np.full(9, 0.1, np.float32))) == float(agreement(np.full(9, 0.1, np.float32), y)) == 0.0
    data = Designs.from_arrays(rng.uniform(size=(120, 2)), np.isin(np.arange(120), [5, 77]).astype(float))
    [(net, _)] = DesignInput(data, 2, [0], None, unwatched).train(Ranking(1e-3, 1, (), 1, "relu", 8), 10, "ram")
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(net))


def test_weights_of_scores_by_hand():
    """Two bins with 3 and 1 of four designs: N / (N + K) exp(-(best - middle) / T) / N, brought to a mean of 1."""
    weight = score_weights(np.array([0.0, 0.1, 0.2, 1.0]), 2, 0.25, 0.5)
    low, high = 3 / 4 * np.exp(-0.75 / 0.5) / 3, 1 / 2 * np.exp(-0.25 / 0.5)
    expected = np.array([low, low, low, high])
    np.testing.assert_allclose(weight, expected / expected.mean(), rtol=1e-5)


@pytest.mark.slow
def test_density_of_mixed_designs_equals_scipy():
    variables = [Variable("a", low=-9, high=9), Variable("c", "categorical", levels=tuple("xyz"))]
    data = Designs.from_arrays(np.array([[i / 5, i % 3] for i in range(12)]), np.arange(12.0), variables)
    view = data.coordinates
    layout = Layout.of(view)
    assert layout.outputs == 2 + 3
    out = np.array([[0.4, -0.5, 0.1, 0.7, -0.3]] * 12, np.float32)
    expected = stats.norm.logpdf(view.encode(data.x)[:, 0], 0.4, np.exp(-0.5))
    expected += special.log_softmax(out[0, 2:])[data.x[:, 1].astype(int)]
    np.testing.assert_allclose(layout.log_prob(jnp.asarray(out), jnp.asarray(view.encode(data.x))), expected, rtol=1e-4)
    drawn = layout.draw(jnp.tile(out[:1], (4000, 1)), jax.random.key(0))
    assert float(drawn[:, 0].mean()) == pytest.approx(0.4, abs=0.05)
    levels = view.decode(np.asarray(drawn))[:, 1].astype(int)
    np.testing.assert_allclose(np.bincount(levels) / 4000, special.softmax(out[0, 2:]), atol=0.03)


def test_a_penalty_grows_where_too_much_is_promised():
    """One step of Adam on the logarithm of its weight, up where the difference is above the margin, down where below."""
    data = Designs.from_arrays(np.linspace(-1, 1, 20)[:, None], np.linspace(-3, 3, 20))
    for margin, sign in ((0.0, 1), (1e3, -1)):
        rates = {"lr": 1e-3, "alpha_lr": 0.01, "design_lr": 0.5}
        learner = Conservative(COMs(hidden=(8,), batch_size=20, margin=margin, ascent_steps=5, **rates))
        x, zeros = np.asarray(data.coordinates.encode(data.x)), np.zeros(20, np.float32)

        @jax.jit
        def promised(net, learner=learner, x=x, zeros=zeros):
            beyond = learner.adversaries(net, x)
            return beyond, learner.loss(net, x, zeros, beyond, 1.0)[1]["overestimation"]

        beyond, more = promised(linear([[2.0]], [0.0]))  # its slope leads beyond the data
        np.testing.assert_allclose(beyond, x + 5 * 0.5 * 2.0, rtol=1e-5)
        assert float(more) == pytest.approx(2.0 * 5.0, rel=1e-4)
        fresh = jax.jit(lambda key, learner=learner: learner.init(data.coordinates, key))(jax.random.key(0))
        batch = type("Batch", (), {"extra": {"x": x, "y": zeros}})
        update = jax.jit(lambda state, learner=learner, batch=batch: learner.update(state, batch, step=0, key=None)[0])
        moved = update(fresh)
        assert np.sign(float(promised(fresh.net)[1]) - margin) == sign
        assert float(moved.log_alpha - fresh.log_alpha) == pytest.approx(sign * 0.01, rel=1e-3)


def test_the_sampler_with_an_exact_model_gives_the_datas_distribution():
    """For data from N(0, s^2) the best noise prediction is sqrt(1 - a) x / (a s^2 + 1 - a)."""
    s = 0.5

    class Exact:
        def __call__(self, seen):
            x, angle = seen[:, :1], seen[:, 1]
            t = jnp.arcsin(jnp.clip(angle, -1, 1)) / (jnp.pi / 2)  # the slowest wave is a quarter of a turn
            left = variance_left(t)[:, None]
            return jnp.sqrt(1 - left) * x / (left * s**2 + 1 - left)

    drawn = _sample(Exact(), 4000)
    assert drawn.std() == pytest.approx(s, rel=0.1)
    assert abs(drawn.mean()) < 0.05


def test_sampled_designs_have_the_fixed_values():
    """Also where they are not repaired afterwards: the other variables are sampled beside these values."""
    rng = np.random.default_rng(0)
    table = {"a": rng.uniform(size=30), "b": rng.uniform(size=30), "c": ["x", "y", "z"] * 10, "y": rng.normal(size=30)}
    data = Designs.from_frame(table, "y", fixed=["a = 0.25", "c = y"])
    made = DDOM(hidden=(8,), steps=2, sampling_steps=3).propose(data, 6, distinct=False)
    np.testing.assert_allclose(made.x[:, 0], 0.25, rtol=1e-5)
    assert [data.variables[2].levels[int(level)] for level in made.x[:, 2]] == ["y"] * 6


def _sample(net, count):
    tree = jax.tree_util.Partial(net)
    wide = jnp.array([-100.0]), jnp.array([100.0])
    drawn = sample(tree, jnp.float32(1.0), 0.0, *wide, jax.random.key(0), count=count, steps=100)
    return np.asarray(drawn)[:, 0]


def test_a_mixture_is_unsure_of_what_its_members_are_unsure_of_and_disagree_on():
    """Means 1 and 5, deviations 1 and 1: the mean of the squares is 1, and that of the means' distances from 3 is 4."""
    nets = MLP((jnp.zeros((2, 3, 2)),), (jnp.array([[1.0, 0.0], [5.0, 0.0]]),))
    mean, deviation = mixture(nets, jnp.ones((4, 3)))
    np.testing.assert_allclose(mean, [3.0] * 4)
    np.testing.assert_allclose(deviation, [5**0.5] * 4, rtol=1e-6)
