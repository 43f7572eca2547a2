"""NEMO's parts against numpy, and that it finds good designs where they are to be found."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import expit

from deadreckon.data.batch import Batch
from deadreckon.errors import UserError
from deadreckon.mbo import NEMO
from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nemo import Fixed, Training
from deadreckon.mbo.nml import Net, bin_log_probs, cross_entropy, middles, nll, p_nml, quantise, reached
from deadreckon.mbo.variables import Variable
from deadreckon.nets.mlp import ensemble, joined

K = 8
SMALL = NEMO(bins=K, hidden=(16, 16), steps=60, pretrain=40, lr=0.01, design_lr=0.01, batch_size=32)


def numpy_probs(mu, s, bins):
    o = np.array([1.0, *(expit((mu - k / bins) / s) for k in range(1, bins)), 0.0])
    return o[:-1] - o[1:]


@pytest.mark.slow
@pytest.mark.parametrize("s", [0.02, 0.1, 1.0])
def test_discretised_logistic_equals_numpy(s):
    mus = np.linspace(-0.3, 1.4, 9)
    found = np.exp(np.asarray(bin_log_probs(jnp.asarray(mus, jnp.float32), jnp.log(s), K)))
    exact = np.stack([numpy_probs(mu, s, K) for mu in mus])
    np.testing.assert_allclose(found, exact, atol=2e-6)
    np.testing.assert_allclose(found.sum(-1), 1.0, atol=1e-5)
    # The mean is g_0 + sum_k (g_k - g_{k-1}) o_k.
    g = np.asarray(middles(K))
    o = 1.0 - np.cumsum(found, -1)[:, :-1]
    np.testing.assert_allclose(o, expit((mus[:, None] - np.arange(1, K) / K) / s), atol=2e-6)
    np.testing.assert_allclose(g[0] + o @ np.diff(g), exact @ g, atol=1e-5)
    assert (np.diff(o, axis=-1) < 1e-6).all()  # falls in k, as labels do; the printed sign would rise


def test_probabilities_far_out_stay_finite():
    """The difference of two sigmoids cancels in floats; its logarithm does not here."""
    logs = np.asarray(bin_log_probs(jnp.asarray([40.0, -40.0]), jnp.log(0.1), K))
    assert np.isfinite(logs).all()
    np.testing.assert_allclose(logs[0, 3] - logs[0, 2], 1 / (K * 0.1), rtol=1e-3)


def test_middles_of_bins_are_halfway_between_their_edges():
    np.testing.assert_allclose(middles(4), [0.125, 0.375, 0.625, 0.875])


def test_quantisation_at_the_edges():
    u = jnp.asarray([0.0, 0.1249, 0.125, 0.5, 0.999, 1.0, 1.7, -0.2])
    np.testing.assert_array_equal(quantise(u, K), [0, 0, 1, 4, 7, 7, 7, 0])


@pytest.mark.slow
def test_losses_equal_numpy():
    net = Net.create(3, (4,), K, True, jax.random.key(0))
    x = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    label = np.array([0, 3, 7, 2, 5])
    mu, s = np.asarray(net.mlp(x))[:, 0], float(np.exp(net.log_scale))
    probs = np.stack([numpy_probs(m, s, K) for m in mu])
    np.testing.assert_allclose(nll(net, x, label), -np.log(probs[np.arange(5), label]), rtol=1e-4)
    o = expit((mu[:, None] - np.arange(1, K) / K) / s)
    wanted = np.arange(1, K) <= label[:, None]
    np.testing.assert_allclose(cross_entropy(net, x, label), -(np.where(wanted, np.log(o), np.log1p(-o))).sum(-1), rtol=1e-4)


@pytest.mark.slow
def test_gradients_of_mu_and_of_the_mean_point_alike():
    """Proposition 6.3.1."""
    net = Net.create(4, (8, 8), K, True, jax.random.key(1))
    x = jax.random.normal(jax.random.key(2), (64, 4))
    of_mu = np.asarray(jax.jit(jax.grad(lambda x: net.internal(x).sum()))(x))
    of_mean = np.asarray(jax.jit(jax.grad(lambda x: (jnp.exp(net.log_probs(x)) @ middles(K)).sum()))(x))
    cosine = (of_mu * of_mean).sum(-1) / (np.linalg.norm(of_mu, axis=-1) * np.linalg.norm(of_mean, axis=-1))
    np.testing.assert_allclose(cosine, 1.0, atol=1e-3)


@pytest.mark.parametrize("logistic", [True, False])
def test_p_nml_takes_each_bin_from_its_own_model(logistic):
    nets = jax.jit(lambda key: ensemble(lambda key: Net.create(2, (4,), K, logistic, key), K, key))(jax.random.key(0))
    x = np.random.default_rng(1).standard_normal((3, 2)).astype(np.float32)
    log_probs = jax.jit(lambda net: net.log_probs(x))
    own = np.stack([np.exp(log_probs(jax.tree.map(lambda leaf, k=k: leaf[k], nets)))[:, k] for k in range(K)], -1)
    np.testing.assert_allclose(np.exp(jax.jit(p_nml)(nets, x)), own / own.sum(-1, keepdims=True), rtol=1e-5)


def test_what_is_exceeded_with_confidence():
    probs = jnp.asarray([[0.25, 0.25, 0.25, 0.25], [0.0, 0.0, 1.0, 0.0], [0.5, 0.0, 0.0, 0.5]])
    exceeded = jax.jit(reached)
    np.testing.assert_allclose(exceeded(probs, 0.5), [0.5, 0.625, 0.75], atol=1e-6)
    np.testing.assert_allclose(exceeded(probs, 0.9), [0.1, 0.525, 0.05], atol=1e-6)
    # It rises with every probability that moves up.
    slope = jax.jit(jax.grad(lambda t: reached(jax.nn.softmax(t * jnp.arange(4.0))[None], 0.8)[0]))(0.1)
    assert slope > 0


@pytest.fixture(scope="module")
def bowl():
    """A bowl in four coordinates whose best designs the data lacks."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-2, 2, (600, 4)).astype(np.float32)
    y = -np.square(x - 0.5).sum(1)
    keep = y < np.quantile(y, 0.8)
    return Designs.from_arrays(x[keep], y[keep], [Variable(f"x{i}", low=-2.0, high=2.0) for i in range(4)], name="bowl")


def score(proposals):
    return -np.square(proposals.x - 0.5).sum(1)


@pytest.mark.slow  # of its parts there are fast tests, and golden numbers of the whole
@pytest.mark.parametrize("fields", [{}, {"label_weight": None, "steps": 400, "design_lr": 0.02}])
def test_designs_improve_and_stay_within_bounds(bowl, fields):
    found = NEMO(**{"bins": 12, "hidden": (32, 32), "pretrain": 400} | fields).propose(bowl, 16)
    assert np.median(score(found)) > bowl.y.max()
    assert found.x.min() >= -2
    assert found.x.max() <= 2
    assert np.isfinite(found.predicted).all()
    assert (found.predicted_std > 0).all()
    assert found.method == "NEMO"


@pytest.mark.slow
def test_claims_make_what_is_searched_uncertain(bowl):
    """Each model is pulled towards its own claim about the designs: without that, nothing is NML."""
    small = NEMO(bins=8, hidden=(32,), steps=300, pretrain=300, lr=0.005, design_lr=0.02, loss="likelihood")
    none, strong = (small.replace(label_weight=weight).propose(bowl, 16) for weight in (0.0, 1.0))
    assert np.median(strong.predicted_std) > 1.5 * np.median(none.predicted_std)
    # Models that stay after pretraining know no claims, whatever these weigh.
    still = [small.replace(search_lr=0.0, label_weight=weight).propose(bowl, 16) for weight in (0.0, 1.0)]
    np.testing.assert_array_equal(still[0].x, still[1].x)
    np.testing.assert_array_equal(still[0].predicted, still[1].predicted)
    assert not np.array_equal(still[0].x, none.x)


@pytest.mark.parametrize(
    "fields",
    [
        pytest.param({"objective": "mean", "g": lambda y: y**3, "loss": "likelihood"}, marks=pytest.mark.slow),
        pytest.param({"objective": "confidence", "architecture": "categorical"}, marks=pytest.mark.slow),
    ],
)
def test_every_form_runs(bowl, fields):
    found = SMALL.replace(**fields).propose(bowl, 4)
    assert found.x.shape == (4, 4)
    assert np.isfinite(found.predicted).all()


@pytest.mark.slow
def test_seeds_side_by_side_and_checkpoints(bowl, tmp_path):
    both = SMALL.propose_many(bowl, 4, seeds=[0, 1])
    alone = SMALL.propose(bowl, 4, seed=1)
    assert [each.seed for each in both] == [0, 1]
    np.testing.assert_allclose(both[1].x, alone.x, atol=2e-2)
    assert not np.array_equal(both[0].x, both[1].x)

    class Killed(Exception):
        pass

    def kill(what, step, steps):
        if step >= 50:
            raise Killed

    with pytest.raises(Killed):
        SMALL.propose(bowl, 4, seed=1, out=tmp_path, watch=kill)
    seen = []
    again = SMALL.propose(bowl, 4, seed=1, out=tmp_path, watch=lambda what, step, steps: seen.append(step))
    assert seen[0] >= 40
    np.testing.assert_array_equal(again.x, alone.x)


@pytest.mark.slow  # its parts are compared with numpy above
def test_trained_long_on_a_design_that_stays_it_is_exact_cnml():
    """Four straight lines under a logistic, against scipy's maximum likelihood on the data and each claim."""
    bins, rows = 4, 12
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(-1, 1, rows))
    data = Designs.from_arrays(x[:, None], x + 0.3 * rng.standard_normal(rows))
    sizes = {"bins": bins, "hidden": (), "batch_size": 256, "pretrain": 0}
    still = NEMO(loss="likelihood", lr=0.003, design_lr=0.0, label_weight=None, **sizes)
    setting = DesignInput(data, 1, [0], None, lambda what, step, steps: None)
    state = setting.train(still.training(setting), 6000, "nemo")[0]
    found = np.exp(np.asarray(p_nml(joined(state.targets), state.search.x)))[0]

    view = data.coordinates
    z, at = view.encode(data.x)[:, 0], float(state.search.x[0, 0])
    label = np.asarray(quantise((data.y - data.y.min()) / np.ptp(data.y), bins))
    log_probs = lambda line, z: np.log(numpy_probs(line[0] * z + line[1], np.exp(line[2]), bins) + 1e-300)  # noqa: E731

    def likely(claims):
        """The line most likely under the data, and a claim counted as a row more."""
        seen = [*zip(z, label), *((at, k) for k in claims)]
        cost = lambda line: -sum(log_probs(line, a)[k] for a, k in seen)  # noqa: E731
        begun = [(0.2, 0.5, log_scale) for log_scale in (-3.0, -1.5)]
        return min((minimize(cost, b, method="Nelder-Mead", options={"maxiter": 2000}) for b in begun), key=lambda r: r.fun).x

    own = np.array([np.exp(log_probs(likely([k]), at)[k]) for k in range(bins)])
    np.testing.assert_allclose(found, own / own.sum(), atol=0.005)
    # Which is not what maximum likelihood says: that is sure of the last bin.
    assert np.exp(log_probs(likely([]), at))[-1] > 0.999
    assert found[-1] < 0.95


def test_designs_move_after_every_ratio_updates_of_the_models_and_not_while_these_are_pretrained():
    data = Designs.from_arrays(np.linspace(0, 1, 12)[:, None], np.linspace(0, 1, 12))
    setting = DesignInput(data, 2, [0], None, lambda what, step, steps: None)
    learner = NEMO(bins=2, hidden=(), pretrain=2, model_updates=3, batch_size=4).training(setting)
    view = data.coordinates
    batch = Batch(extra={"x": view.encode(data.x)[:4], "y": np.zeros(4, np.float32)})
    state = learner.init(view, jax.random.key(0))
    update = jax.jit(lambda state, step: learner.update(state, batch, step=step, key=jax.random.key(0))[0])
    moved = []
    for step in range(9):
        new = update(state, step)
        moved.append(not np.array_equal(new.search.x, state.search.x))
        state = new
    assert np.flatnonzero(moved).tolist() == [4, 7]  # after updates 2, 3, 4 and after 5, 6, 7


@pytest.mark.slow
def test_a_longer_fit_begins_where_a_shorter_one_ended(bowl, tmp_path):
    longer = SMALL.replace(steps=SMALL.steps + 20)
    alone, seen = longer.propose(bowl, 4, seed=1), []
    SMALL.propose(bowl, 4, seed=1, out=tmp_path)
    again = longer.propose(bowl, 4, seed=1, out=tmp_path, watch=lambda what, step, steps: seen.append(step))
    assert seen[0] > SMALL.pretrain + SMALL.steps
    np.testing.assert_array_equal(again.x, alone.x)
    # A shorter one does not begin beyond its own end, nor does another setting begin with this one's.
    shorter = SMALL.replace(steps=SMALL.steps - 20)
    ended = shorter.propose(bowl, 4, seed=1, out=tmp_path)
    np.testing.assert_array_equal(ended.x, shorter.propose(bowl, 4, seed=1).x)
    seen.clear()
    SMALL.replace(lr=0.001).propose(bowl, 4, seed=1, out=tmp_path, watch=lambda what, step, steps: seen.append(step))
    assert seen[0] < SMALL.pretrain


@pytest.mark.slow
def test_a_longer_fit_passes_over_a_broken_checkpoint(bowl, tmp_path):
    shorter = SMALL.replace(steps=SMALL.steps - 20)
    shorter.propose(bowl, 4, seed=1, out=tmp_path)
    newest = max(next(tmp_path.glob("nemo-*")).glob("*.npz"))
    newest.write_bytes(newest.read_bytes()[:100])
    again = SMALL.propose(bowl, 4, seed=1, out=tmp_path)
    np.testing.assert_array_equal(again.x, SMALL.propose(bowl, 4, seed=1).x)


def test_functions_of_the_score_are_told_apart_by_what_they_give(bowl):
    one, other = (SMALL.replace(objective="mean", g=g) for g in (lambda y: y, lambda y: -y))
    assert str(one) == str(other)
    assert one.settings_text(bowl) != other.settings_text(bowl)
    assert one.settings_text(bowl) == SMALL.replace(objective="mean", g=lambda y: y + 0.0).settings_text(bowl)


def test_functions_of_the_score_see_it_as_the_table_has_it():
    rng = np.random.default_rng(0)
    costs = Designs.from_frame({"a": rng.normal(size=20), "cost": np.linspace(5.0, 9.0, 20)}, "cost", minimise=True)
    seen = []
    NEMO(bins=4, objective="mean", g=lambda y: seen.append(y) or -y).settings_text(costs)
    np.testing.assert_allclose(seen[0], [8.5, 7.5, 6.5, 5.5])


def test_a_killed_fit_goes_on_in_another_process_too():
    """The folder's name holds bounds by their digest, not by Python's hash, which every process salts anew."""
    assert repr(Fixed(np.array([1.0, 2.0]))) == "Fixed(0a108fd7267a5566)"


@pytest.mark.slow
def test_refusals(bowl):
    with pytest.raises(UserError, match="n must be 1 or more, got 0"):
        SMALL.propose(bowl, 0)
    with pytest.raises(UserError, match=r"NEMO.bins takes a whole number >= 2, got 1"):
        SMALL.replace(bins=1).propose(bowl)
    with pytest.raises(UserError, match="NEMO.architecture takes 'logistic' or 'categorical'"):
        SMALL.replace(architecture="tree").propose(bowl)
    with pytest.raises(UserError, match="nemo: .* was not finite at update .*; a lower learning rate may help"):
        SMALL.replace(lr=1e30).propose(bowl, 4)  # as many as elsewhere, which is the same program


@pytest.mark.slow
def test_models_with_constant_predictions_are_warned_of(bowl, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SMALL.propose(bowl, 4)
    monkeypatch.setattr(Training, "worth", lambda self, stacks, z: 0.3 + 0.0 * z.sum(-1))
    with pytest.warns(UserWarning, match=r"NEMO: its models predict the same .*seeds \[5, 6\].* lower lr \(now 0.01\)"):
        SMALL.propose_many(bowl, 4, seeds=[5, 6])


def test_a_claim_counts_as_one_row_of_the_data(bowl):
    """One of M claims is drawn an update: each has on average w / M beside a mean over N rows, which must be 1 / N."""
    for designs in (1, 4, 16):
        setting = DesignInput(bowl, designs, [0], None, lambda what, step, steps: None)
        learner = SMALL.training(setting)
        assert learner.settings.label_weight / designs == pytest.approx(1 / len(bowl))
        assert SMALL.replace(label_weight=1.0).training(setting).settings.label_weight == 1.0


def test_models_begin_as_lecun_s():
    """Variance 1 / inputs, zero biases: PyTorch's uniform has a third of it."""
    net = Net.create(200, (300,), K, True, jax.random.key(0))
    for weights, inputs in zip(net.mlp.weights, (200, 300)):
        assert float(weights.var()) * inputs == pytest.approx(1.0, rel=0.2)
    assert all(not np.asarray(biases).any() for biases in net.mlp.biases)


def test_designs_travel_no_further_than_they_may(bowl):
    """In deviations of the data; categories, which have none, are free."""
    far = SMALL.replace(design_lr=0.2)
    found = far.replace(max_travel=0.25).propose(bowl, 4, distinct=False)
    started = bowl.x[bowl.best(4)]
    travelled = np.abs(found.x - started) / bowl.coordinates.std
    assert travelled.max() == pytest.approx(0.25, abs=1e-4)
    free = far.replace(max_travel=100.0).propose(bowl, 4, distinct=False)
    assert (np.abs(free.x - started) / bowl.coordinates.std).max() > 0.5
    level = Variable("c", "categorical", levels=tuple("xyz"))
    rng = np.random.default_rng(0)
    x = np.stack([rng.normal(size=20), rng.integers(0, 3, 20)], 1)
    mixed = Designs.from_arrays(x, rng.normal(size=20), [Variable("a"), level])
    np.testing.assert_array_equal(SMALL._reach(mixed.coordinates), [1.0, np.inf, np.inf])
