"""Tables of scored designs: what comes in, what is refused in one line, and the coordinates that methods search in."""

import gzip
from datetime import datetime

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv

from deadreckon.errors import UserError
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.variables import Variable


def table(rows=12, **changes):
    rng = np.random.default_rng(0)
    columns = {
        "temperature": rng.uniform(20, 80, rows).round(1).tolist(),
        "layers": rng.integers(1, 6, rows).tolist(),
        "solvent": ["water", "ethanol", "acetone"] * (rows // 3),
        "y": rng.normal(size=rows).tolist(),
    }
    return columns | changes


def test_kinds_are_seen_and_bounds_are_those_of_the_data():
    found = Designs.from_frame(table(), "y")
    assert [v.kind for v in found.variables] == ["continuous", "integer", "categorical"]
    assert found.variables[2].levels == ("acetone", "ethanol", "water")
    assert found.variables[0].low == min(table()["temperature"])
    np.testing.assert_allclose(found.y, table()["y"])
    assert found.x[0, 2] == 2


def test_kinds_bounds_levels_and_the_sign_as_told():
    found = Designs.from_frame(
        table(), "y", kinds={"layers": "categorical"}, bounds={"temperature": (0, 100)},
        levels={"solvent": ["water", "ethanol", "acetone", "toluene"]}, minimise=True,
    )  # fmt: skip
    assert found.variables[1].levels == (1, 2, 3, 4, 5)
    assert (found.variables[0].low, found.variables[0].high) == (0.0, 100.0)
    assert len(found.variables[2].levels) == 4
    np.testing.assert_allclose(found.y, -np.array(table()["y"]))


def test_dates_are_levels_where_somebody_says_so():
    days = ["2024-05-06", "2024-05-07"] * 6
    for told in ({"kinds": {"solvent": "categorical"}}, {"levels": {"solvent": days[:2]}}):
        assert Designs.from_frame(table(solvent=days), "y", **told).variables[2].levels == tuple(days[:2])


def test_a_csv_goes_round(tmp_path):
    csv.write_csv(pa.table(table()), tmp_path / "mine.csv")
    found = Designs.from_csv(tmp_path / "mine.csv", "y", ignore=["layers"])
    assert found.name == "mine"
    found.write(tmp_path / "proposals.csv", found.x[:3], {"predicted": [1.0, 2.0, 3.0]})
    again = csv.read_csv(tmp_path / "proposals.csv").to_pydict()
    assert list(again) == ["temperature", "solvent", "predicted"]
    assert again["solvent"] == table()["solvent"][:3]
    np.testing.assert_allclose(found.encode(again), found.x[:3])


@pytest.mark.parametrize(
    ("columns", "options", "words"),
    [
        (table(), {"target": "z"}, "unknown column 'z'"),
        (table(y=[*map(str, range(11)), "n.a."]), {}, "column y holds texts, numbers are needed; row 11 has 'n.a.'"),
        (table(y=[1.0] * 12), {}, "y is 1 in all rows, so no design is known to be better"),
        (table(y=[None] * 12), {}, "y is empty in all rows, so no design is known to be better"),
        (table(temperature=[1.0, None, *range(10)]), {}, "column temperature is empty in row 1"),
        (table(solvent=["water", None] * 6), {}, "column solvent is empty in rows 1, 3, 5, 7, 9 and 1 more, counted"),
        (table(), {"bounds": {"temperature": (0, 30)}}, r"column temperature has .* in row \d+, outside the bounds \[0, 30\]"),
        (table(), {"bounds": {"solvent": (0, 30)}}, "column solvent is categorical and has levels, not bounds"),
        (table(9), {}, "9 rows are too few, 10 or more are needed"),
        (table(), {"kinds": {"layers": "whole"}}, "unknown kind 'whole'"),
        (table(), {"kinds": {"layers": "integer"}, "levels": {"layers": [1, 2, 3]}}, "layers is integer .* make it ordinal"),
        (table(), {"kinds": {"temperature": "integer"}}, "whole numbers are needed"),
        (table(), {"levels": {"solvent": ["water"]}}, "unknown level 'ethanol' in row 1; known are water"),
        ({"y": list(range(12))}, {}, "no column other than the target 'y'"),
        (table(solvent=[f"S{i}" for i in range(12)]), {}, "column solvent holds 12 different values in 12 designs"),
        (table(temperature=[1.7e9 + i for i in range(12)]), {}, "reaches 1.7e.09 .* which 32 bits hold in steps of 128 only"),
        (table(layers=[2**40 + i for i in range(12)]), {}, "beyond 16,777,216, .* take a constant off it"),
        (table(temperature=[datetime(2024, 1, 1)] * 12), {}, "column temperature holds times; make numbers of them, ignore"),
        (table(solvent=["2024-05-06", "2024-05-07"] * 6), {}, r"column solvent holds times; make .* \(--groups solvent\)"),
        (table(**{" z": [1.0] * 12}), {"target": "z"}, "unknown column 'z': did you mean ' z'"),
        (table(), {"ignore": ["layers"], "bounds": {"layers": (0, 9)}}, "bounds is of inputs, and layers is ignored"),
        (table(), {"ignore": ["layers"], "kinds": {"layers": "x"}}, "kinds is of inputs, and layers is ignored"),
    ],
)
def test_refusals_name_what_is_wrong(columns, options, words):
    with pytest.raises(UserError, match=words) as told:
        Designs.from_frame(columns, **{"target": "y"} | options)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_separators_points_and_row_numbers_of_files(tmp_path, separator):
    point = "," if separator == ";" else "."
    rows = [f"{i}{separator}{1.5 * i:g}{separator}{i - 0.25:g}".replace(".", point) for i in range(12)]
    (tmp_path / "mine.csv").write_text("\n".join([separator.join(["", "a", "y"]), *rows]))
    with pytest.warns(UserWarning, match="column '' looks like a row number and is left out"):
        found = Designs.from_csv(tmp_path / "mine.csv", "y")
    assert [v.name for v in found.variables] == ["a"]
    np.testing.assert_allclose(found.x[:, 0], 1.5 * np.arange(12))
    np.testing.assert_allclose(found.y, np.arange(12) - 0.25)


def test_a_compressed_file_is_read(tmp_path):
    text = "a;y\n" + "".join(f"{i};{i / 2}\n" for i in range(20_000))  # longer than what the separator is looked for in
    with gzip.open(tmp_path / "mine.csv.gz", "wt") as file:
        file.write(text)
    assert len(Designs.from_csv(tmp_path / "mine.csv.gz", "y")) == 20_000


def test_a_file_in_another_encoding_is_read_and_told(tmp_path):
    text = "größe;y\n" + "".join(f"{i},5;{i}\n" for i in range(12))
    (tmp_path / "mine.csv").write_bytes(text.encode("latin-1"))
    with pytest.warns(UserWarning, match="the text is not UTF-8"):
        found = Designs.from_csv(tmp_path / "mine.csv", "y")
    assert found.variables[0].name == "größe"
    np.testing.assert_allclose(found.x[:, 0], np.arange(12) + 0.5)


def test_levels_as_texts_are_those_of_the_column():
    columns = table(hot=[True, False] * 6, layers=[0.5, 1.0] * 6)
    told = {"hot": ["false", "True"], "layers": ["0.5", "1", "2"]}
    found = Designs.from_frame(columns, "y", levels=told)
    by_name = {v.name: v.levels for v in found.variables}
    assert by_name["hot"] == (False, True)
    assert by_name["layers"] == (0.5, 1.0, 2.0)


def test_numbers_come_out_as_they_went_in():
    found = Designs.from_frame(table(temperature=[0.1 * i + 2.7 for i in range(12)]), "y")
    assert found.decode(found.x[:2])["temperature"] == [2.7, 2.8]


def test_rounding_at_a_bound_of_zero_is_no_error():
    table = {"a": np.linspace(0, 100, 12), "b": np.geomspace(1e-3, 1e4, 12), "y": np.arange(12.0)}
    made = Designs.from_frame(table, "y", logs=["b"])
    made.check(np.array([[-5e-7, 1.0]]))
    for wrong in ([-1e-3, 1.0], [1.0, 0.0]):  # of a log scale none is below the least number
        with pytest.raises(UserError, match="a number in"):
            made.check(np.array([wrong]))


def test_proposals_of_people_are_checked():
    found = Designs.from_frame(table(), "y")
    good = {"temperature": [30.0], "layers": [2], "solvent": ["water"]}
    assert found.encode(good).tolist() == [[30.0, 2.0, 2.0]]
    with pytest.raises(UserError, match="unknown level 'oil' in row 0; known are acetone, ethanol, water"):
        found.encode(good | {"solvent": ["oil"]})
    with pytest.raises(UserError, match=r"temperature is 900 in row 0, a number in \[.*\] is needed"):
        found.encode(good | {"temperature": [900.0]})
    with pytest.raises(UserError, match="layers is 2.5 in row 0, a whole number"):
        found.encode(good | {"layers": [2.5]})
    with pytest.raises(UserError, match="unknown column 'solvent'"):
        found.encode({"temperature": [30.0], "layers": [2]})
    for unit in (1e-9, 1.0, 1e9):
        grams = (unit * np.linspace(0.1, 0.9, 12)).tolist()
        found = Designs.from_frame(table(grams=grams), "y", ignore=["temperature"], bounds={"grams": (0, unit)})
        part = {"layers": [2], "solvent": ["water"]}
        assert found.encode(part | {"grams": [unit]}).shape == (1, 3)
        with pytest.raises(UserError, match=r"grams is .* in row 0, a number in \[0, .*\] is needed"):
            found.encode(part | {"grams": [1.0001 * unit]})
    decades, at_zero = (1e-3, 1e4, (0.0, 0.9999e-3, 1.0001e4)), (0.0, 1e9, (-900.0, 1.0001e9))
    for low, high, beyond in (decades, at_zero, (-1e9, -1.0, (-0.99, 20.0))):
        variables = Variable("a", low=low, high=high, log=low > 0), Variable("b")
        x = np.stack([np.geomspace(low, high, 12) if low else np.linspace(low, high, 12), np.arange(12.0)], 1)
        found = Designs.from_arrays(x, np.arange(12.0), variables)
        assert found.encode({"a": [low, high], "b": [0.0, -1e30]})[:, 0].tolist() == np.array([low, high], np.float32).tolist()
        for value in beyond:
            with pytest.raises(UserError, match=r"a is .* in row 0, a number in \["):
                found.encode({"a": [value], "b": [0.0]})
    with pytest.raises(UserError, match=r"x1 is nan in row 3, a number in"):
        Designs.from_arrays(np.where(np.arange(24).reshape(12, 2) == 7, np.nan, 1.0), np.arange(12.0))


def test_coordinates_go_round():
    rng = np.random.default_rng(0)
    of = lambda name, levels: Variable(name, "categorical", levels=tuple(levels))  # noqa: E731
    numbers = Variable("a", low=-5, high=5), Variable("c", "integer", 0, 9)
    variables = [numbers[0], of("b", "xyz"), numbers[1], of("d", "uvwxy"), of("e", "pqr")]
    x = np.stack([rng.uniform(-5, 5, 50), rng.integers(0, 3, 50), rng.integers(0, 10, 50), rng.integers(0, 5, 50),
                  rng.integers(0, 3, 50)], 1)  # fmt: skip
    designs = Designs.from_arrays(x, rng.normal(size=50), variables)
    view = designs.coordinates
    z = view.encode(designs.x)
    assert z.shape == (50, view.size) == (50, 2 + 2 + 2 + 4)
    np.testing.assert_allclose(z[:, :2].mean(0), 0.0, atol=1e-5)
    np.testing.assert_allclose(z[:, :2].std(0), 1.0, atol=1e-5)
    assert set(np.unique(z[:, 2:])) == {-1.0, 0.0, 1.0}
    np.testing.assert_allclose(view.decode(z), designs.x, atol=1e-5)
    # Beyond the bounds it is cut, between whole numbers rounded; of bounds the coordinates know too.
    far = view.decode(np.full((1, view.size), 50.0))
    assert far[0, 0] == 5.0
    assert far[0, 2] == 9.0
    np.testing.assert_allclose(view.decode(np.where(np.isfinite(view.low), view.low, 0.0)[None])[0, [0, 2]], [-5.0, 0.0])
    assert np.isinf(view.high[2:]).all()
    np.testing.assert_allclose(view.score((designs.y - designs.y.mean()) / designs.y.std()), designs.y)


def test_best_and_worst():
    designs = Designs.from_arrays(np.arange(20.0)[:, None], np.arange(20.0))
    assert designs.best(3).tolist() == [19, 18, 17]
    assert designs.best(3, worst=True).tolist() == [0, 1, 2]
    assert len(designs.best(50)) == 50
    with pytest.raises(ValueError, match="read-only"):
        designs.x[0] = 3.0


@pytest.mark.parametrize(
    ("lines", "options", "words"),
    [
        (["a,y", *(f"{i}.5,{i}" for i in range(11)), "oops,3"], {}, "column a holds 'oops' in row 11, where most rows"),
        (["c,y", *(f"{'uv'[i % 2]},{i}" for i in range(11)), ",3"], {}, "column c is empty in row 11"),
        (["a,y", *(f"{i},{i}" for i in range(12))], {"bounds": {"a": (0, 14.5)}}, "bounds must be whole too, got 0 and 14.5"),
        (["a,y", *(f"{i}.5,{i}" for i in range(12))], {"bounds": {"a": (1, 0)}}, "bounds must be low and high, got 1 and 0"),
        (["a,y", *(f"{i + 20_000_000},{i}" for i in range(12))], {}, "reaches beyond 16,777,216"),
        (["a,y", *(f"{i}.5,{i}" for i in range(12))], {"bounds": {"y": (0, 1)}}, "bounds is of inputs, and y is the target"),
        (["a,y", *(f"1.5,{i}" for i in range(12))], {}, "all designs are the same"),
        (["a,y", *(f"{i}.5,7" for i in range(12))], {"minimise": True}, "y is 7 in all rows"),
    ],
)
def test_csv_files_that_are_refused(tmp_path, lines, options, words):
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(UserError) as told:
        Designs.from_csv(path, "y", **options)
    assert words in str(told.value)
    assert "\n" not in str(told.value)


def test_scores_as_the_table_has_them():
    frame = {"a": list(range(12)), "y": [float(i) for i in range(12)]}
    lost = Designs.from_frame(frame, "y", minimise=True)
    np.testing.assert_array_equal(lost.shown(lost.y), frame["y"])
    won = Designs.from_frame(frame, "y")
    np.testing.assert_array_equal(won.shown(won.y), won.y)
