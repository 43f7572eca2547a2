"""Hostile names on the whole way: runs by default folders, and a table whose columns and levels are called so."""

import csv
import dataclasses
import unicodedata
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.collect.in_task import collect_in_task
from deadreckon.data.formats.csv_out import cell
from deadreckon.files import read_toml
from deadreckon.runs import online
from deadreckon.runs.crossfit import cross_fit
from deadreckon.runs.train import train_together
from deadreckon.tasks import task
from tests.hostile import FEW, NAMES, PLAIN, place, told  # noqa: F401 - a fixture

ROWS = 24
TINY = {"steps": 2, "task": False, "seeds": 1}


def agent():
    return dr.agents.BC(hidden=(8,), batch_size=8)


def log(name: str) -> dr.Dataset:
    rng = np.random.default_rng(0)
    return dr.Dataset.from_arrays(
        observations=rng.normal(size=(ROWS, 2)), actions=rng.uniform(-1, 1, (ROWS, 1)), rewards=rng.normal(size=ROWS),
        timeouts=np.arange(ROWS) % 4 == 3, name=name,
    )  # fmt: skip


def trained(name):
    return dr.train(agent(), log(name), holdout=0, **TINY)


def fitted(name):
    return agent().fit(log(name), holdout=0, **TINY)


def together(name):
    return train_together({name: agent(), "other": agent()}, log(name), out="out", holdout=0, **TINY)


def crossed(name):
    return cross_fit(agent(), log(name), folds=2, **TINY)


class Still:
    has_log_prob = False

    def start(self, n):
        return ()

    def act(self, step, carry, key, *, greedy):
        return self(step.observation), carry

    def __call__(self, observations):
        return np.zeros((len(observations), 2))


def collected(name):
    return collect_in_task("maze2d-umaze", Still(), steps=4, by=name)


DEFAULTS = [trained, fitted, together, crossed, collected]
CASES = [(write, name) for write in DEFAULTS for name in (*NAMES, PLAIN)]
QUICK = (*FEW[2:4], PLAIN)


@pytest.mark.parametrize(
    ("write", "name"),
    [
        pytest.param(*case, id=f"{case[0].__name__}-{told(case[1])}", marks=() if case[1] in QUICK else pytest.mark.slow)
        for case in CASES
    ],
)
def test_folders_by_default_lie_where_they_should(write, name, place):  # noqa: F811
    with place.attacked(refused=name != PLAIN):
        write(place.name(name))
    if name == PLAIN:
        assert place.written()


@pytest.mark.parametrize("name", [*NAMES, PLAIN], ids=told)
def test_online_runs_by_default_lie_where_they_should(name, place, monkeypatch):  # noqa: F811
    """Of a task that somebody else wrote; nothing is learned."""

    def made(lanes, task, steps, numbers, folder, asked, start):
        assert task.name == place.name(name)
        folder.path.mkdir(parents=True)
        (folder.path / "run.json").write_text("{}")

    monkeypatch.setattr(online, "_train_online", made)
    strange = dataclasses.replace(task("maze2d-umaze"), name=place.name(name))
    with place.attacked(refused=name != PLAIN):
        online.train_online("sac", strange, steps=5)
    if name == PLAIN:
        assert [str(path) for path in Path("runs").rglob("run.json")] == ["runs/sac-plain-online/run.json"]


OBSERVED = ["\x1b[2J\x1b]0;owned\x07", "=cmd|' /C calc'!A0", "<script>alert(1)</script>", "../victim/important", "[/b]\u202eg"]
LEVELS = ["\x1b[31mred", "=1+cmd|x", "<b>", "../victim/important"]


def table(path: Path) -> Path:
    rng = np.random.default_rng(0)
    numbers = {name: rng.normal(size=ROWS) for name in (*OBSERVED, "paid\x9b")}
    texts = {name: rng.choice(LEVELS, ROWS) for name in ("kind \x1b[5m", "@action")}
    parquet.write_table(pa.table(numbers | texts), path)
    return path


def harmless(text: str) -> bool:
    return not [c for c in text if (unicodedata.category(c) in ("Cc", "Cs") or c == "\u202e") and c not in "\n\t"]


WAYS = ["--action", "@action", "--reward", "paid\x9b"]
TABLES = [
    (0, ["data", "info", "evil.parquet", *WAYS, "--html", "info.html"]),
    (0, ["data", "describe", "evil.parquet", *WAYS, "--save", "schema.toml"]),
    (0, ["data", "convert", "evil.parquet", "log.parquet", *WAYS]),
    (0, ["data", "info", "log.parquet"]),
    (2, ["data", "info", "evil.parquet", "--action", OBSERVED[0], "--reward", "no such \x1b[0m"]),
    (2, ["data", "info", OBSERVED[0]]),
    (0, ["design", "evil.parquet", "--method", "random", "--target", "paid\x9b", "-n", "3", "--out", "designed"]),
    (0, ["design", "describe", "evil.parquet", "--target", "paid\x9b", "--save", "designs.toml"]),
]
RUNS = [
    (0, ["train", "--agent", "bc", "--data", "evil.parquet", *WAYS, "--steps", "2", "--agent.hidden", "8", "--out", "run"]),
    (0, ["report", "run"]),
    (0, ["predict", "run", "evil.parquet", "--out", "actions.csv", "--probabilities", "--keep", OBSERVED[0], "kind \x1b[5m"]),
    (0, ["export", "run", "--format", "numpy", "--out", "exported"]),
    (0, ["monitor", "run", "evil.parquet", "--html", "monitored.html"]),  # 5 rows that it has not seen are too few for an alarm
]


@pytest.mark.parametrize(
    ("commands", "written"),
    [
        (TABLES, {"info.html", "schema.toml", "designs.toml", "report.html", "proposals.csv"}),
        pytest.param(RUNS, {"report.html", "actions.csv", "card.md", "monitored.html"}, marks=pytest.mark.slow),
    ],
    ids=["tables", "runs"],
)
def test_names_in_a_table_steer_neither_terminal_nor_page_nor_spreadsheet(place, capsys, commands, written):  # noqa: F811
    table(Path("evil.parquet"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for code, words in commands:
            assert main(words) == code, words
    out, err = capsys.readouterr()
    assert harmless(out)
    assert harmless(err)
    place.check()
    pages = [path for path in place.work.rglob("*") if path.suffix in (".html", ".md", ".toml", ".csv")]
    assert {path.name for path in pages} >= written
    for path in pages:
        text = path.read_text(encoding="utf-8")
        if path.suffix != ".csv":  # whose cells are data
            assert harmless(text), path
        elif path.parent.name != "victim":
            assert [each for row in csv.reader(text.splitlines()) for each in row if cell(each) != each] == []
        if path.suffix == ".html":
            assert "<script>alert" not in text
        if path.suffix == ".toml":
            assert set(read_toml(path)["columns"]) >= set(OBSERVED)
