"""The buffer of an online run: what learners see of it, and what a kill, a torn file or a full disk leave of it."""


import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.training.replay import Replay, read_rows
from tests.limits import files_up_to

WIDTH, CAPACITY, LANES = 3, 20, 2


def rows(count, seed=0):
    return np.random.default_rng(seed).normal(size=(LANES, count, WIDTH)).astype(np.float32)


def halves(rows):
    return rows * np.float32(0.5)


@pytest.fixture
def paths(tmp_path):
    return [tmp_path / "replay" / f"seed{i}.bin" for i in range(LANES)]


def replay(paths=(), capacity=CAPACITY):
    return Replay(WIDTH, capacity, LANES, halves, paths)


def test_learners_see_their_view_of_the_rows_and_files_hold_the_rows(paths):
    buffer, parts = replay(paths), [rows(4), rows(1, 1), rows(7, 2)]
    for part in parts:
        buffer.append(part)
    whole = np.concatenate(parts, 1)
    assert buffer.count == 12
    np.testing.assert_array_equal(buffer.buffer[:, :12], halves(whole))
    assert not np.asarray(buffer.buffer[:, 12:]).any()
    assert not paths[0].exists()  # the disk is not touched before the flush
    buffer.flush()
    for path, lane in zip(paths, whole):
        assert path.read_bytes() == lane.tobytes()
        np.testing.assert_array_equal(read_rows(path, WIDTH, 9), lane[:9])
    buffer.append(rows(8, 3))
    buffer.flush()
    buffer.flush()  # nothing is written twice
    assert paths[1].read_bytes() == np.concatenate([whole[1], rows(8, 3)[1]]).tobytes()


def test_without_files_rows_live_in_memory():
    buffer = replay()
    buffer.append(rows(5))
    buffer.flush()
    np.testing.assert_array_equal(buffer.buffer[:, :5], halves(rows(5)))


def test_taken_up_from_the_files_it_is_the_same_and_goes_on(paths):
    one = replay(paths)
    one.append(rows(6))
    one.flush()
    other = replay(paths, capacity=CAPACITY + 10)  # a run that was made longer
    other.restore(6)
    assert other.count == 6
    np.testing.assert_array_equal(other.buffer[:, :CAPACITY], one.buffer)
    before = [path.stat().st_mtime_ns for path in paths]
    other.flush()  # rows that are on disk are not written again: a kill could catch them half-written
    assert [path.stat().st_mtime_ns for path in paths] == before
    for buffer in (one, other):
        buffer.append(rows(3, 1))
    other.flush()
    np.testing.assert_array_equal(other.buffer[:, :CAPACITY], one.buffer)
    assert paths[0].read_bytes() == np.concatenate([rows(6)[0], rows(3, 1)[0]]).tobytes()


def test_a_number_that_is_set_leaves_all_others(paths):
    one = replay(paths)
    one.append(rows(6))
    one.flush()
    one.set(1, 2, 1, 9.0)
    one.restore(6)
    wanted = rows(6)
    wanted[1, 2, 1] = 9.0
    np.testing.assert_array_equal(one.buffer[:, :6], halves(wanted))
    assert [path.read_bytes() for path in paths] == [lane.tobytes() for lane in wanted]


@pytest.mark.parametrize("torn", [0, 1, 5 * WIDTH * 4, 5 * WIDTH * 4 + 7])
def test_rows_beyond_the_checkpoint_are_cut_off(paths, torn):
    one = replay(paths)
    one.append(rows(6))
    one.flush()
    for path in paths:
        with open(path, "ab") as file:
            file.write(b"\x7f" * torn)  # what a killed run wrote after its last checkpoint
    for count in (6, 4, 0):  # the newest checkpoint, the one before, none
        again = replay(paths)
        again.append(rows(2, 8))  # what it has of its own is forgotten
        again.restore(count)
        assert again.count == count
        again.append(rows(1, 9))
        np.testing.assert_array_equal(again.buffer[:, : count + 1], halves(np.concatenate([rows(6)[:, :count], rows(1, 9)], 1)))
        again.flush()
        for path, lane, last in zip(paths, rows(6), rows(1, 9)):
            assert path.read_bytes() == np.concatenate([lane[:count], last]).tobytes()


def test_files_that_hold_too_little_are_refused(paths):
    one = replay(paths)
    one.append(rows(6))
    one.flush()
    with open(paths[1], "r+b") as file:
        file.truncate(5 * WIDTH * 4 + 1)
    with pytest.raises(UserError, match=r"seed1.bin holds 5 rows, the checkpoint counts 6$"):
        replay(paths).restore(6)
    paths[0].unlink()
    with pytest.raises(UserError, match=r"cannot read .*seed0.bin: No such file or directory$"):
        replay(paths).restore(6)
    replay(paths).restore(0)  # where nothing counts, nothing is missed


def test_a_full_disk_is_one_line_and_can_be_got_over(paths):
    one = replay(paths)
    one.append(rows(5))
    one.flush()
    one.append(rows(9, 1))
    with files_up_to(9 * WIDTH * 4), pytest.raises(UserError, match=r"cannot write .*seed0.bin: File too large$"):
        one.flush()
    again = replay(paths)
    again.restore(5)  # what the checkpoint counts is whole
    np.testing.assert_array_equal(again.buffer[:, :5], halves(rows(5)))
    one.flush()  # there is room again
    for path, first, more in zip(paths, rows(5), rows(9, 1)):
        assert path.read_bytes() == np.concatenate([first, more]).tobytes()


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    (tmp_path / "replay").write_text("a file")
    one = replay([tmp_path / "replay" / f"seed{i}.bin" for i in range(LANES)])
    one.append(rows(1))
    with pytest.raises(UserError, match=r"cannot write .*seed0.bin: "):
        one.flush()
