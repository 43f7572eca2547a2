"""Text files read by parts and kept in files: the table, what is told and what is refused are those of reading in memory."""

import numpy as np
import pyarrow as pa
import pytest
from dialect_files import READ

from deadreckon.data.formats import delimited, stream
from deadreckon.data.formats.any_table import read_table
from deadreckon.data.formats.build import columns_of
from deadreckon.data.formats.delimited import read_delimited
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.formats.folder import read_folder
from deadreckon.data.formats.io import convert, read
from deadreckon.data.formats.kind import READING
from deadreckon.data.formats.spool import Spool
from deadreckon.errors import UserError

BLOCK = 256  # bytes: each of the longer files has several blocks


def agree(path, tmp_path, monkeypatch, **options):
    asked = Dialect.asked(**{key: value for key, value in options.items() if "csv" in READING.get(key, ())})
    whole = read_delimited(path, asked)
    monkeypatch.setattr(delimited, "_BLOCK", BLOCK)
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
    for key, column in columns_of(whole).items():
        np.testing.assert_array_equal(columns_of(streamed)[key], column, key)
    assert streamed.provenance.extra == whole.provenance.extra
    assert read_table(source)[0].num_rows == 400
    source.write_text(german() + "1;2\n")
    with pytest.raises(UserError, match="line 402 has 2 cells"):
        convert(source, tmp_path / "no", **asked)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "log.csv"]
