"""The log as rows of histories: what each holds, at starts and ends, and which logs have none."""

import numpy as np
import pytest

from deadreckon.data.batch import BatchSpec, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.history import beginning, stacked
from deadreckon.data.spec import Box, Discrete
from deadreckon.dynamics.model import unsaid
from deadreckon.errors import UserError


def two_episodes(**changes):
    """Observations 1, 2, 3, then 9, and 4, 5, then 8; actions 10 times these, in bounds of ±100."""
    seen = np.array([1, 2, 3, 4, 5], np.float32)[:, None]
    columns = {
        "observations": seen, "actions": 10 * seen, "rewards": np.arange(5.0), "timeouts": [0, 0, 1, 0, 1],
        "final_observations": np.array([[9.0], [8.0]]), "action_space": Box((-100,), (100,)),
    }  # fmt: skip
    return Dataset.from_arrays(**columns | changes)


# Three observations and two actions: oldest first, the first observation repeated and actions zero before the start.
ROWS = np.float32([
    [1, 0, 1, 0, 1], [1, 0, 1, 0.1, 2], [1, 0.1, 2, 0.2, 3], [4, 0, 4, 0, 4], [4, 0, 4, 0.4, 5],
])  # fmt: skip
FINAL = np.float32([[2, 0.2, 3, 0.3, 9], [4, 0.4, 5, 0.5, 8]])


def test_rows_and_successors_are_histories_that_cross_no_episode():
    log = stacked(two_episodes(), 3)
    assert log.observations.shape == (5, 5)
    np.testing.assert_allclose(np.asarray(log.observations), ROWS, rtol=1e-6)
    np.testing.assert_allclose(log.final_observations, FINAL, rtol=1e-6)
    np.testing.assert_allclose(log.next_observations, [*ROWS[1:3], FINAL[0], ROWS[4], FINAL[1]], rtol=1e-6)
    np.testing.assert_allclose(log.spec.observation.mean, ROWS.mean(0), rtol=1e-5)
    assert log.spec.observation_size == 5
    source = TransitionSource(log, BatchSpec(batch_size=2))
    np.testing.assert_allclose(source.take(np.array([[1, 4]]))["observation"], ROWS[None, [1, 4]], rtol=1e-6)


@pytest.mark.parametrize("index", [2, -1, slice(1, 4), slice(None, None, 2), np.array([3, 0, 3]), np.array([[1], [4]]),
                                   np.array([True, False, False, True, False]), (slice(None), -1), (1, 2)])  # fmt: skip
def test_rows_are_indexed_as_those_of_an_array(index):
    np.testing.assert_allclose(stacked(two_episodes(), 3).observations[index], ROWS[index], rtol=1e-6)


def test_discrete_actions_are_one_hot():
    log = stacked(two_episodes(actions=np.array([2, 0, 1, 1, 0]), action_space=Discrete(3)), 2)
    np.testing.assert_array_equal(log.observations[:3], [[1, 0, 0, 0, 1], [1, 0, 0, 1, 2], [2, 1, 0, 0, 3]])
    np.testing.assert_array_equal(log.final_observations, [[3, 0, 1, 0, 9], [5, 1, 0, 0, 8]])


def test_what_follows_repeats_the_last_row_where_it_is_not_known():
    """As of single observations: of these nothing is learned (`dynamics.model.unsaid`)."""
    log = stacked(two_episodes(terminals=[0, 0, 1, 0, 0], timeouts=[0, 0, 0, 0, 1], final_known=[False, True],
                               final_observations=np.array([[3.0], [8.0]])), 3)  # fmt: skip
    np.testing.assert_allclose(log.final_observations, [ROWS[2], FINAL[1]], rtol=1e-6)
    told = unsaid(log.observations[:], log.next_observations, log.terminals)
    np.testing.assert_array_equal(told, [False, False, True, False, False])


def test_the_end_of_a_row_is_the_history_of_fewer_steps():
    log = two_episodes()
    np.testing.assert_array_equal(stacked(log, 3).observations[:][:, -3:], stacked(log, 2).observations[:])
    np.testing.assert_array_equal(stacked(log, 3).final_observations[:, -3:], stacked(log, 2).final_observations)


def test_one_step_is_the_log_itself_and_parts_keep_their_episodes():
    log = two_episodes()
    assert stacked(log, 1) is log
    np.testing.assert_array_equal(stacked(log, 2).episode_ids, log.episode_ids)
    part = stacked(log, 3).select([1])
    np.testing.assert_allclose(part.observations, ROWS[3:], rtol=1e-6)
    np.testing.assert_array_equal(part.episode_ids, log.episode_ids[[1]])
    assert stacked(log, 2).fingerprint != stacked(log, 3).fingerprint


def test_an_episode_begins_as_its_first_row_does():
    np.testing.assert_array_equal(beginning(np.float32([[1], [4]]), 1, 3), ROWS[[0, 3]])


def test_logs_without_histories_are_refused():
    with pytest.raises(UserError, match=r"rows do not follow each other.*leave history at 1"):
        stacked(two_episodes(final_observations=None, next_observations=np.array([[7.0], [7], [9], [7], [8]])), 2)
    images = two_episodes(observations=np.zeros((5, 4, 4), np.uint8), final_observations=np.zeros((2, 4, 4), np.uint8))
    with pytest.raises(UserError, match="history=2 needs flat observations"):
        stacked(images, 2)
    for steps in (0, -2):
        with pytest.raises(UserError, match=f"history must be >= 1, got {steps}"):
            stacked(two_episodes(), steps)
