"""Spreadsheets that are written: texts, numbers, formulas, and what no spreadsheet holds."""

import re
import sys
import zipfile

import pytest

from deadreckon.data.formats import xlsx_out
from deadreckon.errors import UserError

TABLE = {"=name": ["=cmd|' /C calc'!A0", "@SUM(A1)", "-1", "plain", "\tbehind"], "x": [1.5, float("nan"), None, 2, True]}


def read(path):
    calamine = pytest.importorskip("python_calamine")
    return calamine.CalamineWorkbook.from_path(str(path)).get_sheet_by_name("proposals").to_python(skip_empty_area=False)


@pytest.mark.parametrize(
    ("text", "written"), [("=1+1", "'=1+1"), ("-0.5", "-0.5"), ("a\x1b", "a\\x1b"), ("\ud800", "\\ud800"), (None, "None")]
)
def test_texts_of_cells(text, written):
    assert xlsx_out._text(text) == written


def test_what_is_written_is_read_back_with_formulas_neutralised(tmp_path):
    pytest.importorskip("xlsxwriter")
    xlsx_out.write_sheets({"proposals": TABLE, "about": {"what": ["x"]}}, tmp_path / "p.xlsx")
    rows = read(tmp_path / "p.xlsx")
    assert rows[0] == ["'=name", "x"]
    assert [row[0] for row in rows[1:]] == ["'=cmd|' /C calc'!A0", "'@SUM(A1)", "-1", "plain", "'\tbehind"]
    assert [row[1] for row in rows[1:]] == [1.5, "", "", 2, True]
    first = (tmp_path / "p.xlsx").read_bytes()
    xlsx_out.write_sheets({"proposals": TABLE, "about": {"what": ["x"]}}, tmp_path / "p.xlsx")
    assert (tmp_path / "p.xlsx").read_bytes() == first
    with zipfile.ZipFile(tmp_path / "p.xlsx") as parts:  # in which a second that has passed would show as well
        dates = re.findall(r">([^<]+)</dcterms:(created|modified)>", parts.read("docProps/core.xml").decode())
        assert dates == [("2000-01-01T00:00:00Z", "created"), ("2000-01-01T00:00:00Z", "modified")]
        assert {each.date_time for each in parts.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_control_and_half_characters_are_shown_as_escapes(tmp_path):
    pytest.importorskip("xlsxwriter")
    xlsx_out.write_sheets({"proposals": {"a\x1b": ["\ud800", "x\u202ey"]}}, tmp_path / "p.xlsx")
    assert read(tmp_path / "p.xlsx") == [["a\\x1b"], ["\\ud800"], ["x\\u202ey"]]


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ({"a": ["x" * 32_768]}, "column a has a text of more than 32,767 letters in row 0; take the CSV"),
        ({"a": range(1_048_576)}, "sheet proposals would have 1,048,577 rows, and a spreadsheet holds 1,048,576; take the CSV"),
    ],
)
def test_what_no_spreadsheet_holds_is_refused(tmp_path, table, line):
    pytest.importorskip("xlsxwriter")
    with pytest.raises(UserError, match=line):
        xlsx_out.write_sheets({"proposals": table}, tmp_path / "p.xlsx")
    assert not (tmp_path / "p.xlsx").exists()


def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)
    with pytest.raises(UserError, match=r"written with XlsxWriter: install the extra tables"):
        xlsx_out.write_sheets({"proposals": {"a": [1]}}, tmp_path / "p.xlsx")
