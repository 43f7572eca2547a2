import gzip
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from deadreckon.data.formats.io import read
from deadreckon.data.formats.pickles import read_pickle
from deadreckon.data.spec import Box
from deadreckon.data.unpickle import load_pickle
from deadreckon.errors import UserError
from deadreckon.policies.torch_pickle import load_network


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


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values_come_back(tmp_path, protocol):
    value = {
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)), "swapped": np.arange(3, dtype=">i4"),
        "scalar": np.float32(1.5), "flags": np.array([True, False]), "text": np.array(["a", "bc"]), "empty": np.zeros((0, 2)),
        "nested": ([1, "two", None], {"x": {3}}),
    }  # fmt: skip
    path = tmp_path / "x.pkl"
    path.write_bytes(gzip.compress(pickle.dumps(value, protocol)))
    found = load_pickle(path)
    for key in ("fortran", "swapped", "flags", "text", "empty"):
        np.testing.assert_array_equal(found[key], value[key])
        assert found[key].dtype == value[key].dtype
    assert found["scalar"] == 1.5
    assert found["nested"] == value["nested"]


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


@pytest.mark.parametrize(
    "value",
    [
        Runs(np.ndarray, (1,), "O", b"12345678"),  # takes the process down if numpy itself is called
        np.array([object], object),
        np.zeros(2, [("a", "f4"), ("b", "i4")]),
        np.array(["2020-01-01"], "datetime64[D]"),
    ],
    ids=["crafted", "objects", "structured", "dates"],
)
def test_arrays_of_other_things_than_numbers_are_refused(tmp_path, value):
    path = tmp_path / "x.pickle"
    path.write_bytes(pickle.dumps({"actions": value}))
    program = f"from deadreckon.data.unpickle import load_pickle\nload_pickle({str(path)!r})"
    if isinstance(value, Runs):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert "UserError" in done.stderr
    with pytest.raises(UserError, match=str(path)) as caught:
        load_pickle(path)
    assert "\n" not in str(caught.value)


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
    with pytest.raises(UserError, match="nested too deep"):
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


def test_the_real_demonstrations(real_data):
    log = read(real_data / "adroit" / "door-v0_demos.pickle")
    assert (log.name, log.episodes, len(log), log.dropped) == ("door-human", 25, 6729, 25)
    assert log.observations.shape[1:] == (39,)
    assert log.actions.shape[1:] == (28,)
    assert any("(82 %) have actions out of bounds" in line for line in log.warnings)


def test_the_real_policies_name_foreign_classes(real_data):
    with pytest.raises(UserError, match="refused: the pickle asks for "):
        load_pickle(real_data / "adroit" / "door-v0_dapg_policy.pickle")


@pytest.mark.parametrize(("module", "name"), [("os", "system"), ("builtins", "eval"), ("torch", "load")])
def test_networks_are_read_with_no_more_trust(tmp_path, module, name):
    path = tmp_path / "policy.pickle"
    path.write_bytes(b"\x80\x02c" + f"{module}\n{name}\n".encode() + b"X\x04\x00\x00\x00true\x85R.")
    with pytest.raises(UserError, match=f"refused: the pickle asks for {module}.{name}"):
        load_network(path)


def test_an_object_of_a_network_is_its_fields_and_a_name_stays_a_name(tmp_path):
    path = tmp_path / "policy.pickle"
    known = b"\x80\x02cmjrl.policies.gaussian_mlp\nMLP\n)\x81}X\x01\x00\x00\x00f"
    path.write_bytes(known + b"cbuiltins\ngetattr\nctorch._C\n_VariableFunctions\nX\x04\x00\x00\x00tanh\x86Rsb.")
    assert load_network(path) == {"f": "tanh"}
