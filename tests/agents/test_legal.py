"""Agents that choose among legal actions: their targets against numpy, that they never break the rule, and that they learn."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import log_softmax, logsumexp

from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.rem import simplex
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.nets.mlp import ILLEGAL, MLP
from deadreckon.policies import EnvPolicy, store
from deadreckon.policies.deployed import first_actions
from deadreckon.policies.portable import load as load_portable
from deadreckon.randomness import key_for
from deadreckon.theory import MDP, garnet
from deadreckon.training.fit import fit
from tests.agents.compiled import Compiled
from tests.agents.test_bear import lane
from tests.nets.test_mlp import numpy_mlp

KEY = jax.random.key(5)
NAMES = [name for name in AGENTS if agent_class(name).supports_discrete]
ACTIONS, DRAWS = 4, 1_000_000


@cache
def world() -> tuple[MDP, np.ndarray, Dataset]:
    """A finite world, (states, actions) what is legal in it, and a log of uniform legal actions."""
    rng = np.random.default_rng(3)
    true = garnet(states=5, actions=ACTIONS, ending=0.1, noise=0.1, seed=2)
    legal = rng.random((5, ACTIONS)) < 0.7
    legal[np.arange(5), true.optimal(0.9).argmax(1)] = False  # what would be best
    legal[np.arange(5), true.optimal(0.9).argmin(1)] = True
    seen = true.log(legal / legal.sum(1, keepdims=True), 400, 20, rng)
    columns = {key: getattr(seen, key) for key in ("observations", "actions", "rewards", "terminals", "timeouts")}
    log = Dataset.from_arrays(**columns, final_observations=seen.final_observations, legal=lambda s: legal[s.argmax(1)])
    return true, legal, log


def small(name, **fields):
    own = {"behavior_hidden": (16, 16)} if name == "bcq" else {"heads": 4} if name == "rem" else {}
    return agent_class(name)(**{"hidden": (16, 16), "batch_size": 64} | own | fields).resolve(world()[2].spec, 100)


def started(name, **fields):
    agent = small(name, **fields)
    return Compiled(agent), agent.init(world()[2].spec, jax.random.key(0))


def observed(size: int, seed: int = 0) -> np.ndarray:
    """(size, 5 + n) observations: random numbers and random masks, of which each allows something."""
    rng = np.random.default_rng(seed)
    mask = rng.random((size, ACTIONS)) < 0.4
    mask[np.arange(size), rng.integers(0, ACTIONS, size)] = True
    return np.concatenate([rng.normal(size=(size, 5)), mask], 1).astype(np.float32)


@pytest.fixture(scope="module")
def batch():
    now, after = observed(6), observed(6, 1)
    action = [int(np.flatnonzero(row[5:])[0]) for row in now]
    return Batch(
        observation=jnp.asarray(now), action=jnp.asarray(action, jnp.int32), reward=jnp.arange(6.0),
        next_observation=jnp.asarray(after), terminal=jnp.asarray([0.0, 1.0, 0.0, 0.0, 1.0, 0.0]),
    )  # fmt: skip


def masked(net: MLP, seen) -> np.ndarray:
    """What a network must give, by numpy."""
    seen = np.asarray(seen)
    return np.where(seen[:, 5:] > 0, numpy_mlp(net, seen), ILLEGAL)


def future(batch, value):
    return np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * value


def test_targets_look_at_legal_actions_alone(batch):
    agent, state = started("cql", discount=0.9, entropy_backup=True)
    q = np.min([masked(lane(state.target_critics, j), batch.next_observation) for j in range(2)], 0)
    log_prob = log_softmax(masked(state.actor.net, batch.next_observation), -1)
    temperature = np.exp(np.asarray(state.log_temperature))
    value = np.where(q > ILLEGAL / 2, np.exp(log_prob) * (q - temperature * log_prob), 0).sum(-1)
    np.testing.assert_allclose(agent.target(state, batch, KEY), future(batch, value), atol=1e-4)
    _, metrics = agent.critic_loss(state.critics, state, batch, jnp.zeros(6), KEY)
    q = np.stack([masked(lane(state.critics, j), batch.observation) for j in range(2)])
    gap = logsumexp(q, -1) - q[:, np.arange(6), np.asarray(batch.action)]
    np.testing.assert_allclose(metrics["gap"], gap.mean(), atol=1e-4)

    agent, state = started("bcq", discount=0.9, threshold=1e-6)
    q = np.stack([masked(lane(state.target_critics, j), batch.next_observation) for j in range(2)])
    value = (0.75 * q.min(0) + 0.25 * q.max(0)).max(-1)
    np.testing.assert_allclose(agent.target(state, batch, KEY), future(batch, value), atol=1e-4)

    agent, state = started("rem", discount=0.9)
    weights, target = agent.target(state, batch, KEY)
    heads = numpy_mlp(state.target_critics, np.asarray(batch.next_observation)).reshape(6, 4, ACTIONS)
    mixed = np.einsum("k,bkn->bn", np.asarray(simplex(key_for(KEY, "weights"), 4)), heads)
    value = np.where(np.asarray(batch.next_observation)[:, 5:] > 0, mixed, -np.inf).max(-1)
    np.testing.assert_allclose(target, future(batch, value), atol=1e-4)


def test_the_target_entropy_can_be_reached():
    spec = world()[2].spec
    counts = world()[1][world()[2].observations[:, :5].argmax(1)].sum(1)
    target = small("cql").target_entropy
    assert 0 < target < 0.1 * np.log(counts).mean()
    np.testing.assert_allclose(target, 0.1 * np.log(ACTIONS) * (counts.mean() - 1) / (ACTIONS - 1), rtol=1e-5)
    assert spec.mask_size == ACTIONS


@pytest.mark.parametrize("standardise", [False, True])
@pytest.mark.parametrize("name", [
    pytest.param(name, marks=() if name in ("bc", "iql", "bcq") else pytest.mark.slow) for name in NAMES
])  # fmt: skip
def test_no_draw_of_any_agent_is_illegal(name, standardise, tmp_path):
    """A million draws of networks that have learned nothing, to which illegal actions look as good as any; and their files."""
    log = world()[2]
    agent, state = started(name)
    policy = EnvPolicy.of(agent.policy(state), Normalizer.of(log.spec, standardise))
    seen = observed(DRAWS // 4, 7)
    broken = chosen = 0
    for greedy, key in ((True, 0), (False, 1), (False, 2), (False, 3)):
        drawn = np.asarray(first_actions(policy, jnp.asarray(seen), jax.random.key(key), greedy))
        broken += int((seen[np.arange(len(seen)), 5 + drawn] == 0).sum())
        chosen += len(drawn)
    assert (broken, chosen) == (0, DRAWS)
    probabilities = policy.action_probs(seen[:1000])
    assert (probabilities[seen[:1000, 5:] == 0] == 0).all()
    np.testing.assert_allclose(probabilities.sum(1), 1, atol=1e-5)
    store.save(tmp_path / "p.npz", policy)
    alone = load_portable(tmp_path / "p.npz")
    np.testing.assert_array_equal(alone(seen[:1000]), policy(seen[:1000]))
    np.testing.assert_array_equal(store.load(tmp_path / "p.npz")(seen[:1000]), policy(seen[:1000]))
    np.testing.assert_array_equal(alone(seen[:9, :5], legal=seen[:9, 5:]), policy(seen[:9, :5], legal=seen[:9, 5:]))
    drawn = alone(seen[:50_000], np.random.default_rng(0), greedy=False)
    assert (seen[np.arange(50_000), 5 + drawn] == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name != "bc"])
def test_agents_learn_the_best_legal_policy(name):
    """Nothing is known of illegal actions, which are never logged: who looks at them believes what the network makes up."""
    true, legal, log = world()
    best = np.where(legal, 0.0, -np.inf)
    for _ in range(200):  # value iteration over legal actions
        best = np.where(legal, true.rewards + 0.9 * true.transitions @ best.max(1), -np.inf)
    optimum = true.value(np.eye(ACTIONS)[best.argmax(1)], 0.9)
    uniform = true.value(legal / legal.sum(1, keepdims=True), 0.9)
    own = {"cql_weight": 0.1} if name == "cql" else {"heads": 4} if name == "rem" else {}
    agent = agent_class(name)(**{"discount": 0.9, "hidden": (64, 64), "batch_size": 64} | own).resolve(log.spec, 4000)
    rows = TransitionSource(log, agent.needs(log.spec))
    policy = EnvPolicy.of(agent.policy(fit([agent], rows, [0], 4000).lane(0)), rows.view)
    states = np.concatenate([np.eye(5), legal], 1).astype(np.float32)
    value = true.value(np.eye(ACTIONS)[policy(states)], 0.9)
    assert true.value(np.eye(ACTIONS)[true.optimal(0.9).argmax(1)], 0.9) > optimum + 1
    assert value > uniform + 0.9 * (optimum - uniform)
