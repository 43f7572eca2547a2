"""DAPG: Fisher products, natural steps and the demonstrations' term against numpy; runs that clone, go on and learn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import deadreckon as dr
from deadreckon.agents.dapg import DAPG, LOG_STD_MIN, Cloning, moments
from deadreckon.agents.natural import Actor, fisher_product, log_prob, natural_step
from deadreckon.cli.main import main
from deadreckon.collect.maze2d import demonstrations
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.spec import Box, Spec
from deadreckon.errors import DivergedError, UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP
from deadreckon.online import Online
from deadreckon.online.demonstrated import Demonstrated
from deadreckon.tasks import task
from deadreckon.training.fit import Fit
from tests.agents.compiled import Compiled, begun

SPEC = Spec.empty((3,), Box((-1.0, -1.0), (1.0, 1.0)), "nowhere")
AGENT = DAPG(hidden=(4,), critic_hidden=(8,), batch_size=16, discount=0.9, gae_lambda=0.8).resolve(SPEC, 10)


def actor_and_rows(seed=0, rows=40):
    actor = Actor(MLP.create(3, (4,), 2, jax.random.key(seed), activation="tanh"), jnp.array([-0.7, 0.2]))
    return actor, jax.random.normal(jax.random.key(seed + 1), (rows, 3))


def dense_fisher(actor, seen):
    """E[grad log pi grad log pi^T], the expectation over actions done exactly: of a Gaussian it is a sum over its outputs."""
    flat, rebuilt = ravel_pytree(actor)
    outputs = lambda theta: jnp.concatenate([rebuilt(theta).net(seen).ravel(), rebuilt(theta).log_std])  # noqa: E731
    slopes = np.asarray(jax.jit(jax.jacobian(outputs))(flat), np.float64)
    means, deviations = slopes[:-2].reshape(len(seen), 2, -1), slopes[-2:]
    precision = np.exp(-2.0 * np.asarray(actor.log_std, np.float64))
    return np.einsum("nap,a,naq->pq", means, precision, means) / len(seen) + 2.0 * deviations.T @ deviations


@pytest.mark.slow
def test_fisher_products_are_those_of_the_dense_matrix_and_of_the_divergences_hessian():
    actor, seen = actor_and_rows()
    flat, rebuilt = ravel_pytree(actor)
    wanted = dense_fisher(actor, seen)
    product = jax.jit(lambda row: ravel_pytree(fisher_product(actor, seen, rebuilt(row)))[0])
    got = np.stack([product(row) for row in jnp.eye(len(flat))])
    np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-5)
    apart = lambda theta: dist.kl(actor.at(seen), rebuilt(theta).at(seen)).mean()  # noqa: E731
    np.testing.assert_allclose(jax.jit(jax.hessian(apart))(flat), wanted, rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_a_step_is_numpys_solution_and_diverges_by_half_of_delta():
    actor, seen = actor_and_rows()
    flat, rebuilt = ravel_pytree(actor)
    gradient = np.random.default_rng(0).standard_normal(len(flat)).astype(np.float32)
    damping, delta = 0.1, 1e-3
    step = jax.jit(lambda g, damping: natural_step(actor, rebuilt(g), seen, delta, damping, 60))
    moved = step(gradient, damping)
    direction = np.linalg.solve(dense_fisher(actor, seen) + damping * np.eye(len(flat)), gradient)
    length = np.sqrt(delta / (gradient @ direction))
    np.testing.assert_allclose(ravel_pytree(moved)[0] - flat, length * direction, rtol=2e-2, atol=2e-5)
    undamped = step((dense_fisher(actor, seen) @ gradient).astype(np.float32), 0.0)
    assert float(dist.kl(actor.at(seen), undamped.at(seen)).mean()) == pytest.approx(delta / 2, rel=0.05)


def block(seed=0, steps=6, copies=2):
    rng = np.random.default_rng(seed)
    seen = rng.standard_normal((steps + 1, copies, 3)).astype(np.float32)
    terminal, timeout = np.zeros((2, steps, copies), np.float32)
    timeout[3, 1] = 1.0
    rows = {
        "observation": seen[:-1], "action": 1.5 * rng.standard_normal((steps, copies, 2)).astype(np.float32),
        "reward": rng.standard_normal((steps, copies)).astype(np.float32), "next_observation": seen[1:],
        "terminal": terminal, "timeout": timeout,
    }  # fmt: skip
    return {name: jnp.asarray(column) for name, column in rows.items()}


@pytest.mark.slow
def test_demonstrations_count_less_from_step_to_step(monkeypatch):
    rows, rng = block(), np.random.default_rng(3)
    shown = {"observation": jnp.asarray(rng.standard_normal((5, 3)), jnp.float32),
             "action": jnp.asarray(rng.uniform(-1, 1, (5, 2)), jnp.float32)}  # fmt: skip
    state = AGENT.observing(AGENT.init(SPEC, jax.random.key(0)), rows["observation"].reshape(-1, 3))
    # In the place of the new actor the gradient that would have led to it.
    monkeypatch.setattr("deadreckon.agents.dapg.natural_step", lambda actor, gradient, *rest: gradient)
    digest = jax.jit(lambda state, shown: AGENT.digest(state, rows, shown)[0])
    standard = (shown["observation"] - state.observations.mean) / state.observations.deviation
    likelihood = jax.grad(lambda actor: log_prob(actor.at(standard), shown["action"]).sum())(state.actor)
    for steps in (0.0, 3.0):
        now = state._replace(steps=jnp.float32(steps))
        guided, alone = digest(now, shown), digest(now, None)
        assert float(guided.steps) == steps + 1
        weight = 0.1 * 0.95**steps * advantages_of(state, rows).max()
        assert float(guided.told["demonstrations"]) == pytest.approx(weight, rel=1e-4)
        assert float(alone.told["demonstrations"]) == 0.0
        for a, b, g in zip(*map(jax.tree.leaves, (guided.actor.net, alone.actor.net, likelihood.net)), strict=True):
            np.testing.assert_allclose(a - b, weight * g / 12, rtol=1e-3, atol=1e-5)


def advantages_of(state, rows):
    """By hand, standardised over the block."""
    now, following = (np.asarray(AGENT.value(state, rows[name])) for name in ("observation", "next_observation"))
    out, later = np.zeros((6, 2)), np.zeros(2)
    for t in reversed(range(6)):
        goes_on = 1.0 - np.asarray(rows["timeout"][t])
        later = np.asarray(rows["reward"][t]) + 0.9 * following[t] - now[t] + goes_on * 0.72 * later
        out[t] = later
    return (out - out.mean()) / out.std()


@pytest.mark.slow
def test_without_demonstrations_likelier_are_the_better_actions():
    rows = block()
    state = AGENT.observing(AGENT.init(SPEC, jax.random.key(0)), rows["observation"].reshape(-1, 3))
    digest = jax.jit(AGENT.digest)
    new, columns = digest(state, rows)
    assert set(columns) == set(AGENT.digests)
    assert float(new.told["improvement"]) > 0.0
    assert float(new.told["kl"]) == pytest.approx(AGENT.delta / 2, rel=0.3)
    low = state._replace(actor=state.actor._replace(log_std=jnp.full(2, -9.0)))
    assert float(digest(low, rows)[0].actor.log_std.min()) >= LOG_STD_MIN


def test_a_clone_speaks_in_actions_and_deviates_as_it_errs():
    rng = np.random.default_rng(1)
    shown = {"observation": rng.normal(2.0, 3.0, (50, 3)).astype(np.float32),
             "action": rng.uniform(-0.5, 0.5, (50, 2)).astype(np.float32)}  # fmt: skip
    center, spread = np.array([0.1, -0.2], np.float32), np.array([0.3, 0.5], np.float32)
    cloning = Cloning(1e-3, moments(shown["observation"]), center, spread, (4,))
    clone = jax.jit(lambda key: cloning.init(SPEC, key))(jax.random.key(0))
    batch = Batch(observation=shown["observation"][:7], action=shown["action"][:7])
    seen = (batch.observation - shown["observation"].mean(0)) / shown["observation"].std(0)
    _, metrics = jax.jit(lambda clone: cloning.update(clone, batch, step=0, key=jax.random.key(1)))(clone)
    means = jax.jit(lambda clone: cloning.means(clone))(clone)
    of = jax.jit(lambda net, seen: net(seen))
    own = np.asarray(of(clone.net, seen))
    np.testing.assert_allclose(of(means, seen), own * spread + center, rtol=1e-5, atol=1e-6)
    error = (own - (shown["action"][:7] - center) / spread) ** 2
    assert float(metrics["behavior_error"]) == pytest.approx(float(error.mean()), rel=1e-5)
    state = Compiled(AGENT).observing(begun(AGENT, SPEC), shown["observation"])
    off = of(means, (shown["observation"] - shown["observation"].mean(0)) / shown["observation"].std(0)) - shown["action"]
    acting = jax.jit(lambda state: AGENT.begun(state, means, shown).actor)(state)
    np.testing.assert_allclose(np.exp(acting.log_std), np.sqrt((np.asarray(off) ** 2).mean(0)), rtol=1e-3)
    as_shown = jax.jit(lambda state: AGENT.replace(init_std="demonstrated").begun(state, means, shown).actor)(state)
    np.testing.assert_allclose(np.exp(as_shown.log_std), shown["action"].std(0), rtol=1e-3)


def test_the_first_policy_errs_as_the_clone_did():
    """Also where an observation varies by little, of which batches that are standardised for other agents make less."""
    rng = np.random.default_rng(2)
    shown = Dataset.from_arrays(
        observations=rng.normal(2.0, (3.0, 2e-3, 1e-4), (50, 3)), actions=rng.uniform(-0.5, 0.5, (50, 2)), rewards=np.zeros(50),
        timeouts=np.arange(50) == 49, final_observations=np.zeros((1, 3)), action_space=SPEC.action, name="shown",
    )  # fmt: skip
    observation, action = jnp.asarray(shown.observations), jnp.asarray(shown.actions)
    cloning = Cloning(1e-3, moments(observation), action.mean(0), action.std(0), (4,))
    batch = Batch(**TransitionSource(shown, cloning.needs(shown.spec)).take(np.arange(50)))
    clone = jax.jit(lambda key: cloning.init(SPEC, key))(jax.random.key(0))
    _, metrics = jax.jit(lambda clone: cloning.update(clone, batch, step=0, key=jax.random.key(1)))(clone)
    state = Compiled(AGENT).observing(begun(AGENT, SPEC), observation)
    given = {"observation": observation, "action": action}
    first = jax.jit(lambda state: AGENT.policy(AGENT.begun(state, cloning.means(clone), given)))
    off = (first(state).actions(observation, jax.random.key(0), greedy=True) - action) / action.std(0)
    assert float(metrics["behavior_error"]) == pytest.approx(float(jnp.square(off).mean()), rel=1e-4)


@pytest.mark.slow
def test_the_policy_is_the_actor_on_raw_observations():
    rows = block()
    state = AGENT.observing(AGENT.init(SPEC, jax.random.key(0)), 3.0 + rows["observation"].reshape(-1, 3))
    seen, action = rows["observation"][0], rows["action"][0]
    policy, actor = AGENT.policy(state), state.actor.at((seen - state.observations.mean) / state.observations.deviation)
    np.testing.assert_allclose(policy.pre_actions(seen, jax.random.key(0), greedy=True), actor.mean, rtol=1e-4, atol=1e-5)
    constant = -jnp.log(2 * jnp.pi)
    np.testing.assert_allclose(policy.log_prob(seen, action), log_prob(actor, action) + constant, rtol=1e-4)


MAZE = task("maze2d-umaze-dense")
SETTINGS = Online(copies=4, explore=8, updates_per_step=0.25, block=80)


def run(out, steps, shown=None, **fields):
    agent = DAPG(hidden=(8,), critic_hidden=(8,), batch_size=16, bc_steps=300, bc_lr=1e-2, **fields)
    return dr.train_online(
        agent, MAZE, steps=steps, settings=SETTINGS, demonstrations=shown, evaluate_every=80, episodes=1, chunk=20,
        out=out, resume=True, threads=1,
    )  # fmt: skip


@pytest.mark.slow
def test_a_run_begins_with_a_clone_and_goes_on_where_it_stopped(tmp_path):
    shown, still = demonstrations(MAZE, 3), {"delta": 1e-6}  # steps of next to nothing keep the clone as it is
    whole = run(tmp_path / "whole", 8 + 240, shown, **still)
    run(tmp_path / "part", 8 + 80, shown, **still)
    again = run(tmp_path / "part", 8 + 240, shown, **still)
    assert np.isin(shown.episode_ids, whole.taught).all()
    assert len(whole.taught) > shown.episodes  # its own steps, too
    seen = shown.observations[:50]
    np.testing.assert_array_equal(whole.policy(seen), again.policy(seen))
    policies = [dr.policies.load(path) for path in sorted((tmp_path / "whole" / "policies").glob("00*"))]
    # Before anything a mean of nearly nothing; then what was shown.
    off = [float(np.square(np.clip(p(shown.observations), -1, 1) - shown.actions).mean()) for p in policies]
    assert len(off) == 4
    assert off[1] < 0.5 * off[0]
    assert whole.config["demonstrations"]["rows"] == 3 * MAZE.horizon
    assert set(whole.metrics.to_pydict()) >= {"critic_loss", "kl", "improvement", "demonstrations", "deviation", "reward"}
    with pytest.raises(UserError, match="holds another run: demonstrations"):
        run(tmp_path / "part", 8 + 240, **still)


@pytest.mark.slow
def test_actions_beyond_the_bounds_are_learned_from_as_drawn():
    agent = DAPG(hidden=(8,), batch_size=16).resolve(Spec.empty((4,), MAZE.action_space, MAZE.name), 20)
    experience = Demonstrated(MAZE, agent, [0], 20, SETTINGS, threads=1)
    job = Fit([agent], experience, [0], 20, 20)
    states, data = experience.extend(job.learner, job.states, job.roots, 0)
    drawn = np.asarray(experience.last(80)["action"])
    assert np.abs(drawn).max() > 1.5  # of a normal with deviation one
    assert float(states.steps[0]) == 1.0
    assert data["packed"].shape == (1, 80, 4 + 1)


def test_refusals(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="PPO takes no demonstrations"):
        dr.train_online("ppo", MAZE, steps=5000, demonstrations=demonstrations(MAZE, 1), out="nowhere")
    with pytest.raises(UserError, match="maze2d-umaze-dense-planner has observations \\(4,\\) and 2 actions, hopper has"):
        dr.train_online("dapg", "hopper", steps=50_000, demonstrations=demonstrations(MAZE, 1), out="nowhere")
    with pytest.raises(UserError, match="trains by acting in a simulator"):
        DAPG().resolve(demonstrations(MAZE, 1).spec, 10)


def test_a_lane_whose_cloning_diverges_stops_and_the_other_goes_on(tmp_path):
    shown = demonstrations(MAZE, 1)
    sizes = {"hidden": (8,), "critic_hidden": (8,), "batch_size": 16, "bc_steps": 10}
    agents = [DAPG(**sizes, bc_lr=rate) for rate in (1e-2, 1e30)]
    options = {"steps": 88, "settings": SETTINGS, "demonstrations": shown, "episodes": 1, "chunk": 20, "threads": 1}
    with pytest.warns(UserWarning, match="seed 1: cloning .* gave numbers that are not finite; lower bc_lr"):
        found = dr.train_online(agents, MAZE, seeds=2, out=tmp_path / "run", **options)
    assert found.failures[0] is None
    assert found.failures[1] is not None
    assert np.isfinite(found.policies[0](shown.observations[:5])).all()
    with pytest.raises(DivergedError, match="behavior_error: cloning"):
        dr.train_online(agents[1], MAZE, out=tmp_path / "bad", **options)


@pytest.mark.slow
def test_the_command_takes_demonstrations_from_a_file(tmp_path):
    write_hdf5(demonstrations(MAZE, 2), tmp_path / "shown.hdf5")
    words = ["train", "--agent", "dapg", "--online", "--task", MAZE.name, "--demonstrations", str(tmp_path / "shown.hdf5")]
    sizes = ["--copies", "4", "--explore", "8", "--block", "64", "--steps", "72", "--agent.hidden", "8"]
    assert main([*words, *sizes, "--agent.clone-steps", "20", "--episodes", "1", "--out", str(tmp_path / "run")]) == 0
    assert dr.load_run(tmp_path / "run").config["demonstrations"]["rows"] == 2 * MAZE.horizon


@pytest.mark.slow
def test_it_learns_the_pendulum_without_demonstrations(tmp_path):
    settings = Online(copies=20, explore=200, updates_per_step=2 / 64, block=3200)
    found = dr.train_online(
        DAPG(), "inverted-pendulum", steps=200 + 30 * 3200, settings=settings, evaluate_every=30 * 3200, episodes=5,
        out=tmp_path / "run",
    )  # fmt: skip
    returns = found.evaluations.to_pydict()
    last = [r for r, s in zip(returns["return"], returns["step"]) if s == max(returns["step"])]
    assert np.mean(last) > 800
