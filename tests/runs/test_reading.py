"""A log that was read otherwise than for training is not taken for one that taught nothing."""

import dataclasses
import sqlite3

import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import convert
from deadreckon.errors import UserError
from deadreckon.policies import store
from deadreckon.runs.crossfit import cross_fit
from deadreckon.runs.gather import check_encodings, fresh, gather
from deadreckon.runs.subject import subject
from deadreckon.runs.train import train

BC = dr.agents.BC(hidden=(4,), batch_size=8)
SHORT = {"steps": 2, "task": False}


def unmarked(path, longer=0):
    """A file that marks no time limits: episodes of 30 rows, and some of 10, which a horizon of 25 does not cut."""
    rng = np.random.default_rng(0)
    lengths = [30] * 12 + [10 + longer] * 6
    rows = sum(lengths)
    terminals = np.zeros(rows, bool)
    terminals[np.cumsum(lengths) - 1] = True
    np.savez(
        path, observations=rng.normal(size=(rows, 2)), actions=rng.uniform(-1, 1, (rows, 1)), rewards=rng.normal(size=rows),
        terminals=terminals,
    )  # fmt: skip
    return path


@pytest.fixture(scope="module", params=[0, 20], ids=["some episodes alike", "no episode alike"])
def cut(request, tmp_path_factory):
    """A run on such a file with a horizon, of which raw episodes are known or not."""
    folder = tmp_path_factory.mktemp("cut")
    file = unmarked(folder / "log.npz", request.param)
    return file, train(BC, dr.read(file, horizon=25), out=folder / "run", **SHORT)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["run", "file"])
def test_a_log_that_is_divided_otherwise_is_refused(cut, which):
    file, run = cut
    given = gather([run if which == "run" else run.path / "policies" / "seed0.npz"])
    words = r"was trained on a log read with a horizon of 25, .* read with no horizon: read it with --log-horizon 25, or, if"
    with pytest.raises(UserError, match=words):
        fresh(given, dr.read(file), False)
    same = dr.read(file, horizon=25)
    found = fresh(given, same, False)
    np.testing.assert_array_equal(same.episode_ids[found.held], run.held)
    assert len(fresh(given, dr.read(file), True).held) == 18  # the user's own word


def test_the_command_reads_a_log_as_training_did(cut, capsys):
    file, run = cut
    words = ["ope", "--data", str(file), "--policies", str(run.path), "--cluster", "nobody"]
    assert main(words) == 2
    assert "read it with --log-horizon 25" in capsys.readouterr().err
    assert main([*words, "--log-horizon", "25"]) == 2
    assert "unknown column 'nobody'" in capsys.readouterr().err  # which is looked up once the episodes are known


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """Runs on the first 20 of 30 episodes."""
    rng = np.random.default_rng(0)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(90, 2)), actions=rng.uniform(-1, 1, (90, 1)), rewards=rng.normal(size=90),
        terminals=np.arange(90) % 3 == 2, name="grown",
    )  # fmt: skip
    folder, first = tmp_path_factory.mktemp("part"), log.select(range(20))
    return log, [train(BC, first, out=folder / "run", **SHORT), cross_fit(BC, first, folds=2, out=folder / "cross", **SHORT)]


def test_episodes_that_a_run_knows_nothing_of_are_not_fresh_beside_known_ones(part):
    log, policies = part
    for each in (*policies, policies[1].policy_path):
        with pytest.raises(UserError, match="10 of 30 episodes of grown are not known to .*, while the others are"):
            fresh(gather([each]), log, False)
        assert len(fresh(gather([each]), log.select(range(20, 30)), False).held) == 10


@pytest.mark.slow
def test_the_same_file_of_which_nothing_is_known_is_refused(part, tmp_path):
    log, _ = part
    rng = np.random.default_rng(0)
    rows = [f"{day},{hour},{rng.normal():.4f},{rng.uniform():.4f},{rng.normal():.4f}" for day in range(10) for hour in range(4)]
    (tmp_path / "log.csv").write_text("\n".join(["day,hour,x,dose,gain", *rows]) + "\n")
    columns = {"action": "dose", "reward": "gain", "time": "hour", "observations": "x"}
    run = train(BC, dr.read(tmp_path / "log.csv", episode="day", **columns), out=tmp_path / "run", **SHORT)
    whole = {**columns, "time": None, "timeout": None, "terminal": None}
    with pytest.raises(UserError, match=r"no episode of log is known to run, although it was trained on .*log\.csv too"):
        fresh(gather([run]), dr.read(tmp_path / "log.csv", **whole), False)
    assert len(fresh(gather([run]), log, False).held) == 30  # another log
    days = dr.read(tmp_path / "log.csv", episode="day", **columns)
    other = train(BC, days.select(range(5)), out=tmp_path / "other", **SHORT)
    assert len(fresh(gather([other]), days.select(range(5, 10)), False).held) == 5  # another part of the same file


# ---- what columns became ------------------------------------------------------------------------------------------------


def table(name, doses):
    rng = np.random.default_rng(0)
    frame = {"x": rng.normal(size=60), "dose": np.asarray(doses)[rng.integers(0, 3, 60)], "gain": rng.normal(size=60)}
    return Dataset.from_frame(frame, action="dose", reward="gain", name=name)


@pytest.mark.slow
@pytest.mark.parametrize("other", [[0, 1, 50], ["hold", "sell", "buy"]], ids=["sparse", "texts"])
def test_levels_that_one_side_alone_has_are_a_difference(tmp_path, other):
    plain, levelled = table("plain", [0, 1, 2]), table("levelled", other)
    for taught, new in ((plain, levelled), (levelled, plain)):
        run = train(BC, taught, out=tmp_path / taught.name, **SHORT)
        for given in (run, run.path / "policies" / "seed0.npz"):
            with pytest.raises(UserError, match=r"levels of actions are (.*of levelled|.*plain numbers)"):
                check_encodings(gather([given]), new)
            check_encodings(gather([given]), taught)


def test_a_log_that_is_no_table_has_no_names_to_compare(tmp_path):
    frame = table("plain", ["a", "b", "c"])
    run = train(BC, frame, out=tmp_path / "run", **SHORT)
    arrays = dataclasses.replace(frame, provenance=dataclasses.replace(frame.provenance, extra={}))
    check_encodings(gather([run]), arrays)


def test_files_of_before_say_nothing_of_their_log(part, tmp_path):
    log, (run, _) = part
    store.save(tmp_path / "old.npz", run.policy, taught=run.taught)
    assert store.load_all(tmp_path / "old.npz").held is None
    assert len(fresh(gather([tmp_path / "old.npz"]), log, False).held) == 14


def test_the_file_of_a_schema_says_how_its_own_table_is_read(tmp_path):
    """Where a query, a dialect or a sheet is another one than the log's, that of the given schema holds."""
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"x": rng.uniform(1000, 9000, 30).round(), "action": ["a", "b", "b"] * 10, "reward": 0.0})
    log = dr.Dataset.from_frame(frame)
    run = train(BC, log, out=tmp_path / "run", **SHORT)
    written = frame.assign(x=[f"{int(v) // 1000}.{int(v) % 1000:03d}" for v in frame.x], reward=0)
    written.to_csv(tmp_path / "marked.csv", index=False, sep=";")
    dialect = 'separator = ";"\ndecimal = ","\nthousands = "."'
    with sqlite3.connect(tmp_path / "log.db") as base:
        twice = pd.concat([frame.assign(site=1), frame.assign(site=2, x=-1.0)])
        twice.to_sql("t", base, index=False)
    query = 'query = "select x, action, reward from t where site = 1"'
    columns = (
        '[columns]\nx = {role = "observation"}\naction = {role = "action", kind = "category"}\nreward = {role = "reward"}\n'
    )
    want = run.predict(frame).tolist()
    for file, how in (("marked.csv", dialect), ("log.db", query)):
        (tmp_path / "new.toml").write_text(f'[table]\npath = "{file}"\n{how}\n{columns}')
        found = subject(run).log(tmp_path / "new.toml", option="--log")
        assert np.array_equal(found.observations, log.observations)
        assert main(["predict", str(run.path), str(tmp_path / "new.toml"), "--out", str(tmp_path / "out.csv")]) == 0
        assert pd.read_csv(tmp_path / "out.csv")["action"].tolist() == want


@pytest.mark.parametrize("ending", ["csv", "parquet", "xlsx"])
def test_the_order_of_dates_is_that_of_the_log_whatever_kind_of_file_or_frame_follows(tmp_path, ending):
    first = pd.DataFrame({"who": 0, "at": [f"{day}/12/2024" for day in range(10, 20)], "x": np.arange(10.0)})
    first = first.assign(action=["a", "b"] * 5, reward=0.0)
    later = first.iloc[:4].assign(at=["12/01/2025", "01/02/2025", "02/03/2025", "01/04/2025"])  # 12 January, 1 February, ...
    for log in (dr.Dataset.from_frame(first, episode="who", time="at"), None):
        if log is None:
            first.to_csv(tmp_path / "log.csv", index=False)
            log = dr.read(tmp_path / "log.csv", episode="who", time="at")
        run = train(BC, log, out=tmp_path / log.name, **SHORT)
        write = {"csv": later.to_csv, "parquet": later.to_parquet, "xlsx": later.to_excel}[ending]
        write(tmp_path / f"later.{ending}", index=False)
        for given in (later, tmp_path / f"later.{ending}"):
            assert subject(run).log(given, option="--log").observations[:, 0].tolist() == [0, 1, 2, 3]


def test_columns_of_dates_in_two_orders_are_read_again_as_they_were(tmp_path):
    """An order that an ignored column has is none of the others'."""
    frame = pd.DataFrame({"who": 0, "x": np.arange(9.0), "action": ["a", "b", "b"] * 3, "reward": 0.0})
    for born, day in (("13.04.1980", 10), ("03.04.1980", 1)):  # the second tells by its points alone, the days by nothing
        frame = frame.assign(born=born, when=[f"04/{day + row:02d}/2024" for row in range(9)])
        frame.to_csv(tmp_path / "log.csv", index=False)
        log = dr.read(tmp_path / "log.csv", episode="who", time="when", ignore=("born",))
        assert "dates" not in log.provenance.extra["schema"].get("table", {})
        run = train(BC, log, out=tmp_path / f"run{born}", history=2, **SHORT)
        assert np.array_equal(subject(run).log(option="--log").observations, log.observations)
        assert len(run.predict(frame)) == 9


def test_a_log_without_the_legal_actions_that_a_function_said_is_refused_in_one_line(tmp_path):
    frame = pd.DataFrame({"x": np.arange(20.0), "action": ["a", "b"] * 10, "reward": 0.0})
    log = dr.Dataset.from_frame(frame, legal=lambda x: np.ones((len(x), 2), bool))
    run = train(BC, log, out=tmp_path / "run", **SHORT)
    one = subject(run)
    assert one.log(log, option="--log") is log
    words = r"takes observations of shape \(3,\), those of frame have \(1,\); its log had legal actions from a function"
    for given in (frame, dr.Dataset.from_frame(frame)):
        with pytest.raises(UserError, match=words):
            one.log(given, option="--log")


def test_a_log_that_was_converted_to_parquet_is_read_again_as_a_log(tmp_path):
    """It keeps the schema of its table, whose columns it has no more."""
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"dose": rng.normal(size=40), "given": rng.integers(0, 2, 40), "gain": rng.normal(size=40)})
    frame.to_csv(tmp_path / "log.csv", index=False)
    convert(tmp_path / "log.csv", tmp_path / "log.parquet", action="given", reward="gain")
    run = train(BC, dr.read(tmp_path / "log.parquet"), out=tmp_path / "run", **SHORT)
    log = subject(run.path).log(option="--data")
    assert len(log) == 40
    assert log.provenance.extra["schema"]["columns"].keys() == {"dose", "given", "gain"}
