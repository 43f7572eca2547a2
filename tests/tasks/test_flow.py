"""Flow: the roads, their physics, and SUMO's processes."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from walks import walk

import deadreckon as dr
import deadreckon.tasks.envs
from deadreckon import tasks
from deadreckon.errors import UserError
from deadreckon.tasks import sumo as sumo_process
from deadreckon.tasks.flow_env import FlowEnv
from deadreckon.tasks.flow_merge import Merge
from deadreckon.tasks.flow_roads import CAR, Ring
from deadreckon.tasks.task import PROPERTIES

sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="SUMO is not installed (the extra `flow`)")
RING, MERGE = tasks.task("flow-ring"), tasks.task("flow-merge")
roads = pytest.mark.parametrize("task", [RING, MERGE], ids=["ring", "merge"])


def moves(task, steps, copies, seed=0):
    low, high = np.array(task.action_space.low), np.array(task.action_space.high)
    return np.random.default_rng(seed).uniform(low, high, (steps, copies, len(low))).astype(np.float32)


def same(ours, theirs):
    return len(ours) == len(theirs) and all(np.array_equal(a, b) for a, b in zip(ours, theirs))


@pytest.mark.slow
@sumo
@roads
def test_a_copy_depends_on_its_own_seed_and_actions_alone(task):
    """Whatever drives beside it, in whichever process, and however late in SUMO's time."""
    task = replace(task, horizon={"ring": 13, "merge": 45}[task.road])
    steps = 2 * task.horizon + 5
    actions = moves(task, steps, 16)
    many, few = task.simulate(range(16), threads=2), task.simulate([13, 3], threads=1)
    assert len(many._traffic._sumos) == 2
    rows = {"many": [many.reset()[[13, 3]]], "few": [few.reset()]}
    for t in range(steps):
        if t == 20:  # the others begin anew, which is none of these two's business
            many.reset(np.setdiff1d(np.arange(16), [13, 3]))
        for name, simulator, mine in (("many", many, [13, 3]), ("few", few, [0, 1])):
            out = simulator.step(actions[t] if simulator is many else actions[t][[13, 3]])
            rows[name] += [part[mine] for part in out]
            over = np.flatnonzero(out[2] | out[3])
            if len(over):
                again = simulator.reset(over)
                rows[name] += [again[over == i] for i in mine if i in over]
    assert same(rows["many"], rows["few"])
    assert len(rows["few"]) > 4 * steps + 1  # episodes ended and began anew
    assert sum(part.any() for part in rows["few"] if part.ndim == 2) > 10  # learners have been seen


@pytest.mark.slow
@sumo
@roads
def test_restored_elsewhere_it_goes_on_to_the_bit(task):
    task = replace(task, horizon={"ring": 20, "merge": 45}[task.road])
    actions = moves(task, 2 * task.horizon, 4)
    whole, other = task.simulate(range(4)), task.simulate([8, 9, 10, 11])
    whole.reset()
    walk(whole, actions[:11])
    whole.reset(np.array([1, 3]))  # so that copies are of different ages
    walk(whole, actions[11:20])
    state = whole.state()
    unbroken = walk(whole, actions[20:])
    other.reset()
    walk(other, actions[:7])
    other.restore(state)
    assert same(unbroken, walk(other, actions[20:]))
    assert any(len(part) < 4 for part in unbroken)


@pytest.mark.slow
@sumo
@roads
def test_gymnasiums_checks(task):
    assert gymnasium.spec(task.gym_id).max_episode_steps == task.horizon
    env = gymnasium.make(task.gym_id)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.slow
@sumo
def test_the_environment_equals_the_simulator_to_the_time_limit():
    env, simulator = gymnasium.make(RING.gym_id), RING.simulate([5])
    np.testing.assert_array_equal(env.reset(seed=5)[0], simulator.reset()[0])
    for t, action in enumerate(2.0 * moves(RING, RING.horizon, 1)):  # beyond the bounds, too
        seen, reward, terminated, truncated, _ = env.step(action[0])
        following, rewards, terminals, timeouts = simulator.step(action)
        np.testing.assert_array_equal(seen, following[0])
        assert reward == rewards[0]
        assert (terminated, truncated) == (terminals[0], timeouts[0]) == (False, t == RING.horizon - 1)
    np.testing.assert_array_equal(env.reset()[0], simulator.reset()[0])
    env.close()


@pytest.mark.slow
@sumo
def test_ring_by_hand():
    """Observation and reward from the places and speeds of all cars, and where they stand at first."""
    env = FlowEnv(RING)
    env.reset(seed=3)
    length = int(RING.start(np.random.default_rng(3))[0])
    cars = env.traffic()
    gaps = (np.roll(cars[:, 1], -1) - cars[:, 1]) % length
    even = (length - Ring.BUNCHING) / Ring.CARS
    expected = np.full(Ring.CARS, even)
    expected[-1] += Ring.BUNCHING
    assert np.abs(gaps - expected).max() <= 2 * Ring.JITTER
    assert not cars[:, 2].any()
    for action in (0.7, -0.4, 3.0):
        before = env.traffic()[-1, 2]
        seen, reward, *_ = env.step(np.array([action]))
        cars = env.traffic()
        speed, leading = cars[-1, 2], cars[0, 2]
        taken = np.clip(action, -1, 1)
        assert speed == pytest.approx(max(before + 0.5 * taken, 0.0))
        way = (cars[0, 1] - cars[-1, 1]) % length
        np.testing.assert_allclose(seen, [speed / 15, (leading - speed) / 15, way / 270], rtol=1e-6)
        assert reward == pytest.approx(0.2 * cars[:, 2].mean() - 4.0 * abs(taken), rel=1e-6)
    env.close()


@sumo
def test_merge_by_hand():
    env = FlowEnv(MERGE)
    assert not env.reset(seed=3)[0].any()  # no learner yet
    np.testing.assert_allclose(env.traffic()[:, 1], Merge.STANDING)
    learners = [5 + i for i, car in enumerate(Merge.schedule(MERGE.horizon)) if car[3]]
    most = 0
    for action in moves(MERGE, 120, 1):
        seen, reward, *_ = env.step(action[0])
        cars = env.traffic()
        speeds = dict(zip(cars[:, 0], cars[:, 2]))
        mine = [number for number in learners if number in speeds][:5]
        most = max(most, len(mine))
        rows = seen.reshape(5, 5)
        np.testing.assert_allclose(rows[: len(mine), 0], [speeds[number] / 30 for number in mine], rtol=1e-6)
        assert not rows[len(mine) :].any()
        assert rows[: len(mine)].any(1).all()
        near = max(20 * np.sqrt(len(cars)) - np.linalg.norm(cars[:, 2] - 20), 0) / (20 * np.sqrt(len(cars)))
        gaps = 900.0 * rows[: len(mine), 2].astype(float)
        alone = np.isclose(gaps, 900.0) & np.isclose(rows[: len(mine), :2].sum(1), 1.0)  # nobody ahead
        close = sum(min(gap / speeds[n] - 1, 0) for n, gap, free in zip(mine, gaps, alone) if speeds[n] > 0 and not free)
        assert reward == pytest.approx(max(near + 0.1 * close, 0), abs=1e-5)
        places = dict(zip(cars[:, 0], cars[:, 1]))
        for number, row in zip(mine, rows):
            behind = [(places[number] - place, other) for other, place in places.items() if place < places[number]]
            gap, other = min(behind, default=(900.0 + CAR, None))
            if places[number] < 600 or other is None:  # beyond, someone on the ramp may be nearer
                speed = 0.0 if other is None else speeds[other]
                np.testing.assert_allclose(row[3:], [(speeds[number] - speed) / 30, (gap - CAR) / 900], atol=1e-6)
            else:
                assert 900 * row[4] <= gap - CAR + 1e-3
    assert most >= 3
    highway = cars[np.isfinite(cars[:, 1])]
    highway = highway[np.argsort(highway[:, 1])]
    assert np.diff(highway[:, 1]).min() > CAR  # one behind the other
    env.close()


@pytest.mark.slow
@sumo
def test_a_crash_is_terminal_and_pays_nothing():
    reckless = replace(RING, guarded=False, horizon=200)
    simulator, careful = reckless.simulate([0, 1]), replace(RING, horizon=200).simulate([0, 1])
    simulator.reset(), careful.reset()
    over = np.zeros(2, bool)
    for _ in range(60):
        _, rewards, terminals, timeouts = simulator.step(np.ones((2, 1)))
        assert not timeouts.any()
        assert not rewards[terminals | over].any()
        over |= terminals
        assert not careful.step(np.ones((2, 1)))[2].any()
    assert over.all()
    seen = simulator.reset(np.array([1]))
    assert seen[0, 2] > 0.1
    assert not simulator.step(np.zeros((2, 1)))[2].any()  # it drives again, and the other rests


@sumo
def test_pictures_are_drawn_from_all_cars():
    from deadreckon.runs.evaluate import evaluate

    class Still:
        has_log_prob = False

        def start(self, n):
            return ()

        def act(self, step, carry, key, *, greedy):
            return np.zeros((len(step.observation), 1), np.float32), carry

    task = replace(RING, horizon=4)
    found = evaluate(Still(), task, episodes=3, record=2)
    assert found.trajectories.shape == (1, 2, 4, Ring.CARS, 2)
    assert np.isfinite(found.trajectories).all()
    assert not found.trajectories[:, :, 0, :, 1].any()  # all stand at first
    assert (found.trajectories[:, :, -1, :-1, 1] > 0).sum() > Ring.CARS
    assert not found.trajectories[:, :, :, task.learners[0], 1].any()  # the learner does not move
    assert len(np.unique(found.returns)) == 3


def test_properties_are_those_of_the_thesis():
    for name in tasks.names():
        found = tasks.task(name)
        assert set(found.properties) <= set(PROPERTIES)
    assert RING.properties == MERGE.properties == ("non-representable policies", "realistic")  # 7.3
    assert tasks.task("maze2d-umaze").properties[-1] == "temporally extended"  # Table 8.1: T
    assert "high-dimensional" in tasks.task("ant").properties  # Table 8.1: H


# ---- physics ----------------------------------------------------------------------------------------------------------


def equilibrium(length):
    """Speed at which 22 cars that follow the intelligent driver model drive evenly: its acceleration there is 0."""
    low, high = 0.0, 30.0
    gap = length / Ring.CARS - CAR
    for _ in range(60):
        speed = (low + high) / 2
        low, high = (speed, high) if (2.0 + speed) / np.sqrt(1.0 - (speed / 30.0) ** 4) < gap else (low, speed)
    return low


@pytest.mark.slow
@sumo
def test_drivers_form_waves_that_a_follower_stopper_dissolves():
    """Sugiyama et al. 2008 saw the waves, Stern et al. 2018 one car dissolve them; driving evenly has a closed form."""
    from deadreckon.collect.flow import FollowerStopper, Idm, PISaturation

    task = replace(RING, horizon=1000)  # more than eight minutes
    seeds = range(2)
    lengths = [task.start(np.random.default_rng(seed))[0] for seed in seeds]
    even = np.array([equilibrium(length) for length in lengths])
    calm = 0.9 * even[:, None]
    speeds, returns = {}, {}
    for name, controller in (("idm", Idm(task)), ("stopper", FollowerStopper(task, calm)), ("pi", PISaturation(task))):
        simulator = task.simulate(seeds)
        seen, returns[name], kept = simulator.reset(), np.zeros(2), []
        for t in range(task.horizon):
            seen, rewards, terminals, _ = simulator.step(controller(seen))
            assert not terminals.any()
            returns[name] += rewards
            if t > 700 and t % 5 == 0 and t < task.horizon - 1:
                kept.append(simulator.traffic(np.arange(2))[:, 3].reshape(2, Ring.CARS))
        simulator.close()
        speeds[name] = np.array(kept)  # (times, copies, cars)
    spread = {name: each.std((0, 2)) for name, each in speeds.items()}
    mean = {name: each.mean((0, 2)) for name, each in speeds.items()}
    assert (spread["idm"] > 2.0).all()  # m/s
    assert (speeds["idm"].min((0, 2)) < 0.1).all()  # cars stop,
    assert (speeds["idm"].max((0, 2)) > 6.0).all()  # and go
    assert (mean["idm"] < 0.85 * even).all()  # which costs all of them
    np.testing.assert_allclose(speeds["stopper"], np.broadcast_to(calm, speeds["stopper"].shape), rtol=0.01)
    assert (mean["pi"] > 1.15 * mean["idm"]).all()  # it does not know the ring's length
    assert (spread["pi"] < 0.5 * spread["idm"]).all()
    assert (returns["stopper"] > returns["idm"]).all()
    assert (returns["pi"] > returns["idm"]).all()


# ---- processes --------------------------------------------------------------------------------------------------------


def gone(pid, seconds=10.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        stat = Path(f"/proc/{pid}/stat")
        if stat.exists() and stat.read_text().rsplit(")", 1)[1].split()[0] == "Z":
            return True  # it has ended; nobody has asked how
        time.sleep(0.05)
    return False


@pytest.mark.slow
@sumo
def test_processes_end_with_what_started_them():
    task = replace(RING, horizon=5)
    for close in (True, False, True):  # again and again
        simulator = task.simulate([0])
        pid = simulator._traffic._sumos[0].process.pid
        first = simulator.reset()
        if close:
            simulator.close()
            with pytest.raises(UserError, match="closed"):
                simulator.reset()
        del simulator
        assert gone(pid)
    code = (
        "import os, signal; from deadreckon import tasks; s = tasks.task('flow-ring').simulate([0]); s.reset();"
        "print(s._traffic._sumos[0].process.pid, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    crashed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert crashed.returncode == -signal.SIGKILL
    assert gone(int(crashed.stdout))
    np.testing.assert_array_equal(first, task.simulate([0]).reset())


@sumo
def test_a_dead_process_is_told_in_one_line():
    simulator = RING.simulate([0])
    simulator.reset()
    simulator._traffic._sumos[0].process.kill()
    with pytest.raises(UserError, match="flow-ring: SUMO's process ended with -9"):
        simulator.step(np.zeros((1, 1)))


@pytest.mark.slow
@sumo
def test_bad_actions():
    simulator = RING.simulate([0, 1])
    simulator.reset()
    with pytest.raises(UserError, match="shape"):
        simulator.step(np.zeros((2, 2)))
    with pytest.raises(UserError, match="copy 1"):
        simulator.step(np.array([[0.0], [np.nan]]))
    with pytest.raises(UserError, match="seed"):
        RING.simulate([])


def test_without_sumo_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr(sumo_process.importlib.util, "find_spec", lambda name: None)
    told = r"^flow-merge needs SUMO, which is not installed: install the extra flow"
    with pytest.raises(UserError, match=told):
        MERGE.simulate([0])
    with pytest.raises(UserError, match=told):
        dr.collect.generate("flow-merge-controller-v0", steps=10)


def test_what_is_published_is_near():
    """Uniform actions, measured by D4RL and here: the roads are the same."""
    for task in (RING, MERGE):
        assert task.reference.random == pytest.approx(task.published.random, rel=0.1)
        assert task.reference.expert > task.reference.random
