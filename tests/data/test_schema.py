import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

from deadreckon.cli.main import main
from deadreckon.data.dataset import Dataset
from deadreckon.data.describe import describe_table
from deadreckon.data.formats.any_table import read_rows
from deadreckon.data.formats.io import convert, read
from deadreckon.data.schema import Column, Schema
from deadreckon.errors import UserError

TABLE = """day,minute,temp,mode,note,valve,saved,done
1,0,20.1,auto,a,0.1,3.2,0
1,1,,auto,b,0.3,1.1,0
2,0,19.8,"man ""u"" al",c,0.2,1.0,0
2,1,19.5,auto,d,0.4,1.5,1
"""
NAMED = {"episode": "day", "time": "minute", "action": "valve", "reward": "saved", "terminal": "done", "ignore": "note"}


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "chiller.csv"
    path.write_text(TABLE)
    return path


def test_what_is_drafted_is_read_alike(table, tmp_path):
    schema, told = describe_table(table, **NAMED)
    schema.save(tmp_path / "chiller.toml")
    assert Schema.load(tmp_path / "chiller.toml") == schema
    assert any("temp 1" in line for line in told)
    asked, by_schema = read(table, **NAMED), read(table, schema=tmp_path / "chiller.toml")
    beside = read(tmp_path / "chiller.toml")
    assert asked.fingerprint == by_schema.fingerprint == beside.fingerprint
    assert by_schema.warnings == asked.warnings
    assert schema.one("time").name == "minute"
    assert {c.name: c.levels for c in schema.columns if c.levels} == {"mode": ("auto", 'man "u" al')}


def test_reasons_and_doubts_stand_in_the_file(table):
    schema, told = describe_table(table, reward="saved", action="valve")
    text = schema.to_toml("Schema of a chiller.")
    assert text.startswith("# Schema of a chiller.\n# Lines that begin with `# ?` are doubts")
    assert "# ? marks ends of episodes and is left out: --terminal done" in text
    assert "19.5 .. 20.1, 1 missing" in text
    assert any(line.startswith("column done marks ends of episodes") for line in told)


def test_a_table_of_which_nothing_is_known_is_described_too(table):
    schema, told = describe_table(table)
    assert sum(line.startswith("no column is the reward by its name") for line in told) == 1
    assert schema.one("reward") is None
    assert schema.named("ignore") == ["done"]


def test_changed_by_hand(table, tmp_path):
    schema, _ = describe_table(table, **NAMED)
    text = schema.to_toml()
    at = text.index('[columns."valve"]')
    changed = text[:at] + text[at:].replace('kind = "number"', 'kind = "number"\nlow = 0.0\nhigh = 2.0\nunit = "share"', 1)
    (tmp_path / "changed.toml").write_text(changed)
    log = read(table, schema=tmp_path / "changed.toml")
    assert (log.action_space.low, log.action_space.high) == ((0.0,), (2.0,))
    assert log.provenance.extra["schema"]["columns"]["valve"]["unit"] == "share"


def test_a_zero_is_kept():
    """A range that begins at 0 and a fill of 0 are something else than nothing."""
    column = Column("x", "action", "number", low=0.0, high=1.0, fill=0)
    schema = Schema((column,))
    assert Schema.from_json(schema.to_json()) == schema
    assert "low = 0.0\nhigh = 1.0\nfill = 0" in schema.to_toml()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[columns.x]\nrole = 'obs'", "x.toml, column x: unknown role 'obs'|schema, column x: unknown role 'obs'"),
        ("[columns.x]\nkind = 'number'", "column x needs a role"),
        ("[columns.x]\nrole = 'observation'\nkind = 'date'", "column x: kind date does not go with the role observation"),
        ("[columns.x]\nrole = 'observation'\nlows = 1", "column x: unknown entry 'lows': did you mean low"),
        ("[columns.x]\nrole = 'action'\nlow = 2\nhigh = 1", "low must be smaller than high, got 2 and 1"),
        ("[columns.x]\nrole = 'action'\nlow = 'a'", "low must be a finite number, got 'a'"),
        ("[columns.x]\nrole = 'action'\nlevels = ['a', 'a']", "a level is listed twice"),
        ("[columns.x]\nrole = 'action'\nlevels = 3", "levels must be a list"),
        ("[columns.x]\nrole = 'action'\nlevels = [[1], [2]]", r"levels are texts, numbers or truth values, got \[1\]"),
        ("[columns.x]\nrole = 'reward'\n[columns.y]\nrole = 'reward'", "columns x and y both have the role reward"),
        ("[columns.x]\nrole = 'next_observation'", "a next observation needs of = the name of an observation"),
        ("[columns.x]\nrole = 'observation'\nmarked = 1", "marked must be true or false"),
        ("[columns.x]\nrole = 'observation'\nunit = 1", "unit must be a text"),
        ("[tables]\na = 1\n[columns.x]\nrole = 'observation'", "unknown entry 'tables'"),
        ("table = 1\n[columns.x]\nrole = 'observation'", r"\[table\] holds options of the file"),
        ("columns = 3", "a schema needs a table"),
        ("[columns.x", "not TOML"),
    ],
)
def test_bad_schemas_are_told_in_one_line(tmp_path, text, words):
    path = tmp_path / "x.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=words) as caught:
        Schema.load(path)
    assert "\n" not in str(caught.value)


def test_a_schema_that_does_not_fit_is_told(table, tmp_path):
    schema, _ = describe_table(table, **NAMED)
    with pytest.raises(UserError, match="leave reward out, or change the schema"):
        read(table, schema=schema, reward="saved")
    more = Schema((*schema.columns, Column("tmp", "observation")))
    with pytest.raises(UserError, match="no column tmp, to which the schema gives the role observation: did you mean temp"):
        read(table, schema=more)
    fewer = Schema(tuple(column for column in schema.columns if column.name != "note"))
    assert any("does not have these columns, which are left out: note" in line for line in read(table, schema=fewer).warnings)
    without = Schema(tuple(column for column in schema.columns if column.role != "reward"))
    with pytest.raises(UserError, match="the schema gives no column the role reward"):
        read(table, schema=without)
    with pytest.raises(UserError, match="no file .*nowhere.toml; `deadreckon data describe TABLE"):
        read(table, schema=tmp_path / "nowhere.toml")


def test_flags_of_a_schema_may_be_words_in_data_frames(tmp_path):
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"on": rng.choice(["yes", "no"], 30), "x": rng.normal(size=30), "action": [0, 1] * 15, "reward": 0.0})
    frame.to_csv(tmp_path / "log.csv", index=False)
    log = read(tmp_path / "log.csv")
    found = Dataset.from_frame(frame, schema=log.provenance.extra["schema"])
    np.testing.assert_array_equal(found.observations, log.observations)
    frame.to_parquet(tmp_path / "log.parquet")
    again = read(tmp_path / "log.parquet", schema=log.provenance.extra["schema"])
    np.testing.assert_array_equal(again.observations, log.observations)
    frame.loc[4, "on"] = "maybe"
    with pytest.raises(UserError, match="frame: column on holds .*, numbers are needed; row"):
        Dataset.from_frame(frame, schema=log.provenance.extra["schema"])


@pytest.mark.parametrize("path", ["/etc/passwd", "../secrets.csv"])
def test_a_schema_names_no_table_elsewhere(tmp_path, path):
    (tmp_path / "x.toml").write_text(f'[table]\npath = "{path}"\n[columns.x]\nrole = "observation"\n')
    with pytest.raises(UserError, match="must lie beside the schema"):
        read(tmp_path / "x.toml")


def test_the_command_drafts_and_others_read(table, tmp_path, capsys):
    out = tmp_path / "chiller.toml"
    options = ["--episode", "day", "--time", "minute", "--action", "valve", "--reward", "saved", "--terminal", "done"]
    main(["data", "describe", str(table), *options, "--ignore", "note", "--save", str(out)])
    assert "! " in capsys.readouterr().err
    main(["data", "info", str(table), "--schema", str(out)])
    first = capsys.readouterr().out
    main(["data", "info", str(out)])
    assert capsys.readouterr().out == first
    assert "4 in 2 episodes" in first
    assert main(["data", "describe", str(table), "--save", str(out)]) == 2
    assert "exists already; --force replaces it" in capsys.readouterr().err


def test_options_of_the_file_in_the_schema_hold_however_it_is_given(tmp_path):
    """1,234 beside semicolons is 1.234 by itself."""
    path, schema = tmp_path / "log.csv", tmp_path / "log.toml"
    path.write_text("x;action;reward\n1,234;0;1\n2,345;1;0\n")
    assert read(path, action="action", reward="reward").observations[0] == np.float32(1.234)
    describe_table(path, thousands="comma", decimal="point").schema.save(schema)
    for log in (read(path, schema=schema), read(schema)):
        assert log.observations[:, 0].tolist() == [1234, 2345]
    assert read(path, schema=schema, thousands="none", decimal="comma").observations[0] == np.float32(1.234)
    convert(path, tmp_path / "log.parquet", schema=schema)
    assert read(tmp_path / "log.parquet").observations[:, 0].tolist() == [1234, 2345]


def test_names_with_line_breaks_stay_within_their_comments(tmp_path):
    name = 'role = "reward"\nmy_user_id'
    schema, told = describe_table({name: [1, 2, 3], "a": [0, 1, 0], "r": [0.0, 1.0, 0.5]})
    assert any("looks like a name" in line for line in told)
    schema.save(tmp_path / "x.toml")
    assert Schema.load(tmp_path / "x.toml") == schema
    assert schema.named("observation") == [name]


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("name = 'x'", r"\[table\]: unknown entry 'name'"), ("strict = true", "unknown entry 'strict'"),
        ("horizon = 3", "unknown entry 'horizon'"), ("schema = 'x'", "unknown entry 'schema'"),
        ("separator = 5", "separator must be a text, got 5"), ("encoding = 3", "encoding must be a text, got 3"),
        ("thousands = ['.']", "thousands must be a text, got"), ("query = true", "query must be a text, got True"),
        ("sheet = true", "sheet must be a text or a number, got True"),
    ],
)  # fmt: skip
def test_a_table_of_a_schema_holds_options_of_reading_alone(table, tmp_path, entry, words):
    path = tmp_path / "x.toml"
    path.write_text(f"[table]\npath = 'chiller.csv'\n{entry}\n[columns.temp]\nrole = 'observation'\n")
    with pytest.raises(UserError, match=words):
        read(path)


def test_a_drafted_schema_pins_the_dialect(tmp_path):
    path = tmp_path / "january.csv"
    path.write_text("day;x;action;reward\n13.01.2024;0,5;0;1,25\n14.01.2024;1,5;1;1,5\n", encoding="latin-1")
    schema, _ = describe_table(path, ignore="day")
    schema.save(tmp_path / "s.toml")
    assert Schema.load(tmp_path / "s.toml").table == {
        "path": "january.csv", "separator": ";", "decimal": ",", "dates": "day-first",
    }  # fmt: skip
    following = tmp_path / "february.csv"
    following.write_text("day;x;action;reward\n01.02.2024;1.234;0;2\n02.02.2024;2.345;1;3\n")
    alone = read(following, action="action", reward="reward", ignore="day")
    assert alone.observations[:, 0].tolist() == pytest.approx([1.234, 2.345])
    assert read(following, schema=tmp_path / "s.toml").observations[:, 0].tolist() == [1234, 2345]
    # So is a file with further rows of a log without a schema of its own.
    log = read(path, action="action", reward="reward", ignore="day")
    table, _ = read_rows(following, Schema.from_json(log.provenance.extra["schema"]))
    assert table["x"].to_pylist() == [1234, 2345]
    # Who writes columns otherwise may write numbers otherwise.
    other, schema = tmp_path / "other.csv", Schema.from_json(log.provenance.extra["schema"])
    other.write_text("day,x,action,reward\n2024-02-01,1.234,0,2\n2024-02-02,2.345,1,3\n")
    for ways in ({}, {"separator": ","}, {"separator": ",", "decimal": "."}):
        assert read_rows(other, schema, **ways)[0]["x"].to_pylist() == pytest.approx([1.234, 2.345])
    other.write_text("day;x;action;reward\n2024-02-01;1.234;0;2\n2024-02-02;2.345;1;3\n")
    assert read_rows(other, schema, decimal=".")[0]["x"].to_pylist() == pytest.approx([1.234, 2.345])
    # Under the marks of the log 20.125 would be 20125 beside an 0.5 that is no number.
    fractions = "day;x;action;reward;y\n2024-02-01;20.125;0;2;0.5\n"
    other.write_text(fractions)
    both = Schema((*schema.columns, Column("y", "observation")), schema.table)
    rows, told = read_rows(other, both)
    assert (rows["x"].to_pylist(), rows["y"].to_pylist()) == ([20.125], [0.5])
    assert "numbers in column y are not written as in the log" in told[0]
    other.write_text(fractions.replace("0.5\n", "half\n"))  # one that is no number whatever the marks are
    assert read_rows(other, both)[0]["x"].to_pylist() == [20125]
    # The same table in formats that have no dialect.
    (tmp_path / "march.json").write_text('[{"x": 1.5, "action": 0}, {"x": 2.5, "action": 1}]')
    assert read_rows(tmp_path / "march.json", schema)[0]["x"].to_pylist() == [1.5, 2.5]
    columns = {"day": ["2024-02-01"] * 2, "x": [1.5, 2.5], "action": [0, 1], "reward": [1.0, 2.0]}
    parquet.write_table(pa.table(columns), tmp_path / "march.parquet")
    assert read(tmp_path / "march.parquet", schema=tmp_path / "s.toml").observations[:, 0].tolist() == [1.5, 2.5]


def test_any_name_of_a_column_is_saved(tmp_path):
    schema = Schema((Column('a\x7f"\\b é', "reward"),))
    schema.save(tmp_path / "s.toml")
    assert Schema.load(tmp_path / "s.toml") == schema


def test_another_month_is_encoded_as_the_first_though_its_cells_look_otherwise(tmp_path):
    """Levels 2, 3 and A1 of which only 2 and 3 occur, flags of yes alone, and a column that missed nothing before."""
    head = "zone,alarm,agreed,temp,action,reward\n"
    zones, agreed = ["2", "3", "A1"] * 8, ["yes", "no", "maybe"] * 8
    (tmp_path / "may.csv").write_text(head + "".join(f"{z},{'no' if i % 2 else 'yes'},{w},{i}.5,{i % 2},{i}\n"
                                                     for i, (z, w) in enumerate(zip(zones, agreed))))  # fmt: skip
    may = read(tmp_path / "may.csv")
    schema = Schema.from_json(may.provenance.extra["schema"])
    june = tmp_path / "june.csv"
    june.write_text(head + "".join(f"{2 + i % 2},yes,{'no' if i % 2 else 'yes'},{i}.5,{i % 2},{i}\n" for i in range(12)))
    for log in (read(june, schema=schema), convert(june, tmp_path / "june.npz", schema=schema)):
        assert log.provenance.extra["observation_names"] == may.provenance.extra["observation_names"]
        place = may.provenance.extra["observation_names"].index("zone=2")
        np.testing.assert_array_equal(log.observations[:, place : place + 3], np.eye(3)[np.arange(12) % 2])
        place = may.provenance.extra["observation_names"].index("agreed=maybe")
        np.testing.assert_array_equal(log.observations[:, place : place + 3], np.eye(3)[[2, 1] * 6])
    june.write_text(june.read_text().replace("4.5", ""))
    with pytest.raises(UserError, match="column temp is empty in row 4, which the schema does not mark"):
        read(june, schema=schema)
    again = Schema.from_json(schema.to_json())
    assert [each.marked for each in again.columns if each.role == "observation"] == [False] * 4
    schema.save(tmp_path / "may.toml")
    assert Schema.load(tmp_path / "may.toml").to_json() == schema.to_json()
