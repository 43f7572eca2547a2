"""Agents of one's own, outside the package: the page's example, in Python and on the command line."""

import importlib.metadata
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.agents import BC, agent_class, agent_name, plugins, short_name
from deadreckon.cli.main import main
from deadreckon.errors import UserError
from deadreckon.runs.lanes import agents_of

PAGE = Path(__file__).resolve().parents[2] / "docs" / "agents" / "your-own.md"


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """The folder of `mine.py`, as the page has it, which is the current one; a module of another name each time."""
    name = f"mine_{tmp_path.name}".replace("-", "_")
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert code is not None
    (tmp_path / f"{name}.py").write_text(code[1])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield name
    sys.modules.pop(name, None)


def test_an_agent_is_found_by_module_and_class(mine):
    kind = agent_class(f"{mine}:RWR")
    assert issubclass(kind, dr.agents.Agent)
    agent = kind(temperature=3.0)
    assert (agent_name(agent), short_name(agent)) == (f"{mine}:RWR", "RWR")
    assert agent_name(BC()) == "bc"
    assert kind is agent_class(f"{mine}:RWR")


def test_what_is_no_agent_is_told(mine):
    for name, words in (
        ("nowhere_at_all:RWR", "No module named 'nowhere_at_all'.*named module:Class"), (f"{mine}:Missing", "no class Missing"),
        (f"{mine}:State", "no class State that is a deadreckon.agents.Agent"), ("rwr", "unknown agent 'rwr'"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=words):
            agent_class(name)


def test_an_entry_point_gives_it_a_name(mine, monkeypatch):
    point = importlib.metadata.EntryPoint("rwr", f"{mine}:RWR", "deadreckon.agents")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [point] if group == "deadreckon.agents" else [])
    assert plugins() == {"rwr": f"{mine}:RWR"}
    assert agent_name(agent_class("RWR")()) == "rwr"


def test_a_run_folder_does_not_decide_which_code_is_loaded(mine):
    config = {"agent": {"name": f"{mine}:RWR", "fields": {"temperature": 2.0}}, "seeds": [0]}
    with pytest.raises(UserError, match=f"which is not part of deadreckon: import {mine} first"):
        agents_of(config)
    assert mine not in sys.modules
    kind = agent_class(f"{mine}:RWR")
    assert agents_of(config) == [kind(temperature=2.0)]


def test_the_command_line_takes_it(mine, tmp_path, capsys):
    rng = np.random.default_rng(0)
    rows = ["x,offer,paid"] + [f"{x:.3f},{a:.3f},{-abs(x - a):.3f}" for x, a in rng.uniform(-0.9, 0.9, (60, 2))]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    columns = ["--data", "log.csv", "--action", "offer", "--reward", "paid"]
    asked = ["train", "--agent", f"{mine}:RWR", "--agent.temperature", "3", "--agent.hidden", "8", "--agent.batch-size", "16"]
    assert main([*asked, *columns, "--steps", "20"]) == 0
    assert dr.load_run("runs/RWR-log").config["agent"]["name"] == f"{mine}:RWR"
    assert main(["report", "runs/RWR-log"]) == 0
    assert "RWR" in Path("report.html").read_text()
    assert main([*asked[:3], "--agent.temperature", "0", *columns]) == 2
    assert "RWR.temperature takes a finite number > 0, got 0" in capsys.readouterr().err


def test_what_is_there_is_listed():
    assert {"BEAR", "IQL", "agent_class"} <= set(dir(dr.agents))
    assert {"train", "ope", "Dataset"} <= set(dir(dr))
