"""D4RL's pictures of CARLA's cameras, which its files keep as rows of 6,912 numbers, are pictures again."""

import dataclasses

import h5py
import numpy as np
import pytest

import deadreckon as dr
from deadreckon.bench.published import reference
from deadreckon.cli.main import main
from deadreckon.data.catalogue import cached_path, entry, load
from deadreckon.data.download import get
from deadreckon.data.environments import environment_of
from deadreckon.data.formats.flat_pictures import CARLA_FILES, SHAPES, pictures
from deadreckon.data.formats.io import convert, read
from deadreckon.errors import UserError
from deadreckon.tasks import registry

ROWS = 12
DRAWN = np.random.default_rng(0).integers(0, 256, (ROWS, 48, 48, 3)).astype(np.uint8)


def d4rl_file(path, numbers, **more):
    path.parent.mkdir(parents=True, exist_ok=True)
    ends = np.arange(ROWS) % 6 == 5
    columns = {"observations": numbers, "actions": np.zeros((ROWS, 2), np.float32), "rewards": np.zeros(ROWS, np.float32),
               "terminals": np.zeros(ROWS, bool), "timeouts": ends}  # fmt: skip
    with h5py.File(path, "w") as file:
        for name, column in (columns | more).items():
            file.create_dataset(name, data=column)
    return path


def flat(dtype, scale=1.0):
    return (DRAWN.reshape(ROWS, -1) / scale).astype(dtype)


@pytest.mark.parametrize("numbers", [
    flat(np.float32, 255), flat(np.float64, 255), flat(np.float32), flat(np.uint8), flat(np.int32),
], ids=["0..1", "double", "0..255", "bytes", "integers"])  # fmt: skip
@pytest.mark.parametrize("name", ["carla_lane_follow_flat-v0", "carla-town-v0"])
def test_a_file_of_a_known_name_holds_pictures(tmp_path, name, numbers):
    log = dr.load(d4rl_file(tmp_path / f"{name}.hdf5", numbers))
    assert (log.spec.observation_shape, log.spec.observation_dtype) == ((48, 48, 3), "uint8")
    np.testing.assert_array_equal(log.observations, DRAWN)
    assert log.episodes == 2
    assert log.provenance.extra["observations"] == f"images, 48 x 48 x 3, of 6,912 numbers per row, as {name} has them"


def test_other_names_keep_their_columns(tmp_path):
    path = d4rl_file(tmp_path / "mine.hdf5", flat(np.float32, 255))
    assert dr.load(path).spec.observation_shape == (6912,)
    assert read(path, name="carla-lane-v0").spec.observation_shape == (48, 48, 3)
    path = d4rl_file(tmp_path / "carla-lane-v0.hdf5", flat(np.float32, 255)[:, :-1])
    assert dr.load(path).spec.observation_shape == (6911,)


def test_next_observations_are_pictures_too(tmp_path):
    numbers = flat(np.float32, 255)
    log = dr.load(d4rl_file(tmp_path / "carla-lane-v0.hdf5", numbers, next_observations=np.roll(numbers, -1, 0)))
    np.testing.assert_array_equal(log.final_observations, [DRAWN[6], DRAWN[0]])


@pytest.mark.parametrize(("value", "said"), [(np.nan, "nan"), (-0.5, "-0.5"), (np.inf, "inf"), (256.0, "256.0")])
def test_numbers_that_are_no_pictures_are_told(tmp_path, value, said):
    numbers = flat(np.float32, 255)
    numbers[7, 3] = value
    with pytest.raises(UserError, match=rf"lane-v0.hdf5: observations has {said} in row 7, and its images need numbers"):
        dr.load(d4rl_file(tmp_path / "carla-lane-v0.hdf5", numbers))


def test_blocks_and_an_empty_column(monkeypatch):
    monkeypatch.setattr("deadreckon.data.formats.flat_pictures._BLOCK", 5 * 6912 * 4)
    np.testing.assert_array_equal(pictures("f", "observations", flat(np.float32, 255), (48, 48, 3)), DRAWN)
    assert pictures("f", "observations", np.zeros((0, 6912)), (48, 48, 3)).shape == (0, 48, 48, 3)


def test_mapped_and_converted(tmp_path):
    path = d4rl_file(tmp_path / "carla-lane-v0.hdf5", flat(np.float32, 255))
    with pytest.raises(UserError, match="its images are rows of numbers, so it cannot be memory-mapped: `deadreckon"):
        read(path, mmap=True)
    convert(path, tmp_path / "out.hdf5")
    again = read(tmp_path / "out.hdf5", mmap=True)
    np.testing.assert_array_equal(again.observations, DRAWN)
    assert again.name == "carla-lane-v0"
    path = d4rl_file(tmp_path / "bytes" / "carla-lane-v0.hdf5", flat(np.uint8))
    mapped = read(path, mmap=True).observations
    assert isinstance(mapped.base, np.memmap) or isinstance(mapped, np.memmap)
    np.testing.assert_array_equal(mapped, DRAWN)


def test_info_tells_of_pictures(tmp_path, capsys):
    assert main(["data", "info", str(d4rl_file(tmp_path / "carla-lane-v0.hdf5", flat(np.float32, 255)))]) == 0
    assert "(48, 48, 3) uint8" in capsys.readouterr().out


def test_the_original_is_not_of_our_environment():
    log = dr.Dataset.from_arrays(
        observations=DRAWN, actions=np.zeros((ROWS, 2)), rewards=np.zeros(ROWS), name="carla-lane-v0@d4rl",
    )  # fmt: skip
    assert environment_of(log) is None
    assert environment_of(dataclasses.replace(log, name="carla-lane-v0@dr1")).spec.count("deadreckon/CarlaLane-v0")


def test_the_catalogue(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    found = entry("carla-lane-v0")
    assert (found.original, found.sources, found.rows) == ("carla/carla_lane_follow_flat-v0.hdf5", ("d4rl",), 100_000)
    assert {entry(name).original for name in CARLA_FILES} == {f"carla/{file}.hdf5" for file in CARLA_FILES.values()}
    assert set(CARLA_FILES) < set(SHAPES)
    assert registry.of_log("carla-lane-v0@d4rl") is None  # of another world than our task
    assert registry.of_log("carla-lane-v0@dr1") is registry.of_log("carla-lane-v0") is registry.task("carla-lane")
    assert reference("carla-lane-v0").expert == registry.task("carla:localhost:2000/lane").published.expert
    assert reference("carla-town-full").random == registry.task("carla:localhost:2000/town").published.random
    for name in ("carla-town-full-v0", "carla-town-full-v0@d4rl"):
        with pytest.raises(UserError, match="is not in the cache yet: `deadreckon data get carla-town-full-v0 --source d4rl`"):
            load(name)
    with pytest.raises(UserError, match=r"'dr1' of carla-town-full-v0: known are carla-town-full-v0@d4rl \(downloaded\)$"):
        load("carla-town-full-v0@dr1")
    with pytest.raises(UserError, match="carla-lane-v0 has no Minari twin: --source d4rl downloads its original at D4RL's, "):
        get("carla-lane-v0", "minari")
    monkeypatch.setenv("DEADRECKON_D4RL_URL", "http://localhost:9")
    d4rl_file(cached_path("carla-lane-v0@d4rl"), flat(np.float32, 255))
    assert load("carla-lane-v0").spec.observation_shape == (48, 48, 3)
    assert main(["data", "list"]) == 0
    listed = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("carla-town-full-v0"))
    assert listed.split() == ["carla-town-full-v0", "-", "a", "CARLA", "server", "-", "carla/carla_town_flat-v0.hdf5", "-"]
