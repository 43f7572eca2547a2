"""Logs made by policies, beside a rollout written here in plain Python; kills, cuts, densities."""

import dataclasses
import itertools
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import gymnasium
import jax
import numpy as np
import pytest

import deadreckon as dr
from deadreckon import tasks
from deadreckon.collect import rollouts
from deadreckon.collect.gym import collect_gym
from deadreckon.collect.in_task import _content, collect_in_task
from deadreckon.collect.rollouts import Segment, collect_rollouts, played
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Box, Spec
from deadreckon.errors import UserError
from deadreckon.files import read_json
from deadreckon.nets.mlp import MLP
from deadreckon.policies import BlackBoxPolicy, EnvPolicy, library
from deadreckon.policies.kinds import Categorical, ClippedGaussian, Gaussian, TanhGaussian

# Bounds that are neither symmetric nor of width 2, and episodes that end both ways.
HOPPER = replace(tasks.task("hopper"), horizon=16, action_space=Box((-0.9, -0.5, -1.0), (0.3, 1.0, 0.6)))
MAZE = replace(tasks.task("maze2d-umaze-dense"), horizon=120)  # so long that progress is told inside an episode
LOW, HIGH = (np.array(side, np.float32) for side in (HOPPER.action_space.low, HOPPER.action_space.high))


def policy(task, seed=0):
    spec = Spec.empty(task.observation_shape, task.action_space, task.name)
    rng, sizes = np.random.default_rng(seed), (spec.observation_size, 8, 2 * spec.action_size)
    weights = tuple(rng.normal(0, 0.5 * i**-0.5, (i, o)).astype(np.float32) for i, o in itertools.pairwise(sizes))
    net = MLP(weights, tuple(np.zeros(o, np.float32) for o in sizes[1:]))
    return EnvPolicy.of(TanhGaussian(net), Normalizer.of(spec))


POLICY = policy(HOPPER)
BOTH = [Segment(POLICY, 1501), Segment(None, 700)]  # neither ends with an episode


@eqx.filter_jit
def density(policy, observations, actions):
    return policy.log_prob(observations, actions)


class Killed(Exception):
    pass


@pytest.fixture(autouse=True, scope="module")
def _small_portions():
    """Rows go to the disk in small portions, so that short logs have several."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollouts, "FLUSH", 200)
        yield


def log(folder, segments=BOTH, task=HOPPER, seed=0, **options):
    return collect_rollouts(task, segments, name="rolled", seed=seed, provenance=Provenance(), scratch=folder, **options)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The log of `BOTH`, and what was told of its progress."""
    told = []
    return log(tmp_path_factory.mktemp("both"), progress=lambda done, total: told.append((done, total))), told


def by_hand(task, rows, seed):
    """Uniform actions, one copy at a time and one step at a time: (observation, action, reward, terminal, timeout, final)."""
    root = jax.random.fold_in(jax.random.key(seed), 0)
    low, high = (np.array(side, np.float32) for side in (task.action_space.low, task.action_space.high))
    out = []
    for episode in itertools.count():
        start = np.random.SeedSequence([seed, 0, episode]).generate_state(1, np.uint64)[0]
        simulator, own = task.simulate([int(start)]), jax.random.fold_in(root, episode)
        observation, over = simulator.reset()[0], False
        for t in range(task.horizon):
            action = np.array(jax.random.uniform(jax.random.fold_in(own, t), low.shape, minval=low, maxval=high))
            following, reward, terminal, timeout = (part[0] for part in simulator.step(action[None]))
            over = terminal or timeout
            out.append((observation, action, reward, terminal, timeout, following if over else None))
            observation = following
            if len(out) == rows and not over:
                out[-1] = (*out[-1][:4], True, following)
            if over or len(out) == rows:
                break
        if len(out) == rows:
            break
    return [np.array([x for x in column if x is not None]) for column in zip(*out)]


def test_actions_are_computed_on_the_processor(tmp_path, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    held = []

    def acts(observations):
        held.append(jax.config.jax_default_device)
        return np.zeros((len(observations), 2), np.float32)

    made = rollouts.acted_in("gymnasium", "x", 0, {})
    collect_rollouts(tasks.task(MAZE), [Segment(acts, 3)], name="x", seed=0, provenance=made, scratch=tmp_path)
    assert {device.platform for device in held} == {"cpu"} == {made.extra["device"]}


@pytest.mark.slow
@pytest.mark.parametrize(("task", "rows"), [(HOPPER, 900), (MAZE, 400)])
def test_uniform_actions_equal_a_rollout_by_hand(task, rows, tmp_path):
    made = log(tmp_path, [Segment(None, rows)], task, seed=3)
    expected = by_hand(task, rows, 3)
    columns = made.observations, made.actions, made.rewards, made.terminals, made.timeouts, made.final_observations
    for ours, theirs in zip(columns, expected):
        np.testing.assert_array_equal(ours, theirs)
    assert len(made) == rows
    assert made.dropped == 0
    assert made.episodes > 3
    assert made.action_space == task.action_space


@pytest.mark.slow
def test_two_acts_have_their_rows_and_share_no_episode(both):
    made, told = both
    assert len(made) == 2201
    assert made.timeouts[1500]  # cut
    assert made.timeouts[-1]
    assert made.terminals[:1501].any()
    assert (made.lengths <= HOPPER.horizon).all()
    assert made.lengths.max() == HOPPER.horizon
    assert told[-1] == (2201, 2201)
    assert told == sorted(told)
    np.testing.assert_array_equal(np.diff(made.starts), made.lengths[:-1])
    volume = np.prod(HIGH - LOW)
    np.testing.assert_allclose(made.extras["behavior_log_probs"][1501:], -np.log(volume), rtol=1e-6)
    assert (made.actions >= LOW).all()
    assert (made.actions <= HIGH).all()


def test_the_policys_rows_follow_the_physics(both):
    """The log, put back into the simulator from the seeds of its first episodes."""
    made, _ = both
    count = 40
    seeds = [np.random.SeedSequence([0, 0, k]).generate_state(1, np.uint64)[0] for k in range(count)]
    simulator = HOPPER.simulate([int(s) for s in seeds])
    np.testing.assert_array_equal(simulator.reset(), made.observations[made.starts[:count]])
    for t in range(HOPPER.horizon):
        rows = np.minimum(made.starts[:count] + t, made.ends[:count])
        following, rewards, terminals, timeouts = simulator.step(made.actions[rows])
        inside = made.starts[:count] + t <= made.ends[:count]
        np.testing.assert_array_equal(following[inside], made.next_observations_at(rows[inside]))
        np.testing.assert_array_equal(rewards[inside], made.rewards[rows[inside]])
        np.testing.assert_array_equal(terminals[inside], made.terminals[rows[inside]])
        np.testing.assert_array_equal(timeouts[inside], made.timeouts[rows[inside]])
    assert made.ends[count] < 1500  # none of these was cut


@pytest.mark.parametrize("who", [POLICY, None], ids=["policy", "uniform"])
def test_a_cut_row_is_followed_by_what_came_next(who, tmp_path):
    whole, cut = log(tmp_path / "whole", [Segment(who, 16)]), log(tmp_path / "cut", [Segment(who, 5)])
    np.testing.assert_array_equal(cut.actions, whole.actions[:5])
    np.testing.assert_array_equal(cut.final_observations, whole.observations[5:6])
    assert (cut.timeouts.tolist(), whole.timeouts[:5].any()) == ([False] * 4 + [True], False)


def test_logged_densities_are_the_policys(both):
    made, _ = both
    logged = made.extras["behavior_log_probs"][:1501]
    assert logged.dtype == np.float32
    expected = density(POLICY, made.observations[:1501], made.actions[:1501])
    np.testing.assert_allclose(logged, expected, rtol=1e-4, atol=1e-4)


def test_actions_are_drawn_from_the_policy(both):
    made, _ = both
    mean, log_std = np.split(np.asarray(POLICY.inner.net(made.observations[:1501])), 2, axis=-1)
    unit = 2 * (made.actions[:1501] - LOW) / (HIGH - LOW) - 1
    noise = ((np.arctanh(np.clip(unit, -1 + 1e-6, 1 - 1e-6)) - mean) / np.exp(log_std)).ravel()
    # A standard normal: its quartiles hold a quarter each, to 4 standard errors of sqrt(3/16 / 4503).
    quarters = np.histogram(noise, [-np.inf, -0.6745, 0.0, 0.6745, np.inf])[0] / len(noise)
    np.testing.assert_allclose(quarters, 0.25, atol=0.026)
    assert abs(noise.std() - 1) < 0.05
    assert len(np.unique(made.actions[:1501, 0])) > 1490  # no row repeats another's draw
    # Copies side by side and steps one after the other draw independently.
    assert abs(np.corrcoef(noise[:-3], noise[3:])[0, 1]) < 0.06


def test_episodes_start_apart(both, tmp_path):
    made, _ = both
    starts = made.observations[made.starts]
    assert len(np.unique(starts, axis=0)) == made.episodes
    other = log(tmp_path, seed=1)
    assert other.fingerprint != made.fingerprint
    assert not (other.observations[other.starts][:, None] == starts[None]).all(-1).any()
    assert not (other.actions[:100] == made.actions[:100]).any(1).any()


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_nothing(both, threads, tmp_path):
    assert log(tmp_path, threads=threads).fingerprint == both[0].fingerprint


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.3, 0.68, 0.7, 1.0])
def test_killed_and_gone_on_with_is_the_same(both, share, tmp_path):
    made, told = both
    at = next(done for done, _ in told if done >= share * len(made))

    def kill(done, total):
        if done >= at:
            raise Killed

    with pytest.raises(Killed):
        log(tmp_path, progress=kill)
    kept = read_json(tmp_path / "state.json")["rows"]
    assert at - 200 <= kept <= at  # portions are of 200 rows
    for path in tmp_path.glob("*.bin"):  # and the kill fell into the next write
        with open(path, "ab") as file:
            file.write(b"\x7f" * 1001)
    more = []
    again = log(tmp_path, progress=lambda done, total: more.append((done, total)))
    assert again.fingerprint == made.fingerprint
    assert all(done > kept for done, _ in more)  # what was there is not made again
    assert bool(more) == (kept < len(made))


@pytest.mark.slow
def test_killed_inside_an_episode_is_the_same(tmp_path):
    segments, calls = [Segment(policy(MAZE), 130), Segment(None, 250)], []
    whole = log(tmp_path / "whole", segments, MAZE, progress=lambda done, total: calls.append(done))
    assert len(calls) >= 6
    assert calls == sorted(calls)  # also where episodes made more rows than their act takes
    for kill_at in (0, 2, len(calls) - 1):
        left = [kill_at]

        def kill(done, total, left=left):
            if left[0] == 0:
                raise Killed
            left[0] -= 1

        with pytest.raises(Killed):
            log(tmp_path / f"{kill_at}", segments, MAZE, progress=kill)
        assert log(tmp_path / f"{kill_at}", segments, MAZE).fingerprint == whole.fingerprint


@pytest.mark.slow
def test_a_log_does_not_depend_on_how_many_run_side_by_side(both, tmp_path, monkeypatch):
    monkeypatch.setattr(rollouts, "COPIES", 24)
    assert log(tmp_path).fingerprint == both[0].fingerprint


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hopper", "halfcheetah"])
def test_a_rows_bits_do_not_depend_on_its_place(name):
    """What makes a log the same after a kill; full-size networks take other paths through a matrix product than small ones."""
    each, rng = library.snapshot(name, "medium").policy(), np.random.default_rng(0)
    seen = rng.normal(size=(rollouts.COPIES, each.inner.net.weights[0].shape[0])).astype(np.float32)
    episodes, ages = np.arange(rollouts.COPIES), rng.integers(0, 1000, rollouts.COPIES)
    low, high = np.full(len(each.low), -1.0, np.float32), np.full(len(each.low), 1.0, np.float32)
    draw = lambda order: rollouts._draw(each, seen[order], jax.random.key(0), episodes[order], ages[order], low, high)  # noqa: E731
    order = rng.permutation(rollouts.COPIES)
    for straight, mixed in zip(draw(episodes), draw(order)):
        np.testing.assert_array_equal(np.asarray(straight)[order], np.asarray(mixed))


def test_a_column_that_lost_rows_is_told(tmp_path):
    with pytest.raises(Killed):
        log(tmp_path, progress=lambda done, total: _kill_at(done, 900))
    column = tmp_path / "observations.bin"
    column.write_bytes(column.read_bytes()[:1000])
    with pytest.raises(UserError, match=r"observations\.bin has lost its end: 1000 bytes are left of"):
        log(tmp_path)


def _kill_at(done, most):
    if done >= most:
        raise Killed


@pytest.mark.parametrize("rows", [1, 15, 16, 17])
def test_any_number_of_rows(rows, tmp_path):
    made = log(tmp_path, [Segment(None, rows)])
    assert len(made) == rows
    assert made.timeouts[-1] != made.terminals[-1]
    assert made.dropped == 0


def test_another_collection_is_not_gone_on_with(tmp_path):
    log(tmp_path, [Segment(None, 30)])
    for segments, seed in (([Segment(None, 31)], 0), ([Segment(None, 30)], 1), ([Segment(None, 15), Segment(None, 15)], 0)):
        with pytest.raises(UserError, match=r"holds the beginning of another collection \(.* was .*, now .*\); delete it"):
            log(tmp_path, segments, seed=seed)
    other = Provenance(extra={"policies": ["expert"]})
    with pytest.raises(UserError, match="another collection"):
        collect_rollouts(HOPPER, [Segment(None, 30)], name="rolled", seed=0, provenance=other, scratch=tmp_path)
    assert len(log(tmp_path, [Segment(None, 30)])) == 30


def test_another_policy_does_not_go_on_with_a_killed_log(tmp_path):
    """Of one kind and one name they are told apart by what they hold, and code of one's own is not told apart at all."""
    asked = {"steps": 300, "out": tmp_path / "log.hdf5"}
    for first in (POLICY, Coded()):
        with pytest.raises(Killed):
            collect_in_task(HOPPER, first, **asked, progress=lambda done, total: _kill_at(done, 100))
        with pytest.raises(UserError, match="holds the beginning of a(nother)? collection.*delete it to start again"):
            collect_in_task(HOPPER, policy(HOPPER, seed=1), **asked)
        with pytest.raises(UserError, match="holds the beginning of a collection, maybe by another policy; delete it"):
            collect_in_task(HOPPER, Coded(), **asked)
        if first is POLICY:
            made = dr.read(collect_in_task(HOPPER, policy(HOPPER), **asked))  # the same, made anew
            assert made.provenance.extra["policy_content"] == _content(POLICY)
            asked["out"] = tmp_path / "other.hdf5"


class Coded:
    has_log_prob = False

    def start(self, n):
        return ()

    def act(self, step, carry, key, *, greedy):
        return self(step.observation), carry

    def __call__(self, observations):
        return np.zeros((len(observations), 3), np.float32)


class Drawing:
    """Code of one's own that follows the protocol, and is no function; a draw tells which generator it is from."""

    has_log_prob = True

    def start(self, n):
        return ()

    def act(self, step, carry, key, *, greedy):
        assert (len(step.observation), greedy) == (1, False)
        assert step.first[0] == (step.reward[0] == 0.0)  # rewards of `MAZE` are more than 0
        return key.uniform(-1, 1, (1, 2)), carry

    def log_prob(self, observations, actions):
        return np.asarray(actions).sum(1)


def test_a_policy_of_ones_own_draws_by_seed_episode_and_step(tmp_path, monkeypatch):
    short, rows = replace(MAZE, horizon=30), [Segment(Drawing(), 100), Segment(None, 10)]
    made = log(tmp_path / "many", rows, short, seed=5)
    for row in (0, 1, 29, 30, 75):
        drawn = np.random.default_rng([5, 0, row // 30, row % 30 + 1]).uniform(-1, 1, 2)
        np.testing.assert_allclose(made.actions[row], drawn, rtol=1e-6)
    np.testing.assert_allclose(made.extras["behavior_log_probs"][:100], made.actions[:100].sum(1), rtol=1e-6)
    assert len(np.unique(made.actions, axis=0)) == 110
    monkeypatch.setattr(rollouts, "FLUSH", 40)
    monkeypatch.setattr(rollouts, "COPIES", 1)
    with pytest.raises(Killed):
        log(tmp_path / "few", rows, short, seed=5, progress=lambda done, total: _kill_at(done, 60))
    assert 60 <= read_json(tmp_path / "few" / "state.json")["rows"] < 100
    monkeypatch.setattr(rollouts, "COPIES", 3)
    assert log(tmp_path / "few", rows, short, seed=5).fingerprint == made.fingerprint


def test_a_function_with_its_densities_collects_by_chance(tmp_path):
    uniform = BlackBoxPolicy(lambda x, rng: rng.uniform(-2, 2, (len(x), 1)), log_prob=lambda x, a: np.full(len(x), -np.log(4)))
    log = dr.read(collect_in_task("Pendulum-v1?max_episode_steps=20", uniform, steps=50, out=tmp_path / "log.hdf5"))
    assert len(np.unique(log.actions)) == 50
    np.testing.assert_allclose(log.extras["behavior_log_probs"], -np.log(4), rtol=1e-6)


def test_a_policy_of_ones_own_with_a_memory_is_refused(tmp_path):
    class Remembers(Coded):
        def start(self, n):
            return np.zeros(n)

    with pytest.raises(UserError, match="rolled: a policy with a memory of earlier steps cannot collect a log"):
        log(tmp_path, [Segment(Remembers(), 5)])


WIDE = replace(MAZE, action_space=Box((-2.0, -1.0), (1.0, 3.0)))


@pytest.mark.parametrize(
    ("kind", "low", "high", "dense"),
    [
        (Gaussian, None, None, False), (Gaussian, (-1, -1), (1, 1), False), (ClippedGaussian, None, None, True),
        (ClippedGaussian, (-2, -1), (1, 3), True), (ClippedGaussian, (-2, -1), (1.5, 3), False),
        (TanhGaussian, (-2, -1), (1, 3), True), (TanhGaussian, (-2, -1.5), (1, 3), False),
    ],
)  # fmt: skip
def test_densities_of_actions_that_are_clipped_afterwards_are_not_logged(kind, low, high, dense):
    net = Gaussian.of(MLP((np.zeros((4, 2), np.float32),), (np.full(2, 3.0, np.float32),)), np.zeros(2, np.float32)).net
    bounds = (None, None) if low is None else (np.array(low, np.float32), np.array(high, np.float32))
    assert rollouts.has_densities(EnvPolicy(kind(net), None, None, *bounds), WIDE) == dense


def test_a_log_of_a_gaussian_without_bounds_has_no_densities(tmp_path):
    far = Gaussian.of(MLP((np.zeros((4, 2), np.float32),), (np.full(2, 3.0, np.float32),)), np.zeros(2, np.float32))
    made = log(tmp_path, [Segment(EnvPolicy(far, None, None, None, None), 30)], MAZE)
    assert "behavior_log_probs" not in made.extras
    assert (made.actions == 1.0).mean() > 0.9  # where the density of a mean of 3 is 0.05, and the probability 0.98


def test_a_density_that_is_no_number_is_refused_where_it_occurs(tmp_path):
    class Lost(Drawing):
        def log_prob(self, observations, actions):
            return np.full(1, np.nan)

    net = MLP((np.zeros((4, 2), np.float32),), (np.zeros(2, np.float32),))
    without = ClippedGaussian.of(net, np.full(2, -np.inf, np.float32))  # any spread
    for name, who in (("own", Lost()), ("ours", EnvPolicy(without, None, None, None, None))):
        with pytest.raises(UserError, match=r"the policy's log-probability of its action \[.*\] is nan, a finite number is"):
            log(tmp_path / name, [Segment(who, 500)], MAZE)
        assert not (tmp_path / name / "state.json").exists()


def test_discrete_actions_that_are_no_whole_numbers_are_refused(tmp_path):
    class Between(Coded):
        def __call__(self, observations):
            return np.full(len(observations), 0.9)

    pull = tasks.task(Pull(5.0), 20)
    for who in (Between(), Between().__call__):
        with pytest.raises(UserError, match=r"an action is 0\.9, a number from 0 to 1 is needed$"):
            log(tmp_path / "one", [Segment(who, 5)], pull)
    choices = EnvPolicy(Categorical(MLP((np.zeros((1, 9), np.float32),), (np.arange(9, dtype=np.float32) * 9,))), *[None] * 4)
    with pytest.raises(UserError, match=r"an action is 8, a number from 0 to 1 is needed$"):  # and is not taken for 1
        log(tmp_path / "two", [Segment(choices, 5)], pull)
    with pytest.raises(
        UserError, match=r"takes one action of shape \(\) per row, the policy gave shape \(1, 3\) for a batch of 1"
    ):
        log(tmp_path / "three", [Segment(Coded(), 5)], pull)


def test_rows_take_memory_as_they_are_wanted_and_little_of_it(tmp_path, monkeypatch):
    rows = [Segment(POLICY, 90), Segment(None, 40)]
    made = log(tmp_path / "many", rows)
    monkeypatch.setattr(rollouts, "memory", lambda: 1)
    assert log(tmp_path / "one", rows).fingerprint == made.fingerprint
    monkeypatch.setattr(rollouts, "memory", lambda: 4 * 3 * 120 * 34)  # of a row of the maze's columns: 34 bytes
    copies = rollouts._SideBySide(MAZE, MAZE.simulate([0]), None, jax.random.key(0), [0, 0], True, 10**6)
    assert copies.columns["observations"].shape == (3, 120, 4)
    monkeypatch.undo()
    endless = replace(MAZE, horizon=10**12)  # an episode takes more memory than there is, and more time
    short = log(tmp_path / "short", [Segment(None, 20)], MAZE)
    assert log(tmp_path / "endless", [Segment(None, 20)], endless).fingerprint == short.fingerprint


def test_a_scratch_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(UserError, match=r"cannot write .*file/.*: Not a directory$"):
        log(tmp_path / "file" / "scratch", [Segment(None, 30)])


def test_kinds_of_log_are_acts_in_equal_parts(tmp_path, monkeypatch):
    from deadreckon.policies import library

    class Shipped:
        updates = 7

        def __init__(self, task, name):
            assert (task, name) == ("hopper", "expert")

        def policy(self):
            return POLICY

    monkeypatch.setattr(library, "snapshot", Shipped)
    made = collect_gym(HOPPER, "uniform-expert", name="hopper-uniform-expert-v2", steps=61, seed=2, scratch=tmp_path)
    assert made.name == "hopper-uniform-expert-v2@dr1"
    assert made.provenance.extra["rows"] == [30, 31]
    assert made.provenance.extra["policies"] == ["uniform", "expert"]
    assert made.provenance.extra["updates"] == {"expert": 7}
    assert {"mujoco", "gymnasium", "numpy", "jax", "deadreckon"} <= set(made.provenance.versions)
    log_probs = made.extras["behavior_log_probs"]
    np.testing.assert_allclose(log_probs[:30], -np.log(np.prod(HIGH - LOW)), rtol=1e-6)
    np.testing.assert_allclose(log_probs[30:], density(POLICY, made.observations[30:], made.actions[30:]), rtol=1e-4, atol=1e-4)
    with pytest.raises(UserError, match="hopper-x-v2: steps must be 2 or more, got 1"):
        collect_gym(HOPPER, "medium-expert", name="hopper-x-v2", steps=1, scratch=tmp_path)


def test_played_is_the_same_log_in_memory(tmp_path):
    provenance = Provenance("collected", seed=5)
    made = collect_rollouts(HOPPER, [Segment(POLICY, 300)], name="x", seed=5, provenance=provenance, scratch=tmp_path)
    found = played(HOPPER, POLICY, 300, 5)
    assert len(found) == 300
    for name in ("observations", "actions", "rewards", "terminals", "timeouts"):
        np.testing.assert_array_equal(getattr(found, name), getattr(made, name))
        assert not isinstance(getattr(found, name), np.memmap)


class Pull(gymnasium.Env):
    """Of two pulls nothing tells but what it does."""

    def __init__(self, pull):
        self.pull, box = pull, gymnasium.spaces.Box(-9, 9, (1,), np.float32)
        self.observation_space, self.action_space = box, gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return np.full(1, self.pull, np.float32), self.pull, False, False, {}


def test_a_killed_log_of_an_environment_that_is_an_object_is_not_gone_on_with(tmp_path):
    asked = {"steps": 300, "out": tmp_path / "log.hdf5"}
    with pytest.raises(Killed):
        collect_in_task(tasks.task(Pull(5.0), 20), **asked, progress=lambda done, total: _kill_at(done, 100))
    for again in (tasks.task(Pull(8.0), 20), tasks.task(Pull(5.0), 20)):
        with pytest.raises(UserError, match="maybe by another environment; delete it to start again"):
            collect_in_task(again, **asked)


def test_the_simulator_is_closed_whatever_ends_a_collection(tmp_path):
    class Closing(type(HOPPER)):
        closed: ClassVar = []

        def simulate(self, seeds, threads=None):
            simulator = super().simulate(seeds, threads)
            simulator.close = lambda: self.closed.append(threads)
            return simulator

    task = Closing(**{each.name: getattr(HOPPER, each.name) for each in dataclasses.fields(HOPPER) if each.init})
    log(tmp_path / "whole", [Segment(None, 40)], task, threads=2)
    with pytest.raises(Killed):
        log(tmp_path / "part", [Segment(None, 300)], task, progress=lambda done, total: _kill_at(done, 100))
    assert task.closed == [2, None]


def test_a_killed_log_is_gone_on_with_in_a_task_of_the_same_fields_alone(tmp_path):
    asked = {"steps": 300, "out": tmp_path / "log.hdf5"}
    with pytest.raises(Killed):
        collect_in_task(HOPPER, **asked, progress=lambda done, total: _kill_at(done, 100))
    for other in ("hopper", replace(HOPPER, horizon=17)):
        with pytest.raises(UserError, match=r"the beginning of another collection \(extra.task_fields.* was .*; delete it"):
            collect_in_task(other, **asked)
    extra = dr.read(collect_in_task(replace(HOPPER), **asked)).provenance.extra
    bounds = {"class": "deadreckon.data.spec:Box", "low": [-0.9, -0.5, -1.0], "high": [0.3, 1.0, 0.6]}
    assert extra["task_fields"] == {"horizon": 16, "action_space": bounds}


def test_a_killed_log_is_not_gone_on_with_in_another_registered_task_of_the_same_name(tmp_path):
    asked = {"steps": 300, "out": tmp_path / "log.hdf5"}
    for horizon, found in ((16, Killed), (17, UserError)):
        tasks.register(replace(HOPPER, name="own-hopper", horizon=horizon))
        try:
            with pytest.raises(found, match="task_registered.horizon was 16, now 17" if horizon == 17 else None):
                collect_in_task("own-hopper", **asked, progress=lambda done, total: _kill_at(done, 100))
        finally:
            tasks.registry._TASKS.pop("own-hopper")


def test_tasks_of_one_copy_are_collected_one_episode_after_the_other(tmp_path):
    class Single(type(HOPPER)):
        most_copies = 1

        def simulate(self, seeds, threads=None):
            assert len(seeds) == 1
            return super().simulate(seeds, threads)

    single = Single(**{each.name: getattr(HOPPER, each.name) for each in dataclasses.fields(HOPPER) if each.init})
    made = log(tmp_path / "one", [Segment(None, 40)], single)
    assert made.fingerprint == log(tmp_path / "many", [Segment(None, 40)]).fingerprint
