"""Text files that try to be misread: each is read exactly, or what is open about it is told."""

import gzip
import random

import pyarrow as pa
import pytest
from any_file import read_table
from dialect_files import READ

from deadreckon.cli.main import main
from deadreckon.cli.train import columns_of
from deadreckon.data import catalogue
from deadreckon.data.describe import describe_table
from deadreckon.data.formats import io
from deadreckon.data.formats.cells import flags_of
from deadreckon.data.formats.dialect import Dialect, encoding_of, sniff
from deadreckon.data.formats.io import convert, read
from deadreckon.data.formats.stream import convert_table
from deadreckon.data.schema import Schema
from deadreckon.errors import UserError

REFUSED = {
    "names twice": ("a,b,a\n1,2,3\n", {}, "the name 'a' is given to columns 1 and 3; rename one"),
    "names twice but for blanks": ("a,b, a\n1,2,3\n", {}, "the name 'a' is given to columns 1 and 3"),
    "names twice in Latin-1": ("ä,b,ä\n1,2,3\n".encode("latin-1"), {}, "the name 'ä' is given to columns 1 and 3"),
    "no name": ("a,,b\n1,2,3\n", {}, "column 2 has no name; give it one in the line of names"),
    "no name, and no numbers of rows": (",b\nx,2\ny,3\n", {}, "column 1 has no name"),
    "no name, and numbers that come twice": (",b\n1,2\n1,3\n", {}, "column 1 has no name"),
    "no names": ("1.5,2.5\n3.5,4.5\n", {}, r"line 1 holds numbers \(1.5, 2.5\) where the names of the columns are needed"),
    "names of rows without a name": (
        '"x","y"\n"1",2,3\n"2",3,4\n', {}, r"line 1 has 2 names, the rows have 3 cells; .*in R: write.csv",
    ),
    "a separator behind rows alone": (
        "a;b\n1;2;\n3;4;\n", {}, r"every line but that of the names \(line 1\) ends in a separator",
    ),
    "too few cells": (
        "a;b;c\n1;2;3\n4;5\n6;7;8\n", {}, "line 3 has 2 cells, the line of names has 3: '4;5'; is a separator missing",
    ),
    "too many cells": ("a,b\n1,2\n3,4,5\n6,7\n8,9\n", {}, "line 3 has 3 cells, the line of names has 2: '3,4,5'"),
    "too many cells below a title": ("Title\na,b\n1,2\n3,4,5\n6,7\n", {}, "line 4 has 3 cells, the line of names has 2"),
    "a decimal comma without quotes": (
        "a,b\n1,5,x\n2,x\n3,y\n4,z\n", {}, "line 2 has 3 cells, .*or does a text that holds one lack",
    ),
    "an open quote": ('a,b\n1,"x\n2,y\n3,z\n', {}, r'in line 2 a quote \("\) opens a text and none closes it'),
    "an open quote far behind": (
        "a,b\n" + "1,x\n" * 90_000 + '1,"x\n' + "1,x\n" * 90_000, {}, r"in line 90002 a quote",
    ),
    "names alone": ("a,b\n", {}, "the log has no rows, only a line of names"),
    "names alone, without a line end": ("a;b", {}, "the log has no rows, only a line of names"),
    "names alone and empty rows": ("a;b\n;\n;\n", {}, "the log has no rows"),
    "one column": ("a\n1\n2\n", {}, "not a log in a format that is read .* one column is read from Parquet or a spreadsheet"),
    "prose": ("hello\nworld, this is\nprose\n", {}, "two columns or more, and nothing separates any in 'hello'"),
    "UTF-8 that breaks": (
        "a,ä\n".encode() + b"1,x\n" * 100_000 + b"2,\xe4\n", {}, "column ä, row 100000: .* is not utf-8; name the encoding",
    ),
    "UTF-16 that breaks": ("a,b\n1,2\n".encode("utf-16") * 1 + b"\0", {}, "not utf-16|not a text in"),
    "another encoding than asked for": (
        "a,b\n1,\xe4\n".encode("latin-1"), {"encoding": "utf-8"}, "line 2 is not utf-8; name its encoding",
    ),
    "another separator than asked for": (
        "a,b\n1,2\n", {"separator": ";"}, "no ';' separates columns in its line of names 'a,b'",
    ),
    "a wrong separator": ("a,b\n1,2\n", {"separator": "xy"}, "--separator takes one character, or comma, .*, not 'xy'"),
    "a wrong decimal": ("a,b\n1,2\n", {"decimal": "x"}, "--decimal takes a point or a comma"),
    "wrong thousands": ("a,b\n1,2\n", {"thousands": "x"}, "--thousands takes none, point, comma, space or apostrophe, not 'x'"),
    "one mark for both": ("a,b\n1,2\n", {"thousands": ",", "decimal": ","}, "--decimal and --thousands are both ','"),
    "a wrong encoding": ("a,b\n1,2\n", {"encoding": "utf-9"}, "--encoding utf-9: unknown; known are"),
    "an encoding of no text": ("a,b\n1,2\n", {"encoding": "base64"}, "--encoding base64: unknown"),
    "wrong dates": ("a,b\n1,2\n", {"dates": "us"}, "--dates takes iso, day-first or month-first, not 'us'"),
    "a sheet of a text": ("a,b\n1,2\n", {"sheet": "1"}, "--sheet is for a spreadsheet, but this is CSV"),
    "a query of a text": ("a,b\n1,2\n", {"query": "SELECT 1"}, "--query is for SQLite or DuckDB, but this is CSV"),
}  # fmt: skip


def dashed(name):
    return name.replace(" ", "-")


def written(tmp_path, content, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch):
    """As if files were much larger."""
    monkeypatch.setattr("deadreckon.data.formats.delimited._BLOCK", 1 << 16)


@pytest.mark.parametrize("name", READ, ids=dashed)
def test_a_file_is_read_exactly_and_what_is_open_is_told(tmp_path, name):
    content, options, expected, lines = READ[name]
    options = dict(options)
    tail = options.pop("tail", None)
    found, dialect, told = read_table(written(tmp_path, content), **options)
    assert found.slice(found.num_rows - tail if tail else 0).to_pydict() == expected
    assert len(told) == len(lines), told
    for line, words in zip(told, lines, strict=True):
        assert words in line
        assert "\n" not in line
    assert dialect is not None


@pytest.mark.parametrize("name", REFUSED, ids=dashed)
def test_a_file_is_refused_in_one_line(tmp_path, name):
    content, options, words = REFUSED[name]
    path = written(tmp_path, content)
    with pytest.raises(UserError, match=words) as caught:
        read_table(path, **options)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith((f"{path}: ", "--"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_file_that_is_broken_at_random_is_read_or_refused_in_one_line(tmp_path, seed):
    rng = random.Random(seed)
    files = [written(tmp_path, content).read_bytes() for content, *_ in READ.values()]
    files = [content for content in files if len(content) < 1000]
    texts = "; , \n \r \t - 1.234 1,5 01.02.2024 31.02.2024 yes sep=;\n # ' e5 -1- . 99999999999999999999 inf 12:30 | \" \0"
    pieces = [*(text.encode() for text in texts.split(" ")), b"", b" ", b"\xe4", b"\xff", b"\xc2\xa0", b"\xef\xbb\xbf"]
    for _ in range(100):
        content = bytearray(rng.choice(files))
        for _ in range(rng.randint(1, 6)):
            place = rng.randrange(len(content) + 1)
            content[place : place + rng.choice((0, 0, 1, 8))] = rng.choice(pieces)
        try:
            _, _, told = read_table(written(tmp_path, bytes(content)))
        except UserError as error:
            told = [str(error)]
        assert not any("\n" in line for line in told), bytes(content)


def test_the_dialect_that_was_found(tmp_path):
    path = written(tmp_path, "sep=;\nd;x\n01.02.2024;1.234,5\n")
    _, dialect, _ = read_table(path)
    assert dialect == Dialect(";", ",", ".", None, '"', "day-first", 1)  # the next file may have another encoding
    assert read_table(path, decimal=".", thousands=",")[1] == Dialect(";", ".", ",", None, '"', "day-first", 1)
    _, dialect, _ = read_table(written(tmp_path, "a;b\n1;é\n2;x\n"))
    assert dialect == Dialect(";", ".", "", None, '"', None, 0, unmarked=True)
    assert dialect.options == {"separator": ";"}
    assert read_table(path, encoding="utf-8")[1].options["encoding"] == "utf-8"


def test_the_head_may_end_within_a_row_and_within_a_letter(tmp_path):
    head = "a;b\n1,5;x\n2,25;ü".encode()
    for cut in (head, head[:-1]):
        dialect, told = sniff("f", cut, False, Dialect.asked())
        assert (dialect.separator, dialect.decimal, dialect.encoding) == (";", ",", "utf-8")
        assert len(told) == 2
    assert sniff("f", b"a;b\n1;x\n1,234", False, Dialect.asked())[1] == ["columns are separated by semicolons (--separator)"]
    assert encoding_of(head[:-1]) == "utf-8"
    assert encoding_of(head[:-1], whole=True) == "cp1252"


def test_a_line_of_names_longer_than_the_head(tmp_path, monkeypatch):
    monkeypatch.setattr("deadreckon.data.formats.delimited._BLOCK", 1 << 22)
    names = [f"{'long_' * 30}{index}" for index in range(3_000)]
    path = written(tmp_path, ";".join(names) + "\n" + ";".join("1,5" for _ in names) + "\n")
    found, dialect, _ = read_table(path)
    assert (found.num_columns, dialect.decimal, found.column(2_999).to_pylist()) == (3_000, ",", [1.5])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
def test_gzipped_files_of_any_dialect(tmp_path, encoding):
    text = "größe;reward;action\n" + "1,5;2;x\n" * 50_000
    path = written(tmp_path, gzip.compress(text.encode(encoding)), "log.csv.gz")
    log = read(path, reward="reward", action="action")
    assert log.observations[0].tolist() == [1.5]
    assert len(log) == 50_000
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(UserError, match="damaged or cut short"):
        read(path, reward="reward", action="action")


@pytest.mark.parametrize("text", ["a;b\n1;2\n", "a\tb\n1\t2\n", "a|b\n1|2\n", "sep=,\na,b\n", "Title\n\na;b\n1;2\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_a_table_is_told_by_its_content(tmp_path, text, encoding):
    assert io.sniff(written(tmp_path, text.encode(encoding), "log.txt")) == "csv"
    assert io.sniff(written(tmp_path, gzip.compress(text.encode(encoding)), "log.gz")) == "csv"


@pytest.mark.parametrize("content", ["a\n1\n2\n", "a,\n", b"\x00\x01\x02,\x03", b"a,b\x01\n", b"\xff\xfe\x00,", "word\n" * 100])
def test_what_is_no_table(tmp_path, content):
    with pytest.raises(UserError, match="not a log in a format that is read"):
        io.sniff(written(tmp_path, content))


EUROPEAN = "Tag;x;Ventil;Ertrag;fertig\n01.02.2024;1,5;0,25;1.000,5;nein\n02.02.2024;2,5;0,75;2.000;ja\n"
COLUMNS = {"time": "Tag", "action": "Ventil", "reward": "Ertrag", "terminal": "fertig"}


def test_a_log_of_a_european_table(tmp_path):
    path = written(tmp_path, EUROPEAN)
    log = read(path, **COLUMNS)
    assert log.observations.tolist() == [[1.5], [2.5]]
    assert log.rewards.tolist() == [1000.5, 2000.0]
    assert log.terminals.tolist() == [False, True]
    assert log.provenance.source == "csv"
    assert any("decimal commas: '1,5'" in line for line in log.warnings)
    again = convert(path, tmp_path / "log.parquet", **COLUMNS, thousands=".", dates="day-first")
    assert again.fingerprint == log.fingerprint == read(tmp_path / "log.parquet").fingerprint
    assert catalogue.load(path, decimal=",", **COLUMNS).fingerprint == log.fingerprint


def test_how_a_file_is_read_does_not_name_its_columns(tmp_path):
    """Without a mapping columns have our names; a separator is no mapping."""
    path = written(tmp_path, "observation_0;action;reward\n1,5;0;1\n2,5;1;0\n")
    assert read(path, separator=";", decimal=",", encoding="utf-8").observations.tolist() == [[1.5], [2.5]]
    assert read(path, separator=";", action="action").fingerprint == read(path).fingerprint
    log = read(path)
    for target in ("log.parquet", "log.hdf5"):
        convert(path, tmp_path / target)
    assert read(tmp_path / "log.parquet").fingerprint == log.fingerprint
    for target, kind in (("log.parquet", "Parquet"), ("log.hdf5", "hdf5")):
        with pytest.raises(UserError, match=rf"log\.{target[4:]}: --decimal is for CSV, but this is {kind}"):
            read(tmp_path / target, decimal=",")


def test_options_of_the_command_line(tmp_path, capsys):
    path = written(tmp_path, "observation_0;action;reward\n1,234;0;1\n2,567;1;0\n")
    assert main(["data", "info", str(path), "--thousands", "comma", "--separator", "semicolon"]) == 0
    assert "marks of thousands are taken out of the numbers in observation_0" in capsys.readouterr().out
    out = str(tmp_path / "log.csv.hdf5")
    assert main(["data", "convert", str(path), out, "--decimal", "comma"]) == 0
    assert "! columns are separated by semicolons (--separator)" in capsys.readouterr().err
    assert read(out).observations[0, 0] == pytest.approx(1.234)
    assert main(["data", "info", str(path), "--encoding", "nope"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["data", "info", str(path), "--sheet", "1"]) == 2
    assert "--sheet is for a spreadsheet" in capsys.readouterr().err


def test_a_column_to_hold_out_by_is_no_mapping_of_a_file_without_one():
    from deadreckon.cli.data import Mapping

    assert columns_of(Mapping(separator=";"), "user") == {"separator": ";"}
    assert columns_of(Mapping(separator=";", reward="r"), "user") == {"separator": ";", "reward": "r", "keep": ("user",)}


def test_numbers_with_an_odd_text_are_no_category(tmp_path):
    rows = "".join(f"{row / 8},{row % 3},1\n" for row in range(100))
    path = written(tmp_path, f"x,arm,r\n{rows}broken,1,1\n")
    with pytest.raises(
        UserError, match=rf"^{path}: column x holds a text in row 100, 'broken', among 100 numbers such as '0.0'"
    ):
        read(path, action="arm", reward="r")
    path = written(tmp_path, f"arm,x,r\n{rows}broken,1,1\n")
    with pytest.raises(UserError, match="column arm holds a text in row 100, 'broken'"):
        read(path, action="arm", reward="r")
    path = written(tmp_path, f"x,arm,r,y\n{rows.replace(',1' + chr(10), ',1,2' + chr(10))}broken,1,1,2\n")
    assert read(path, action="arm", reward="r", ignore="x").observations.shape == (101, 1)  # of no matter there


def test_levels_of_which_some_are_numbers_stay_levels(tmp_path):
    rows = "".join(f"{row % 5},{row % 2},1\n" for row in range(100))
    path = written(tmp_path, f"floor,arm,r\n{rows}ground,1,1\n")
    log = read(path, action="arm", reward="r")
    assert log.observations.shape == (101, 6)
    assert any("column floor is read as texts: 100 of 101 cells" in line for line in log.warnings)


def test_what_is_said_of_no_other_cell_is_said_of_the_rows_that_were_looked_at(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("x;action;reward\n" + "1.234;0;1\n" * 3_000)
    words = "'1.234' is read as 1.234, not as 1234, and no other cell of the first 2,000 rows tells (--thousands point)"
    assert words in read_table(path)[2]


def test_an_action_that_is_none_everywhere_is_a_level(tmp_path):
    """Where the cells are all that pyarrow takes for a column of nothing; an empty column stays one, and so do numbers."""
    (tmp_path / "log.csv").write_text("x,note,lab,offer,paid\n1,NA,1,none,1\n2,NA,2,none,0\n3,NA,,none,1\n")
    log = read(tmp_path / "log.csv", action="offer", reward="paid")
    assert log.provenance.extra["action_levels"] == ["none"]
    assert any("column note is empty and is left out" in line for line in log.warnings)
    schema, _ = describe_table(tmp_path / "log.csv", action="offer", reward="paid")
    assert {column.name: column.levels for column in schema.columns}["offer"] == ("none",)
    streamed = convert_table(tmp_path / "log.csv", tmp_path / "log", "csv", action="offer", reward="paid")
    assert streamed.fingerprint == log.fingerprint
    assert streamed.provenance.extra["action_levels"] == ["none"]
    # By a schema, too: in later rows one level of several may be all there is, and a column of numbers may miss them all.
    (tmp_path / "more.csv").write_text("x,lab,offer,paid\n1,1,none,1\n2,2,mail,0\n3,,none,1\n")
    (tmp_path / "late.csv").write_text("x,lab,offer,paid\n1,NA,none,1\n2,NA,none,0\n")
    first = read(tmp_path / "more.csv", action="offer", reward="paid")
    late = read(tmp_path / "late.csv", schema=Schema.from_json(first.provenance.extra["schema"], "more"))
    assert late.actions.tolist() == [1, 1]
    assert late.observations[:, 1:].tolist() == [[1.5, 1.0], [1.5, 1.0]]
    # By its name, where nobody asks.
    (tmp_path / "named.csv").write_text("x,action,reward\n1,None,1\n2,None,0\n")
    assert read(tmp_path / "named.csv").provenance.extra["action_levels"] == ["None"]


def test_a_word_after_many_spellings_of_yes_and_no_is_no_flag():
    spellings = ["yes", "no", "Yes", "No", "YES", "NO", "yEs", "nO", "yeS"]
    assert flags_of(pa.array(spellings), known=False) is not None
    assert flags_of(pa.array([*spellings, "maybe"]), known=False) is None
