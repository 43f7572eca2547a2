"""Likelihoods against numpy; a linear world whose matrices and noise are found; what a fit keeps and when it ends."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy import stats

from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Spec
from deadreckon.dynamics import AutoRegressive, Gaussian, Trainer
from deadreckon.dynamics import model as models
from deadreckon.dynamics.gaussian import BOUND_WEIGHT
from deadreckon.dynamics.model import bernoulli_nll, gaussian_nll, soft_bounds
from deadreckon.errors import DivergedError, UserError
from deadreckon.nets.optim import init_opt
from deadreckon.training.fit import fit

SPEC = Spec.empty((2,), Box((-1.0,), (1.0,)), "linear")
A = np.array([[-0.1, 0.2], [0.0, -0.3]])  # of the change
B = np.array([[0.0], [0.5]])
NOISE = np.array([0.02, 0.05])


def linear(n, seed=0):
    """Transitions of a linear world with Gaussian noise and a linear reward."""
    rng = np.random.default_rng(seed)
    s, a = rng.standard_normal((n, 2)), rng.uniform(-1, 1, (n, 1))
    following = s + s @ A.T + a @ B.T + NOISE * rng.standard_normal((n, 2))
    columns = {"observation": s, "action": a, "reward": s[:, 0] - a[:, 0], "next_observation": following}
    return {name: column.astype(np.float32) for name, column in columns.items()} | {"terminal": np.zeros(n, np.float32)}


def created(model):
    """A model's first parameters, by one program: one operation at a time, each would be compiled alone."""
    return jax.jit(lambda key: model.create(SPEC, key))(jax.random.key(0))


def test_likelihoods_equal_numpy():
    rng = np.random.default_rng(0)
    mean, target, log_variance = rng.standard_normal((3, 5)).astype(np.float32)
    wanted = -stats.norm.logpdf(target, mean, np.exp(log_variance / 2))
    np.testing.assert_allclose(gaussian_nll(*map(jnp.asarray, (mean, log_variance, target))), wanted, rtol=1e-5)
    logit, happened = np.array([-30.0, -1.0, 0.0, 2.0], np.float32), np.array([0.0, 1.0, 1.0, 0.0], np.float32)
    chance = 1 / (1 + np.exp(-logit.astype(float)))
    wanted = -np.log(np.where(happened, chance, 1 - chance))
    np.testing.assert_allclose(bernoulli_nll(jnp.asarray(logit), jnp.asarray(happened)), wanted, rtol=1e-5, atol=1e-12)


@pytest.mark.slow
def test_soft_bounds_hold_and_have_slopes():
    bounds = jnp.array([[-10.0], [0.5]])
    x = jnp.linspace(-100.0, 100.0, 41)[:, None]
    held = soft_bounds(x, bounds)
    assert ((held >= -10.0) & (held <= 0.501)).all()
    np.testing.assert_allclose(soft_bounds(jnp.array([[-5.0]]), bounds), -5.0, atol=0.02)
    upper = 0.5 - np.logaddexp(0.5 - 2.0, 0.0)
    np.testing.assert_allclose(soft_bounds(jnp.array([[2.0]]), bounds)[0, 0], -10 + np.logaddexp(upper + 10.0, 0.0), rtol=1e-6)
    slope = jax.grad(lambda b: soft_bounds(jnp.array([[50.0]]), b).sum())(bounds)
    assert slope[1, 0] == pytest.approx(1.0, abs=1e-3)  # what is above is held by the upper bound, which learns


@pytest.mark.slow
def test_gradients_equal_differences():
    """Of the whole loss, in float64: likelihood, bounds and chance of an end."""
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        model = Gaussian(members=2, hidden=(4,))
        params = jax.tree.map(lambda leaf: np.asarray(leaf, float), created(model))
        inputs, target = (jnp.asarray(rng.standard_normal((2, 5, 3))) for _ in range(2))
        terminal = jnp.asarray(rng.integers(0, 2, (2, 5)), float)
        flat, back = ravel_pytree(params)
        loss = jax.jit(lambda flat: model.losses(back(flat), inputs, target, terminal, None).mean(-1).sum())
        moved = np.eye(len(flat)) * 1e-6
        differences = [(loss(flat + step) - loss(flat - step)) / 2e-6 for step in moved]
        found = jax.jit(jax.grad(loss))(flat)
        assert found.dtype == np.float64
        np.testing.assert_allclose(found, differences, atol=1e-8)
        assert np.abs(found).max() > 0.1


@pytest.mark.slow
def test_losses_equal_numpy_for_each_member_on_its_own_rows():
    rng = np.random.default_rng(0)
    model = Gaussian(members=3, hidden=(8,))
    params = created(model)
    inputs, target = (rng.standard_normal((3, 4, k)).astype(np.float32) for k in (3, 3))
    terminal = rng.integers(0, 2, (3, 4)).astype(np.float32)
    found = model.losses(params, *map(jnp.asarray, (inputs, target, terminal)), jax.random.key(1))
    mean, log_variance, logit = (np.asarray(x) for x in jax.vmap(model._heads)(params["nets"], params["bounds"], inputs))
    likelihood = stats.norm.logpdf(target, mean, np.exp(log_variance / 2)).sum(-1)
    chance = 1 / (1 + np.exp(-logit))
    ends = np.log(np.where(terminal > 0, chance, 1 - chance))
    np.testing.assert_allclose(found, -likelihood - ends + BOUND_WEIGHT * 3 * 10.5, rtol=1e-4)
    mbpo = dataclasses.replace(model, as_mbpo=True).losses(params, inputs, target, terminal, jax.random.key(1))
    np.testing.assert_allclose(mbpo, 2 * (-likelihood - ends) / 3 + BOUND_WEIGHT / 3 * 3 * 10.5, rtol=1e-4)
    np.testing.assert_allclose(model.sample(params, jnp.asarray(inputs), None)[0], mean, rtol=1e-6)
    plain = Gaussian(members=3, hidden=(8,), deterministic=True)
    squares = np.square(mean - target).sum(-1) - ends
    np.testing.assert_allclose(plain.losses(params, inputs, target, terminal, jax.random.key(1)), squares, rtol=1e-4)
    np.testing.assert_array_equal(plain.sample(params, jnp.asarray(inputs), jax.random.key(2))[0], mean)


def test_an_update_is_of_changes_of_observations_and_of_rewards_in_deviations(monkeypatch):
    """Two rows by hand: (inputs, target, terminal) as every member is given them."""
    told, losses = [], Gaussian.losses

    @jax.jit
    def given(state, batch):
        """What a traced update gives to `losses`."""
        model.update(state, batch, step=jnp.int32(0), key=jax.random.key(0))
        (one,) = told
        return one

    def spy(self, params, inputs, target, terminal, key):
        told.append((inputs, target, terminal))
        return losses(self, params, inputs, target, terminal, key)

    monkeypatch.setattr(Gaussian, "losses", spy)
    monkeypatch.setattr(models, "stacks", lambda: 1)
    model = Gaussian(members=2, hidden=())
    params = created(model)
    batch = Batch(
        observation=jnp.array([[1.0, 2.0], [3.0, 4.0]]), action=jnp.array([[0.5], [-0.5]]), reward=jnp.array([6.0, -3.0]),
        next_observation=jnp.array([[1.5, 2.0], [3.0, 3.0]]), terminal=jnp.array([0.0, 1.0]),
    )  # fmt: skip
    inputs, target, terminal = given((params, init_opt(params), jnp.float32(3.0)), batch)
    np.testing.assert_allclose(inputs, [[[1.0, 2.0, 0.5], [3.0, 4.0, -0.5]]] * 2)
    np.testing.assert_allclose(target, [[[0.5, 0.0, 2.0], [0.0, -1.0, -1.0]]] * 2)
    np.testing.assert_allclose(terminal, [[0.0, 1.0]] * 2)


@pytest.mark.slow
@pytest.mark.parametrize("parts", [2, 5])
def test_stacks_of_members_learn_what_one_stack_does(parts, monkeypatch):
    """Each member from its own rows, with its own weights of them."""
    net = Gaussian(members=3, hidden=(8,), layer_decay=(0.1, 0.2))
    params, rng = created(net), np.random.default_rng(0)
    rows, target = rng.standard_normal((3, 16, 3)), rng.standard_normal((3, 16, 3))
    given = params, init_opt(params), rows, target, rng.random((3, 16)), rng.random((3, 16)), jax.random.key(0)
    monkeypatch.setattr(models, "stacks", lambda: 1)
    new, _, told = jax.jit(lambda *given: net.step(*given))(*given)
    monkeypatch.setattr(models, "stacks", lambda: parts)
    same, _, also = jax.jit(lambda *given: net.step(*given))(*given)
    np.testing.assert_allclose(ravel_pytree(same)[0], ravel_pytree(new)[0], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(also["model_nll"], told["model_nll"], rtol=1e-6)


@pytest.mark.slow
def test_decay_of_layers_by_hand():
    """On rows that are predicted already only the decay has a gradient, whose sign is all of Adam's first step."""
    model = Gaussian(members=2, hidden=(4,), deterministic=True, layer_decay=(0.5, 0.25), weight_decay=0.0, lr=1e-3)
    params = created(model)
    rows = jnp.ones((2, 3, 3))
    target, logit = jax.jit(lambda params: model.sample(params, rows, None))(params)
    chance = jax.nn.sigmoid(logit)  # a terminal of this much has no gradient either
    new, _, _ = jax.jit(model.step)(params, init_opt(params), rows, target, chance, 1.0, jax.random.key(0))
    for before, after in zip(params["nets"].weights, new["nets"].weights):
        np.testing.assert_allclose(after - before, -1e-3 * np.sign(before), rtol=1e-2)


@pytest.fixture(scope="module")
def fitted():
    model = Gaussian(members=5, hidden=(32, 32), lr=3e-3, weight_decay=0.0)
    return model, *Trainer(elites=3, most_epochs=60).fit(model, SPEC, linear(4000), 0)


@pytest.mark.slow
def test_a_linear_world_is_found(fitted):
    model, ensemble, report = fitted
    assert report.rows == 3200
    inputs = np.concatenate([np.eye(3), np.zeros((1, 3))]).astype(np.float32)
    seen = jnp.broadcast_to(ensemble.standardise(inputs), (3, 4, 3))
    mean = np.asarray(jax.jit(lambda params, seen: model.sample(params, seen, None)[0])(ensemble.best(), seen))
    slopes = (mean[:, :3] - mean[:, 3:]).mean(0).T  # (outputs, inputs)
    np.testing.assert_allclose(slopes[:2, :2], A, atol=0.04)
    np.testing.assert_allclose(slopes[:2, 2:], B, atol=0.04)
    np.testing.assert_allclose(slopes[2], [1.0, 0.0, -1.0], atol=0.05)
    # The noise where the data is: at its edge, where few rows are, networks differ from machine to machine.
    fresh = linear(500, seed=1)
    inputs = ensemble.standardise(np.concatenate([fresh["observation"], fresh["action"]], 1))
    spread = jax.jit(lambda params, seen: model.heads(params, seen)[1])
    log_variance = spread(ensemble.best(), np.broadcast_to(inputs, (3, 500, 3)))
    np.testing.assert_allclose(np.exp(0.5 * np.asarray(log_variance)).mean((0, 1))[:2], NOISE, rtol=0.2)


@pytest.mark.slow
def test_intervals_are_calibrated_on_rows_held_out(fitted):
    model, ensemble, _ = fitted
    fresh = linear(2000, seed=1)
    inputs = ensemble.standardise(np.concatenate([fresh["observation"], fresh["action"]], 1))
    params, inputs = ensemble.best(), np.broadcast_to(inputs, (3, 2000, 3))
    draw = jax.jit(lambda seed: model.sample(params, inputs, jax.random.key(seed))[0])
    drawn = [np.asarray(draw(i)) for i in range(100)]
    low, high = np.percentile(np.concatenate(drawn), [5.0, 95.0], 0)
    change = fresh["next_observation"] - fresh["observation"]
    inside = ((low[:, :2] <= change) & (change <= high[:, :2])).mean(0)
    assert (inside > 0.85).all(), inside
    assert (inside < 0.95).all(), inside


@pytest.mark.slow
def test_the_best_are_elites_and_their_errors_are_of_the_weights_kept(fitted):
    model, ensemble, report = fitted
    assert list(ensemble.elites) == list(np.argsort(report.error)[:3])
    assert (np.sort(report.error)[:3] < 1.5 * np.square(NOISE).sum() / 3).all()


@pytest.mark.slow
def test_a_later_fit_goes_on_and_is_deterministic(fitted):
    model, ensemble, report = fitted
    trainer = Trainer(elites=3, most_epochs=2, patience=0)
    again, after = trainer.fit(model, SPEC, linear(4500), 1, start=ensemble)
    twice, _ = trainer.fit(model, SPEC, linear(4500), 1, start=ensemble)
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(twice)):
        np.testing.assert_array_equal(one, other)
    fresh, start = trainer.fit(model, SPEC, linear(4500), 1)
    assert after.error.max() < 0.5 * start.error.min()
    np.testing.assert_allclose(fresh.mean, again.mean)


@pytest.mark.slow
def test_a_fit_ends_when_nothing_gets_better():
    """Noise alone: after its mean is known there is nothing to learn."""
    rng = np.random.default_rng(0)
    noise = linear(300) | {"next_observation": rng.standard_normal((300, 2)).astype(np.float32)}
    _, report = Trainer(patience=2, most_epochs=500).fit(Gaussian(members=2, hidden=(8,), lr=1e-2), SPEC, noise, 0)
    assert 3 < report.epochs < 200


@pytest.mark.slow
def test_the_autoregressive_model_fits_the_same_way():
    model = AutoRegressive(members=2, hidden=(32, 32), lr=3e-3)
    ensemble, report = Trainer(elites=1, most_epochs=30).fit(model, SPEC, linear(2000), 0)
    assert report.error.min() < 0.02
    drawn, logit = model.sample(ensemble.params, jnp.zeros((2, 5, 3)), jax.random.key(0))
    assert drawn.shape == (2, 5, 3)
    assert logit.shape == (2, 5)
    assert (np.asarray(drawn).std(1) > 0).all()


@pytest.mark.slow
def test_refusals():
    with pytest.raises(UserError, match="9 rows are too few to fit a model to, 10 or more are needed"):
        Trainer().fit(Gaussian(members=2, hidden=(4,)), SPEC, linear(9), 0)
    with pytest.raises(DivergedError, match="model: its error was not finite after epoch 1; a lower learning rate may help"):
        Trainer().fit(Gaussian(members=2, hidden=(4,), lr=1e30), SPEC, linear(100), 0)


@pytest.mark.slow  # a matter of learning; its numbers are golden
def test_the_autoregressive_model_knows_what_numbers_have_to_do_with_each_other():
    """Both numbers become one draw, which no diagonal model can say."""
    rng = np.random.default_rng(0)
    seen, both = rng.standard_normal((2000, 2)), rng.standard_normal((2000, 1))
    log = Dataset.from_arrays(
        observations=seen, actions=np.zeros((2000, 1)), rewards=np.zeros(2000), timeouts=np.ones(2000, bool),
        final_observations=np.tile(both, 2), action_space=Box((-1.0,), (1.0,)), name="both",
    )  # fmt: skip
    correlation = {}
    for kind in (AutoRegressive, Gaussian):
        model = kind(members=1, hidden=(16,), lr=1e-2)
        params, _, _ = fit([model], TransitionSource(log, model.needs(log.spec)), [0], 600).lane(0)
        change = jax.jit(model.draw)(params, jnp.asarray(seen[None], jnp.float32), jnp.zeros((1, 2000, 1)), jax.random.key(1))
        correlation[kind] = np.corrcoef(np.asarray(change.observation[0]).T)[0, 1]
    assert correlation[AutoRegressive] > 0.9
    assert abs(correlation[Gaussian]) < 0.1


@pytest.mark.parametrize("kind", [Gaussian, AutoRegressive])
def test_ends_of_which_a_log_does_not_say_what_they_led_to_teach_no_change(kind):
    """A fifth of all rows end by chance, and repeat their own observation; all others change by 1."""
    rng = np.random.default_rng(0)
    observation = rng.normal(size=(600, 1)).astype(np.float32)
    terminal = (rng.random(600) < 0.2).astype(np.float32)
    following = np.where(terminal[:, None] > 0.5, observation, observation + 1.0).astype(np.float32)
    columns = {"observation": observation, "action": np.zeros((600, 1), np.float32), "reward": np.ones(600, np.float32),
               "next_observation": following, "terminal": terminal}  # fmt: skip
    spec = Dataset.from_arrays(
        observations=observation, actions=columns["action"], rewards=columns["reward"], terminals=terminal
    ).spec
    model = kind(members=2, hidden=(8,), lr=1e-2, batch_size=64)
    found, report = Trainer(elites=2, patience=3, most_epochs=60).fit(model, spec, columns, 0)
    inputs = (np.concatenate([observation, columns["action"]], 1) - found.mean) / found.std
    mean, logit = model.sample(found.params, jnp.broadcast_to(inputs, (2, *inputs.shape)), None)
    np.testing.assert_allclose(mean[..., 0], 1.0, atol=0.1)
    assert report.elite_error < 0.01
    if kind is Gaussian:
        assert abs(float(jax.nn.sigmoid(logit).mean()) - 0.2) < 0.05


@pytest.mark.parametrize("kind", [Gaussian, AutoRegressive])
def test_such_ends_are_drawn_as_often_as_they_happen(kind):
    """A fifth of all rows end by chance, with a reward of -5 instead of 1; all others change by 1."""
    rng = np.random.default_rng(0)
    terminal = rng.random(500) < 0.2
    observation = rng.normal(size=(500, 1))
    log = Dataset.from_arrays(
        observations=observation, actions=np.zeros((500, 1)), rewards=1.0 - 6.0 * terminal, terminals=terminal,
        timeouts=~terminal, final_observations=observation + ~terminal[:, None], final_known=~terminal,
        action_space=Box((-1.0,), (1.0,)),
    )  # fmt: skip
    model = kind(members=1, hidden=(16,), lr=1e-2)
    rows = TransitionSource(log, model.needs(log.spec))
    params, _, unit = fit([model], rows, [0], 300).lane(0)
    seen = jnp.asarray(rows.view.observe(observation.astype(np.float32)))[None]
    change = jax.jit(model.draw)(params, seen, jnp.zeros((1, 500, 1)), jax.random.key(3))
    assert abs(float(change.ends.mean()) - terminal.mean()) < 0.05
    assert abs(float(unit) * float(change.reward.mean()) - np.mean(1.0 - 6.0 * terminal)) < 0.4
    assert float((change.observation - seen).mean()) == pytest.approx(1.0 / float(rows.view.std[0]), rel=0.1)
