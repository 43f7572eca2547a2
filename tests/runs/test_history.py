"""Histories from training to judgement, in a world whose single observations do not tell the state.

An episode has two steps. The first shows a cue of 1 or -1, each half of the time; its action 1 puts a coin aside. The second
shows zero, whatever happened: it pays 1 where the action is 1 after the cue 1 or 0 after the cue -1, and 0.5 for the coin. At a
discount of 0.9 the best policy of two steps is worth 0.9 (1 + 0.5) = 1.35, the best memoryless one 0.9 (0.5 + 0.5) = 0.9.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import deadreckon as dr
from deadreckon.data.spec import Discrete
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.ope import LinearFQE, OPEInput
from deadreckon.policies import BlackBoxPolicy
from deadreckon.policies.deployed import history_of
from deadreckon.runs.offline import judge
from deadreckon.runs.run import load
from deadreckon.runs.train import train

DISCOUNT, BEST, MEMORYLESS = 0.9, 1.35, 0.9
AGENT = dr.agents.CQL(hidden=(16,), batch_size=64, cql_weight=0.0, discount=DISCOUNT, critic_lr=3e-3, tau=0.05)
OPTIONS = {"steps": 600, "chunk": 300, "task": False, "holdout": 0.5}
ALWAYS = BlackBoxPolicy(
    lambda seen, rng: np.ones(len(seen), int), action_probs=lambda seen: np.tile(np.float32([0, 1]), (len(seen), 1))
)


def paid(cue, coin, action):
    """The second reward."""
    return (action == (cue > 0)) + 0.5 * coin


def cued(episodes=800, seed=0):
    """A log of actions by chance."""
    rng = np.random.default_rng(seed)
    cue, done = rng.choice([-1.0, 1.0], episodes), rng.integers(0, 2, (episodes, 2))
    rewards = np.stack([np.zeros(episodes), paid(cue, done[:, 0], done[:, 1])], 1)
    return dr.Dataset.from_arrays(
        observations=np.stack([cue, np.zeros(episodes)], 1).reshape(-1, 1), actions=done.ravel(), rewards=rewards.ravel(),
        terminals=np.tile([False, True], episodes), action_space=Discrete(2), name="cued",
        user=np.repeat(np.arange(episodes), 2),
    )  # fmt: skip


def worth(policy):
    """The exact value of a greedy policy, whose episodes begin with either cue."""
    cue = np.float32([-1, 1])
    step = lambda seen, first: Step(jnp.asarray(seen[:, None]), jnp.zeros(2), jnp.full(2, first))  # noqa: E731
    coin, carry = policy.act(step(cue, True), policy.start(2), jax.random.key(0), greedy=True)
    last, _ = policy.act(step(0 * cue, False), carry, jax.random.key(0), greedy=True)
    return DISCOUNT * paid(cue, np.asarray(coin), np.asarray(last)).mean()


@pytest.fixture(scope="module")
def log():
    return cued()


@pytest.fixture(scope="module")
def run(log, tmp_path_factory):
    return train(AGENT, log, out=tmp_path_factory.mktemp("runs") / "h2", history=2, **OPTIONS)


@pytest.mark.slow
def test_two_steps_teach_what_one_does_not(run):
    assert run.config["history"] == 2
    assert history_of(run.policy) == 2
    assert worth(run.policy) == pytest.approx(BEST)


@pytest.mark.slow  # a bound that holds for every policy of one step
def test_one_step_teaches_no_more_than_a_memoryless_policy_is_worth(log, tmp_path):
    alone = train(AGENT, log, out=tmp_path / "h1", **OPTIONS)
    assert "history" not in alone.config
    assert worth(alone.policy) <= MEMORYLESS + 1e-6


@pytest.mark.slow
def test_estimates_see_the_state_where_policies_remember(log, run):
    """A memoryless policy too is judged rightly beside one that remembers, and wrongly alone: the coin is hidden then."""
    ask = {"discount": DISCOUNT, "greedy": True}
    both = OPEInput(log, [run.policy, ALWAYS], **ask)
    value = LinearFQE().on(both).value
    truth = DISCOUNT * (0.5 + 0.5)
    assert value[0] == pytest.approx(BEST, abs=0.03)
    assert value[1] == pytest.approx(truth, abs=0.05)
    alone = LinearFQE().on(OPEInput(log, [ALWAYS], **ask)).value[0]
    assert alone == pytest.approx(DISCOUNT * (0.5 + 0.25), abs=0.05)


def test_policies_of_fewer_steps_act_on_the_newest(log, run):
    """Beside one of two steps, a policy of the observation is shown the second step's zero, and not the cue before it."""
    shy = lambda seen: np.eye(2, dtype=np.float32)[(np.asarray(seen)[:, 0] != 0).astype(int)]  # noqa: E731
    memoryless = BlackBoxPolicy(lambda seen, rng: shy(seen).argmax(1), action_probs=shy)
    case = OPEInput(log, [run.policy, memoryless], discount=DISCOUNT, greedy=True)
    done = case.actor.table(case.data.observations, 1, "any")[:, 1].argmax(1)
    np.testing.assert_array_equal(done, np.tile([1, 0], log.episodes))


@pytest.mark.slow
def test_judged_on_held_out_episodes_as_any_other(log, run):
    found = judge(run, log, [LinearFQE()], discount=DISCOUNT, greedy=True, counted=False, accept_model_based=True)
    assert found.estimates[0].value[0] == pytest.approx(BEST, abs=0.05)
    other = cued(300, seed=5)
    new = judge(run, other, [LinearFQE()], discount=DISCOUNT, greedy=True, counted=False, unseen=True)
    assert new.estimates[0].value[0] == pytest.approx(BEST, abs=0.1)


@pytest.mark.slow
def test_cross_fits_and_resumed_runs_keep_their_history(log, run, tmp_path):
    with pytest.raises(UserError, match="history was 2, now None"):
        train(AGENT, log, out=run.path, resume=True, **OPTIONS)
    train(AGENT, log, out=run.path, resume=True, history=2, **OPTIONS)
    assert history_of(load(run.path).policy) == 2
    crossed = dr.cross_fit(AGENT, log, folds=2, out=tmp_path / "c", history=2, steps=20, chunk=20, task=False)
    assert history_of(crossed.policy) == 2
    found = judge(crossed, log, ["dr-linear"], discount=DISCOUNT, greedy=True, counted=False)
    assert np.isfinite(found.estimates[0].value).all()


@pytest.mark.parametrize(("agent", "words"), [
    ("decision_transformer", "DecisionTransformer takes no histories: it takes the last steps already, see context_length"),
    ("mopo", "MOPO takes no histories: its model predicts single observations"),
])  # fmt: skip
def test_agents_with_a_past_or_a_model_of_their_own_refuse(agent, words, log, tmp_path):
    with pytest.raises(UserError, match=words):
        train(agent, log, out=tmp_path / "r", history=2, **OPTIONS)
    with pytest.raises(UserError, match="history must be >= 1, got 0"):
        train(AGENT, log, out=tmp_path / "r", history=0, **OPTIONS)
    assert not (tmp_path / "r" / "run.json").exists()


def test_policies_of_other_logs_are_refused(run):
    wide = dr.Dataset.from_arrays(
        observations=np.zeros((20, 2)), actions=np.arange(20) % 2, rewards=np.zeros(20), terminals=np.ones(20),
        action_space=Discrete(2),
    )  # fmt: skip
    with pytest.raises(UserError, match="acts on histories of observations of 1 number"):
        OPEInput(wide, [run.policy], discount=DISCOUNT)
