"""Schemas of tables of experiments: drafted, saved, read back, and refused in one line."""

import dataclasses
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv

from deadreckon.cli.main import main
from deadreckon.errors import UserError
from deadreckon.mbo.design_draft import describe
from deadreckon.mbo.design_schema import DesignColumn, DesignSchema
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.front import targets_of
from tests.mbo.practice import TABLES


@pytest.fixture
def table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    csv.write_csv(pa.table(TABLES["mixed"]().columns), "mine.csv")
    return tmp_path / "mine.csv"


def test_what_is_drafted_reads_the_same_designs(table):
    schema, told = describe(table)
    assert told == ["the last column of numbers, y, is taken as the target (--target)"]
    assert {name: column.kind for name, column in schema.columns.items()} == {
        "heat": "integer", "rate": "continuous", "layers": "integer", "colour": "categorical", "y": None,
    }  # fmt: skip
    schema.save("mine.toml")
    again = DesignSchema.load("mine.toml")
    assert again == schema
    data = again.read(table)
    np.testing.assert_array_equal(data.x, TABLES["mixed"]().designs().x)
    assert data.variables[3].levels == ("blue", "green", "red")


@pytest.mark.parametrize("value", [False, 0, 0.0, "no"])
def test_values_that_are_false_or_zero_are_saved_too(tmp_path, value):
    column = DesignColumn("input", "categorical", levels=(False, True), fix=value)
    schema = DesignSchema({"a": column, "cost": DesignColumn("weighted", weight=0.0), "y": DesignColumn("target")})
    schema.save(tmp_path / "mine.toml")
    assert DesignSchema.load(tmp_path / "mine.toml") == schema


def test_roles_and_rules_that_are_added_are_obeyed(table, capsys):
    schema, _ = describe(table)
    schema.save("mine.toml")
    path = Path("mine.toml")
    text = path.read_text()
    text = text.replace("constraints = []", 'constraints = ["heat + 2 layers <= 80"]')
    text = text.replace('[columns."heat"]', '[columns."heat"]\nstep = 5')
    path.write_text(text.replace('[columns."rate"]', '[columns."rate"]\nlog = true'))
    asked = ["design", "mine.csv", "--schema", "mine.toml", "--method", "random", "-n", "12", "--fix", "colour=red"]
    assert main(asked) == 0
    rows = csv.read_csv("runs/design/random-mine/proposals.csv").to_pydict()
    assert len(rows["heat"]) == 12
    assert all(heat % 5 == 0 and heat + 2 * layers <= 80 for heat, layers in zip(rows["heat"], rows["layers"]))
    assert set(rows["colour"]) == {"red"}
    capsys.readouterr()
    assert main([*asked[:-2], "--constraints", "heat >= 200", "--out", "x"]) == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert told.startswith("deadreckon: mine: no design within the bounds satisfies all constraints; without 'heat >= 200'")
    assert not (table.parent / "x").exists()


def test_describe_prints_and_does_not_overwrite(table, capsys):
    assert main(["design", "describe", "mine.csv", "--target", "y"]) == 0
    assert '[columns."colour"]' in capsys.readouterr().out
    assert main(["design", "describe", "mine.csv", "--save", "s.toml"]) == 0
    assert main(["design", "describe", "mine.csv", "--save", "s.toml"]) == 2
    assert "s.toml is there already" in capsys.readouterr().err


def test_direction_and_standard_error_are_of_the_schemas_own_target(table):
    schema, _ = describe(table)
    columns = {**schema.columns, "layers": DesignColumn("std_error")}
    schema = dataclasses.replace(schema, columns=columns, minimise=True)
    own, other = schema.read(table, pool=False), schema.read(table, target="rate", pool=False)  # replicates give errors too
    assert (own.minimise, other.minimise) == (True, False)
    assert own.std_error is not None
    assert other.std_error is None
    assert schema.read(table, target="rate", minimise=True).minimise
    assert [v.name for v in own.variables] == ["heat", "rate", "colour"]
    assert [v.name for v in other.variables] == ["heat", "colour"]  # neither the old target nor its error
    assert [v.name for v in schema.read(table, std_error="rate").variables] == ["heat", "colour"]
    weighted = dataclasses.replace(schema, columns={**schema.columns, "layers": DesignColumn("weighted", weight=-5.0)})
    assert weighted.read(table).target == "y - 5 layers"
    assert weighted.read(table, target="rate").target == "rate"
    nameless = dataclasses.replace(schema, columns={"heat": DesignColumn("input")})
    assert nameless.read(table, target="rate", ignore=("y", "layers", "colour")).minimise


def test_a_name_and_earlier_messages_may_be_given(table):
    schema, _ = describe(table)
    asked = {"name": "first series", "noticed": ["the oven was cold"]}
    for data in (schema.read(table, **asked), Designs.from_csv(table, "y", **asked)):
        assert data.name == "first series"
        assert data.noticed[0] == "the oven was cold"
    with pytest.raises(UserError, match="^first series: unknown column 'z'"):
        dataclasses.replace(schema, columns={**schema.columns, "z": DesignColumn("input")}).read(table, **asked)


@pytest.mark.parametrize("given", [{"std_error": "rate"}, {"weights": {"rate": 2.0}}])
def test_outputs_that_the_call_names_need_not_be_in_the_schema(table, given):
    schema, _ = describe(table)
    columns = {name: column for name, column in schema.columns.items() if name != "rate"}
    data = dataclasses.replace(schema, columns=columns).read(table, **given)
    assert [v.name for v in data.variables] == ["heat", "layers", "colour"]


@pytest.mark.parametrize("column", ["input", "fixed", "ignore", "weighted"])
def test_what_the_call_makes_the_target_has_no_other_role(table, column):
    schema, _ = describe(table)
    as_what = {
        "input": schema.columns["rate"], "fixed": dataclasses.replace(schema.columns["rate"], step=0.1, log=True, fix=0.1),
        "ignore": DesignColumn("ignore"), "weighted": DesignColumn("weighted", weight=2.0),
    }  # fmt: skip
    schema = dataclasses.replace(schema, columns={**schema.columns, "rate": as_what[column]})
    plain = Designs.from_csv(table, "rate", ignore=["y"])
    made = schema.read(table, target="rate")
    assert made.target == "rate"
    assert made.variables == plain.variables
    np.testing.assert_array_equal(made.y, plain.y)
    with pytest.raises(UserError, match="kinds is of inputs, and rate is the target"):
        schema.read(table, target="rate", kinds={"rate": "continuous"})  # what the call itself says is checked
    if column != "weighted":
        y, rate = targets_of(lambda **more: schema.read(table, **more), ["y", "rate"], [])
        assert y.variables == rate.variables == plain.variables


def test_a_schema_with_several_targets(table, capsys):
    schema, _ = describe(table)
    dataclasses.replace(schema, minimise=True).save("least.toml")
    read = DesignSchema.load("least.toml").read
    for small, want in (([], [True, False]), (["y"], [True, False]), (["rate"], [True, True])):
        made = targets_of(lambda **more: read(table, **more), ["y", "rate"], small)
        assert [each.minimise for each in made] == want
    for name, changed, said in (
        ("weighted", {"layers": DesignColumn("weighted", weight=-1.0)}, "column layers has the role weighted"),
        ("error", {"layers": DesignColumn("std_error")}, "column layers has the role std_error"),
        ("nameless", {"y": DesignColumn("ignore")}, "minimise = true is of no column"),
    ):
        dataclasses.replace(schema, columns={**schema.columns, **changed}, minimise=True).save(f"{name}.toml")
        asked = ["design", "mine.csv", "--schema", f"{name}.toml", "--targets", "y", "rate", "-n", "2", "--out", "x"]
        assert main(asked) == 2
        told = capsys.readouterr().err.strip()
        assert told.startswith(f"deadreckon: {name}.toml: {said}")
        assert "\n" not in told
    assert not (table.parent / "x").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("minimise = true", "needs a table \\[columns.NAME\\]"),
        ("maximise = true\n[columns.a]\nrole = 'input'", "unknown entry 'maximise'"),
        ("[columns.a]\nrole = 'inputs'", "column a needs a role"),
        ("[columns.a]\nrole = 'input'\nlow = 1", "low and high go together"),
        ("[columns.a]\nrole = 'input'\nstep = 'x'", "step must be a number, got 'x'"),
        ("[columns.a]\nrole = 'input'\nkind = 'number'", "unknown kind 'number'"),
        ("[columns.a]\nrole = 'input'\nsteps = 1", "unknown entry 'steps'"),
        ("[columns.a]\nrole = 'input'\nabout = 'x'", "unknown entry 'about'"),
        ("[columns.a]\nrole = 'input'\nlevels = []", "levels must be a list of values"),
        ("table = 5\n[columns.a]\nrole = 'input'", "holds options of the file such as separator, got 5"),
        ("[columns.a]\nrole = 'input'\n[table]\nfoo = [1]", "unknown entry 'foo'"),
        ("[columns.a]\nrole = 'input'\nabot = 'x'", r"unknown entry 'abot'(?!.*about)"),
        ("columns = 5", "needs a table \\[columns.NAME\\]"),
        ("[columns]\na = 5", "column a needs a role"),
        ("[columns.a]\nrole = 'weighted'", "a weighted column needs weight"),
        ("[columns.a]\nrole = 'target'\nlog = true", "log is of the role input, and its role is target; leave log out"),
        ("[columns.a]\nrole = 'input'\nweight = 1.0", "weight is of the role weighted, and its role is input"),
        ("[columns.a]\nrole = 'weighted'\nweight = 1.0\nlow = 0\nhigh = 1", "low is of the role input, and its role is wei"),
        ("[columns.a]\nrole = 'std_error'\nfix = 1", "fix is of the role input, and its role is std_error"),
        ("[columns.a]\nrole = 'target'\n[columns.b]\nrole = 'target'", "columns a and b both have the role target"),
        ("constraints = 'a'\n[columns.a]\nrole = 'input'", "constraints must be a list"),
        ("[table]\nsep = ';'\n[columns.a]\nrole = 'input'", "unknown entry 'sep'"),
    ],
)
def test_schemas_that_are_refused(tmp_path, text, words):
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(UserError, match=words) as told:
        DesignSchema.load(tmp_path / "s.toml")
    assert "\n" not in str(told.value)


def test_a_column_that_is_ignored_keeps_what_was_drafted_of_it(tmp_path):
    told = DesignColumn("ignore", "integer", 1.0, 8.0, weight=2.0, unit="mm")
    schema = DesignSchema({"a": told, "y": DesignColumn("target", unit="mm")})
    schema.save(tmp_path / "s.toml")
    assert DesignSchema.load(tmp_path / "s.toml") == schema


def test_a_column_that_the_schema_ignores_need_not_be_in_the_file(table):
    schema, _ = describe(table)
    schema = dataclasses.replace(schema, columns={**schema.columns, "note": DesignColumn("ignore")})
    data = schema.read(table)
    np.testing.assert_array_equal(data.x, TABLES["mixed"]().designs().x)
    assert not any("note" in line for line in data.noticed)
    with pytest.raises(UserError, match="^mine: unknown column 'notes'"):  # one that the call ignores must be
        schema.read(table, ignore=["notes"])


def test_what_a_call_says_of_a_column_that_is_ignored_is_refused(table):
    schema, _ = describe(table)
    ignored = dataclasses.replace(schema, columns={**schema.columns, "rate": DesignColumn("ignore")})
    for said in ({"kinds": {"rate": "integer"}}, {"bounds": {"rate": (0, 9)}}, {"steps": {"rate": -3}}, {"logs": ["rate"]}):
        with pytest.raises(UserError, match=f"^mine: {next(iter(said))} is of inputs, and rate is ignored$"):
            ignored.read(table, **said)
    rate = dataclasses.replace(schema.columns["rate"], step=0.1)
    made = dataclasses.replace(schema, columns={**schema.columns, "rate": rate}).read(table, ignore=["rate"])
    assert [v.name for v in made.variables] == ["heat", "layers", "colour"]  # what the schema says of it is then left out


def test_an_input_that_the_file_lacks_is_refused(table):
    schema, _ = describe(table)
    schema = dataclasses.replace(schema, columns={**schema.columns, "heats": DesignColumn("input")})
    with pytest.raises(UserError, match="^mine: unknown column 'heats': did you mean heat"):
        schema.read(table)


SCHEMA = """
[columns.a]
role = "input"
kind = "continuous"
{a}
[columns.c]
role = "input"
kind = "categorical"
{c}
[columns.y]
role = "target"
[columns.cost]
role = "weighted"
weight = {weight}
[table]
{table}
"""
USUAL = {"first": "", "a": "", "c": "", "weight": "1.0", "table": ""}
LONG = "1" + "0" * 400


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"table": "separator = 5"}, "table.separator must be a text, got 5"),
        ({"table": 'separator = ["a"]'}, r"table.separator must be a text, got a list of 1"),
        ({"table": "encoding = 5"}, "table.encoding must be a text, got 5"),
        ({"table": 'decimal = ["."]'}, r"table.decimal must be a text, got a list of 1"),
        ({"table": "sheet = [1]"}, r"table\['sheet'\] must be a text or a whole number"),
        ({"table": 'encoding = "undefined"'}, "--encoding undefined: unknown"),
        ({"table": 'encoding = "a\\u0000b"'}, "--encoding .*: unknown"),
        ({"c": 'levels = [["u"], {a = 1}]'}, r"columns\['c'\].levels\[0\] must be"),
        ({"c": f"levels = [{LONG}]"}, r"columns\['c'\].levels\[0\] must be"),
        ({"a": f"low = -{LONG}\nhigh = 1"}, r"columns\['a'\].low must be a number, got -1000"),
        ({"a": 'log = "x"'}, r"columns\['a'\].log must be true or false, got 'x'"),
        ({"a": "fix = {a = 1}"}, r"columns\['a'\].fix must be"),
        ({"a": "unit = 5"}, r"columns\['a'\].unit must be a text, got 5"),
        ({"weight": LONG}, r"columns\['cost'\].weight must be a number, got 1000"),
        ({"first": 'max_distance = "x"'}, "max_distance must be a number, got 'x'"),
        ({"first": "mixtures = [1]"}, r"mixtures\[0\] must be a list of texts, got 1"),
        ({"first": 'mixtures = [[["a"]]]'}, r"mixtures\[0\]\[0\] must be a text"),
        ({"first": 'constraints = [["a"]]'}, r"constraints\[0\] must be a text"),
        ({"first": 'minimise = "x"'}, "minimise must be true or false, got 'x'"),
    ],
)
def test_values_of_other_types_are_refused(changes, words, tmp_path):
    parts = USUAL | changes
    (tmp_path / "schema.toml").write_text(parts["first"] + SCHEMA.format(**parts))
    (tmp_path / "table.csv").write_text("a,c,y,cost\n" + "\n".join(f"0.{i},u,{i}.5,1.{i}" for i in range(12)) + "\n")
    with pytest.raises(UserError, match=words) as caught:
        DesignSchema.load(tmp_path / "schema.toml").read(tmp_path / "table.csv")
    assert "\n" not in str(caught.value)


def test_bounds_without_end_and_levels_with_signs_are_saved_and_read_again(tmp_path):
    rng = np.random.default_rng(0)
    table = pa.table({"a": rng.uniform(size=20), "s": ["a=1", "b&2"] * 10, "y": rng.normal(size=20)})
    csv.write_csv(table, tmp_path / "t.csv")
    schema = describe(tmp_path / "t.csv", "y")[0]
    columns = dict(schema.columns)
    columns["a"] = dataclasses.replace(columns["a"], low=0.0, high=float("inf"))
    columns["s"] = dataclasses.replace(columns["s"], fix="b&2")
    dataclasses.replace(schema, columns=columns).save(tmp_path / "t.toml")
    data = DesignSchema.load(tmp_path / "t.toml").read(tmp_path / "t.csv")
    assert data.variables[0].high > 1e38
    assert data.rules.fixed == ((1, 1.0),)
