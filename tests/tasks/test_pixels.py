import os
import subprocess
import sys
from dataclasses import dataclass

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from opengl import needs_opengl

import deadreckon as dr
from deadreckon.agents.bc import BC
from deadreckon.collect.driving import collect_driving, pursue
from deadreckon.collect.rollouts import Segment, collect_rollouts
from deadreckon.data.formats.hdf5 import read_hdf5, write_hdf5
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.policies.policy import BlackBoxPolicy
from deadreckon.runs.evaluate import evaluate
from deadreckon.tasks import driving, town
from deadreckon.tasks.pixels import Pixels
from deadreckon.tasks.registry import of_run
from deadreckon.tasks.registry import task as find
from deadreckon.tasks.simulator_env import SimulatorEnv
from deadreckon.tasks.task import Reference, Task
from tests.marks import slow


@dataclass(frozen=True)
class Counting(Task):
    """Counts steps from the copy's seed on; its camera shows the count."""

    def simulate(self, seeds, threads=None):
        return Counter(seeds)


class Renderer(tuple):
    closed = 0

    def close(self):
        Renderer.closed += 1


class Counter:
    def __init__(self, seeds):
        self.seeds, self.count, self.age, self.drawn = list(seeds), np.zeros(len(seeds)), np.zeros(len(seeds), int), 0

    def reset(self, which=None, seeds=None):
        which = np.arange(len(self.count)) if which is None else np.asarray(which)
        for i, copy in enumerate(which):
            self.seeds[copy] = self.seeds[copy] if seeds is None else seeds[i]
            self.count[copy], self.age[copy] = self.seeds[copy], 0
        return self.count[which, None].astype(np.float32)

    def step(self, actions):
        self.count += 1
        self.age += 1
        over = self.age >= 5
        return self.count[:, None].astype(np.float32), self.count.copy(), np.zeros(len(over), bool), over

    def state(self):
        return {"count": self.count.copy(), "age": self.age.copy()}

    def restore(self, state):
        self.count, self.age = state["count"].copy(), state["age"].copy()

    def renderer(self, size, plain=False):
        assert plain
        return Renderer(size)

    def picture(self, copy, size, renderer=None):
        assert renderer == size
        self.drawn += 1
        return renderer, np.full((*size, 3), self.count[copy] % 256, np.uint8)


BASE = Counting("counting", "test", 5, (1,), Box((-1.0,), (1.0,)), "", Reference(0.0, 1.0, "test"))
SEEN = Pixels.of(BASE, (4, 6), 3, "counting:pixels")
STILL = np.zeros((2, 1), np.float32)


def test_frames_are_the_last_ones_the_newest_last():
    simulator = SEEN.simulate([10, 20])
    first = simulator.reset()
    assert (SEEN.observation_shape, first.shape, first.dtype) == ((4, 6, 9), (2, 4, 6, 9), np.uint8)
    assert (first[0] == 10).all()
    for _ in range(2):
        seen, rewards, _, _ = simulator.step(STILL)
    np.testing.assert_array_equal(seen[1, 0, 0], [20] * 3 + [21] * 3 + [22] * 3)
    assert rewards.tolist() == [12, 22]
    np.testing.assert_array_equal(simulator.seen[:, 0], [12, 22])
    before = seen.copy()
    simulator.step(STILL)
    np.testing.assert_array_equal(seen, before)  # what was given is not written to again


def test_an_episode_that_is_over_is_not_drawn_again():
    simulator = SEEN.simulate([0, 0])
    simulator.reset()
    for _ in range(4):
        simulator.step(STILL)
    assert simulator.step(STILL)[3].all()
    drawn = simulator.base.drawn
    simulator.step(STILL)
    assert simulator.base.drawn == drawn == 12
    simulator.reset(np.array([1]))
    simulator.step(STILL)
    assert simulator.base.drawn == drawn + 2


def test_restored_simulators_show_the_same_frames():
    one = SEEN.simulate([3, 4])
    one.reset()
    one.step(STILL)
    other = SEEN.simulate([0, 0])
    assert other.restore(one.state()) is None
    for _ in range(3):
        for a, b in zip(one.step(STILL), other.step(STILL), strict=True):
            np.testing.assert_array_equal(a, b)


def test_policies_are_judged_by_what_the_camera_shows():
    seen = []

    def act(observations, rng):
        seen.append(observations)
        return np.zeros((len(observations), 1), np.float32)

    closed = Renderer.closed
    result = evaluate(BlackBoxPolicy(act), SEEN, episodes=3, record=2)
    assert Renderer.closed == closed + 1
    assert {(each.dtype.name, each.shape) for each in seen} == {("uint8", (3, 4, 6, 9))}
    assert result.trajectories is not None
    assert result.trajectories.shape == (1, 2, 5, 1)  # what pictures are drawn from, and no pictures


def test_a_log_of_pictures_is_the_same_twice_and_in_its_file(tmp_path):
    logs = [
        collect_rollouts(
            SEEN, [Segment(None, 130)], name="counting", seed=5, provenance=Provenance("collected"), scratch=tmp_path / name
        )
        for name in ("one", "two")
    ]
    assert (logs[0].fingerprint, logs[0].observations.dtype) == (logs[1].fingerprint, np.uint8)
    assert logs[0].final_observations.dtype == np.uint8
    write_hdf5(logs[0], tmp_path / "packed.hdf5", compress=True)
    write_hdf5(logs[0], tmp_path / "plain.hdf5")
    assert (tmp_path / "packed.hdf5").stat().st_size < (tmp_path / "plain.hdf5").stat().st_size
    for name in ("packed", "plain"):
        assert read_hdf5(tmp_path / f"{name}.hdf5").fingerprint == logs[0].fingerprint
    assert read_hdf5(tmp_path / "plain.hdf5", mmap=True).fingerprint == logs[0].fingerprint
    with pytest.raises(UserError, match="is stored in chunks or compressed"):
        read_hdf5(tmp_path / "packed.hdf5", mmap=True)


@pytest.mark.parametrize(("matter", "asked", "shift"), [(True, None, 0), (False, None, 1), *slow((True, 3, 3))])
def test_pictures_are_shifted_where_places_in_them_do_not_matter(matter, asked, shift, tmp_path):
    seen = Pixels.of(BASE, (16, 16), 1, "counting:pixels", places_matter=matter)
    log = collect_rollouts(
        seen, [Segment(None, 30)], name="counting", seed=5, provenance=Provenance("collected"), scratch=tmp_path / "log"
    )
    run = dr.train(BC(hidden=(4,), batch_size=4), log, steps=1, task=seen, episodes=1, out=tmp_path / "run", shift=asked)
    assert run.config["shift"] == shift


def test_names():
    found = find("walker2d:pixels")
    assert (found.name, found.observation_shape, found.horizon) == ("walker2d:pixels", (84, 84, 9), 1000)
    assert of_run("walker2d:pixels") == found
    for name in ("stranger:pixels?size=3", "stranger:Env:pixels", "stranger:Env?size=3:pixels"):
        with pytest.raises(UserError, match="name it with --task, or import stranger first"):
            of_run(name)
    with pytest.raises(UserError, match="carla-lane has image observations already; leave :pixels out"):
        find("carla-lane:pixels")
    with pytest.raises(UserError, match="battery cannot be rendered"):
        find("battery:pixels").simulate([0])
    with pytest.raises(UserError, match="unknown task 'wolker2d'"):
        find("wolker2d:pixels")


def test_pictures_may_be_larger_than_the_models_own_buffer(monkeypatch):
    simulator = find("hopper").simulate([0])
    drawn = simulator._model.vis.global_
    own, seen = (drawn.offheight, drawn.offwidth), []

    class Renderer:
        def __init__(self, model, height, width):
            seen.append((model.vis.global_.offheight, model.vis.global_.offwidth))

    monkeypatch.setattr(simulator._mujoco, "Renderer", Renderer, raising=False)
    for size in ((720, 1280), (84, 84), (84, 1280)):
        simulator.renderer(size)
    assert seen == [(720, 1280), own, (own[0], 1280)]
    assert (drawn.offheight, drawn.offwidth) == own == (480, 640)  # the model is shared


@needs_opengl
def test_large_pictures_are_drawn():
    env = SimulatorEnv("hopper", render_mode="rgb_array", width=1280, height=720)
    env.reset(seed=0)
    assert env.render().shape == (720, 1280, 3)
    env.close()


def test_without_opengl_one_line_says_what_is_missing():
    code = "from deadreckon.tasks.registry import task; task('walker2d:pixels').simulate([0]).reset()"
    env = {name: value for name, value in os.environ.items() if name != "DISPLAY"} | {"MUJOCO_GL": "disabled"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert "walker2d:pixels is drawn with OpenGL, which MuJoCo does not find; without a screen set MUJOCO_GL=egl" in done.stderr


@needs_opengl
@pytest.mark.parametrize("task", [driving.SEEN, town.SEEN], ids=lambda task: task.name)
def test_the_road_is_seen_and_restored(task):
    simulator, base = task.simulate([0, 1]), task.base.simulate([0, 1])
    first = simulator.reset()
    np.testing.assert_array_equal(simulator.seen, base.reset())
    assert (first.shape, first.dtype) == ((2, 48, 48, 3), np.uint8)
    sky, ground = first[:, :20].astype(float), first[:, 28:].astype(float)
    assert (sky[..., 2].mean() > ground[..., 2].mean()) & (np.ptp(first[0]) > 100)
    actions = np.array([[1.0, 0.3], [0.5, -0.3]], np.float32)
    for _ in range(4):
        moved = simulator.step(actions)
        np.testing.assert_array_equal(moved[1], base.step(actions)[1])
    other = task.simulate([7, 8])
    other.restore(simulator.state())
    np.testing.assert_array_equal(simulator.step(actions)[0], other.step(actions)[0])
    assert (moved[0] != first).any()


@needs_opengl
def test_the_controller_drives_by_what_pictures_are_drawn_from(tmp_path):
    """So the log of pictures has the rewards and actions of the log of states."""
    seen, state = (
        collect_driving(task, "controller", name="carla-lane-v0", steps=300, seed=1, scratch=tmp_path / task.name)
        for task in (driving.SEEN, driving.TASK)
    )
    np.testing.assert_array_equal(seen.rewards, state.rewards)
    np.testing.assert_array_equal(seen.actions, pursue(np.asarray(state.observations)))
    assert seen.observations.shape == (300, 48, 48, 3)


@needs_opengl
def test_gymnasiums_checks():
    env = gymnasium.make(driving.SEEN.gym_id)
    assert env.observation_space == gymnasium.spaces.Box(0, 255, (48, 48, 3), np.uint8)
    check_env(env.unwrapped, skip_render_check=True)


@needs_opengl
@pytest.mark.slow
def test_a_policy_learns_from_drawn_pictures_and_is_judged_by_them(tmp_path):
    log = collect_driving(driving.SEEN, "controller", name="carla-lane-v0", steps=3_000, scratch=tmp_path / "log")
    run = dr.train("bc", log, steps=500, task="carla-lane", episodes=5, out=tmp_path / "run")
    assert evaluate(run, "carla-lane", episodes=10).score().value > 10.0
