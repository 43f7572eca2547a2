"""Every agent with tiny networks on one small log: what tests compile is the same program, so that it is compiled once."""

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.agents import agent_class
from deadreckon.agents.offline_mbrl import OfflineMBRL
from deadreckon.data.batch import TransitionSource
from deadreckon.policies import EnvPolicy
from deadreckon.policies.deployed import first_actions
from tests.agents.worlds import corridor

LOG = corridor()
STEPS, CHUNK = 150, 50

MODEL = {"model_hidden": (8,), "model_weight_decay": (), "members": 3, "elites": 2, "rollout_batch_size": 40, "model_epochs": 2,
         "rollout_length": 2, "real_batch_size": 20}  # fmt: skip

# EDAC: of one action the gradient of its likeness is a spike where a slope changes its sign, and no number to compare.
OWN = {"cal_ql": {"critic_hidden": (16, 16), "samples": 3}, "rlpd": {"critics": 3, "policy_freq": 2},
       "edac": {"diversity": 0.0}, "bcq": {"behavior_hidden": (16, 16), "test_samples": 10}, "brac": {"behavior_steps": 20},
       "d4pg": {"critic_hidden": (16, 16), "v_min": -5.0, "v_max": 5.0, "target_update_period": 10, "n_step": 2},
       "crr_d": {"critic_hidden": (16, 16), "v_min": -5.0, "v_max": 5.0, "target_update_period": 10},
       "abm": {"window": 8, "samples": 4, "epsilon": 0.5, "target_update_period": 10},
       "mobile": {"min_target": None}, "rem": {"heads": 5}, "kl_control": {"behavior_steps": 20}, "awr": {"window": 8},
       "decision_transformer": {"context_length": 4, "layers": 1, "hidden": (16,), "batch_size": 16}}  # fmt: skip


def small(name, **fields):
    kind = agent_class(name)
    own = OWN.get(name, {}) | (MODEL if issubclass(kind, OfflineMBRL) else {})
    fields = {"hidden": (16, 16), "batch_size": 64} | own | fields
    return kind(**fields).resolve(LOG.spec, STEPS)


def rows_of(agent, log=LOG):
    return TransitionSource(log, agent.needs(log.spec))


def assert_function_of_state(policy: EnvPolicy, observations: np.ndarray) -> None:
    """That greedy actions depend on the state alone: not on the place in a batch, its size, or a key; `observations` are 9."""
    actions, order = policy(observations), np.random.default_rng(0).permutation(9)
    assert len(np.unique(actions, axis=0)) > 1  # or there is nothing to see
    np.testing.assert_allclose(policy(observations[order]), actions[order], atol=1e-5)
    np.testing.assert_allclose(np.concatenate([policy(part) for part in np.split(observations, 3)]), actions, atol=1e-5)
    other = first_actions(policy, jnp.asarray(observations), jax.random.key(7), True)
    np.testing.assert_allclose(other, actions, atol=1e-5)
