"""Gymnasium environments as tasks: equal to a loop written by hand, whatever their spaces, and no promise broken."""

import dataclasses
import functools
import re

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces, wrappers

import deadreckon as dr
import deadreckon.tasks.envs
from deadreckon import imports
from deadreckon.data.entries import ENTRIES as CATALOGUE
from deadreckon.data.entries import task_of
from deadreckon.data.environments import IDS
from deadreckon.data.formats.flatten import flatten_space, join_actions
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.policies.policy import BlackBoxPolicy
from deadreckon.runs.evaluate import episode_seeds
from deadreckon.tasks import registry
from deadreckon.tasks.gymnasium_copies import episode_seed
from deadreckon.tasks.gymnasium_names import options_of, written
from deadreckon.tasks.simulator_env import SimulatorEnv
from tests import toy_environments as toys

GOAL, SHIFTED = "tests.toy_environments:Goal?max_episode_steps=20", "tests.toy_environments:Shifted?max_episode_steps=9"


def pushing(observations, generator):
    return np.tanh(observations[:, 1:2] - observations[:, :1]).astype(np.float32)


def leaning(observations, generator):
    return (observations[:, 2] + observations[:, 3] > 0).astype(np.int32)


def by_hand(env, policy, seeds):
    """Return, length and whether it ended by itself, of an episode a seed."""
    out = []
    for seed in seeds:
        seen, _ = env.reset(seed=seed)
        total, length, over = 0.0, 0, False
        while not over:
            action = policy(np.asarray(seen, np.float32)[None], None)[0]
            seen, reward, terminated, truncated, _ = env.step(action)
            total, length, over = total + float(reward), length + 1, terminated or truncated
        out.append((total, length, terminated))
    return zip(*out)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "policy"), [("Pendulum-v1", pushing), ("CartPole-v1", leaning)])
def test_returns_are_those_of_a_loop_written_by_hand(name, policy):
    returns, lengths, _ = map(list, by_hand(gymnasium.make(name), policy, episode_seeds(4, 3)))
    for task in (f"gymnasium:{name}", name, gymnasium.make(name), lambda: gymnasium.make(name)):
        found = dr.evaluate(BlackBoxPolicy(policy), task, episodes=3, seed=4)
        assert found.returns[0].tolist() == returns
        assert found.lengths[0].tolist() == lengths


def random_actions(task, steps, copies, seed=0):
    rng = np.random.default_rng(seed)
    if isinstance(task.action_space, Discrete):
        return rng.integers(0, task.action_space.n, (steps, copies))
    space = task.action_space
    return rng.uniform(space.low, space.high, (steps, copies, space.size)).astype(np.float32)


def test_cart_pole_ends_by_falls_and_by_time():
    task = dr.task(toys.short_cart)
    assert task.horizon == 9
    simulator = task.simulate([1, 2])
    seen, falls, times = simulator.reset(), 0, 0
    for _ in range(400):
        actions = np.array([0, int(seen[1, 2] + seen[1, 3] > 0)])  # the first falls, the second is held
        seen, rewards, terminals, timeouts = simulator.step(actions)
        assert not (terminals & timeouts).any()
        falls, times = falls + int(terminals[0]), times + int(timeouts[1])
        assert not terminals[1]
        if (over := np.flatnonzero(terminals | timeouts)).size:
            seen[over] = simulator.reset(over)
    assert falls > 15
    assert times == 400 // 9


def test_a_fall_in_the_last_step_is_a_terminal():
    # Cut where it falls by itself: what Gymnasium says of both, we say is a terminal.
    env = gymnasium.make("CartPole-v1")
    env.reset(seed=0)
    fall = 1 + next(t for t in range(50) if env.step(0)[2])
    simulator = dr.task("CartPole-v1", horizon=fall).simulate([0])
    simulator.reset()
    ends = [(bool(part[2][0]), bool(part[3][0])) for part in (simulator.step(np.zeros(1, int)) for _ in range(fall))]
    assert ends == [(False, False)] * (fall - 1) + [(True, False)]
    np.testing.assert_array_equal(simulator.step(np.zeros(1, int))[1:], [[0], [False], [False]])  # it rests


def test_steps_are_those_of_gymnasiums_vectors():
    task = dr.task("CartPole-v1")
    disabled = {"autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED}
    vector = gymnasium.make_vec("CartPole-v1", 3, vectorization_mode="sync", vector_kwargs=disabled)
    simulator = task.simulate([5, 6, 7])
    np.testing.assert_array_equal(vector.reset(seed=[5, 6, 7])[0], simulator.reset())
    for actions in random_actions(task, 8, 3):
        theirs, ours = vector.step(actions), simulator.step(actions)
        for a, b in zip(theirs, ours):
            np.testing.assert_array_equal(a, b)


def test_observations_of_frozen_lake_are_one_hot():
    task = dr.task("FrozenLake-v1")
    assert task.observation_shape == (16,)
    assert task.action_space == Discrete(4)
    env, simulator = gymnasium.make("FrozenLake-v1"), task.simulate([8])
    seen, ours = env.reset(seed=8)[0], simulator.reset()
    for action in random_actions(task, 6, 1):
        np.testing.assert_array_equal(ours, np.eye(16, dtype=np.float32)[[seen]])
        seen, reward, terminated, _, _ = env.step(int(action[0]))
        ours, rewards, terminals, _ = simulator.step(action)
        assert (rewards[0], terminals[0]) == (reward, terminated)
        if terminated:
            break


@pytest.mark.slow
def test_dicts_are_flattened_as_gymnasium_and_as_logs_have_them():
    with pytest.warns(UserWarning, match="texts are not observed: note"):
        task = dr.task(GOAL)
    assert task.observation_shape == (2 + 2 + 3,)
    env = toys.Goal()
    seen = [env.reset(seed=seed)[0] for seed in range(4)]
    numeric = spaces.Dict({key: env.observation_space[key] for key in ("place", "flags")})
    rows = {"flags": np.stack([each["flags"] for each in seen]),
            "place": {key: np.stack([each["place"][key] for each in seen]) for key in ("at", "mode")}}  # fmt: skip
    np.testing.assert_array_equal(task.simulate(range(4)).reset(), flatten_space(numeric, rows)[0])


def test_actions_of_several_integers_are_counted_as_in_logs():
    task = dr.task(GOAL)
    assert task.action_space == Discrete(6)
    space = toys.Goal().action_space
    every = np.array([task.spaces.act(np.array(i)) for i in range(6)])
    assert every.dtype == space.dtype
    np.testing.assert_array_equal(join_actions(space, every)[0], np.arange(6))
    simulator = task.simulate(range(6))
    simulator.reset()
    np.testing.assert_array_equal(simulator.step(np.arange(6))[1], [-1, 0, 1, 9, 10, 11])


def test_environments_may_change_their_actions_in_place():
    for space in (spaces.MultiDiscrete([2, 3]), spaces.Dict(a=spaces.Discrete(2), b=spaces.MultiBinary(2))):
        taken = dr.task(lambda space=space: Custom(BOX, space), horizon=5).spaces.act
        first = taken(np.array(3))
        if isinstance(first, dict):
            first.pop("a")
            first["b"][:] = 7
        else:
            first[:] = 7
        assert space.contains(taken(np.array(3)))


def test_numbers_that_do_not_begin_at_zero():
    task = dr.task(SHIFTED)
    assert (task.observation_shape, task.action_space) == ((4,), Discrete(3))
    simulator = task.simulate([0])
    np.testing.assert_array_equal(simulator.reset(), [[1, 0, 0, 0]])
    seen, rewards, _, _ = simulator.step(np.array([2]))
    assert (seen.argmax(), rewards[0]) == (1, 7.0)
    with pytest.raises(UserError, match="an action is 3, a number from 0 to 2 is needed"):
        simulator.step(np.array([3]))


class Custom(gymnasium.Env):
    def __init__(self, observation, action):
        self.observation_space, self.action_space = observation, action

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.action_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        assert self.action_space.contains(action), action
        return self.observation_space.sample(), 0.0, False, False, {}


BOX = spaces.Box(-1, 1, (2,), np.float32)


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        (spaces.Box(np.array([[0, 1]]), np.array([[2, 5]]), dtype=np.float64), Box((0, 1), (2, 5))),
        (spaces.MultiBinary(3), Discrete(8)),
        (spaces.Tuple([spaces.Discrete(2), spaces.MultiDiscrete([2, 2])]), Discrete(8)),
        (spaces.Dict({"a": spaces.Box(-1, 1, (1,), np.float32), "b": spaces.Box(0, 3, (2,), np.float32)}),
         Box((-1, 0, 0), (1, 3, 3))),
        (spaces.Dict({"a": spaces.Discrete(2), "b": spaces.Discrete(3, start=4)}), Discrete(6)),
    ],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_actions_reach_the_environment_in_its_own_form(action, expected):
    task = dr.task(lambda: Custom(BOX, action), horizon=5)
    assert task.action_space == expected
    simulator = task.simulate([0, 1])
    simulator.reset()
    for actions in random_actions(task, 4, 2):
        simulator.step(actions)


def test_pictures_keep_their_shape():
    task = dr.task(lambda: Custom(spaces.Box(0, 255, (40, 32, 3), np.uint8), BOX), horizon=5)
    assert task.observation_shape == task.simulate([0]).reset()[0].shape == (40, 32, 3)
    simulator = task.simulate([0])  # and their numbers: no agent takes pictures of floats
    assert task.observation_dtype == simulator.reset().dtype == simulator.step(np.zeros((1, 2)))[0].dtype == np.uint8
    assert dr.task(lambda: Custom(spaces.Box(0, 255, (7, 7, 3), np.uint8), BOX), horizon=5).observation_shape == (147,)


# ---- promises of simulators -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["Pendulum-v1?max_episode_steps=5", "FrozenLake-v1", GOAL])
def test_a_copy_depends_on_its_own_seed_and_actions_alone(name):
    task = dr.task(name)
    many, few = task.simulate(range(10, 16)), task.simulate([13, 11])
    pick = [3, 1]
    np.testing.assert_array_equal(few.reset(), many.reset()[pick])
    for actions in random_actions(task, 24, 6):
        ours, theirs = many.step(actions), few.step(actions[pick])
        for a, b in zip(ours, theirs):
            np.testing.assert_array_equal(a[pick], b)
        ended = np.flatnonzero(ours[2] | ours[3])
        if len(ended):
            many.reset(ended)
        if len(own := np.flatnonzero(theirs[2] | theirs[3])):
            few.reset(own)


@pytest.mark.parametrize("name", ["Pendulum-v1?max_episode_steps=7", "FrozenLake-v1", GOAL])
def test_restored_copies_go_on_bit_for_bit(name):
    task = dr.task(name)
    actions, whole = random_actions(task, 40, 3), task.simulate([1, 2, 3])
    whole.reset()

    def walk(simulator, part):
        out = []
        for each in part:
            out.append(simulator.step(each))
            if len(over := np.flatnonzero(out[-1][2] | out[-1][3])):
                out.append((simulator.reset(over),))
        return [array for row in out for array in row]

    walk(whole, actions[:20])
    other = task.simulate([7, 8, 9])
    other.reset()
    assert other.restore(whole.state()) is None
    for a, b in zip(walk(whole, actions[20:]), walk(other, actions[20:]), strict=True):
        np.testing.assert_array_equal(a, b)


def test_environments_that_do_not_repeat_are_told():
    task = dr.task(toys.Unseeded, horizon=9)
    simulator = task.simulate([0, 1])
    simulator.reset()
    simulator.step(np.zeros(2, int))
    np.testing.assert_array_equal(task.simulate([0, 1]).restore(simulator.state()), [0, 1])


def test_seeds_of_episodes():
    assert episode_seed(7, 0) == 7
    several = [episode_seed(2**40, 0), *(episode_seed(7, i) for i in range(1, 5))]
    assert len(set(several)) == 5
    assert max(several) < 2**32


# ---- names and objects ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "name"),
    [
        (lambda: gymnasium.make("Pendulum-v1"), "gymnasium:Pendulum-v1"),
        (lambda: gymnasium.make("Pendulum-v1", render_mode="rgb_array", g=9.0), "gymnasium:Pendulum-v1?g=9.0"),
        (lambda: gymnasium.make("FrozenLake-v1", max_episode_steps=50), "gymnasium:FrozenLake-v1?max_episode_steps=50"),
    ],
)
def test_an_object_is_known_by_a_name_that_finds_it_again(given, name):
    task, again = dr.task(given()), dr.task(name)
    assert task.name == again.name == name
    assert task == again
    np.testing.assert_array_equal(task.simulate([3]).reset(), again.simulate([3]).reset())
    assert dr.task(task) is task


def test_an_object_that_gymnasium_cannot_make_is_copied():
    env = toys.Goal(3)
    env.reset(seed=1)
    task = dr.task(env, horizon=8)
    before = env.at.copy()
    first = task.simulate([0, 0]).reset()
    np.testing.assert_array_equal(first[0], first[1])
    np.testing.assert_array_equal(env.at, before)
    assert task.name == "Goal"


def test_wrappers_are_kept():
    wrapped = gymnasium.wrappers.RescaleAction(gymnasium.make("Pendulum-v1"), np.float32(-1), np.float32(1))
    task = dr.task(wrapped)
    assert task.action_space == Box((-1,), (1,))
    assert task.name == "gymnasium:Pendulum-v1+RescaleAction"
    limited = gymnasium.wrappers.ClipReward(gymnasium.make("FrozenLake-v1", is_slippery=False), 0.0, 1.0)
    for name in (task.name, dr.task(limited).name):  # of which options must not hide what follows
        told = "wrappers cannot be made from a name; give the environment as an object in Python"
        with pytest.raises(UserError, match=f"^task {re.escape(name)}: {told}$"):
            dr.task(name)


def test_fields_that_a_name_does_not_tell():
    door, pendulum = registry.task("door"), dr.task("Pendulum-v1")
    for told in (door, pendulum, dr.task(toys.short_cart), registry.task("hopper:pixels")):
        assert registry.own_fields(told) == {}
    assert registry.own_fields(dataclasses.replace(door, horizon=3, reward=np.sum)) == {"horizon": 3, "reward": "numpy:sum"}
    assert registry.own_fields(dataclasses.replace(pendulum, horizon=3)) == {"horizon": 3}
    assert registry.own_fields(dataclasses.replace(door, name="mine"))["draw"] == "deadreckon.tasks.adroit:_draw_door"
    paid = functools.partial(np.sum, axis=toys.Crowd())
    told = registry.own_fields(dataclasses.replace(door, reward=paid))["reward"]
    assert told == f"functools.partial({re.sub(' at 0x.*', '>', repr(np.sum))}, axis=<tests.toy_environments.Crowd object>)"
    kept = [registry.own_fields(dataclasses.replace(door, extra={"map": np.arange(n)})) for n in (2, 2, 3)]
    assert kept[0] == kept[1] != kept[2]
    scaled = [dr.task(wrappers.RescaleAction(gymnasium.make("Pendulum-v1"), np.float32(-n), np.float32(n))) for n in (1, 2)]
    assert registry.own_fields(scaled[0])["action_space"] != registry.own_fields(scaled[1])["action_space"]


def test_sets_in_fields_are_told_in_one_order():
    assert registry._told({"a": frozenset("dcba")}) == {"a": ["a", "b", "c", "d"]}


def test_all_fields_of_a_registered_task_of_ones_own_are_told():
    battery = registry.task("battery")
    own = dataclasses.replace(battery, name="own-battery")
    for given in (battery, own, dr.task("Pendulum-v1"), dataclasses.replace(battery, horizon=3)):
        assert registry.registered_fields(given) == {}
    registry.register(own)
    try:
        assert registry.own_fields(own) == {}  # its name finds it here
        for given in (own, dataclasses.replace(own)):
            told = registry.registered_fields(given)
            assert (told["name"], told["horizon"]) == ("own-battery", 8)
    finally:
        registry._TASKS.pop("own-battery")


def test_a_class_is_opened_once_for_a_task(monkeypatch):
    opened = []
    monkeypatch.setattr(toys.Shifted, "__init__", lambda self: opened.append(self))
    dr.task("tests.toy_environments:Shifted", horizon=9)
    assert len(opened) == 1


def test_a_horizon_is_within_a_time_limit_that_stays():
    assert dr.task("Pendulum-v1", horizon=500).horizon == 500  # a limit of Gymnasium's own is replaced
    assert dr.task(gymnasium.make("Pendulum-v1"), horizon=500).horizon == 500
    assert dr.task(toys.short_cart, horizon=5).horizon == 5
    for given in (toys.short_cart, gymnasium.wrappers.TimeLimit(toys.Shifted(), 9)):
        with pytest.raises(
            UserError, match=r"ends its episodes after 9 steps by itself; the horizon must be 9 or less, got 50$"
        ):
            dr.task(given, horizon=50)

    for given in ("deadreckon/AdroitDoor-v1", lambda: gymnasium.make("deadreckon/AdroitDoor-v1")):  # the simulator's own
        with pytest.raises(UserError, match=r"200 steps by itself; the horizon must be 200 or less, got 500$"):
            dr.task(given, horizon=500)
    assert dr.task(gymnasium.make("deadreckon/AdroitDoor-v1", max_episode_steps=500)).horizon == 200
    assert dr.task("deadreckon/AdroitDoor-v1", horizon=50).horizon == 50

    def declared():
        env = toys.Shifted()
        env.spec = gymnasium.spec("CartPole-v1")
        return env

    assert dr.task(declared).horizon == 500  # as its spec says
    assert dr.task(declared, horizon=900).horizon == 900  # nothing cuts it


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("tests.toy_environments:Goal", "it has no time limit; give one, such as horizon=500"),
        ("gymnasium:Nothing-v3", "Gymnasium cannot make it.*gymnasium:MODULE:ID"),
        ("Pendulum-v9", "unknown task 'Pendulum-v9'.*a Gymnasium environment is named gymnasium:ID"),
        ("gymnasium:Pendulum-v1?g", "options are written"),
        ("gymnasium:Pendulum-v1?weight=3", "TypeError: .*weight"),
        ("gymnasium:Pendulum-v1?max_episode_steps=0", "horizon must be a whole number|max_episode_steps"),
        ("pettingzoo:mpe/simple_v3", "environment of PettingZoo, for several agents"),
        ("pettingzoo.classic.chess_v6:env", "environment of PettingZoo, for several agents"),
        (toys.Crowd(), "environment of PettingZoo, for several agents"),
        ("tests.toy_environments:_ONE", "no _ONE that is an environment class"),
        (toys.the_same, "gives the same environment twice"),
        (toys.the_same_in_a_wrapper, "gives the same environment twice"),
        ("tests.toy_environments:the_same", "gives the same environment twice"),
        ("tests.toy_environments:the_same_in_a_wrapper", "gives the same environment twice"),
        (gymnasium.make_vec("CartPole-v1", 2), "is a vector of environments"),
        (3, "int is no environment but int"),
        (len, "making it raised TypeError"),
        (lambda: Custom(spaces.Sequence(BOX), BOX), "the observation is Sequence"),
        (lambda: Custom(BOX, spaces.Box(-np.inf, np.inf, (1,), np.float32)), "actions have infinite bounds"),
        (lambda: Custom(BOX, spaces.MultiDiscrete([99, 99, 99])), "970,299 combinations"),
        (lambda: Custom(BOX, spaces.Tuple([spaces.Discrete(2), BOX])), "actions are Discrete, Box"),
        (lambda: Custom(spaces.Box(0, 255, (4, 84, 84), np.uint8), BOX), "no image of .height, width, channels.; put its"),
        (lambda: Custom(spaces.Box(0, 255, (84, 84, 3, 4), np.uint8), BOX), "no image of .height, width, channels.; put its"),
        (lambda: Custom(spaces.Box(0, 255, (84, 84), np.uint8), BOX), "84. is no image of .* give it channels .*keep_dim=True"),
        (lambda: wrappers.NormalizeReward(toys.short_cart()), "NormalizeReward keeps statistics over episodes"),
        (
            lambda: wrappers.FlattenObservation(wrappers.NormalizeObservation(toys.short_cart())),
            "NormalizeObservation keeps statistics over episodes",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_what_is_no_task_is_refused_in_one_line(given, told):
    horizon = 5 if callable(given) and given is not toys.the_same and given is not len else None
    with pytest.raises(UserError, match=told) as error:
        dr.task(given, horizon)
    assert "\n" not in str(error.value)


def test_a_task_keeps_its_horizon_however_it_is_named():
    path, own = "deadreckon.tasks.battery:TASK", "^battery has a horizon of its own, 8 steps; leave the other out$"
    assert dr.task(path) is dr.task(lambda: registry.task("battery")) is registry.task("battery")
    for given in ("battery", path, registry.task("battery"), lambda: registry.task("battery")):
        for horizon in (3, 8):  # an equal one, too
            with pytest.raises(UserError, match=own):
                dr.task(given, horizon=horizon)
    with pytest.raises(UserError, match=own):
        dr.task("deadreckon.tasks.registry:task?given=battery&max_episode_steps=3")
    assert dr.task("deadreckon.tasks.registry:task?given=battery") is registry.task("battery")
    with pytest.raises(UserError, match=f"^task {path} is a Task, which takes no options; leave .size=9 out$"):
        dr.task(f"{path}?size=9")


def test_what_an_environment_raises_is_told_with_its_name():
    simulator = dr.task(toys.Failing, horizon=5).simulate([0])
    simulator.reset()
    with pytest.raises(UserError, match=r"Failing.*: the environment's step\(1\) raised RuntimeError: the pump is dry"):
        simulator.step(np.array([1]))


@pytest.mark.parametrize(
    ("seen", "reward", "told"),
    [(np.nan, 0.0, r"step\(1\) gave an observation that is not finite: nan"),
     (0.0, np.inf, r"step\(1\) gave the reward inf, a finite number is needed")],
)  # fmt: skip
def test_what_is_not_finite_is_told_where_it_begins(seen, reward, told):
    class Drifting(toys.Unseeded):
        def step(self, action):
            return np.full(1, seen, np.float32), reward, False, False, {}

    simulator = dr.task(Drifting, horizon=5).simulate([0])
    simulator.reset()
    with pytest.raises(UserError, match=rf"Drifting.*: the environment's {told}"):
        simulator.step(np.array([1]))


def test_a_folder_must_not_name_code_that_runs():
    with pytest.raises(UserError, match="not one of deadreckon's: name it with --task, or import antigravity first"):
        registry.of_run("antigravity:fly")
    with pytest.raises(UserError, match="import antigravity first"):
        registry.of_run("gymnasium:antigravity:Fly-v0?a=1")
    assert registry.of_run(SHIFTED).name == SHIFTED


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("os:system?command=touch PWNED", "system of os is no class of environments"),
        ("subprocess:getoutput?cmd=touch PWNED", "getoutput of subprocess is no class of environments"),
        ("builtins:open?file=PWNED&mode=x", "open of builtins is no class of environments"),
        ("os:nothing", "nothing of os is no class of environments"),
        ("os:system?command=touch PWNED:pixels", "system of os is no class of environments"),
        ("gymnasium:Ant-v5?xml_file=/etc/passwd", "a file may not give an environment the path of another file"),
        ("gymnasium:Ant-v5?xml_file=~root.xml", "a file may not give an environment the path of another file"),
        ("gymnasium:Ant-v5?a={'b': [b'../c.xml']}", "a file may not give an environment the path of another file"),
        ("Ant-v5?xml_file=..", "a file may not give an environment the path of another file"),
        ("gymnasium:CartPole-v1?a=" + "-" * 2000 + "1", "has a name of 2,025 characters; 1000 are allowed"),
        ("carla:evil:1/lane", "is in a CARLA server"),
    ],
)
def test_a_name_in_a_file_runs_and_opens_nothing(name, message, tmp_path, monkeypatch):
    import subprocess  # noqa: F401 - what programs have imported is no more harmless for it

    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=re.escape(message)):
        registry.of_run(name)
    assert list(tmp_path.iterdir()) == []


def test_names_of_trusted_modules_may_be_anything(monkeypatch):
    monkeypatch.setattr(imports, "_TRUSTED", set())
    assert registry.of_run(SHIFTED).name == SHIFTED  # a class of environments of a module that is imported
    made = SHIFTED.partition(":")[0] + ":short_cart"
    with pytest.raises(UserError, match="short_cart of .* is no class of environments"):
        registry.of_run(made)
    imports.trust("tests")
    assert registry.of_run(made).horizon
    for wrong in ("", "a-b", "a:b", "../a"):
        with pytest.raises(UserError, match="a module is named such as"):
            imports.trust(wrong)


def test_numbers_and_words_of_environments_may_stand_in_files():
    assert registry.of_run("gymnasium:FrozenLake-v1?is_slippery=False&map_name=8x8").horizon == 100
    assert registry.of_run("gymnasium:CartPole-v1").horizon == 500


# ---- our own as Gymnasium has them ------------------------------------------------------------------------------------


def test_logs_know_the_environments_of_all_tasks():
    assert {name: registry.task(name).gym_id for name in registry.names()} == {
        name: env_id.partition(":")[2] or env_id for name, env_id in IDS.items()
    }


def test_logs_of_the_catalogue_are_known_by_their_names():
    assert {each.task for each in CATALOGUE.values()} - {None} <= set(IDS)
    assert task_of("maze2d-medium-v1@dr1-5000") == "maze2d-medium"
    for name in ("hopper-mine-v1", "hopper-noisy-v2", "hopper", "mine-v2"):
        assert task_of(name) is None


ENTRIES = {gymnasium.spec(registry.task(name).gym_id).entry_point: registry.task(name).gym_id for name in registry.names()}


@pytest.mark.parametrize("env_id", ENTRIES.values())
def test_our_own_open_with_a_render_mode(env_id):
    if "Flow" in env_id:
        pytest.importorskip("libsumo")
    env = gymnasium.make(env_id, render_mode="rgb_array")
    assert env.render_mode == "rgb_array"
    env.close()


def test_our_own_say_their_horizon_and_end_there():
    for task in map(registry.task, registry.names()):
        assert gymnasium.spec(task.gym_id).max_episode_steps == task.horizon
    assert dr.task("deadreckon/AdroitDoor-v1").horizon == 200
    env, simulator = gymnasium.make("deadreckon/CarlaLaneState-v0"), registry.task("carla-lane-state").simulate([3])
    env.reset(seed=3), simulator.reset()
    for left in reversed(range(250)):
        *_, terminated, truncated, _ = env.step(np.zeros(2, np.float32))
        assert (terminated, truncated) == (False, left == 0)
        assert simulator.step(np.zeros((1, 2)))[3][0] == truncated


def test_flow_draws_its_cars():
    pytest.importorskip("libsumo")
    env = gymnasium.make("deadreckon/Flow-Ring-v0", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (24, 1024, 3)
    assert (picture == (210, 50, 50)).all(-1).any()  # one learner
    assert (picture == (50, 90, 190)).all(-1).sum() > 10 * 5 * 8  # and most of 21 others, apart
    env.close()


def test_flow_draws_a_merge_without_the_cars_on_its_ramp():
    pytest.importorskip("libsumo")
    env = gymnasium.make("deadreckon/Flow-Merge-v0", render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(2):
        env.step(np.zeros(5, np.float32))
    places = env.unwrapped.traffic()[:, 1]
    assert np.isnan(places).any()
    columns, fronts = np.arange(1024)[:, None], places[~np.isnan(places)].astype(int)
    drawn = (env.render()[8:16] != 225).any((0, 2))
    np.testing.assert_array_equal(drawn, ((fronts - 5 <= columns) & (columns <= fronts)).any(1))
    env.close()


def test_a_task_that_nothing_draws_says_so():
    env = SimulatorEnv("battery", render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(UserError, match="^battery cannot be rendered; leave render_mode out$"):
        env.render()


def test_before_its_first_episode_an_environment_is_not_rendered():
    env = SimulatorEnv("hopper", render_mode="rgb_array")
    with pytest.raises(UserError, match="^hopper cannot be rendered before its first episode; call reset first$"):
        env.render()


def test_a_picture_without_opengl_names_the_remedy(monkeypatch):
    env = SimulatorEnv("hopper", render_mode="rgb_array")
    env.reset(seed=0)

    def absent(*given):
        raise RuntimeError("no OpenGL platform library")

    monkeypatch.setattr(env.simulator, "renderer", absent)
    with pytest.raises(UserError, match="^hopper is drawn with OpenGL, which MuJoCo does not find; without a screen"):
        env.render()


def test_actions_lie_on_bounds_that_rounding_puts_them_beyond():
    """Of a policy that is saturated: -0.7 + 0.8 is 0.10000002 in 32 bits, and 0.1 in 32 bits is more than 0.1 in 64."""
    for space in (
        spaces.Box(-0.7, 0.1, (2,), np.float32), spaces.Box(-0.7, 0.1, (2,), np.float64),
        spaces.Dict({"a": spaces.Box(-0.7, 0.1, (1,), np.float64), "b": spaces.Box(-0.7, 0.1, (1,), np.float64)}),
    ):  # fmt: skip
        task = dr.task(lambda space=space: Custom(BOX, space), horizon=5)
        simulator = task.simulate([0])
        simulator.reset()
        view = Normalizer(None, None, *(np.float32(each) for each in (task.action_space.low, task.action_space.high)))
        for end in (-1.0, 1.0):
            simulator.step(view.from_unit(np.full((1, 2), end, np.float32)))  # which the environment asserts to be allowed
    task = dr.task(lambda: Custom(BOX, spaces.Box(-1, 1, (2,), np.float32)), horizon=5)
    np.testing.assert_array_equal(task.spaces.act(np.array([1.5, -3.0], np.float32)), np.float32([1.5, -3.0]))  # as before


def test_dicts_keep_the_order_that_gymnasium_flattens_in():
    observation = spaces.Dict(velocity=spaces.Box(-1, 1, (1,), np.float32), angle=spaces.Box(5, 6, (2,), np.float32))
    task = dr.task(lambda: Custom(observation, BOX), horizon=5)
    assert list(observation.spaces) == ["velocity", "angle"]
    seen = task.simulate([3]).reset()[0]
    assert abs(seen[0]) <= 1
    assert (seen[1:] >= 5).all()


@pytest.mark.parametrize(
    "value",
    [1, 9.0, True, None, -np.inf, np.inf, "8x8", "1", "True", "'a'", "", " 1", "a&b=c", "a=b", r"\&\x26", "inf", "'&\"",
     ("a&b", 2), {"b&c": [1.5, "2"]}, b"&", "?x=1"],
    ids=repr,
)  # fmt: skip
def test_options_are_read_as_they_were_written(value):
    name = written({"x": value, "other": 3})
    found = options_of(name, name.removeprefix("?"))
    assert found == {"x": value, "other": 3}
    assert type(found["x"]) is type(value)


def test_options_are_written_as_plainly_as_may_be():
    told = {"a": 9.0, "b": False, "c": "8x8", "d": np.float32(0.5), "e": [1, "x"]}
    assert written(told) == "?a=9.0&b=False&c=8x8&d=0.5&e=[1, 'x']"
    assert written({"level": "1"}) == "?level='1'"
    assert written({}) == ""


def test_an_option_may_be_an_array():
    task = dr.task(gymnasium.make("FrozenLake-v1", desc=np.array([[b"S", b"F"], [b"F", b"G"]]), is_slippery=False))
    assert task.observation_shape == (4,)
    assert "\n" not in task.name
    assert task.name.startswith("gymnasium:FrozenLake-v1?desc=array-")
    other = dr.task(gymnasium.make("FrozenLake-v1", desc=np.array([[b"S", b"F"], [b"H", b"G"]]), is_slippery=False))
    assert other.name != task.name


class Owing(gymnasium.Wrapper):
    """Pays from what it has kept of all episodes."""

    paid = 0.0

    def step(self, action):
        seen, reward, *rest = super().step(action)
        self.paid += 1.0
        return seen, self.paid, *rest


def test_rewards_that_depend_on_earlier_episodes_are_told_when_copies_are_restored():
    task = dr.task(lambda: Owing(gymnasium.make("CartPole-v1", max_episode_steps=5)), horizon=5)
    simulator = task.simulate([0, 1])
    simulator.reset()
    for _ in range(3):
        simulator.step(np.zeros(2, int))
    assert task.simulate([0, 1]).restore(simulator.state()) is None  # of the first episode nothing was before
    simulator.reset()
    simulator.step(np.zeros(2, int))
    np.testing.assert_array_equal(task.simulate([0, 1]).restore(simulator.state()), [0, 1])
