"""Tables of experiments as people have them: blanks, planned runs, missing cells, dates, slipped digits and yes or no."""

import warnings

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from deadreckon.cli.main import main
from deadreckon.errors import UserError
from deadreckon.mbo.design_draft import describe
from deadreckon.mbo.design_schema import DesignColumn, DesignSchema
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.doubts import far
from deadreckon.mbo.front import targets_of


def frame(rows=18, **changes):
    rng = np.random.default_rng(0)
    columns = {
        "temp": rng.uniform(42, 110, rows).round(1).tolist(), "solvent": ["DMF", "THF", "EtOH"] * (rows // 3),
        "y": rng.normal(5, 1, rows).round(3).tolist(),
    }  # fmt: skip
    return columns | changes


def told(read, *args, **options):
    """What is read, and the lines on it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = read(*args, **options)
    return made, [str(each.message) for each in caught]


def write(path, columns):
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    path.write_text("\n".join(",".join("" if cell is None else str(cell) for cell in row) for row in rows) + "\n")
    return path


def test_blanks_at_the_ends_of_texts_make_no_levels(tmp_path):
    columns = frame(solvent=["DMF", "DMF ", "\u00a0THF"] * 6)
    rule = {"forbidden": ["temp > 70 & solvent = DMF"]}
    for data in (
        Designs.from_frame(columns, "y", **rule), Designs.from_csv(write(tmp_path / "t.csv", columns), "y", **rule),
        Designs.from_frame(columns, "y", levels={"solvent": ["DMF ", "THF"]}, **rule),
        Designs.from_frame(columns | {"solvent": pa.array(columns["solvent"]).dictionary_encode()}, "y", **rule),
    ):  # fmt: skip
        assert data.variables[1].levels == ("DMF", "THF")
        assert data.encode({"temp": [60.0], "solvent": ["DMF  "]})[0, 1] == 0
    assert describe(tmp_path / "t.csv", "y")[0].columns["solvent"].levels == ("DMF", "THF")
    with pytest.raises(UserError, match="solvent is empty in row 2, counted from 0; fill the cells in, leave the rows out"):
        Designs.from_frame(frame(solvent=["DMF", "THF", " ", *["DMF"] * 15]), "y")


def test_levels_that_differ_in_case_alone_are_told():
    data, lines = told(Designs.from_frame, frame(solvent=["THF", "thf", "DMF"] * 6), "y")
    assert data.variables[1].levels == ("DMF", "THF", "thf")
    (line,) = lines
    assert line.startswith("frame: column solvent has levels that differ in upper and lower case alone: THF and thf; they are")
    assert told(Designs.from_frame, frame(), "y")[1] == []


def test_rows_without_a_score_are_planned_runs_and_no_data(tmp_path):
    full = frame()
    y = [None if row in (0, 7, 8) else score for row, score in enumerate(full["y"])]
    temp = [None if row == 7 else 500.0 if row == 0 else value for row, value in enumerate(full["temp"])]
    path = write(tmp_path / "t.csv", full | {"y": y, "temp": temp})
    data, lines = told(Designs.from_csv, path, "y")
    assert lines == ["t: 3 rows left out, as planned and without y yet: rows 0, 7 to 8, counted from 0"]
    assert len(data) == 15
    assert data.variables[0].high == max(value for row, value in enumerate(full["temp"]) if row not in (0, 7, 8))
    kept = [row for row in range(18) if row not in (0, 7, 8)]
    assert data.numbered(np.arange(15)).tolist() == kept  # rows are called as they stand in the file
    np.testing.assert_allclose(data.y, np.array(full["y"])[kept])
    schema, lines = describe(path)
    assert lines == ["the last column of numbers, y, is taken as the target (--target)",
                     "3 rows left out, as planned and without y yet: rows 0, 7 to 8, counted from 0"]  # fmt: skip
    assert schema.named("input") == ["temp", "solvent"]
    np.testing.assert_array_equal(told(schema.read, path)[0].x, data.x)


def test_rows_after_planned_runs_keep_their_numbers():
    full = frame()
    y = [None, None, *full["y"][2:]]
    for changes, options, words in (
        ({}, {"bounds": {"temp": (0, 30)}}, r"in row 2, outside the bounds"),
        ({"solvent": ["DMF"] * 17 + ["oil"]}, {"levels": {"solvent": ["DMF"]}}, "unknown level 'oil' in row 17"),
        ({"temp": [*full["temp"][:5], float("inf"), *full["temp"][6:]]}, {}, "column temp has inf in row 5"),
        ({"se": [None, 0.1, *[0.1] * 15, -1.0]}, {"std_error": "se"}, "column se is -1 in row 17"),
        ({"temp": [*full["temp"][:4], None, *full["temp"][5:]]}, {}, "column temp is empty in row 4, counted from 0"),
        ({"y": [*y[:9], 1e160, *y[10:]]}, {}, "y is 1e.160 in row 9, and may be"),
    ):
        with pytest.raises(UserError, match=words):
            told(Designs.from_frame, full | {"y": y} | changes, "y", **options)


def test_of_several_targets_a_row_with_none_is_planned():
    full = frame()
    columns = full | {"y": [None, *full["y"][1:]], "z": [None, *full["y"][:0:-1]]}
    read = lambda **more: Designs.from_frame(columns, **more)  # noqa: E731
    made, lines = told(targets_of, read, ["y", "z"], [])
    assert [len(each) for each in made] == [17, 17]
    assert set(lines) == {"frame: 1 row left out, as planned and without y or z yet: row 0, counted from 0"}
    columns["z"][3] = None
    with pytest.raises(UserError, match="column z is empty in row 3, counted from 0; fill the cells in or leave the rows out$"):
        told(targets_of, read, ["y", "z"], [])


def test_all_missing_inputs_are_told_at_once():
    full = frame()
    holes = {
        "temp": [None if row in (2, 4, 6, 8, 10, 12, 14) else value for row, value in enumerate(full["temp"])],
        "solvent": [None if row in (3, 4, 5) else value for row, value in enumerate(full["solvent"])],
    }
    with pytest.raises(UserError) as error:
        Designs.from_frame(full | holes, "y")
    assert str(error.value) == (
        "frame: column temp is empty in rows 2, 4, 6, 8, 10 and 2 more, solvent is empty in rows 3 to 5, counted from 0; fill "
        "the cells in, leave the rows out, or ignore the columns (--ignore temp solvent)"
    )


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_nothing_is_told_of_columns_that_are_ignored(tmp_path, kind):
    path = tmp_path / f"t.{kind}"
    columns = frame(date=[f"{day:02}.03.2026" for day in range(1, 19)])
    parquet.write_table(pa.table(columns), path) if kind == "parquet" else write(path, columns)
    assert told(Designs.from_csv, path, "y", ignore=["date"])[1] == []
    roles = {"temp": DesignColumn("input"), "solvent": DesignColumn("input"), "y": DesignColumn("target")}
    assert told(DesignSchema(roles | {"date": DesignColumn("ignore")}).read, path)[1] == []
    with pytest.raises(UserError, match="column date holds times"):
        told(Designs.from_csv, path, "y")


def test_options_that_hints_name_are_those_of_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    columns = frame()
    text = write(tmp_path / "t.csv", columns).read_text().replace(",", "|")
    (tmp_path / "t.csv").write_text(text)
    assert main(["design", "t.csv", "--target", "y", "--separator", "pipe", "--method", "random", "-n", "2"]) == 0
    assert "separat" not in capsys.readouterr().err
    assert main(["design", "describe", "t.csv", "--separator", "pipe", "--save", "t.toml"]) == 0
    assert DesignSchema.load("t.toml").table["separator"] == "pipe"
    asked = ["--schema", "t.toml", "--separator", "comma"]  # what the command says goes before the schema
    assert main(["design", "t.csv", *asked, "--method", "random", "-n", "2", "--out", "x"]) == 2
    assert "separat" in capsys.readouterr().err


def test_a_slipped_digit_is_told():
    columns = frame()
    columns["temp"][3], columns["y"][5] = 900.0, 431.0
    least, most = (end(value for value in columns["temp"] if value != 900) for end in (min, max))
    data, lines = told(Designs.from_frame, columns, "y")
    assert data.variables[0].high == 900
    assert lines[0] == (
        f"frame: temp: 900 (row 3, counted from 0) is far from all others ({least:g} to {most:g}); the models learn from it: "
        f"mend it, or leave the row out, if it is a slip; --constraints '`temp` <= {most:g}' would keep proposals alone from "
        "there"
    )
    assert lines[1].startswith("frame: y: 431 (row 5, counted from 0) is far from all others (")
    assert data.noticed == tuple(line.removeprefix("frame: ") for line in lines)
    assert told(Designs.from_frame, columns, "y", bounds={"temp": (0, 900)})[1] == lines[1:]
    drafted = {"bounds": {"temp": (least, 900.0)}}  # the range of the data is nobody's word
    assert told(Designs.from_frame, columns, "y", **drafted)[1] == lines
    for rule in ({"constraints": [f"`temp` <= {most:g}"]}, {"fixed": ["temp = 60"]}):  # proposals are kept from there already
        assert told(Designs.from_frame, columns, "y", **rule)[1] == [lines[0].partition("; --constraints")[0], *lines[1:]]


def test_a_level_of_one_row_that_is_nearly_another_is_told():
    columns = frame()
    columns["solvent"] = ["ethanol", "water", "toluene"] * (len(columns["y"]) // 3) + ["water"] * (len(columns["y"]) % 3)
    assert told(Designs.from_frame, columns, "y")[1] == []
    columns["solvent"][4] = "wather"
    (line,) = told(Designs.from_frame, columns, "y")[1]
    assert line.startswith("frame: column solvent has wather in one row, which is written nearly as water; they are different")
    columns["solvent"] = [f"cat{i % 9 + 1}" for i in range(len(columns["y"]))]
    columns["solvent"][4] = "cat10"  # names with numbers are alike on purpose
    assert told(Designs.from_frame, columns, "y")[1] == []


def test_rows_that_break_a_sum_which_others_hold_are_told():
    rng = np.random.default_rng(0)
    parts = rng.dirichlet([2.0] * 3, 20).round(3)
    parts[:, 2] = 1 - parts[:, :2].sum(1)
    columns = dict(zip("abc", parts.T)) | {"y": rng.normal(size=20)}
    mixture = {"mixtures": [list("abc")]}
    assert told(Designs.from_frame, columns, "y", **mixture)[1] == []
    columns["c"][7] += 0.3
    (line,) = told(Designs.from_frame, columns, "y", **mixture)[1]
    assert line.startswith("frame: a + b + c = 1 does not hold in row 7, counted from 0; the models learn from these")
    percent = {name: 100 * columns[name] for name in "abc"} | {"y": columns["y"]}
    with pytest.raises(UserError, match=r"in the data they sum to 100, so say --constraints 'a \+ b \+ c = 100' instead"):
        Designs.from_frame(percent, "y", **mixture)


def test_few_rows_are_too_few_and_nothing_else_is_wrong():
    for rows in (1, 2, 4):
        with pytest.raises(UserError, match=f"{rows} rows? (is|are) too few to learn from, 10 or more are needed"):
            Designs.from_frame({"a": list(range(rows)), "y": list(range(rows))}, "y")


RNG = np.random.default_rng(1)
DRAWN = {
    "normal": RNG.normal, "uniform": RNG.uniform, "log-normal": lambda size: RNG.lognormal(0, 1, size),
    "log-normal and shifted": lambda size: RNG.lognormal(0, 1, size) - 1, "negative": lambda size: -RNG.lognormal(0, 1, size),
    "bimodal": lambda size: RNG.choice([0.0, 30.0], size) + RNG.normal(size=size), "t": lambda size: RNG.standard_t(3, size),
    "logarithmic levels": lambda size: RNG.choice([0.1, 1, 10, 100], size), 
    "levels": lambda size: RNG.choice([20, 80, 90], size), "mostly zero": lambda size: np.where(np.arange(size), 0, 50),
    "a rare level": lambda size: np.where(np.arange(size), 20, 800),
    "with a control": lambda size: np.append(RNG.uniform(50, 60, size - 1), 0),
}  # fmt: skip


@pytest.mark.parametrize("kind", DRAWN)
def test_tails_modes_and_levels_are_no_slips(kind):
    shape = {"size": 30}
    assert sum(far(np.asarray(DRAWN[kind](**shape), float)) is not None for _ in range(300)) <= 2
    if kind in ("normal", "uniform"):
        assert far(np.append(50 + DRAWN[kind](**shape), 500.0)) == 30
        assert far(np.append(50 + DRAWN[kind](**shape), 5.0)) == 30


def test_a_score_of_0_and_1_is_told():
    data, lines = told(Designs.from_frame, frame(y=[0, 1, 1] * 6), "y")
    assert set(data.y) == {0.0, 1.0}
    said = "frame: y has only the values 0 and 1: predictions are of its mean (a rate), and may lie below 0 or above 1"
    assert lines == [said]
    assert told(Designs.from_frame, frame(y=[True, False, False] * 6), "y", minimise=True)[1] == [said]
