"""Three kinds of tables from the log to a service: a decision, actions for new rows, ONNX and HTTP, all of them the same."""

import json
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.files import read_json
from deadreckon.policies import portable
from deadreckon.runs.player import chosen, predictor
from deadreckon.runs.service import Service, app
from tests.asked import post

CLOSE = 1e-5  # of half an action's range
ROWS, FRESH = 1_000, 60  # of the log, and new ones


class Table(NamedTuple):
    """A table, and how it is used.

    Attributes:
        make: gives the data frame of so many rows of a random seed.
        schema: as a person writes it, in TOML.
        ope: further options of this command.
        ranges: half the range of each action; None of a discrete one.
        renamed: (column, level, other name) of the new rows.
        deploy: whether the decision is to deploy the policy.
        right: of new rows and actions, (rows,) whether these are as the log teaches, so that names cannot be exchanged.
        units: what `predict` says of them, if anything.
    """

    make: object
    schema: str
    ope: str
    ranges: dict
    renamed: tuple
    deploy: bool
    right: object
    units: str


def offers(rows, seed):
    """One step: the best of three offers depends on the plan; it has been made to 80 % of the customers."""
    rng = np.random.default_rng(seed)
    plan = rng.integers(0, 3, rows)
    offer = np.where(best := rng.random(rows) < 0.8, (plan + 1) % 3, (plan + rng.choice([0, 2], rows)) % 3)
    return pd.DataFrame({
        "id": np.arange(rows), "age": rng.integers(18, 80, rows), "plan": np.array(["free", "pro", "team"])[plan],
        "grade": rng.choice([1, 3, 7], rows), "member": rng.random(rows) < 0.5,
        "offer": np.array(["call", "mail", "none"])[offer], "logged_with": np.where(best, 0.8, 0.1),
        "paid": (2.0 * (offer == (plan + 1) % 3) + rng.random(rows)).round(3),
    })  # fmt: skip


OFFERS = Table(
    offers,
    """
    [table]
    path = "log.csv"

    [columns]
    id = {role = "ignore", kind = "integer"}
    age = {role = "observation", kind = "integer", low = 0, high = 120, unit = "years"}
    plan = {role = "observation", kind = "category", levels = ["team", "pro", "free"]}
    grade = {role = "observation", kind = "category", levels = [1, 3, 7]}
    member = {role = "observation", kind = "flag"}
    offer = {role = "action", kind = "category", levels = ["none", "mail", "call"]}
    logged_with = {role = "propensity", kind = "number"}
    paid = {role = "reward", kind = "number", unit = "EUR"}
    """,
    "--greedy", {"offer": None}, ("plan", "pro", "professional"), True,
    lambda rows, actions: actions["offer"] == rows["plan"].map({"free": "mail", "pro": "none", "team": "call"}), "",
)  # fmt: skip


def visits(rows, seed):
    """Several steps: a patient's visits on dates of a day-first form; laboratory values and wards are missing at times."""
    rng = np.random.default_rng(seed)
    lab, ward = rng.normal(5, 1, rows), rng.integers(0, 3, rows)
    right = rng.random(rows) < 0.8
    dose = np.where(right, ward == 0, ward != 0).astype(int)
    patient, visit = np.arange(rows) // 3, np.arange(rows) % 3
    dates = pd.Timestamp("2024-01-05") + pd.to_timedelta(9 * visit + patient, unit="D")
    return pd.DataFrame({
        "patient": [f"p{each}" for each in patient], "date": dates.strftime("%d.%m.%Y"),
        "lab": np.where(rng.random(rows) < 0.2, np.nan, lab.round(2)),
        "ward": np.where(rng.random(rows) < 0.1, None, np.array(["north", "south", "east"], object)[ward]),
        "dose": np.array(["low", "high"])[dose], "logged_with": np.where(right, 0.8, 0.2),
        "recovered": (right + 0.1 * rng.random(rows)).round(3),
    })  # fmt: skip


VISITS = Table(
    visits,
    """
    [table]
    path = "log.csv"
    dates = "day-first"

    [columns]
    patient = {role = "episode", kind = "category"}
    date = {role = "time", kind = "date"}
    lab = {role = "observation", kind = "number", marked = true, unit = "mmol/l"}
    ward = {role = "observation", kind = "category", levels = ["north", "south", "east"], marked = true}
    dose = {role = "action", kind = "category", levels = ["low", "high"]}
    logged_with = {role = "propensity", kind = "number"}
    recovered = {role = "reward", kind = "number"}
    """,
    "--greedy --horizon 3", {"dose": None},
    ("ward", "north", "North"), True,
    lambda rows, actions: (actions["dose"] == np.where(rows["ward"] == "north", "high", "low")) | rows["ward"].isna(), "",
)  # fmt: skip


def rooms(rows, seed):
    """Two continuous actions with units, in days of eight hours."""
    rng = np.random.default_rng(seed)
    outside, room = rng.normal(8, 6, rows).round(2), rng.integers(0, 2, rows)
    supply = np.clip(45 - outside + rng.normal(0, 3, rows), 20, 70).round(2)
    fan = np.clip(0.5 * room + rng.normal(0.3, 0.1, rows), 0, 1).round(3)
    return pd.DataFrame({
        "day": np.arange(rows) // 8, "hour": np.arange(rows) % 8, "outside": outside,
        "room": np.array(["lab", "office"])[room], "supply": supply, "fan": fan,
        "cost": (-0.01 * supply - fan + 0.1 * rng.random(rows)).round(3),
    })  # fmt: skip


ROOMS = Table(
    rooms,
    """
    [table]
    path = "log.csv"

    [columns]
    day = {role = "episode", kind = "integer"}
    hour = {role = "time", kind = "integer"}
    outside = {role = "observation", kind = "number", unit = "degC"}
    room = {role = "observation", kind = "category", levels = ["office", "lab"]}
    supply = {role = "action", kind = "number", low = 20, high = 70, unit = "degC"}
    fan = {role = "action", kind = "number", low = 0, high = 1, unit = "share"}
    cost = {role = "reward", kind = "number"}
    """,
    "--discount 0.9",
    {"supply": 25.0, "fan": 0.5}, ("room", "lab", "laboratory"), False,
    lambda rows, actions: (actions["fan"] > 0.55) == (rows["room"] == "office"),
    "units: supply in degC, fan in share",
)  # fmt: skip

TABLES = {"one-step": OFFERS, "sequential": VISITS, "continuous": ROOMS}


def command(words, capsys, code=0):
    """What a command prints; it must end with this code."""
    assert main(words) == code, capsys.readouterr().err
    said = capsys.readouterr()
    return said.err if code else said.out


def same(table, found, wanted):
    """Actions by name are the same: discrete ones exactly, continuous ones nearly."""
    assert list(found) == list(wanted) == list(table.ranges)
    for key, half in table.ranges.items():
        if half is None:
            assert list(found[key]) == list(wanted[key]), key
        else:
            np.testing.assert_allclose(found[key], wanted[key], rtol=0, atol=CLOSE * half, err_msg=key)


def by_name(table, actions):
    """{column: actions}, also where there is one column."""
    return actions if isinstance(actions, dict) else {next(iter(table.ranges)): actions}


def as_json(frame):
    """Rows as they are sent; null is missing."""
    return json.loads(frame.to_json(orient="records"))


def in_onnx(file, frame):
    """{output: values} of the graph for the columns of a frame, by what the graph says of its inputs."""
    runtime = pytest.importorskip("onnxruntime")
    session, given = runtime.InferenceSession(str(file)), {}
    for each in session.get_inputs():
        column = frame[each.name]
        if each.type == "tensor(string)":
            given[each.name] = column.fillna("").to_numpy(object)
        else:
            given[each.name] = column.to_numpy({"tensor(float)": np.float32, "tensor(double)": np.float64}[each.type])
    names = [each.name for each in session.get_outputs()]
    return dict(zip(names, session.run(names, given)))


def decided(table, folder, capsys, judged):
    """Trains and judges; gives the folder whose policy is used: the decision's if it is to deploy, else the run's."""
    (folder / "log.toml").write_text("\n".join(line.strip() for line in table.schema.splitlines()))
    table.make(ROWS, seed=0).to_csv(folder / "log.csv", index=False)
    log, run, card = str(folder / "log.toml"), folder / "run", folder / "card"
    words = ["train", "--agent", "bc", "--agent.hidden", "32", "--agent.lr", "0.01", "--agent.batch-size", "32"]
    command([*words, "--steps", "200", "--holdout", "0.5", "--data", log, "--out", str(run)], capsys)
    if not judged:
        return run
    words = ["ope", "--data", log, "--policies", str(run), "--select", "--out", str(card)]
    words += ["--estimators", "is", "--steps", "50", "--hidden", "8", *table.ope.split()]
    said = command(words, capsys)
    assert ("\nDEPLOY run seed 0" if table.deploy else "\nDO NOT DEPLOY") in said
    assert read_json(card / "estimates.json")["choice"]["deploy"] == table.deploy
    return card if table.deploy else run


def used(table, folder, capsys, judged=True):
    """From the log to `predict` in numpy and JAX and to HTTP; gives the folder of the policy, new rows, and their actions."""
    place = decided(table, folder, capsys, judged)
    fresh = table.make(FRESH, seed=1)
    fresh.drop(columns=list(table.ranges)).to_csv(folder / "fresh.csv", index=False)
    given = fresh.astype(object).where(fresh.notna(), None)
    found = chosen(place)

    wanted = by_name(table, dr.load_policy(found.file).predict(given))  # in JAX
    for key, values in wanted.items():
        assert len(set(np.asarray(values).tolist())) > 1, key  # a policy that does one thing would hide a wrong encoding
    assert np.mean(table.right(fresh, wanted)) > 0.8
    said = command(["predict", str(place), str(folder / "fresh.csv"), "--out", str(folder / "actions.csv")], capsys)
    assert ("units: " in said) == bool(table.units)
    assert table.units in said
    same(table, pd.read_csv(folder / "actions.csv")[list(table.ranges)].to_dict("list"), wanted)
    same(table, by_name(table, portable.load(found.file).predict(given)), wanted)

    service = app(Service(predictor(found.file), found.words))
    status, told = post(service, as_json(fresh))
    assert status == 200, told
    same(table, {key: [row[key] for row in told["actions"]] for key in told["actions"][0]}, wanted)
    refused(table, folder, capsys, place, service, fresh)
    return place, fresh, wanted


def refused(table, folder, capsys, place, service, fresh):
    """A level of another name is refused with its column, its row and the level, and nothing is written."""
    column, level, name = table.renamed
    other = fresh.replace({column: {level: name}})
    row = fresh[column].tolist().index(level)
    words = f"column {column} has {name!r} in row {row}, which is none of its levels"
    other.to_csv(folder / "other.csv", index=False)
    assert words in command(["predict", str(place), str(folder / "other.csv"), "--out", str(folder / "no.csv")], capsys, code=2)
    assert not (folder / "no.csv").exists()
    for policy in (dr.load_policy(chosen(place).file), portable.load(chosen(place).file)):
        with pytest.raises(ValueError, match=words):
            policy.predict(other.astype(object).where(other.notna(), None))
    status, told = post(service, as_json(other))
    assert (status, words in told["error"]) == (422, True), told


def exported(table, folder, capsys, place, fresh, wanted):
    """The ONNX graph does the same by the same columns, and marks levels that it does not know."""
    pytest.importorskip("jax2onnx")
    command(["export", str(place), "--format", "onnx", "--out", str(folder / "onnx")], capsys)
    named = lambda told: (  # noqa: E731
        {next(iter(table.ranges)): told["action_name"]} if "action_name" in told else dict(zip(table.ranges, told["action"].T))
    )
    file = folder / "onnx" / "policy.onnx"
    same(table, named(in_onnx(file, fresh)), wanted)
    column, level, name = table.renamed
    other = fresh.replace({column: {level: name}})
    told = in_onnx(file, other)
    assert told["outside_the_log"][fresh[column] == level].all()
    flagged = dr.load_policy(chosen(place).file).predict(other.astype(object).where(other.notna(), None), outside="flag")
    same(table, named(told), by_name(table, flagged.actions))
    return folder / "onnx" / "card.md"


def test_a_table_with_missing_values_from_the_log_to_http(tmp_path, capsys):
    """Without what takes long: the decision and ONNX."""
    used(VISITS, tmp_path, capsys, judged=False)


@pytest.mark.slow  # jax2onnx takes ten seconds to be imported
def test_one_step_with_named_actions_from_the_log_to_onnx_and_http(tmp_path, capsys):
    card = exported(OFFERS, tmp_path, capsys, *used(OFFERS, tmp_path, capsys))
    assert "**DEPLOY**" in card.read_text()


@pytest.mark.slow
def test_episodes_with_missing_values_and_dates_from_the_log_to_onnx_and_http(tmp_path, capsys):
    card = exported(VISITS, tmp_path, capsys, *used(VISITS, tmp_path, capsys))
    assert "mmol/l" in card.read_text()


@pytest.mark.slow
def test_several_continuous_actions_with_units_from_the_log_to_onnx_and_http(tmp_path, capsys):
    card = exported(ROOMS, tmp_path, capsys, *used(ROOMS, tmp_path, capsys))
    assert "degC" in card.read_text()
