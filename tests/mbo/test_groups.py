"""Rows in groups such as batches, which are held out as a whole."""

from dataclasses import replace

import numpy as np
import pytest

from deadreckon.cli import main as cli
from deadreckon.errors import UserError
from deadreckon.mbo import designer
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.validation import checkable, cross_validated, held_out, judged
from deadreckon.mbo.variables import Variable

AB = (Variable("a", low=0.0, high=1.0), Variable("b", low=0.0, high=1.0))


def batches(count=8, rows=6, seed=0, width=0.03):
    """Batches that each try a region of their own, and scores that say only which batch it was."""
    rng = np.random.default_rng(seed)
    codes = np.repeat(np.arange(count), rows)
    x = np.clip(rng.uniform(0.2, 0.8, (count, 2))[codes] + width * rng.standard_normal((len(codes), 2)), 0, 1).round(7)
    return {
        "a": x[:, 0],
        "b": x[:, 1],
        "lot": codes + 300,
        "y": rng.standard_normal(count)[codes] + 0.1 * rng.normal(size=len(codes)),
    }


def read(frame, **more):
    return Designs.from_frame(frame, "y", bounds={"a": (0, 1), "b": (0, 1)}, **more)


def test_a_model_that_knows_what_a_batch_has_in_common_is_not_praised():
    frame = batches()
    with pytest.warns(UserWarning, match="rows with the same lot are held out together .*8 parts"):
        data = read(frame, groups="lot")
    assert [v.name for v in data.variables] == ["a", "b"]
    np.testing.assert_array_equal(data.units, np.repeat(np.arange(8), 6))
    grouped, single = (
        designer("gp", rounds=3).propose(each, 2, validate=True).quality for each in (data, read(frame, ignore=["lot"]))
    )
    assert all(len(set(grouped.fold[data.units == k])) == 1 for k in range(8))
    assert len(set(grouped.fold)) == 8
    assert single.skilled  # and R2 is 0.9, of nothing
    assert single.r2 > 0.7
    assert not grouped.skilled
    assert grouped.r2 < 0.2


@pytest.mark.filterwarnings("ignore:.*")
def test_a_design_that_stands_in_several_groups_is_held_out_by_itself():
    frame = batches(4, 5)
    frame = {key: np.append(values, [0.5] * 4 if key in "ab" else np.arange(300, 304) if key == "lot" else [0.1, 0.2, 0.3, 0.4])
             for key, values in frame.items()}  # fmt: skip
    data = read(frame, groups="lot")
    assert len(data) == 21  # the control is one row
    np.testing.assert_array_equal(data.units, [*np.repeat(np.arange(4), 5), 4])
    some = data.part(np.arange(5, 21))
    np.testing.assert_array_equal(some.units, [*np.repeat(np.arange(3), 5), 3])


@pytest.mark.filterwarnings("ignore:.*")
def test_enough_is_left_to_learn_from():
    assert checkable(read(batches(2, 10), groups="lot"))
    assert not checkable(read(batches(2, 9), groups="lot"))
    held, rest, fold = held_out(data := read(batches(5, 20), groups="lot"), 2000)
    assert sorted([*held, *rest]) == list(range(100))
    assert len(held) == 40  # two batches, though one would be enough
    assert not set(data.units[held]) & set(data.units[rest])
    assert all(len(set(fold[data.units[held] == k])) == 1 for k in set(data.units[held]))
    assert set(fold) == {0, 1}
    assert held_out(read(batches(2, 40), groups="lot"), 2000) is None
    alone = read({"a": np.linspace(0, 1, 40), "b": np.tile([0.0, 1.0], 20), "y": np.arange(40.0) ** 0.5})
    assert len(held_out(alone, 2000)[0]) == 20


@pytest.mark.filterwarnings("ignore:.*")
def test_four_groups_with_nothing_else_in_them_tell_no_skill_from_chance():
    data = read(batches(4, 8, width=0.0005), groups="lot")
    found = cross_validated(data, lambda part: lambda x, error: (x[:, 0], np.ones(len(x))), "a")
    assert len(found.units) == 32
    right = replace(judged(data.y, data.y, np.ones(32), data.units, "right"), units=data.units)
    assert right.rank_correlation == pytest.approx(1.0)
    assert not right.skilled  # four batches in the right order are no evidence
    assert right.limit == 1.0


@pytest.mark.parametrize(
    ("lots", "more", "asked"),
    [
        ([1] * 20, {}, "column lot has the same value in all rows"),
        (list(range(20)), {}, "column lot has another value in every row"),
        ([None, *[1, 2] * 9, 1], {}, "column lot is empty in row 0"),
        ([1, 2] * 10, {"kinds": {"lot": "integer"}}, "kinds is of inputs, and lot holds the groups"),
        ([1, 2] * 10, {"std_error": "lot"}, "lot cannot be the target or part of it and hold the groups"),
    ],
)
def test_bad_groups(lots, more, asked):
    frame = {"a": np.linspace(0, 1, 20), "b": np.tile([0.0, 1.0], 10), "lot": lots, "y": np.arange(20.0)}
    with pytest.raises(UserError, match=asked):
        read(frame, groups="lot", **more)


@pytest.mark.filterwarnings("ignore:.*")
def test_the_command_and_a_schema_say_groups(tmp_path, capsys):
    frame = batches(4, 5) | {"z": np.arange(20)[::-1] ** 0.5}
    rows = zip(*(frame[key] for key in ("a", "b", "lot", "y", "z")))
    (tmp_path / "t.csv").write_text("\n".join(["a,b,lot,y,z", *(",".join(map(str, row)) for row in rows)]) + "\n")
    table = str(tmp_path / "t.csv")
    say = ["-n", "2", "--method.rounds", "3", "--method", "gp"]
    assert (
        cli.main(["design", table, "--target", "y", "--ignore", "z", "--groups", "lot", "--out", str(tmp_path / "one"), *say])
        == 0
    )
    assert "2 variables (a, b)" in capsys.readouterr().out
    assert "rows with the same lot are held out together" in (tmp_path / "one" / "report.html").read_text()
    (tmp_path / "s.toml").write_text(
        'columns.a.role = "input"\ncolumns.b.role = "input"\ncolumns.lot.role = "group"\n'
        'columns.y.role = "target"\ncolumns.z.role = "ignore"\n'
    )
    assert cli.main(["design", table, "--schema", str(tmp_path / "s.toml"), "--out", str(tmp_path / "two"), *say]) == 0
    first, second = (tmp_path / out / "proposals.csv" for out in ("one", "two"))
    assert first.read_text() == second.read_text()
    both = ["design", table, "--targets", "y", "z", "--groups", "lot", "-n", "2", "--out", str(tmp_path / "three")]
    assert cli.main(both) == 0
    assert "2 variables (a, b)" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore:.*")
def test_a_column_that_is_called_like_a_batch_is_reported():
    frame = batches(4, 5)
    line = "column lot is taken for an input; if it is no setting and tells which rows belong together, --groups lot holds"
    assert any(line in each for each in read(frame).noticed)
    assert not any("--groups" in each for each in read(frame, groups="lot").noticed)
    left = read({**frame, "lots_of": frame["lot"]}, ignore=["lot"]).noticed
    assert not any("is taken for an input" in each for each in left)
    assert any("column lot is ignored and has 4 values in 20 rows" in each for each in left)
