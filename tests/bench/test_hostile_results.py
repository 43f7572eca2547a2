"""Results from elsewhere, as Parquet and as ledgers, that are none of ours: refused in one line before a row is looked into."""

import json

import pyarrow as pa
import pytest
from pyarrow import parquet

from deadreckon.bench import ledger, store
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from deadreckon.bench.tables import number, tables
from deadreckon.errors import UserError

SUITE = """
kind = "learn"
logs = ["hopper-medium-v2"]
steps = 100
seeds = 1
evaluations = 1

[methods]
BC = { agent = "bc" }
"""
GONE = object()


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """A suite, its plan of one cell, and the row that this has."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "suite.toml").write_text(SUITE)
    suite = read(tmp_path / "suite.toml")
    jobs = plan(suite)
    [job] = jobs
    row = {
        "cell": job.cell(0), "content": job.content(0), "suite": "suite", "kind": "learn", "method": "BC", "agent": "bc",
        "settings": json.dumps(job.settings), "preset": "", "on": job.on, "data": job.data, "asked": json.dumps(job.options),
        "seed": 0, "score": 50.0, "raw": 1.0, "more": '{"m": "text"}', "episodes": [1.0], "log": "x", "failure": "",
        "seconds": 1.0, "steps": 100, "revisions": "{}", "versions": "{}", "finished": "2026", "job": "job",
    }  # fmt: skip
    return suite, jobs, row


def written(folder, table):
    """A store of one part."""
    (folder / "results").mkdir()
    parquet.write_table(table, folder / "results" / "part.parquet")
    return store.Store(folder)


def test_the_row_itself_is_shown(asked, tmp_path):
    suite, jobs, row = asked
    kept = written(tmp_path, pa.Table.from_pylist([row], schema=store.RESULT))
    [table] = tables(suite, jobs, kept)
    assert table.cells["BC"]["hopper-medium-v2"].scores.tolist() == [50.0]
    older = kept.results().drop_columns(["episodes", "content"])
    parquet.write_table(older, tmp_path / "results" / "other.parquet")
    assert kept.results().num_rows == 2


def test_a_score_of_nulls_is_nan(asked, tmp_path):
    """Earlier versions wrote them of studies without a score, and folders that hold such rows are still read."""
    suite, jobs, row = asked
    table = pa.Table.from_pylist([row | {"score": None}], schema=store.RESULT)
    kept = written(tmp_path, table)
    for name, other in (("some", [row, row | {"score": None}]), ("none", [row | {"score": None}])):
        parquet.write_table(pa.Table.from_pylist(other), tmp_path / "results" / f"{name}.parquet")
    assert pa.types.is_null(parquet.read_schema(tmp_path / "results" / "none.parquet").field("score").type)
    found = kept.results()["score"]
    assert found.null_count == 0
    assert sorted(map(str, found.to_pylist())) == ["50.0", "nan", "nan", "nan"]


DEEP = "[" * 100_000


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seconds": None}, "column seconds of its results must have a value in every row, got null"),
        ({"agent": None}, "column agent of its results must have a value"),
        ({"versions": None}, "column versions of its results must have a value"),
        ({"versions": "{"}, "column versions is not valid JSON"),
        ({"versions": "[1]"}, "column versions: what it holds must be an object, got a list of 1"),
        ({"versions": DEEP}, "column versions: is nested in 100,000 levels"),
        ({"more": "{"}, "column more is not valid JSON"),
        ({"more": "[1]"}, "column more: what it holds must be an object"),
        ({"more": DEEP}, "column more: is nested in 100,000 levels"),
        ({"settings": "5"}, "column settings: what it holds must be an object, got 5"),
    ],
)
def test_rows_that_lack_something_are_refused(changes, words, asked, tmp_path):
    suite, jobs, row = asked
    kept = written(tmp_path, pa.Table.from_pylist([row | changes], schema=store.RESULT))
    with pytest.raises(UserError, match=f"part.parquet: {words}"):
        tables(suite, jobs, kept)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: table.drop_columns("cell"), "its results lack the column cell"),
        (
            lambda table: table.set_column(0, "cell", pa.array([1])),
            "column cell of its results must be of type string, got int64",
        ),
        (lambda table: table.append_column("cell", table["cell"]), "two of its columns are called 'cell'"),
        (lambda table: table.append_column("more", table["cell"]), "two of its columns are called 'more'"),
    ],
)
def test_columns_of_another_table_are_refused(change, words, asked, tmp_path):
    suite, jobs, row = asked
    kept = written(tmp_path, change(pa.Table.from_pylist([row], schema=store.RESULT)))
    with pytest.raises(UserError, match=f"part.parquet: {words}"):
        tables(suite, jobs, kept)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"versions": GONE}, "it lacks versions"),
        ({"seconds": None}, "seconds must be a number, got None"),
        ({"agent": None}, "agent must be a text, got None"),
        ({"failure": None}, "failure must be a text, got None"),
    ],
)
def test_cells_of_a_ledger_that_lack_something_are_refused(changes, words, asked, tmp_path):
    suite, jobs, row = asked
    whole = {name: json.loads(value) if name in ledger.OBJECTS else value for name, value in row.items()}
    cell = {name: value for name, value in (whole | {"curve": []} | changes).items() if value is not GONE}
    place = tmp_path / "ledger" / "learn" / "hopper-medium-v2"
    place.mkdir(parents=True)
    (place / "BC.json").write_text(json.dumps(cell))
    kept = ledger.Ledger(tmp_path / "runs", tmp_path / "ledger")
    with pytest.raises(UserError, match=f"BC.json: {words}"):
        tables(suite, jobs, kept, any_revision=True)


@pytest.mark.parametrize("value", ["text", [1], True, {"a": 1}, 10**400])
def test_a_metric_that_is_no_number_is_refused(value, asked):
    _, _, row = asked
    with pytest.raises(UserError, match=r"BC on hopper-medium-v2, seed 0 \(cell .*\): m must be a number, got"):
        number(row | {"more": json.dumps({"m": value})}, "m")
    assert number(row | {"more": '{"m": 3}'}, "m") == 3.0
