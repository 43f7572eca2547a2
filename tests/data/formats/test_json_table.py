"""Tables in JSON."""

import datetime
import gzip
import json

import numpy as np
import pytest
from any_file import read_table

from deadreckon.cli.main import main
from deadreckon.data.describe import describe_table
from deadreckon.data.formats.any_table import read_rows
from deadreckon.data.formats.io import convert, read, sniff
from deadreckon.data.schema import Schema
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
    assert told == ["column tags holds lists, not all of numbers and of one length, and is read as texts"]
    assert read_table(written(tmp_path, [{"n": [1], "x": 0}, {"n": [1, 2], "x": 0}]))[0]["n"].to_pylist() == ["[1]", "[1, 2]"]


def logged(**columns):
    return [{"x": i / 7, "action": "ab"[i * i % 3 % 2], "reward": float(i % 5), **{k: f(i) for k, f in columns.items()}}
            for i in range(60)]  # fmt: skip


def test_texts_of_many_digits_stay_apart(tmp_path):
    """64-bit codes are texts in JSON, since some readers make floats of numbers; as floats these would all be one."""
    log = read(written(tmp_path, logged(user=lambda i: str(1234567890123456780 + i % 20))), group="user")
    assert len(np.unique(log.extras["user"])) == 20
    log = read(written(tmp_path, logged(action=lambda i: str(7000000000000000000 + i * i % 3))))
    assert log.spec.discrete
    with pytest.raises(UserError, match="column user identifies groups, and it was read as numbers up to 1.23457e.19, which"):
        read(written(tmp_path, logged(user=lambda i: str(12345678901234567800 + i % 20))), group="user")


def test_lists_of_legal_actions_stay_lists(tmp_path):
    """Whatever their lengths, so that a file of one row has the columns of the log."""
    names = ["x", "legal=a", "legal=b"]
    log = read(written(tmp_path, logged(legal=lambda i: ["a", "b"])))
    assert log.provenance.extra["observation_names"] == names
    log = read(written(tmp_path, logged(ok=lambda i: ["b", "a"] if i else ["a"])), legal="ok")
    assert log.provenance.extra["observation_names"] == names
    path, schema = written(tmp_path, logged(ok=lambda i: ["a"])[:1]), Schema.from_json(log.provenance.extra["schema"])
    assert read_rows(path, schema)[0]["ok"].to_pylist() == [["a"]]
    numbers = logged(action=lambda i: i % 2, ok=lambda i: [0, 1])
    assert read(written(tmp_path, numbers), legal="ok").provenance.extra["observation_names"] == ["x", "legal=0", "legal=1"]
    assert "ok[1]" in read(written(tmp_path, numbers)).provenance.extra["observation_names"]
    with pytest.raises(UserError, match="column action_mask holds list.*, numbers are needed"):  # and no observations
        read(written(tmp_path, logged(action_mask=lambda i: [1, 0])))


def test_a_schema_of_a_text_file_reads_json(tmp_path):
    lines = [f"{i / 7};{'ab'[i * i % 3 % 2]};{i % 5}" for i in range(60)]
    (tmp_path / "log.csv").write_text("x;action;reward\n" + "\n".join(lines))
    schema, _ = describe_table(tmp_path / "log.csv")
    assert schema.table["separator"] == ";"
    schema.save(tmp_path / "s.toml")
    log = read(written(tmp_path, logged()), schema=tmp_path / "s.toml")
    assert log.fingerprint == read(tmp_path / "s.toml").fingerprint


def test_json_in_utf_16(tmp_path):
    path = tmp_path / "log.jsonl"
    for encoding in ("utf-16", "utf-16-le", "utf-16-be"):
        path.write_text(("" if encoding == "utf-16" else "\ufeff") + FORMS["lines"](ROWS), encoding=encoding)
        assert read_table(path)[0]["site"].to_pylist() == ["a", "b"]


def test_missing_objects_have_missing_parts(tmp_path):
    assert read_table(written(tmp_path, [{"user": {"age": 3}}, {"user": None}]))[0].to_pydict() == {"user.age": [3, None]}
    found, _, told = read_table(written(tmp_path, [{"user": {"age": 3}}, {"user": 7}]))
    assert found.to_pydict() == {"user.age": [3, None], "user": [None, 7]}
    assert told == ["column user holds objects too, whose values are in user.age and the like"]


def test_numbers_that_json_or_64_bits_do_not_have(tmp_path):
    path = tmp_path / "log.jsonl"
    rows = ('{"id": 9223372036854775807, "key": 18446744073709551615, "x": NaN}', '{"id": -1, "key": 1, "x": Infinity}')
    path.write_text("\n".join(rows))
    found = read_table(path)[0]
    assert found["id"].to_pylist() == [2**63 - 1, -1]
    assert found["key"].to_pylist() == [2.0**64, 1.0]
    assert found["x"].to_pylist() == [None, np.inf]
    path.write_text('{"x": %s, "k": 18446744073709551615, "l": [18446744073709551615]}\n{"x": -1.5, "k": "NA"}' % ("9" * 400))
    found, _, told = read_table(path)
    assert found.to_pydict() == {"x": [np.inf, -1.5], "k": [2.0**64, None], "l[0]": [2.0**64, None]}
    assert told == [f"column {name}: '18446744073709551615' is rounded, as no integer is so large; put a letter before codes"
                    for name in ("k", "l[0]")]  # fmt: skip
    path.write_text('{"a": 1}\n{"a": "2"}\n{"a": 3.5}')
    found, _, told = read_table(path)
    assert found["a"].to_pylist() == [1.0, 2.0, 3.5]
    assert told == ["column a has cells of several types: line 2 holds '2', and most cells hold numbers"]
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
        ('{"x": {"0": 1, "1": 2}, "y": {"0": 1, "1": 3}}', "its object is a whole data frame as pandas writes it; .*records"),
        ('{"columns": ["x"], "index": [0], "data": [[1]]}', "its object is a whole data frame as pandas writes it"),
        ("[]", "it has no rows"), ("{}", "its objects have no keys"), ("[{}, {}]", "its objects have no keys"),
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
        ('{"count": 1, "obs": [[1.0]], "actions": [0]}', "rllib"), ('{"obs": [[1.0]], "type": "SampleBatch"}', "rllib"),
        ('{"obs": [[1.0]], "infos": [{}]}', "rllib"), ('\ufeff{"obs": {"a": [[1.0]], "b": [[2.0]]}}', "rllib"),
        ('{"obs": [%s 1.0], "action": 0}' % ("1.0, " * 2000), "json"), ('{"tags": [], "x": "%s"}' % ("x" * 5000), "json"),
        ('{"x": 1.0, "obs": [' + "1.0, " * 2000, "json"), ('{"type": "visit", "x": 1}', "json"), ("[\n {\n", "json"),
    ):  # fmt: skip
        path.write_text(text + ('"x": 1}]' if text.startswith("[") else "\n"), encoding="utf-8")
        assert sniff(path) == kind


def test_the_command_line_reads_json(tmp_path, capsys):
    path = written(tmp_path, ROWS * 20)
    assert main(["data", "info", str(path), "--action", "offer", "--reward", "clicks", "--ignore", "day", "spent", "ok"]) == 0
    assert "log (json, fingerprint" in capsys.readouterr().out
    assert main(["data", "info", str(path), "--action", "offer", "--reward", "clicks", "--decimal", ","]) == 2
    assert "--decimal is for CSV, but this is JSON" in capsys.readouterr().err
