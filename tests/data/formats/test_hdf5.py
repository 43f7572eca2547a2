import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from small_logs import images, make_log, same

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.folder import write_folder
from deadreckon.data.formats.hdf5 import create, read_hdf5, write_hdf5
from deadreckon.data.formats.io import convert, read
from deadreckon.data.formats.npz import write_npz
from deadreckon.data.formats.tables import write_parquet
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Box
from deadreckon.errors import UserError


def d4rl_file(path, log, *, following=False, timeouts=True, **options):
    """A file as D4RL's scripts wrote them: no header, all kinds of number types."""
    with h5py.File(path, "w") as file:
        file.create_dataset("observations", data=log.observations, **options)
        file.create_dataset("actions", data=log.actions, **options)
        file.create_dataset("rewards", data=log.rewards.astype(np.float64), **options)
        file.create_dataset("terminals", data=log.terminals.astype(np.float32), **options)
        if timeouts:
            file.create_dataset("timeouts", data=log.timeouts, **options)
        if following:
            file.create_dataset("next_observations", data=log.next_observations, **options)
        file.create_dataset("infos/goal", data=np.arange(2 * len(log)).reshape(-1, 2))
        file.create_dataset("infos/action_log_probs", data=-np.ones(len(log)))
        file.create_dataset("infos/rewards", data=np.ones(len(log)))
        file.create_dataset("metadata/algorithm", data=b"SAC")
        file.create_dataset("metadata/iteration", data=[7])
        file.create_dataset("metadata/policy/fc0/weight", data=np.ones((3, 3)))
    return path


def test_a_log_comes_back_exactly(variant, tmp_path):
    path = tmp_path / "log.hdf5"
    write_hdf5(variant, path)
    for mmap in (False, True):
        again = read_hdf5(path, mmap=mmap)
        same(variant, again)
        assert again.fingerprint == variant.fingerprint
        assert again.name == variant.name
        assert again.action_space == variant.action_space
    assert isinstance(again.observations, np.memmap)
    assert list(tmp_path.iterdir()) == [path]


def test_pictures_come_back_exactly(tmp_path):
    write_hdf5(images(), tmp_path / "log.hdf5")
    again = read_hdf5(tmp_path / "log.hdf5", mmap=True)
    assert again.fingerprint == images().fingerprint
    assert again.observations.dtype == np.uint8


def test_our_columns_are_contiguous_float32_at_their_offset(log, tmp_path):
    path = tmp_path / "log.hdf5"
    write_hdf5(log, path)
    with h5py.File(path) as file:
        column = file["observations"]
        assert column.chunks is None
        assert column.compression is None
        offset, shape = column.id.get_offset(), column.shape
    raw = np.memmap(path, np.float32, "r", offset, shape)
    np.testing.assert_array_equal(raw, log.observations)
    assert offset % 64 == 0


def test_provenance_comes_back(log, tmp_path):
    provenance = Provenance("collected", "maze", 3, {"mujoco": "3.11.0"}, None, {"cells": [1, 2]})
    log = Dataset.from_arrays(observations=log.observations, actions=log.actions, rewards=log.rewards, provenance=provenance)
    write_hdf5(log, tmp_path / "log.hdf5")
    again = read_hdf5(tmp_path / "log.hdf5").provenance
    assert again.path == str(tmp_path / "log.hdf5")
    assert (again.recipe, again.seed, again.versions, again.extra) == ("maze", 3, {"mujoco": "3.11.0"}, {"cells": [1, 2]})


@pytest.mark.parametrize("following", [False, True])
@pytest.mark.parametrize("timeouts", [False, True])
def test_d4rl_layout(log, tmp_path, following, timeouts):
    found = read_hdf5(d4rl_file(tmp_path / "maze-v1.hdf5", log, following=following, timeouts=timeouts))
    assert found.name == "maze-v1"
    assert found.provenance.source == "d4rl-hdf5"
    assert found.provenance.extra["metadata"] == {"algorithm": "SAC", "iteration": 7}
    assert set(found.extras) == {"goal", "behavior_log_probs", "infos_rewards"}
    np.testing.assert_array_equal(found.observations, log.observations)
    np.testing.assert_array_equal(found.terminals, log.terminals)
    if following:
        np.testing.assert_array_equal(found.next_observations, log.next_observations)
        np.testing.assert_array_equal(found.timeouts, log.timeouts)
        assert found.dropped == 0
    else:
        # Without next observations, only terminals and marked timeouts end an episode, and timeouts lose their last row.
        assert found.dropped == (2 if timeouts else 1)


def test_d4rls_dict_is_read_as_its_file_is(log, tmp_path):
    """As `env.get_dataset()` gives it."""
    path, columns = d4rl_file(tmp_path / "maze.hdf5", log), {}
    with h5py.File(path) as file:
        file.visititems(lambda key, item: columns.update({key: item[()]}) if isinstance(item, h5py.Dataset) else None)
    found, expected = Dataset.from_dict(columns, name="maze"), read_hdf5(path)
    assert found.fingerprint == expected.fingerprint
    assert found.provenance.extra == expected.provenance.extra
    write_hdf5(found, tmp_path / "again.hdf5")
    both = Dataset.from_dict({**columns, "behavior_log_probs": -2 * np.ones(len(log))})
    assert (both.extras["behavior_log_probs"][0], both.extras["action_log_probs"][0]) == (-2, -1)


@pytest.mark.parametrize("options", [{"chunks": True}, {"compression": "gzip"}])
def test_compressed_columns_are_not_memory_mapped(log, tmp_path, options):
    path = d4rl_file(tmp_path / "log.hdf5", log, **options)
    assert len(read_hdf5(path)) == len(log)
    with pytest.raises(UserError, match=f"{path}: column .* cannot be memory-mapped: `deadreckon data convert {path} "):
        read_hdf5(path, mmap=True)


def test_compressed_files_are_converted_without_being_loaded(log, tmp_path, monkeypatch):
    path = d4rl_file(tmp_path / "log.hdf5", log, compression="gzip", following=True)
    whole = read_hdf5(path)
    converted = convert(path, tmp_path / "ours.hdf5")
    assert isinstance(converted.observations, np.memmap)
    assert read_hdf5(tmp_path / "ours.hdf5", mmap=True).fingerprint == whole.fingerprint
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.hdf5", "ours.hdf5"]
    with h5py.File(path, "a") as file:
        file["rewards"][4] = 1e300
    with pytest.raises(UserError, match=r"column rewards has inf in row 4"):
        convert(path, tmp_path / "other.hdf5")
    assert not (tmp_path / "other.hdf5").exists()


def test_columns_that_would_be_converted_are_not_memory_mapped(log, tmp_path):
    with pytest.raises(UserError, match="column rewards holds float64, so it cannot be memory-mapped"):
        read_hdf5(d4rl_file(tmp_path / "log.hdf5", log), mmap=True)


def test_streamed_writing(tmp_path):
    path, log = tmp_path / "sub" / "log.hdf5", make_log((4, 3), terminal=(False,), name="streamed")
    columns = {"observations": ((3,), "f4"), "actions": ((2,), "f4"), "rewards": ((), "f4"), "terminals": ((), bool),
               "timeouts": ((), bool), "goal": ((2,), "f4")}  # fmt: skip
    with create(path, rows=7, columns=columns, name="streamed", action_space=log.action_space) as writer:
        for rows in (slice(4, 7), slice(0, 4)):
            for key in ("observations", "actions", "rewards", "terminals", "timeouts"):
                writer[key][rows] = getattr(log, key)[rows]
            writer["goal"][rows] = 1
        writer.write_finals(log.final_observations)
        writer.provenance = Provenance("collected", recipe="maze", seed=1)
        assert not path.exists()
    found = read_hdf5(path, mmap=True)
    assert found.name == "streamed"
    assert found.provenance.recipe == "maze"
    np.testing.assert_array_equal(found.next_observations, log.next_observations)
    assert (found.extras["goal"] == 1).all()


def test_streamed_writing_that_fails_leaves_nothing(tmp_path):
    columns = {"actions": ((2,), "f4"), "terminals": ((), bool), "timeouts": ((), bool)}

    def fill(column):
        with create(tmp_path / "log.hdf5", rows=3, columns=columns) as writer:
            writer[column][:] = [True, False, False]
            writer["timeouts"][:] = False
            writer.write_finals(np.zeros((1, 3)))

    with pytest.raises(UserError, match="1 final observations for 2 episodes"):
        fill("terminals")
    with pytest.raises(KeyError, match="rewards"):
        fill("rewards")
    assert list(tmp_path.iterdir()) == []


def test_damaged_files_are_told_in_one_line(log, tmp_path):
    path = tmp_path / "log.hdf5"
    write_hdf5(log, path)
    whole = path.read_bytes()
    for size in (100, len(whole) // 2, len(whole) - 20):
        path.write_bytes(whole[:size])
        for mmap in (False, True):
            with pytest.raises(UserError, match="damaged or cut short") as caught:
                read(path, mmap=mmap)
            assert str(path) in str(caught.value)
            assert "\n" not in str(caught.value)


def test_wrong_columns_name_file_column_and_row(log, tmp_path):
    path = d4rl_file(tmp_path / "log.hdf5", log)
    with h5py.File(path, "a") as file:
        file["rewards"][4] = np.nan
    with pytest.raises(UserError, match=f"^{path}: column rewards has nan in row 4$"):
        read_hdf5(path)
    with h5py.File(path, "a") as file:
        del file["rewards"]
    with pytest.raises(UserError, match=f"^{path}: no column rewards"):
        read_hdf5(path)
    with h5py.File(path, "a") as file:
        del file["actions"]
    with pytest.raises(UserError, match=f"^{path}: no column actions; .* this one has infos/action_log_probs"):
        read_hdf5(path)


def test_texts_are_left_out_and_dones_must_be_said_what_they_are(log, tmp_path):
    path = d4rl_file(tmp_path / "log.hdf5", log)
    with h5py.File(path, "a") as file:
        file["infos/comment"] = [b"well"] * len(log)
    found = read_hdf5(path)
    assert "comment" not in found.extras
    assert found.provenance.extra["left_out"] == ["infos/comment"]
    with h5py.File(path, "a") as file:
        file.move("terminals", "dones")
    with pytest.raises(UserError, match=f"^{path}: column dones must be called terminals"):
        read_hdf5(path)


def test_a_newer_format_and_a_damaged_header_are_refused(log, tmp_path):
    path = tmp_path / "log.hdf5"
    write_hdf5(log, path)
    for header, words in (('{"deadreckon": 99}', "newer deadreckon"), ("{", "header is damaged"), ("{}", "damaged")):
        with h5py.File(path, "a") as file:
            file.attrs["deadreckon"] = header
        with pytest.raises(UserError, match=words):
            read_hdf5(path)


def test_strict_refuses_actions_out_of_bounds(tmp_path):
    log = Dataset.from_arrays(
        observations=np.zeros((3, 1)), actions=np.array([[0], [2], [0]]) * 1.0, rewards=np.zeros(3),
        action_space=Box((-1,), (1,)),
    )  # fmt: skip
    write_hdf5(log, tmp_path / "log.hdf5")
    assert "out of bounds" in read_hdf5(tmp_path / "log.hdf5").warnings[0]
    with pytest.raises(UserError, match=r"log.hdf5: 1 of 3 rows .* first row 1"):
        read_hdf5(tmp_path / "log.hdf5", strict=True)


HEADERS = ["", "[1]", "3", "null", '{"deadreckon": "a"}', '{"deadreckon": true}', "[" * 100_000,
           '{"deadreckon": 1, "name": 3, "action_space": null, "provenance": {}}',
           '{"deadreckon": 1, "name": "x", "action_space": [], "provenance": {}}',
           '{"deadreckon": 1, "name": "x", "action_space": null, "provenance": []}',
           '{"deadreckon": 1, "name": "x", "action_space": null, "provenance": {"extra": 3}}']  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("header", HEADERS)
def test_damaged_headers_are_told_in_one_line_by_every_format(log, tmp_path, header):
    for name in ("log.hdf5", "log.npz", "log.parquet", "log"):
        convert_to = tmp_path / name
        {"log.hdf5": write_hdf5, "log.npz": write_npz, "log.parquet": write_parquet, "log": write_folder}[name](log, convert_to)
        spoil(convert_to, header)
        with pytest.raises(UserError, match="its header is damaged") as caught:
            read(convert_to)
        assert str(caught.value).startswith(str(convert_to))
        assert "\n" not in str(caught.value)


def spoil(path, header):
    if path.suffix == ".hdf5":
        with h5py.File(path, "a") as file:
            del file.attrs["deadreckon"]
            file.attrs["deadreckon"] = header[:10_000]
    elif path.suffix == ".npz":
        with np.load(path) as file:
            columns = dict(file)
        np.savez(path, **{**columns, "deadreckon": np.array(header)})
    elif path.suffix == ".parquet":
        pq.write_table(pq.read_table(path).replace_schema_metadata({"deadreckon": header}), path)
    else:
        value = header.replace('{"deadreckon": 1,', '{"deadreckon": 1, "columns": ["observations", "actions", "rewards"],')
        (path / "log.json").write_text(value)


@pytest.mark.parametrize("key", ["name", "strict", "action_space", "provenance", "cls"])
def test_columns_called_like_an_argument_are_renamed(log, tmp_path, key):
    path, column = d4rl_file(tmp_path / "log.hdf5", log), np.arange(len(log))
    with h5py.File(path, "a") as file:
        file[key] = column
    np.savez(tmp_path / "log.npz", observations=log.observations, actions=log.actions, rewards=log.rewards, **{key: column})
    for found in (read(path), read(tmp_path / "log.npz")):
        np.testing.assert_array_equal(found.extras[f"infos_{key}"], column)
    with h5py.File(path, "a") as file:
        file[f"infos/infos_{key}"] = column
    with pytest.raises(UserError, match=rf"{path}: two columns would be called infos_{key}; rename one"):
        read(path)


def test_a_horizon_marks_the_time_limits_that_a_file_does_not(log, tmp_path):
    path = d4rl_file(tmp_path / "log.hdf5", log, timeouts=False)  # terminals in rows 2 and 8 of 13
    assert "time limits that are not marked would be crossed" in " ".join(read(path).warnings)
    cut = read(path, horizon=2)
    assert not any("time limits" in line for line in cut.warnings)
    assert cut.lengths.tolist() == [2, 1, 2, 2, 2, 2, 2]
    assert cut.dropped == int((~log.terminals[cut.ends]).sum())
    np.testing.assert_array_equal(cut.terminals, log.terminals)
    assert cut.provenance.extra["horizon"] == 2
    assert convert(path, tmp_path / "ours.hdf5", horizon=2).fingerprint == cut.fingerprint
    assert read(path, horizon=100).lengths.tolist() == read(path).lengths.tolist()
    told = d4rl_file(tmp_path / "told.hdf5", log, following=True)
    again = read(told, horizon=2)
    assert (again.lengths <= 2).all()
    assert again.dropped == 0  # what follows is known
    assert not any("time limits" in line for line in (*read(told).warnings, *read(tmp_path / "ours.hdf5").warnings))
    for file, words in ((tmp_path / "ours.hdf5", "final_observations tell where"), (path, "horizon must be >= 1")):
        with pytest.raises(UserError, match=words):
            read(file, horizon=0 if file == path else 3)
    nowhere = d4rl_file(tmp_path / "following.hdf5", log, following=True, timeouts=False)
    with pytest.raises(UserError, match="next_observations tell where episodes end"):
        read(nowhere, horizon=3)
