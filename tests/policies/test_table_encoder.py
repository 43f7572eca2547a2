"""Rows are encoded at use as `data.encode` encoded the log, whatever they are given as, by numpy alone."""

import json
import sqlite3
import subprocess
import sys
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats import cells
from deadreckon.policies import table_encoder
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.policies.table_rows import RowsError, columns_of, flags_of, numbers_of
from deadreckon.runs.reading import noted

ROWS = 60


def table(seed=0):
    """Numbers, whole numbers, texts that say numbers, decimals, flags, texts, codes and categories, some of them missing."""
    rng = np.random.default_rng(seed)
    return pd.DataFrame({
        "temp": np.where(rng.random(ROWS) < 0.2, np.nan, rng.normal(20.0, 7.0, ROWS)), "count": rng.integers(0, 9, ROWS),
        "text": [f"{value:.3f}" for value in rng.normal(size=ROWS)], "price": [Decimal(f"{i}.25") for i in range(ROWS)],
        "on": rng.random(ROWS) < 0.5, "mode": rng.choice(["auto", "man", "off"], ROWS), "zone": rng.integers(3, 6, ROWS),
        "kind": pd.Categorical(rng.choice(["x", "y", None], ROWS)), "small": rng.normal(size=ROWS).astype(np.float32),
        "offer": rng.choice(["a", "b", "c"], ROWS), "reward": rng.normal(size=ROWS),
    })  # fmt: skip


@pytest.fixture(scope="module")
def log():
    return Dataset.from_frame(table(), action="offer", reward="reward", kinds={"zone": "category"})


@pytest.fixture(scope="module")
def encoder(log):
    return TableEncoder(json.loads(json.dumps(noted(log))))


def of_sqlite(frame):
    """The rows of a frame as sqlite3 gives them."""
    base = sqlite3.connect(":memory:")
    base.row_factory = sqlite3.Row
    frame.astype({"price": float, "on": int, "kind": object}).to_sql("t", base, index=False)
    return base.execute("select * from t").fetchall()


FORMS = {
    "pandas": lambda t: t, "arrow": pa.Table.from_pandas, "rows": lambda t: t.to_dict("records"),
    "columns": lambda t: {key: t[key].to_numpy() for key in t}, "lists": lambda t: {key: t[key].tolist() for key in t},
    "nullable": lambda t: t.convert_dtypes(), "series": lambda t: [row[::-1] for _, row in t.iterrows()],
    "tuples": lambda t: list(t[t.columns[::-1]].itertuples()), "sqlite3": lambda t: of_sqlite(t[t.columns[::-1]]),
    "masked": lambda t: {key: np.ma.masked_array(t[key].fillna(77 if key == "temp" else "x"), t[key].isna()) for key in t},
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("outside", ["raise", "flag"])
def test_the_logs_own_rows_are_encoded_as_in_training(encoder, log, form, outside):
    found = encoder.encode(FORMS[form](table()), outside=outside)
    np.testing.assert_array_equal(found.observations, log.observations)
    assert found.observations.dtype == np.float32
    assert not found.outside.any()


def test_a_row_alone_is_as_among_others(encoder, log):
    for row in (0, 7, 20):
        found = encoder.encode(table().iloc[row].to_dict())
        assert found.single
        np.testing.assert_array_equal(found.observations[0], log.observations[row])


def test_levels_are_found_by_their_names_and_not_by_their_order(encoder, log):
    """Text, number and truth value of a level are one; a table with fewer levels, or in another order, is no other table."""
    part = table()[["kind", "zone", "mode", "small", "price", "temp", "text", "on", "count"]].iloc[5:9]
    part = part.astype({"zone": str, "kind": object})
    np.testing.assert_array_equal(encoder.encode(part).observations, log.observations[5:9])


@pytest.mark.parametrize(
    "words",
    [("yes", "no"), ("True", "FALSE"), (" Ja", "nein "), ("1", "0"), (np.True_, np.False_), (np.int64(1), np.float32(0))],
)
def test_flags_as_people_and_libraries_write_them(encoder, log, words):
    given = table()
    given["on"] = pd.Series([words[0] if on else words[1] for on in given["on"]], dtype=object)
    np.testing.assert_array_equal(encoder.encode(given).observations, log.observations)
    np.testing.assert_array_equal(encoder.encode(given.iloc[3].to_dict()).observations[0], log.observations[3])


def test_words_for_what_is_missing_are_missing_flags():
    frame = table().astype({"on": object})
    frame.loc[3, "on"] = None
    log = Dataset.from_frame(frame, action="offer", reward="reward", kinds={"zone": "category"})
    coder = TableEncoder(json.loads(json.dumps(noted(log))))
    for word in ("NA", "", "null", None, np.nan):
        frame.loc[3, "on"] = word
        np.testing.assert_array_equal(coder.encode(frame).observations, log.observations)


def test_the_words_of_flags_are_those_of_files():
    """The modules that need numpy alone have their own list of them, which must not become another one."""
    for yes, no in cells._PAIRS:
        assert flags_of("on", np.array([yes, no, yes.upper()], object), "rows").tolist() == [1.0, 0.0, 1.0]
    missing = np.array(cells.MISSING, object)
    assert np.isnan(flags_of("on", missing, "rows")).all()


WRONG = {
    "an unknown level": ({"mode": "aut"}, "column mode has 'aut' in row 1, which is none of its levels: did you mean auto"),
    "a text": ({"temp": "warm"}, "column temp has 'warm' in row 1, a number is needed"),
    "a date": ({"temp": pd.Timestamp("2024-01-01")}, "column temp has .* in row 1, a number is needed"),
    "a new missing number": ({"count": None}, "column count is empty in row 1, and the log has no missing value there"),
    "a new missing level": ({"mode": None}, "column mode is empty in row 1, and the log has no missing value there"),
    "an empty level": ({"mode": ""}, "column mode is empty in row 1, and the log has no missing value there"),
    "no flag": ({"on": 2}, "column on has 2.0 in row 1, a flag is true or false, 1 or 0, yes or no"),
    "no word of a flag": ({"on": "unknown"}, "column on has 'unknown' in row 1, a flag is true or false, 1 or 0, yes or no"),
    "infinite": ({"count": float("inf")}, "column count has inf in row 1, a finite number is needed"),
    "beyond float32": ({"count": 1e300}, "column count has 1e.300 in row 1, which float32 cannot hold"),
    "a list": ({"mode": ["auto"]}, r"column mode has \['auto'\] in row 1, which is none of its levels"),
    "thousands of digits": ({"mode": 10**5_000}, "column mode has a whole number of thousands of digits in row 1, which is"),
    "huge": ({"count": 10**400}, "column count has 1000.* in row 1, a number is needed"),
    "digits of another script": ({"text": "١"}, "column text has '١' in row 1, a number is needed"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_rows_that_are_refused(encoder, case):
    rows = table().to_dict("records")[:3]
    rows[1] |= WRONG[case][0]
    with pytest.raises(RowsError, match=WRONG[case][1]):
        encoder.encode(rows)


@pytest.mark.parametrize("unit", ["ns", "us", "D"])
@pytest.mark.parametrize("kind", ["datetime64", "timedelta64"])
def test_dates_and_durations_are_no_numbers_in_any_unit(unit, kind):
    values = np.array(["NaT", 0, 1], f"{kind}[{unit}]")
    for reader, needed in ((numbers_of, "a number is needed"), (flags_of, "a flag is true or false")):
        with pytest.raises(RowsError, match=f"column a has '.*' in row 1, {needed}"):
            reader("a", values, "rows")
        assert np.isnan(reader("a", values[:1], "rows")).all()


def test_a_row_with_names_is_read_by_them(encoder, log):
    for row in (table().iloc[3][::-1], next(table().iloc[3:].itertuples())):
        found = encoder.encode(row)
        assert found.single
        np.testing.assert_array_equal(found.observations, log.observations[3:4])


def test_what_has_no_rows_or_no_columns_yet(encoder):
    class Relation:
        """A table of a database whose columns are given by their names alone."""

        columns = ("temp", "count")

        def __getitem__(self, key):
            raise TypeError

    with pytest.raises(RowsError, match="rows: there are no rows"):
        encoder.encode([])
    with pytest.raises(RowsError, match="the columns of a Relation cannot be read; a data frame, an Arrow table or"):
        encoder.encode(Relation())
    with pytest.raises(RowsError, match="rows: column day is one value, 3, and others are columns"):
        columns_of({"temp": [1.0, 2.0], "day": np.array(3)}, ["temp"], ["day"], "rows")


def test_columns_that_are_not_there(encoder):
    rows = table().to_dict("records")[:3]
    with pytest.raises(RowsError, match="rows: no column temp: did you mean temps?"):
        encoder.encode(table().rename(columns={"temp": "temps"}))
    del rows[2]["temp"]
    with pytest.raises(RowsError, match=r"row 2 has no column temp.*; say null where a value is missing"):
        encoder.encode(rows)
    with pytest.raises(RowsError, match="row 1 is a text, a dictionary of columns is needed"):
        encoder.encode([rows[0], "no"])
    with pytest.raises(RowsError, match="column count has the shape 2, the first one has 60 values"):
        encoder.encode({**{key: table()[key].to_numpy() for key in table()}, "count": [1, 2]})
    with pytest.raises(RowsError, match=r"observations must have the shape \(rows, 16\), or be given by the columns temp"):
        encoder.encode(np.zeros((3, 4)))
    with pytest.raises(RowsError, match="dictionaries or arrays of numbers, got a text"):
        encoder.encode("temp")
    with pytest.raises(RowsError, match="leave legal out"):
        encoder.encode(rows[:1], legal=[[1, 1, 1]])


def test_rows_outside_the_log_are_flagged(encoder, log):
    """The rule: an unknown level, a value beyond those of the log, or a missing one where the log misses none."""
    changes = [{"mode": "new"}, {"count": 9}, {"count": 8}, {"temp": -60.0}, {"temp": None}, {"count": None}, {"mode": None}]
    changes.append({})
    rows = [table().iloc[3].to_dict() | change for change in changes]
    found = encoder.encode(rows, outside="flag")
    assert found.outside.tolist() == [True, True, False, True, False, True, True, False]
    names = log.provenance.extra["observation_names"]
    modes = [names.index(f"mode={level}") for level in ("auto", "man", "off")]
    assert found.observations[[0, 6]][:, modes].sum() == 0  # no level
    assert found.observations[5, names.index("count")] == np.float32(table()["count"].mean())
    np.testing.assert_array_equal(found.observations[7], log.observations[3])


def test_the_range_of_a_schema_is_kept():
    given = table()[["count", "offer", "reward"]]
    columns = {"count": {"role": "observation", "kind": "integer", "low": -1.0, "high": 20}, "offer": {"role": "action",
               "kind": "category"}, "reward": {"role": "reward"}}  # fmt: skip
    encoder = TableEncoder(noted(Dataset.from_frame(given, schema={"columns": columns})))
    assert encoder.encode({"count": 15}).observations.tolist() == [[15.0]]
    with pytest.raises(RowsError, match=r"column count has 21 in row 0, outside the range -1 \.\. 20 that the schema gives"):
        encoder.encode({"count": 21})
    assert encoder.encode({"count": [8, 15, 21]}, outside="flag").outside.tolist() == [False, True, True]


def test_what_is_filled_by_the_mean_though_the_log_missed_nothing():
    """A schema may mark missing values that the log does not have yet."""
    columns = {"count": {"role": "observation", "kind": "integer", "marked": True}, "offer": {"role": "action",
               "kind": "category"}, "reward": {"role": "reward"}}  # fmt: skip
    log = Dataset.from_frame(table()[["count", "offer", "reward"]], schema={"columns": columns})
    found = TableEncoder(noted(log)).encode({"count": None})
    np.testing.assert_array_equal(found.observations, [[np.float32(table()["count"].mean()), 1.0]])


LEGAL = {
    "texts": ["wait|call", "call", "visit|wait|call", "wait|call"],
    "lists": [["wait", "call"], ["call"], ["visit", "wait", "call"], ["wait", "call"]],
    "JSON": ['["wait", "call"]', '["call"]', '["visit", "wait", "call"]', '["wait", "call"]'],
    "commas": ["wait, call", "call", "['visit', 'wait', 'call']", "wait,call"],
}  # fmt: skip


@pytest.mark.parametrize("form", LEGAL)
def test_legal_actions_that_a_column_lists(form):
    given = {"x": [0.0, 1.0, 2.0, 3.0], "action": ["wait", "call", "wait", "call"], "reward": [0.0] * 4, "legal": LEGAL[form]}
    log = Dataset.from_frame(given, legal="legal")
    encoder = TableEncoder(noted(log))
    np.testing.assert_array_equal(encoder.encode(given).observations, log.observations)
    for row in range(4):
        found = encoder.encode({"x": row, "legal": LEGAL[form][row]})
        np.testing.assert_array_equal(found.observations[0], log.observations[row])
    with pytest.raises(RowsError, match="column legal has 'cal' in row 0, which is no action: did you mean call"):
        encoder.encode({"x": 0.0, "legal": "wait|cal"})
    with pytest.raises(RowsError, match="no action is legal in row 0"):
        encoder.encode({"x": 0.0, "legal": []})
    with pytest.raises(RowsError, match="no column legal, which says which actions are legal"):
        encoder.encode({"x": 0.0})
    assert encoder.encode({"x": 0.0}, legal=[0, 1, 0]).observations.tolist() == [[0.0, 0.0, 1.0, 0.0]]
    with pytest.raises(RowsError, match=r"legal must be truth values of shape \(1, 3\), got shape \(2,\)"):
        encoder.encode({"x": 0.0}, legal=[0, 1])


def test_legal_actions_of_columns_and_of_a_function():
    given = {"x": [0.0, 1.0, 2.0], "action": [20, 50, 20], "reward": [0.0] * 3}
    given |= {"legal_20": [1, 0, 1], "legal_50": [0, 1, 1]}
    log = Dataset.from_frame(given, legal="legal")
    encoder = TableEncoder(noted(log))
    np.testing.assert_array_equal(encoder.encode(given).observations, log.observations)
    assert encoder.named([1, 0]).tolist() == [50, 20]
    del given["legal_20"], given["legal_50"]
    log = Dataset.from_frame(given, legal=lambda seen: np.stack([seen[:, 0] != 1, seen[:, 0] > 0], 1))
    encoder = TableEncoder(noted(log))
    with pytest.raises(RowsError, match=r"give legal, truth values of shape \(3, 2\)"):
        encoder.encode(given)
    np.testing.assert_array_equal(encoder.encode(given, legal=log.observations[:, -2:]).observations, log.observations)


ACTIONS = {
    "texts": (["b", "a", "b"], [1, 0, 1], ["b", "a", "b"]),
    "truth values": ([True, False, True], [1, 0, 1], [True, False, True]),
    "whole numbers": ([0, 1, 0], [0, 1, 0], [0, 1, 0]), "other whole numbers": ([30, 10, 30], [1, 0, 1], [30, 10, 30]),
    "one": (["b", "b", "b"], [0, 0, 0], ["b", "b", "b"]),
}  # fmt: skip


@pytest.mark.parametrize("case", ACTIONS)
def test_discrete_actions_have_their_names(case):
    given, codes, named = ACTIONS[case]
    log = Dataset.from_frame({"x": [0.0, 1.0, 2.0], "action": given, "reward": [0.0] * 3}, action="action")
    encoder = TableEncoder(noted(log))
    assert log.actions.tolist() == codes
    assert encoder.named(log.actions).tolist() == named
    np.testing.assert_array_equal(encoder.logged({"action": np.asarray(given)}), log.actions)
    assert len(encoder.names) == log.action_space.n


def test_continuous_actions_become_a_table():
    given = {"x": [0.0, 1.0], "valve": [0.5, 0.25], "fan": [30.0, 10.0], "reward": [0.0] * 2}
    encoder = TableEncoder(noted(Dataset.from_frame(given, action=["valve", "fan"])))
    named = encoder.named(np.array([[0.5, 30.0], [0.25, 10.0]]))
    assert {key: values.tolist() for key, values in named.items()} == {"valve": [0.5, 0.25], "fan": [30.0, 10.0]}
    encoder = TableEncoder(noted(Dataset.from_frame({**given, "fan": ["a", "b"]}, action="valve")))
    assert encoder.named(np.array([[0.5], [0.25]])).tolist() == [0.5, 0.25]


def test_a_log_without_a_schema_takes_arrays_alone():
    log = Dataset.from_arrays(observations=np.zeros((4, 3)), actions=np.zeros((4, 2)), rewards=np.zeros(4))
    encoder = TableEncoder(noted(log))
    assert encoder.encode([1.0, 2.0, 3.0]).single
    np.testing.assert_array_equal(encoder.encode(np.ones((5, 3))).observations, np.ones((5, 3)))
    assert encoder.named(np.ones((5, 2))).shape == (5, 2)
    with pytest.raises(RowsError, match=r"has no schema of its log: .* give arrays of observations \(rows, 3\), or train"):
        encoder.encode({"x": 1.0})
    with pytest.raises(RowsError, match="not finite in row 1"):
        encoder.encode([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]])
    with pytest.raises(RowsError, match="has no schema"):
        TableEncoder({}).encode([{"x": 1.0}])


def test_the_encoder_needs_numpy_alone(encoder, log, tmp_path):
    """Copied to a folder of its own, where nothing of the package can be imported."""
    for name in ("table_rows", "table_columns", "table_encoder"):
        source = Path(table_encoder.__file__).with_name(f"{name}.py")
        (tmp_path / source.name).write_text(source.read_text())
    (tmp_path / "log.json").write_text(json.dumps(noted(log)))
    rows = table().assign(price=[float(price) for price in table()["price"]])
    (tmp_path / "rows.json").write_text(rows.to_json(orient="records"))
    code = (
        "import json, sys, table_encoder as t; read = lambda f: json.load(open(f)); "
        "print(json.dumps(t.TableEncoder(read('log.json')).encode(read('rows.json')).observations.tolist())); "
        "print(*(m for m in ('deadreckon', 'jax', 'pyarrow') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env={}, check=True)
    found, loaded = done.stdout.split("\n")[:2]
    assert loaded == ""
    np.testing.assert_allclose(json.loads(found), log.observations, atol=1e-6)  # JSON has ten decimals
