"""The code of the pages *Use it* runs as it stands there, in their order, in one folder."""

import contextlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from deadreckon.cli.main import main

PAGES = Path(__file__).resolve().parent.parent / "docs" / "use"
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page):
    """(kind, code) of each block of a page; training takes a few steps of a small network."""
    small = {"IQL(hidden=(64, 64))": "BC(hidden=(8,), batch_size=8)", "steps=2_000": "steps=5"}
    found = BLOCK.findall((PAGES / page).read_text())
    for long, short in small.items():
        found = [(kind, code.replace(long, short)) for kind, code in found]
    return found


def commands(code):
    lines = code.replace("\\\n", " ").splitlines()
    return [shlex.split(line, comments=True) for line in lines if line.startswith("deadreckon ")]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with the table and the run that the first block of the first page makes, and the names of that block."""
    folder, names = tmp_path_factory.mktemp("docs"), {}
    with contextlib.chdir(folder):
        exec(compile(blocks("predict.md")[0][1], "predict.md", "exec"), names)
    return folder, names


@pytest.fixture
def folder(made, monkeypatch):
    """That folder, which is the current one."""
    monkeypatch.chdir(made[0])
    return made[0]


def test_predict(folder, made, monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", [*sys.path])
    names = dict(made[1])
    for kind, code in blocks("predict.md")[1:]:
        if kind == "python":
            exec(compile(code, "predict.md", "exec"), names)
        for words in commands(code) if kind == "sh" else ():
            assert main(words[1:]) == 0
    sys.modules.pop("portable", None)
    said = capsys.readouterr().out
    assert "column plan has 'Free' in row 0, which is none of its levels: did you mean free?" in said
    assert names["told"].outside.tolist() == [True, True]
    assert list(pd.read_parquet("actions.parquet")) == [
        "id", "offer", "probability=call", "probability=mail", "probability=none", "outside_the_log",
    ]  # fmt: skip
    assert len(pd.read_csv("actions.csv")) == 10_000


@pytest.mark.slow
def test_serve(folder):
    (_, shell), (_, code) = blocks("serve.md")
    (words,) = commands(shell)
    words[-1] = "0"  # a free port
    process = subprocess.Popen([sys.executable, "-m", "deadreckon.cli.main", *words[1:]], stdout=subprocess.PIPE, text=True)
    with process:
        try:
            port = re.search(r":(\d+)/predict", process.stdout.readline())[1]
            names: dict = {}
            exec(compile(code.replace("8000", port), "serve.md", "exec"), names)
            row = {"age": 30, "plan": "free", "discount": None}
            assert list(names["ask"](row)["action"]) == ["offer"]
            assert names["ask"]([row, {**row, "age": 99}], "?outside=flag")["outside"] == [False, True]
        finally:  # else to leave the block waits for it
            process.terminate()


@pytest.mark.slow
def test_the_policy_of_the_page_is_deployed_and_can_be_monitored(tmp_path, monkeypatch, capsys):
    """With all of its rows and steps: of a decision to deploy none nothing on the pages would run as it is printed."""
    monkeypatch.chdir(tmp_path)
    page = (PAGES / "predict.md").read_text()
    exec(compile(BLOCK.findall(page)[0][1], "predict.md", "exec"), {})
    (estimate,) = re.findall(r"^`(deadreckon ope .*?)`", page, re.MULTILINE)
    assert main(shlex.split(estimate)[1:]) == 0
    assert "DEPLOY offers seed 0: " in capsys.readouterr().out
    pd.read_csv("visits.csv").sample(300, random_state=0).to_csv("new.csv", index=False)
    (words,) = commands(blocks("monitor.md")[0][1])
    assert main(words[1:]) == 1  # the new log is of random offers, and that is found


@pytest.mark.slow
def test_export_explain_and_monitor(folder, capsys):
    pd.read_csv("visits.csv").sample(300, random_state=0).to_csv("new.csv", index=False)
    (estimate,) = re.findall(r"^`(deadreckon ope .*?)`", (PAGES / "predict.md").read_text(), re.MULTILINE)
    assert main(shlex.split(estimate)[1:]) == 0
    # A policy of so few steps is not one to deploy, so that its run is named, as the page of monitor says.
    named = {"monitor runs/offers-ope new.csv": "monitor runs/offers new.csv --estimates runs/offers-ope",
             '"runs/offers-ope", "new.csv"': '"runs/offers", "new.csv", estimates="runs/offers-ope"'}  # fmt: skip
    names: dict = {}
    exec("import deadreckon as dr", names)
    codes = {"export.md": 0, "explain.md": 0, "monitor.md": 1}  # the new log is not the policy's own, and that is found
    for page, code in codes.items():
        for kind, text in blocks(page):
            for decision, run in named.items():
                text = text.replace(decision, run)
            if kind == "python":
                exec(compile(text.replace('"offers-numpy"', '"offers-again"'), page, "exec"), names)
            for words in commands(text) if kind == "sh" else ():
                if "onnx" not in words and "mlflow" not in words:  # which take long to be imported, and have slow tests
                    assert main(words[1:]) == code
    assert Path("offers-again/card.md").exists()
    assert "What the policy does" in Path("report.html").read_text()
    assert Path("monitor.html").exists()
    assert "drift" in capsys.readouterr().out
