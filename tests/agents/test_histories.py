"""Every agent that learns from logs acts on the last steps, or refuses to in one line."""

import jax
import numpy as np
import pytest

from deadreckon.agents import agent_class
from deadreckon.errors import UserError
from deadreckon.policies.deployed import history_of, memoryless
from deadreckon.runs.evaluate import evaluate
from deadreckon.runs.train import train
from tests import golden
from tests.agents import test_discrete
from tests.agents.tiny import LOG, small

OPTIONS = {"steps": 4, "chunk": 4, "history": 2, "task": False}


# The others differ in what they compute, not in what they see.
@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n == "bc" else pytest.mark.slow) for n in golden.OFFLINE])
def test_learns_and_acts_on_two_steps_or_says_why_not(name, tmp_path):
    agent = small(name)
    if not agent.supports_history:
        with pytest.raises(UserError, match=f"{type(agent).__name__} takes no histories: {agent.own_history}"):
            train(agent, LOG, out=tmp_path / "run", **OPTIONS)
        return
    run = train(agent, LOG, out=tmp_path / "run", **OPTIONS)
    assert run.failures == [None]
    check(run.policy, (9, 1), 3)


@pytest.mark.slow
@pytest.mark.parametrize("name", test_discrete.NAMES)
def test_learns_and_chooses_on_two_steps(name, tmp_path):
    agent = agent_class(name)(hidden=(16, 16), batch_size=64)
    run = train(agent, test_discrete.LOG, out=tmp_path / "run", **OPTIONS)
    check(run.policy, (9,), 5)


def check(policy, shape, numbers):
    """A policy of two steps acts in bounds on histories of so many numbers."""
    assert history_of(policy) == 2
    rows = np.random.default_rng(0).uniform(-1, 1, (9, numbers)).astype(np.float32)
    actions = memoryless(policy)(rows)
    assert actions.shape == shape
    assert np.isfinite(actions).all()
    assert not jax.tree.leaves(memoryless(policy).start(1))


@pytest.mark.slow
def test_a_simulator_sees_the_same_policy_whatever_the_copies(tmp_path):
    """And while it learns: values and distances to the log are those of histories."""
    from deadreckon.collect import generate

    log = generate("maze2d-umaze-v1", steps=600, seed=0)
    agent = agent_class("td3_bc")(hidden=(16, 16), batch_size=64)
    run = train(agent, log, out=tmp_path / "run", steps=4, chunk=4, history=3, episodes=2)
    told = run.evaluations.to_pydict()
    assert np.isfinite(told["estimated_value"]).all()
    assert np.isfinite(told["mmd_to_data"]).all()
    found = evaluate(run, "maze2d-umaze", episodes=3, discount=0.99).returns[0]
    np.testing.assert_allclose(found[:2], told["return"][-2:], rtol=1e-5)
    alone = evaluate([*run.policies, *run.policies], "maze2d-umaze", episodes=1)
    np.testing.assert_allclose(alone.returns[:, 0], found[0], rtol=1e-5)
