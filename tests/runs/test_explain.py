"""A tree says what a policy does where it can, and that it cannot where it cannot."""

import os
import shutil

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.data.schema import Column, Schema
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.nets.mlp import MLP
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy, History, Mixture
from deadreckon.policies.kinds import Categorical, Deterministic
from deadreckon.report.explained import _of, drawing
from deadreckon.runs.explain import DEPTHS, Explained, _groups, _marks, _mean, _names, _parted, _units, explain
from deadreckon.runs.explained_tree import Node
from deadreckon.runs.run import load
from deadreckon.stats.interval import Interval

ROWS = 1500


def linear(*columns):
    """Logits that are linear in the observation, a column of weights each action."""
    weight = jnp.asarray(np.array(columns, np.float32).T)
    return Categorical(MLP((weight,), (jnp.zeros(weight.shape[1]),)))


def noise(seed):
    """Choices that no small tree can know: the tent map, twelve times, of a sum of the numbers, which is 4,096 teeth wide."""
    start = np.random.default_rng(seed).uniform(0.03, 0.06, (3, 1))
    weights = [np.repeat(start, 2, 1), *[np.array([[2.0, 2.0], [-4.0, -4.0]])] * 11, np.array([[0.0, 2.0], [0.0, -4.0]])]
    biases = [np.array([0.5, 0.0]), *[np.array([0.0, -0.5])] * 12]
    return Categorical(MLP(*(tuple(jnp.asarray(each, jnp.float32) for each in part) for part in (weights, biases))))


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    return dr.Dataset.from_arrays(
        observations=rng.normal(size=(ROWS, 3)), actions=rng.integers(0, 2, ROWS), rewards=np.zeros(ROWS),
        terminals=np.ones(ROWS, bool), name="normal",
    )  # fmt: skip


def saved(policy, path):
    store.save(path, EnvPolicy(policy, None, None, None, None))
    return path


def test_a_threshold_is_found_and_so_is_the_column(log, tmp_path):
    found = explain(saved(linear((0, 0, 0), (0, 4, 0)), tmp_path / "p.npz"), log)
    assert found.explains
    assert found.depth == 1
    assert found.fidelity > 0.98
    assert 0.4 < found.constant < 0.6
    assert found.tree is not None
    assert found.tree.text.startswith("observation 1 <= ")
    assert abs(float(found.tree.text.split()[-1])) < 0.1
    assert [leaf.text for leaf in (found.tree.yes, found.tree.no)] == ["0", "1"]
    assert found.columns[0].column == "observation 1"
    # An exchanged value gives another action in half of all rows: with the chance that two signs differ.
    assert found.columns[0].low < 0.5 < found.columns[0].high
    assert all(each.high == 0.0 for each in found.columns[1:])
    assert Explained.from_json(found.as_json()) == found


def test_rows_of_an_episode_are_no_fresh_ones_of_each_other(tmp_path):
    """Thirty episodes of fifty near-copies: whatever is said of them rests on as many numbers as there are episodes."""
    rng = np.random.default_rng(0)
    episode = np.repeat(np.arange(30), 50)
    levels = rng.choice([-1.0, 1.0], (30, 3))
    data = dr.Dataset.from_arrays(
        observations=levels[episode] + 0.01 * rng.normal(size=(ROWS, 3)), actions=rng.integers(0, 2, ROWS),
        rewards=np.zeros(ROWS), terminals=np.arange(ROWS) % 50 == 49, name="copies",
    )  # fmt: skip
    unit = _units(data, np.arange(ROWS))
    assert unit.tolist() == episode.tolist()
    parts = [np.unique(episode[part]) for part in _parted(unit, rng)]
    assert [len(part) for part in parts] == [18, 6, 6]
    assert len(np.unique(np.concatenate(parts))) == 30
    # The interval is Student's of the means of the episodes, which are equally long.
    mean = levels[:, 0].mean()
    half = stats.t.ppf(0.975, 29) * levels[:, 0].std(ddof=1) / np.sqrt(30)
    assert _mean(levels[episode, 0], unit) == Interval(*(pytest.approx(end) for end in (mean, mean - half, mean + half)))
    # A tree that is never wrong in six fresh episodes may be wrong in others: Clopper and Pearson's end of six, not of 300.
    found = explain(saved(linear((0, 0, 0), (0, 4, 0)), tmp_path / "p.npz"), data)
    assert (found.rows, found.fidelity, found.low) == (300, 1.0, pytest.approx(0.025 ** (1 / 6)))
    # A log of few episodes is divided into blocks of rows that follow each other.
    few = _units(data.select(range(3)), np.arange(150))
    assert few.tolist() == np.repeat(np.arange(15), 10).tolist()


@pytest.mark.parametrize("seed", range(4))
def test_noise_has_no_fidelity_and_no_tree(log, tmp_path, seed):
    found = explain(saved(noise(seed), tmp_path / "p.npz"), log)
    assert not found.explains
    assert found.tree is None
    assert "fidelity: none" in str(found)


def test_a_policy_that_does_one_thing_is_said_to(log, tmp_path):
    found = explain(saved(Categorical(MLP((jnp.zeros((3, 2)),), (jnp.asarray([0.0, 1.0]),))), tmp_path / "p.npz"), log)
    assert "takes the same action in all of" in str(found)
    assert not found.explains


def test_of_continuous_actions_it_is_the_share_of_their_variance(tmp_path):
    rng = np.random.default_rng(1)
    data = dr.Dataset.from_arrays(
        observations=rng.normal(size=(ROWS, 2)), actions=rng.uniform(-1, 1, (ROWS, 1)), rewards=np.zeros(ROWS),
        terminals=np.ones(ROWS, bool), action_space=Box((-5.0,), (5.0,)),
    )  # fmt: skip
    inner = Deterministic(MLP((jnp.asarray([[50.0], [0.0]]),), (jnp.zeros(1),)))  # nearly the sign of the first number
    policy = EnvPolicy(inner, None, None, jnp.asarray([-5.0]), jnp.asarray([5.0]))
    store.save(tmp_path / "p.npz", policy)
    found = explain(tmp_path / "p.npz", data)
    assert found.explains
    assert found.low <= found.fidelity <= found.high
    assert found.fidelity > 0.9
    assert found.constant == 0.0
    # Two independent signs differ in half of all rows, by two standard deviations: the root of 4 / 2.
    assert found.columns[0].change == pytest.approx(np.sqrt(2), abs=0.15)
    wider = Deterministic(MLP((jnp.asarray([[50.0, 0.0], [0.0, 0.0]]),), (jnp.zeros(2),)))  # a second action that never changes
    both = dr.Dataset.from_arrays(
        observations=data.observations, actions=rng.uniform(-1, 1, (ROWS, 2)), rewards=np.zeros(ROWS),
        terminals=np.ones(ROWS, bool), action_space=Box((-5.0, -5.0), (5.0, 5.0)),
    )  # fmt: skip
    store.save(tmp_path / "two.npz", EnvPolicy(wider, None, None, jnp.full(2, -5.0), jnp.full(2, 5.0)))
    assert explain(tmp_path / "two.npz", both).columns[0].change == pytest.approx(found.columns[0].change, rel=1e-5)


def test_what_it_needs_is_said(log, tmp_path):
    image = dr.Dataset.from_arrays(
        observations=np.zeros((20, 2, 2)), actions=np.arange(20) % 2, rewards=np.zeros(20), terminals=np.ones(20, bool)
    )
    path = saved(linear((0, 0, 0), (0, 1, 0)), tmp_path / "p.npz")
    with pytest.raises(UserError, match="image observations"):
        explain(path, image)
    with pytest.raises(UserError, match="does not record where its log is; name it with a second argument"):
        explain(path)


def test_thresholds_and_actions_have_the_units_of_the_schema(tmp_path):
    rng = np.random.default_rng(2)
    table = {"age": rng.normal(size=ROWS), "dose": rng.uniform(-1, 1, ROWS), "reward": np.zeros(ROWS)}
    schema = Schema((
        Column("age", "observation", unit="years"), Column("dose", "action", low=-5.0, high=5.0, unit="mg"),
        Column("reward", "reward"),
    ))  # fmt: skip
    data = dr.Dataset.from_frame(table, schema=schema)
    inner = Deterministic(MLP((jnp.asarray([[50.0]]),), (jnp.zeros(1),)))
    store.save(tmp_path / "p.npz", EnvPolicy(inner, None, None, -5 * jnp.ones(1), 5 * jnp.ones(1)))
    found = explain(tmp_path / "p.npz", data)
    assert found.tree is not None
    lines = list(found.tree.lines())
    assert lines[0].startswith("age <= ")
    assert lines[0].endswith(" years?")
    assert all(" mg (" in line for line in lines if "dose" in line)
    assert sum("dose = " in line for line in lines) >= 2


def test_marks_of_missing_values_are_told_from_columns_that_are_called_so(tmp_path):
    rng = np.random.default_rng(3)
    x = rng.normal(size=ROWS)
    x[rng.random(ROWS) < 0.5] = np.nan
    table = {"x": x, "y_missing": rng.normal(size=ROWS), "action": ["a", "b"] * (ROWS // 2), "reward": np.zeros(ROWS)}
    data = dr.Dataset.from_frame(table, action="action", reward="reward")
    for weights, words in (((0, 9, 0), "x has no value"), ((0, 0, 9), "y_missing <= ")):
        half = linear((0, 0, 0), weights)
        bias = jnp.asarray([sum(weights) / 2 if weights[1] else 0.0, 0.0])
        found = explain(saved(Categorical(MLP(half.net.weights, (bias,))), tmp_path / f"{weights[1]}.npz"), data)
        assert found.tree.text.startswith(words)


def test_a_question_says_how_rows_without_a_value_answer_it(tmp_path):
    """Missing numbers are replaced by the mean, which answers for them."""
    rng = np.random.default_rng(3)
    x = rng.normal(10.0, 1.0, size=ROWS)
    x[rng.random(ROWS) < 0.2] = np.nan
    table = {"x": x, "action": ["a", "b"] * (ROWS // 2), "reward": np.zeros(ROWS)}
    data = dr.Dataset.from_frame(table, action="action", reward="reward")
    for edge, words in ((9.0, "x <= 9"), (11.0, "x <= 11")):
        half = linear((0, 0), (1, 0))
        policy = Categorical(MLP(half.net.weights, (jnp.asarray([edge, 0.0]),)))
        text = explain(saved(policy, tmp_path / f"{edge}.npz"), data).tree.text
        assert text.startswith(words[:-1])
        assert text.endswith(", or no value") == (edge == 11.0)


def test_thresholds_of_earlier_actions_have_the_logs_units(tmp_path):
    """A policy that turns the dose up where the dose before was below 70 mg, in a log of 0 to 100 mg."""
    rng = np.random.default_rng(0)
    dose = rng.uniform(0, 100, ROWS)
    table = {"x": rng.normal(size=ROWS), "w": dose, "day": np.arange(ROWS) // 20, "reward": np.zeros(ROWS)}
    columns = (Column("x", "observation"), Column("w", "action", unit="mg", low=0.0, high=100.0), Column("day", "episode"),
               Column("reward", "reward"))  # fmt: skip
    data = dr.Dataset.from_frame(table, schema=Schema(columns))
    inner = Deterministic(MLP((jnp.asarray([[0.0], [-9.0], [0.0]]),), (jnp.asarray([9.0 * 0.4]),)))
    policy = History.of(EnvPolicy(inner, None, None, jnp.zeros(1), 100 * jnp.ones(1)), 2, data.spec)
    store.save(tmp_path / "p.npz", policy)
    question = explain(tmp_path / "p.npz", data).tree.text
    assert question.startswith("action w, 1 back <= ")
    assert question.endswith(" mg")
    assert 60 < float(question.split()[-2]) < 80


def test_the_tree_is_drawn_with_all_its_texts():
    assert "blood_<wbr>pressure &lt; 3" in drawing(Node("blood_pressure < 3", 1.0), "long names may be broken")
    root = Node("age <= 50", 1.0, Node("a & b", 0.25), Node("c <= 1", 0.75, Node("d", 0.5), Node("e", 0.25)))
    text = drawing(root, "what it does")
    assert all(part in text for part in ("age &lt;= 50?", "a &amp; b", "25% of rows", "yes", "no"))
    assert "\n".join(root.lines()) == (
        "age <= 50?\n├─ yes: a & b (25% of rows)\n└─ no:  c <= 1?\n   ├─ yes: d (50% of rows)\n   └─ no:  e (25% of rows)"
    )


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A run on a table with names, levels and missing values."""
    folder, rng = tmp_path_factory.mktemp("table"), np.random.default_rng(0)
    age, kind = rng.normal(50, 10, 400), rng.choice(["old", "new"], 400)
    lines = [f"{a:.2f},{k},{'' if i % 7 == 0 else i % 5},{c},{i % 2}" for i, (a, k, c) in enumerate(zip(age, kind, "xy" * 200))]
    (folder / "log.csv").write_text("\n".join(["age,kind,lab,action,reward", *lines]))
    run = dr.train(dr.agents.BC(hidden=(4,), batch_size=8), folder / "log.csv", steps=2, task=False, out=folder / "run")
    return folder, run


@pytest.mark.slow
def test_a_run_keeps_it_and_the_report_shows_it(table, capsys):
    folder, run = table
    assert main(["explain", str(run.path)]) == 0
    out = capsys.readouterr().out
    assert "columns that matter" in out
    assert all(name in out for name in ("age", "kind", "lab"))
    assert main(["report", str(run.path), "--out", str(folder / "page.html")]) == 0
    page = (folder / "page.html").read_text()
    assert "What the policy does" in page
    assert "share of fresh rows that get another action" in page


@pytest.mark.parametrize("option", ["--policy-seed", "--seed"])
def test_the_seed_of_the_policy_is_called_as_in_predict_and_may_have_its_old_name(table, capsys, option):
    for words in (["explain"], ["export", "--format", "numpy", "--out", "x"], ["monitor", "new.csv"]):
        assert main([words[0], str(table[1].path), *words[1:], f"{option}=7"]) == 2
        assert "has no policy of seed 7; its seeds are 0" in capsys.readouterr().err


def test_depths_are_few():
    assert DEPTHS[-1] <= 6


def test_exchanged_values_are_asked_of_the_member_that_acted_before(log, tmp_path):
    """Of a mixture whose members act differently; no column matters but the first two."""
    members = [EnvPolicy(linear((0, 0, 0), weights), None, None, None, None) for weights in ((4, 0, 0), (0, 4, 0))]
    store.save(tmp_path / "m.npz", Mixture.of(members))
    found = explain(tmp_path / "m.npz", log)
    changes = {each.column: each.change for each in found.columns}
    assert changes["observation 2"] == 0.0  # a fifth and more of all rows got another member
    assert 0.15 < changes["observation 0"] < 0.35
    assert 0.15 < changes["observation 1"] < 0.35


def test_all_numbers_of_a_column_are_exchanged_together_in_each_step_of_a_history():
    rng = np.random.default_rng(0)
    frame = {"plan": rng.choice(["a", "b", "c"], 60), "x": rng.normal(size=60), "day": np.arange(60) // 6,
             "action": rng.choice(["on", "off", "wait"], 60), "reward": rng.normal(size=60)}  # fmt: skip
    data = dr.Dataset.from_frame(frame, episode="day")
    names = _names(data, 2)
    assert len(names) == 2 * 4 + 3
    groups = _groups(data, 2)
    assert [(name, [names[i] for i in numbers]) for name, numbers in groups] == [
        ("plan, 1 back", ["plan=a, 1 back", "plan=b, 1 back", "plan=c, 1 back"]), ("x, 1 back", ["x, 1 back"]),
        ("action, 1 back", ["action off, 1 back", "action on, 1 back", "action wait, 1 back"]),
        ("plan", ["plan=a", "plan=b", "plan=c"]), ("x", ["x"]),
    ]  # fmt: skip
    continuous = dr.Dataset.from_frame({**frame, "action": rng.normal(size=60)}, episode="day")
    assert [name for name, _ in _groups(continuous, 3)] == [
        *(f"{name}, {back} back" for back in (2, 1) for name in ("plan", "x", "action action")), "plan", "x",
    ]  # fmt: skip


def test_a_page_shows_no_tree_of_an_earlier_policy(table, tmp_path):
    folder = shutil.copytree(table[1].path, tmp_path / "run")
    found = explain(folder, table[0] / "log.csv")
    write_json(folder / "explain.json", found.as_json())
    assert "has changed since it was explained" not in str(_of(folder / "explain.json"))
    assert found.headline[1:] in str(_of(folder / "explain.json"))
    store.save(folder / "policies" / "seed0.npz", load(folder).policies[0], {"more": 1})
    assert "The policy has changed since it was explained; `deadreckon explain " in str(_of(folder / "explain.json"))


def test_a_page_opens_nothing_but_files_to_know_whether_the_policy_is_the_same(tmp_path):
    found = Explained("bc", "log", True, 90, 1, 0.95, 0.9, 0.99, 0.6, False, None, (), digest="00")
    write_json(tmp_path / "explain.json", found.as_json())
    (tmp_path / "seed0.npz").symlink_to(os.devnull)
    with pytest.raises(UserError, match=r"seed0\.npz is a device, and a file is needed"):
        _of(tmp_path / "explain.json")


def test_a_number_whose_column_is_called_as_a_level_keeps_its_threshold(tmp_path):
    """Salt in g/l, and levels of a category and legal actions whose names have more than one sign."""
    rng = np.random.default_rng(4)
    table = {"NaCl=g/l": rng.normal(size=ROWS), "plan=a": rng.choice(["x=y", "z"], ROWS), "action": ["a", "b"] * (ROWS // 2)}
    data = dr.Dataset.from_frame({**table, "reward": np.zeros(ROWS)}, action="action", reward="reward")
    for weights, words in (((9, 0, 0), "NaCl=g/l <= "), ((0, 9, 0), "plan=a is x=y")):
        half = linear((0, 0, 0), weights)
        bias = jnp.asarray([weights[1] / 2, 0.0])
        found = explain(saved(Categorical(MLP(half.net.weights, (bias,))), tmp_path / f"{weights[0]}.npz"), data)
        assert found.tree.text.startswith(words)
        assert found.tree.yes.text == ("b" if weights[1] else "a")


@pytest.mark.parametrize(
    ("first", "cut"), [(1990, 2017.5), (10_023_350, 10_023_400.5), (10_023_250, 10_023_301.5), (30_000, 30_049.5)]
)
def test_a_threshold_as_it_is_shown_divides_the_rows_as_the_tree_does(first, cut, tmp_path):
    """Of whole numbers with more than four digits the rounded threshold was on the other side of some."""
    values = np.random.default_rng(0).integers(first, first + 100, ROWS)
    actions = np.arange(ROWS) % 2
    data = dr.Dataset.from_frame({"year": values, "action": actions, "reward": 0.0 * actions}, action="action", reward="reward")
    policy = linear((0.0,), (1.0,))
    policy = Categorical(MLP(policy.net.weights, (jnp.asarray([cut, 0.0]),)))
    found = explain(saved(policy, tmp_path / "p.npz"), data)
    assert found.fidelity == 1.0
    shown = float(found.tree.text.split()[-1])
    np.testing.assert_array_equal(values <= shown, values <= float(np.float32(cut)))  # which the policy compares with
    assert len(found.tree.text) <= len("year <= 10023400.5")


def test_what_numbers_of_zero_and_one_say_in_each_step_of_a_history():
    rng = np.random.default_rng(0)
    x = np.where(np.arange(60) % 7, rng.normal(size=60), np.nan)
    frame = {"plan": rng.choice(["a", "b"], 60), "x": x, "day": np.arange(60) // 6, "action": ["on", "off"] * 30,
             "legal_on": np.ones(60, int), "legal_off": np.ones(60, int), "reward": np.zeros(60)}  # fmt: skip
    data = dr.Dataset.from_frame(frame, episode="day", legal=["legal"])
    now = {"plan=a": "plan is a", "plan=b": "plan is b", "x_missing": "x has no value", "legal=off": "legal is off",
           "legal=on": "legal is on"}  # fmt: skip
    before = {f"{name}, 1 back": f"{text}, 1 back" for name, text in now.items()}
    assert {_names(data, 2)[i]: text for i, text in _marks(data, 2).items()} == before | now
