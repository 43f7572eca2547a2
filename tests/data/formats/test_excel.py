import datetime
import sys

import pytest
from any_file import read_table
from small_sheets import write_ods, write_xlsx

from deadreckon.cli.main import main
from deadreckon.data.formats import io
from deadreckon.data.formats.excel import letters_of
from deadreckon.data.formats.io import convert, read
from deadreckon.errors import UserError

DAY = datetime.datetime
ROWS = [
    ["when", "x", "arm", "reward", "done", "note"],
    [DAY(2024, 1, 2, 3, 4, 5), 1.5, "a", 1, False, None],
    [datetime.date(2024, 1, 3), 2, "b", 0, True, "late"],
]


def test_a_sheet_is_read_exactly(tmp_path):
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": ROWS})
    assert io.sniff(path) == "excel"
    found, dialect, told = read_table(path)
    assert found.to_pydict() == {
        "when": [DAY(2024, 1, 2, 3, 4, 5), DAY(2024, 1, 3)], "x": [1.5, 2.0], "arm": ["a", "b"], "reward": [1, 0],
        "done": [False, True], "note": [None, "late"],
    }  # fmt: skip
    assert [str(kind) for kind in found.schema.types] == ["timestamp[us]", "double", "string", "int64", "bool", "string"]
    assert (dialect, told) == (None, [])
    log = read(path, action="arm", reward="reward", time="when", terminal="done", ignore="note")
    assert log.observations.tolist() == [[1.5], [2.0]]
    assert (log.name, log.provenance.source) == ("log", "excel")
    assert convert(path, tmp_path / "log.hdf5", action="arm", reward="reward", sheet=1).episodes == 2


def test_a_sheet_of_open_document(tmp_path):
    path = write_ods(tmp_path / "log.ods", [["x", "arm"], [1.5, "a"], [2, "b"]])
    assert io.sniff(path) == "excel"
    assert read_table(path)[0].to_pydict() == {"x": [1.5, 2.0], "arm": ["a", "b"]}


def test_the_table_may_stand_anywhere(tmp_path):
    rows = [["x ", None, "y\nz", None], [1, None, "a", None], [None, None, None, None], [None, None, "b", None]]
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": rows}, first="C4")
    found, _, told = read_table(path)
    assert found.to_pydict() == {"x": [1, None], "y z": ["a", "b"]}
    assert told == ["empty rows are left out: 1"]


def test_merged_cells_below_the_names_are_told(tmp_path):
    rows = [["site", "x", "reward"], ["a", 1, 2], [None, 2, 3], ["b", 3, 4], [None, 4, 5]]
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": rows}, first="A2", merged=("A1:C1", "A2:A2"))
    assert read_table(path)[2] == []
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": rows}, first="A2", merged=("A1:C1", "A5:A6", "A3:A4"))
    table, _, told = read_table(path)
    assert table["site"].to_pylist() == ["a", None, "b", None]
    assert len(told) == 1
    assert told[0].startswith("2 ranges of cells are merged, such as A3:A4, and only the first cell of each has its value; ")


def test_which_sheet(tmp_path):
    sheets = {"Notes": [["a", "b"], [1, 2]], "Log": [["a", "b"], [3, 4]], "2024": [["a", "b"], [5, 6]]}
    path = write_xlsx(tmp_path / "log.xlsx", sheets)
    with pytest.raises(UserError, match=rf"^{path}: which sheet .* --sheet NAME, .*it has 'Notes', 'Log', '2024'$"):
        read_table(path)
    for sheet, value in (("Log", 3), ("2", 3), (2, 3), (1, 1), ("2024", 5), (3, 5)):
        assert read_table(path, sheet=sheet)[0].column("a").to_pylist() == [value]
    with pytest.raises(UserError, match="unknown sheet 'Lag': did you mean Log"):
        read_table(path, sheet="Lag")
    for sheet in (0, 4, "4"):
        with pytest.raises(UserError, match=f"there is no sheet {sheet}; it has 3: 'Notes', 'Log', '2024'"):
            read_table(path, sheet=sheet)
    path = write_xlsx(tmp_path / "hidden.xlsx", {"Lists": [["z", "b"], [1, 2]], "Log": sheets["Log"]}, hidden=("Lists",))
    assert read_table(path)[0].column("a").to_pylist() == [3]
    assert read_table(path, sheet="Lists")[0].column("z").to_pylist() == [1]


def test_texts_that_stand_for_something_else(tmp_path):
    rows = [
        ["d", "ok", "n", "m"],
        ["01.02.2024", "yes", "1.5", 7],
        ["13.02.2024", "no", "-2", "n/a"],
        ["", None, "3e2", "#N/A"],
    ]
    found, _, told = read_table(write_xlsx(tmp_path / "log.xlsx", {"Log": rows}))
    assert found.to_pydict() == {
        "d": [DAY(2024, 2, 1), DAY(2024, 2, 13), None], "ok": [True, False, None],
        "n": [1.5, -2.0, 300.0], "m": [7, None, None],
    }  # fmt: skip
    assert len(told) == 2
    assert told[0] == "read as true and false: ok (yes/no)"
    assert "'01.02.2024' are read as day.month.year" in told[1]


def test_kinds_that_are_mixed(tmp_path):
    rows = [["x", "y"], *([value, value / 2] for value in range(15)), [15, "broken"], *([value, 1] for value in range(20))]
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": rows}, first="B2")
    with pytest.raises(UserError, match=rf"^{path}: column y: cell C18 holds 'broken', and most cells hold numbers; correct"):
        read_table(path)
    rows = [["x", "y"], [1, DAY(2024, 1, 1)], ["a", "soon"], [2.5, DAY(2024, 1, 2)]]
    found, _, told = read_table(write_xlsx(tmp_path / "log.xlsx", {"Log": rows}))
    assert found.column("x").to_pylist() == ["1", "a", "2.5"]
    assert told[:2] == [
        "column x has cells of several types: cell A3 holds 'a', and most cells hold numbers",
        "column y has cells of several types: cell B3 holds 'soon', and most cells hold dates",
    ]
    rows = [["x", "y"], *([True, 1] for _ in range(20)), [3, 2]]
    with pytest.raises(UserError, match="cell A22 holds '3.0', and most cells hold true or false"):
        read_table(write_xlsx(tmp_path / "log.xlsx", {"Log": rows}))


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([["a", "b", "a"], [1, 2, 3]], "the name 'a' in cell C1 is that of another column too"),
        ([["a", "b", " a"], [1, 2, 3]], "the name 'a' in cell C1"),
        (
            [["a", None, "b"], [1, None, 3], [1, 2, 3]],
            "cell B1 is empty, where the name of column B is needed; B3 holds a value",
        ),
        ([["A title"], ["a", "b"], [1, 2]], "cell B1 is empty, where the name of column B is needed"),
        ([["a", "b"]], "sheet 'Log' has no rows below a row of names"),
        ([], "sheet 'Log' has no rows"),
    ],
)
def test_a_sheet_that_is_no_table(tmp_path, rows, words):
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": rows})
    with pytest.raises(UserError, match=words) as caught:
        read_table(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_damaged_and_locked_files(tmp_path):
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": ROWS})
    path.write_bytes(path.read_bytes()[:700])
    assert io.sniff(path) == "excel"
    with pytest.raises(UserError, match="cannot be read as a spreadsheet, it is damaged or cut short") as caught:
        read_table(path)
    assert "\n" not in str(caught.value)
    path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 600)
    with pytest.raises(UserError, match="cannot be read as a spreadsheet"):
        read_table(path)


def test_options_of_other_formats(tmp_path, capsys):
    path = str(write_xlsx(tmp_path / "log.xlsx", {"Log": ROWS, "More": ROWS}))
    for option, formats in (("separator", "CSV"), ("query", "SQLite or DuckDB"), ("encoding", "CSV")):
        with pytest.raises(UserError, match=f"--{option} is for {formats}, but this is a spreadsheet"):
            read(path, **{option: ";"})
    assert main(["data", "info", path, "--sheet", "More", "--action", "arm", "--reward", "reward"]) == 0
    assert "2 in 2 episodes" in capsys.readouterr().out
    assert main(["data", "info", path, "--action", "arm", "--reward", "reward"]) == 2
    assert "it has 'Log', 'More'" in capsys.readouterr().err


def test_without_the_extra(tmp_path, monkeypatch):
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": ROWS})
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    with pytest.raises(UserError, match=rf"^{path}: .* python-calamine: install the extra tables"):
        read_table(path)


def test_letters_of_columns():
    assert [letters_of(column) for column in (0, 25, 26, 51, 52, 701, 702)] == ["A", "Z", "AA", "AZ", "BA", "ZZ", "AAA"]


def test_a_cell_that_is_far_away_ends_no_process_but_the_one_that_reads(tmp_path, monkeypatch):
    rows = [["x", *[None] * 16_382, "y"], *[[]] * 50_000, [1]]  # 50,001 rows of 16,384 cells, nearly all of them empty
    path = write_xlsx(tmp_path / "log.xlsx", {"Log": rows})
    assert path.stat().st_size < 1_000_000
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "100M")
    with pytest.raises(UserError, match=r"log\.xlsx: cannot be read as a spreadsheet, it .* more memory than a file"):
        read_table(path)
    small = write_xlsx(tmp_path / "small.xlsx", {"Log": ROWS})
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "1M")
    assert read_table(small)[0].num_rows == 2
