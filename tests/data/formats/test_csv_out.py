"""Cells that a spreadsheet would compute are neutralised in every CSV, and numbers stay numbers."""

import csv
import io

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv as arrow_csv

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.csv_out import cell, write_rows, write_table
from deadreckon.data.formats.tables import write_csv
from deadreckon.mbo.designs import Designs
from deadreckon.report.theory.drawing import columns

FORMULAS = [
    "=1+1", "=cmd|' /C calc'!A0", "+cmd|x", "-cmd|x", "-2+3+cmd|x", "@SUM(A1)", "\t=1", "\r=1", "\n=1", " =1",
    "\u00a0=1", "＝1+1", "＠A1", "-A1", "+49 (0)", "=", "=-1.5", "--1", "-e5", "+e5", "-1e5x", "- 1 + A2", "\tplain",
]  # fmt: skip
HARMLESS = [
    "", "plain", "a=b", "a@b", "-1.5", "+2", "-1,234.5", "-.5", "-1.", "-1e-05", "+1E5", "-10%", "-10 %", "-", "+", "-inf",
    "+nan", " -3 ", "1-2", "'=1", "2024-03-01",
]  # fmt: skip


@pytest.mark.parametrize("text", FORMULAS)
def test_formulas_are_texts(text):
    assert cell(text) == f"'{text}"


@pytest.mark.parametrize("value", [*HARMLESS, -1.5, -3, None, True, np.float32(-2)])
def test_numbers_and_plain_texts_stay(value):
    assert cell(value) is value


@pytest.mark.parametrize(
    "kind",
    [pa.string(), pa.large_string(), pa.string_view(), pa.dictionary(pa.int32(), pa.string()), pa.binary(), pa.large_binary()],
    ids=str,
)
def test_tables_of_every_kind_of_text(kind, tmp_path):
    texts = [*FORMULAS, None, *HARMLESS[1:]]
    given = [each if each is None or "binary" not in str(kind) else each.encode() for each in texts]
    parts = [pa.array(given[:5]), pa.array(given[5:])]
    column = pa.chunked_array([each.dictionary_encode() if "dictionary" in str(kind) else each.cast(kind) for each in parts])
    numbers = np.linspace(-2, 2, len(texts))
    write_table({"=name": column, "x": numbers}, tmp_path / "t.csv")
    options = arrow_csv.ParseOptions(newlines_in_values=True), arrow_csv.ConvertOptions(column_types={"'=name": pa.string()})
    back = arrow_csv.read_csv(tmp_path / "t.csv", parse_options=options[0], convert_options=options[1])
    assert back.column_names == ["'=name", "x"]
    assert back["'=name"].to_pylist() == ["" if each is None else cell(each) for each in texts]
    np.testing.assert_array_equal(back["x"].to_numpy(), numbers)


def test_a_table_without_formulas_is_written_as_before(tmp_path):
    table = pa.table({"a": ["x", None, "-1.5"], "b": [-1.5, None, 2.0], "c": [1, 2, 3]})
    write_table(table, tmp_path / "ours.csv")
    arrow_csv.write_csv(table, tmp_path / "arrows.csv")
    assert (tmp_path / "ours.csv").read_bytes() == (tmp_path / "arrows.csv").read_bytes()


def test_every_writer_neutralises(tmp_path):
    """A log, proposals, theory's columns and rows of a benchmark; `predict` is in the tests of the command."""
    evil = "=cmd|' /C calc'!A0"
    four = {"observations": np.zeros((4, 1)), "actions": np.zeros((4, 1)), "rewards": np.ones(4), "timeouts": np.ones(4, bool)}
    log = Dataset.from_arrays(**four, **{evil: -np.ones(4)})
    write_csv(log, tmp_path / "log.csv")
    data = Designs.from_frame({evil: np.linspace(-2.5, 3, 12), "@b": [evil, "+b", "c"] * 4, "y": np.arange(12.0)}, "y")
    data.write(tmp_path / "proposals.csv", data.x, {"-A1": -np.ones(12)})
    columns(tmp_path / "theory.csv", {evil: np.array([-1.5, 2.0]), "x": np.array([evil, "-A1"])})
    out = io.StringIO()
    write_rows(out, [["on", "method"], [evil, "-A1"], [-1.5, "-1.5"]])
    texts = [(tmp_path / f"{name}.csv").read_text() for name in ("log", "proposals", "theory")]
    for text in (*texts, out.getvalue()):
        cells = [each for row in csv.reader(io.StringIO(text, newline="")) for each in row]
        assert f"'{evil}" in cells
        assert [each for each in cells if cell(each) != each] == []
        assert {"-1", "-1.5"} & set(cells)
