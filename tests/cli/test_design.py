"""`deadreckon design` from a CSV to proposals, and its one-line errors."""

import csv
import re

import numpy as np
import pytest

from deadreckon.cli.main import main

FORWARD = ["--method", "forward", "--method.hidden", "8", "--method.steps", "50", "--method.ascent", "10"]


@pytest.fixture
def table(tmp_path, monkeypatch):
    """An alloy's costs: a bowl over a number and a whole number, and one of three colours that is cheapest."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(60):
        heat, layers, colour = rng.uniform(0, 10), rng.integers(1, 6), rng.choice(["red", "green", "blue"])
        rows.append([f"{heat:.3f}", layers, colour, f"{(heat - 4) ** 2 + (layers - 3) ** 2 + (colour == 'red'):.3f}"])
    with open("alloys.csv", "w", newline="") as file:
        csv.writer(file).writerows([["heat", "layers", "colour", "cost"], *rows])
    for name, scores in (("few", range(9)), ("same", [1] * 12), ("hole", [0, 1, 2, 3, *range(8)])):
        with open(f"{name}.csv", "w", newline="") as file:
            inputs = ["" if name == "hole" and i == 3 else i / 2 for i in range(len(scores))]
            csv.writer(file).writerows([["a", "y"], *zip(inputs, scores)])
    return tmp_path


@pytest.mark.slow
def test_from_a_table_to_proposals(table, capsys):
    asked = ["--data", "alloys.csv", "--target", "cost", "--minimise", "-n", "5", "--bounds", "heat", "0", "12"]
    assert main(["design", *FORWARD, *asked]) == 0
    out, told = (text.splitlines() for text in capsys.readouterr())
    assert out[0].startswith("alloys: 60 designs, 3 variables (heat, layers, colour with 3 levels); best cost 0.")
    assert out[1].startswith("Forward: 5 proposals, best predicted ")
    # So small and short a network knows nothing of designs that it has not seen, and that is said.
    assert out[2].startswith("Forward out of fold: R2 -")
    doubt = "! the model's order of unseen designs cannot be distinguished from chance (rank corr"
    assert any(line.startswith(doubt) for line in told)
    with open(out[3], newline="") as file:
        rows = list(csv.DictReader(file))
    beside = ["predicted", "predicted_std", "predicted_low", "predicted_high", "distance", "nearest_row", "nearest_score"]
    assert list(rows[0]) == ["heat", "layers", "colour", *beside]
    assert len(rows) == 5
    for row in rows:
        assert 0 <= float(row["heat"]) <= 12
        assert row["layers"] in "12345"
        assert row["colour"] in ("red", "green", "blue")
    # Costs as the table holds them, not their negatives.
    assert f"{min(float(row['predicted']) for row in rows):,.4g}" in out[1]
    page = (table / "runs" / "design" / "forward-alloys" / "report.html").read_text()
    assert out[-1].endswith("report.html")
    sheet = table / "runs" / "design" / "forward-alloys" / "proposals.xlsx"
    if not sheet.exists():  # the one line that says which extra is missing
        why = "! proposals.xlsx is not written: spreadsheets are written with XlsxWriter: install the extra tables"
        assert any(line.startswith(why) for line in told)
        return
    calamine = pytest.importorskip("python_calamine")
    book = calamine.CalamineWorkbook.from_path(str(sheet))
    assert book.sheet_names == ["proposals", "about"]
    written = book.get_sheet_by_name("proposals").to_python()
    assert written[0] == list(rows[0])
    np.testing.assert_allclose([row[3] for row in written[1:]], [float(row["predicted"]) for row in rows], rtol=1e-12)
    assert "order of unseen designs cannot be distinguished from chance" in page
    for said in ("5 designs for cost", "typical distances", "colour"):
        assert said in page


def test_with_a_judge(table, capsys):
    assert main(["design", *FORWARD, "--problem", "branin", "-n", "4", "--out", "b"]) == 0
    out = capsys.readouterr().out
    assert "Forward on branin: best of 4 " in out
    assert "the oracle is exact; the greatest score is -0.397887" in out
    with open("b/proposals.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    assert f"{max(float(row['true']) for row in rows):,.4g}" in out
    assert "Above the dashed line the score is overestimated" in (table / "b" / "report.html").read_text()


@pytest.mark.parametrize(
    ("args", "line"),
    [
        ([], "design needs --data FILE --target COLUMN, or --problem NAME"),
        (["--method", "nimo"], "unknown designer 'nimo': did you mean nemo?"),
        (["--method", "best"], "design needs --data FILE --target COLUMN, or --problem NAME"),
        (["--method", "best", "--data", "alloys.csv"], "missing --target, the column of the scores"),
        (["--method", "best", "--data", "alloys.csv", "--target", "price"], "alloys: unknown column 'price': known: "),
        (["--method", "best", "--data", "nothing.csv", "--target", "cost"], "no file nothing.csv"),
        (["--method", "best", "--problem", "brannin"], "unknown problem 'brannin': did you mean branin or "),
        (["--method", "best", "--problem", "branin", "--apart", "1"], "--apart is about a table of your own (--data)"),
        (["--method", "best", "--problem", "branin", "--minimise"], "--minimise is about a table of your own (--data)"),
        (["--method", "best", "--data", "alloys.csv", "--target", "cost", "--reference", "cost", "1"],
         "--reference is the point that hypervolumes of --targets are measured from"),
        (["--method", "best", "--problem", "branin", "--sheet", "2"], "--sheet is about a table of your own (--data)"),
        (["--method", "best", "--problem", "branin", "--path", "x"], "unknown option of branin 'path'"),
        (["--method", "best", "--data", "alloys.csv", "--target", "cost", "--path", "x"], "--path is the file of a --problem"),
        (["--method", "best", "--data", "alloys.csv", "--target", "cost", "-n", "0"], "n must be 1 or more, got 0"),
        (["--method", "best", "--data", "alloys.csv", "--target", "cost", "--bounds", "heat", "2", "12"],
         "alloys: column heat has "),
        (["--method", "best", "--data", "alloys.csv", "--target", "cost", "--kinds", "heat", "colourful"],
         "alloys: column heat: unknown kind 'colourful'"),
        (["--method", "best", "--data", "alloys.csv", "--target", "cost", "--bounds", "cost", "0", "1"],
         "alloys: bounds is of inputs, and cost is the target"),
        (["--method", "best", "--data", "alloys.csv", "--target", "cost", "--levels", "colour", "red,green"],
         "alloys: column colour has the unknown level 'blue' in row "),
        (["--data", "alloys.csv", "--target", "cost", "--bounds", "heat", "2"],
         "--bounds takes names and values in turn, with blanks between them: STR FLOAT FLOAT"),
        (["--data", "alloys.csv", "--target", "cost", "--weights", "heat=-0.1"],
         "--weights takes names and values in turn, with blanks between them: STR FLOAT"),
        (["--method", "best", "--data", "few.csv", "--target", "y"], "few: 9 rows are too few"),
        (["--method", "best", "--data", "same.csv", "--target", "y"], "same: y is 1 in all rows, so no design"),
        (["--method", "best", "--data", "hole.csv", "--target", "y"], "hole: column a is empty in row 3, counted from 0; fill"),
        (["bench", "--seeds", "0"], "--seeds must be 1 or more, got 0"),
        (["bench", "--together", "-1"], "--together must be 1 or more, got -1"),
        (["bench", "--problems", "nk,brannin", "--methods", "best", "--seeds", "1"], "unknown problem 'brannin': did"),
        (["bench", "--problems", "nk,gfp-gp", "--methods", "best", "--seeds", "1"], "gfp-gp needs avgfp.tsv (variants of"),
        (["bench", "--problems", "nk,gfp", "--methods", "best", "--seeds", "1", "--paths", "gfp", "no"], "gfp needs avgfp.tsv"),
        (["bench", "--problems", "nk", "--methods", "best", "--seeds", "1", "--paths", "nk", "x"], "unknown option of nk"),
        (["bench", "--problems", "nk", "--paths", "gfp", "x"], "--paths names gfp, which is not among --problems"),
    ],
)  # fmt: skip
def test_bad_input_in_one_line(table, capsys, args, line):
    assert main(["design", *args]) == 2
    told = capsys.readouterr().err.strip()
    assert told.startswith(f"deadreckon: {line}")
    assert "\n" not in told
    assert not (table / "runs").exists()


def test_lists(capsys):
    assert main(["design", "problems"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^gfp +avgfp.tsv \(missing\)", out, re.M)
    assert main(["design", "methods"]) == 0
    assert "nemo" in capsys.readouterr().out


def test_bench(tmp_path, capsys):
    asked = ["design", "bench", "--problems", "branin,nk", "--methods", "best,random", "--seeds", "3", "-n", "8"]
    assert main([*asked, "--out", str(tmp_path / "b")]) == 0
    out = capsys.readouterr().out
    assert out.count("| branin |") == 7  # best, median, both normalised, and three that tell whom to trust
    assert "random on nk" in out
    assert "Median design, by the oracle" in out


@pytest.mark.parametrize(
    ("names", "name"),
    [
        (["a", "b", "yield", "std_yield"], "predicted_std_yield"),
        (["a", "predicted_y", "y", "y_"], "predicted_y_"),  # the input predicted_y has an underscore put behind the first
    ],
)
def test_targets_whose_columns_would_have_one_name_are_refused(table, capsys, names, name):
    with open("two.csv", "w", newline="") as file:
        csv.writer(file).writerows([names, *np.random.default_rng(0).uniform(0, 1, (16, 4)).round(2).tolist()])
    assert main(["design", "two.csv", "--targets", *names[2:], "-n", "2", "--out", "f"]) == 2
    assert capsys.readouterr().err.strip() == (
        f"deadreckon: two: targets {names[2]} and {names[3]} would both have the column {name} of the proposals; "
        "rename one of them in the table"
    )
    assert not (table / "f").exists()
