import re

import numpy as np
import pytest
from small_logs import images, make_log

import deadreckon as dr
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import convert
from deadreckon.data.info import warnings_for
from deadreckon.data.spec import Box
from deadreckon.data.told import action_names, columns_of, observation_names, text_of_columns

TABLE = """day,minute,site,temp,dose,level,note,act,reward
1,0,a,1.5,3,x,,low,1
1,1,b,,4,y,,high,2
1,2,a,2.5,3,,,low,0
2,0,b,3.5,9,x,,mid,1
2,1,b,,4,y,,high,3
2,2,a,4.5,3,x,,low,2
"""


@pytest.fixture
def table(tmp_path):
    (tmp_path / "t.csv").write_text(TABLE)
    return dr.read(tmp_path / "t.csv", action="act", reward="reward", episode="day", time="minute")


def test_every_column_with_what_becomes_of_it(table):
    found = {each.name: each for each in columns_of(table)}
    assert set(found) == set(TABLE.split("\n")[0].split(","))
    assert {name: each.missing for name, each in found.items() if each.missing} == {"temp": 2, "level": 1, "note": 6}
    assert (found["site"].holds, found["site"].becomes) == ("a, b", "observation 0-1 (one 0/1 number per level)")
    assert found["temp"].holds == "1.5 .. 4.5"
    assert found["temp"].dimensions == (2, 3)
    assert found["temp"].becomes == "observation 2-3 (missing cells: 3, marked by 1 in the last)"
    assert found["act"].becomes == "actions 0, 1, 2 = high, low, mid"
    assert found["note"].becomes.startswith("left out: empty")
    assert found["day"].becomes == "identifies episodes"
    for name in ("site", "temp", "dose", "level"):
        assert all(observation_names(table)[i].startswith(name) for i in found[name].dimensions)


@pytest.mark.parametrize("ending", ["hdf5", "parquet", "npz"])
def test_the_counts_come_back_from_a_file(table, tmp_path, ending):
    how = {"action": "act", "reward": "reward", "episode": "day", "time": "minute"}
    convert(tmp_path / "t.csv", tmp_path / f"log.{ending}", **how)
    assert columns_of(dr.read(tmp_path / f"log.{ending}")) == columns_of(table)


def test_a_column_that_the_schema_does_not_have(tmp_path):
    frame = {"a": [0, 1, 0], "r": [1.0, 2, 3], "x": [1.0, 2, 3], "late": [1.0, None, 3]}
    schema = {"columns": {"a": {"role": "action", "kind": "integer"}, "r": {"role": "reward"}, "x": {"role": "observation"}}}
    last = columns_of(Dataset.from_frame(frame, schema=schema))[-1]
    assert (last.name, last.missing, last.becomes) == ("late", 1, "left out: not in the schema")


def test_logs_without_columns(variant):
    text = text_of_columns(columns_of(variant))
    assert "observation 2" in text
    assert "missing" not in text
    assert "rewards" in text


def test_images_and_hundreds_of_dimensions_are_cut():
    assert len(columns_of(images())) < 10
    wide = Dataset.from_arrays(observations=np.zeros((3, 500)), actions=np.array([0, 1, 0]), rewards=np.zeros(3))
    lines = text_of_columns(columns_of(wide)).split("\n")
    assert len(lines) == 41
    assert any("463 more" in line for line in lines)


def test_warnings_name_columns():
    rng = np.random.default_rng(0)
    frame = {"still": np.ones(40), "small": rng.normal(size=40) * 1e-3, "large": rng.normal(size=40) * 1e3,
             "push": rng.uniform(-2, 2, 40), "pull": rng.uniform(-1, 1, 40), "r": rng.normal(size=40)}  # fmt: skip
    columns = {name: {"role": "observation"} for name in ("still", "small", "large")}
    columns |= {name: {"role": "action", "kind": "number", "low": -1, "high": 1} for name in ("push", "pull")}
    log = Dataset.from_frame(frame, schema={"columns": {**columns, "r": {"role": "reward"}}})
    told = "\n".join(warnings_for(log))
    assert "never change: still;" in told
    assert re.search(r"(small|large) is \S+ in size \(root mean square\), and 1 more is far from 1", told)
    beyond = int((np.abs(frame["push"]) > 1).sum())
    assert f"(push {beyond})" in told
    assert action_names(log) == ["push", "pull"]


def test_unused_actions_are_named():
    told = "\n".join(warnings_for(make_log(discrete=True)))
    assert "1 of 4 actions never occurs in the log (3)" in told
    assert isinstance(make_log().action_space, Box)


def test_a_column_that_is_called_as_a_mark_is_itself():
    table = {"x": [0.0, 1.0, 2.0, 3.0], "x_missing": [0, 1, 0, 1], "action": [0, 1, 1, 0], "reward": [1.0, 0.0, 1.0, 0.0]}
    found = {column.name: column.dimensions for column in columns_of(Dataset.from_frame(table))}
    assert (found["x"], found["x_missing"]) == ((0,), (1,))
