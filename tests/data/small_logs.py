"""Small logs that the tests of this folder share."""

from typing import Any

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box, Discrete

# Few examples, so that the whole folder runs in seconds; no deadline, because test machines stall.
quick = settings(max_examples=25, deadline=None)


def make_log(
    lengths=(3, 5, 1, 4), *, seed=0, terminal=(True, False), discrete=False, finals=True, name="small", **extra: Any
) -> Dataset:
    """Episodes of `lengths`; `terminal` says in turn which end in a terminal, the others in a timeout."""
    rng = np.random.default_rng(seed)
    rows = sum(lengths)
    ends = np.cumsum(lengths) - 1
    terminals, timeouts = np.zeros(rows, bool), np.zeros(rows, bool)
    for index, end in enumerate(ends):
        (terminals if terminal[index % len(terminal)] else timeouts)[end] = True
    return Dataset.from_arrays(
        observations=rng.normal(size=(rows, 3)).astype(np.float32),
        actions=rng.integers(0, 3, rows) if discrete else rng.uniform(-1, 1, (rows, 2)).astype(np.float32),
        rewards=rng.normal(size=rows).astype(np.float32),
        terminals=terminals,
        timeouts=timeouts,
        final_observations=rng.normal(size=(len(lengths), 3)).astype(np.float32) if finals else None,
        action_space=Discrete(4) if discrete else Box((-1, -1), (1, 1.5)),
        name=name,
        **extra,
    )


def variants() -> dict[str, Dataset]:
    """One log of each kind that a file format must bring back exactly."""
    rng = np.random.default_rng(1)
    plain = make_log(goal=rng.normal(size=(13, 2)).astype(np.float32), behavior_log_probs=-rng.random(13))
    partly = Dataset.from_arrays(
        observations=plain.observations, actions=plain.actions, rewards=plain.rewards, terminals=plain.terminals,
        timeouts=plain.timeouts, final_observations=plain.final_observations,
        final_known=np.array([True, False, True, False]), action_space=plain.action_space, name="partly",
    )  # fmt: skip
    following = rng.normal(size=(13, 3))
    following[7] = plain.observations[7]  # not known, as tables say it
    successors = Dataset.from_arrays(
        observations=plain.observations, actions=plain.actions, rewards=plain.rewards, terminals=plain.terminals,
        timeouts=plain.timeouts, next_observations=following, final_known=np.array([True, False, True, True]),
        name="successors",
    )  # fmt: skip
    return {
        "plain": plain,
        "discrete": make_log(discrete=True, name="discrete"),
        "no finals": make_log(finals=False, name="no-finals"),
        "partly known finals": partly,
        "own successors": successors,
    }


def images() -> Dataset:
    """A log of uint8 pictures."""
    rng = np.random.default_rng(2)
    pictures = rng.integers(0, 256, (7, 4, 5, 3)).astype(np.uint8)
    return Dataset.from_arrays(
        observations=pictures[:6], next_observations=pictures[1:], actions=rng.uniform(-1, 1, (6, 2)),
        rewards=np.arange(6), terminals=np.arange(6) == 5, name="pictures",
    )  # fmt: skip


def same(a: Dataset, b: Dataset) -> None:
    """Asserts equal columns, with the name of the first that differs."""
    for key in ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations", "final_known"):
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key), err_msg=key)
    assert (a.successors is None) == (b.successors is None)
    assert set(a.extras) == set(b.extras)
    for key in a.extras:
        np.testing.assert_array_equal(a.extras[key], b.extras[key], err_msg=key)


@st.composite
def logs(draw: Any) -> Dataset:
    """Logs of a few episodes of any lengths and ends."""
    lengths = draw(st.lists(st.integers(1, 6), min_size=1, max_size=6))
    terminal = draw(st.lists(st.booleans(), min_size=len(lengths), max_size=len(lengths)))
    seed = draw(st.integers(0, 1000))
    return make_log(tuple(lengths), seed=seed, terminal=tuple(terminal), discrete=draw(st.booleans()))
