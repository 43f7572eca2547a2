import json

import pytest
from small_logs import make_log

from deadreckon.data.catalogue import cached_path, entry, load
from deadreckon.data.entries import ENTRIES
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.formats.io import read
from deadreckon.data.spec import Box
from deadreckon.errors import UserError


def test_the_entries():
    assert sum(e.domain == "maze2d" for e in ENTRIES.values()) == 12  # three sizes, sparse and dense, and the evaluation mazes
    found = entry("maze2d-umaze-v1")
    assert (found.task, found.rows, found.recipe) == ("maze2d-umaze", 1_000_000, "maze2d-umaze-v1")
    assert found.original == "maze2d/maze2d-umaze-sparse-v1.hdf5"
    assert found.minari == "D4RL/pointmaze/umaze-v2"
    assert found.collected == "maze2d-umaze-v1@dr1"
    assert entry("maze2d-large-dense-v1@dr1").minari == "D4RL/pointmaze/large-dense-v2"
    assert entry("maze2d-large-dense-v1").task == "maze2d-large-dense"
    assert entry("maze2d-medium-v1").rows == 2_000_000


def test_the_gym_entries():
    robots = ("hopper", "halfcheetah", "walker2d", "ant")
    policies = ("random", "medium", "expert", "medium-replay", "medium-expert")
    for name in [f"{robot}-{policy}-v2" for robot in robots for policy in policies]:
        found = entry(name)
        assert (found.domain, found.task, found.recipe) == ("gym", name.split("-")[0], name)
        assert found.sources == (("d4rl", "minari") if name.split("-")[1:-1] in (["medium"], ["expert"]) else ("d4rl",))
        assert found.sha256 is None
    assert entry("walker2d-expert-v2").minari == "mujoco/walker2d/expert-v0"
    assert entry("ant-medium-replay-v2").original == "gym_mujoco_v2/ant_medium_replay-v2.hdf5"
    rows = {policy: entry(f"hopper-{policy}-v2").rows for policy in policies}
    assert list(rows.values()) == [1_000_000, 1_000_000, 1_000_000, 200_920, 2_000_000]


def test_the_originals_are_those_of_d4rl(real_data):
    files = json.loads((real_data / "d4rl" / "d4rl_dataset_files.json").read_text())
    originals = {name: found.original for name, found in ENTRIES.items() if found.original is not None}
    assert originals == {name: files[name] for name in originals}


def test_wrong_names_are_told_the_nearest():
    with pytest.raises(UserError, match="did you mean maze2d-umaze-v1"):
        load("maze2d-umaze-v2")
    with pytest.raises(UserError, match=r"^no file qqq, and no data set of that name \(`deadreckon data list` lists them\)$"):
        load("qqq")
    with pytest.raises(UserError, match=r"unknown version 'dr9' of maze2d-umaze-v1: .* maze2d-umaze-v1@dr1"):
        load("maze2d-umaze-v1@dr9")
    known = r"known are hopper-random-v2@dr1 \(collected\), hopper-random-v2@d4rl \(downloaded\)$"
    with pytest.raises(UserError, match=f"unknown version 'minari' of hopper-random-v2: {known}"):
        load("hopper-random-v2@minari")


@pytest.mark.parametrize(("version", "how"), [
    ("", "collect hopper-medium-v2` makes it here, or `deadreckon data get hopper-medium-v2 --source d4rl` downloads"),
    ("@dr1", "collect hopper-medium-v2` makes it here$"),
    ("@d4rl", "get hopper-medium-v2 --source d4rl` downloads the original, or .* makes hopper-medium-v2@dr1 here$"),
    ("@minari", "get hopper-medium-v2 --source minari` downloads a twin, or .* makes hopper-medium-v2@dr1 here$"),
])  # fmt: skip
def test_how_a_log_can_be_had(version, how):
    with pytest.raises(UserError, match=f"^hopper-medium-v2{version} is not in the cache yet: `deadreckon data {how}"):
        load(f"hopper-medium-v2{version}")


def test_a_log_of_another_length_is_named(home):
    (home / "data").mkdir(parents=True)
    (home / "data" / "hopper-medium-v2@dr1-5000-steps.hdf5").touch()
    for name in ("hopper-medium-v2", "hopper-medium-v2@dr1"):
        with pytest.raises(UserError, match="; in the cache under other names: hopper-medium-v2@dr1-5000-steps$"):
            load(name)


def test_the_cache(home):
    path = cached_path("maze2d-umaze-v1")
    assert path == home / "data" / "maze2d-umaze-v1@dr1.hdf5" == cached_path("maze2d-umaze-v1@dr1")
    with pytest.raises(UserError, match="`deadreckon data collect maze2d-umaze-v1` makes it here") as caught:
        load("maze2d-umaze-v1")
    assert "\n" not in str(caught.value)
    log = make_log(name="maze2d-umaze-v1@dr1")
    write_hdf5(log, path)
    for name in ("maze2d-umaze-v1", "maze2d-umaze-v1@dr1"):
        assert load(name).fingerprint == load(name, mmap=True).fingerprint == log.fingerprint
        assert load(name).name == "maze2d-umaze-v1@dr1"


def test_a_file_is_loaded_by_its_path(tmp_path, log):
    write_hdf5(log, tmp_path / "mine.hdf5")
    assert load(str(tmp_path / "mine.hdf5")).fingerprint == log.fingerprint
    with pytest.raises(UserError, match="no file"):
        load(tmp_path / "yours.hdf5")


@pytest.mark.parametrize(
    "name", ["../x", "/etc/passwd", "maze2d/../../x", "maze2d/x", "..", ".", "", "~/x", "a\\..\\b", "a\0b", "x/"]
)
def test_names_that_lead_out_of_the_cache_are_refused(name):
    with pytest.raises(UserError, match="not the name of a log"):
        cached_path(name)


def test_strict_is_asked_of_what_is_loaded(tmp_path, home):
    log = make_log(name="maze2d-umaze-v1@dr1").with_action_space(Box((-0.1, -0.1), (0.1, 0.1)))
    for path in (tmp_path / "mine.hdf5", cached_path("maze2d-umaze-v1")):
        write_hdf5(log, path)
    for name in (tmp_path / "mine.hdf5", "maze2d-umaze-v1"):
        assert "out of bounds" in load(name).warnings[0]
        with pytest.raises(UserError, match="have actions out of bounds, first row"):
            load(name, strict=True)
    with pytest.raises(UserError, match="action names a column of a table"):
        load("maze2d-umaze-v1", action="a")


def test_a_minari_id_is_the_twin_of_that_id(home, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    known = "mujoco/hopper/medium-v0"
    assert entry(known) == entry("hopper-medium-v2")
    with pytest.raises(UserError, match="^hopper-medium-v2@minari is not in the cache yet: `.* get hopper-medium-v2 --source"):
        load(known)
    log = make_log(name="hopper-medium-v2@minari")
    write_hdf5(log, cached_path("hopper-medium-v2@minari"))
    write_hdf5(make_log(name="hopper-medium-v2@dr1", seed=1), cached_path("hopper-medium-v2"))
    assert load(known).fingerprint == log.fingerprint != load("hopper-medium-v2").fingerprint
    with pytest.raises(UserError, match="unknown Minari data set 'mujoco/hopper/mediun-v0': did you mean mujoco/hopper/medi"):
        load("mujoco/hopper/mediun-v0")
    for take in (load, read):
        with pytest.raises(UserError, match="no Minari data set of this id in .*; `minari download mine/own/task-v3` fetches"):
            take("mine/own/task-v3")


def test_where_a_minari_id_is_downloaded_from(monkeypatch):
    from deadreckon.data import download

    asked = []

    def known(name, source):
        asked.append((name, source))
        raise UserError("enough")

    monkeypatch.setattr(download, "_known", known)
    for name in ("mujoco/hopper/medium-v0", "hopper-medium-v2", "hopper-medium-v2@minari"):
        with pytest.raises(UserError, match="enough"):
            download.get(name)
    assert [source for _, source in asked] == ["minari", "d4rl", "minari"]
    assert asked[0][0] == "hopper-medium-v2@minari"
