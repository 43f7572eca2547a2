"""Batches that a log has a share of: how many of its rows, in which coordinates, and the returns known of both parts."""

import re
from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.batch import BatchSpec, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import STD_FLOOR
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.online import Exploration, Online
from deadreckon.online.mixed import MixedReplay, Returns, logged_rows
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.training.fit import Fit
from tests.online.test_exploration import HIGH, LOW, TASK, Counter, rows_of

ROWS, DISCOUNT = 60, 0.9
SETTINGS = Online(copies=4, explore=0, updates_per_step=0.5, block=16)  # 8 updates a block
UPDATES = 80


def log_of(space=None):
    """Rewards are -1, -2, ...; episodes end by turns with a terminal, and time-outs of which the successor is known or not."""
    rng = np.random.default_rng(0)
    last = np.arange(ROWS) % 10 == 9
    turn = np.arange(ROWS) // 10 % 3
    return Dataset.from_arrays(
        observations=rng.normal([5.0, 3.0], [2.0, 1.0], (ROWS, 2)), actions=rng.uniform(LOW, HIGH, (ROWS, 2)),
        rewards=-1.0 - np.arange(ROWS), terminals=last & (turn == 0), timeouts=last & (turn > 0),
        final_observations=rng.normal(size=(6, 2)), final_known=np.array([0, 1, 0, 0, 1, 0], bool), name="toy log",
        action_space=space or TASK.action_space,
    )  # fmt: skip


LOG = log_of()


class Sums(Counter):
    """Also counts rows of the log, which have rewards below 0, and adds up what it sees of both parts."""

    online: ClassVar[bool] = False
    fine_tunes: ClassVar[bool] = True

    def needs(self, spec):
        columns = *BatchSpec.columns, "monte_carlo"
        return BatchSpec(columns, self.batch_size, standardise=True, gamma=DISCOUNT)

    def update(self, state, batch, *, step, key):
        new, metrics = super().update(state, batch, step=step, key=key)
        of_log = batch.reward < 0
        known = jnp.isfinite(batch.monte_carlo[:, 0])
        told = {
            "logged": of_log.mean(), "first": of_log[: self.batch_size // 4].mean(),
            "known of log": (known & of_log).sum() / of_log.sum(), "known": (known & ~of_log).mean(),
        }  # fmt: skip
        return new, metrics | told


class Zero(NormalizedPolicy):
    """Does nothing."""

    def act(self, step, carry, key, *, greedy):
        return jnp.zeros((len(step.observation), 2)), carry


class Still(Sums):
    """Acts by noise alone."""

    exploration_noise: ClassVar[float] = 0.1

    def policy(self, state):
        return Zero()


def mixed(folder=None, seeds=(0,), share=0.25, chunk=8, agent=None, log=LOG, **change):
    agents = [agent or Sums()] * len(seeds)
    paths = [folder / f"seed{seed}.bin" for seed in seeds] if folder else []
    experience = MixedReplay(TASK, agents[0], seeds, UPDATES, replace(SETTINGS, **change), paths, log=log, share=share)
    return Fit(agents, experience, seeds, UPDATES, chunk, folder / "checkpoints" if folder else None)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two lanes: the fit, its metrics chunk by chunk, and (lanes, rows, width) the files."""
    folder = tmp_path_factory.mktemp("mixed")
    job = mixed(folder, (3, 4))
    seen = [p.metrics for p in job.chunks()]
    return job, seen, np.stack([rows_of(folder / f"seed{seed}.bin") for seed in (3, 4)])


def test_every_batch_has_exactly_its_share_of_the_log(run):
    job, seen, _ = run
    assert len(seen) == 10
    for metrics in seen:
        np.testing.assert_array_equal(metrics["logged"], 0.25)  # a mean of 8 updates: none has more or fewer
        np.testing.assert_array_equal(metrics["first"], 1.0)
        np.testing.assert_array_equal(metrics["known of log"], 1.0)
    assert not jax.device_get(job.states["blank"]).any()  # no row that nobody has written, no row beyond the log's


def test_lanes_share_the_log_and_have_batches_of_their_own(run):
    job, seen, _ = run
    experience = job.source.experience
    matrix, count = experience._logged["logged"]
    rows = TransitionSource(LOG, Sums().needs(LOG.spec))
    assert int(count) == rows.count == ROWS - 2  # of two time-outs the successor is unknown
    own = rows.take(np.arange(rows.count))
    order = "observation", "action", "reward", "next_observation", "terminal", "monte_carlo"
    expected = np.concatenate([own[name].reshape(rows.count, -1) for name in order], 1)
    np.testing.assert_array_equal(matrix["packed"][: rows.count], expected)
    assert seen[-1]["oldest"][0] != seen[-1]["oldest"][1]


def test_experience_is_seen_in_the_coordinates_of_the_log(run):
    job, _, files = run
    buffer = np.asarray(job.source.experience.replay.buffer)
    mean, std = LOG.observations.mean(0), LOG.observations.std(0) + STD_FLOOR
    np.testing.assert_allclose(buffer[..., :2], (files[..., :2] - mean) / std, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(buffer[..., 5:7], (files[..., 5:7] - mean) / std, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(buffer[..., 2:4], 2 * (files[..., 2:4] - LOW) / (HIGH - LOW) - 1, atol=2e-6)
    np.testing.assert_array_equal(buffer[..., [4, 7]], files[..., [4, 7]])
    assert buffer.shape[-1] == 10


def returned(rewards, ended):
    """Discounted rewards, and steps, from the first row on: for ever where the episode was cut, as far as float64 sees."""
    rewards = list(rewards) + ([] if ended else [rewards[-1]] * 600)
    weights = DISCOUNT ** np.arange(len(rewards))
    return weights @ rewards, weights.sum()


def test_returns_of_the_log_are_exact_also_where_episodes_were_cut():
    found = TransitionSource(LOG, Sums().needs(LOG.spec)).take(np.arange(ROWS - 2))["monte_carlo"]
    shown = np.flatnonzero(LOG.usable)
    for row, own in zip(shown, found, strict=True):
        end = LOG.ends[LOG.episode_at(np.array([row]))[0]]
        np.testing.assert_allclose(own, returned(LOG.rewards[row : end + 1], LOG.terminals[end]), rtol=1e-5)
    # An agent that learns from scaled and shifted rewards has their return from the two numbers.
    scaled = [3.0 * r - 1.0 for r in LOG.rewards[10:20]]
    np.testing.assert_allclose(3.0 * found[10, 0] - found[10, 1], returned(scaled, False)[0], rtol=1e-5)


def test_returns_of_experience_are_known_once_an_episode_has_ended(run):
    job, seen, files = run
    values = np.asarray(job.source.experience.replay.buffer)[..., -2:]
    ended = 0
    for lane, rows in enumerate(files):
        for copy in range(SETTINGS.copies):
            own, told = rows[copy :: SETTINGS.copies], values[lane, copy :: SETTINGS.copies]
            begin = 0
            for at in range(len(own)):
                if own[at, -2] or own[at, -1]:
                    for row in range(begin, at + 1):
                        np.testing.assert_allclose(told[row], returned(own[row : at + 1, 4], own[at, -2]), rtol=1e-5)
                    begin, ended = at + 1, ended + 1
            assert np.isneginf(told[begin:, 0]).all()
    assert ended > 20
    assert seen[0]["known"][0] < 0.3 < 0.6 < seen[-1]["known"][0]


def test_returns_do_not_depend_on_how_rows_come():
    rng = np.random.default_rng(1)
    reward = rng.normal(size=(2, 48)).astype(np.float32)
    terminal, timeout = rng.uniform(size=(2, 48)) < 0.2, rng.uniform(size=(2, 48)) < 0.1
    whole, parts = Returns(2, 3, 60, DISCOUNT), Returns(2, 3, 60, DISCOUNT)
    assert whole.see(0, reward, terminal, timeout) == 0
    changed = [parts.see(i, *(column[:, i : i + 6] for column in (reward, terminal, timeout))) for i in range(0, 48, 6)]
    assert all(first <= i for first, i in zip(changed, range(0, 48, 6)))
    np.testing.assert_array_equal(parts.values, whole.values)


def test_stopped_and_taken_up_again_it_is_the_same(run, tmp_path):
    job, _, files = run
    first = mixed(tmp_path, (3, 4), chunk=16)
    walk = first.chunks()
    for _ in range(3):
        next(walk)
    walk.close()
    second = mixed(tmp_path, (3, 4), chunk=16)
    second.resume()
    assert second.step == 32
    assert all(p.failures == (None, None) for p in second.chunks())
    np.testing.assert_array_equal(np.stack([rows_of(tmp_path / f"seed{seed}.bin") for seed in (3, 4)]), files)
    np.testing.assert_array_equal(second.source.experience.replay.buffer, job.source.experience.replay.buffer)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(job.states), jax.tree.leaves(second.states), strict=True))


class Echo(NormalizedPolicy):
    """Does what it sees, one hundredth of it."""

    def act(self, step, carry, key, *, greedy):
        return 0.01 * step.observation, carry


class Echoes(Sums):
    """Acts by what it sees."""

    def policy(self, state):
        return Echo()


def test_the_policy_acts_in_the_coordinates_of_the_log(tmp_path):
    job = mixed(tmp_path, agent=Echoes())
    next(job.chunks())
    rows = np.asarray(job.source.experience.replay.buffer)[0, :16]
    np.testing.assert_allclose(rows[:, 2:4], 0.01 * rows[:, :2], atol=1e-5)


def test_a_policy_that_draws_nothing_explores_by_noise():
    job = mixed(agent=Still())
    next(job.chunks())
    unit = np.asarray(job.source.experience.replay.buffer)[0, :16, 2:4]
    assert 0.05 < unit.std() < 0.2
    assert abs(unit.mean()) < 0.1


@pytest.mark.parametrize(("change", "words"), [
    ({"share": 1.0}, "log_share must be 0 or more and below 1, got 1.0"),
    ({"share": -0.5}, "log_share must be 0 or more"),
    ({"share": 0.3}, r"log_share \* batch_size must be a whole number, got 0.3 \* 64; 0.296875 is the nearest share"),
    ({"agent": Counter()}, "Counter does not learn online with a log in its replay; these agents do: .*cal_ql"),
    ({"log": log_of(Box((-1.0, 0.0), (3.0, 1.0)))}, "toy log: actions have the bounds .*, beyond those of ticking"),
])  # fmt: skip
def test_refuses_what_does_not_fit(change, words):
    with pytest.raises(UserError, match=words):
        mixed(**change)


def test_without_a_log_something_must_be_explored_first():
    with pytest.raises(UserError, match="must be 1 or more where no log is learned from, got 0"):
        Exploration(TASK, Counter(), [0], UPDATES, SETTINGS)


def test_the_share_that_is_proposed_is_taken():
    with pytest.raises(UserError, match="is the nearest share") as caught:
        logged_rows(0.99, 256)
    nearest = re.search(r"; (.*) is the nearest", str(caught.value))[1]
    assert logged_rows(float(nearest), 256) == 253
