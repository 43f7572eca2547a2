"""A ledger holds finished cells as files that are added and never changed; queues fill it, whatever happens to them."""

import dataclasses
import json
import math
import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from pyarrow import parquet

from deadreckon.bench.executor import run
from deadreckon.bench.idle import is_measured, measuring
from deadreckon.bench.jobs import Job, Program, programs, updates
from deadreckon.bench.ledger import Ledger, Snapshot, store_of
from deadreckon.bench.local import Local
from deadreckon.bench.plan import plan, plan_all
from deadreckon.bench.rates import work
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.suite import queue, read
from deadreckon.bench.tables import _notes, tables
from deadreckon.bench.times import forecast
from deadreckon.bench.work import perform
from deadreckon.errors import UserError
from tests.bench.in_process import InProcess

STUDY = """
about = "A study."
kind = "study"
ledger = "ledger"
seeds = 4
cases = ["a", "b"]

[methods]
one = { agent = "studies_of_tests:measure", fields = { size = 1.0 } }
two = { agent = "studies_of_tests:measure", fields = { size = 2.0 } }

[metrics]
value = { words = "a value", digits = 2 }

[full]
seeds = 6
"""

CORE = '{"device": "cpu cpu"}'  # versions of a row that a core has made
CODE = """
import os, time

def measure(case, *, seed, size):
    time.sleep(float(os.environ.get("STUDY_SECONDS", "0")))
    with open(os.environ["STUDY_DONE"], "a") as file:
        file.write(f"{case} {size} {seed}\\n")
    return {"value": size + seed / 100 + (case == "b")}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "studies_of_tests.py").write_text(CODE)
    (tmp_path / "queue.toml").write_text('suites = ["study.toml"]\n')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("STUDY_DONE", str(tmp_path / "done.txt"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "studies_of_tests", raising=False)
    return tmp_path


def filled(folder: Path) -> Ledger:
    suite = read(folder / "study.toml")
    store = store_of([suite], folder / "runs")
    run(plan(suite, 1), store, lambda event: None, InProcess(store.path))
    assert isinstance(store, Ledger)
    return store


def test_a_cell_is_a_file_that_tells_all_and_is_never_changed(folder):
    store = filled(folder)
    files = sorted((folder / "ledger" / "study").glob("*/*.json"))
    assert len(files) == 16
    cell = json.loads(files[0].read_text())
    assert (cell["on"], cell["method"], cell["seed"], cell["settings"]) == ("a", "one", cell["seed"], {"size": 1.0})
    assert cell["more"] == {"value": pytest.approx(1.0 + cell["seed"] / 100)}
    assert cell["revisions"]["study"] == 1
    assert cell["versions"]["python"]
    assert cell["seconds"] >= 0.0
    before = {file: file.read_text() for file in files}
    suite = read(folder / "study.toml")
    assert store.undone(plan(suite)) == []
    [table] = tables(suite, plan(suite), store)
    assert table.cells["two"]["b"].scores == pytest.approx([3.0, 3.01, 3.02, 3.03])
    filled(folder)
    assert {file: file.read_text() for file in files} == before
    assert len((folder / "done.txt").read_text().splitlines()) == 16


def test_seconds_before_a_lost_result_count(folder):
    """A process that ends between a program's end and its results leaves them to another one."""
    suite = read("study.toml")
    store, program = store_of([suite], folder / "runs"), programs(plan(suite, 1))[0]
    (first,), (again,) = (perform(program, store.folder(program)) for _ in range(2))
    assert again.rows[0]["seconds"] > first.rows[0]["seconds"] > 0.0


@pytest.mark.slow
def test_a_file_that_is_added_is_read(folder):
    store = filled(folder)
    rows = store.results().to_pylist()
    [other] = (folder / "ledger").rglob(f"*-{rows[0]['cell']}.json")
    text = other.read_text()
    other.unlink()
    cells = lambda: [row["cell"] for row in store.results().to_pylist()]  # noqa: E731
    assert cells() == [row["cell"] for row in rows[1:]]
    other.write_text(text)
    assert cells() == [row["cell"] for row in rows]


def test_a_snapshot_shows_what_there_was(folder):
    store = filled(folder)
    snapshot = Snapshot(store.path, store.cells)
    before = snapshot.results()
    next((folder / "ledger").rglob("*.json")).unlink()
    assert len(store.results()) == len(before) - 1
    assert snapshot.results() is before


def test_a_log_without_a_simulator_has_no_score(folder):
    (folder / "suite.toml").write_text('ledger = "ledger"\nlogs = ["hopper-medium-v2"]\n[methods]\nBC = { agent = "bc" }\n')
    suite = read("suite.toml")
    store, job = store_of([suite], folder / "runs"), plan(suite)[0]
    row = {"seed": 0, "score": math.nan, "raw": math.nan, "steps": 9, "seconds": 1.0, "failure": "", "versions": "{}"}
    store.keep(job, JobResult([row], [{"cell": job.cell(0), "step": 9, "score": math.nan, "raw": math.nan, "spread": None}]))
    [file] = (folder / "ledger").rglob("*.json")
    assert json.loads(file.read_text(), parse_constant=pytest.fail)["score"] is None
    assert math.isnan(store.results().to_pylist()[0]["score"])
    [table] = tables(suite, plan(suite), store)
    assert "no simulator to evaluate in, so no scores: hopper-medium-v2" in table.notes


def test_a_study_without_a_score_is_read_from_a_folder_of_results(folder):
    (folder / "study.toml").write_text(STUDY.replace('ledger = "ledger"', ""))
    suite = read("study.toml")
    store = Store(folder / "store")
    run(plan(suite, 1), store, lambda event: None, InProcess(store.path))
    scores = [parquet.read_table(part)["score"] for part in (folder / "store" / "results").iterdir()]
    assert sum(column.null_count for column in scores) == 0
    [table] = tables(suite, plan(suite), store)
    assert table.cells["two"]["b"].scores == pytest.approx([3.0, 3.01, 3.02, 3.03])


def test_the_full_size_is_declared_in_the_same_file(folder):
    assert (read("study.toml").seeds, read("study.toml", full=True).seeds) == (4, 6)
    text = STUDY.partition("[full]")[0]
    (folder / "small.toml").write_text(text)
    with pytest.raises(UserError, match=r"small.toml does not say what differs at full size: give it a section \[full\]"):
        read("small.toml", full=True)
    (folder / "odd.toml").write_text(text + "[full]\nmethods = 3\n")
    with pytest.raises(UserError, match=r"odd.toml: \[full\] may change budget, designs, .*, got {'methods': 3}"):
        read("odd.toml")


def test_a_queue_is_its_suites_in_their_order(folder):
    (folder / "queue.toml").write_text('suites = ["study.toml", "other.toml"]\n')
    (folder / "other.toml").write_text(STUDY.replace("seeds = 4", "seeds = 1").partition("[full]")[0])
    suites = queue("queue.toml")
    assert [suite.name for suite in suites] == ["study", "other"]
    assert [suite.name for suite in queue("queue.toml", full=True)] == ["study"]  # the other has no full size
    jobs = plan_all(suites)
    assert [job.suite for job in jobs] == ["study"] * 16 + ["other"] * 4
    assert [job.program for job in jobs] == list(range(20))
    store = store_of(suites, folder / "runs")
    assert [job.suite for job in store.undone(jobs)] == ["study"] * 16  # the other's cells are among these
    (folder / "small.toml").write_text('suites = ["other.toml"]\n')
    with pytest.raises(UserError, match=r"small.toml: none of its suites says what differs at full size, in a .*full"):
        queue("small.toml", full=True)
    (folder / "twice.toml").write_text('suites = ["study.toml", "study.toml"]\n')
    with pytest.raises(UserError, match="twice.toml: 2 of its suites are named study; give each a name of its own"):
        queue("twice.toml")
    for text, message in (
        ("suites = []", "suites must be a list of files or names of suites, got []"),
        ('suites = ["study.toml"]\nseeds = 3', "a queue has the key suites alone, got seeds too"),
    ):
        (folder / "bad.toml").write_text(text)
        with pytest.raises(UserError) as error:
            queue("bad.toml")
        assert message in str(error.value)
    (folder / "away.toml").write_text(STUDY.replace('"ledger"', '"elsewhere"'))
    with pytest.raises(UserError, match="suites of one queue must have one ledger, got .*elsewhere, .*ledger"):
        store_of([read("study.toml"), read("away.toml")], folder)


def test_results_of_earlier_revisions_are_shown_from_a_ledger_too(folder, monkeypatch):
    """Its files have their settings in the order of the alphabet."""
    text = STUDY.replace("size = 1.0", "zoom = 1.0, size = 1.0").replace("size = 2.0", "zoom = 2.0, size = 2.0")
    text = text.replace("studies_of_tests", "zoomed_studies_of_tests")
    (folder / "study.toml").write_text(text)
    (folder / "zoomed_studies_of_tests.py").write_text(CODE.replace("seed, size", "seed, size, zoom"))
    store, suite = filled(folder), read("study.toml")
    assert store.undone(plan(suite)) == []
    later = [dataclasses.replace(job, revisions={"study": 2}) for job in plan(suite)]
    assert tables(suite, later, store)[0].cells["two"]["b"].missing == 4
    [table] = tables(suite, later, store, any_revision=True)
    assert table.cells["two"]["b"].scores == pytest.approx([3.0, 3.01, 3.02, 3.03])
    swapped = text.replace("zoom = 1.0, size = 1.0", "size = 1.0, zoom = 1.0")
    (folder / "swapped.toml").write_text(swapped)
    assert [job.cells for job in plan(read("swapped.toml"))] == [job.cells for job in plan(suite)]


@pytest.mark.slow
def test_a_case_that_no_file_can_be_called_is_done_once(folder):
    (folder / "study.toml").write_text(STUDY.replace('cases = ["a", "b"]', f'cases = ["..", "{"é" * 150}"]'))  # two bytes each
    store = filled(folder)
    assert store.undone(plan(read("study.toml"))) == []


def test_a_finished_cell_is_not_written_over(folder):
    store, job = filled(folder), plan(read("study.toml"))[0]
    row = {"seed": 0, "score": 99.0, "raw": 99.0, "steps": 0, "seconds": 1.0, "failure": "", "versions": "{}"}
    before = {path: path.read_text() for path in (folder / "ledger").rglob("*.json")}
    store.keep(job, JobResult([row], []))
    assert {path: path.read_text() for path in (folder / "ledger").rglob("*") if path.is_file()} == before


def test_times_are_of_programs_of_the_same_sizes_or_rough(folder):
    shape = {"lr": 1e-3, "hidden": [32, 32], "batch_size": 256}
    job = Job("learn", "BC", "bc", shape, "", "a", "a", {"steps": 100, "episodes": 1, "every": 50}, (0,))
    design = Job("design", "NEMO", "nemo", {"steps": 30}, "", "a", "a", {"budget": "cpu", "fields": {"steps": 30}}, (0,))
    store = Store(folder / "store")
    row = {"seed": 0, "score": 1.0, "raw": 1.0, "seconds": 10.0, "failure": "", "versions": CORE}
    store.keep(job, JobResult([row | {"steps": 100}], []))
    store.keep(design, JobResult([row | {"steps": 0}], []))

    def expected(job, **changes):
        program = Program((dataclasses.replace(job, **changes),))
        found = forecast([program], store)[program.name]
        return found and (round(found.seconds, 6), found.close, found.whole)

    longer = job.options | {"steps": 500, "every": 100}
    assert expected(job, options=longer, settings=shape | {"lr": 3e-4}) == (50.0, True, True)
    assert expected(job, on="b", data="b") == (10.0, False, True)
    more = (256**2 + 2 * 24 * 256) / (32**2 + 2 * 24 * 32)  # work of an update; the first and last layer count as 24 wide
    assert expected(job, settings=shape | {"hidden": [256, 256]}) == (round(10.0 * more, 6), False, True)
    assert expected(job, settings=shape | {"batch_size": 512}, on="b", data="b", options=longer) == (100.0, False, True)
    assert expected(job, options=job.options | {"history": 4}) == (10.0, False, False)  # its updates alone
    assert expected(job, seeds=(0, 1)) is None
    assert expected(job, agent="td3") is None
    assert expected(job, on="carla-lane-v0", data="b") == (10.0, False, False)  # pictures
    assert expected(design, settings={"steps": 600}, options={"budget": "cpu", "fields": {"steps": 600}}) == (10.0, False, True)
    assert expected(design, options=design.options | {"budget": "full"}) is None


def test_of_agents_that_no_core_has_run_the_updates_are_counted(folder):
    """As of the agent that they are derived from, where that has learned from a log."""
    options = {"steps": 1000, "episodes": 1, "every": 50}
    sac = Job("learn", "SAC", "sac", {"hidden": [256, 256], "batch_size": 256}, "", "a", "a", options, (0,))
    store = Store(folder / "store")
    row = {"seed": 0, "score": 1.0, "raw": 1.0, "steps": 1000, "seconds": 2.0, "failure": "", "versions": CORE}
    store.keep(sac, JobResult([row], []))

    def expected(kind, agent, on="a", **more):
        program = Program((dataclasses.replace(sac, kind=kind, agent=agent, on=on, options=options | more),))
        found = forecast([program], store)[program.name]
        return found and (round(found.seconds, 6), found.close, found.whole)

    acting = {"copies": 1, "explore": 200, "block": 100, "updates_per_step": 4.0}
    assert expected("online", "mbpo", "hopper", acting=acting) == (6.4, False, False)  # 800 steps, 3,200 updates
    log = {"name": "hopper-medium-v2", "use": "first", "offline": 500}
    assert expected("online", "sac", "hopper", acting=acting | {"explore": 0}, log=log) == (9.0, False, False)  # 4,500
    assert expected("learn", "mopo") == (2.0, False, False)
    more = work("combo", sac.settings) / work("sac", sac.settings)
    assert expected("learn", "combo") == (round(2.0 * more, 6), False, False)
    assert expected("online", "ppo", "hopper", acting=acting) is None
    assert expected("learn", "td3") is None


def test_longer_runs_that_go_on_from_a_log_learn_from_it_once(folder):
    """2,000 updates on the log and 1,000 of acting took 30 seconds: with three times the steps it is 2,000 and 3,000."""
    options = {"steps": 1000, "episodes": 1, "every": 500, "acting": {"copies": 1, "explore": 0, "block": 100},
               "log": {"name": "hopper-medium-v2", "use": "first", "offline": 2000}}  # fmt: skip
    job = Job("online", "SAC", "sac", {"hidden": [256, 256], "batch_size": 256}, "", "hopper", "hopper", options, (0,))
    assert updates(job) == 3000
    store = Store(folder / "store")
    row = {"seed": 0, "score": 1.0, "raw": 1.0, "steps": 1000, "seconds": 30.0, "failure": "", "versions": CORE}
    store.keep(job, JobResult([row], []))
    program = Program((dataclasses.replace(job, options=options | {"steps": 3000}),))
    assert forecast([program], store)[program.name].seconds == pytest.approx(50.0)


def test_times_of_a_gpu_say_nothing_of_a_core_and_the_other_way_round(folder):
    options = {"steps": 100, "episodes": 1, "every": 50}
    job = Job("learn", "BC", "bc", {}, "", "a", "a", options, (0,))
    [waiting] = programs([dataclasses.replace(job, seeds=(7,))])
    known = lambda: [forecast([waiting], store, gpu)[waiting.name] for gpu in (False, True)]  # noqa: E731
    store = Store(folder / "store")
    row = {"score": 1.0, "raw": 1.0, "steps": 100, "failure": ""}
    for seed, device, seconds, found in (
        (0, "gpu NVIDIA H100 80GB HBM3", 4.0, [None, 4.0]), (1, "cpu cpu", 50.0, [50.0, 4.0])
    ):  # fmt: skip
        told = {"seed": seed, "seconds": seconds, "versions": json.dumps({"device": device})}
        store.keep(dataclasses.replace(job, seeds=(seed,)), JobResult([row | told], []))
        assert known() == [took and (pytest.approx(took), True, True) for took in found]


@pytest.mark.slow
def test_a_run_ends_in_time_and_goes_on(folder, monkeypatch):
    monkeypatch.setenv("STUDY_SECONDS", "1")
    suite = read("study.toml")
    jobs, store = plan(suite, 1), store_of([suite], folder / "runs")
    assert len(jobs) == 16
    begun = []  # when; a busy machine takes long to start a process
    told = lambda event: begun.append(time.monotonic()) if event.what == "begun" else None  # noqa: E731
    run(jobs, store, told, Local(store.path, workers=1), seconds=2.0)
    assert not begun or time.monotonic() - begun[0] < 8.0
    assert store.undone(jobs)
    monkeypatch.setenv("STUDY_SECONDS", "0")
    run(jobs, store, lambda event: None, Local(store.path, workers=1))
    assert store.undone(jobs) == []


def state(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="/proc, and priorities, are Linux's")
def test_idle_work_has_the_lowest_priority_and_stands_still_while_times_are_measured(folder, monkeypatch):
    monkeypatch.setenv("STUDY_SECONDS", "0.05")
    suite = read("study.toml")
    store, team, seen = store_of([suite], folder / "runs"), [], []
    executor = Local(store.path, workers=1, idle=True)

    def told(event):
        if event.what == "begun" and not team:
            team.append(executor._team[0].process.pid)
            seen.append((os.sched_getscheduler(team[0]), os.getpriority(os.PRIO_PROCESS, team[0]), os.getsid(team[0])))
            with measuring():
                assert is_measured()
                executor.wait(0.0)
                until = time.monotonic() + 60.0
                while state(team[0]) != "T" and time.monotonic() < until:
                    time.sleep(0.02)
                seen.append(state(team[0]))
            assert not is_measured()

    run(plan(suite, 1), store, told, executor)
    assert seen == [(os.SCHED_IDLE, 19, team[0]), "T"]
    assert store.undone(plan(suite)) == []


def test_a_table_says_of_how_many_copies_of_a_log_it_is_and_who_scored_designs():
    def row(on, log, more):
        return {"kind": "learn", "on": on, "log": log, "more": more, "score": 1.0, "cell": "c", "versions": "{}", "failure": ""}

    about = {"kind": "design", "method": "m", "preset": "", "cells": ["c"], "options": {}}
    jobs = [SimpleNamespace(on=on, data=f"{on}@dr1", **about) for on in ("a", "b")]
    judged = '{"oracle": "a forest"}'
    found = [row("a", "1", "{}"), row("a", "2", ""), row("b", "3", judged), row("b", "3", judged)]
    notes = _notes(jobs, [], None, found)
    assert [note for note in notes if "copies" in note] == [
        "collected on machines that round differently, so methods were trained on copies that differ: a (2 logs)"
    ]
    assert [note for note in notes if "oracle" in note] == ["oracle of b: a forest"]
