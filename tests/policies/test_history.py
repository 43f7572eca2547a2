"""Policies that carry the last steps act as the network does on the rows of the log, also from a file and by NumPy alone."""

import equinox as eqx
import jax
import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.history import history_size, stacked
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Box, Discrete
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.policies import EnvPolicy, portable, store
from deadreckon.policies.deployed import History, Mixture, history_of, memoryless
from deadreckon.policies.kinds import Categorical, Deterministic

STEPS, SIZE = 3, 2
LENGTHS = (7, 1, 4, 2)  # of episodes, one after the other in the first copy; the second copy has them the other way round
SPACES = {"box": Box((-3.0, 0.0), (1.0, 5.0)), "discrete": Discrete(3)}


def of(space, key):
    """A policy on histories, and what it needs to know of a log."""
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 3, 4) if isinstance(space, Discrete) else rng.uniform(0.0, 1.0, (4, 2))
    observations = rng.normal(size=(4, SIZE))
    spec = Dataset.from_arrays(observations=observations, actions=actions, rewards=np.zeros(4), action_space=space).spec
    net = MLP.create(history_size(SIZE, space.size, STEPS), (8,), space.size, jax.random.key(key))
    inner = (Categorical if spec.discrete else Deterministic)(net)
    return History.of(EnvPolicy.of(inner, Normalizer.of(spec)), STEPS, spec)


def acted(act, space):
    """The log of two copies that act side by side, whose episodes begin at different times: ([log of each], [actions])."""
    rng = np.random.default_rng(1)
    total = sum(LENGTHS)
    seen = rng.normal(size=(total, 2, SIZE)).astype(np.float32)
    first = np.zeros((total, 2), bool)
    for copy, lengths in enumerate((LENGTHS, LENGTHS[::-1])):
        first[np.append(0, np.cumsum(lengths)[:-1]), copy] = True
    done = np.stack([act(seen[t], first[t]) for t in range(total)])
    logs = []
    for copy in range(2):
        ends = np.append(first[1:, copy], True)
        logs.append(Dataset.from_arrays(
            observations=seen[:, copy], actions=done[:, copy], rewards=np.zeros(total), terminals=ends, action_space=space,
        ))  # fmt: skip
    return logs, done


@eqx.filter_jit
def stepped(policy, step, carry):
    return policy.act(step, carry, jax.random.key(0), greedy=True)


def carrying(policy):
    """The policy's `act` with its carry inside."""
    carry = policy.start(2)

    def act(seen, first):
        nonlocal carry
        actions, carry = stepped(policy, Step(seen, np.zeros(2, np.float32), first), carry)
        return np.asarray(actions)

    return act


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_acts_on_what_it_saw_as_on_the_stacked_log(space, tmp_path):
    policy = of(space, 0)
    assert history_of(policy) == STEPS
    logs, done = acted(carrying(policy), space)
    for copy, log in enumerate(logs):
        rows = memoryless(policy)(stacked(log, STEPS).observations[:])
        np.testing.assert_allclose(rows, done[:, copy], atol=1e-6)
    assert len(np.unique(done[..., 0] if done.ndim == 3 else done)) > 1
    store.save(tmp_path / "p.npz", policy)
    loaded = store.load(tmp_path / "p.npz")
    np.testing.assert_array_equal(acted(carrying(loaded), space)[1], done)
    play = portable.load(tmp_path / "p.npz")
    np.testing.assert_allclose(acted(lambda seen, first: play(seen, first=first), space)[1], done, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
def test_members_of_a_mixture_carry_their_own(space, tmp_path):
    policy = of(space, 0)
    mixture = Mixture.of([policy, policy])
    done = acted(carrying(policy), space)[1]
    np.testing.assert_allclose(acted(carrying(mixture), space)[1], done, atol=1e-6)
    store.save(tmp_path / "m.npz", mixture)
    play = portable.load(tmp_path / "m.npz")
    np.testing.assert_allclose(acted(lambda seen, first: play(seen, first=first), space)[1], done, atol=1e-5)


def test_one_observation_does_not_tell_the_history(tmp_path):
    policy = of(SPACES["box"], 0)
    for each in (policy, Mixture.of([policy, policy])):
        with pytest.raises(UserError, match="acts on the last 3 steps of an episode, not on one observation"):
            each(np.zeros((2, SIZE), np.float32))
    store.save(tmp_path / "p.npz", policy)
    play = portable.load(tmp_path / "p.npz")
    with pytest.raises(ValueError, match="say first=True where an episode begins"):
        play(np.zeros(SIZE))
    with pytest.raises(ValueError, match="no episode is in progress"):
        play(np.zeros(SIZE), first=False)
    assert play(np.zeros(SIZE), first=True).shape == (2,)


def test_a_history_of_one_step_is_the_policy_itself():
    member = memoryless(of(SPACES["box"], 0))
    assert History.of(member, 1, None) is member
    assert history_of(member) == 1
