"""A small study of faults for each kind of command: what is killed goes on, and its results are the same to the bit."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.commands import COMMANDS, Command, checkpoint_steps, computed, digests, finished, leftovers, repeated
from tests.faults.study import EACH, KILL, done_before, planned, table

ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
@pytest.mark.parametrize("only", ["train", "collect", "ope", "queue"])
def test_killed_at_random_twenty_times(only, tmp_path):
    options = ["--kills", "20", "--only", only, "--faults", KILL, "--out", str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)])}
    subprocess.run([sys.executable, "-m", "tests.faults", *options], check=True, cwd=ROOT, env=environment)
    rows = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert sum(row["kills"] for row in rows) >= 20
    assert [row for row in rows if row["broken"]] == []


def test_every_command_meets_every_fault_and_most_cases_are_kills():
    commands = list(COMMANDS)
    seen = [planned(number, commands) for number in range((EACH + 1) * 15 * len(commands))]
    others = {(command.name, fault) for command, fault in seen if fault != KILL}
    assert len(others) == 11 * len(commands)
    assert sum(fault == KILL for _, fault in seen) / len(seen) == EACH / (EACH + 1)
    assert planned(7, commands) == planned(7, commands)


def test_what_must_not_change_is_told_from_what_may(tmp_path):
    run = Command("train", (), kept=("evaluations/*.parquet",), steps="checkpoints/*.npz")
    for name in ("checkpoints/0000000010.npz", "evaluations/0000000010.parquet", "evaluations/0000000020.parquet"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert checkpoint_steps(run, tmp_path) == [(tmp_path / "checkpoints/0000000010.npz", 10)]
    assert list(finished(run, tmp_path)) == [str(tmp_path / "evaluations/0000000010.parquet")]  # the later one is done again
    (tmp_path / "a.json").write_text('{"seconds": 1.0, "value": 2}')
    (tmp_path / "b.json").write_text('{"seconds": 3.0, "value": 2}')
    (tmp_path / "c.json").write_text('{"seconds": 1.0, "value": 3}')
    same = digests(tmp_path, ("*.npz", "*.parquet"))
    assert same["a.json"] == same["b.json"] != same["c.json"]
    (tmp_path / ".x.lock").touch()
    assert leftovers(tmp_path) == [".x.lock"]


def test_a_finished_cell_that_is_computed_again_is_noticed(tmp_path):
    queue = Command("bench", (), kept=("../ledger/study/*/*.json",), computed="done.txt")
    cell = tmp_path / "ledger" / "study" / "a" / "one-0.json"
    cell.parent.mkdir(parents=True)
    (tmp_path / "out").mkdir()
    cell.write_text(json.dumps({"on": "a", "settings": {"size": 1.0}, "seed": 3}))
    (tmp_path / "done.txt").write_text("a 1.0 3\na 1.0 4\n")
    done = finished(queue, tmp_path / "out")
    assert len(done) == 1
    assert repeated(queue, tmp_path, done, 1) == []  # the other cell, which is not finished
    assert repeated(queue, tmp_path, done, 0) == ["a 1.0 3"]
    assert computed(queue, tmp_path) == ["a 1.0 3", "a 1.0 4"]
    other = Command("train", ())
    assert computed(other, tmp_path) == repeated(other, tmp_path, done, 0) == []


def test_the_table_counts():
    rows = [
        {"case": 0, "command": "train", "fault": KILL, "kills": 3, "outcome": "", "broken": []},
        {"case": 1, "command": "train", "fault": KILL, "kills": 2, "outcome": "", "broken": ["lost"]},
        {"case": 4, "command": "ope", "fault": "disk full", "kills": 0, "outcome": "told", "broken": []},
    ]
    text = table(rows)
    assert "| `train` | 2 | 5 | 1 |" in text
    assert "| disk full | 1 | 1 | told (1) | 0 |" in text
    assert "- case 1, SIGKILL, `train`: lost" in text


def test_the_page_shows_what_the_file_of_results_says():
    assert table(done_before(ROOT / "evidence" / "faults.jsonl")) in (ROOT / "docs" / "reliability.md").read_text()
