"""MVE and STEVE: their targets against numbers by hand, in a model that always pays the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import MVE, SAC, STEVE
from deadreckon.agents.agent import bellman_loss
from deadreckon.data.batch import Batch
from deadreckon.data.spec import Box, Spec
from deadreckon.dynamics import Ensemble, Model
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.online import Online
from deadreckon.randomness import key_for
from tests.agents.compiled import begun
from tests.agents.resumed import whole_and_resumed

SPEC = Spec.empty((2,), Box(-np.ones(1, np.float32), np.ones(1, np.float32)), "nowhere")
KEY = jax.random.key(0)
DISCOUNT, VALUE = 0.9, 7.0


class Paying(Model):
    """Member i pays `params[i]` and counts the first number up by one; the logit of an end is the second, doubled."""

    def sample(self, params, inputs, key):
        """See `Model`."""
        one = jnp.ones(inputs.shape[:2])
        return jnp.stack([one, 0.0 * one, params[:, None] * one], -1), 2e3 * inputs[..., 1]


def made(kind, pays=(1.0, 1.0), **fields):
    """An agent in that model, whose critics know one value each, and 4 rows of a batch; the last row is a terminal."""

    class Knowing(kind):
        @property
        def model(self):
            return Paying(members=len(pays))

    fields = {"members": 2, "elites": 2, "hidden": (8,), "model_hidden": (8,), "model_weight_decay": (), "discount": DISCOUNT,
              "entropy_backup": False, "termination": "learned"} | fields  # fmt: skip
    if kind is SAC:
        fields = {name: fields[name] for name in ("hidden", "discount", "entropy_backup")}
    agent = (SAC if kind is SAC else Knowing)(**fields).resolve(SPEC, 10)
    plain = kind(**fields).resolve(SPEC, 10)
    state = begun(plain, SPEC)
    if kind is not SAC:
        zeros = np.zeros(3, np.float32)
        state = state._replace(model=Ensemble(jnp.asarray(pays), None, zeros, zeros + 1.0, np.arange(len(pays))))
    rng = np.random.default_rng(0)
    seen = rng.standard_normal((2, 4, 2)).astype(np.float32)
    seen[1, :, 1] = [-1.0, -1.0, 1.0, -1.0]  # beyond the third row's next observation, the model ends
    batch = Batch(observation=jnp.asarray(seen[0]), action=jnp.asarray(rng.uniform(-1, 1, (4, 1)), jnp.float32),
                  reward=jnp.asarray([1.0, 2.0, 3.0, 4.0]), next_observation=jnp.asarray(seen[1]),
                  terminal=jnp.asarray([0.0, 0.0, 0.0, 1.0]))  # fmt: skip
    return agent, state, batch


def flat(critics, values):
    """The same networks, which say `values` wherever they are asked."""
    zeros = jax.tree.map(lambda w: np.zeros(w.shape, w.dtype), critics)
    return MLP(zeros.weights, (*zeros.biases[:-1], np.asarray(values, np.float32)[:, None]), zeros.activation)


def test_mve_is_the_sum_by_hand():
    agent, state, batch = made(MVE, horizon=3)
    state = state._replace(target_critics=flat(state.target_critics, [VALUE, VALUE + 1.0]))
    found = jax.jit(agent.target)(state, batch, KEY)
    assert found.target.shape == (4, 4)
    goes_on = lambda steps: sum(DISCOUNT**k for k in range(steps)) + DISCOUNT**steps * VALUE  # noqa: E731
    target, observation = np.asarray(found.target), np.asarray(found.observation)
    np.testing.assert_allclose(target[0], [1 + 0.9 * goes_on(3), 2 + 0.9 * goes_on(3), 3 + 0.9, 4.0], rtol=1e-5)
    np.testing.assert_allclose(target[1:, :2], np.tile([[goes_on(3)], [goes_on(2)], [goes_on(1)]], (1, 2)), rtol=1e-5)
    np.testing.assert_array_equal(found.weight, [[1, 1, 1, 1], [1, 1, 1, 0], [1, 1, 0, 0], [1, 1, 0, 0]])
    np.testing.assert_array_equal(observation[0], batch.observation)
    np.testing.assert_allclose(observation[2, :2, 0], np.asarray(batch.next_observation)[:2, 0] + 1.0, rtol=1e-6)
    # The loss is the mean over all steps that there are.
    critics = flat(state.critics, [2.0, 2.0])
    loss, _ = jax.jit(agent.critic_loss)(critics, state, batch, found, KEY)
    weight, error = np.asarray(found.weight), (2.0 - target) ** 2
    np.testing.assert_allclose(loss, 2 * (weight * error).sum() / weight.sum(), rtol=1e-5)


@pytest.mark.slow
def test_mve_of_no_steps_is_sac():
    agent, state, batch = made(MVE, horizon=0, entropy_backup=True)
    sac, plain, _ = made(SAC, entropy_backup=True)
    wanted = sac.target(plain, batch, key_for(KEY, "value"))
    np.testing.assert_array_equal(agent.target(state, batch, KEY).target[0], wanted)
    np.testing.assert_allclose(
        agent.critic_loss(state.critics, state, batch, agent.target(state, batch, KEY), KEY)[0],
        bellman_loss(plain.critics, batch, wanted)[0], rtol=1e-6,
    )  # fmt: skip


@pytest.mark.slow
def test_mve_pays_the_entropy_of_every_action_to_come_but_the_first():
    agent, state, batch = made(MVE, horizon=1, entropy_backup=True)
    free = agent.replace(entropy_backup=False)
    state = state._replace(target_critics=flat(state.target_critics, [VALUE, VALUE]))
    gain = np.asarray(agent.target(state, batch, KEY).target - free.target(state, batch, KEY).target)[:, :2]
    k_act = key_for(key_for(KEY, "rollout", 0), "act")
    noise = lambda key: jax.random.normal(key, (4, 1))  # noqa: E731
    first = np.asarray(agent.act(state, batch.next_observation, noise(k_act))[1])[:2]
    following = batch.next_observation + jnp.asarray([1.0, 0.0])
    second = np.asarray(agent.act(state, following, noise(key_for(KEY, "value")))[1])[:2]
    np.testing.assert_allclose(gain[1], DISCOUNT * second, rtol=1e-4)
    np.testing.assert_allclose(gain[0], DISCOUNT * (first + DISCOUNT * second), rtol=1e-4)


@pytest.mark.slow
def test_steps_of_the_model_whose_numbers_go_bad_are_none():
    agent, state, batch = made(MVE, pays=(np.nan, np.nan), horizon=2)
    state = state._replace(target_critics=flat(state.target_critics, [VALUE, VALUE]))
    found = jax.jit(agent.target)(state, batch, KEY)
    np.testing.assert_allclose(found.target[0], [1 + 0.9 * VALUE, 2 + 0.9 * VALUE, 3 + 0.9 * VALUE, 4.0], rtol=1e-6)
    np.testing.assert_array_equal(found.weight, [[1] * 4, [0] * 4, [0] * 4])
    assert np.isfinite(found.target).all()
    agent, state, batch = made(STEVE, pays=(np.nan, 1.0), horizon=1)
    state = state._replace(target_critics=flat(state.target_critics, np.full(4, VALUE, np.float32)))
    targets = np.asarray(jax.jit(agent.targets)(state, batch, KEY))
    np.testing.assert_allclose(targets[1, :, 0, 0], [1 + 0.9 * VALUE, 1 + 0.9 + 0.81 * VALUE], rtol=1e-6)


def test_steve_weighs_horizons_by_their_certainty():
    agent, state, batch = made(STEVE, pays=(1.0, 3.0), horizon=2, critics=3)
    values = np.array([5.0, 7.0, 12.0], np.float32)
    state = state._replace(target_critics=flat(state.target_critics, values))
    targets, found = jax.jit(lambda *given: (agent.targets(*given), agent.target(*given)))(state, batch, KEY)
    targets = np.asarray(targets)
    assert targets.shape == (3, 2, 3, 4)
    by_hand = np.stack([
        np.broadcast_to(1 + 0.9 * values, (2, 3)),
        np.stack([1 + 0.9 * pay + 0.81 * values for pay in (1.0, 3.0)]),
        np.stack([1 + 0.9 * pay + 0.81 * pay + 0.729 * values for pay in (1.0, 3.0)]),
    ])  # fmt: skip
    np.testing.assert_allclose(targets[..., 0], by_hand, rtol=1e-5)
    weight = 1.0 / by_hand.var((1, 2))
    weight /= weight.sum()
    np.testing.assert_allclose(found.value[0], (weight * by_hand.mean((1, 2))).sum(), rtol=1e-4)
    np.testing.assert_allclose(found.horizon[0], weight @ np.arange(3), rtol=1e-4)
    # The third row ends in the model's first step: the networks disagree only about that step.
    np.testing.assert_allclose(targets[2, :, :, 2], [[3.9] * 3, [5.7] * 3], rtol=1e-5)
    np.testing.assert_allclose(found.value[3], 4.0, rtol=1e-6)


def test_steve_needs_critics_that_can_differ():
    spec = Spec.empty((3,), Box((-1.0,), (1.0,)), "any")
    with pytest.raises(UserError, match="STEVE.critics must be 2 or more, got 1"):
        STEVE(critics=1).resolve(spec, 10)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mve", "steve"])
def test_a_run_online_and_its_resume(kind, tmp_path):
    settings = Online(copies=2, explore=40, updates_per_step=0.5, block=10)
    fields = {"hidden": (8,), "batch_size": 16, "model_hidden": (8,), "model_weight_decay": (), "members": 3, "elites": 2,
              "model_epochs": 2, "model_train_freq": 20}  # fmt: skip
    agent = (MVE if kind == "mve" else STEVE)(**fields)
    whole, again = whole_and_resumed(agent, settings, tmp_path, 80, 120, 10)
    metrics = whole.metrics.to_pydict()
    assert metrics["environment_steps"][-1] == 120
    assert np.isfinite(metrics["model_error"]).all()
    assert {"critic_loss", "model_epochs"} <= set(metrics)
    last = lambda run: np.load(max((run.path / "checkpoints").glob("*.npz")), allow_pickle=False)  # noqa: E731
    one, other = last(whole), last(again)
    assert set(one) == set(other)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
