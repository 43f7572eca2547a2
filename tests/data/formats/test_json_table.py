"""Tables in JSON."""

import datetime
import gzip
import json

import numpy as np
import pytest
from any_file import read_table

from deadreckon.cli.main import main
from deadreckon.data.formats.io import convert, read, sniff
from deadreckon.errors import UserError

ROWS = [
    {"day": "2024-01-02 10:00:00", "site": "a", "offer": "x", "clicks": 1, "spent": 1.5, "ok": True},
    {"day": "2024-01-03 00:00:00", "site": "b", "offer": "y", "clicks": 0, "spent": None, "ok": False},
]
FORMS = {
    "lines": lambda rows: "\n".join(map(json.dumps, rows)),
    "lines with blanks and a mark": lambda rows: "\ufeff\n" + "\n\n".join(map(json.dumps, rows)) + "\n\n",
    "list": json.dumps,
    "printed list": lambda rows: json.dumps(rows, indent=2),
}


def written(folder, rows, form="lines"):
    path = folder / "log.jsonl"
    path.write_text(FORMS[form](rows), encoding="utf-8")
    return path


@pytest.mark.parametrize("form", FORMS)
def test_objects_are_rows(tmp_path, form):
    path = written(tmp_path, ROWS, form)
    assert sniff(path) == "json"
    found, dialect, told = read_table(path)
    assert found.to_pydict() == {
        "day": [datetime.datetime(2024, 1, 2, 10), datetime.datetime(2024, 1, 3)], "site": ["a", "b"], "offer": ["x", "y"],
        "clicks": [1, 0], "spent": [1.5, None], "ok": [True, False],
    }  # fmt: skip
    assert (dialect, told) == (None, [])
    roles = {"time": "day", "action": "offer", "reward": "clicks", "ignore": ["spent", "ok"]}
    log = read(path, **roles)
    assert (log.name, log.provenance.source) == ("log", "json")
    assert convert(path, tmp_path / "again.parquet", **roles).fingerprint == log.fingerprint
    packed = tmp_path / "log.jsonl.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert read(packed, **roles).fingerprint == log.fingerprint


def test_a_log_is_that_of_the_same_table_in_csv(tmp_path):
    rng = np.random.default_rng(0)
    rows = [
        {"user": f"u{i // 3}", "step": i % 3, "x": round(float(rng.normal()), 4), "offer": "pq"[rng.integers(2)], "r": i / 8}
        for i in range(60)
    ]
    text = ",".join(rows[0]) + "\n" + "\n".join(",".join(map(str, row.values())) for row in rows)
    (tmp_path / "log.csv").write_text(text)
    roles = {"episode": "user", "time": "step", "action": "offer", "reward": "r"}
    mine, other = read(written(tmp_path, rows), **roles), read(tmp_path / "log.csv", **roles)
    assert mine.fingerprint == other.fingerprint


def test_objects_and_lists_within_objects_become_columns(tmp_path):
    rows = [{"a": {"b": {"c": 1}, "d": [1, 2.5]}, "tags": ["x"]}, {"a": {"b": {"c": 2}, "d": None}, "tags": []}, {"late": "z"}]
    found, _, told = read_table(written(tmp_path, rows))
    assert found.to_pydict() == {
        "a.b.c": [1, 2, None], "a.d[0]": [1, None, None], "a.d[1]": [2.5, None, None], "tags": ['["x"]', "[]", None],
        "late": [None, None, "z"],
    }  # fmt: skip
    assert told == ["column tags holds lists, not all of the same length and flat, and is read as texts"]


def test_numbers_that_json_or_64_bits_do_not_have(tmp_path):
    path = tmp_path / "log.jsonl"
    rows = ('{"id": 9223372036854775807, "key": 18446744073709551615, "x": NaN}', '{"id": -1, "key": 1, "x": Infinity}')
    path.write_text("\n".join(rows))
    found = read_table(path)[0]
    assert found["id"].to_pylist() == [2**63 - 1, -1]
    assert found["key"].to_pylist() == [2.0**64, 1.0]
    assert found["x"].to_pylist() == [None, np.inf]
    with pytest.raises(UserError, match="column key identifies episodes, .* rounded"):
        read(written(tmp_path, [{"key": 2**64 + i, "x": i / 3, "a": i % 2, "r": i / 2} for i in range(20)]), episode="key",
             action="a", reward="r")  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"x": 1}\n{"x": 2', "line 2 is no JSON .*; an object per line, or one list of objects, is needed"),
        ('{"x": 1}\n\n3\n', "line 3 is no object; an object per line"),
        ('[{"x": 1}, [2]]', "row 2 is no object; an object per line"),
        ('[{"x": 1}] {"x": 2}', "the list from line 1 on is no JSON"),
        ('{"x": 1, "x": 2}\n', "line 1 is no JSON .two values of an object are called 'x'"),
        ('{"x": {"y": 1}, "x.y": 2}\n', "line 1 has two values called 'x.y'; rename one"),
        ('{"x": 1, " ": 2}\n', "line 1 has a value without a name"),
        ('{"data": [{"x": 1}, {"x": 2}]}\n', "its object holds a list of objects, 'data'; write a file with that list alone"),
        ('{"data": [{"x": "' + "a" * 5000 + '"}]}\n', "its object holds a list of objects, 'data'"),
        ('{"x": [1], "x[0]": 2}\n', r"two columns are called 'x\[0\]'; rename one"),
        ('{"x[0]": 2, "x": [1]}\n', r"two columns are called 'x\[0\]'; rename one"),
        ('{"x": "\\ud800"}\n', "cannot be read as JSON"),
        ('{"x": ' + '{"y": ' * 2000 + "1" + "}" * 2001 + "\n", "is no JSON|cannot be read as JSON"),
        ("\n".join('{"x": %s}' % (i if i else '"a"') for i in range(40)), "column x: line 1 holds 'a', and most cells hold"),
    ],
)
def test_errors_name_the_line(tmp_path, text, words):
    path = tmp_path / "log.jsonl"
    path.write_text(text)
    with pytest.raises(UserError, match=words) as caught:
        read_table(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_few_keys_cannot_make_a_table_that_fills_the_memory(tmp_path, monkeypatch):
    """A column per row has as many cells as the square of the rows."""
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "1e6")
    assert read_table(written(tmp_path, [{f"k{i}": 1} for i in range(300)]))[0].shape == (300, 300)
    with pytest.raises(UserError, match="unpacks to .* more than the 0.001 GB"):
        read_table(written(tmp_path, [{f"k{i}": 1} for i in range(500)]))


def test_batches_of_rllib_are_no_rows(tmp_path):
    path = tmp_path / "log.json"
    for text, kind in (
        ('{"type": "SampleBatch", "count": 3', "rllib"), ('{"obs": [[1.0]], "actions": [0]}', "rllib"),
        ('{"obs": [[' + "1.0, " * 2000, "rllib"), ('{"obs": [1.0, 2.0], "action": 0}', "json"),
        ('{"x": 1.0, "obs": [' + "1.0, " * 2000, "json"), ('{"type": "visit", "x": 1}', "json"), ("[\n {\n", "json"),
    ):  # fmt: skip
        path.write_text(text + ('"x": 1}]' if text.startswith("[") else "\n"))
        assert sniff(path) == kind


def test_the_command_line_reads_json(tmp_path, capsys):
    path = written(tmp_path, ROWS * 20)
    assert main(["data", "info", str(path), "--action", "offer", "--reward", "clicks", "--ignore", "day", "spent", "ok"]) == 0
    assert "log (json, fingerprint" in capsys.readouterr().out
    assert main(["data", "info", str(path), "--action", "offer", "--reward", "clicks", "--decimal", ","]) == 2
    assert "--decimal is for CSV, but this is JSON" in capsys.readouterr().err
