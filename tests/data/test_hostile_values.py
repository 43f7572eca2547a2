"""Logs, schemas and headers from elsewhere with values that no log has: each is refused in one line."""

import copy
import json

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.folder import read_folder, write_folder
from deadreckon.data.formats.io import read
from deadreckon.data.schema import Schema
from deadreckon.errors import UserError

SCHEMA = {
    "columns": {
        "episode": {"role": "episode", "kind": "category"}, "x": {"role": "observation"},
        "action": {"role": "action", "kind": "category"}, "reward": {"role": "reward"},
        "legal": {"role": "legal", "kind": "category"},
    }
}  # fmt: skip


def table(path, cell: str = "u|v"):
    quoted = '"' + cell.replace('"', '""') + '"'
    rows = [f"{row // 4},{row},{'uv'[row % 2]},{row * 0.5},{quoted if row == 3 else 'u|v'}" for row in range(12)]
    path.write_text("\n".join(["episode,x,action,reward,legal", *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ("[" * 100_000, "column legal has lists in lists without end; a list of actions is needed"),
        ('[{"a": 1}, [1]]', "column legal has lists in a list in row 3; a list of actions is needed"),
        (f"[{'1' * 5_000}]", "row 3"),
    ],
)
def test_cells_that_list_no_actions_are_refused(cell, words, tmp_path):
    assert len(read(table(tmp_path / "log.csv"), schema=Schema.from_json(SCHEMA))) == 12
    with pytest.raises(UserError, match=f"log.*{words}"):
        read(table(tmp_path / "log.csv", cell), schema=Schema.from_json(SCHEMA))


@pytest.mark.parametrize("encoding", ["a\0b", "undefined", "rot13", "no such"])
def test_encodings_that_there_are_not_are_refused(encoding, tmp_path):
    schema = Schema.from_json(SCHEMA | {"table": {"encoding": encoding}})
    with pytest.raises(UserError, match="--encoding .*: unknown"):
        read(table(tmp_path / "log.csv"), schema=schema)


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ({"fill": 10**400}, "column x: fill must be a finite number, got 1000"),
        ({"low": float("inf")}, "column x: low must be a finite number, got inf"),
        ({"high": True}, "column x: high must be a finite number, got True"),
        ({"kind": "category", "levels": [10**400]}, "column x: levels are texts, numbers or truth values, got 1000"),
        (
            {"kind": "category", "levels": [float("nan"), 1]},
            "column x: levels are texts, numbers or truth values, got nan",
        ),
    ],
)
def test_numbers_of_a_schema_that_no_column_holds_are_refused(column, words):
    with pytest.raises(UserError, match=words):
        Schema.from_json({"columns": {"x": {"role": "observation"} | column}})


EXTRA = [
    ({"env_spec": "x", "observation_bounds": 5}, "extra.observation_bounds must be a list of 2 or null, got 5"),
    ({"env_spec": "{}", "observation_bounds": [["a"], ["b"]]}, r"extra.observation_bounds\[0\]\[0\] must be a number or null"),
    ({"action_levels": [[[1]], {}]}, r"extra.action_levels\[0\]\[0\] must be"),
    ({"action_levels": 5}, "extra.action_levels must be a list"),
    ({"observation_names": 5}, "extra.observation_names must be a list of texts or null, got 5"),
    ({"schema": 5}, "extra.schema must be an object or null, got 5"),
    ({"schema": {"columns": {"a": 5}}}, r"extra.schema.columns\['a'\] must be an object, got 5"),
    ({"held": {"a": [1]}}, r"extra.held\['a'\] must be an object"),
    ({"horizon": "x"}, "extra.horizon must be a whole number or null, got 'x'"),
]


@pytest.fixture
def folder(tmp_path):
    log = Dataset.from_arrays(
        observations=np.zeros((4, 1)), actions=np.array([0, 1, 0, 1]), rewards=np.zeros(4), timeouts=np.arange(4) == 3
    )
    write_folder(log, tmp_path / "log")
    return tmp_path / "log", json.loads((tmp_path / "log" / "log.json").read_text())


@pytest.mark.parametrize(("extra", "words"), EXTRA)
def test_what_a_header_says_beside_is_checked(extra, words, folder):
    path, header = folder
    assert len(read_folder(path)) == 4
    changed = copy.deepcopy(header)
    changed["provenance"]["extra"] |= extra
    (path / "log.json").write_text(json.dumps(changed))
    with pytest.raises(UserError, match=f"log.json: .*{words}"):
        read_folder(path)


def test_more_actions_than_memory_holds_are_refused(folder):
    path, header = folder
    (path / "log.json").write_text(json.dumps(header | {"action_space": {"kind": "Discrete", "n": 2**40}}))
    with pytest.raises(UserError, match="log.json: .*action_space.n must be a whole number up to 1,000,000, got 1099511627776"):
        read_folder(path)


def test_a_name_that_no_file_has_is_no_column(folder):
    path, header = folder
    (path / "log.json").write_text(json.dumps(header | {"columns": ["a" * 300]}))
    with pytest.raises(UserError, match="column file a*.npy is missing"):
        read_folder(path)
