import json

import gymnasium
import h5py
import minari
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from minari.data_collector import EpisodeBuffer
from small_logs import images, make_log, same

from deadreckon.data.catalogue import load
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.flatten import flatten_space
from deadreckon.data.formats.hdf5 import read_hdf5
from deadreckon.data.formats.io import read
from deadreckon.data.formats.minari import read_minari, write_minari
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:minari")


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


def by_minari(log, dataset_id="theirs/maze-v0", goals=False):
    """`log` written with the minari package alone."""
    space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    buffers = []
    for index, (start, end) in enumerate(zip(log.starts, log.ends)):
        rows = slice(start, end + 1)
        observations = np.concatenate([log.observations[rows], log.final_observations[index : index + 1]])
        goal = np.full((len(observations), 2), index, np.float32)
        infos = {"qpos": np.arange(len(observations)), "deep": {"flag": np.ones(len(observations), bool)}}
        if goals:
            observations = {"observation": observations, "desired_goal": goal, "achieved_goal": goal + 1}
        buffers.append(
            EpisodeBuffer(
                observations=observations,
                actions=log.actions[rows],
                rewards=log.rewards[rows].tolist(),
                terminations=log.terminals[rows].tolist(),
                truncations=log.timeouts[rows].tolist(),
                infos=infos,
            )
        )
    goal_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    minari.create_dataset_from_buffers(
        dataset_id,
        buffer=buffers,
        observation_space=spaces.Dict({"observation": space, "desired_goal": goal_space, "achieved_goal": goal_space})
        if goals
        else space,
        action_space=spaces.Box(np.float32([-1, -1]), np.float32([1, 1.5])),
    )


@pytest.mark.parametrize("goals", [False, True])
def test_minari_and_d4rl_files_of_the_same_data_agree(log, tmp_path, goals):
    by_minari(log, goals=goals)
    path = tmp_path / "same.hdf5"
    with h5py.File(path, "w") as file:
        for key in ("observations", "next_observations", "actions", "rewards", "terminals", "timeouts"):
            file.create_dataset(key, data=getattr(log, key), compression="gzip")
    theirs = read_minari("minari:theirs/maze-v0")
    d4rl = read_hdf5(path)
    assert set(theirs.extras) == {"qpos", "deep_flag", *(("desired_goal", "achieved_goal") if goals else ())}
    for key in ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations", "next_observations"):
        np.testing.assert_array_equal(getattr(theirs, key), getattr(d4rl, key), err_msg=key)
        assert getattr(theirs, key).dtype == getattr(d4rl, key).dtype
    assert theirs.successors is None
    assert theirs.action_space == Box((-1, -1), (1, 1.5))
    assert theirs.name == "maze-v0"
    assert theirs.provenance.extra["dataset_id"] == "theirs/maze-v0"
    if goals:
        np.testing.assert_array_equal(theirs.extras["achieved_goal"][:, 0], log.episode_of + 1)


def test_a_log_comes_back(root):
    log = make_log(goal=np.ones((13, 2), np.float32), name="mine@dr1")
    folder = write_minari(log, "minari:mine/deep/maze-v0")
    assert folder == root / "mine" / "deep" / "maze-v0"
    for source in (folder, folder / "data", "minari:mine/deep/maze-v0"):
        again = read_minari(source)
        same(log, again)
    assert read("minari:mine/deep/maze-v0").fingerprint == read(folder).fingerprint == log.fingerprint
    assert again.name == "mine@dr1"
    assert minari.load_dataset("mine/deep/maze-v0").total_steps == 13
    assert "mine/deep/maze-v0" in minari.list_local_datasets()
    assert not [path for path in root.iterdir() if path.name.startswith(".")]


def test_discrete_actions_and_pictures_come_back():
    for log in (make_log(discrete=True), images()):
        write_minari(log, "mine/other-v0", force=True)
        assert read_minari("minari:mine/other-v0").fingerprint == log.fingerprint


def test_actions_that_start_elsewhere_are_counted_from_zero():
    buffer = EpisodeBuffer(
        observations=np.zeros((4, 2), np.float32), actions=np.array([3, 5, 4]), rewards=[0.0, 1.0, 2.0],
        terminations=[False, False, True], truncations=[False] * 3,
    )  # fmt: skip
    box = spaces.Box(-1, 1, (2,), np.float32)
    minari.create_dataset_from_buffers(
        "theirs/start-v0", buffer=[buffer], observation_space=box, action_space=spaces.Discrete(3, start=3)
    )
    log = read_minari("minari:theirs/start-v0")
    assert log.actions.tolist() == [0, 2, 1]
    assert log.action_space == Discrete(3)


@pytest.mark.parametrize(("moves", "space", "written"), [
    ([1, 2, 3], spaces.Discrete(3, start=1), [3, 1, 2, 3]), ([0, 5, 10], spaces.Discrete(3), [2, 0, 1, 2]),
])  # fmt: skip
def test_integers_of_a_table_are_written_where_gymnasium_has_a_space_for_them(moves, space, written):
    table = {"x": np.arange(8.0), "move": [moves[i % 3 - 1] for i in range(8)], "gain": np.ones(8), "end": [0, 0, 0, 1] * 2}
    log = Dataset.from_frame(table, action="move", reward="gain", terminal="end")
    write_minari(log, "mine/moves-v0")
    theirs = minari.load_dataset("mine/moves-v0")
    assert theirs.action_space == space
    assert theirs[0].actions.tolist() == written
    again = read("minari:mine/moves-v0")
    np.testing.assert_array_equal(again.actions, log.actions)
    assert (again.action_space, again.provenance.extra["action_levels"]) == (Discrete(3), moves)


def test_rows_without_successor_are_left_out_when_written():
    log = make_log((3, 1, 2), terminal=(False,), finals=False)
    write_minari(log, "mine/short-v0")
    again = read_minari("minari:mine/short-v0")
    assert again.lengths.tolist() == [2, 1]
    assert again.dropped == 0
    np.testing.assert_array_equal(again.final_observations, log.observations[log.ends[[0, 2]]])


def test_what_cannot_be_read_or_written_is_told_in_one_line(log, root, tmp_path):
    with pytest.raises(UserError, match="holds none"):
        read_minari("minari:mine/maze-v0")
    write_minari(log, "mine/maze-v0")
    with pytest.raises(UserError, match="unknown Minari data set 'mine/mazes-v0': did you mean mine/maze-v0"):
        read_minari("minari:mine/mazes-v0")
    with pytest.raises(UserError, match="exists already"):
        write_minari(log, "mine/maze-v0")
    (root / "mine" / "photos-v0").mkdir()
    with pytest.raises(UserError, match="holds no Minari data set, so it is not replaced"):
        write_minari(log, "mine/photos-v0", force=True)
    for bad in ("no id at all", "mine", "mine/maze", "mine/../../maze-v0", "/mine/maze-v0"):
        with pytest.raises(UserError, match="is no Minari id"):
            write_minari(log, bad)
    odd = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards,
        next_observations=log.observations + 1, timeouts=log.timeouts | log.terminals,
    )  # fmt: skip
    with pytest.raises(UserError, match="Minari cannot store it"):
        write_minari(odd, "mine/odd-v0")
    main = root / "mine" / "maze-v0" / "data" / "main_data.hdf5"
    with pytest.raises(UserError, match="the inside of a Minari data set"):
        read(main)
    main.write_bytes(main.read_bytes()[:500])
    with pytest.raises(UserError, match="damaged or cut short") as caught:
        read_minari("minari:mine/maze-v0")
    assert "\n" not in str(caught.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match=r"no metadata\.json"):
        read_minari(tmp_path / "empty")


def by_spaces(dataset_id, observation_space, action_space, steps=3):
    """Samples of two spaces as one episode, written with the minari package alone."""
    observation_space.seed(0), action_space.seed(1)
    seen = [observation_space.sample() for _ in range(steps + 1)]
    acted = [action_space.sample() for _ in range(steps)]
    stacked = {key: np.stack([each[key] for each in seen]) for key in seen[0]} if isinstance(seen[0], dict) else (
        tuple(np.stack(part) for part in zip(*seen)) if isinstance(seen[0], tuple) else np.stack(seen)
    )  # fmt: skip
    buffer = EpisodeBuffer(
        observations=stacked, actions=np.stack(acted), rewards=[1.0] * steps, terminations=[False] * (steps - 1) + [True],
        truncations=[False] * steps,
    )  # fmt: skip
    minari.create_dataset_from_buffers(
        dataset_id, buffer=[buffer], observation_space=observation_space, action_space=action_space
    )
    return seen, acted


GOAL, CARDS = spaces.Box(-1, 1, (2,), np.float32), spaces.MultiDiscrete([2, 3])
FLATTENED = {
    "lake": (spaces.Discrete(4), [f"observation={level}" for level in range(4)]),
    "start": (spaces.Discrete(3, start=5), ["observation=5", "observation=6", "observation=7"]),
    "cards": (CARDS, ["observation[0]=0", "observation[0]=1", "observation[1]=0", "observation[1]=1", "observation[1]=2"]),
    "lamps": (spaces.MultiBinary(3), ["observation[0]", "observation[1]", "observation[2]"]),
    "dict": (
        spaces.Dict({"state": spaces.Discrete(3), "goal": GOAL}), ["goal[0]", "goal[1]", "state=0", "state=1", "state=2"]
    ),
    "tuple": (spaces.Tuple((spaces.Discrete(2), GOAL)), ["0=0", "0=1", "1[0]", "1[1]"]),
}  # fmt: skip


@pytest.mark.parametrize("kind", FLATTENED)
def test_observations_are_flattened_as_gymnasium_does_it(kind):
    space, names = FLATTENED[kind]
    seen, _ = by_spaces(f"theirs/{kind}-v0", space, spaces.Discrete(2))
    log = read_minari(f"minari:theirs/{kind}-v0")
    want = np.stack([gymnasium.spaces.utils.flatten(space, each) for each in seen])
    np.testing.assert_array_equal(log.observations, want[:-1])
    np.testing.assert_array_equal(log.next_observations, want[1:])
    assert log.provenance.extra["observation_names"] == names


def test_the_names_of_dicts_within_dicts():
    inner = spaces.Dict({"b": spaces.Dict({"c": spaces.Box(0, 1, (1, 2), np.float32)}), "a": spaces.Box(0, 1, (), np.float32)})
    column, names = flatten_space(inner, {"a": np.ones(2), "b": {"c": np.zeros((2, 1, 2))}})
    assert names == ["a", "b/c[0,0]", "b/c[0,1]"]
    np.testing.assert_array_equal(column, [[1, 0, 0], [1, 0, 0]])
    for space, values, words in (
        (spaces.Dict({"eye": spaces.Box(0, 255, (4, 4), np.uint8)}), {"eye": np.zeros((2, 4, 4), np.uint8)}, "is an image"),
        (spaces.Dict({"word": spaces.Text(3)}), {"word": ["a", "b"]}, "word is Text, which has no fixed number of dimensions"),
        (spaces.Discrete(2), np.array([0, 2]), r"observation has 2 in row 1, 0 \.\. 1 is needed"),
    ):
        with pytest.raises(UserError, match=words):
            flatten_space(space, values)


SEVERAL = (spaces.MultiDiscrete([2, 3]), spaces.MultiBinary(2), spaces.MultiDiscrete([2, 2], start=[1, 3]))


@pytest.mark.parametrize("space", SEVERAL)
def test_actions_of_several_integers_are_joined(space):
    _, acted = by_spaces("theirs/multi-v0", GOAL, space, steps=20)
    log = read_minari("minari:theirs/multi-v0")
    levels = log.provenance.extra["action_levels"]
    np.testing.assert_array_equal(np.array(levels)[log.actions], acted)
    assert log.action_space == Discrete(len(levels))
    assert len({tuple(level) for level in levels}) == len(levels)
    assert f"are joined into {len(levels)} discrete ones" in log.warnings[0]


def test_actions_that_cannot_be_joined_are_refused():
    by_spaces("theirs/many-v0", GOAL, spaces.MultiDiscrete([101, 100]))
    with pytest.raises(UserError, match="MultiDiscrete with 10,100 combinations; at most 10,000 are joined"):
        read_minari("minari:theirs/many-v0")


def test_bare_ids_of_data_sets_that_are_here(root, tmp_path, monkeypatch):
    log = make_log(name="mine@dr1")
    write_minari(log, "mujoco/hopper/medium-v0")
    for reader in (read, read_minari, load):
        assert reader("mujoco/hopper/medium-v0").fingerprint == log.fingerprint
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mujoco" / "hopper").mkdir(parents=True)
    (tmp_path / "mujoco" / "hopper" / "medium-v0").write_text("a file of this name is meant before the data set")
    with pytest.raises(UserError, match="not a log in a format that is read"):
        read("mujoco/hopper/medium-v0")
    for bad in ("mujoco/hopper/expert-v0", "../minari/mujoco/hopper/medium-v0", str(root / "mujoco" / "none-v0")):
        with pytest.raises(UserError, match="no file"):
            read(bad)


def test_ids_stay_within_the_root_and_need_their_prefix(log, root, tmp_path):
    folder = write_minari(log, "mine/maze-v0")
    (tmp_path / "other").mkdir()
    folder.rename(tmp_path / "other" / "ds-v0")
    assert len(read_minari(tmp_path / "other" / "ds-v0")) == len(log)
    for bad in ("../other/ds-v0", "../other/ds", str(tmp_path / "other" / "ds-v0"), "mine/../../other/ds-v0", "mine", ""):
        with pytest.raises(UserError, match="is no Minari id"):
            read(f"minari:{bad}")
    with pytest.raises(UserError, match=r"mine/maze-v0: no metadata.json; .*minari:ID names one by id"):
        read_minari("mine/maze-v0")


@pytest.mark.parametrize("header", ["[1]", '"x"', '{"deadreckon": "a"}'])
def test_a_damaged_header_of_ours(log, header):
    meta = write_minari(log, "mine/maze-v0") / "data" / "metadata.json"
    found = json.loads(meta.read_text())
    meta.write_text(json.dumps({**found, "deadreckon": json.loads(header)}))
    with pytest.raises(UserError, match="its header is damaged"):
        read("minari:mine/maze-v0")


@pytest.mark.parametrize("key", ["observation_space", "action_space"])
def test_no_environment_is_made_for_a_space_that_is_not_there(log, tmp_path, key):
    """Minari makes the environment that the file names, by any function of any module."""
    meta = write_minari(log, "mine/maze-v0") / "data" / "metadata.json"
    found = json.loads(meta.read_text())
    del found[key]
    made = tmp_path / "made"
    spec = EnvSpec("X-v0", entry_point="os:mkdir", kwargs={"path": str(made)})
    meta.write_text(json.dumps({**found, "env_spec": spec.to_json()}))
    with pytest.raises(UserError, match=f"no {key}, which is needed"):
        read("minari:mine/maze-v0")
    assert not made.exists()


def test_columns_that_lie_in_other_files_are_not_read(log, tmp_path):
    folder = write_minari(log, "mine/maze-v0")
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    with h5py.File(folder / "data" / "main_data.hdf5", "r+") as file:
        rewards = file["episode_0/rewards"]
        shape, dtype = rewards.shape, rewards.dtype
        del file["episode_0/rewards"]
        file["episode_0"].create_dataset("rewards", shape, dtype, external=[(str(tmp_path / "secret.bin"), 0, 1000)])
    with pytest.raises(UserError, match="episode_0/rewards lies in another file, which is not opened"):
        read("minari:mine/maze-v0")
