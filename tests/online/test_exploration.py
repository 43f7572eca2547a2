"""Rows that agents make for themselves, in a world whose every number is known and by an agent that counts."""

import itertools
import re
from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import deadreckon as dr
from deadreckon import agents, tasks
from deadreckon.agents.agent import Agent
from deadreckon.collect import gym, trained
from deadreckon.data.batch import BatchSpec
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.online import Exploration, Online
from deadreckon.online.rows import replay_log, row_width
from deadreckon.policies import library
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.randomness import sequence
from deadreckon.tasks.task import Starts, Task
from deadreckon.training.fit import Fit
from deadreckon.training.hyperparameters import static
from deadreckon.versions import versions
from tests.agents.little import Little

LOW, HIGH = np.array([-1.0, 0.5], np.float32), np.array([3.0, 1.0], np.float32)


@dataclass(frozen=True)
class Ticking(Task):
    """Copies that count: see `Clocks`."""

    def simulate(self, seeds, threads=None):
        return Clocks(self, seeds)


class Clocks:
    """Observation: [a number of the copy's seed and its episode, steps in the episode]; reward: steps in all, 1, 2, ...

    Every second episode of a copy ends with a fall after 3 to 5 steps; the others go to the horizon.
    """

    def __init__(self, task, seeds):
        self.task = task
        self.starts = Starts(seeds, lambda generator: generator.uniform(1, 2))
        self.start = np.zeros(len(seeds))
        self.age = np.zeros(len(seeds), int)
        self.steps = np.zeros(len(seeds), int)

    def reset(self, which=None, seeds=None):
        which = np.arange(len(self.age)) if which is None else which
        self.start[which] = [self.starts.next(i) for i in which]
        self.age[which] = 0
        return self.see()[which]

    def see(self):
        return np.stack([self.start, self.age], 1).astype(np.float32)

    def step(self, actions):
        assert actions.shape == (len(self.age), 2)
        assert actions.dtype == np.float32
        assert (actions >= LOW - 1e-6).all()
        assert (actions <= HIGH + 1e-6).all()
        self.age, self.steps = self.age + 1, self.steps + 1
        fall = (self.starts.drawn % 2 == 0) & (self.age >= 3 + (1000 * self.start).astype(int) % 3)
        return self.see(), self.steps.astype(np.float32), fall, ~fall & (self.age >= self.task.horizon)

    def state(self):
        # Two of the names are of what an experience keeps beside it.
        return {"start": self.start.copy(), "seen": self.age.copy(), "count": self.steps.copy(), **self.starts.state()}

    def restore(self, state):
        self.starts.restore(state)
        self.start, self.age, self.steps = (state[key].copy() for key in ("start", "seen", "count"))


TASK = Ticking("ticking", "toy", 7, (2,), Box((-1.0, 0.5), (3.0, 1.0)), "", tasks.task("hopper").reference)


class Says(NormalizedPolicy):
    """Says by its first action how many updates it has seen, and draws its second."""

    updates: jax.Array

    def act(self, step, carry, key, *, greedy):
        n = len(step.observation)
        noise = jax.random.uniform(key, (n,), minval=-1.0, maxval=1.0)
        return jnp.stack([jnp.broadcast_to(self.updates / 1000, (n,)), noise], -1), carry


class Counter(Agent):
    """Counts its updates and looks for rows that nobody has written, which have no reward."""

    online: ClassVar[bool] = True
    breaks: float = 1e9  # updates after which its numbers go bad
    batch_size: int = static(64)

    def needs(self, spec):
        return BatchSpec(batch_size=self.batch_size)

    def init(self, spec, key):
        return {"updates": jnp.zeros(()), "blank": jnp.zeros(()), "newest": jnp.zeros(()), "sum": jnp.zeros(())}

    def update(self, state, batch, *, step, key):
        rows = [jnp.sum(x) for x in (batch.observation, batch.action, batch.next_observation, batch.terminal)]
        new = {
            "updates": jnp.where(state["updates"] < self.breaks, state["updates"] + 1, jnp.nan),
            "blank": state["blank"] + (batch.reward == 0).sum(),
            "newest": jnp.maximum(state["newest"], batch.reward.max()),
            "sum": 0.9 * state["sum"] + 1e-3 * sum(rows),
        }
        return new, {"step": step.astype(jnp.float32), "oldest": batch.reward.min(), "updates": new["updates"]}

    def policy(self, state):
        return Says(state["updates"])


class Shouting(NormalizedPolicy):
    """Goes beyond all bounds, as a Gaussian's draws do."""

    def act(self, step, carry, key, *, greedy):
        return jnp.tile(jnp.asarray([3.0, -2.0]), (len(step.observation), 1)), carry


class Shouter(Counter):
    """Counts, and shouts."""

    def policy(self, state):
        return Shouting()


SETTINGS = Online(copies=4, explore=80, updates_per_step=0.5, block=16)  # 8 updates a block
UPDATES = SETTINGS.updates(80 + 10 * 16)


def fit(folder=None, seeds=(0,), chunk=8, updates=UPDATES, lanes=None):
    lanes = lanes or [Counter()] * len(seeds)
    paths = [folder / f"seed{seed}.bin" for seed in seeds] if folder else []
    experience = Exploration(TASK, lanes[0], seeds, updates, SETTINGS, paths)
    return Fit(lanes, experience, seeds, updates, chunk, folder / "checkpoints" if folder else None)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two lanes: the fit, its progress with the rows at that time, and (lanes, rows, width) the files."""
    folder = tmp_path_factory.mktemp("online")
    job = fit(folder, (3, 4))
    seen = [(p.step, job.source.experience.count, p.metrics, jax.device_get(p.states)) for p in job.chunks()]
    return job, seen, np.stack([rows_of(folder / f"seed{seed}.bin") for seed in (3, 4)])


def rows_of(path):
    return np.fromfile(path, np.float32).reshape(-1, row_width(TASK))


def parts(rows):
    """Observation, action, reward, next observation, terminal, timeout; one row a step of each copy."""
    turns = rows.reshape(-1, SETTINGS.copies, rows.shape[-1])
    observation, action, reward, following, terminal, timeout = np.split(turns, np.cumsum([2, 2, 1, 2, 1]), axis=-1)
    return observation, action, reward[..., 0], following, terminal[..., 0], timeout[..., 0]


# ---- settings ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("change", "words"), [
    ({"copies": 0}, "copies, the number of environments .* must be 1 or more, got 0"),
    ({"explore": -1}, "explore, .* with random actions .* must be 0 or more, got -1"),
    ({"block": -64}, "block, .* between two blocks of updates, must be 1 or more, got -64"),
    ({"updates_per_step": 0.0}, "must be above 0, got 0.0"),
    ({"updates_per_step": float("nan")}, "must be above 0, got nan"),
    ({"updates_per_step": float("inf")}, "must be above 0, got inf"),
    ({"copies": 3}, r"block, .*, must be a multiple of copies \(3 environments .*\), got 64, such as 63 or 66"),
    ({"copies": 64}, r"explore, .*, must be a multiple of copies \(64 environments .*\), got 10000, such as 9984 or 10048"),
    ({"copies": 128}, r"block, .*, got 64, such as 128$"),
    ({"updates_per_step": 0.3}, "a whole number of updates for each block of 64 .*, got 0.3; 0.296875 gives 19$"),
    ({"updates_per_step": 0.001}, "got 0.001; 0.015625 gives 1$"),
])  # fmt: skip
def test_settings_that_make_no_sense_are_told(change, words):
    with pytest.raises(UserError, match=words):
        Online(**change)


def test_updates_and_steps_are_each_others_inverse():
    for settings in (Online(), SETTINGS, Online(updates_per_step=0.1, block=80), Online(updates_per_step=3.0)):
        per_block = settings.updates_per_block
        assert per_block == pytest.approx(settings.block * settings.updates_per_step)
        for blocks in (1, 2, 777):
            updates = blocks * per_block
            steps = settings.steps(updates)
            assert steps == settings.explore + blocks * settings.block
            assert settings.updates(steps) == updates
            assert settings.updates(steps + settings.block - 1) == updates  # an unfinished block is not begun
            # The rows of a block are there before the first of its updates.
            assert settings.steps(updates + 1) == steps + settings.block
        assert settings.steps(0) == 0
        with pytest.raises(UserError, match=f"too few: .* give {settings.explore + settings.block} or more"):
            settings.updates(settings.explore + settings.block - 1)


# ---- rows -------------------------------------------------------------------------------------------------------------


def test_rows_are_what_the_simulator_did(run):
    job, _, files = run
    for lane, seed in enumerate((3, 4)):
        observation, action, reward, following, terminal, timeout = parts(files[lane])
        twin = Clocks(TASK, [int(s) for s in sequence(seed, "act").generate_state(4, np.uint64)])
        seen = twin.reset()
        for turn in range(len(observation)):
            np.testing.assert_array_equal(observation[turn], seen)
            expected = twin.step(action[turn])
            for ours, theirs in zip((following[turn], reward[turn], terminal[turn], timeout[turn]), expected):
                np.testing.assert_array_equal(ours, theirs)
            seen, over = expected[0], np.flatnonzero(expected[2] | expected[3])
            if len(over):
                seen[over] = twin.reset(over)
        assert terminal.any()
        assert timeout.any()
    assert not np.intersect1d(files[0][:, 0], files[1][:, 0]).size  # lanes start apart


def test_simulators_get_actions_within_the_bounds_and_rows_are_as_they_were_drawn(monkeypatch, tmp_path):
    taken, step = [], Clocks.step
    monkeypatch.setattr(Clocks, "step", lambda self, actions: (taken.append(actions), step(self, actions))[1])
    for _ in fit(tmp_path, updates=8, lanes=[Shouter()]).chunks():
        pass
    drawn = rows_of(tmp_path / "seed0.bin")[:, 2:4]
    assert len(drawn) == 80 + 16  # random actions, then its own
    np.testing.assert_allclose(drawn[80:], np.tile([7.0, 0.25], (16, 1)))
    np.testing.assert_array_equal(np.concatenate(taken), np.clip(drawn, LOW, HIGH))


def test_a_row_goes_on_where_the_copys_last_one_stopped_unless_it_ended(run):
    observation, _, _, following, terminal, timeout = parts(run[2][0])
    over = ((terminal + timeout) > 0)[:-1]
    np.testing.assert_array_equal(observation[1:][~over], following[:-1][~over])
    assert (observation[1:][over][:, 1] == 0).all()
    assert (observation[1:][over][:, 0] != following[:-1][over][:, 0]).all()


def test_learners_see_the_rows_with_actions_in_their_coordinates(run):
    job, _, files = run
    buffer = np.asarray(job.source.experience.replay.buffer)
    expected = files.copy()
    expected[..., 2:4] = np.clip(2 * (files[..., 2:4] - LOW) / (HIGH - LOW) - 1, -1 + 1e-6, 1 - 1e-6)
    np.testing.assert_allclose(buffer, expected, atol=1e-6)
    assert {name: shape for name, (shape, _) in job.source.experience.fields.items()} == {
        "observation": (2,), "action": (2,), "reward": (), "next_observation": (2,), "terminal": (),
    }  # fmt: skip


def test_uniform_actions_first_and_the_policys_after(run):
    _, _, files = run
    explore = SETTINGS.explore
    for lane in (0, 1):
        unit = 2 * (files[lane, :, 2:4] - LOW) / (HIGH - LOW) - 1
        uniform, acted = unit[:explore], unit[explore:]
        assert np.abs(uniform).max() <= 1
        assert np.abs(uniform).max(0).min() > 0.9
        # The mean of 80 draws has a standard error of 1 / sqrt(3 * 80) = 0.065, their deviation about 0.03.
        assert np.abs(uniform.mean(0)).max() < 0.26
        np.testing.assert_allclose(uniform.std(0), 1 / np.sqrt(3), atol=0.12)
        assert len(np.unique(uniform)) == uniform.size  # each number is drawn for itself
        assert acted[:, 0].max() < 0.1
        assert len(np.unique(acted[:, 1])) == len(acted)  # and so are the policy's
    assert not np.intersect1d(files[0][:, 2], files[1][:explore, 2]).size


def test_the_policy_does_not_change_within_a_block(run):
    job, _, files = run
    unit = 2 * (files[:, SETTINGS.explore :, 2] - LOW[0]) / (HIGH[0] - LOW[0]) - 1
    said = (1000 * unit).reshape(2, 10, SETTINGS.block)
    np.testing.assert_allclose(said, np.broadcast_to(8.0 * np.arange(10)[:, None], said.shape), atol=0.01)


def test_steps_and_updates_are_those_promised(run):
    job, seen, files = run
    assert [step for step, *_ in seen] == [8 * k for k in range(1, 11)]
    for step, count, metrics, states in seen:
        assert count == SETTINGS.steps(step)
        np.testing.assert_array_equal(states["updates"], step)
        np.testing.assert_allclose(metrics["step"], step - 4.5)  # the mean of this block's
    assert files.shape[1] == 80 + 160


def test_batches_hold_rows_that_exist_up_to_the_newest(run):
    _, seen, _ = run
    for _, count, metrics, states in seen:
        np.testing.assert_array_equal(states["blank"], 0)
        # 8 batches of 64 rows among 240 or fewer, each reward 4 times: that the newest is missed has a chance below 1e-3.
        np.testing.assert_array_equal(states["newest"], count / SETTINGS.copies)
        assert (metrics["oldest"] < 6).all()  # and the oldest are there too


@pytest.mark.slow
def test_a_lane_equals_the_run_of_its_seed_alone(run, tmp_path):
    _, _, files = run
    job = fit(tmp_path, (4,))
    for _ in job.chunks():
        pass
    np.testing.assert_allclose(rows_of(tmp_path / "seed4.bin"), files[1], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(job.states["sum"][0], run[0].states["sum"][1], rtol=1e-4)


@pytest.mark.parametrize("chunk", [1, 20, 1000])
def test_chunks_change_nothing(run, chunk, tmp_path):
    job = fit(tmp_path, (3, 4), chunk)
    steps = [p.step for p in job.chunks()]
    assert steps == {1: [8 * k for k in range(1, 11)], 20: [24, 48, 72, 80], 1000: [80]}[chunk]
    assert same(job, run[0])
    for lane, seed in enumerate((3, 4)):
        assert rows_of(tmp_path / f"seed{seed}.bin").tobytes() == run[2][lane].tobytes()


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a.states), jax.tree.leaves(b.states), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("broken", [False, True])
@pytest.mark.parametrize("at", [0, 1, 4, 9])
def test_killed_and_gone_on_with_is_the_same(run, at, broken, tmp_path):
    job = fit(tmp_path, (3, 4))
    for _ in itertools.islice(job.chunks(), at + 1):
        pass  # the checkpoint of the last of them is never written
    for seed in (3, 4):
        with open(tmp_path / f"seed{seed}.bin", "ab") as file:
            file.write(b"\x7f" * (36 * 7 + 5))  # rows that no checkpoint counts, the last one torn
    newest = max((tmp_path / "checkpoints").iterdir())
    assert int(newest.stem) == 8 * at
    if broken and at > 0:
        newest.write_bytes(newest.read_bytes()[:100])  # then the one before it counts
    again = fit(tmp_path, (3, 4))
    again.resume()
    assert again.step == 8 * (at - (broken and at > 0))
    assert again.source.experience.count == SETTINGS.steps(again.step)
    for _ in again.chunks():
        pass
    assert same(again, run[0])
    for lane, seed in enumerate((3, 4)):
        assert rows_of(tmp_path / f"seed{seed}.bin").tobytes() == run[2][lane].tobytes()


@pytest.mark.parametrize("chunk", [8, 40])
def test_a_lane_whose_numbers_go_bad_is_marked_and_the_other_goes_on(run, chunk, tmp_path):
    job = fit(tmp_path, (3, 4), chunk, lanes=[Counter(), Counter(breaks=20.0)])
    for progress in job.chunks():
        assert np.isnan(progress.metrics["oldest"][1]) == (progress.step > 20)
        assert np.isfinite(progress.metrics["oldest"][0])
    assert progress.step == UPDATES
    assert job.failures == (None, ("updates", 20))
    np.testing.assert_array_equal(job.states["updates"], [UPDATES, 16 if chunk == 8 else 0])  # the last good state
    assert rows_of(tmp_path / "seed3.bin").tobytes() == run[2][0].tobytes()
    rows = rows_of(tmp_path / "seed4.bin")  # it goes on acting, so that the simulator need not know
    assert rows.shape == run[2][1].shape
    assert np.isfinite(rows).all()


def test_when_every_lane_has_failed_the_fit_ends(tmp_path):
    job = fit(tmp_path, (3, 4), lanes=[Counter(breaks=30.0), Counter(breaks=20.0)])
    assert [p.step for p in job.chunks()] == [8, 16, 24, 32]
    assert job.failures == (("updates", 30), ("updates", 20))


def test_updates_that_end_inside_a_block_are_rounded_up_to_it():
    job = fit(updates=20)
    assert job.steps == 24
    # With less room, the newest rows would be written over older ones without a word.
    assert job.source.experience.replay.buffer.shape[1] == SETTINGS.steps(24) == 80 + 3 * 16


# ---- refusals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bc", "td3", "td3_bc", "bear", "bear_is"])
def test_agents_that_do_not_explore_are_refused(name):
    agent = agents.agent_class(name)()
    with pytest.raises(UserError, match=rf"^{type(agent).__name__} does not learn online$"):
        Exploration(TASK, agent, [0], 8, SETTINGS)


@pytest.mark.parametrize("asks", [
    BatchSpec(n_step=2), BatchSpec(window=3), BatchSpec(initial=4), BatchSpec(("observation", "return_to_go")),
])  # fmt: skip
def test_batches_that_rows_in_the_making_do_not_have_are_refused(asks):
    class Asks(Counter):
        def needs(self, spec):
            return asks

    with pytest.raises(UserError, match="Asks does not learn online"):
        Exploration(TASK, Asks(), [0], 8, SETTINGS)


def test_observations_are_not_standardised_where_none_are_known():
    class Asks(Counter):
        def needs(self, spec):
            return BatchSpec(standardise=True)

    with pytest.raises(UserError, match="Asks.standardise: observations are standardised by those of a log, .* leave it out"):
        Exploration(TASK, Asks(), [0], 8, SETTINGS)


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_large_observations_are_told_of_once(monkeypatch, recwarn, unit):
    see = Clocks.see
    monkeypatch.setattr(Clocks, "see", lambda self: see(self) * np.float32([1.0, unit]))
    list(fit(updates=16).chunks())
    told = [str(each.message) for each in recwarn if "networks learn slowly" in str(each.message)]
    assert len(told) == (unit > 1.0)
    for text in told:
        assert re.match(r"ticking: observation 1 is \d+ in size \(root mean square\); .* in other units", text)


def test_pictures_are_refused():
    with pytest.raises(UserError, match="ticking: online learning needs flat observations, it has shape"):
        Exploration(replace(TASK, observation_shape=(8, 8, 3)), Counter(), [0], 8, SETTINGS)


def test_learners_with_phases_are_refused():
    class Prepares(Counter):
        def prepare(self, state, rows, key, fit):
            return state

    with pytest.raises(UserError, match="Prepares prepares itself on a whole log and cannot learn online"):
        fit(lanes=[Prepares()])


# ---- logs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [240, 239, 238, 121, 7, 3, 1, "fall"])
def test_a_replay_file_becomes_a_log_of_whole_copies(run, steps, tmp_path):
    rows = run[2][0]
    if steps == "fall":  # the recording stops just where an episode ends by itself
        steps = int(np.flatnonzero(rows[:, 7])[0]) + 1
    path = tmp_path / "rows.bin"
    rows.tofile(path)
    log = replay_log(path, TASK, 4, steps, name="r", provenance=Provenance("collected", "r", 0))
    assert len(log) == steps
    assert log.dropped == 0
    assert log.action_space == TASK.action_space
    row = 0
    for copy in range(min(4, steps)):
        mine = rows[:steps][copy::4]
        for k, each in enumerate(mine):
            np.testing.assert_array_equal(log.observations[row], each[:2])
            np.testing.assert_array_equal(log.actions[row], each[2:4])
            np.testing.assert_array_equal(log.next_observations_at(np.array([row]))[0], each[5:7])
            assert (log.rewards[row], log.terminals[row]) == (each[4], each[7] > 0)
            cut = k == len(mine) - 1 and not each[7]
            assert log.timeouts[row] == (each[8] > 0 or cut)
            row += 1
    # Steps are counted from 0 in every episode, so none holds parts of two.
    np.testing.assert_array_equal(log.observations[log.starts][:, 1], 0)
    np.testing.assert_array_equal(log.observations[:, 1], np.arange(steps) - log.starts[log.episode_of])


def test_a_replay_file_that_is_too_short_for_the_log_is_told(run, tmp_path):
    path = tmp_path / "rows.bin"
    run[2][0].tofile(path)
    with pytest.raises(UserError, match=r"rows.bin holds 240 rows"):
        replay_log(path, TASK, 4, 241, name="r", provenance=Provenance())


@pytest.fixture
def hopper(monkeypatch):
    """Hopper, as if its policies had been made by a run of `Little`."""
    monkeypatch.setattr(gym, "SAC", Little)
    monkeypatch.setattr(trained, "CHUNK", 8)
    online = {"copies": 4, "explore": 16, "updates_per_step": 0.5, "block": 16}
    about = {"run": {"agent": {"lr": 0.01, "hidden": [4], "batch_size": 8}, "online": online, "versions": versions()}}
    monkeypatch.setattr(library, "about", lambda name: about)
    return tasks.task("hopper")


@pytest.mark.slow
def test_medium_replay_has_any_number_of_rows_and_begins_like_a_longer_one(hopper, tmp_path):
    whole = gym.collect_replay(hopper, name="h", steps=64, scratch=tmp_path / "whole")
    assert len(whole) == 64
    for steps in (1, 63):  # less than the exploration, and between two blocks
        told = []
        tell = lambda *done, told=told: told.append(done)  # noqa: E731
        part = gym.collect_replay(hopper, name="h", steps=steps, scratch=tmp_path / str(steps), progress=tell)
        assert len(part) == steps
        assert told[-1] == (steps, steps)
        first = len(range(0, steps, 4))  # rows of the first copy
        np.testing.assert_array_equal(part.actions[:first], whole.actions[:first])
    other = gym.collect_replay(hopper, name="h", steps=64, seed=1, scratch=tmp_path / "other")
    assert not (other.actions == whole.actions).any()


@pytest.mark.slow
def test_medium_replay_is_the_run_that_the_policies_came_from(hopper, tmp_path):
    """Other capacity, chunks and pauses than `train_online` has, and yet the same rows."""
    run = library.about("hopper")["run"]
    settings, agent = Online(**run["online"]), Little(**gym._fields(run["agent"]))
    steps = settings.explore + 5 * settings.block
    out = dr.train_online(
        agent, hopper, steps=steps + 4 * settings.block, settings=settings, chunk=100, evaluate_every=64, episodes=1,
        out=tmp_path / "run",
    )  # fmt: skip
    theirs = replay_log(
        out.path / "replay" / "seed0.bin", hopper, settings.copies, steps, name="x", provenance=Provenance()
    )
    made = gym.collect_replay(hopper, name="h", steps=steps, scratch=tmp_path / "again")
    for key in ("observations", "actions", "rewards", "terminals", "timeouts"):
        np.testing.assert_array_equal(getattr(made, key), getattr(theirs, key))


@pytest.mark.slow
def test_medium_replay_does_not_go_on_with_another_collection(hopper, tmp_path):
    whole = gym.collect_replay(hopper, name="h", steps=64, scratch=tmp_path)
    for change in ({"seed": 1}, {"steps": 48}, {"steps": 80}, {"name": "i"}):
        with pytest.raises(UserError, match="holds the beginning of another collection"):
            gym.collect_replay(hopper, **({"name": "h", "steps": 64, "scratch": tmp_path} | change))
    again = gym.collect_replay(hopper, name="h", steps=64, scratch=tmp_path)
    assert again.fingerprint == whole.fingerprint
