"""Numbers of episodes: from content, unique, the same in parts and files, other where anything differs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from small_logs import images, logs, make_log, quick, variants

from deadreckon.data import episodes
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.folder import write_folder
from deadreckon.data.formats.io import _writer, read
from deadreckon.data.spec import Box


def test_the_numbers_never_change():
    log = Dataset.from_arrays(
        observations=np.arange(6).reshape(3, 2), actions=[0, 1, 1], rewards=[0.5, -1.0, 0.0], terminals=[0, 1, 0],
        final_observations=[[9, 9], [7, 8]],
    )  # fmt: skip
    # Run folders and policy files hold such numbers: if this fails, older ones are no longer understood.
    assert log.episode_ids.tolist() == [3119341625388590357, 10209973075875185602]
    assert log.episode_ids.dtype == np.uint64


@quick
@given(logs())
def test_they_are_unique_and_stay_with_their_episodes(log):
    ids = log.episode_ids
    assert len(set(ids.tolist())) == log.episodes
    order = np.random.default_rng(0).permutation(log.episodes)
    np.testing.assert_array_equal(log.select(order).episode_ids, ids[order])
    # An episode's number does not depend on what is around it.
    for i in range(log.episodes):
        alone = replace(log.select([i]), part_of=None)
        assert alone.episode_ids.tolist() == [ids[i]]


def test_successors_of_their_own_count_where_they_say_something_new():
    plain, log = make_log(), variants()["own successors"]
    assert log.successors is not None
    for i in range(log.episodes):
        assert replace(log.select([i]), part_of=None).episode_ids.tolist() == [log.episode_ids[i]]
    changed = log.successors.copy()
    changed[4] += 1  # inside the second episode
    assert np.flatnonzero(replace(log, successors=changed).episode_ids != log.episode_ids).tolist() == [1]
    following = replace(plain, successors=plain.next_observations)
    np.testing.assert_array_equal(following.episode_ids, plain.episode_ids)


@pytest.mark.parametrize("ending", [".hdf5", ".npz", ".parquet", "folder/", ".csv"])
def test_files_bring_them_back(variant, tmp_path, ending):
    path = str(tmp_path / f"log{ending}")
    _writer(path)(variant, path, False)
    np.testing.assert_array_equal(read(path).episode_ids, variant.episode_ids)
    part = variant.select([2, 3])
    _writer(path)(part, path, True)
    np.testing.assert_array_equal(read(path).episode_ids, part.episode_ids)


def test_memory_maps_bounds_and_parts_of_parts(tmp_path):
    log = make_log((2, 3, 4, 5)).select([1, 1, 2, 3])  # a part has other numbers than its content alone would give it
    log = replace(log, part_of=None)
    write_folder(log, tmp_path / "folder")
    mapped = read(tmp_path / "folder", mmap=True)
    part = mapped.select([1, 2])
    assert isinstance(part.observations, np.memmap)  # neighbours are not copied
    assert not isinstance(mapped.select([0, 2]).observations, np.memmap)
    for other in (part.loaded(), part.with_action_space(Box((-9, -9), (9, 9))), part.loaded().loaded()):
        np.testing.assert_array_equal(other.episode_ids, log.episode_ids[1:3])
    np.testing.assert_array_equal(part.select([1]).episode_ids, log.episode_ids[2:3])


@quick
@given(logs())
def test_blocks_of_rows_change_nothing(log):
    returns, ids = log.returns_to_go(0.9)[log.starts], log.episode_ids
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(episodes, "BLOCK", 3)
        patched.setattr(episodes, "_TOGETHER", 3)
        np.testing.assert_array_equal(replace(log).returns(0.9), returns)
        np.testing.assert_array_equal(replace(log, part_of=None).episode_ids, ids)


def test_large_folders_are_memory_mapped(tmp_path, monkeypatch):
    write_folder(make_log(), tmp_path / "folder")
    assert not isinstance(read(tmp_path / "folder").observations, np.memmap)
    monkeypatch.setattr("deadreckon.data.formats.io.LARGE", 100)
    assert isinstance(read(tmp_path / "folder").observations, np.memmap)
    assert not isinstance(read(tmp_path / "folder", mmap=False).observations, np.memmap)


def test_episodes_that_are_alike_are_counted():
    log = Dataset.from_arrays(
        observations=np.zeros((6, 2)), actions=np.array([0, 0, 1, 0, 1, 0]), rewards=np.zeros(6), terminals=np.ones(6)
    )
    assert len(set(log.episode_ids.tolist())) == 6
    # The second of a kind has the same number wherever the others stand.
    swapped = replace(log.select([2, 0, 1, 4, 3, 5]), part_of=None)
    np.testing.assert_array_equal(swapped.episode_ids, log.episode_ids[[2, 0, 1, 4, 3, 5]])
    # A part keeps them even though the ones before are gone.
    assert log.select([3]).episode_ids[0] == log.episode_ids[3] != log.episode_ids[0]


def _changed(log, name, row, value):
    column = getattr(log, name).copy()
    column[row] = value
    return replace(log, **{name: column})


@pytest.mark.parametrize(
    ("name", "row", "value", "episode"),
    [
        ("observations", (4, 1), 7.0, 1), ("actions", (4, 0), 0.5, 1), ("rewards", 8, 1.0, 2), ("terminals", 2, False, 0),
        ("timeouts", 12, False, 3), ("final_observations", (1, 0), 5.0, 1), ("final_known", 3, False, 3),
    ],
)  # fmt: skip
def test_whatever_differs_makes_another_number(name, row, value, episode):
    log = make_log(finals=True)
    changed = _changed(log, name, row, value)
    if name in ("terminals", "timeouts"):  # keep the episode's end, so that the others are the same rows
        other = "timeouts" if name == "terminals" else "terminals"
        changed = _changed(changed, other, row, True)
    differs = changed.episode_ids != log.episode_ids
    assert np.flatnonzero(differs).tolist() == [episode]


def test_order_of_steps_and_places_of_values_count_and_two_signs_at_once():
    rng = np.random.default_rng(0)
    seen = rng.normal(size=(4, 4)).astype(np.float32)
    make = lambda x: Dataset.from_arrays(  # noqa: E731
        observations=x, actions=np.zeros(4, int), rewards=np.zeros(4), terminals=np.arange(4) == 3
    ).episode_ids[0]
    signs = seen.copy()
    signs[0, [1, 3]] *= -1
    several = [seen, seen[::-1], seen[:, ::-1], signs, seen[[1, 0, 2, 3]]]
    assert len({int(make(x)) for x in several}) == len(several)
    assert make(np.zeros((4, 4))) == make(-np.zeros((4, 4)))


def test_extra_columns_do_not_count():
    plain, extra = make_log(), make_log(user=np.arange(13), behavior_log_probs=-np.ones(13))
    np.testing.assert_array_equal(plain.episode_ids, extra.episode_ids)


def test_every_kind_of_log_has_them():
    for log in (*variants().values(), images()):
        assert len(np.unique(log.episode_ids)) == log.episodes
