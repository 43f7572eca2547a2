"""Text files read by parts and kept in files: the table, what is told and what is refused are those of reading in memory."""

import numpy as np
import pyarrow as pa
import pytest
from any_file import read_table
from dialect_files import READ

from deadreckon.data.formats import delimited, stream
from deadreckon.data.formats.build import arrays_of
from deadreckon.data.formats.delimited import read_delimited
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.formats.folder import read_folder
from deadreckon.data.formats.io import convert, read
from deadreckon.data.formats.kind import READING
from deadreckon.data.formats.spool import Spool
from deadreckon.data.schema import Schema
from deadreckon.errors import UserError

BLOCK = 256  # bytes, or a part of a long file: each but the shortest has several blocks


def agree(path, tmp_path, monkeypatch, **options):
    asked = Dialect.asked(**{key: value for key, value in options.items() if "csv" in READING.get(key, ())})
    whole = read_delimited(path, asked)
    monkeypatch.setattr(delimited, "_BLOCK", max(BLOCK, path.stat().st_size // 40))
    (tmp_path / "parts").mkdir()
    parts = read_delimited(path, asked, Spool(tmp_path / "parts"))
    assert parts[0].equals(whole[0])
    assert parts[1:] == whole[1:]
    return parts[0]


@pytest.mark.parametrize("name", READ)
def test_dialects(tmp_path, monkeypatch, name):
    content, options, _, _ = READ[name]
    (tmp_path / "log.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    agree(tmp_path / "log.csv", tmp_path, monkeypatch, **options)


LATE = {
    "integers, then a number": (["1", "-2", ""], "0.5", pa.float64()),
    "integers, then a text": (["1", "2", ""], "x", pa.string()),
    "integers, then a date": (["1", "2"], "2024-05-06", pa.string()),
    "truth values, then integers": (["true", "false"], "7", pa.string()),
    "dates, then a moment": (["2024-01-02", "2024-01-03"], "2024-01-02 10:00", pa.timestamp("s")),
    "moments, then a part of a second": (["2024-01-02 10:00"], "2024-01-02 10:00:00.25", pa.timestamp("ns")),
    "moments with zones": (["2024-01-02T10:00Z"], "2024-01-02T10:00+01:00", pa.timestamp("s", "UTC")),
    "zones, then none": (["2024-01-02T10:00Z"], "2024-01-02 10:00", None),
    "nothing, then a text": (["", "NA"], "a \"quoted\", 'text'\nof lines", pa.string()),
    "decimal commas, then none": (["1,5", "2,5"], "3", pa.float64()),
}


@pytest.mark.parametrize("name", LATE)
def test_types_are_those_of_the_whole_file(tmp_path, monkeypatch, name):
    cells, late, kind = LATE[name]
    quoted = [f'"{cell.replace(chr(34), chr(34) * 2)}"' if set('",\n') & set(cell) else cell for cell in [*cells * 200, late]]
    (tmp_path / "log.csv").write_text("x,n\n" + "".join(f"{cell},{row}\n" for row, cell in enumerate(quoted)))
    table = agree(tmp_path / "log.csv", tmp_path, monkeypatch, decimal="comma" if "commas" in name else None)
    assert table.column("x").num_chunks > 1
    assert kind is None or table.schema.field("x").type == kind


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_zeros_in_front_are_told_wherever_they_are(tmp_path, monkeypatch, encoding):
    lines = [f"{10_000 + row},{row % 3},0{row % 10},{row / 7:.2f}" for row in range(2_500)]
    for row, cell in ((2_300, " 00123"), (2_301, "00124"), (2_400, "x")):
        first, second, third, last = lines[row].split(",")
        lines[row] = f'"{cell}",{second},{third},0{last}' if cell != "x" else f"{first},{second},{cell},{last}"
    (tmp_path / "log.csv").write_text("zip, n,text,x\n" + "\n".join(lines) + "\n", encoding=encoding)
    table = agree(tmp_path / "log.csv", tmp_path, monkeypatch)
    assert table.column("zip")[2_300].as_py() == 123
    told = [line for line in read_delimited(tmp_path / "log.csv", Dialect())[2] if "letter before" in line]
    # Not of what is no number: `text` has a letter after so many rows, and `x` has decimals.
    assert told == ["column zip: '00123' is read as the number 123 (row 2300); put a letter before codes"]


@pytest.mark.parametrize("place", range(8, 14))
def test_zeros_at_the_edge_of_what_is_read_at_once_are_told(tmp_path, monkeypatch, place):
    name = "n" * place
    path = tmp_path / "log.csv"
    path.write_text(f"{name},x\n007,1\n" + "1,2\n" * 9)
    monkeypatch.setattr(delimited, "_BLOCK", 16)
    found = []
    with open(path, "rb") as file:
        found.append(delimited._may_have_zeros(file, Dialect(",", ".", "", "utf-8", '"')))
    path.write_text(f"{name},x\n7.007,1e-05\n" + "100,2\n" * 9)
    with open(path, "rb") as file:
        found.append(delimited._may_have_zeros(file, Dialect(",", ".", "", "utf-8", '"')))
    assert found == [True, False]


def test_a_total_in_the_last_row_is_told(tmp_path, monkeypatch):
    source = tmp_path / "log.csv"
    source.write_text("day,x,a,r\n" + "".join(f"d{row % 3},{row}.5,{row % 2},1\n" for row in range(90)) + "Total,9,1,90\n")
    monkeypatch.setattr(stream, "_LARGE", 100)
    told = convert(source, tmp_path / "log", action="a", reward="r")
    assert told.warnings == read(source, action="a", reward="r").warnings
    assert any(line.startswith("the last row, 90, looks like a total (column day has 'Total')") for line in told.warnings)


def german(rows=400):
    rng = np.random.default_rng(0)
    lines = ["Tag;Fall;Menge;an;Art;Lohn"]
    for row in range(rows):
        amount = "" if row == 7 else f"{rng.uniform(-9, 9):.3f}".replace(".", ",")
        flag, kind = rng.choice(["ja", "nein"]), rng.choice(["rot", "grün"])
        lines.append(f"{1 + row % 28:02d}.03.2024;{row // 28};{amount};{flag};{kind};{row % 5}")
    return "\n".join(lines) + "\n"


def test_large_text_files_become_the_log_in_memory(tmp_path, monkeypatch):
    source, asked = tmp_path / "log.csv", {"action": "an", "reward": "Lohn", "episode": "Fall", "time": "Tag"}
    source.write_text(german())
    whole = read(source, **asked)
    monkeypatch.setattr(stream, "_LARGE", 100)
    monkeypatch.setattr(delimited, "_BLOCK", BLOCK)
    rows = []
    told = convert(source, tmp_path / "log", progress=lambda done, of: rows.append(done), **asked)
    assert told.warnings == whole.warnings
    assert rows[-1] == 400
    assert len(rows) > 5
    streamed = read_folder(tmp_path / "log")
    for key, column in arrays_of(whole).items():
        np.testing.assert_array_equal(arrays_of(streamed)[key], column, key)
    assert streamed.provenance.extra == whole.provenance.extra
    assert read_table(source)[0].num_rows == 400
    source.write_text(german() + "1;2\n")
    with pytest.raises(UserError, match="line 402 has 2 cells"):
        convert(source, tmp_path / "no", **asked)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "log.csv"]


def test_levels_of_a_schema_that_look_like_numbers_stay_texts(tmp_path, monkeypatch):
    source = tmp_path / "log.csv"
    source.write_text("x,zone,a,r\n" + "".join(f"{row},{('01', '02', '10')[row % 3]},{row % 2},1\n" for row in range(90)))
    columns = {"x": {"role": "observation"}, "zone": {"role": "observation", "kind": "category", "levels": ["01", "02", "10"]},
               "a": {"role": "action", "kind": "integer"}, "r": {"role": "reward"}}  # fmt: skip
    whole = read(source, schema={"columns": columns})
    monkeypatch.setattr(stream, "_LARGE", 100)
    monkeypatch.setattr(delimited, "_BLOCK", BLOCK)
    streamed = convert(source, tmp_path / "log", schema={"columns": columns})
    assert streamed.observations[:3].tolist() == [[0, 1, 0, 0], [1, 0, 1, 0], [2, 0, 0, 1]]
    np.testing.assert_array_equal(streamed.observations, whole.observations)
    assert (streamed.warnings, streamed.provenance.extra) == (whole.warnings, whole.provenance.extra)


@pytest.mark.parametrize(("key", "value", "words"), [
    ("sheet", "one", "--sheet is for a spreadsheet, but this is CSV"), ("table", "t", "--table is for SQLite or DuckDB, but"),
    ("query", "select 1", "--query is for SQLite or DuckDB, but"),
])  # fmt: skip
def test_a_schema_of_another_format_is_refused_as_in_memory(tmp_path, monkeypatch, key, value, words):
    source = tmp_path / "log.csv"
    source.write_text("x,a,r\n" + "1.5,0,1\n2.5,1,0\n" * 20)
    columns = {"x": {"role": "observation"}, "a": {"role": "action", "kind": "integer"}, "r": {"role": "reward"}}
    for large in (10_000, 100):
        monkeypatch.setattr(stream, "_LARGE", large)
        with pytest.raises(UserError, match=words):
            convert(source, tmp_path / "log", schema={"table": {key: value}, "columns": columns})
        assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_a_schema_in_the_place_of_a_large_table_is_converted_by_parts(tmp_path, monkeypatch):
    source, schema = tmp_path / "log.txt", tmp_path / "log.toml"
    source.write_text("x a r\n" + "1.5 0 1\n2.5 1 0\n" * 90)
    columns = {"x": {"role": "observation"}, "a": {"role": "action", "kind": "integer"}, "r": {"role": "reward"}}
    for path, table in ((schema, {"path": "log.txt", "separator": "space"}), (tmp_path / "own.toml", {"separator": "space"})):
        Schema.from_json({"columns": columns, "table": table}).save(path)
    whole, parts = read(schema), []
    monkeypatch.setattr(stream, "_LARGE", 1_000)
    monkeypatch.setattr(stream, "SHARE", 1e-9)
    for index, (given, more) in enumerate(((schema, {}), (source, {"schema": str(tmp_path / "own.toml")}))):
        streamed = convert(given, tmp_path / f"log{index}", progress=lambda *done: parts.append(done), **more)
        assert (streamed.fingerprint, streamed.name) == (whole.fingerprint, whole.name)
        assert len(parts) == index + 1
        told = f"{given} holds 0.0 GB, more than 0% of the memory: `deadreckon data convert {given} FOLDER` first"
        assert str(stream.advice(given, **more)).startswith(told)
