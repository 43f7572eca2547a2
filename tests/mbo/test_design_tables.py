"""Tables of experiments as people have them: blanks, planned runs, missing cells, dates, slipped digits and yes or no."""

import shlex
import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

from deadreckon.cli.main import main
from deadreckon.data.formats.csv_out import cell as as_cell
from deadreckon.errors import UserError
from deadreckon.mbo import designer
from deadreckon.mbo.batch import batch, check_batch
from deadreckon.mbo.design_draft import describe
from deadreckon.mbo.design_schema import DesignColumn, DesignSchema
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.doubts import far
from deadreckon.mbo.forward import Forward
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
    assert lines == ["t: 3 rows without y left out, as planned: rows 0, 7 to 8, counted from 0; give a run that failed a "
                     "score, such as the worst one; complete ones are not proposed again (--repeat allows it)"]  # fmt: skip
    assert len(data) == 15
    assert data.variables[0].high == max(value for row, value in enumerate(full["temp"]) if row not in (0, 7, 8))
    kept = [row for row in range(18) if row not in (0, 7, 8)]
    assert data.numbered(np.arange(15)).tolist() == kept  # rows are called as they stand in the file
    np.testing.assert_allclose(data.y, np.array(full["y"])[kept])
    schema, lines = describe(path)
    assert lines == ["the last column of numbers, y, is taken as the target (--target)",
                     "3 rows without y left out, as planned: rows 0, 7 to 8, counted from 0; give a run that failed a score, "
                     "such as the worst one"]  # fmt: skip
    assert schema.named("input") == ["temp", "solvent"]
    np.testing.assert_array_equal(told(schema.read, path)[0].x, data.x)


@pytest.mark.parametrize("european", [False, True])
def test_rows_without_a_score_do_not_decide_how_a_column_is_read(tmp_path, european):
    full = frame(speed=[100 + i % 4 for i in range(18)], cost=[i / 4 for i in range(18)])
    planned = [("TBD", "DMF", "", 102, "low"), (60.5, "?", "", "tbd", 1.5), (60.5, "DMF", "", 103, "?")]
    rows = [list(map(str, row)) for row in [full, *zip(*full.values()), *planned]]
    text = "\n".join(";".join(row).replace(".", ",") if european else ",".join(row) for row in rows)
    (tmp_path / "t.csv").write_text(text + "\n")
    data, lines = told(Designs.from_csv, tmp_path / "t.csv", "y", weights={"cost": -1.0})
    assert {v.name: v.kind for v in data.variables} == {"temp": "continuous", "solvent": "categorical", "speed": "integer"}
    assert data.variables[1].levels == ("DMF", "EtOH", "THF")
    np.testing.assert_allclose(data.unscored, [[60.5, 0, 103]])  # the only complete one
    told_of = [line.partition(": ")[2] for line in lines if "is read" in line and "decimal" not in line]
    assert told_of == [
        f"column {name} is read by the rows with a score; {cell!r} in row {row}, which has none, counts as missing"
        for name, cell, row in (("temp", "TBD", 18), ("speed", "tbd", 19), ("cost", "low", 18))
    ]
    schema, lines = describe(tmp_path / "t.csv", "y")
    assert [schema.columns[name].kind for name in ("temp", "speed", "cost")] == ["continuous", "integer", "continuous"]
    assert not any("as texts" in line for line in lines)
    np.testing.assert_array_equal(told(schema.read, tmp_path / "t.csv")[0].x[:, :3], data.x)


def test_cells_of_planned_runs_are_kept_where_others_are_words(tmp_path):
    """Lost ones could be proposed again."""
    full = frame(15, t=[50 + 10 * (i % 5) for i in range(15)])
    planned = {"temp": [60.5] * 3, "solvent": ["DMF"] * 3, "t": ["65", "2024-01-05", "55"], "y": [None] * 3}
    path = write(tmp_path / "t.csv", {name: full[name] + planned[name] for name in full})
    data, lines = told(Designs.from_csv, path, "y")
    assert data.unscored[:, 2].tolist() == [65, 55]
    assert any("column t is read by the rows with a score; '2024-01-05' in row 16, which has" in line for line in lines)
    forms = write(tmp_path / "f.csv", {"t": [*range(1990, 2005), "55", "'1,234'", "TBD"], "y": [*range(15), "", "", ""]})
    forms.write_text(forms.read_text().replace("'", '"'))
    assert told(Designs.from_csv, forms, "y", thousands=",")[0].unscored.tolist() == [[55]]  # 1990 is of another form


def test_the_levels_that_are_said_decide_how_planned_runs_are_read(tmp_path):
    full = frame(15, g=["1", "2", "3"] * 5)
    planned = {"temp": [60.5] * 2, "solvent": ["DMF"] * 2, "g": ["4A", "2"], "y": [None] * 2}
    path = write(tmp_path / "t.csv", {name: full[name] + planned[name] for name in full})
    names = {"g": ["1", "2", "3", "4A"]}
    schema = DesignSchema({"y": DesignColumn("target"), "temp": DesignColumn("input"), "solvent": DesignColumn("input"),
                           "g": DesignColumn("input", "categorical", levels=tuple(names["g"]))})  # fmt: skip
    for read in (lambda: Designs.from_csv(path, "y", kinds={"g": "categorical"}, levels=names), lambda: schema.read(path)):
        data, _ = told(read)
        assert data.variables[2].levels == ("1", "2", "3", "4A")
        assert data.unscored[:, 2].tolist() == [3, 1]
    assert told(Designs.from_csv, path, "y", kinds={"g": "categorical"})[0].variables[2].levels == ("1", "2", "3")
    for levels in ([1, 2, 3], ["1", "2", "3"]):  # numbers stay numbers, in order
        data, _ = told(Designs.from_csv, path, "y", kinds={"g": "ordinal"}, levels={"g": levels})
        assert data.variables[2].levels == (1, 2, 3)
        assert data.unscored[:, 2].tolist() == [1]


def test_texts_of_parquet_are_not_converted_for_the_sake_of_planned_runs(tmp_path):
    full = frame(15, t=[str(50 + 10 * (i % 5)) for i in range(15)], code=["1e5", "2e3", "3e4"] * 5)
    planned = {"temp": [60.5] * 2, "solvent": ["DMF"] * 2, "t": ["55", "65"], "code": ["2e3"] * 2, "y": [None] * 2}
    parquet.write_table(pa.table({name: full[name] + planned[name] for name in full}), tmp_path / "t.parquet")
    data, lines = told(Designs.from_csv, tmp_path / "t.parquet", "y", kinds={"code": "categorical"})
    assert data.variables[3].levels == ("1e5", "2e3", "3e4")
    assert data.unscored[:, 2].tolist() == [55, 65]
    assert not any("counts as missing" in line for line in lines)
    schema, _ = describe(tmp_path / "t.parquet", "y")
    assert schema.columns["t"].kind == "integer"
    assert told(schema.read, tmp_path / "t.parquet")[0].unscored[:, 2].tolist() == [55, 65]


def test_what_a_reader_leaves_as_texts_is_no_number(tmp_path):
    """Versions in a file with decimal commas, and numbers with points that are said to separate no thousands."""
    full = frame(version=["1.1", "1.10", "1.2"] * 6, mass=["1.500", "2.500", "1.500"] * 6)
    rows = ["temp;solvent;y;version;mass"]
    rows += [";".join(map(str, row[:3])).replace(".", ",") + ";" + ";".join(row[3:]) for row in zip(*full.values())]
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    data, lines = told(Designs.from_csv, tmp_path / "t.csv", "y", thousands="none")
    assert [(v.kind, v.levels) for v in data.variables[2:]] == [
        ("categorical", ("1.1", "1.10", "1.2")), ("categorical", ("1.500", "2.500"))
    ]  # fmt: skip
    assert not any("is read so" in line for line in lines)
    schema, _ = describe(tmp_path / "t.csv", "y", thousands="none")
    assert [schema.columns[name].kind for name in ("version", "mass")] == ["categorical"] * 2
    assert told(schema.read, tmp_path / "t.csv")[0].variables == data.variables


def test_a_draft_of_a_schema_reads_its_file_whatever_planned_runs_hold(tmp_path):
    """Truth values, of which one planned run has TBD."""
    rows = [f"{i / 10},{'true' if i % 2 else 'false'},{i}" for i in range(24)]
    (tmp_path / "t.csv").write_text("\n".join(["a,flag,y", *rows, "3.3,TBD,"]) + "\n")
    schema, _ = describe(tmp_path / "t.csv", "y")
    assert len(schema.read(tmp_path / "t.csv")) == 24


def test_fixed_values_may_come_from_an_iterator():
    table = {"a": np.linspace(0.1, 0.3, 12), "b": np.linspace(0.5, 0.7, 12), "y": np.arange(12.0)}
    assert Designs.from_frame(table, "y", fixed=(text for text in ["b=0.5"])).rules.fixed == ((1, 0.5),)


def test_codes_of_more_digits_than_designs_hold_stay_texts():
    for pair in (["4012345678901", "4012345678918"], ["2e400", "1"], ["16777217", "3"]):
        assert told(Designs.from_frame, frame(code=pair * 9), "y")[0].variables[2].levels == tuple(sorted(pair))
    for pair in (["16777216", "3"], ["2e7", "1e8"]):
        assert told(Designs.from_frame, frame(code=pair * 9), "y")[0].variables[2].high == max(map(float, pair))


def test_texts_that_are_all_numbers_are_read_as_numbers(tmp_path):
    full = frame()
    temp, codes = [str(value) for value in full["temp"]], [f"{i % 4:02}" for i in range(18)]
    columns = full | {"temp": temp, "grade": [str(i % 5) for i in range(18)], "code": codes}
    for stored in (columns, columns | {"temp": [*temp[:4], f" {temp[4]} ", *temp[5:]]}, pa.table(columns)):
        data, lines = told(Designs.from_frame, stored, "y")
        assert {v.name: v.kind for v in data.variables} == {
            "temp": "continuous", "solvent": "categorical", "grade": "integer", "code": "categorical",
        }  # fmt: skip
        np.testing.assert_allclose(data.x[:, 0], full["temp"], rtol=1e-6)
        assert lines == [
            f"frame: column {name} holds texts that are all numbers, and is read so; if they are names, say kind categorical"
            for name in ("temp", "grade")
        ]
    said = {"kinds": {"temp": "continuous"}, "levels": {"grade": list("01234")}}
    data, lines = told(Designs.from_frame, columns, "y", **said)
    assert (data.variables[0].kind, data.variables[2].levels, lines) == ("continuous", tuple("01234"), [])
    parquet.write_table(pa.table(columns), tmp_path / "t.parquet")
    schema, lines = describe(tmp_path / "t.parquet", "y")
    assert [schema.columns[name].kind for name in ("temp", "grade", "code")] == ["continuous", "integer", "categorical"]
    assert sum("holds texts that are all numbers" in line for line in lines) == 2
    planned = columns | {"temp": ["TBD", temp[1], *temp[2:]], "y": [None, None, *full["y"][2:]]}
    assert told(Designs.from_frame, planned, "y")[0].unscored[:, 0] == pytest.approx(full["temp"][1])
    with pytest.raises(UserError, match="column temp holds '8O' in row 3, where most rows hold numbers; correct it"):
        Designs.from_frame(columns | {"temp": [*temp[:3], "8O", *temp[4:]]}, "y")


def test_whole_numbers_stay_so_beside_the_missing_cell_of_a_planned_run():
    """pandas and NumPy have no integers that are missing."""
    full = frame()
    layers, y = np.r_[np.arange(17.0) % 4, np.nan], [*full["y"][:-1], None]
    for columns in (full | {"layers": layers, "y": y}, pd.DataFrame(full | {"layers": layers, "y": y})):
        data, lines = told(Designs.from_frame, columns, "y")
        assert (data.variables[0].kind, data.variables[2].kind) == ("continuous", "integer")
        assert any("column layers holds whole numbers beside a missing cell (row 17), and" in line for line in lines)
    for other in (layers + 0.5, np.where(np.isnan(layers), 2.0, layers)):  # no whole numbers; nothing is missing
        assert told(Designs.from_frame, full | {"layers": other, "y": y}, "y")[0].variables[2].kind == "continuous"
    kinds = {"layers": "continuous"}
    assert told(Designs.from_frame, full | {"layers": layers, "y": y}, "y", kinds=kinds)[0].variables[2].kind == "continuous"
    listed = [None if np.isnan(value) else value for value in layers]  # 1.0 in Python is meant so
    assert told(Designs.from_frame, full | {"layers": listed, "y": y}, "y")[0].variables[2].kind == "continuous"
    table = pa.table(full | {"layers": pa.array(layers, mask=np.isnan(layers)), "y": y})  # which has
    assert told(Designs.from_frame, table, "y")[0].variables[2].kind == "continuous"


@pytest.mark.parametrize(
    "said",
    [{"steps": {"t": 0.5}}, {"bounds": {"t": (49.5, 80.5)}}, {"bounds": {"t": (0, np.inf)}}, {"fixed": ["t = 52.5"]}],
)
def test_what_is_said_of_other_numbers_makes_them_no_whole_numbers(said):
    full = frame(t=np.r_[50 + 10.0 * (np.arange(17) % 4), np.nan])
    columns = pd.DataFrame(full | {"y": [*full["y"][:-1], None]})
    data, lines = told(Designs.from_frame, columns, "y", **said)
    assert data.variables[2].kind == "continuous"
    assert not any("holds whole numbers" in line for line in lines)
    whole = {"steps": {"t": 5.0}, "bounds": {"t": (40.0, 90)}, "fixed": ["t = 50.0", "solvent = DMF"]}
    assert told(Designs.from_frame, columns, "y", **whole)[0].variables[2].kind == "integer"


def test_runs_without_a_score_are_not_proposed_again():
    """Nor do they teach: what has no score may have failed, or is to be predicted."""
    cells = [(a, b) for a in (1, 2, 3) for b in "wxyz"]
    cells = [*cells[:11], (None, "w"), (2, None), (9, "w"), (3, "new"), cells[10]]  # incomplete, beyond the bounds, no level
    frame = {"a": [a for a, _ in cells], "b": [b for _, b in cells], "y": [*map(float, range(10)), *[None] * 6]}
    data, lines = told(Designs.from_frame, frame, "y", bounds={"a": (1, 3)}, kinds={"a": "integer"})
    assert len(lines) == 2
    assert "column b has 'new' in row 14, which no row with a score has, so this run may be proposed again" in lines[1]
    assert (len(data), data.variables[0].high, data.variables[1].levels) == (10, 3, ("w", "x", "y", "z"))
    assert data.unscored.tolist() == [[3, 2], [9, 0], [3, 2]]
    for method in ("random", "gp"):
        made = designer(method, **({"rounds": 2, "folds": 0} if method == "gp" else {})).propose(data, 1)
        assert made.x.tolist() == [[3, 3]]
    with pytest.raises(UserError, match="2 proposals that differ and are not in the data .* only 1 were found"):
        batch(data, data.x, 2)
    with pytest.raises(UserError, match="or is in the data"):
        check_batch(data, data.unscored[:1], repeat=False)
    np.testing.assert_array_equal(batch(data, data.unscored[:1], 1, repeat=True), [[3, 2]])
    assert data.part(np.arange(10)).unscored is data.unscored


def test_proposals_can_be_appended_whatever_their_levels_begin_with(tmp_path):
    """A level such as +EDTA is written with an apostrophe, for spreadsheets, and read without it."""
    rng, path = np.random.default_rng(0), tmp_path / "log.csv"
    levels = ["-EDTA", "+EDTA", "=x", "'q"]
    path.write_text("add,temp,y\n" + "\n".join(f"{levels[i % 4]},{rng.normal():.3f},{rng.normal():.3f}" for i in range(40)))
    data = told(Designs.from_csv, path, "y")[0]
    assert data.variables[0].levels == ("'q", "+EDTA", "-EDTA", "=x")
    added = ("+EDTA", 1, 2), ("-EDTA", 2, ""), ("=x", 0, 1)
    rows = "\n".join(f"{as_cell(level)},{value},{score}" for level, value, score in added)
    assert rows.startswith("'+EDTA")
    path.write_text(f"{path.read_text()}\n{rows}\n")
    more = told(Designs.from_csv, path, "y")[0]
    assert more.variables[0].levels == data.variables[0].levels
    assert more.x[-2:].tolist() == [[1, 1], [3, 0]]
    assert more.unscored.tolist() == [[2, 2]]


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
    assert set(lines) == {"frame: 1 row without y or z left out, as planned: row 0, counted from 0; give a run that failed a "
                          "score, such as the worst one; complete ones are not proposed again (--repeat "
                          "allows it)"}  # fmt: skip
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


def test_a_budget_is_of_methods_with_published_sizes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "t.csv", frame())
    asked = ["design", "t.csv", "--target", "y", "-n", "2", "--out", "x"]
    for more in (["--budget", "full"], ["--budget", "cpu", "--method", "gp"]):
        assert main([*asked, *more]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"--budget says whether models have published sizes, and {more[-1] if more[2:] else 'auto'} has none" in line
        assert "take one of forward, ensemble" in line
    seen = []
    monkeypatch.setattr(Forward, "solve", lambda method, setting: seen.append(method.hidden) or [])
    for budget in ("full", "cpu"):
        main([*asked, "--method", "forward", "--budget", budget])  # nothing is proposed
    assert seen == [(2048, 2048), (256, 256)]


def test_a_slipped_digit_is_told():
    columns = frame()
    columns["temp"][3], columns["y"][5] = 900.0, 431.0
    least, most = (end(value for value in columns["temp"] if value != 900) for end in (min, max))
    data, lines = told(Designs.from_frame, columns, "y")
    assert data.variables[0].high == 900
    assert lines[0] == (
        f"frame: temp: 900 (row 3, counted from 0) is far from all others ({least:g} to {most:g}); the models are fitted to "
        f"it: correct it, or leave the row out, if it is an error; --constraints '`temp` <= {most:g}' would keep proposals "
        "within the others' range"
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
    assert line.startswith("frame: a + b + c = 1 does not hold in row 7, counted from 0; the models are fitted to these")
    percent = {name: 100 * columns[name] for name in "abc"} | {"y": columns["y"]}
    with pytest.raises(UserError, match=r"in the data they sum to 100, so say --constraints 'a \+ b \+ c = 100' instead"):
        Designs.from_frame(percent, "y", **mixture)


@pytest.mark.parametrize("rule", [{"mixtures": [["part a", "b"]]}, {"constraints": ["`part a`+b=1"]}])
def test_a_sum_of_percentages_that_a_message_names_can_be_said(rule):
    part = np.linspace(30, 70, 12)
    percent = {"part a": part, "b": 100 - part, "y": np.arange(12.0) % 5}
    with pytest.raises(UserError, match="in the data they sum to 100") as error:
        Designs.from_frame(percent, "y", **rule)
    said = shlex.split(str(error.value).partition("so say ")[2].partition(" instead;")[0])
    assert said == ["--constraints", "`part a` + b = 100"]
    assert told(Designs.from_frame, percent, "y", constraints=said[1:])[1] == []


def test_a_sum_that_most_rows_break_is_told():
    rng = np.random.default_rng(0)
    parts = rng.dirichlet([2.0] * 3, 20)
    columns = dict(zip("abc", parts.T)) | {"y": rng.normal(size=20)}
    said = {"mixtures": [["a", "b"]]}
    (line,) = told(Designs.from_frame, columns, "y", **said)[1]
    ends = f"{parts[:, :2].sum(1).min():.4g} to {parts[:, :2].sum(1).max():.4g}"
    assert line.startswith(f"frame: a + b = 1 does not hold in 20 of 20 rows, where the sum is {ends} instead of 1; proposals")


@pytest.mark.parametrize(("whole", "digits"), [(1, 4), (100, 2)])
@pytest.mark.parametrize("trace", [0.004, 0.02])
def test_parts_that_sum_to_a_whole_are_told_and_drafted(tmp_path, whole, digits, trace):
    """Two mixtures, one with a trace of a dopant, both rounded part by part, beside a number, a constant and a category."""
    rng = np.random.default_rng(0)
    first, second = (whole * rng.dirichlet([2.0] * size, 40) for size in (3, 3))
    dopant = trace * rng.uniform(size=(40, 1))
    first = np.concatenate([(1 - dopant) * first, whole * dopant], 1).round(digits)
    second = second.round(digits)
    columns = {"temp": rng.uniform(0, whole, 40).round(digits), "same": [whole / 2] * 40} | dict(zip("abcd", first.T))
    columns |= dict(zip(["u", "v w", "x"], second.T)) | {"kind": ["p", "q"] * 20, "y": rng.normal(size=40).round(3)}
    sums = [f"a + b + c + d = {whole}", f"u + `v w` + x = {whole}"]
    lines = told(Designs.from_frame, columns, "y")[1]
    assert len(lines) == 2
    for line, said in zip(lines, sums):
        assert line.startswith(f"frame: {said} in every row, and proposals need not")
        assert line.endswith(f"say --constraints {shlex.quote(said)}")
    path = write(tmp_path / "t.csv", columns)
    schema, lines = describe(path, "y")
    assert schema.constraints == tuple(sums)
    assert [line.partition(" in every")[0] for line in lines] == sums
    made, lines = told(schema.read, path)
    assert lines == []
    assert [each.text for each in made.rules.linear] == [each.replace("`", "") for each in sums]
    columns["a"] = columns["a"] + np.where(np.arange(40), 0, 0.1 * whole)  # no sum of all rows any more
    line, nearly = told(Designs.from_frame, columns, "y")[1]
    assert line.startswith(f"frame: {sums[1]} in every row")
    assert "are predicted by the other inputs" in nearly


def test_binary_numbers_and_names_hide_no_sum(tmp_path):
    a, b = np.array([0.1, 0.3, 0.9, 0.7] * 5), np.array([0.2, 0.4, 0.1, 0.1] * 5)
    columns = {"wt, a": a, "b": b, "c": 1 - a - b, "y": np.random.default_rng(0).normal(size=20).round(2)}
    assert columns["c"].min() < 0
    (line,) = told(Designs.from_frame, columns, "y", pool=False)[1]
    assert line.endswith("say --constraints '`wt, a` + b + c = 1'")
    columns = {"a`x": a, "z": 1 - a, "y": columns["y"]}  # no rule can name the first
    assert describe(write(tmp_path / "t.csv", columns), "y")[0].constraints == ()


def test_numbers_of_runs_are_told():
    numbers = frame(run=[*range(18, 0, -1)])
    (line,) = told(Designs.from_frame, numbers, "y")[1]
    assert line == (
        "frame: column run has each whole number from 1 to 18 once, and is taken for an input; if it is the number of the run, "
        "leave it out (--ignore run) or, if the process drifts, fix it at its latest value (--fix run=18)"
    )
    low, high = {"bounds": {"run": (0, 40)}}, {"bounds": {"run": (1, 18)}}
    assert told(Designs.from_frame, numbers, "y", **low)[1] == []
    assert told(Designs.from_frame, numbers, "y", **high)[1] == [line]  # as in a drafted schema
    for other in ([*range(2, 38, 2)], [1, 1, *range(2, 18)], [i + 0.5 for i in range(18)]):
        assert told(Designs.from_frame, frame(run=other), "y")[1] == []


def test_names_of_rows_are_refused_also_where_rows_are_copies(tmp_path):
    names = frame(sample=[f"S-{i:03}" for i in range(18)])
    for copies in ([], [4], [4, 4, 7]):  # rows of the file, once more
        columns = {key: [*values, *(values[row] for row in copies)] for key, values in names.items()}
        with pytest.raises(UserError, match=r"sample holds 18 different values in 18 designs.*ignore it \(--ignore sample\)"):
            told(Designs.from_frame, columns, "y")
        schema, lines = describe(write(tmp_path / "t.csv", columns), "y")
        assert schema.columns["sample"].role == "ignore"
        assert schema.named("input") == ["temp", "solvent"]
        assert any(line.startswith("column sample holds 18 different values") for line in lines)
    assert len(told(Designs.from_frame, names, "y", kinds={"sample": "categorical"})[0].variables) == 3
    both = frame(24, sample=[f"S-{i % 12:02}" for i in range(24)])
    both["temp"] = (both["temp"][:12] * 2)[:24]  # of the same designs, but for their numbers
    both["solvent"] = (both["solvent"][:12] * 2)[:24]
    for order in ({"row": [f"r{i}" for i in range(24)]} | both, both | {"row": [f"r{i}" for i in range(24)]}):
        schema, lines = describe(write(tmp_path / "t.csv", order), "y")
        assert schema.named("input") == ["temp", "solvent"]
    few = frame(36, sample=[f"S-{i % 18:03}" for i in range(36)])  # each in two designs: something can be learned
    assert len(told(Designs.from_frame, few, "y")[0].variables) == 3


@pytest.mark.parametrize(
    ("cell", "unit"),
    [("{}%", "%"), ("{} C", "C"), ("{} °C", "°C"), ("{}.5mg/l", "mg/l"), ("-{},1 %", "%"), ("{} mol %", "mol %")],
)
def test_numbers_with_a_unit_are_no_categories(cell, unit):
    columns = frame(dose=[f"none of {unit}", *(cell.format(i % 6) for i in range(17))])
    for dose in (columns["dose"], pa.array(columns["dose"], pa.large_string())):
        with pytest.raises(UserError, match=f"dose holds texts such as '{cell.format(0)}'; take the '{unit}' off") as error:
            told(Designs.from_frame, columns | {"dose": dose}, "y")
    assert ("40% is 0.4" in str(error.value)) == (unit == "%")
    told(Designs.from_frame, columns, "y", kinds={"dose": "categorical"})
    steels = ["4CzIPN", "4CzIPN", "Ru(bpy)3"], ["316L", "304L", "316L"]
    others = ["5-methyl", "6-methyl", "7-methyl"], ["1e3x", "x1", "x2"], ["A 1", "B 2", "C 3"]
    for names in (*steels, *others, ["3A", "4B", "5C"]):
        told(Designs.from_frame, frame(dose=names * 6), "y")


def test_a_number_that_follows_from_others_is_told():
    rng = np.random.default_rng(5)
    columns = frame(30, conc=rng.uniform(0, 1, 30).round(2), flow=rng.normal(size=30))
    price = {"DMF": 3.0, "THF": 8.0, "EtOH": 1.0}
    cost = np.array([price[each] for each in columns["solvent"]]) + 0.5 * np.array(columns["temp"]) + 2 * columns["conc"]
    (line,) = told(Designs.from_frame, columns | {"cost": cost.round(3)}, "y")[1]
    assert line == (
        "frame: temp, solvent, conc and cost satisfy a linear relation in every row, and proposals need not; ignore one that "
        "follows from the others, as a cost does, or say the relation as a constraint"
    )
    rule = {"constraints": ["`cost` - 0.5 temp = 3"], "bounds": {"cost": (0, 99)}}
    assert not any("linear relation" in each for each in told(Designs.from_frame, columns | {"cost": cost}, "y", **rule)[1])
    nearly = cost + rng.normal(0, 0.5, 30)
    (line,) = told(Designs.from_frame, columns | {"cost": nearly}, "y")[1]
    assert line.startswith("frame: columns cost, temp are predicted by the other inputs (R2 1.00 of cost in rows left out)")
    few = {f"x{i}": rng.normal(size=12) for i in range(8)} | {"y": rng.normal(size=12)}  # that many fit any rows nearly
    assert told(Designs.from_frame, few, "y")[1] == []


def acids(rows, seed=0, noise=0.1):
    """A pH that three settings determine, but for noise."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.random((3, rows))
    ph = 5 + np.sin(2.5 * a) * (0.5 + b) - c**2 + noise * rng.normal(size=rows)
    return {"a": a, "b": b, "c": c, "ph": ph, "y": 10 * (ph - 5) + 2 * rng.normal(size=rows)}


def test_an_input_that_others_determine_is_told():
    """A model of it explains y well, and what it proposes cannot be set."""
    for seed in range(3):
        *_, line = told(Designs.from_frame, acids(60, seed), "y")[1]
        assert line.startswith(("frame: column ph is predicted by the other inputs (R2 0.9", "frame: columns ph, "))
        assert "measured and not set" in line
        assert "(--ignore ph)" in line
        assert told(Designs.from_frame, acids(60, seed), "y", ignore=["ph"])[1] == []
        own = told(Designs.from_frame, acids(60, seed, noise=1.0), "y")[1]  # which is set, more or less
        assert not any("is predicted" in each for each in own)
    assert not any("predicted" in line for line in told(Designs.from_frame, acids(29), "y")[1])  # too few
    assert "predicted by the other inputs" in told(Designs.from_frame, acids(300), "y")[1][-1]
    several = acids(60) | {"again": acids(60)["ph"] + 0.01 * np.random.default_rng(1).normal(size=60)}
    *_, line = told(Designs.from_frame, several, "y")[1]
    assert "columns ph, again" in line or "columns again, ph" in line
    rule = {"constraints": ["ph - c = 5"]}  # which says what is known
    assert not any("predicted" in each for each in told(Designs.from_frame, acids(60), "y", **rule)[1])


def test_numbers_over_decades_are_told_and_drafted_on_a_log_scale(tmp_path):
    rng = np.random.default_rng(1)
    columns = frame(60, conc=10 ** rng.uniform(-6, 0, 60))
    (line,) = told(Designs.from_frame, columns, "y")[1]
    assert line.startswith("frame: column conc reaches from ")
    assert line.endswith("evenly in its logarithm; have it modelled on a log scale (--logs conc)")
    assert told(Designs.from_frame, columns, "y", logs=["conc"])[1] == []
    for other in (10 ** rng.uniform(-2, 0, 60), rng.uniform(1e-6, 1, 60), rng.uniform(0, 1, 60) - 0.5):
        assert told(Designs.from_frame, frame(60, conc=other), "y")[1] == []
    schema, lines = describe(write(tmp_path / "t.csv", columns), "y")
    assert schema.columns["conc"].log
    assert not schema.columns["temp"].log
    assert "--logs conc" in lines[0]
    assert told(schema.read, tmp_path / "t.csv")[1] == []


def test_placeholders_and_scores_at_a_limit_are_told():
    rng = np.random.default_rng(0)
    columns = frame(42, conc=np.where(np.arange(42) % 13 == 0, -999.0, rng.uniform(20, 90, 42)))
    (line,) = told(Designs.from_frame, columns, "y")[1]
    assert line.startswith("frame: column conc has -999 in 4 rows, far from its other values, ")
    columns = frame(42) | {"y": np.where(np.arange(42) % 13 == 0, -999.0, rng.uniform(20, 90, 42))}
    (line,) = told(Designs.from_frame, columns, "y")[1]
    assert line.startswith("frame: y has -999 in 4 rows")
    score = np.random.default_rng(1).uniform(50, 110, 42)
    capped = frame(42) | {"y": np.minimum(score, 100)}
    (line,) = told(Designs.from_frame, capped, "y")[1]
    assert line == (
        f"frame: {(score > 100).sum()} rows have the greatest y, 100: if it is a limit, no score lies above it, and "
        "predictions above it mean that it is reached"
    )
    assert told(Designs.from_frame, capped, "y", minimise=True)[1] == []
    (line,) = told(Designs.from_frame, capped | {"y": -capped["y"]}, "y", minimise=True)[1]
    assert "have the least y, -100" in line
    assert told(Designs.from_frame, frame(42) | {"y": score}, "y")[1] == []
    assert told(Designs.from_frame, frame(42) | {"y": score.round(-1)}, "y")[1] == []  # few values


def test_ignored_columns_that_may_tell_which_rows_belong_together_are_told():
    days = [f"2024-03-{1 + row // 6:02d}" for row in range(48)]
    for name, values in {"date": days, "batch": [row % 8 for row in range(48)]}.items():
        (line,) = told(Designs.from_frame, frame(48, **{name: values}), "y", ignore=[name])[1]
        assert line == (
            f"frame: column {name} is ignored and has 8 values in 48 rows: if rows of one belong together, hold them out "
            f"together where predictions are tested (--groups {name})"
        )
    times = [f"2024-03-{1 + row // 2:02d} {row % 24:02d}:{row:02d}" for row in range(48)]  # another one in each row
    for name, values in {"date": times, "note": ["a", "b"] * 24}.items():
        assert told(Designs.from_frame, frame(48, **{name: values}), "y", ignore=[name])[1] == []
    assert not any("is ignored" in each for each in told(
        Designs.from_frame, frame(48, date=days, batch=[row % 8 for row in range(48)]), "y", ignore=["date"], groups="batch"
    )[1])  # fmt: skip


def test_ignored_columns_of_lists_are_not_looked_at():
    lists = pa.array([[row] for row in range(18)])
    table = pa.table({**{name: pa.array(values) for name, values in frame().items()}, "batch": lists})
    assert told(Designs.from_frame, table, "y", ignore=["batch"])[1] == []


def test_another_outcome_is_told(tmp_path):
    columns = frame(30)
    columns |= {"conversion": (-np.array(columns["y"])).round(1)}
    (line,) = told(Designs.from_frame, columns, "y")[1]
    assert line.startswith("frame: conversion orders the rows nearly as y does (rank correlation -")
    assert line.endswith("if it is another outcome, ignore it (--ignore conversion)")
    assert line.removeprefix("frame: ") in describe(write(tmp_path / "t.csv", columns), "y")[1]
    columns["conversion"] = columns["conversion"] + np.random.default_rng(1).normal(0, 0.3, 30)
    assert told(Designs.from_frame, columns, "y")[1] == []


def test_a_column_that_must_be_mended_stays_an_input_of_the_draft(tmp_path):
    for cell in ("{} C", "{}-{}", "{}"):
        dose = [cell.format(i % 6, i % 6 + 2) for i in range(17)] + ["warm"]
        path = write(tmp_path / "t.csv", frame(dose=dose))
        schema, lines = describe(path, "y")
        assert schema.columns["dose"].role == "input"
        assert any(line.endswith("; it is drafted as an input, and refused until then") for line in lines)
        with pytest.raises(UserError, match="column dose holds"):
            told(schema.read, path)
    with pytest.raises(UserError, match="column dose holds texts such as '0-2'; write one number, such as the middle of"):
        Designs.from_frame(frame(dose=[f"{i % 6}-{i % 6 + 2}" for i in range(18)]), "y")


def test_a_score_may_be_larger_than_an_input(tmp_path):
    """Counts beyond 16,777,216, and numbers that 32 bits hold coarsely."""
    for cfu in ([20_000_001 + 26_000_003 * i for i in range(18)], [1e9 + i / 2 for i in range(18)]):
        path = write(tmp_path / "t.csv", frame() | {"cfu": cfu})
        for asked in (None, "cfu"):
            schema, lines = describe(path, asked)
            assert schema.named("target") == ["cfu"]
            assert not [line for line in lines if "take a constant off" in line]
            assert told(schema.read, path)[0].y.tolist() == cfu
    assert "column solvent holds texts, numbers are needed" in " ".join(describe(path, "solvent")[1])


def test_rows_without_any_input_are_left_out_and_nothing_else_is_said():
    columns = {"temp": [*np.arange(17.0), None], "size": [*np.arange(17.0) ** 2, None], "y": [*np.arange(18.0) % 5]}
    with pytest.raises(UserError, match="^frame: all inputs are empty in row 17, counted from 0; leave it out$"):
        Designs.from_frame(columns, "y")


def test_few_rows_are_too_few_and_nothing_else_is_wrong():
    for rows in (1, 2, 4):
        with pytest.raises(UserError, match=f"{rows} rows? (is|are) too few, 10 or more are needed"):
            Designs.from_frame({"a": list(range(rows)), "y": list(range(rows))}, "y")


DRAWN = {
    "normal": lambda rng, n: rng.normal(size=n), "uniform": lambda rng, n: rng.uniform(size=n),
    "log-normal": lambda rng, n: rng.lognormal(0, 1, n), "log-normal and shifted": lambda rng, n: rng.lognormal(0, 1, n) - 1,
    "negative": lambda rng, n: -rng.lognormal(0, 1, n), "t": lambda rng, n: rng.standard_t(3, n),
    "bimodal": lambda rng, n: rng.choice([0.0, 30.0], n) + rng.normal(size=n),
    "logarithmic levels": lambda rng, n: rng.choice([0.1, 1, 10, 100], n), "levels": lambda rng, n: rng.choice([20, 80, 90], n),
    "mostly zero": lambda rng, n: np.where(np.arange(n), 0, 50), "a rare level": lambda rng, n: np.where(np.arange(n), 20, 800),
    "with a control": lambda rng, n: np.append(rng.uniform(50, 60, n - 1), 0),
}  # fmt: skip


@pytest.mark.parametrize("kind", DRAWN)
def test_tails_modes_and_levels_are_no_slips(kind):
    rng = np.random.default_rng(1)
    assert sum(far(np.asarray(DRAWN[kind](rng, 30), float)) is not None for _ in range(300)) <= 2
    if kind in ("normal", "uniform"):
        assert far(np.append(50 + DRAWN[kind](rng, 30), 500.0)) == 30
        assert far(np.append(50 + DRAWN[kind](rng, 30), 5.0)) == 30


def test_a_score_of_0_and_1_is_told():
    data, lines = told(Designs.from_frame, frame(y=[0, 1, 1] * 6), "y")
    assert set(data.y) == {0.0, 1.0}
    said = "frame: y has only the values 0 and 1: predictions are of its mean (a rate), and may lie below 0 or above 1"
    assert lines == [said]
    assert told(Designs.from_frame, frame(y=[True, False, False] * 6), "y", minimise=True)[1] == [said]


def test_yes_and_no_are_the_levels_that_the_table_has(tmp_path):
    """What is proposed may be written below the table, where true beside yes would be another level."""
    data = frame(stirred=["yes", "no", "no"] * 6, light=["on", "off"] * 9, open=["TRUE", "false", "True"] * 6)
    path = write(tmp_path / "t.csv", data)
    made, lines = told(Designs.from_csv, path, "y", fixed=["stirred=yes"], forbidden=["light = on & temp > 80"])
    levels = {v.name: v.levels for v in made.variables if v.leveled}
    assert levels["stirred"] == ("no", "yes")
    assert levels["light"] == ("off", "on")
    assert levels["open"] == (False, True)
    assert not any("true and false" in line for line in lines)
    made.write(tmp_path / "p.csv", made.x[:2])
    assert (tmp_path / "p.csv").read_text().splitlines()[1].endswith(',"yes","on",true')
    drafted, _ = describe(path, "y")
    assert drafted.columns["stirred"].levels == ("no", "yes")
    drafted.save(tmp_path / "t.toml")
    assert {v.name: v.levels for v in DesignSchema.load(tmp_path / "t.toml").read(path).variables if v.leveled} == levels
    works = write(tmp_path / "w.csv", frame(y=["yes", "no", "no"] * 6))
    assert told(Designs.from_csv, works, "y")[0].y.sum() == 6  # a score of yes and no is a number
    weighed, _ = told(Designs.from_csv, path, "y", weights={"stirred": -1.0}, kinds={"light": "integer"})
    np.testing.assert_allclose(weighed.y, np.array(data["y"]) - (np.array(data["stirred"]) == "yes"))
    assert {v.name: v.kind for v in weighed.variables}["light"] == "integer"
