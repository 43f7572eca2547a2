"""Exports do what the policy does, with the encoding of its table, and nothing is kept that does not."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.nets.encoder import Encoder
from deadreckon.nets.mlp import MLP
from deadreckon.policies import onnx_graph, portable, store
from deadreckon.policies.decoded_rows import decoded
from deadreckon.policies.deployed import EnvPolicy, Mixture, Seeing
from deadreckon.policies.kinds import Deterministic
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.runs import export as exporting
from deadreckon.runs.export import export
from deadreckon.runs.export_onnx import _line
from deadreckon.runs.exported import Rows, check
from deadreckon.runs.reading import noted
from deadreckon.runs.subject import subject
from tests.data.small_logs import make_log
from tests.recorded import decision


def rows_of_table(rows, seed=0):
    rng = np.random.default_rng(seed)
    lab, kind = rng.normal(size=rows).round(3), rng.integers(0, 3, rows)
    return pd.DataFrame({
        "age": rng.normal(0, 1, rows).round(3), "kind": np.array(["old", "new", "other"])[kind],
        "lab": np.where(rng.random(rows) < 0.2, np.nan, lab), "grade": rng.choice([1, 3, 7], rows),
        "vip": rng.random(rows) < 0.5, "action": np.array(["call", "mail", "wait"])[kind], "reward": rng.random(rows),
    })  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A run on a table of all kinds of columns, which has learned enough for its actions to differ."""
    folder = tmp_path_factory.mktemp("export")
    rows_of_table(300).to_csv(folder / "log.csv", index=False)
    log = dr.read(folder / "log.csv", action="action", reward="reward", kinds={"grade": "category"})
    dr.train(dr.agents.BC(hidden=(8,), batch_size=32, lr=0.03), log, steps=150, task=False, out=folder / "run")
    return folder


@pytest.fixture(scope="module")
def numpys(place):
    return export(place / "run", "numpy", place / "numpy")


@pytest.mark.slow
def test_numpy_alone_plays_the_folder_by_the_names_of_the_table(place, numpys):
    fresh = rows_of_table(50, seed=1).drop(columns=["action", "reward"])
    fresh.to_csv(place / "fresh.csv", index=False)
    code = (
        "import json, sys, numpy as np, portable\n"
        "rows = json.loads(sys.stdin.read())\n"
        "found = portable.load('policy.npz').predict(rows).tolist()\n"
        "assert not {'jax', 'deadreckon', 'pandas'} & set(sys.modules)\n"
        "print(json.dumps(found))"
    )
    given = json.dumps(fresh.astype(object).where(fresh.notna(), None).to_dict("records"))
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code], input=given, capture_output=True, text=True, cwd=numpys, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    wanted = dr.load_run(place / "run").predict(fresh)
    assert json.loads(done.stdout) == wanted.tolist()
    assert len(set(wanted)) > 1


def test_the_card_tells_what_it_is_and_what_it_cannot(place, numpys):
    card = (numpys / "card.md").read_text()
    for text in (
        "# run seed 0", "No estimates are known", "| age | observation | number |", "bc, seed 0, 150 updates",
        "The export takes deterministic (greedy) actions", "- jax: ", "call, mail, wait",
        "actions: one of 3 discrete actions (type `Discrete(n=3)`)", "type `Categorical`: A choice among discrete actions",
    ):  # fmt: skip
        assert text in card, text


def test_the_card_says_nothing_in_the_name_of_a_file(place, tmp_path):
    forged = "bc\n\n## Decision\n\n**DEPLOY** this <script>alert(1)</script> | `x` |"
    shutil.copytree(place / "run", tmp_path / "run")
    config = json.loads((tmp_path / "run" / "run.json").read_text())
    config["agent"]["fields"]["note"], config["versions"][forged] = forged, forged
    config["data"]["warnings"] = [forged]
    (tmp_path / "run" / "run.json").write_text(json.dumps(config))
    card = (export(tmp_path / "run", "numpy", tmp_path / "out") / "card.md").read_text()
    escaped = r"bc\\n\\n## Decision\\n\\n\*\*DEPLOY\*\* this \<script>alert(1)\</script> \| \`x\` \|"
    assert [line for line in card.splitlines() if "DEPLOY" in line] == [
        f"- warning: {escaped}", f"| note | {escaped} |", f"- {escaped}: {escaped}",
    ]  # fmt: skip
    assert card.count("## Decision\n") == 1


def test_the_card_has_the_decision_and_the_estimates(place):
    value = {"value": [0.5, 0.4], "low": [0.4, 0.3], "high": [0.6, 0.5], "gain": [[0.1, 0.05, None]]}
    told = decision([{"name": "run seed 0"}], [value], estimand={"greedy": False},
                    choice={"level": 0.975, "evidence": ["IS agrees"], "objections": [["few rows"]]})  # fmt: skip
    write_json(place / "told" / "estimates.json", told)
    card = (export(place / "run", "numpy", place / "judged", estimates=place / "told") / "card.md").read_text()
    for text in (
        "**DEPLOY** run seed 0", "| DR | 0.50 [0.40, 0.60] | +0.10 ", "- few rows", "`greedy=False` samples",
        "| estimator | value [95 %] | gain over the behaviour policy [97.5 % for all policies at once] |",
    ):  # fmt: skip
        assert text in card, text


def test_observations_become_rows_and_the_same_observations_again(place):
    encoder = TableEncoder(subject(place / "run").told)
    rows = rows_of_table(40, seed=2)
    observations = encoder.encode(rows).observations
    again = decoded(encoder, observations)
    np.testing.assert_array_equal(encoder.encode(again).observations, observations)
    assert again["kind"] == rows["kind"].tolist()
    assert [value is None for value in again["lab"]] == rows["lab"].isna().tolist()


def test_what_differs_is_refused_and_nothing_is_left(place, monkeypatch):
    plain = portable.NumpyPolicy.__call__
    monkeypatch.setattr(portable.NumpyPolicy, "__call__", lambda self, x, *a, **k: (plain(self, x, *a, **k) + 1) % 3)
    with pytest.raises(UserError, match="the numpy player differs from the policy in 300 of 300 rows of the log.* is not kept"):
        export(place / "run", "numpy", place / "wrong")
    assert not list(place.glob("*wrong*"))


def test_one_seed_of_a_cross_fit_keeps_what_its_table_was(place, tmp_path):
    log = dr.read(place / "log.csv", action="action", reward="reward", kinds={"grade": "category"})
    dr.cross_fit(dr.agents.BC(hidden=(4,), batch_size=8), log, out=tmp_path / "c", folds=2, seeds=2, steps=1, task=False)
    folder = export(tmp_path / "c", "numpy", tmp_path / "numpy", seed=1)
    found = portable.load(folder / "policy.npz").predict(rows_of_table(5, seed=1))
    assert set(found) <= {"call", "mail", "wait"}


@pytest.mark.parametrize("mixed", [False, True])
def test_policies_on_pictures_are_played_by_numpy(tmp_path, mixed):
    pictures = np.random.default_rng(0).integers(0, 256, (20, 16, 16, 3)).astype(np.uint8)
    log = dr.Dataset.from_arrays(observations=pictures, actions=np.zeros((20, 1)), rewards=np.zeros(20), name="pictures",
                                 action_space=Box((-1.0,), (1.0,)), terminals=np.ones(20, bool))  # fmt: skip
    sees = []
    for seed in range(1 + mixed):
        keys = jax.random.split(jax.random.key(seed))
        encoder = Encoder.create("patches", (16, 16, 3), 8, keys[0])
        member = EnvPolicy(Deterministic(MLP.create(8, (4,), 1, keys[1])), None, None, -jnp.ones(1), jnp.ones(1))
        sees.append(EnvPolicy(Seeing(encoder, member), None, None, None, None))
    store.save(tmp_path / "p.npz", Mixture.of(sees) if mixed else sees[0])
    folder = export(tmp_path / "p.npz", "numpy", tmp_path / "numpy", log=log)
    assert (folder / "portable_pictures.py").exists()


def test_continuous_actions_may_differ_by_little_for_their_range():
    rows = Rows(np.zeros((2, 1)), np.zeros(2, np.int32), np.array([[100.0], [0.0]], np.float32), np.array([1000.0]))
    check("it", rows, rows.actions + 0.009)
    with pytest.raises(UserError, match="it differs from the policy in 2 of 2 rows of the log, by up to 0.011: it is not kept"):
        check("it", rows, rows.actions + 0.011)
    with pytest.raises(UserError, match="differs"):
        check("it", rows, np.full((2, 1), np.nan))
    with pytest.raises(UserError, match="shape"):
        check("it", rows, np.zeros(2))


def test_what_it_needs_is_said(place, numpys, capsys):
    with pytest.raises(UserError, match="exists already; choose another --out"):
        export(place / "run", "numpy", numpys)
    with pytest.raises(UserError, match="unknown format 'onyx': did you mean onnx"):
        export(place / "run", "onyx", place / "new")
    assert main(["export", str(place / "run"), "--format", "numpy", "--out", str(place / "told")]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
def test_a_stablehlo_program_is_read_back_and_takes_any_number_of_rows(place, tmp_path):
    from jax import export as jax_export

    folder = export(place / "run", "stablehlo", place / "hlo")
    program = jax_export.deserialize(bytearray((folder / "policy.stablehlo").read_bytes()))
    encoder = TableEncoder(json.loads((folder / exporting.ENCODING).read_text()))
    rows = rows_of_table(7, seed=3)
    actions, chances = program.call(jnp.asarray(encoder.encode(rows).observations))
    predicted = dr.load_run(place / "run").predict(rows, probabilities=True)
    assert encoder.named(np.asarray(actions)).tolist() == predicted.actions.tolist()
    card = (folder / "card.md").read_text()
    [code] = re.findall(r"```python\n(.*?)```", card, re.S)
    rows.to_csv(tmp_path / "rows.csv", index=False)
    code = code.replace('{"column": [value, ...], ...}', f"__import__('pandas').read_csv({str(tmp_path / 'rows.csv')!r})")
    code = code.replace("encoder.named(action)", "print(encoder.named(action).tolist())")
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.replace("'", '"')) == predicted.actions.tolist()
    np.testing.assert_allclose(np.asarray(chances)[:, 1], predicted.probabilities["mail"], atol=1e-5)


@pytest.mark.slow  # jax2onnx takes ten seconds to be imported
def test_an_onnx_graph_takes_the_columns_themselves(place):
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("jax2onnx")
    from deadreckon.runs.export_onnx import onnx_inputs

    folder = export(place / "run", "onnx", place / "onnx")
    session = runtime.InferenceSession(str(folder / "policy.onnx"))
    assert "- age: one number of 32 bits per row (`tensor(float)`, shape ['rows'])" in (folder / "card.md").read_text()
    kinds = {each.name: each.type for each in session.get_inputs()}
    assert kinds == {
        "age": "tensor(float)", "kind": "tensor(string)", "lab": "tensor(float)", "grade": "tensor(double)",
        "vip": "tensor(float)",
    }  # fmt: skip
    rows = rows_of_table(60, seed=4)
    encoder = TableEncoder(subject(place / "run").told)
    columns = decoded(encoder, encoder.encode(rows).observations)
    found = dict(zip([each.name for each in session.get_outputs()], session.run(None, onnx_inputs(encoder, columns))))
    wanted = dr.load_run(place / "run").predict(rows, probabilities=True)
    assert found["action_name"].tolist() == wanted.actions.tolist()
    np.testing.assert_allclose(found["probabilities"][:, 2], wanted.probabilities["wait"], atol=1e-5)
    # A level that the log does not have, and a number beyond it, are marked and act as no level and as they are.
    columns["kind"][0], columns["age"][1], columns["lab"][2], columns["age"][3] = "strange", 1e4, None, None
    given = onnx_inputs(encoder, columns)
    for strange in (7.0, -1.0, np.inf):  # of a flag, which Python refuses
        given["vip"] = np.array([0.0, 1.0, strange] * 20, np.float32)
        assert session.run(["outside_the_log"], given)[0][[5, 8, 11]].all()
    flagged = dr.load_run(place / "run").predict(columns, outside="flag")
    found = dict(zip([each.name for each in session.get_outputs()], session.run(None, onnx_inputs(encoder, columns))))
    assert found["outside_the_log"].tolist()[:4] == [True, True, False, True] == flagged.outside.tolist()[:4]
    assert found["action_name"].tolist() == flagged.actions.tolist()


def test_a_column_of_an_onnx_graph_says_nothing_on_the_card():
    """Between backquotes nothing can be escaped: one more would end them."""
    given = SimpleNamespace(name="age`\n\n**DEPLOY** <script>", type="tensor(float)", shape=["rows"])
    assert _line(given) == (
        r"- age\`\\n\\n\*\*DEPLOY\*\* \<script>: one number of 32 bits per row (`tensor(float)`, shape ['rows'])"
    )


class Named(SimpleNamespace):
    """Stands for the library onnx, which is an extra: parts of a graph by their names alone."""

    TensorProto = SimpleNamespace(FLOAT=0, DOUBLE=0, STRING=0, BOOL=0)
    helper = SimpleNamespace(
        make_node=lambda kind, inputs, outputs, **options: SimpleNamespace(output=outputs),
        make_tensor_value_info=lambda name, kind, shape: SimpleNamespace(name=name),
    )
    numpy_helper = SimpleNamespace(from_array=lambda value, name: SimpleNamespace(name=name))


@pytest.mark.parametrize("name", ["observation", "action", "action_name", "outside_the_log", "x:missing", "Add_0"])
def test_columns_that_are_called_as_parts_of_the_graph_are_refused_in_a_line(monkeypatch, name):
    monkeypatch.setattr(onnx_graph, "libraries", lambda: (None, Named, None))
    rows = {"x": [0.0, 1.0], "dose": [0, 1], "reward": [0.0, 1.0]}
    for other in ("y", name):
        log = dr.Dataset.from_frame(rows | {other: [1.0, 2.0]}, action="dose", reward="reward")
        given, made = [SimpleNamespace(name="observation")], [SimpleNamespace(name="action")]
        nodes = [SimpleNamespace(output=["Add_0"]), SimpleNamespace(output=["action"])]
        graph = SimpleNamespace(input=given, output=made, node=nodes, initializer=[])
        if other == "y":
            onnx_graph.with_columns(SimpleNamespace(graph=graph), TableEncoder(noted(log)))
            assert [each.name for each in graph.input] == ["x", "y"]
            continue
        with pytest.raises(UserError, match=f"column {name} is called as a part of the ONNX graph is"):
            onnx_graph.with_columns(SimpleNamespace(graph=graph), TableEncoder(noted(log)))


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """Runs on several continuous actions in episodes, on histories, cross-fitted, and with legal actions."""
    folder, rng, n = tmp_path_factory.mktemp("others"), np.random.default_rng(0), 400
    frame = pd.DataFrame({
        "day": np.repeat(np.arange(20), 20), "hour": np.tile(np.arange(20), 20), "temp": rng.normal(size=n),
        "mode": rng.choice(["a", "b"], n), "valve": rng.uniform(0, 50, n), "fan": rng.uniform(-1, 1, n), "reward": 0.0,
    })  # fmt: skip
    frame.loc[rng.random(n) < 0.1, "temp"] = np.nan
    frame.to_csv(folder / "days.csv", index=False)
    days = dr.read(folder / "days.csv", action=["valve", "fan"], reward="reward", episode="day", time="hour")
    second = rng.integers(0, 2, n)
    allowed = pd.DataFrame({"x": rng.normal(size=n), "legal_a": 1, "legal_b": second, "reward": 0.0})
    allowed["action"] = np.where((second == 1) & (rng.random(n) < 0.5), "b", "a")
    allowed.to_csv(folder / "legal.csv", index=False)
    some = dr.read(folder / "legal.csv", action="action", reward="reward", legal=["legal"])
    small, short = {"hidden": (4,), "batch_size": 16}, {"steps": 2, "task": False}
    return {
        "continuous": dr.train(dr.agents.TD3BC(**small), days, out=folder / "td3", **short),
        "candidates": dr.train(dr.agents.BEAR(**small), days, out=folder / "bear", **short),
        "history": dr.train(dr.agents.BC(**small), days, out=folder / "history", history=2, **short),
        "mixture": dr.cross_fit(dr.agents.BC(**small), days, out=folder / "cross", folds=2, **short).path,
        "legal": dr.train(dr.agents.BCQ(**small), some, out=folder / "legal", **short),
    }


@pytest.mark.slow
@pytest.mark.parametrize("format", exporting.FORMATS)
def test_all_kinds_of_policies_go_into_all_formats(others, tmp_path, format):
    """The check itself compares them with the policy. Shapes are not checked there, whose number of rows is a symbol."""
    code = "import json, sys, deadreckon as dr\nfor run, out in json.loads(sys.argv[2]): dr.export(run, sys.argv[1], out)"
    jobs = [(str(getattr(run, "path", run)), str(tmp_path / which)) for which, run in others.items()]
    done = subprocess.run([sys.executable, "-c", code, format, json.dumps(jobs)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for which in others:
        card = (tmp_path / which / "card.md").read_text()
        assert ("`member`, 0 .. 1" in card) == (which == "mixture")
        assert ("2 observations with the actions between" in card) == (which == "history")
        assert ("legal has to be given" in card) == (which == "legal")
    if format == "onnx":
        session = pytest.importorskip("onnxruntime").InferenceSession(str(tmp_path / "legal" / "policy.onnx"))
        given = {"x": np.zeros(3, np.float32), "legal": np.array([[1, 0], [0, 0], [2, 1]], np.float32)}
        assert session.run(["outside_the_log"], given)[0].tolist() == [False, True, True]


@pytest.mark.slow
def test_an_mlflow_model_is_no_pickle_and_names_actions(place):
    pyfunc = pytest.importorskip("mlflow.pyfunc")
    folder = export(place / "run", "mlflow", place / "mlflow")
    rows = rows_of_table(30, seed=5).drop(columns=["action", "reward"])
    found = pyfunc.load_model(str(folder)).predict(rows)
    assert found["action"].tolist() == dr.load_run(place / "run").predict(rows).tolist()
    assert not [path for path in folder.rglob("*") if path.suffix in (".pkl", ".pickle")]
    assert "torch" not in (folder / "requirements.txt").read_text()


@pytest.mark.slow
def test_the_code_on_a_stablehlo_card_runs_as_it_stands(tmp_path):
    """Also of a mixture, whose member is drawn, and where a function says which actions are legal."""
    frame = pd.DataFrame({"x": np.arange(-20.0, 20.0), "action": ["a", "b"] * 20, "reward": 0.0})
    agent, short = dr.agents.BC(hidden=(4,), batch_size=8), {"steps": 2, "task": False}
    frame.to_csv(tmp_path / "log.csv", index=False)
    dr.cross_fit(agent, dr.read(tmp_path / "log.csv"), out=tmp_path / "mixture", folds=2, **short)
    log = dr.Dataset.from_frame(frame, legal=lambda x: np.ones((len(x), 2), bool))
    dr.train(agent, log, out=tmp_path / "legal", **short)
    for name, given, mask in (("mixture", None, ""), ("legal", log, ", legal=[[True, False], [True, False]]")):
        out = tmp_path / f"{name}-exported"
        export(tmp_path / name, "stablehlo", out, log=given)
        (code,) = re.findall(r"```python\n(.*?)```", (out / "card.md").read_text(), re.DOTALL)
        assert ("legal=" in code) == (name == "legal")
        assert ("member" in code) == (name == "mixture")
        code = code.replace(", legal=[[True, ...], ...]", mask).replace('{"column": [value, ...], ...}', '{"x": [0.0, 1.0]}')
        done = subprocess.run([sys.executable, "-c", code], cwd=out, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_mixture_of_arrays_says_how_it_is_called_and_what_it_was_trained_on(tmp_path):
    log = make_log([4] * 10, terminal=(True,), finals=False, name="mine")
    agent, short = dr.agents.BC(hidden=(4,), batch_size=8), {"steps": 2, "task": False}
    cross = dr.cross_fit(agent, log, out=tmp_path / "cross", folds=2, **short)
    other = dataclasses.replace(log, name="other", rewards=log.rewards + 1.0)
    folder = export(cross.path, "numpy", tmp_path / "numpy", log=other)
    card = (folder / "card.md").read_text()
    assert "play(observations, first=first)   # first: (rows,), true where an episode begins" in card
    assert f"- name: mine\n- fingerprint: {log.fingerprint}\n- rows: 40\n- episodes: 10\n" in card
    assert "- held out: each episode by one of the 2 folds, by random" in card
    assert "bc, seed 0, 2 updates in each fold." in card
    assert "on 40 rows of other" in card
    history = dr.train(agent, log, out=tmp_path / "history", history=2, **short)
    pytest.importorskip("mlflow.pyfunc")
    with pytest.raises(UserError, match="acts on the last 2 observations of arrays: .*; the format numpy is"):
        export(history.path, "mlflow", tmp_path / "no", log=log)
    assert not (tmp_path / "no").exists()
    plain = dr.train(agent, log, out=tmp_path / "plain", **short)
    text = (export(plain.path, "mlflow", tmp_path / "mlflow", log=log) / "card.md").read_text()
    assert "takes an array of observations, a row for each" in text
