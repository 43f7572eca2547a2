"""Options and places that no command can do anything with are refused in one line, and nothing is left behind."""

import os
import re

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from deadreckon.cli import main as command
from deadreckon.cli.main import main

ROLES = ["--action", "act", "--reward", "reward", "--episode", "ep", "--time", "t"]
LONG = "x" * 300


@pytest.fixture
def table(tmp_path, monkeypatch):
    tmp_path = tmp_path / "work"
    tmp_path.mkdir()
    monkeypatch.chdir(tmp_path)
    rows = [f"{i // 6},{i % 6},{i % 7 / 7},{('lo', 'hi')[i % 5 > 1]},{i % 3}" for i in range(60)]
    (tmp_path / "log.csv").write_text("\n".join(["ep,t,x,act,reward", *rows]) + "\n")
    (tmp_path / "designs.csv").write_text("a,b,y\n" + "".join(f"{i / 20},{i % 4},{i % 11}\n" for i in range(24)))
    return tmp_path


@pytest.mark.parametrize(
    ("args", "told"),
    [
        (["report", "run", "--out", "log.csv"], r"log\.csv: the page is HTML, and its name must end in \.html"),
        (["monitor", "run", "log.csv", "--html", "log.csv"], r"--html log\.csv: the page is HTML"),
        (["data", "info", f"{LONG}.csv"], ": file name too long"),
        (["predict", LONG, "log.csv", "--out", "o.csv"], ": file name too long"),
        (["predict", "run", "log.csv", "--out", "o.csv", "--seed", "-1"], r"seed must be 0 \.\. 2\^32 - 1, got -1"),
        (["train", "--agent", "bc", "--data", "log.csv", *ROLES, "--out", ""], "--out is empty; name a file or a folder"),
        (["data", "convert", "log.csv", "/", "--force", *ROLES], "/ is the root of all folders"),
        (["data", "convert", "log.csv", "", *ROLES], "the target is an empty text"),
        (["train", "--agent", "bc", "--agent.hidden", "9" * 30, "--data", "log.csv", *ROLES],
         "^deadreckon: --agent.hidden: whole numbers are from"),
        (["train", "--agent", "bc", "--data", "log.csv", *ROLES, "--chunk", "9" * 30], "^deadreckon: --chunk: whole numbers"),
        (["train", "--agent", "bc", "--history", "1000000000", "--data", "log.csv", *ROLES], "history must be <= 10,000"),
        (["design", "--data", "designs.csv", "--target", "y", "--forbid", " & ".join(["a > 0"] * 51), "--out", "d"],
         "has 51 conditions, and 50 are the most"),
        (["train", "--agent", "bc", "--data", "log.csv", *ROLES, "--steps", "1", "--out", "/proc/x"], "cannot write /proc/x"),
    ],
)  # fmt: skip
def test_one_line_says_what_is_wrong(table, capsys, args, told):
    if "/proc/x" in args and not os.path.isdir("/proc"):
        pytest.skip("no /proc here")
    before = sorted(table.rglob("*"))
    assert main(args) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("deadreckon: ")
    assert re.search(told, error)
    assert sorted(table.rglob("*")) == before


def test_a_suite_of_more_cells_than_can_be_planned_is_refused(table, capsys):
    text = 'logs = ["maze2d-umaze-v1"]\nseeds = 10000000\nsteps = 10\nevaluations = 1\n[methods]\nBC = { agent = "bc" }\n'
    (table / "s.toml").write_text(text)
    assert main(["bench", "s.toml", "--dry-run"]) == 2
    assert "s.toml: 10,000,000 cells (10,000,000 seeds of each), more than 1,000,000" in capsys.readouterr().err
    (table / "s.toml").write_text(text.replace("10000000", "1").replace('"bc" }', '"bc", history = 1000000000 }'))
    assert main(["bench", "s.toml", "--dry-run"]) == 2
    assert "history of method 'BC' must be <= 10,000" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes."), 70, "deadreckon: not enough memory: RESOURCE_"),
        (ValueError("array is too big; `arr.size` is larger"), 70, "deadreckon: not enough memory: array is too big"),
        (MemoryError(), 70, "deadreckon: not enough memory: none is left"),
        (OSError(28, "No space left on device", "x"), 2, "deadreckon: x: no space left on device"),
        (OSError(12, "Cannot allocate memory"), 70, "deadreckon: not enough memory: "),
        (OSError(5, "Input/output error", "x"), 70, "deadreckon: internal error, OSError"),
    ],
)
def test_what_the_machine_lacks_is_no_internal_error(monkeypatch, capsys, error, code, told):
    def fails(args):
        raise error

    monkeypatch.setitem(command.COMMANDS, "agents", ("show", "fails", ""))
    monkeypatch.setattr("deadreckon.cli.show.fails", fails, raising=False)
    assert main(["agents"]) == code
    assert capsys.readouterr().err.startswith(told)


def test_texts_as_actions_become_numbers_in_minari(table, capsys, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(table / "minari"))
    assert main(["data", "convert", "log.csv", "minari:mine/log-v0", *ROLES]) == 0
    data = minari.load_dataset("mine/log-v0")
    assert data.action_space.n == 2
    assert np.unique(np.concatenate([each.actions for each in data.iterate_episodes()])).tolist() == [0, 1]


@pytest.mark.parametrize(
    ("ids", "roles", "told"),
    [
        (np.arange(20) // 5 + 2**53, [], "column episode has numbers from 2\\^53 on"),
        (np.float32(np.arange(20) // 5 + 2**24), ["--action", "act", "--reward", "reward", "--episode", "episode"],
         "rounded from 1.67772e"),
    ],
    ids=["our names", "float32"],
)  # fmt: skip
def test_ids_of_tables_that_were_rounded_are_refused(table, capsys, ids, roles, told):
    columns = {"episode": ids, "observation_0": np.arange(20.0), "reward": np.ones(20), "terminal": np.zeros(20, int)}
    columns |= {"act" if roles else "action_0": np.arange(20.0) % 3}
    parquet.write_table(pa.table(columns), table / "ids.parquet")
    assert main(["data", "info", "ids.parquet", *roles]) == 2
    assert re.search(told, capsys.readouterr().err)


def test_ids_that_were_rounded_do_not_become_one_episode(table, capsys):
    rows = [f"{89490200001000000000 + i // 5},{i},{'ab'[i % 2]},{i % 3}" for i in range(20)]
    (table / "ids.csv").write_text("\n".join(["ep,x,act,reward", *rows]) + "\n")
    assert main(["data", "info", "ids.csv", "--action", "act", "--reward", "reward", "--episode", "ep"]) == 2
    assert "column ep identifies episodes, and it was read as numbers up to 8.949" in capsys.readouterr().err
