"""One suite for every agent: shapes, determinism, lanes, resume, bad numbers, save and load, field rules.

Compile time is the budget: one small program an agent (2 lanes, 16 wide), which all tests but the slow ones run, and the golden
numbers of offline agents too.
"""

import dataclasses
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.agents import agent_class
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.tables import Actor
from deadreckon.policies import EnvPolicy, store
from deadreckon.policies.file import numpy_player, read_policy
from deadreckon.policies.portable import load as load_portable
from deadreckon.training.fit import Fit, fit
from tests import golden
from tests.agents.tiny import LOG, OWN, assert_function_of_state, rows_of, small


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


STEPS, CHUNK = 9, 4  # of a run; compiling takes longer
# Fast; streaming is the loop's and not the agent's, and a program of its own. As the fast tests compile them, the two programs
# of most other agents (such as IQL, AWAC and BEAR) differ in the last bit.
STREAMED = ("bc", "td3_bc")


# Their programs take seconds to compile, and most of their code is that of others, which run among the fast tests.
SLOW = {"abm", "algae_dice", "bear_is", "cal_ql", "combo", "crr_d", "kl_control", "mobile", "rlpd", "sac_n"}
AGENTS = [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in golden.OFFLINE]


@pytest.mark.parametrize("name", AGENTS)
def test_numbers_are_as_before(name):
    told = golden.problem_of(f"agents/{name}")
    assert told is None, told


# Numbers that the small agents are asked to do without: None leaves a term out.
LEFT_OUT = {(agent_class(name), field) for name, own in OWN.items() for field, value in own.items() if value is None}


@pytest.fixture(scope="session", params=AGENTS)
def trained(request):
    """(agent, rows, fit of two lanes, metrics by chunk)."""
    agent = small(request.param)
    rows = rows_of(agent)
    seen = []
    result = fit([agent, agent], rows, [0, 1], STEPS, chunk=CHUNK, on_chunk=seen.append)
    return agent, rows, result, seen


@pytest.mark.parametrize("name", golden.OFFLINE)
def test_observations_are_standardised_where_it_is_asked_for(name):
    agent = agent_class(name)
    if name != "decision_transformer":  # which always does
        assert agent(standardise=True).needs(LOG.spec).standardise
        assert not agent(standardise=False).needs(LOG.spec).standardise


def test_trains_with_finite_metrics_under_fixed_names(trained):
    agent, rows, result, seen = trained
    assert result.step == STEPS
    assert result.failures == (None, None)
    assert len(seen) == 3
    assert len({tuple(p.metrics) for p in seen}) == 1
    assert all(np.isfinite(v).all() and v.shape == (2,) for p in seen for v in p.metrics.values())
    assert not same(result.lane(0), result.lane(1))


def test_same_seed_same_bits_whatever_the_chunks(trained):
    agent, rows, result, _ = trained
    again = fit([agent, agent], rows, [0, 1], STEPS, chunk=7)
    assert same(result.states, again.states)


@pytest.mark.slow
def test_a_lane_equals_the_single_run_within_tolerance(trained):
    agent, rows, result, _ = trained
    alone = fit([agent], rows, [1], STEPS, chunk=CHUNK)
    for a, b in zip(jax.tree.leaves(alone.lane(0)), jax.tree.leaves(result.lane(1)), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize(
    "trained", [pytest.param(n, marks=() if n in STREAMED else pytest.mark.slow) for n in golden.OFFLINE], indirect=True
)
def test_streamed_equals_resident_bit_for_bit(trained):
    agent, rows, result, _ = trained
    streamed = fit([agent, agent], rows, [0, 1], STEPS, chunk=CHUNK, stream=True)
    assert same(result.states, streamed.states)


def test_resume_is_bit_for_bit(trained, tmp_path):
    agent, rows, result, _ = trained
    first = Fit([agent, agent], rows, [0, 1], STEPS, CHUNK, tmp_path)
    # A weak type becomes strong when it is updated, for which the program would be compiled anew.
    assert not any(getattr(leaf, "weak_type", False) for leaf in jax.tree.leaves(first.states))
    walk = first.chunks()
    next(walk)
    next(walk)  # the checkpoint of the first chunk is written, that of the second is not
    walk.close()
    second = Fit([agent, agent], rows, [0, 1], STEPS, CHUNK, tmp_path)
    second.resume()
    assert second.step == CHUNK
    for _ in second.chunks():
        pass
    assert same(result.states, second.states)


def test_a_lane_with_bad_numbers_stops_and_the_other_goes_on(trained, tmp_path):
    agent, rows, result, _ = trained
    name = "lr" if hasattr(agent, "lr") else "critic_lr"
    bad = agent.replace(**{name: 1e30})
    job = Fit([agent, bad], rows, [0, 1], STEPS, CHUNK, tmp_path)
    seen = list(job.chunks())
    assert job.failures[0] is None
    metric, step = job.failures[1]
    assert metric in seen[0].metrics or metric == "parameters"
    assert 0 <= step < CHUNK
    assert np.isnan(seen[-1].metrics[next(iter(seen[-1].metrics))][1])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(job.states))
    for good, alone in zip(jax.tree.leaves(job.states), jax.tree.leaves(result.states), strict=True):
        np.testing.assert_allclose(good[0], alone[0], rtol=1e-4, atol=1e-5)


def test_the_run_stops_when_no_lane_is_left(trained):
    agent, rows, *_ = trained
    name = "lr" if hasattr(agent, "lr") else "critic_lr"
    bad = agent.replace(**{name: 1e30})
    result = fit([bad, bad], rows, [0, 1], STEPS, chunk=CHUNK)
    assert all(result.failures)
    assert result.step == CHUNK


def test_settings_may_differ_along_the_lanes(trained):
    agent, rows, result, _ = trained
    name = "lr" if hasattr(agent, "lr") else "critic_lr"
    other = agent.replace(**{name: 2 * getattr(agent, name)})
    mixed = fit([agent, other], rows, [0, 0], CHUNK, chunk=CHUNK)
    assert not same(mixed.lane(0), mixed.lane(1))


def test_policy_acts_in_bounds_and_survives_its_file(trained, tmp_path):
    agent, rows, result, _ = trained
    policy = EnvPolicy.of(agent.policy(result.lane(0)), rows.view)
    observations = np.linspace(-1, 1, 9, dtype=np.float32)[:, None]
    actions = policy(observations)
    assert actions.shape == (9, 1)
    assert (np.abs(actions) <= 1).all()
    assert policy(observations[0]).shape == (1,)
    if not jax.tree.leaves(policy.start(1)):  # estimators judge what remembers nothing
        assert Actor([policy], ["it"], LOG.spec, True, 0).table(observations, 1, "any").shape == (9, 1, 1, 1)
    store.save(tmp_path / "p.npz", policy, {"note": 1})
    np.testing.assert_array_equal(store.load(tmp_path / "p.npz")(observations), actions)
    assert store.meta(tmp_path / "p.npz") == {"note": 1}
    if jax.tree.leaves(policy.start(1)):  # what remembers needs the package
        return
    play = load_portable(tmp_path / "p.npz")
    np.testing.assert_allclose(play(observations), actions, atol=1e-5)
    assert play(observations[0]).shape == (1,)
    player = numpy_player(tmp_path / "p.npz", *read_policy(tmp_path / "p.npz"))
    assert player is not None
    np.testing.assert_array_equal(player(observations), play(observations))


def test_greedy_actions_are_a_function_of_the_state(trained):
    """And of nothing else: not of the place in a batch, its size, or a key."""
    agent, rows, result, _ = trained
    policy = EnvPolicy.of(agent.policy(result.lane(0)), rows.view)
    assert_function_of_state(policy, np.linspace(-1, 1, 9, dtype=np.float32)[:, None])


def test_floats_are_traced_and_all_else_is_static(trained):
    agent, *_ = trained
    hints = typing.get_type_hints(type(agent))
    for f in dataclasses.fields(agent):
        if f.metadata.get("host"):  # the host alone reads it, whatever its type
            continue
        traced = hints[f.name] is float or hints[f.name] == float | None
        assert traced != bool(f.metadata.get("static")), f.name
        left_out = (type(agent), f.name) in LEFT_OUT
        assert left_out or not (traced and getattr(agent, f.name) is None), f"{f.name} must be resolved before lifting"


def test_refuses_what_does_not_fit(trained):
    agent, *_ = trained
    rng = np.random.default_rng(0)
    discrete = Dataset.from_arrays(observations=rng.normal(size=(9, 2)), actions=np.arange(9) % 3, rewards=np.zeros(9))
    if not agent.supports_discrete:
        with pytest.raises(UserError, match="continuous actions"):
            agent.resolve(discrete.spec, STEPS)
    images = Dataset.from_arrays(
        observations=np.zeros((4, 8, 8, 3), np.uint8), actions=rng.uniform(size=(4, 1)), rewards=np.zeros(4)
    )
    if "supports_images" in vars(type(agent)):  # pictures alone: not grey ones, nor numbers of any shape
        images = Dataset.from_arrays(
            observations=np.zeros((4, 8, 8), np.uint8), actions=rng.uniform(size=(4, 1)), rewards=np.zeros(4)
        )
    with pytest.raises(UserError, match="flat observations"):
        agent.resolve(images.spec, STEPS)
    name = "lr" if hasattr(agent, "lr") else "critic_lr"
    with pytest.raises(UserError, match=f"{name} takes a finite number"):
        agent.replace(**{name: float("nan")}).resolve(LOG.spec, STEPS)


WITHOUT_VALUES = tuple(map(agent_class, ("bc", "awr", "decision_transformer")))  # of actions


def test_value_estimates_have_one_number_a_row(trained):
    agent, rows, result, _ = trained
    q = agent.q_value(result.lane(0), jnp.zeros((5, 1)), jnp.zeros((5, 1)))
    assert (q is None) == isinstance(agent, WITHOUT_VALUES)
    assert q is None or q.shape == (5,)


# How well each must do: mean |action - best| on the line, where a random policy has about 0.8 and a constant zero 0.63.
# Everything is in the support of uniform data, so BEAR's multiplier is zero; IS-BEAR's set policy stays at the data's
# spread, and its clipped ratios bound how far the actor may go from it. BCQ's clamped latents make a part of uniform actions
# alone, so what moves them is given a longer reach.
MODELLED = {"model_hidden": (16,), "model_epochs": 30, "rollout_batch_size": 500, "refresh": 500, "actor_decay_steps": 1500.0}
LEARNERS = {
    "td3": (0.25, {}),
    "td3_bc": (0.35, {"alpha": 10.0}),
    "d4pg": (0.25, {"v_min": -12.0, "v_max": 2.0, "n_step": 1}),
    "sac": (0.25, {"temperature": 0.01}),
    "bcq": (0.25, {"max_perturbation": 0.6, "test_samples": 50}),
    "brac": (0.35, {"penalty": 0.1, "behavior_steps": 500}),
    "iql": (0.35, {"expectile": 0.9, "beta": 10.0, "actor_decay_steps": 1500.0}),
    "xql": (0.35, {"loss_temperature": 0.3, "beta": 10.0, "actor_decay_steps": 1500.0}),
    "awac": (0.35, {"temperature": 0.1}),
    "crr": (0.35, {}),
    "crr_d": (0.35, {"v_min": -12.0, "v_max": 2.0, "atoms": 51, "temperature": 0.1}),
    "abm": (0.35, {"window": 4, "samples": 10, "epsilon": 0.5, "prior_lr": 1e-3, "target_update_period": 25}),
    "rebrac": (0.35, {"actor_penalty": 0.05, "critic_penalty": 0.05}),
    "cql": (0.35, {"temperature": 0.01, "cql_weight": 0.1}),
    "sac_n": (0.25, {"temperature": 0.01, "critics": 4}),
    "edac": (0.25, {"temperature": 0.01, "critics": 4}),
    "algae_dice": (0.25, {"temperature": 0.01}),
    "awr": (0.45, {"temperature": 0.15, "max_weight": 100.0, "td_lambda": 0.5}),
    "rem": (0.25, {}),
    "kl_control": (0.25, {"target_kl": 3.0, "temperature": 0.05, "behavior_steps": 500}),
    "dqfd": (0.25, {"margin": 0.02, "margin_weight": 0.02}),
    "fql": (0.35, {"alpha": 0.1}),
    "bear": (0.25, {"warm_start": 50, "dual": False, "multiplier": 0.0, "test_action": "actor"}),
    "cal_ql": (0.35, {"temperature": 0.01, "cql_weight": 0.1, "samples": 5}),
    "rlpd": (0.25, {"temperature": 0.01}),
    "mopo": (0.35, {"temperature": 0.01, "penalty": 0.01, **MODELLED}),
    "combo": (0.35, {"temperature": 0.01, "cql_weight": 0.1, **MODELLED}),
    "morel": (0.35, {"temperature": 0.01, "threshold": 1.0, **MODELLED}),
    "mobile": (0.35, {"temperature": 0.01, "penalty": 0.1, **MODELLED}),
    "bear_is": (0.5, {"warm_start": 300, "dual": False, "multiplier": 10.0, "behavior_lr": 1e-3, "test_action": "actor"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_learns_the_corridor(name):
    most, fields = LEARNERS[name]
    agent = small(name, actor_lr=1e-3, critic_lr=1e-3, discount=0.9, **fields)
    result = fit([agent], rows_of(agent), [0], 1500, chunk=500)
    assert result.failures == (None,)
    policy = EnvPolicy.of(agent.policy(result.lane(0)), rows_of(agent).view)
    s = np.linspace(-1, 1, 41, dtype=np.float32)[:, None]
    assert np.abs(policy(s) - np.clip(-5 * s, -1, 1)).mean() < most


def test_bc_knows_its_models():
    with pytest.raises(UserError, match="BC.model"):
        agent_class("bc")(model="clip").resolve(LOG.spec, 10)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["gaussian", "vae", "clipped"])
def test_bc_copies_what_was_logged(model):
    """Actions that follow from the state are found again; the mean squared error falls below 1 % of their variance."""
    rng = np.random.default_rng(0)
    s = rng.uniform(-1, 1, (3000, 1))
    log = Dataset.from_arrays(
        observations=s, actions=0.7 * np.sin(3 * s), rewards=np.zeros(3000), terminals=np.ones(3000),
        action_space=LOG.action_space,
    )  # fmt: skip
    agent = agent_class("bc")(model=model, hidden=(32, 32), lr=3e-3).resolve(log.spec, 1500)
    rows = rows_of(agent, log)
    policy = EnvPolicy.of(agent.policy(fit([agent], rows, [0], 1500, chunk=500).lane(0)), rows.view)
    grid = np.linspace(-0.9, 0.9, 50, dtype=np.float32)[:, None]
    assert np.square(policy(grid) - 0.7 * np.sin(3 * grid)).mean() < 0.01 * 0.25
