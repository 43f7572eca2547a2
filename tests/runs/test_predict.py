"""From a table to named actions in new rows of it: one step, several steps with missing values and dates, several actions."""

import datetime as dt
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.data.history import stacked
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.policies import portable, store
from deadreckon.policies.deployed import EnvPolicy, Mixture
from deadreckon.policies.kinds import Categorical
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.policies.table_rows import RowsError
from deadreckon.runs.crossfit import cross_fit
from deadreckon.runs.folder import Folder
from deadreckon.runs.reading import noted
from deadreckon.runs.train import train

SHORT = {"steps": 3, "task": False, "seeds": 1}
ROWS = 40
NETS = {"hidden": (8,), "batch_size": 8}


def offers(seed=0):
    """One step: which offer to make; discrete, with names."""
    rng = np.random.default_rng(seed)
    return pd.DataFrame({
        "age": rng.integers(18, 80, ROWS), "plan": rng.choice(["free", "pro", "team"], ROWS), "trial": rng.random(ROWS) < 0.5,
        "offer": rng.choice(["call", "mail", "none"], ROWS), "paid": rng.normal(size=ROWS),
    })  # fmt: skip


def patients(seed=0):
    """Several steps: dates, missing values, doses that are the numbers 10, 20 and 40."""
    rng = np.random.default_rng(seed)
    pulse = np.where(rng.random(ROWS) < 0.3, np.nan, rng.normal(70.0, 9.0, ROWS))
    return pd.DataFrame({
        "patient": np.repeat([f"p{i}" for i in range(ROWS // 4)], 4), "day": pd.date_range("2024-03-01", periods=ROWS),
        "pulse": pulse, "ward": pd.Series(rng.choice(["a", "b", None], ROWS), dtype=object),
        "dose": rng.choice([10, 20, 40], ROWS), "gain": rng.normal(size=ROWS), "left": np.arange(ROWS) % 4 == 3,
    })  # fmt: skip


def chiller(seed=0):
    """Two continuous actions with units."""
    rng = np.random.default_rng(seed)
    return pd.DataFrame({
        "temp": rng.normal(20.0, 3.0, ROWS), "mode": rng.choice(["day", "night"], ROWS), "valve": rng.uniform(0.0, 1.0, ROWS),
        "fan": rng.uniform(100.0, 900.0, ROWS), "saved": rng.normal(size=ROWS),
    })  # fmt: skip


SCHEMA = {"columns": {
    "temp": {"role": "observation", "kind": "number", "low": 0.0, "high": 45.0, "unit": "C"},
    "mode": {"role": "observation", "kind": "category"}, "valve": {"role": "action", "kind": "number", "low": 0.0, "high": 1.0},
    "fan": {"role": "action", "kind": "number", "low": 0.0, "high": 1000.0, "unit": "rpm"}, "saved": {"role": "reward"},
}}  # fmt: skip
TABLES = {
    "offers": (offers, {"action": "offer", "reward": "paid"}, dr.agents.BC(**NETS)),
    "patients": (patients, {"action": "dose", "reward": "gain", "episode": "patient", "time": "day", "terminal": "left"},
                 dr.agents.CQL(**NETS)),
    "chiller": (chiller, {"schema": SCHEMA}, dr.agents.BC(**NETS)),
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """{table: (log, run)}."""
    out = {}
    for name, (table, how, agent) in TABLES.items():
        log = dr.Dataset.from_frame(table(), **how)
        out[name] = log, train(agent, log, out=tmp_path_factory.mktemp("runs") / name, **SHORT)
    return out


def player(run):
    return portable.load(Folder(run.path).policy(run.seeds[0]))


def same(actions, others):
    """Equal names, or numbers to a rounding."""
    if not isinstance(others, dict):
        np.testing.assert_array_equal(actions, others)
        return
    assert list(actions) == list(others)
    for key, values in others.items():
        np.testing.assert_allclose(actions[key], values, rtol=1e-5)


NAMED = {
    "offers": lambda actions: set(actions) <= {"call", "mail", "none"},
    "patients": lambda actions: set(actions) <= {10, 20, 40},
    "chiller": lambda actions: list(actions) == ["valve", "fan"] and (actions["fan"] <= 1000).all(),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_new_rows_get_named_actions_alike_by_jax_and_numpy(runs, name):
    log, run = runs[name]
    new = TABLES[name][0](1)
    own = run.policy(log.observations)
    for act in (run.predict, player(run).predict):
        assert NAMED[name](act(new))
        for rows in (new, new.to_dict("records"), {key: new[key].tolist() for key in new}):
            first, again = act(rows), run.predict(new)
            same(first, again)
        # Arrays as they are encoded give what the policy does itself.
        same(act(log.observations), run.predictor().encoder.named(own))


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_permuting_the_rows_permutes_the_actions(runs, name):
    _, run = runs[name]
    new, order = TABLES[name][0](2), np.random.default_rng(0).permutation(ROWS)
    plain, moved = run.predict(new), run.predict(new.iloc[order])
    same(moved, {key: values[order] for key, values in plain.items()} if isinstance(plain, dict) else plain[order])


@pytest.mark.parametrize("name", TABLES)
def test_one_row_gives_one_action(runs, name):
    _, run = runs[name]
    new = TABLES[name][0](1)
    many = run.predict(new)
    for act in (run.predict, player(run).predict):
        one = act(new.iloc[5].to_dict())
        if name == "chiller":
            assert type(one["fan"]) is float
            assert one["fan"] == pytest.approx(many["fan"][5], rel=1e-5)
        else:
            assert type(one) in (str, int)
            assert one == many[5]


@pytest.mark.parametrize("name", ["offers", "patients"])
def test_probabilities_by_name_and_what_is_sampled_from_them(runs, name):
    """Sampled actions are drawn from the probabilities alone, so that all players draw the same."""
    _, run = runs[name]
    new = TABLES[name][0](1)
    ours, theirs = (act(new, probabilities=True) for act in (run.predict, player(run).predict))
    assert list(ours.probabilities) == run.predictor().encoder.names
    assert ours.outside is None
    for key, values in ours.probabilities.items():
        np.testing.assert_allclose(theirs.probabilities[key], values, atol=1e-6)
    np.testing.assert_allclose(sum(ours.probabilities.values()), 1.0, atol=1e-5)
    names = list(ours.probabilities)
    np.testing.assert_array_equal(ours.actions, [names[i] for i in np.stack(list(ours.probabilities.values())).argmax(0)])
    row = {key: [value] * 4000 for key, value in new.iloc[0].to_dict().items()}
    drawn = run.predict(row, greedy=False, seed=3)
    np.testing.assert_array_equal(player(run).predict(row, greedy=False, seed=3), drawn)
    for key in names:
        assert abs((drawn == key).mean() - ours.probabilities[key][0]) < 0.03
    generator = np.random.default_rng(0)
    assert len({run.predict(new.iloc[0].to_dict(), greedy=False, seed=generator) for _ in range(30)}) > 1


def test_sampled_continuous_actions_differ_and_have_no_probabilities(runs):
    _, run = runs["chiller"]
    rows = chiller(1)
    for act, error in ((run.predict, UserError), (player(run).predict, RowsError)):
        with pytest.raises(error, match="probabilities are those of discrete actions"):
            act(rows, probabilities=True)


def test_what_does_not_fit_is_told_by_name(runs):
    _, run = runs["offers"]
    renamed = offers(1).replace({"plan": {"pro": "professional"}})
    with pytest.raises(UserError, match="column plan has 'professional' in row .*, which is none of its levels"):
        run.predict(renamed)
    with pytest.raises(RowsError, match="column plan has 'professional'"):
        player(run).predict(renamed)
    found = run.predict(renamed, outside="flag")
    np.testing.assert_array_equal(found.outside[renamed["plan"] == "professional"], True)
    assert run.predict(offers(0), outside="flag").outside.sum() == 0
    with pytest.raises(UserError, match="no column age"):
        run.predict(offers(1).drop(columns="age"))
    _, run = runs["chiller"]
    with pytest.raises(UserError, match=r"column temp has 60.0 in row 0, outside the range 0 \.\. 45"):
        run.predict({"temp": 60.0, "mode": "day"})
    assert run.predict({"temp": 60.0, "mode": "day"}, outside="flag").outside is True
    assert list(run.predictor().columns(run.predict(chiller(0), outside="flag"))) == ["valve", "fan", "outside_the_log"]
    with pytest.raises(UserError, match="has no policy of seed 7; its seeds are 0"):
        run.predictor(7)


def test_a_policy_file_alone_is_enough(runs, tmp_path):
    """Without the package, beside copies of the files that need numpy alone."""
    log, run = runs["offers"]
    for name in ("portable", "table_rows", "table_columns", "table_encoder", "table_predict", "table_times"):
        (tmp_path / f"{name}.py").write_text(Path(portable.__file__).with_name(f"{name}.py").read_text())
    new = offers(1)
    (tmp_path / "rows.json").write_text(new.to_json(orient="records"))
    file = Folder(run.path).policy(0)
    code = (
        f"import json, sys, portable; p = portable.load({str(file)!r}); rows = json.load(open('rows.json')); "
        "print(json.dumps(p.predict(rows).tolist())); print(*(m for m in ('deadreckon', 'jax') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env={}, check=True)
    actions, loaded = done.stdout.split("\n")[:2]
    assert (json.loads(actions), loaded) == (run.predict(new).tolist(), "")
    np.testing.assert_array_equal(dr.load_policy(file).predict(new), run.predict(new))
    with pytest.raises(UserError, match=r"is a folder; load_run\('.*'\).predict takes the policy of a run"):
        dr.load_policy(run.path)


def test_files_that_keep_no_schema_say_so(runs, tmp_path):
    log, run = runs["offers"]
    store.save(tmp_path / "old.npz", run.policy)
    with pytest.raises(UserError, match="this policy has no schema of its log: .*; give arrays of observations"):
        dr.load_policy(tmp_path / "old.npz").predict(offers())
    assert dr.load_policy(tmp_path / "old.npz").predict(log.observations).tolist() == run.policy(log.observations).tolist()


LEGAL = {"x": [0.0, 1.0, 2.0, 3.0] * 5, "action": ["wait", "call", "visit", "call"] * 5, "reward": [0.0] * 20,
         "may": ["wait|call", "call", "visit|wait", "wait|call|visit"] * 5}  # fmt: skip


@pytest.mark.slow
def test_legal_actions_are_obeyed(tmp_path):
    log = dr.Dataset.from_frame(LEGAL, legal="may")
    run = train(dr.agents.BC(**NETS), log, out=tmp_path / "run", **SHORT)
    for act in (run.predict, player(run).predict):
        for action in ("wait", "call", "visit"):
            assert act({"x": [1.0] * 50, "may": [action] * 50}, greedy=False).tolist() == [action] * 50
        found = act({"x": 1.0, "may": ["call", "visit"]}, probabilities=True)
        assert found.probabilities["wait"] == 0.0
        assert act({"x": 1.0}, legal=[0, 0, 1]) == log.provenance.extra["action_levels"][2]
    pd.DataFrame({"x": [0.0, 1.0], "may": ["call", "visit"]}).to_csv(tmp_path / "new.csv", index=False)
    assert main(["predict", str(run.path), str(tmp_path / "new.csv"), "--out", str(tmp_path / "out.csv")]) == 0
    assert pd.read_csv(tmp_path / "out.csv")["action"].tolist() == ["call", "visit"]


@pytest.fixture(scope="module", params=["patients", "chiller"])
def history(request, tmp_path_factory):
    """A run on the last three steps of episodes."""
    table, how, agent = TABLES[request.param]
    if request.param == "patients":
        frame = table()
    else:
        frame, how = table().assign(day=np.arange(ROWS) // 4), {"action": ["valve", "fan"], "reward": "saved", "episode": "day"}
    log = dr.Dataset.from_frame(frame, **how)
    return frame, log, train(agent, log, out=tmp_path_factory.mktemp("history") / "run", history=3, **SHORT), request.param


def test_policies_on_histories_take_the_logged_past(history):
    """What is done in a row is what the policy does on the log's own histories, whose actions are those of the log."""
    frame, log, run, name = history
    member = run.policy.inner.member
    own = member(stacked(log, 3).observations)
    want = run.predictor().encoder.named(own)
    mixed = frame.sample(frac=1.0, random_state=0).sort_values("day", kind="stable") if name == "patients" else frame
    for act in (run.predict, player(run).predict):
        found = act(mixed)
        if name == "patients":
            np.testing.assert_array_equal(pd.Series(found, mixed.index).sort_index(), want)
        else:
            np.testing.assert_allclose(found["fan"], want["fan"], rtol=1e-4)


def test_policies_on_histories_go_on_from_what_they_did(history):
    """Without the actions of the rows, the past is what the policy did; and so it is if these are given."""
    frame, log, run, name = history
    columns = ["dose"] if name == "patients" else ["valve", "fan"]
    alone = frame.drop(columns=columns)
    for act in (run.predict, player(run).predict):
        found = act(alone)
        given = alone.assign(**(found if isinstance(found, dict) else {"dose": found}))
        again = act(given)
        one, other = (found, again) if name == "patients" else (found["valve"], again["valve"])
        np.testing.assert_allclose(np.asarray(other, float), np.asarray(one, float), rtol=1e-4)
        assert len(act(alone.iloc[:0])) == (0 if name == "patients" else 2)


@pytest.mark.parametrize("written", ["%d/%m/%Y", "%m/%d/%Y", "%d.%m.%Y %H:%M", "%Y-%m-%dT%H", "delta", "time", None])
def test_times_of_histories_are_read_as_those_of_the_log(tmp_path, written):
    days = pd.date_range("2024-05-06", periods=60, freq="D")  # most of them can be read in two ways, and some in one alone
    moments = {"delta": days - days[0], "time": [dt.time(i // 60, i % 60) for i in range(60)], None: days}.get(written)
    frame = pd.DataFrame({"who": np.arange(60) // 10, "at": days.strftime(written) if moments is None else moments})
    frame = frame.assign(x=np.arange(60.0), action=["a", "b"] * 30, reward=0.0)
    log = dr.Dataset.from_frame(frame, episode="who", time="at")
    run = train(dr.agents.BC(**NETS), log, out=tmp_path / "run", history=2, **SHORT)
    for act in (run.predict, player(run).predict):
        assert len(act(frame)) == 60
        assert len(act(frame.iloc[:5])) == 5  # whose days are all below 12
        with pytest.raises(ValueError, match="column at has .* in row 1, before the .* of row 0 in the same episode"):
            act(frame.iloc[[4, 3]])
    if written is not None and "%" in written:
        frame.iloc[:5].to_csv(tmp_path / "new.csv", index=False)
        command = ["predict", str(run.path), str(tmp_path / "new.csv"), "--out", str(tmp_path / "out.csv"), "--keep", "at"]
        assert main(command) == 0
        assert pd.read_csv(tmp_path / "out.csv")["at"].tolist() == frame["at"].tolist()[:5]


def test_flags_that_were_the_action_may_be_words(tmp_path):
    frame = pd.DataFrame({"who": np.arange(40) // 10, "x": np.arange(40.0), "go": [True, False] * 20, "reward": 0.0})
    log = dr.Dataset.from_frame(frame, action="go", reward="reward", episode="who")
    run = train(dr.agents.BC(**NETS), log, out=tmp_path / "run", history=2, **SHORT)
    want = run.predict(frame).tolist()
    for words in (["yes", "no"], [1, 0], ["True", "False"]):
        assert run.predict(frame.assign(go=words * 20)).tolist() == want


@pytest.mark.parametrize("levels", [[True, False], [False, True], [1, 0], ["no", "yes"], ["yes", "no"]])
def test_flags_that_were_the_action_have_the_codes_of_their_levels(tmp_path, levels):
    words = ["yes", "no"] if "yes" in levels else [1, 0] if levels == [1, 0] else [True, False]
    frame = pd.DataFrame({"who": np.arange(12) // 3, "x": np.arange(12.0), "go": words * 6, "reward": 0.0})
    roles = {"who": {"role": "episode"}, "x": {"role": "observation"}, "reward": {"role": "reward"}}
    schema = {"columns": roles | {"go": {"role": "action", "kind": "flag", "levels": levels}}}
    frame.to_csv(tmp_path / "log.csv", index=False)
    frame.to_parquet(tmp_path / "log.parquet")
    files = [tmp_path / "log.csv", tmp_path / "log.parquet"]
    for log in (dr.Dataset.from_frame(frame, schema=schema), *(dr.read(file, schema=schema) for file in files)):
        assert log.actions.tolist() == [levels.index(word) for word in words] * 6
        encoder = TableEncoder(noted(log))
        assert encoder.logged({"go": frame["go"].to_numpy()}).tolist() == log.actions.tolist()
        assert encoder.named(log.actions).tolist() == words * 6


def test_a_time_may_be_missing_where_it_orders_nothing(tmp_path):
    frame = pd.DataFrame({"who": np.arange(12) // 3, "at": pd.date_range("2024-05-06", periods=12), "x": np.arange(12.0)})
    frame = frame.assign(action=["a", "b"] * 6, reward=0.0)
    run = train(dr.agents.BC(**NETS), dr.Dataset.from_frame(frame, episode="who", time="at"), out=tmp_path, history=2, **SHORT)
    rows = [
        {"who": 0, "at": None, "x": 1.0},
        {"who": 1, "at": "2024-05-06", "x": 1.0},
        {"who": 1, "at": "2024-05-07", "x": 2.0},
    ]
    assert len(run.predict(rows)) == 3
    with pytest.raises(UserError, match="column at is empty in row 0; it orders the rows of an episode"):
        run.predict([rows[0], rows[1] | {"who": 0}])


def test_policies_on_histories_refuse_rows_without_order(history):
    frame, log, run, name = history
    with pytest.raises(UserError, match="acts on the last 3 steps of an episode: give the column (patient|day) of the episode"):
        run.predict(frame.drop(columns=["patient"] if name == "patients" else ["day"]))
    with pytest.raises(UserError, match="acts on the last 3 steps of an episode: give rows by the names"):
        run.predict(log.observations)
    if name == "patients":
        with pytest.raises(UserError, match="column day has .* in row 1, before the .* of row 0 in the same episode"):
            run.predict(frame.iloc[[1, 0, 2, 3]])
        open_ = frame.iloc[:4].assign(dose=[10, None, 20, None])
        with pytest.raises(UserError, match="row 1 has no action, and its episode continues"):
            run.predict(open_)
        assert len(run.predict(open_.assign(dose=[10, 40, 20, None]))) == 4


@pytest.mark.slow
def test_the_mixture_of_a_cross_fit_is_a_file_like_others(tmp_path):
    log = dr.Dataset.from_frame(offers(), action="offer", reward="paid")
    cross = cross_fit(dr.agents.BC(**NETS), log, folds=2, out=tmp_path / "cross", **SHORT)
    policy, play = dr.load_policy(cross.policy_path), portable.load(cross.policy_path)
    members = np.stack([run.predict(offers(1)) for run in cross.runs])
    for seed in range(3):
        found = policy.predict(offers(1), seed=seed)
        np.testing.assert_array_equal(play.predict(offers(1), seed=seed), found)
        assert (found == members).any(0).all()


def test_one_member_of_a_mixture_acts_to_the_end_of_an_episode_that_flags_alone_tell(tmp_path):
    frame = {"x": np.arange(200.0), "done": np.arange(200) % 4 == 3, "action": ["call", "mail"] * 100, "reward": np.ones(200)}
    log = dr.Dataset.from_frame(frame, terminal="done")
    weight, biases = np.zeros((1, 2), np.float32), (np.array(each, np.float32) for each in ([4.6, 0.0], [0.0, 4.6]))
    members = [EnvPolicy(Categorical(MLP((weight,), (bias,))), None, None, None, None) for bias in biases]
    store.save(tmp_path / "m.npz", Mixture.of(members), {"log": noted(log)})
    for play in (dr.load_policy(tmp_path / "m.npz"), portable.load(tmp_path / "m.npz")):
        found = play.predict({"x": frame["x"], "done": frame["done"]}, probabilities=True, seed=1)
        acted = np.asarray(found.actions).reshape(50, 4)
        assert (acted == acted[:, :1]).all()  # a member was drawn for each row
        assert 10 < (acted[:, 0] == "call").sum() < 40
        own = np.where(acted == "call", 1, 0) + np.where(acted == "call", -1, 1) / (1 + np.exp(4.6))
        np.testing.assert_allclose(found.probabilities["call"].reshape(50, 4), own, rtol=1e-5)
        alone = play.predict({"x": frame["x"], "done": np.ones(200, bool)}, probabilities=True, seed=1)
        np.testing.assert_allclose(alone.probabilities["call"], 0.5, rtol=1e-5)


def test_a_log_of_one_action_has_nothing_to_choose_between(tmp_path):
    table = {"x": np.arange(20.0), "action": ["mail"] * 20, "reward": np.arange(20.0)}
    with pytest.raises(UserError, match="frame: its only action is mail, so there is nothing to choose between"):
        dr.train("bc", dr.Dataset.from_frame(table), out=tmp_path / "run", steps=2, task=False)
    numbers = dr.Dataset.from_frame(table | {"action": [0] * 20})
    with pytest.raises(UserError, match="frame: its only action is 0, so"):
        dr.train("bc", numbers, out=tmp_path / "run", steps=2, task=False)
    assert not (tmp_path / "run").exists()
