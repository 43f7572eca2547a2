import contextlib
import datetime
import shutil
import sqlite3
import sys

import duckdb
import pytest
from any_file import read_table

from deadreckon.cli.main import main
from deadreckon.data.formats import io
from deadreckon.data.formats.io import convert, read
from deadreckon.data.spec import Box
from deadreckon.errors import UserError

DAY = datetime.datetime
KINDS = ("sqlite", "duckdb")
LOG = (
    "CREATE TABLE visits (day TEXT, site TEXT, offer TEXT, clicks INTEGER, spent DOUBLE, ok TEXT)",
    "INSERT INTO visits VALUES ('2024-01-02 10:00:00', 'a', 'x', 1, 1.5, 'yes'), "
    "('2024-01-03 00:00:00', 'b', 'y', 0, NULL, 'no')",
)  # fmt: skip


def made(path, kind, *statements):
    path = path / f"log.{kind}"
    with contextlib.closing(sqlite3.connect(path) if kind == "sqlite" else duckdb.connect(str(path))) as base:
        for statement in statements:
            base.execute(statement)
        if kind == "sqlite":
            base.commit()
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_the_only_table(tmp_path, kind):
    path = made(tmp_path, kind, *LOG)
    assert io.sniff(path) == kind
    found, dialect, told = read_table(path)
    assert found.to_pydict() == {
        "day": [DAY(2024, 1, 2, 10), DAY(2024, 1, 3)], "site": ["a", "b"], "offer": ["x", "y"], "clicks": [1, 0],
        "spent": [1.5, None], "ok": [True, False],
    }  # fmt: skip
    assert (dialect, told) == (None, ["read as true and false: ok (yes/no)"])
    log = read(path, time="day", action="offer", reward="clicks", ignore=["spent", "ok"])
    assert log.provenance.source == kind
    assert log.provenance.extra["observation_names"] == ["site=a", "site=b"]
    again = convert(path, tmp_path / "again.parquet", time="day", action="offer", reward="clicks", ignore=["spent", "ok"])
    assert again.fingerprint == log.fingerprint


@pytest.mark.parametrize("kind", KINDS)
def test_a_table_by_name_and_by_query(tmp_path, kind):
    other = ('CREATE TABLE "odd "" name" (a INTEGER)', 'INSERT INTO "odd "" name" VALUES (7)')
    path = made(tmp_path, kind, *LOG, *other, "CREATE VIEW few AS SELECT clicks AS c FROM visits WHERE clicks = 1")
    with pytest.raises(UserError, match=rf"^{path}: which table .* --table NAME, .*; it has few, odd \" name, visits$"):
        read_table(path)
    assert read_table(path, table='odd " name')[0].to_pydict() == {"a": [7]}
    assert read_table(path, table="few")[0].to_pydict() == {"c": [1]}
    query = "SELECT site, clicks * 2 AS double FROM visits ORDER BY site DESC"
    assert read_table(path, query=query)[0].to_pydict() == {"site": ["b", "a"], "double": [0, 2]}
    assert read_table(path, query=f"WITH v AS ({query}) SELECT * FROM v WHERE double > 0;")[0].num_rows == 1
    assert read_table(path, query="VALUES (1, 2)")[0].num_rows == 1
    with pytest.raises(UserError, match=f"^{path}: unknown table 'visit': did you mean visits"):
        read_table(path, table="visit")
    with pytest.raises(UserError, match="--query and --table exclude each other"):
        read_table(path, table="visits", query=query)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("SELECT nope FROM visits", "cannot run 'SELECT nope FROM visits' .*nope"),
        ("SELEC 1", "cannot run 'SELEC 1' "),
        ("DELETE FROM visits", "takes (a|one) SELECT"),
        ("DROP TABLE visits", "takes (a|one) SELECT"),
        ("CREATE TABLE other (a INTEGER)", "takes (a|one) SELECT"),
        ("SELECT 1; DROP TABLE visits", "takes (a|one) SELECT|one statement at a time"),
        ("", "takes (a|one) SELECT"),
        ("SELECT clicks AS a, spent AS a FROM visits", "the query gives two columns called 'a'"),
        ("SELECT x'00' AS b FROM visits", "column b holds binary data"),
    ],
)
def test_a_query_that_is_wrong_is_told_in_one_line_and_changes_nothing(tmp_path, kind, query, words):
    path = made(tmp_path, kind, *LOG)
    before = path.read_bytes()
    query = query.replace("x'00'", "'\\x00'::BLOB") if kind == "duckdb" else query
    with pytest.raises(UserError, match=words) as caught:
        read_table(path, query=query)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_without_tables_or_rows_or_whole_pages(tmp_path, kind):
    path = made(tmp_path, kind, "CREATE TABLE t (a INTEGER)", "DROP TABLE t")
    with pytest.raises(UserError, match="the database has no tables"):
        read_table(path)
    path.unlink()
    path = made(tmp_path, kind, "CREATE TABLE t (a INTEGER, b INTEGER)")
    assert read_table(path)[0].num_rows == 0
    with pytest.raises(UserError, match="the table has no rows"):
        read(path, action="a", reward="b")
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(UserError, match="cannot be read as a database of .*damaged") as caught:
        read_table(path)
    assert "\n" not in str(caught.value)


def test_a_database_whose_writer_was_killed_is_not_written_to(tmp_path):
    """A transaction that was cut leaves a journal, by which whoever opens the file for writing would take it back."""
    with contextlib.closing(sqlite3.connect(tmp_path / "used.db", isolation_level=None)) as base:
        base.execute("CREATE TABLE t (a INTEGER, b TEXT)")
        base.execute("INSERT INTO t VALUES (1, 'x')")
        base.execute("PRAGMA cache_size = 1")  # pages reach the file before the transaction ends
        base.execute("BEGIN")
        base.executemany("INSERT INTO t VALUES (?, ?)", [(row, "y" * 1_000) for row in range(200)])
        for end in ("", "-journal"):
            shutil.copy(tmp_path / f"used.db{end}", tmp_path / f"killed.db{end}")
    before = [(tmp_path / f"killed.db{end}").read_bytes() for end in ("", "-journal")]
    with pytest.raises(UserError, match="killed.db") as caught:
        read_table(tmp_path / "killed.db")
    assert "\n" not in str(caught.value)
    assert [(tmp_path / f"killed.db{end}").read_bytes() for end in ("", "-journal")] == before


def test_cells_of_sqlite_may_be_of_any_type(tmp_path):
    rows = ", ".join(f"({row}, '{row}.5', 0.5, '')" for row in range(20))
    path = made(tmp_path, "sqlite", "CREATE TABLE t (a, b TEXT, c, d)", f"INSERT INTO t VALUES {rows}, (NULL, '', 'NA', '-')")
    found, _, told = read_table(path)
    assert found.slice(19).to_pydict() == {"a": [19, None], "b": [19.5, None], "c": [0.5, None], "d": [None, "-"]}
    assert told == ["column d: '-' is a text like others in 1 row; empty such cells if they are missing"]
    path.unlink()
    path = made(tmp_path, "sqlite", "CREATE TABLE t (a)", "INSERT INTO t VALUES " + "(1), " * 20 + "('broken'), (2)")
    with pytest.raises(UserError, match="column a: row 20 holds 'broken', and most cells hold numbers"):
        read_table(path)
    assert read_table(path, query="SELECT a FROM t WHERE typeof(a) = 'integer'")[0].num_rows == 21


def test_types_of_duckdb(tmp_path):
    path = made(
        tmp_path, "duckdb",
        "CREATE TABLE t AS SELECT 1.25::DECIMAL(8, 2) AS d, 5::HUGEINT AS h, 'y'::ENUM ('x', 'y') AS e, "
        "TIMESTAMP '2024-01-02 10:00:00' AS t, true AS r, 2::UTINYINT AS a UNION ALL SELECT 2.5, 6, 'x', NULL, false, 1",
        "CREATE SCHEMA s", "CREATE TABLE s.t AS SELECT 1 AS a",
    )  # fmt: skip
    log = read(path, table="t", action="a", reward="d", ignore="t")
    assert log.rewards.tolist() == [1.25, 2.5]
    assert log.provenance.extra["observation_names"] == ["h", "e=x", "e=y", "r"]
    assert read_table(path, table="s.t")[0].to_pydict() == {"a": [1]}


def test_options_of_the_command_line(tmp_path, capsys):
    path = str(made(tmp_path, "sqlite", *LOG, "CREATE TABLE more (a INTEGER)"))
    query = "SELECT site, offer, clicks FROM visits"
    assert main(["data", "info", path, "--query", query, "--action", "offer", "--reward", "clicks"]) == 0
    assert "2 in 2 episodes" in capsys.readouterr().out
    assert main(["data", "info", path, "--table", "visits", "--separator", ";"]) == 2
    assert capsys.readouterr().err == f"deadreckon: {path}: --separator is for CSV, but this is SQLite\n"


def test_without_the_extra(tmp_path, monkeypatch):
    path = made(tmp_path, "duckdb", *LOG)
    monkeypatch.setitem(sys.modules, "duckdb", None)
    with pytest.raises(UserError, match=rf"^{path}: .* duckdb: install the extra tables"):
        read_table(path)


@pytest.mark.parametrize("query", ["VACUUM INTO '{other}'", "ATTACH '{other}' AS other", "PRAGMA user_version = 7"])
def test_a_query_of_sqlite_writes_no_file(tmp_path, query):
    path = made(tmp_path, "sqlite", *LOG, "CREATE VIEW v AS SELECT site FROM visits")
    other = tmp_path / "other.db"
    with pytest.raises(UserError, match="--query takes a SELECT that only reads tables of the file, not "):
        read_table(path, query=query.format(other=other))
    schema = {"table": {"query": query.format(other=other)}, "columns": {"clicks": {"role": "reward"}}}
    with pytest.raises(UserError, match="--query takes a SELECT that only reads tables of the file, not "):
        read(path, schema=schema)
    assert not other.exists()
    recursive = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 3) SELECT i, upper(site) AS s FROM "
    recursive += "n, v"
    assert read_table(path, query=recursive)[0].num_rows == 6


def test_a_query_and_a_view_of_duckdb_read_no_other_file(tmp_path):
    secret = tmp_path / "secret.csv"
    secret.write_text("a,b\n1,2\n")
    path = made(tmp_path, "duckdb", *LOG, f"CREATE VIEW evil AS SELECT * FROM read_csv('{secret}')")
    for how in (
        {"query": f"SELECT * FROM read_text('{secret}')"}, {"query": f"SELECT * FROM '{secret}'"}, {"table": "evil"},
        {"query": "SELECT * FROM listed"},
    ):  # fmt: skip
        with pytest.raises(UserError, match="DuckDB cannot run|takes one SELECT"):
            read_table(path, **how)
    assert read_table(path, table="visits")[0].num_rows == 2


def test_numbers_of_sqlite_keep_their_type(tmp_path):
    rows = ", ".join(f"({2**62 + row // 3}, {row % 3 * 10}, {row}, {2**60 if row else 0.5})" for row in range(60))
    create = "CREATE TABLE t (episode INTEGER, action REAL, reward INTEGER, x)"
    path = made(tmp_path, "sqlite", create, f"INSERT INTO t VALUES {rows}")
    found, _, told = read_table(path)
    assert found["episode"][59].as_py() == 2**62 + 19
    assert [str(kind) for kind in found.schema.types] == ["int64", "double", "int64", "double"]
    assert told == [f"column x holds integers and decimals, and row 1 has {2**60}, which is rounded"]
    log = read(path)
    assert log.episodes == 20
    assert log.action_space == Box((0.0,), (20.0,))


@pytest.mark.parametrize(
    ("kind", "view"),
    [
        ("sqlite", "SELECT replace(hex(zeroblob(30000000)), '0', 'x') AS s"),  # one value
        ("sqlite", "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c LIMIT 200) "
                   "SELECT printf('%.*c', 1000000, 'x') AS s FROM c"),
        ("duckdb", "SELECT repeat('x', 100000) AS s FROM range(2000)"),
    ],
)  # fmt: skip
def test_a_view_computes_no_more_than_a_file_may_unpack_to(tmp_path, monkeypatch, kind, view):
    path = made(tmp_path, kind, f"CREATE VIEW v AS {view}")
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "50M")
    with pytest.raises(UserError, match=r"string or blob too big|DEADRECKON_MAX_UNPACKED|out of memory"):
        read_table(path)
    assert not list(tmp_path.glob("*.tmp"))
    monkeypatch.delenv("DEADRECKON_MAX_UNPACKED")
    found, _, _ = read_table(path, query="SELECT substr(s, 1, 3) AS s, 1.5 AS y FROM v LIMIT 1")
    assert found.to_pydict() == {"s": ["xxx"], "y": [1.5]}
