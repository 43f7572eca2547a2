"""D4PG and CRR-D against numpy written from the papers, on fixed numbers; what it learns is in the conformance tests."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import CRRD, D4PG
from deadreckon.data.batch import Batch
from deadreckon.errors import UserError
from deadreckon.nets.return_distributions import mean, project
from tests.agents.compiled import Compiled, begun, moved
from tests.agents.test_offline import KEY, SPEC, drawn_actions, logged_log_prob
from tests.agents.tiny import LOG

SETTINGS = {"hidden": (8, 6), "critic_hidden": (7, 5), "atoms": 11, "v_min": -2.0, "v_max": 2.0, "batch_size": 6}
FAR = 60.0


@pytest.fixture(scope="module")
def learner():
    agent = D4PG(**SETTINGS, target_update_period=3).resolve(SPEC, 10)
    return Compiled(agent), moved(begun(agent, SPEC), ("actor", "critic", "target_actor", "target_critic"))


@pytest.fixture(scope="module")
def batch():
    rng = np.random.default_rng(0)
    size = SPEC.observation_size, SPEC.action_size
    return Batch(
        observation=jnp.asarray(rng.normal(size=(6, size[0])), jnp.float32),
        reward=jnp.asarray(rng.normal(size=6), jnp.float32),
        action=jnp.asarray(rng.uniform(-1, 1, (6, size[1])), jnp.float32),
        next_observation=jnp.asarray(rng.normal(size=(6, size[0])), jnp.float32),
        discount=jnp.asarray([0.9, 0.81, 0.0, 0.9, 0.81, 0.0], jnp.float32),
    )  # fmt: skip


def forward(net, x):
    for i, (w, b) in enumerate(zip(net.weights, net.biases)):
        x = x @ np.asarray(w, np.float64) + np.asarray(b)
        if i == 0:
            x = (x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-5)
            x = np.tanh(x * np.asarray(net.gain) + np.asarray(net.shift))
        elif i < len(net.weights) - 1:
            x = np.where(x > 0, x, np.exp(x) - 1)
    return x


def softmax(x):
    e = np.exp(x - x.max(-1, keepdims=True))
    return e / e.sum(-1, keepdims=True)


def shared_by_nearness(probabilities, rewards, discounts, atoms):
    """Algorithm 1 of Bellemare et al. (2017), atom by atom."""
    out, step = np.zeros_like(probabilities), atoms[1] - atoms[0]
    for row, (reward, discount) in enumerate(zip(rewards, discounts)):
        for atom, chance in zip(atoms, probabilities[row]):
            place = (np.clip(reward + discount * atom, atoms[0], atoms[-1]) - atoms[0]) / step
            below, above = int(np.floor(place + 1e-6)), int(np.ceil(place - 1e-6))
            if below == above:
                out[row, below] += chance
            else:
                out[row, below] += chance * (above - place)
                out[row, above] += chance * (place - below)
    return out


def test_the_target_is_the_projected_distribution_of_the_target_networks(learner, batch):
    agent, state = learner
    atoms = np.linspace(-2.0, 2.0, 11)
    after = np.asarray(batch.next_observation, np.float64)
    action = np.tanh(forward(state.target_actor, after))
    future = softmax(forward(state.target_critic, np.concatenate([after, action], -1)))
    by_hand = shared_by_nearness(future, np.asarray(batch.reward), np.asarray(batch.discount), atoms)
    found = np.asarray(agent.target(state, batch, KEY))
    np.testing.assert_allclose(found, by_hand, atol=2e-5)
    np.testing.assert_allclose(found.sum(-1), 1.0, atol=1e-5)
    ended = np.asarray(batch.discount) == 0.0  # all of it lies at the reward then
    np.testing.assert_allclose((found * atoms).sum(-1)[ended], np.clip(np.asarray(batch.reward)[ended], -2, 2), atol=1e-5)


def test_a_projection_keeps_the_mean_of_what_fits_between_the_atoms():
    rng = np.random.default_rng(1)
    atoms = np.linspace(-3.0, 3.0, 21, dtype=np.float32)
    chances = softmax(rng.normal(size=(50, 21))).astype(np.float32)
    reward, discount = rng.uniform(-0.5, 0.5, 50), rng.uniform(0, 0.8, 50)
    found = np.asarray(jax.jit(project)(chances, reward, discount, atoms))
    np.testing.assert_allclose((found * atoms).sum(-1), reward + discount * (chances * atoms).sum(-1), atol=1e-5)


def test_the_critics_loss_is_the_cross_entropy_to_it(learner, batch):
    agent, state = learner
    target = agent.target(state, batch, KEY)
    loss, metrics = agent.critic_loss(state.critic, batch, target)
    chances = softmax(forward(state.critic, np.concatenate([batch.observation, batch.action], -1)))
    assert loss == pytest.approx(-(np.asarray(target) * np.log(chances)).sum(-1).mean(), rel=1e-5)
    assert metrics["q"] == pytest.approx((chances * np.linspace(-2, 2, 11)).sum(-1).mean(), abs=1e-5)
    slope = jax.jit(jax.grad(lambda target: agent.critic_loss(state.critic, batch, target)[0]))(target)
    assert not np.asarray(slope).any()


def test_the_actor_follows_the_critics_slope_cut_to_length_one(learner, batch):
    state = learner[1]
    agent, critic = learner[0].replace(v_min=-FAR, v_max=FAR), state.critic  # slopes above one, of some rows
    seen = np.asarray(batch.observation, np.float64)
    action, atoms, small = np.tanh(forward(state.actor, seen)), np.linspace(-FAR, FAR, 11), 1e-5

    def value(action):
        return (softmax(forward(critic, np.concatenate([seen, action], -1))) * atoms).sum(-1)

    moves = small * np.eye(action.shape[1])
    slope = np.stack([(value(action + m) - value(action - m)) / (2 * small) for m in moves], -1)
    length = np.linalg.norm(slope, axis=-1, keepdims=True)
    assert length.max() > 1.5
    assert length.min() < 1.0
    cut = slope / np.maximum(length, 1.0)
    loss, found = jax.jit(jax.value_and_grad(agent.actor_loss))(state.actor, critic, batch, KEY)
    assert loss == pytest.approx(0.5 * np.square(cut).sum(-1).mean(), rel=1e-3)
    # By the biases of the last layer the action's slope is 1 - tanh^2.
    np.testing.assert_allclose(found.biases[-1], -(cut * (1 - action**2)).mean(0), rtol=2e-3, atol=1e-5)


SLOW = pytest.mark.slow


OTHERS = [pytest.param(*each, marks=SLOW) for each in (("binary", "normal"), ("exp", "tanh_normal"))]


@pytest.mark.parametrize(("by", "likelihood"), [("exp", "normal"), *OTHERS])
def test_crr_d_imitates_by_the_advantage_of_expected_returns(batch, likelihood, by):
    fields = SETTINGS | {"hidden": (8,), "filter": by, "likelihood": likelihood, "temperature": 0.02, "max_weight": 2.5}
    agent = CRRD(**fields, samples=3).resolve(SPEC, 10)
    state = begun(agent, SPEC)
    state = state._replace(critic=jax.tree.map(lambda w: 2.0 * np.asarray(w), state.critic))
    atoms, seen = np.linspace(-2.0, 2.0, 11), np.asarray(batch.observation, np.float64)
    expected = lambda a: (softmax(forward(state.critic, np.concatenate([seen, a], -1))) * atoms).sum(-1)  # noqa: E731
    drawn = drawn_actions(state.actor, seen, jax.random.normal(KEY, (3, 6, batch.action.shape[-1])))
    advantage = expected(np.asarray(batch.action)) - np.mean([expected(a) for a in drawn], 0)
    assert 0 < (advantage > 0).sum() < 6
    weight = advantage > 0 if by == "binary" else np.minimum(np.exp(advantage / 0.02), 2.5)
    loss = -(weight * logged_log_prob(state.actor, batch)).mean()
    assert Compiled(agent).actor_loss(state.actor, state.critic, batch, KEY) == pytest.approx(loss, rel=1e-3)


def test_crr_d_values_draws_of_a_copy_of_the_policy(batch):
    agent = CRRD(**SETTINGS | {"hidden": (8,)}).resolve(SPEC, 10)
    state = begun(agent, SPEC)
    state = state._replace(target_actor=jax.tree.map(lambda w: np.asarray(w) + np.float32(0.2), state.target_actor))
    after = np.asarray(batch.next_observation, np.float64)
    action = drawn_actions(state.target_actor, after, jax.random.normal(KEY, batch.action.shape))
    future = softmax(forward(state.target_critic, np.concatenate([after, action], -1)))
    by_hand = shared_by_nearness(future, np.asarray(batch.reward), np.asarray(batch.discount), np.linspace(-2.0, 2.0, 11))
    np.testing.assert_allclose(Compiled(agent).target(state, batch, KEY), by_hand, atol=2e-5)


def test_targets_are_copied_at_the_end_of_every_period_and_rest_in_between(learner, batch):
    agent, state = learner
    update = jax.jit(lambda state, step: agent.update(state, batch, step=step, key=jax.random.key(0))[0])
    for step in range(7):
        new = update(state, jnp.asarray(step))
        kept = new if step in (2, 5) else state
        for side in ("actor", "critic"):
            source = getattr(kept, side if step in (2, 5) else f"target_{side}")
            for a, b in zip(jax.tree.leaves(getattr(new, f"target_{side}")), jax.tree.leaves(source), strict=True):
                np.testing.assert_array_equal(a, b)
        state = new


def test_rows_are_of_n_steps_and_say_what_multiplies_the_value_behind_them():
    needs = D4PG(n_step=5, discount=0.95).needs(LOG.spec)
    assert (needs.n_step, needs.gamma) == (5, 0.95)
    assert "discount" in needs.columns
    assert "terminal" not in needs.columns


def test_what_it_refuses():
    with pytest.raises(UserError, match="v_min must be below v_max, got 3.0 and 3.0"):
        D4PG(v_min=3.0, v_max=3.0).resolve(SPEC, 10)
    worse = dataclasses.replace(LOG, rewards=-1.0 - np.abs(LOG.rewards))
    with pytest.raises(UserError, match="CRRD: rewards of .* so that every return lies outside v_min = 0 to v_max = 100"):
        CRRD().resolve(worse.spec, 10)
    D4PG().resolve(worse.spec, 10)
    for kind in (D4PG, CRRD):
        with pytest.raises(UserError, match=rf"{kind.__name__}.atoms takes a whole number >= 2, got 1"):
            kind(atoms=1).resolve(SPEC, 10)
    with pytest.raises(UserError, match="D4PG.v_min takes a finite number"):
        D4PG(v_min=-np.inf).resolve(SPEC, 10)


def test_the_mean_is_of_the_softmax():
    logits = np.asarray([[0.0, 0.0, 0.0], [0.0, 0.0, 40.0]], np.float32)
    np.testing.assert_allclose(jax.jit(mean)(logits, np.asarray([-1.0, 0.0, 2.0], np.float32)), [1 / 3, 2.0], atol=1e-5)
