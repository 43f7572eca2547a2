import os
import pickle

import numpy as np
import pytest

from deadreckon.data.formats.io import read
from deadreckon.data.formats.pickles import read_pickle
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.unpickle import load_pickle


def episodes(lengths=(3, 2)):
    rng = np.random.default_rng(0)
    return [
        {"observations": rng.normal(size=(n, 4)), "actions": rng.uniform(-1.2, 1.2, (n, 2)), "rewards": rng.normal(size=n),
         "init_state_dict": {"qpos": rng.normal(size=3)}}
        for n in lengths
    ]  # fmt: skip


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_demonstrations(tmp_path, protocol):
    path, data = tmp_path / "door-v0_demos.pickle", episodes()
    path.write_bytes(pickle.dumps(data, protocol))
    log = read(path)
    assert log.name == "door-human"
    assert log.lengths.tolist() == [3, 2]
    assert log.dropped == 2
    assert log.action_space == Box((-1, -1), (1, 1))
    assert "out of bounds" in log.warnings[0]
    np.testing.assert_array_equal(log.observations, np.concatenate([e["observations"] for e in data]).astype("f4"))


class Runs:
    """A pickle that runs a command when it is read in the ordinary way."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_a_pickle_that_runs_a_command_is_refused_and_nothing_runs(tmp_path, protocol):
    path, witness = tmp_path / "x.pickle", tmp_path / "witness"
    for call in (Runs(os.system, f"touch {witness}"), Runs(eval, f"open({str(witness)!r}, 'w')")):
        path.write_bytes(pickle.dumps([{"actions": call}], protocol))
        with pytest.raises(UserError, match=rf"^{path}: refused: the pickle asks for (posix|builtins|__builtin__)\.\w+"):
            read(path)
        assert not witness.exists()
    path.write_bytes(pickle.dumps([{"actions": Runs(os.system, f"touch {witness}")}], protocol))
    pickle.loads(path.read_bytes())
    assert witness.exists()  # the test would see it


def test_truncated_and_foreign_pickles_are_told_in_one_line(tmp_path):
    path, whole = tmp_path / "x.pickle", pickle.dumps(episodes())
    for size in (3, 40, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(UserError, match=f"^{path}: cannot be read as a pickle, it is damaged or cut short") as caught:
            read(path)
        assert "\n" not in str(caught.value)
    for value, words in (
        ([1, 2], "a list of episodes"),
        ([], "a list of episodes"),
        ("text", "a list of episodes"),
        ([{"observations": np.zeros(2)}], "episode 0 has no array actions"),
        ({"observations": np.zeros(2)}, "no column actions"),
    ):
        path.write_bytes(pickle.dumps(value))
        with pytest.raises(UserError, match=words):
            read_pickle(path)
    uneven = episodes()
    uneven[1]["rewards"] = np.zeros(5)
    path.write_bytes(pickle.dumps(uneven))
    with pytest.raises(UserError, match="episode 1 has 5 rewards and 2 actions"):
        read_pickle(path)
    deep = []
    for _ in range(300):
        deep = [deep]
    path.write_bytes(pickle.dumps(deep))
    with pytest.raises(UserError, match="nested in 101 levels"):
        load_pickle(path)


def test_trajectories_with_next_observations_and_terminals(tmp_path):
    data = [
        {"observations": np.arange(3.0)[:, None], "next_observations": np.arange(1.0, 4)[:, None], "rewards": np.ones(3),
         "actions": np.zeros((3, 1)), "terminals": np.array([False, False, index == 0])}
        for index in range(2)
    ]  # fmt: skip
    (tmp_path / "walk.pkl").write_bytes(pickle.dumps(data))
    log = read(tmp_path / "walk.pkl")
    assert (log.name, log.episodes, log.dropped) == ("walk", 2, 0)
    assert log.final_observations.ravel().tolist() == [3, 3]


def test_flags_of_ends_are_never_lost(tmp_path):
    """As a list, or under another name in a dict an episode, a flag was dropped and its episodes ended in timeouts."""
    path = tmp_path / "walk.pkl"
    columns = {"observations": np.arange(4.0)[:, None], "actions": np.zeros((4, 1)), "rewards": np.ones(4)}
    lists = {"terminals": [False, True, False, True], "goal": [1.0, 2.0, 3.0, 4.0], "tags": ["a", "b", "c", "d"], "note": None}
    path.write_bytes(pickle.dumps({**columns, **lists}))
    log = read(path)
    assert log.terminals.tolist() == lists["terminals"]
    assert {key: column.tolist() for key, column in log.extras.items()} == {"goal": lists["goal"]}
    path.write_bytes(pickle.dumps({**columns, "terminals": [[False], [True, False], [False], [True]]}))
    with pytest.raises(UserError, match=f"^{path}: column terminals is no array of numbers in which every row has the same"):
        read(path)
    ended = np.array([False, False, False, True])
    for name in ("dones", "terminated", "truncated"):
        path.write_bytes(pickle.dumps([columns, {**columns, name: ended}]))
        with pytest.raises(UserError, match=f"episode 1 has {name}, which is not read; call it terminals .* or timeouts"):
            read(path)
    path.write_bytes(pickle.dumps([columns, {**columns, "terminals": ended}]))
    with pytest.raises(UserError, match="episode 1 has terminals, which is not read; all need the same"):
        read(path)


def test_the_real_demonstrations(real_data):
    log = read(real_data / "adroit" / "door-v0_demos.pickle")
    assert (log.name, log.episodes, len(log), log.dropped) == ("door-human", 25, 6729, 25)
    assert log.observations.shape[1:] == (39,)
    assert log.actions.shape[1:] == (28,)
    assert any("(82 %) have actions out of bounds" in line for line in log.warnings)
