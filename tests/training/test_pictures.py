from dataclasses import replace
from functools import partial

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

import deadreckon as dr
from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.bc import BC
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.nets.encoder import Encoder, shifted
from deadreckon.policies import portable, store
from deadreckon.policies.deployed import Mixture, deployed
from deadreckon.randomness import keys
from deadreckon.runs import diagnostics
from deadreckon.runs.diagnostics import LogProbe
from deadreckon.runs.settings import TrainSettings
from deadreckon.training import sources
from deadreckon.training.fit import Fit, complete
from deadreckon.training.learner import lane_of
from deadreckon.training.pictures import FEATURES, Seen, Sight, features_of, update, usual_shift
from tests.marks import slow

SEEING = [name for name in AGENTS if "supports_images" in vars(agent_class(name))]
ROWS = 300


def one_fast(names, fast):
    """The others have the same code around other losses."""
    return [fast, *slow(*(name for name in names if name != fast))]


def log_of_spots(rows: int = ROWS, seed: int = 0) -> Dataset:
    """A bright spot on dark pictures; the action says where it is, the reward is larger to the right."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-1, 1, (rows, 2))
    pictures = rng.integers(0, 30, (rows, 16, 16, 3)).astype(np.uint8)
    for picture, (x, y) in zip(pictures, np.rint((place + 1) / 2 * 11).astype(int)):
        picture[y : y + 5, x : x + 5] = 255
    return Dataset.from_arrays(
        observations=pictures, actions=place.astype(np.float32), rewards=place[:, 0].astype(np.float32),
        timeouts=np.arange(rows) % 20 == 19, action_space=Box((-1.0, -1.0), (1.0, 1.0)), name="spots",
    )  # fmt: skip


LOG = log_of_spots()


def small(name: str, **fields):
    fields = {"hidden": (32,), "batch_size": 16} | fields
    return agent_class(name)(**fields).resolve(LOG.spec, 100)


def fitted(agents, seeds, steps, log=LOG, **options):
    job = Fit(agents, TransitionSource(log, agents[0].needs(log.spec)), seeds, steps, **options)
    complete(job, "test", lambda _: None)
    return job


def test_which_agents_see():
    assert set(SEEING) == {"bc", "td3", "td3_bc", "sac", "iql", "cql", "bear"}
    with pytest.raises(UserError, match="ReBRAC needs flat observations, spots has shape"):  # as for AWAC, which sees nothing
        agent_class("rebrac")().resolve(LOG.spec, 10)
    mine = type("Mine", (agent_class("td3_bc"),), {"__module__": "mine"})
    said = "Mine takes flat observations, or images .* where its class says supports_images = True; spots has shape"
    with pytest.raises(UserError, match=said):
        mine().resolve(LOG.spec, 10)


@pytest.mark.parametrize("name", one_fast(SEEING, "bc"))
def test_lanes_chunks_and_streams_change_nothing_and_files_act_alike(name, tmp_path):
    agents = [small(name)] * 2
    together = fitted(agents, [3, 4], 6, chunk=6)
    alone = fitted(agents[:1], [4], 6, chunk=2, stream=True)
    state = lane_of(alone.states, 0)
    for one, other in zip(jax.tree.leaves(lane_of(together.states, 1)), jax.tree.leaves(state), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5)
    policy = deployed(agents[0], state, alone.each[0].view)
    store.save(tmp_path / "policy.npz", policy)
    actions = policy(LOG.observations[:7])
    assert actions.shape == (7, 2)
    np.testing.assert_array_equal(store.load(tmp_path / "policy.npz")(LOG.observations[:7]), actions)
    np.testing.assert_allclose(portable.load(tmp_path / "policy.npz")(LOG.observations[:7]), actions, atol=1e-5)
    np.testing.assert_allclose(policy(LOG.observations[3]), actions[3], atol=1e-6)


@pytest.mark.slow
def test_batches_from_the_host_come_in_parts_of_limited_size(monkeypatch):
    whole = fitted([small("td3_bc")], [0], 6, chunk=6, stream=True)
    monkeypatch.setattr(sources, "FETCHED", 2 * 16 * 2 * 768 + 5_000)  # two updates of 16 rows with what follows
    source = Fit([small("td3_bc")], TransitionSource(LOG, small("td3_bc").needs(LOG.spec)), [0], 6, 6, stream=True)
    assert source.source.part == 2
    parts = fitted([small("td3_bc")], [0], 6, chunk=6, stream=True)
    for one, other in zip(jax.tree.leaves(whole.states), jax.tree.leaves(parts.states), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("network", ["patches", *(pytest.param(name, marks=pytest.mark.slow) for name in ("drq", "impala"))])
def test_programs_of_any_number_of_pictures(network):
    """As exports make them: the number of rows is a symbol."""
    encoder = Encoder.create(network, (24, 24, 3), 8, jax.random.key(0))
    rows = jax.export.symbolic_shape("n")[0]
    program = jax.jit(lambda pictures: encoder(pictures))
    whole = jax.export.export(program)(jax.ShapeDtypeStruct((rows, 24, 24, 3), jnp.float32))
    pictures = np.random.default_rng(0).integers(0, 256, (5, 24, 24, 3)).astype(np.float32)
    np.testing.assert_allclose(whole.call(pictures), program(pictures), atol=1e-5)


def test_a_mixture_sees_one_picture_or_several(tmp_path):
    agent = small("bc")
    states = fitted([agent] * 2, [0, 1], 2)
    view = states.each[0].view
    members = [deployed(agent, lane_of(states.states, i), view) for i in range(2)]
    mixture = Mixture.of(members)
    store.save(tmp_path / "mixture.npz", mixture)
    play = portable.load(tmp_path / "mixture.npz")
    assert mixture(LOG.observations[0]).shape == play(LOG.observations[0], first=True).shape == (2,)
    assert mixture(LOG.observations[:3]).shape == play(LOG.observations[:3], first=True).shape == (3, 2)
    with pytest.raises(UserError, match="takes images"):
        mixture(np.zeros((3, 16, 15, 3), np.uint8))


@pytest.mark.slow
def test_discrete_policies_tell_their_probabilities_by_numpy_too(tmp_path):
    log = replace(LOG, actions=(LOG.actions[:, 0] > 0).astype(np.int32), action_space=Discrete(2))
    agent = agent_class("bc")(hidden=(8,), batch_size=8).resolve(log.spec, 10)
    job = fitted([agent], [0], 2, log=log)
    policy = deployed(agent, lane_of(job.states, 0), job.each[0].view)
    store.save(tmp_path / "policy.npz", policy)
    found = portable.load(tmp_path / "policy.npz").probs(log.observations[:4])
    np.testing.assert_allclose(found, policy.action_probs(log.observations[:4]), atol=1e-5)
    assert found.shape == (4, 2)


@pytest.mark.slow  # what shifts them is in tests/tasks/test_pixels.py
def test_pictures_of_roads_are_not_shifted_by_any_of_their_names(tmp_path):
    for name, shift in (("carla_lane_follow_flat-v0", 0), ("carla-town-full-v0", 0), ("spots", 1)):
        log = replace(LOG, name=name)
        run = dr.train(BC(hidden=(4,), batch_size=4), log, steps=1, task=False, holdout=0, out=tmp_path / name)
        assert run.config["shift"] == shift


@pytest.mark.slow
def test_a_run_goes_on_where_it_was_killed(tmp_path):
    whole = fitted([small("td3_bc")], [0], 8, chunk=4)
    job = Fit([small("td3_bc")], TransitionSource(LOG, small("td3_bc").needs(LOG.spec)), [0], 8, 4, tmp_path / "kept")
    walk = job.chunks()
    next(walk)
    job.save()
    walk.close()
    again = Fit([small("td3_bc")], TransitionSource(LOG, small("td3_bc").needs(LOG.spec)), [0], 8, 4, tmp_path / "kept")
    again.resume()
    assert again.step == 4
    complete(again, "test", lambda _: None)
    for one, other in zip(jax.tree.leaves(whole.states), jax.tree.leaves(again.states), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", one_fast(["bc", "td3_bc", "sac", "iql", "bear"], "iql"))
def test_the_encoder_follows_the_slope_of_its_loss_alone(name):
    """One update by hand: Adam's first step has the sign of the slope, whatever the agent's other losses are."""
    agent = small(name)
    job = Fit([agent], TransitionSource(LOG, agent.needs(LOG.spec)), [0], 10, sight=Sight(shift=2))
    state = lane_of(job.states, 0)
    assert isinstance(state, Seen)
    rows = TransitionSource(LOG, agent.needs(LOG.spec)).take(np.arange(16))
    batch = Batch(**{name: jnp.asarray(column) for name, column in rows.items()})
    key, step = jax.random.key(7), jnp.asarray(5)
    new, _ = jax.jit(partial(update, agent))(state, batch, step=step, key=key)
    k_now, k_next, k_inner = keys(key, "shift", "next_shift", "agent")

    def loss(encoder):
        seen = batch._replace(observation=encoder(shifted(batch.observation, k_now, 2)))
        if batch.next_observation is not None:
            seen = seen._replace(next_observation=state.encoder(shifted(batch.next_observation, k_next, 2)))
        return agent.representation_loss(state.inner, seen, step=step, key=k_inner)

    slopes = jax.jit(jax.grad(loss))(state.encoder)
    for before, after, slope in zip(*map(jax.tree.leaves, jax.device_get((state.encoder, new.encoder, slopes))), strict=True):
        sure = np.abs(slope) > 1e-5
        assert sure.any()
        np.testing.assert_allclose((after - before)[sure], -agent.representation_lr * np.sign(slope)[sure], rtol=2e-2)


@pytest.mark.slow
def test_values_reach_the_encoder_of_actor_critics_and_imitation_does_not():
    """With critics that are flat in the observation the encoder rests, whatever the actor wants."""
    agent = small("td3_bc")
    job = Fit([agent], TransitionSource(LOG, agent.needs(LOG.spec)), [0], 10)
    state = lane_of(job.states, 0)
    first = state.inner.critics.weights[0].at[:, :FEATURES].set(0.0)
    critics = type(state.inner.critics)((first, *state.inner.critics.weights[1:]), state.inner.critics.biases)
    state = state._replace(inner=state.inner._replace(critics=critics))
    rows = TransitionSource(LOG, agent.needs(LOG.spec)).take(np.arange(16))
    batch = Batch(**{name: jnp.asarray(column) for name, column in rows.items()})
    new, _ = jax.jit(partial(update, agent))(state, batch, step=jnp.asarray(0), key=jax.random.key(0))
    for before, after in zip(*map(jax.tree.leaves, (state.encoder, new.encoder)), strict=True):
        np.testing.assert_array_equal(before, after)
    assert not np.array_equal(new.inner.actor.weights[0], state.inner.actor.weights[0])


def test_the_spec_behind_an_encoder():
    spec = features_of(LOG.spec)
    assert (spec.observation_shape, spec.observation_dtype, spec.action) == ((FEATURES,), "float32", LOG.spec.action)


@pytest.mark.slow
@pytest.mark.parametrize("encoder", ["patches", "drq"])
def test_bc_is_seen_to_learn_where_the_spot_is(encoder, tmp_path):
    log = log_of_spots(2_000)
    agent = BC(hidden=(64,), batch_size=64, lr=1e-3)
    run = dr.train(agent, log, steps=300 if encoder == "patches" else 150, out=tmp_path / "run", holdout=0.2, encoder=encoder)
    fresh = log_of_spots(200, seed=1)
    errors = np.square(run.policy(np.asarray(fresh.observations)) - fresh.actions).mean()
    assert errors < 0.06 < np.square(fresh.actions).mean() / 4  # a pixel is 0.18 wide
    assert (run.config["encoder"], run.config["shift"]) == (encoder, usual_shift(16)) == (encoder, 1)
    with pytest.raises(UserError, match="encoder"):
        dr.train(agent, log, steps=400, out=tmp_path / "run", resume=True, encoder="impala")


def test_what_is_refused(tmp_path):
    with pytest.raises(UserError, match="encoder takes 'patches' or 'drq' or 'impala', got 'resnet'"):
        TrainSettings.of({"encoder": "resnet"})
    agent = small("bc")
    job = fitted([agent], [0], 2)
    policy = deployed(agent, lane_of(job.states, 0), job.each[0].view)
    with pytest.raises(UserError, match=r"takes images, uint8 of shape \(16, 16, 3\).*got float32"):
        policy(np.zeros((16, 16, 3), np.float32))
    with pytest.raises(UserError, match=r"got uint8 of shape \(3, 16, 15, 3\)"):
        policy(np.zeros((3, 16, 15, 3), np.uint8))


def test_the_distance_to_the_log_is_of_actions_alone(monkeypatch):
    """Pixels would outweigh them: a policy that did something else was at a distance of 0.000."""
    log = log_of_spots(400)
    probe, done = LogProbe(log), {seen.tobytes(): action for seen, action in zip(log.observations, log.actions)}
    copied = np.stack([done[seen.tobytes()] for seen in probe.observations])
    found = []
    for actions in (copied, np.full_like(copied, 0.9)):
        monkeypatch.setattr(diagnostics, "first_actions", lambda *given, actions=actions: actions)
        found.append(probe(None)["mmd_to_data"])
    assert found[0] < 0.05
    assert found[1] > 0.5
