"""Run folders whose JSON, tables and arrays have other shapes than a run's: a report refuses each in one line."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from run_folders import write_run

from deadreckon.errors import UserError
from deadreckon.report.entries import read
from deadreckon.report.page import render
from deadreckon.runs.folder import Folder
from deadreckon.runs.records import checked_rows, read_run

HELD = {"share": 0.2, "by": "random", "seed": 0, "held": 2, "learning": 8}
BEHAVIOR = {"mean": 1.0, "low": 0.0, "high": 2.0}
DATA = {"name": "l", "fingerprint": "x"}
LOG = {**DATA, "rows": 1, "share": 0.5, "path": None, "task": None, "holdout": None}


def data(**changes) -> dict:
    return {"data": DATA | changes}


def extra(**entries) -> dict:
    return data(provenance={"extra": entries})


def without(given: dict, key: str) -> dict:
    return {name: value for name, value in given.items() if name != key}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (data(holdout={}), "data.holdout lacks share"),
        (data(holdout=HELD | {"share": "a"}), "data.holdout.share must be a number, got 'a'"),
        (data(holdout=without(HELD, "by")), "data.holdout lacks by"),
        (data(holdout=HELD | {"held": "2"}), "data.holdout.held must be a whole number"),
        (data(holdout=HELD | {"fold": 1}), "data.holdout lacks folds"),
        (data(holdout=HELD | {"fold": 7, "folds": 5}), "data.holdout.fold must be a whole number from 0 to 4, got 7"),
        ({"data": {"name": "l", "behavior": BEHAVIOR}}, "data lacks fingerprint"),
        (extra(horizon="x"), "data.provenance.extra.horizon must be a whole number or null, got 'x'"),
        (extra(horizon=[1]), "data.provenance.extra.horizon must be a whole number or null, got a list of 1"),
        (extra(schema=5), "data.provenance.extra.schema must be an object or null, got 5"),
        (extra(schema={"columns": {"x": {}}}), r"data.provenance.extra.schema.columns\['x'\] lacks role"),
        (extra(held={"x": [1]}), r"data.provenance.extra.held\['x'\] must be an object"),
        (extra(action_levels=[[[1]], {}]), r"data.provenance.extra.action_levels\[0\]\[0\] must be"),
        ({"encoder": "patches"}, "it lacks shift"),
        ({"encoder": [1], "shift": 4}, "encoder must be a text"),
        ({"encoder": "patches", "shift": "x"}, "shift must be a whole number, got 'x'"),
        ({"history": {"a": 1}}, "history must be a whole number"),
        ({"online": {}, "log": without(LOG, "path")}, "log lacks path"),
        ({"online": {}, "log": LOG | {"holdout": {"held": 1}}}, "log.holdout lacks share"),
    ],
)  # fmt: skip
def test_a_configuration_of_another_shape_is_refused(changes, words, tmp_path):
    config = Folder(write_run(tmp_path / "run")).config
    config.write_text(json.dumps(json.loads(config.read_text()) | changes))
    with pytest.raises(UserError, match=f"run.json: {words}"):
        read_run(config)


def test_what_may_be_missing_may_be_null(tmp_path):
    config = Folder(write_run(tmp_path / "run")).config
    config.write_text(json.dumps(json.loads(config.read_text()) | data(provenance=None, holdout=None, behavior=None)))
    assert "--data l --task" in render(read([tmp_path / "run"]))


ROWS = {"step": [5, 10], "seed": [0, 0], "episode": [0, 0], "length": [3, 3], "return": [1.0, 2.0]}


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (without(ROWS, "episode"), "evaluations need a column episode"),
        (ROWS | {"step": [5, None]}, "column step of evaluations must have a value in every row, got null"),
        (ROWS | {"step": [5.0, float("inf")]}, "column step of evaluations must hold whole numbers, got double"),
        (ROWS | {"episode": [0, None]}, "column episode of evaluations must have a value in every row"),
        (ROWS | {"length": [3.0, float("nan")]}, "column length of evaluations must hold whole numbers"),
        (ROWS | {"return": [True, None]}, "column return of evaluations must have a value in every row"),
    ],
)
def test_a_table_that_lacks_what_every_row_needs_is_refused(columns, words, tmp_path):
    path = write_run(tmp_path / "run", task=None)
    (path / "evaluations").joinpath("0000000200.parquet").unlink()
    parquet.write_table(pa.table(columns), path / "evaluations" / "0000000100.parquet")
    with pytest.raises(UserError, match=words):
        read([path])
    with pytest.raises(UserError, match=words):
        checked_rows(path / "evaluations", "evaluations", Folder(path).table("evaluations"))


def test_an_empty_table_lacks_nothing():
    assert not len(checked_rows("run", "evaluations", pa.table({})))


@pytest.mark.parametrize(
    "array", [np.array(["a"]), np.zeros(()), np.zeros(3), np.zeros((2, 3)), np.zeros((1, 1, 2, 1)), np.zeros(2, complex)]
)
@pytest.mark.parametrize("name", ["segments", "trajectories"])
def test_arrays_of_other_dimensions_are_refused(name, array, tmp_path):
    path = write_run(tmp_path / "run")
    place = Folder(path).log if name == "segments" else Folder(path).trajectories
    np.savez(place, **{name: array})
    with pytest.raises(UserError, match=rf"{Path(place).name}: {name} must "):
        render(read([path]))


def test_a_road_is_drawn_of_cars_alone(tmp_path):
    path = write_run(tmp_path / "run", task="flow-ring", behavior=None)
    np.savez(Folder(path).trajectories, trajectories=np.zeros((2, 1, 5, 4), np.float32))
    with pytest.raises(UserError, match=r"trajectories must be of shape \(seeds, episodes, steps, cars, numbers\)"):
        render(read([path]))
