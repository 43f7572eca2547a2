"""Jobs are run once, by processes that may die; what they bring is kept, and shown."""

import dataclasses
import json
import multiprocessing
import os
import re
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from deadreckon.agents.bc import BC
from deadreckon.bench.executor import run
from deadreckon.bench.forms import rendered
from deadreckon.bench.identity import revisions_of
from deadreckon.bench.jobs import Job, Program, programs
from deadreckon.bench.local import Local, shares
from deadreckon.bench.plan import plan
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.suite import read
from deadreckon.bench.tables import tables
from deadreckon.bench.times import forecast
from deadreckon.bench.work import perform
from deadreckon.cli.lines import Lines
from deadreckon.cli.main import main
from deadreckon.errors import UserError
from tests.bench.in_process import InProcess

SUITE = """
seeds = 2
steps = 60
evaluations = 2
episodes = 2
logs = ["maze2d-umaze-v1"]
rows = 600

[methods]
BC = { agent = "bc", fields = { hidden = [8], batch_size = 16 } }
TD3 = { agent = "td3", fields = { hidden = [8], batch_size = 16 } }
"""

ONLINE = """
kind = "online"
seeds = 2
steps = 640
evaluations = 2
episodes = 2
tasks = ["maze2d-umaze"]
data = { maze2d-umaze = "maze2d-umaze-v1" }
offline = 30

[methods]
SAC = { agent = "sac", log = "first" }
"""


class Noted:
    """A tracker that keeps what it is told."""

    points: ClassVar[list] = []

    def start(self, config):
        pass

    def log(self, step, seed, metrics):
        self.points.append((step, metrics))

    def finish(self, files):
        pass


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SUITE)
    return read(path)


def made(job, scores, failure=""):
    """Results as a job would bring them."""
    versions = json.dumps({"jax": "1", "mujoco": "2"})
    rows = [
        {"seed": seed, "score": score, "raw": 2 * score, "steps": 60, "seconds": 30.0, "failure": failure, "versions": versions}
        for seed, score in zip(job.seeds, scores)
    ]
    return JobResult(rows, [])


@pytest.mark.slow
def test_jobs_are_done_once_though_a_process_is_killed_and_a_job_fails(suite, tmp_path):
    jobs = plan(suite)[:1]
    lost = dataclasses.replace(jobs[0], method="lost", on="no-such-log", data="no-such-log", program=None)
    lost = dataclasses.replace(lost, revisions=revisions_of(lost))
    store, events = Store(tmp_path / "out"), []

    def told(event):
        events.append((event.what, event.program.jobs[0].method))
        if event.what == "begun" and len(events) == 1:  # the first process, when it has just begun
            [child] = multiprocessing.active_children()
            os.kill(child.pid, signal.SIGKILL)

    run([*jobs, lost], store, told, Local(store.path, workers=1))
    whats = [event for event in events if event[0] != "progress"]
    assert whats == [("begun", "BC"), ("died", "BC"), ("begun", "BC"), ("done", "BC"), ("begun", "lost"), ("failed", "lost")]
    assert "no-such-log" in store.failure(lost, 0)["error"]
    found = store.of(jobs)
    assert sorted(found["cell"].to_pylist()) == sorted(cell for job in jobs for cell in job.cells)
    assert np.isfinite(found["score"].to_numpy()).all()
    assert len(store.curves()) == 2 * 2  # evaluations, seeds

    events.clear()
    run(jobs, store, told, Local(store.path, workers=1))
    assert events == []  # nothing is done twice

    # The numbers are those of the same job in this process, which has other threads.
    [again] = perform(Program((jobs[0],)), tmp_path / "again", track=("tests.bench.test_runner:Noted",))
    tracked = {step for step, metrics in Noted.points if {"train/behavior_nll", "evaluation/score"} <= metrics.keys()}
    assert tracked == {point["step"] for point in again.curves}
    mine = found.filter(np.asarray(found["method"]) == "BC")
    assert [row["score"] for row in again.rows] == pytest.approx(mine["score"].to_pylist(), rel=1e-4)


@pytest.mark.slow
def test_a_process_that_always_dies_is_given_up(suite, tmp_path):
    jobs, store = plan(suite), Store(tmp_path / "out")
    deaths = []

    def told(event):
        if event.what == "begun" and event.program.jobs[0].method == "BC":
            for child in multiprocessing.active_children():
                os.kill(child.pid, signal.SIGKILL)
            deaths.append(event)

    run(jobs[:1], store, told, Local(store.path, workers=1))
    assert len(deaths) == 3
    assert "died 3 times" in store.failure(jobs[0], 1)["error"]


def test_a_seed_that_fails_does_not_take_the_others_with_it(suite, tmp_path):
    """A designer's program raises if any of its seeds diverges."""
    job, store, done = dataclasses.replace(plan(suite, 2)[0], kind="design"), Store(tmp_path), []

    def work(program, folder, watch):
        done.append(program.jobs[0].seeds)
        if 0 in program.jobs[0].seeds:
            raise UserError("the loss of seed 0 was not finite")
        return [made(program.jobs[0], (11.0,))]

    events = []
    run([job], store, events.append, InProcess(store.path, work=work))
    assert done == [(0, 1), (0,), (1,)]
    assert [event.what for event in events if event.what in ("split", "failed", "done")] == ["split", "failed", "done"]
    assert store.results()["seed"].to_pylist() == [1]
    assert store.failure(job, 0)["error"] == "the loss of seed 0 was not finite"


def test_the_note_on_collected_logs_names_logs_and_no_tasks(tmp_path):
    path = tmp_path / "online.toml"
    path.write_text(ONLINE)
    asked = read(path)
    [shown, *_] = tables(asked, plan(asked), Store(tmp_path))
    assert [note for note in shown.notes if "collected" in note] == [
        "collected again by this package, not the original files: maze2d-umaze-v1",
    ]
    assert "evaluated from the same starts, and intervals do not include how starts vary" in shown.notes[0]


def test_a_table_shows_scores_what_is_missing_and_what_failed(suite, tmp_path):
    jobs, store = plan(suite), Store(tmp_path)
    store.fail(jobs[1], "out of luck", "")
    store.keep(jobs[0], made(jobs[0], (10.0, 12.0)))
    [shown] = tables(suite, jobs, store)
    assert str(shown.cells["BC"]["maze2d-umaze-v1"].estimate) == "11 [-1.706, 23.71]"  # 11 -+ 12.706 * 1
    plain = rendered([shown])
    assert "11.0 [-1.7, 23.7]" in plain
    assert "FAILED: TD3 on maze2d-umaze-v1: out of luck" in plain
    assert "made with jax 1, mujoco 2" in plain
    assert "130.6 (SAC-N, CORL)" in plain  # the best published
    assert not shown.cells["TD3"]["maze2d-umaze-v1"].bold

    store.keep(jobs[1], made(jobs[1], (50.0, 50.1), "critic_loss was not finite at update 7"))
    [shown] = tables(suite, jobs, store)
    assert "* best of the methods without missing or failed runs, or not significantly" in rendered([shown])
    # What went bad is not best, whatever it scored.
    assert [shown.cells[m]["maze2d-umaze-v1"].bold for m in ("BC", "TD3")] == [True, False]
    assert "50.0 [49.4, 50.7] (2 failed)" in rendered([shown])
    assert "FAILED" not in rendered([shown])
    assert "seed 0 of TD3 on maze2d-umaze-v1 failed: critic_loss was not finite at update 7" in rendered([shown])

    newer = made(jobs[1], (50.0, 50.1))
    newer.rows[1]["versions"] = json.dumps({"deadreckon": "7", "jax": "1.5", "mujoco": "2", "threads": 3})
    store.keep(jobs[1], newer)
    [shown] = tables(suite, jobs, store)
    assert "made with deadreckon 7, jax 1 and 1.5, mujoco 2\n" in rendered([shown]) + "\n"
    assert [shown.cells[m]["maze2d-umaze-v1"].bold for m in ("BC", "TD3")] == [False, True]
    assert "* best, or not significantly" in rendered([shown])
    assert "**50.0 [49.4, 50.7]**" in rendered([shown], "markdown")
    assert r"\textbf{50.0 [49.4, 50.7]}" in rendered([shown], "latex")
    head, bc, td3 = rendered([shown], "csv").split("\n")
    assert td3.startswith("score,maze2d-umaze-v1,TD3,2,50.05,")


def test_a_result_imports_no_agent(suite, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stranger_of_results.py").write_text("open('PWNED', 'w').close()\n")
    store, [job, *_] = Store(tmp_path / "store"), plan(suite)
    store.keep(dataclasses.replace(job, agent="stranger_of_results:Agent"), made(job, (1.0, 2.0)))
    assert len(store.of([job], any_revision=True)) == 0
    assert not (tmp_path / "PWNED").exists()


def test_results_of_other_revisions_are_shown_when_asked_for_and_told(suite, tmp_path, monkeypatch):
    store = Store(tmp_path)

    def at(revision):
        monkeypatch.setattr(BC, "revision", revision)
        return plan(suite)

    for revision, scores in ((1, (1.0, 2.0)), (4, (3.0, 4.0)), (3, (5.0, 6.0))):
        job = at(revision)[0]
        store.keep(job, made(job, scores))
    jobs = at(2)
    assert len(store.of(jobs)) == 0
    assert len(store.of(jobs, any_revision=True)) == 6
    assert "without a result yet: 4 of 4 cells" in rendered(tables(suite, jobs, store))
    shown = rendered(tables(suite, jobs, store, any_revision=True))
    assert "5.5" in shown  # the newest
    assert "without a result yet: 2 of 4 cells" in shown
    assert "2 of 2 results are of other revisions of their method or of the protocol" in shown
    shown = rendered(tables(suite, at(4), store, any_revision=True))
    assert "3.5" in shown  # the present revision's, though another is newer
    assert "other revisions" not in shown


def test_results_from_when_the_source_was_hashed_are_other_revisions(suite, tmp_path):
    """They hold a digest of the source in place of revisions, which was part of their cells' names, and fields' older names."""
    store, job = Store(tmp_path), plan(suite)[1]
    store.keep(job, made(job, (1.0, 2.0)))
    [part] = (tmp_path / "results").iterdir()
    rows = pq.read_table(part).to_pylist()
    for row in rows:
        del row["revisions"]
        row |= {"cell": f"old{row['seed']}", "content": "as it was then", "code": "0f"}
        row["settings"] = row["settings"].replace('"policy_noise"', '"noise"')
    pq.write_table(pa.Table.from_pylist(rows), part)
    assert len(store.of([job])) == 0
    assert store.undone([job]) == [job]
    shown = rendered(tables(suite, [job], store, any_revision=True))
    assert "1.5" in shown
    assert "2 of 2 results are of other revisions" in shown


def test_jobs_that_are_the_same_by_content_are_done_once(suite, tmp_path):
    jobs, store = plan(suite), Store(tmp_path)
    twin = dataclasses.replace(jobs[0], method="cloning")
    assert store.undone([*jobs, twin]) == jobs
    store.keep(twin, made(twin, (1.0, 2.0)))
    assert store.undone([*jobs, twin]) == [jobs[1]]
    assert "1.5" in rendered(tables(suite, jobs, store))


def test_a_log_without_a_simulator_has_no_scores_and_says_so(suite, tmp_path):
    jobs, store = plan(suite), Store(tmp_path)
    for job in jobs:
        store.keep(job, made(job, (np.nan, np.nan)))
    assert "no simulator to evaluate in, so no scores: maze2d-umaze-v1" in rendered(tables(suite, jobs, store))
    assert "nan" not in rendered(tables(suite, jobs, store))


def test_a_design_suite_runs_through(tmp_path):
    path = tmp_path / "d.toml"
    path.write_text('kind = "design"\nseeds = 2\nproblems = ["branin"]\ndesigns = 8\n'
                    '[methods]\nbest = { agent = "best" }\nrandom = { agent = "random" }\n')  # fmt: skip
    store = Store(tmp_path / "out")
    jobs = plan(read(path))
    for program in programs(jobs):
        store.keep(program.jobs[0], *perform(program, store.folder(program)))
    found = store.of(jobs).to_pylist()
    assert len(found) == 4
    more = [json.loads(row["more"]) for row in found]
    assert all(m["median"] <= row["score"] and m["median_raw"] <= row["raw"] for m, row in zip(more, found))
    assert "branin" in rendered(tables(read(path), jobs, store))


@pytest.mark.slow
def test_a_suite_of_estimators_has_a_table_a_metric(tmp_path, capsys):
    path = tmp_path / "o.toml"
    path.write_text('kind = "ope"\nseeds = 2\nlogs = ["hopper-random-v2"]\nrows = 400\n[methods]\nIS = { agent = "is" }\n'
                    'PDIS = { agent = "pdis" }\n')  # fmt: skip
    store = Store(tmp_path / "out")
    jobs = plan(read(path))
    assert main(["bench", str(path), "--out", str(store.path), "--workers", "1"]) == 0
    shown = capsys.readouterr().out
    for words in ("Absolute error, in ranges of the true values, less is better", "Rank correlation, more is better"):
        assert words in shown
    assert not re.search(r"^ *thesis ", shown, re.M)  # whose appendix E.2 is of whole logs
    assert str(tmp_path / "out" / "reports" / "o.html") in shown
    found = store.of(jobs).to_pylist()
    assert [row["method"] for row in found].count("IS") == 2
    for row in found:
        more = json.loads(row["more"])
        assert len(more["result"]["estimates"]) == 11
        assert row["score"] == more["rank_correlation"]
    path.write_text(path.read_text().replace("hopper-random", "maze2d-umaze").replace("-v2", "-v1"))
    with pytest.raises(UserError, match="maze2d-umaze"):
        plan(read(path))


def test_what_another_command_has_done_since_is_not_begun(suite, tmp_path, capsys):
    jobs, store, begun = plan(suite, 1), Store(tmp_path / "out"), []

    def work(program, folder, watch):
        begun.append(str(program))
        if len(begun) == 1:
            store.keep(jobs[1], made(jobs[1], (1.0,)))
        return [made(job, (2.0,)) for job in program.jobs]

    run(jobs, store, Lines(4), InProcess(store.path, work=work))
    assert begun == ["BC on maze2d-umaze-v1, seed 0", "TD3 on maze2d-umaze-v1, seed 0", "TD3 on maze2d-umaze-v1, seed 1"]
    assert "2 of 4: BC on maze2d-umaze-v1, seed 1, done by another command\n3 of 4: TD3" in capsys.readouterr().out
    assert sorted(store.of(jobs)["score"].to_pylist()) == [1.0, 2.0, 2.0, 2.0]


def test_what_was_found_in_time_is_kept_though_nobody_had_asked_for_it_yet(suite, tmp_path):
    """Results of two workers come in together, and the time is over when the first has been heard."""
    jobs, store, clock = plan(suite, 1), Store(tmp_path / "out"), [0.0]

    class Two(InProcess):
        room = property(lambda self: len(self._taken) < 2)

        def wait(self, timeout=None):
            clock[0] += 10.0
            return super().wait(timeout)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deadreckon.bench.executor.time", SimpleNamespace(monotonic=lambda: clock[0]))
        run(
            jobs,
            store,
            lambda event: None,
            Two(store.path, work=lambda program, *_: [made(j, (2.0,)) for j in program.jobs]),
            5.0,
        )
    assert store.of(jobs).num_rows == 2


def test_an_estimator_without_sound_estimates_has_no_score(monkeypatch, tmp_path):
    """NaN, as a null would make the whole folder of results unreadable."""
    result = SimpleNamespace(estimates=np.array([np.nan]), warnings=["no estimate"])
    monkeypatch.setattr("deadreckon.ope.dope.evaluate_log", lambda *args, **options: [result])
    monkeypatch.setattr("deadreckon.ope.dope.to_json", lambda result: {})
    monkeypatch.setattr("deadreckon.bench.work._log", lambda job: SimpleNamespace(fingerprint="x"))
    job = Job("ope", "IS", "is", {}, "", "hopper-random-v2", "x", {"budget": "full", "fields": {}}, (0,))
    job = dataclasses.replace(job, revisions=revisions_of(job))
    [found] = perform(Program((job,)), tmp_path / "run")
    assert [(str(row["score"]), row["failure"]) for row in found.rows] == [("nan", "no estimate")]


def test_times_come_from_jobs_that_are_done(suite, tmp_path):
    jobs, store = plan(suite), Store(tmp_path)
    assert forecast(programs(jobs), store) == {job.name: None for job in jobs}
    done = made(jobs[0], (1.0, 2.0))
    store.keep(jobs[0], JobResult([row | {"versions": '{"device": "cpu cpu"}'} for row in done.rows], []))
    longer = dataclasses.replace(jobs[0], options=jobs[0].options | {"steps": 600})
    assert forecast(programs([longer, jobs[1]]), store) == {longer.name: (pytest.approx(300.0), True, True), jobs[1].name: None}


def test_workers_share_the_cores():
    cores = sorted(os.sched_getaffinity(0))
    assert shares(1, False) == [cores]
    assert [len(share) for share in shares(None, False)] == [1] * len(cores)
    assert shares(None, True) == [cores]
    many = shares(len(cores) + 3, False)
    assert [len(share) for share in many] == [1] * (len(cores) + 3)
    assert {core for share in many for core in share} == set(cores)
    with pytest.raises(UserError, match="workers must be 1 or more, got 0"):
        Local(Path("nowhere"), workers=0)


def test_what_is_missing_of_a_job_is_done_once_and_packed_as_it_may_be(suite, tmp_path):
    store, whole = Store(tmp_path), plan(suite)
    alone = plan(suite, lanes=1)
    assert [job.seeds for job in alone] == [(0,), (1,)] * 2
    assert [cell for job in alone for cell in job.cells] == [cell for job in whole for cell in job.cells]
    store.keep(alone[0], made(alone[0], (1.0,)))
    assert [(job.method, job.seeds) for job in store.undone(whole)] == [("BC", (1,)), ("TD3", (0, 1))]
    gap = dataclasses.replace(whole[0], seeds=(0, 1, 2, 3))
    store.keep(one := dataclasses.replace(gap, seeds=(2,)), made(one, (1.0,)))
    assert [job.seeds for job in store.undone([gap])] == [(1,), (3,)]
    store.keep(whole[0], made(whole[0], (5.0, 6.0)))  # another command has done seed 0 once more
    assert sorted(store.of(whole)["score"].to_pylist()) == [5.0, 6.0]
    store.fail(alone[2], "out of luck", "")
    assert "FAILED: TD3 on maze2d-umaze-v1: out of luck" in rendered(tables(suite, whole, store))


def test_the_command_lists_plans_and_refuses(suite, tmp_path, capsys):
    assert main(["bench", "list"]) == 0
    assert "quick" in capsys.readouterr().out
    assert main(["bench", str(tmp_path / "small.toml"), "--out", str(tmp_path / "out"), "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "4 cells, 0 of them done" in out
    assert "TD3 on maze2d-umaze-v1, seed 1: time not known, no similar job is finished" in out
    assert not (tmp_path / "out").exists()
    assert main(["bench", "quik"]) == 2
    assert "did you mean quick" in capsys.readouterr().err
    assert main(["bench", "quick", "--workers", "0"]) == 2
    assert main(["bench", "quick", "--track", "tensorbord"]) == 2
    assert "unknown tracker 'tensorbord': did you mean tensorboard?" in capsys.readouterr().err
    parts = '[methods]\nA = { agent = "tests.bench.test_runner:made" }\n[metrics]\nx = { words = "x" }\n'
    (tmp_path / "study.toml").write_text(f'kind = "study"\nseeds = 1\ncases = ["a"]\n{parts}')
    assert main(["bench", str(tmp_path / "study.toml"), "--track", "tests.bench.test_runner:Noted"]) == 2
    assert "suites of the kinds learn, online), and these are of the kinds study" in capsys.readouterr().err
    assert main(["bench", "quick", "--gpu", "--for", "1m", "--track", "mlflow"]) == 2
    assert "--track does not go with --gpu" in capsys.readouterr().err
    assert main(["bench", "show", "quick", "--out", str(tmp_path / "out"), "--format", "markdown"]) == 0
    assert "without a result yet: 12 of 12 cells" in capsys.readouterr().out
