"""Agents that choose among discrete actions: their losses against numpy, and that they learn, act and are saved."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import log_softmax, logsumexp, softmax

from deadreckon.agents import AGENTS, BC, BCQ, CQL, IQL, agent_class
from deadreckon.agents.rem import simplex
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP, q_values
from deadreckon.ope.tables import Actor
from deadreckon.policies import EnvPolicy, store
from deadreckon.policies.candidates import ThresholdedPolicy, probable_enough
from deadreckon.policies.deployed import first_actions
from deadreckon.policies.kinds import Categorical
from deadreckon.policies.portable import load as load_portable
from deadreckon.randomness import key_for
from deadreckon.training.fit import Fit, fit
from tests.agents.test_bear import lane
from tests.agents.worlds import corridor
from tests.nets.test_mlp import numpy_mlp

KEY = jax.random.key(5)
NAMES = [name for name in AGENTS if agent_class(name).supports_discrete]

LOG = corridor(actions="choices")


@pytest.fixture(scope="module")
def batch():
    rng = np.random.default_rng(0)
    return Batch(
        observation=jnp.asarray(rng.normal(size=(6, 1)), jnp.float32), action=jnp.asarray([0, 2, 1, 1, 0, 2], jnp.int32),
        reward=jnp.asarray(rng.normal(size=6)), next_observation=jnp.asarray(rng.normal(size=(6, 1)), jnp.float32),
        terminal=jnp.asarray([0.0, 1.0, 0.0, 0.0, 1.0, 0.0]),
    )  # fmt: skip


def small(name, **fields):
    own = {"behavior_hidden": (16, 16)} if name == "bcq" else {}
    return agent_class(name)(**{"hidden": (16, 16), "batch_size": 64} | own | fields).resolve(LOG.spec, 100)


def started(name, **fields):
    agent = small(name, **fields)
    return agent, agent.init(LOG.spec, jax.random.key(0))


def values(critics, seen):
    return np.stack([numpy_mlp(lane(critics, j), np.asarray(seen)) for j in range(len(critics.biases[0]))])


def future(batch, value):
    return np.asarray(batch.reward) + 0.9 * (1 - np.asarray(batch.terminal)) * value


def test_which_agents_choose():
    assert {"bc", "cql", "bcq", "rem", "iql"} <= set(NAMES)


# ---- losses


@pytest.mark.slow
def test_q_values_of_choices(batch):
    _, state = started("iql")
    expected = values(state.critics, batch.observation)[:, np.arange(6), np.asarray(batch.action)]
    np.testing.assert_allclose(q_values(state.critics, batch.observation, batch.action), expected, atol=1e-5)


def test_iql_imitates_choices_by_advantage(batch):
    agent, state = started("iql", beta=2.0)
    advantage = np.linspace(-1, 1, 6)
    log_prob = log_softmax(numpy_mlp(state.actor.net, np.asarray(batch.observation)), -1)
    log_prob = log_prob[np.arange(6), np.asarray(batch.action)]
    loss = agent.actor_loss(state.actor, batch, jnp.asarray(advantage))
    np.testing.assert_allclose(loss, -(np.exp(2 * advantage) * log_prob).mean(), rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("entropy_backup", [False, True])
def test_cql_is_sac_with_means_over_all_choices(batch, entropy_backup):
    agent, state = started("cql", discount=0.9, temperature=0.3, entropy_backup=entropy_backup, cql_weight=2.0)
    log_prob = log_softmax(numpy_mlp(state.actor.net, np.asarray(batch.next_observation)), -1)
    q = values(state.target_critics, batch.next_observation).min(0)
    value = (np.exp(log_prob) * (q - 0.3 * entropy_backup * log_prob)).sum(-1)
    target = agent.target(state, batch, KEY)
    np.testing.assert_allclose(target, future(batch, value), atol=1e-5)

    q = values(state.critics, batch.observation)
    logged = q[:, np.arange(6), np.asarray(batch.action)]
    expected = ((logged - np.asarray(target)) ** 2).mean(-1).sum() + 2.0 * (logsumexp(q, -1) - logged).mean(-1).sum()
    loss, _ = agent.critic_loss(state.critics, state, batch, target, KEY)
    np.testing.assert_allclose(loss, expected, rtol=1e-4)

    log_prob = log_softmax(numpy_mlp(state.actor.net, np.asarray(batch.observation)), -1)
    loss, mean = agent.actor_loss(state.actor, state, batch, KEY)
    np.testing.assert_allclose(loss, (np.exp(log_prob) * (0.3 * log_prob - q.min(0))).sum(-1).mean(), rtol=1e-4)
    np.testing.assert_allclose(mean, (np.exp(log_prob) * log_prob).sum(-1).mean(), rtol=1e-4)


def test_cql_rho_weighs_the_policys_choices_by_their_worth(batch):
    agent, state = started("cql", form="rho", cql_weight=1.0)
    q = values(state.critics, batch.observation)
    weight = softmax(q + log_softmax(numpy_mlp(state.actor.net, np.asarray(batch.observation)), -1), -1)
    gap = (weight * q).sum(-1) - q[:, np.arange(6), np.asarray(batch.action)]
    _, metrics = agent.critic_loss(state.critics, state, batch, jnp.zeros(6), KEY)
    np.testing.assert_allclose(metrics["gap"], gap.mean(), atol=1e-5)


@pytest.mark.slow
def test_rem_is_q_learning_on_mixtures_of_heads(batch):
    agent, state = started("rem", discount=0.9, heads=4)
    weight = np.asarray(simplex(key_for(KEY, "weights"), 4))
    heads = lambda critic, seen: numpy_mlp(critic, np.asarray(seen)).reshape(6, 4, 3)  # noqa: E731
    mixed = np.einsum("k,bkn->bn", weight, heads(state.target_critics, batch.next_observation))
    weights, target = agent.target(state, batch, KEY)
    np.testing.assert_allclose(target, future(batch, mixed.max(-1)), atol=1e-5)
    now = heads(state.critics, batch.observation)[np.arange(6), :, np.asarray(batch.action)]
    loss, _ = agent.critic_loss(state.critics, state, batch, (weights, target), KEY)
    np.testing.assert_allclose(loss, np.square(now @ weight - target).mean(), rtol=1e-4)
    np.testing.assert_allclose(agent.q_value(state, batch.observation, batch.action), now.mean(1), atol=1e-5)
    policy, best = agent.policy(state), heads(state.critics, batch.observation).mean(1).argmax(-1)
    np.testing.assert_array_equal(policy.probs(batch.observation), np.eye(3)[best])


@pytest.mark.slow
@pytest.mark.parametrize("layer_norm", [False, True])
def test_rems_policy_survives_its_file(batch, layer_norm, tmp_path):
    """The mean of the heads is one network, which the file and the NumPy player have too."""
    agent, state = started("rem", heads=4, layer_norm=layer_norm)
    seen = np.linspace(-2, 2, 101, dtype=np.float32)[:, None]
    mean = lambda critic: agent.head_values(critic, jnp.asarray(seen), None).mean(1)  # noqa: E731
    # No action is the best everywhere.
    level = [*state.critics.biases[:-1], state.critics.biases[-1] - jnp.tile(mean(state.critics).mean(0), 4)]
    state = state._replace(critics=replace(state.critics, biases=tuple(level)))
    np.testing.assert_allclose(agent.policy(state).values(jnp.asarray(seen)), mean(state.critics), atol=1e-5)
    policy = EnvPolicy.of(agent.policy(state), TransitionSource(LOG, agent.needs(LOG.spec)).view)
    assert len(set(policy(seen))) > 1
    store.save(tmp_path / "p.npz", policy)
    np.testing.assert_array_equal(store.load(tmp_path / "p.npz")(seen), policy(seen))
    np.testing.assert_array_equal(load_portable(tmp_path / "p.npz")(seen), policy(seen))


def test_bcq_takes_the_best_of_what_is_likely_enough(batch):
    agent, state = started("bcq", discount=0.9, threshold=0.98)
    chances = softmax(numpy_mlp(state.behavior.net, np.asarray(batch.next_observation)), -1)
    likely = chances >= 0.98 * chances.max(-1, keepdims=True)
    assert likely.any(-1).all()
    assert not likely.all()
    q = values(state.target_critics, batch.next_observation)
    mixed = np.where(likely, 0.75 * q.min(0) + 0.25 * q.max(0), -np.inf)
    np.testing.assert_allclose(agent.target(state, batch, KEY), future(batch, mixed.max(-1)), atol=1e-5)
    policy = agent.policy(state)
    seen = batch.observation
    best = np.where(probable_enough(state.behavior, 0.98, seen), values(state.critics, seen)[0], -np.inf).argmax(-1)
    assert isinstance(policy, ThresholdedPolicy)
    np.testing.assert_array_equal(policy.probs(seen).argmax(-1), best)


def test_what_is_not_for_choices_says_so():
    with pytest.raises(UserError, match="EDAC needs continuous actions"):
        agent_class("edac")().resolve(LOG.spec, 10)
    with pytest.raises(UserError, match=r"BC.model: of discrete actions .* leave 'vae' out"):
        BC(model="vae").resolve(LOG.spec, 10)
    with pytest.raises(UserError, match="CQL.max_target_backup takes the best of sampled actions, .*; leave it out"):
        CQL(max_target_backup=True).resolve(LOG.spec, 10)


def test_entropy_of_choices_is_a_tenth_of_the_most():
    np.testing.assert_allclose(CQL().resolve(LOG.spec, 10).target_entropy, 0.1 * np.log(3))
    assert BCQ.supports_discrete
    assert IQL.supports_discrete


# ---- policies


def test_a_categorical_draws_by_its_chances_and_tells_them():
    net = MLP((jnp.zeros((1, 3)),), (jnp.log(jnp.asarray([0.2, 0.5, 0.3])),))
    policy = EnvPolicy.of(Categorical(net), TransitionSource(LOG, small("bc").needs(LOG.spec)).view)
    seen = np.zeros((6000, 1), np.float32)
    assert policy(seen).dtype == np.int32
    assert (policy(seen) == 1).all()
    np.testing.assert_allclose(policy.action_probs(seen[:2]), [[0.2, 0.5, 0.3]] * 2, rtol=1e-5)
    drawn = np.asarray(first_actions(policy, jnp.asarray(seen), KEY, False))
    np.testing.assert_allclose(np.bincount(drawn) / 6000, [0.2, 0.5, 0.3], atol=0.03)
    log_prob = policy.inner.log_prob(jnp.zeros((2, 1)), jnp.asarray([0, 2]))
    np.testing.assert_allclose(log_prob, np.log([0.2, 0.3]), rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_learns_the_line_resumes_and_survives_its_file(name, tmp_path):
    """The best is to go to the middle. BC copies what was done at random, so it is told what others would do."""
    log = LOG
    if name == "bc":
        to_middle = np.where(np.abs(LOG.observations[:, 0]) < 0.1, 1, np.where(LOG.observations[:, 0] < 0, 2, 0))
        log = Dataset.from_arrays(
            observations=LOG.observations, actions=to_middle, rewards=LOG.rewards, timeouts=LOG.timeouts,
            action_space=Discrete(3), final_observations=LOG.final_observations,
        )  # fmt: skip
    agent = small(name)
    names = {"actor_lr", "critic_lr", "lr", "behavior_lr"} & {f for f in vars(agent)}
    agent = agent.replace(**{n: 1e-3 for n in names}, **({} if name == "bc" else {"discount": 0.9}))
    if "actor_decay_steps" in vars(agent):  # of the 2,000 updates below
        agent = agent.replace(actor_decay_steps=2000.0)
    if name in ("iql", "xql"):
        agent = agent.replace(beta=10.0)
    if name == "cql":
        agent = agent.replace(cql_weight=0.1)
    rows = TransitionSource(log, agent.needs(log.spec))
    job = Fit([agent, agent], rows, [0, 1], 2000, 500, tmp_path / "run")
    walk = job.chunks()
    next(walk), next(walk)
    walk.close()
    again = Fit([agent, agent], rows, [0, 1], 2000, 500, tmp_path / "run")
    again.resume()
    assert again.step == 500
    for _ in again.chunks():
        pass
    assert tuple(again.failures) == (None, None)
    once = fit([agent, agent], rows, [0, 1], 2000, chunk=500)
    for a, b in zip(jax.tree.leaves(again.states), jax.tree.leaves(once.states), strict=True):
        np.testing.assert_array_equal(a, b)

    policy = EnvPolicy.of(agent.policy(once.lane(0)), rows.view)
    s = np.concatenate([np.linspace(-1, -0.2, 20), np.linspace(0.2, 1, 20)]).astype(np.float32)[:, None]
    assert (policy(s) == np.where(s[:, 0] < 0, 2, 0)).mean() > 0.9
    store.save(tmp_path / "p.npz", policy)
    np.testing.assert_array_equal(store.load(tmp_path / "p.npz")(s), policy(s))
    np.testing.assert_array_equal(load_portable(tmp_path / "p.npz")(s), policy(s))
    chances = Actor([policy], ["it"], log.spec, False, 0).table(s, 1, "any")[:, 0]
    np.testing.assert_allclose(chances, policy.action_probs(s), atol=1e-6)
