"""Cells that differ in seeds or float settings alone are lanes of one program, and are found as if each had been alone."""

import dataclasses
import json

import numpy as np
import pytest

from deadreckon.bench.executor import Event, attempt, run
from deadreckon.bench.forms import rendered
from deadreckon.bench.identity import revisions_of
from deadreckon.bench.jobs import Program, programs
from deadreckon.bench.local import Local
from deadreckon.bench.plan import plan
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.suite import read
from deadreckon.bench.tables import tables
from deadreckon.bench.times import forecast
from deadreckon.bench.tune import TrialSettings, _estimated, tune
from deadreckon.bench.tune import suite as tuning
from deadreckon.bench.work import perform
from deadreckon.cli.bench import _page
from deadreckon.cli.lines import Lines
from deadreckon.errors import BusyError
from deadreckon.files import alone
from deadreckon.runs.offline import Judged
from deadreckon.runs.run import load

SUITE = """
seeds = 2
steps = 60
evaluations = 2
episodes = 2
logs = ["maze2d-umaze-v1"]
rows = 600

[methods]
plain = { agent = "td3_bc", fields = { hidden = [8], batch_size = 16 } }
near = { agent = "td3_bc", fields = { hidden = [8], batch_size = 16, alpha = 0.1 } }
fast = { agent = "td3_bc", fields = { hidden = [8], batch_size = 16, actor_lr = 0.01, discount = 0.9 } }
"""
X = np.random.default_rng(0).uniform(-1, 1, (20, 4)).astype("f4")


@pytest.fixture
def planned(tmp_path):
    def make(text=SUITE, lanes=None):
        path = tmp_path / "some.toml"
        path.write_text(text)
        return plan(read(path), lanes)

    return make


class Here:
    """An executor in this process; `watch` is called as work goes on, and may end it as a kill does."""

    workers, lanes = 1, None

    def __init__(self, path, watch=lambda program, done: None):
        self.path, self.watch, self.program = path, watch, None

    @property
    def room(self):
        return self.program is None

    def begin(self, program):
        self.program = program

    def wait(self, timeout=None):
        program, self.program = self.program, None
        what, told = attempt(program, self.path, perform, lambda done, total: self.watch(program, done))
        return Event(what, program, told)

    def close(self):
        pass


def shapes(jobs):
    """Methods and seeds of each program."""
    return [([job.method for job in each.jobs], each.jobs[0].seeds) for each in programs(jobs)]


def test_what_differs_in_seeds_and_floats_alone_shares_a_program(planned):
    assert shapes(planned()) == [(["plain", "near", "fast"], (0, 1))]
    others = """
wide = { agent = "td3_bc", fields = { hidden = [16], batch_size = 16 } }
large = { agent = "td3_bc", fields = { hidden = [8], batch_size = 32, alpha = 0.1 } }
larger = { agent = "td3_bc", fields = { hidden = [8], batch_size = 32, alpha = 5 } }
other = { agent = "td3", fields = { hidden = [8], batch_size = 16 } }
"""
    jobs = planned(SUITE + others)
    apart = [["plain", "near", "fast"], ["wide"], ["large", "larger"], ["other"]]
    assert [methods for methods, _ in shapes(jobs)] == apart
    # Two logs are two programs.
    assert [methods for methods, _ in shapes(planned(SUITE.replace("-v1", '-v1", "maze2d-medium-v1')))] == apart[:1] * 2


def test_a_number_that_is_left_to_the_agent_is_another_program(planned):
    text = SUITE.partition("[methods]")[0] + "[methods]\n"
    entropies = ("-1.0", "-2.0")
    text += "".join(f'sac{i} = {{ agent = "cql", fields = {{ target_entropy = {e} }} }}\n' for i, e in enumerate(entropies))
    assert [methods for methods, _ in shapes(planned(text + 'own = { agent = "cql" }\n'))] == [["sac0", "sac1"], ["own"]]


def test_lanes_say_how_many_cells_share_a_program_and_cells_keep_their_names(planned):
    whole = planned()
    cells = [cell for job in whole for cell in job.cells]
    for lanes, wanted in (
        (1, [([method], (seed,)) for method in ("plain", "near", "fast") for seed in (0, 1)]),
        (2, [([method], (0, 1)) for method in ("plain", "near", "fast")]),
        (3, [([method], (0, 1)) for method in ("plain", "near", "fast")]),  # a job's seeds stay together
        (4, [(["plain", "near"], (0, 1)), (["fast"], (0, 1))]),
    ):
        for jobs in (planned(lanes=lanes), planned(f"lanes = {lanes}\n{SUITE}", lanes=64)):  # the suite has the last word
            assert sorted(shapes(jobs)) == sorted(wanted)
            assert [cell for job in jobs for cell in job.cells] == cells
    odd = planned(f"lanes = 4\n{SUITE.replace('seeds = 2', 'seeds = 5')}")
    assert shapes(odd) == [(["plain"], (0, 1, 2, 3)), (["plain", "near", "fast"], (4,)),
                           (["near"], (0, 1, 2, 3)), (["fast"], (0, 1, 2, 3))]  # fmt: skip


def test_a_cpu_runs_each_cell_for_itself_and_a_gpu_all_together(planned, tmp_path, monkeypatch):
    assert len(programs(planned(lanes=Local(tmp_path).lanes))) == 6
    monkeypatch.setattr("jax.default_backend", lambda: "gpu")
    assert len(programs(planned(lanes=Local(tmp_path).lanes))) == 1


def test_only_seeds_are_lanes_where_nothing_is_learned_from_a_log(planned):
    text = 'kind = "online"\nseeds = 2\nsteps = 20_000\ntasks = ["hopper"]\n[methods]\n'
    text += 'a = { agent = "sac", fields = { actor_lr = 1e-3 } }\nb = { agent = "sac" }\n'
    assert shapes(planned(text)) == [(["a"], (0, 1)), (["b"], (0, 1))]


def test_settings_that_are_tuned_share_a_program():
    asked = tuning("td3_bc", ["hopper-medium-v2"], [{"alpha": a} for a in (1.0, 2.5, 5.0)], by="ope", steps=100, seeds=3)
    assert [program.lanes for program in programs(plan(asked))] == [9]


@pytest.mark.slow
def test_lanes_find_what_cells_find_alone(planned, tmp_path, monkeypatch):
    apart, together = Store(tmp_path / "apart"), Store(tmp_path / "together")
    told = lambda event: None  # noqa: E731
    run(planned(lanes=2), apart, told, Here(apart.path))
    jobs = planned()

    class Killed(BaseException):
        pass

    def interrupt(program, done):
        assert program.lanes == 6
        if done == 60:
            raise Killed

    with pytest.raises(Killed):
        run(jobs, together, told, Here(together.path, interrupt))
    assert together.undone(jobs) == jobs
    steps = []
    run(jobs, together, told, Here(together.path, lambda program, done: steps.append(done)))
    assert steps == [60]  # the half that was done is not done again
    assert together.undone(jobs) == together.undone(planned(lanes=1)) == []

    by = [("cell", "ascending"), ("step", "ascending")]
    for kind in ("results", "curves"):
        mine, theirs = (getattr(store, kind)().sort_by(by[: 1 + (kind == "curves")]) for store in (together, apart))
        assert mine.num_rows == theirs.num_rows
        for column in mine.column_names:
            if column in ("score", "raw", "spread"):
                np.testing.assert_allclose(mine[column].to_numpy(), theirs[column].to_numpy(), rtol=2e-3, atol=2e-3)
            elif column not in ("seconds", "versions", "job", "finished"):
                assert mine[column].equals(theirs[column]), column
    others = []
    for row in together.results().to_pylist():
        job = next(job for job in jobs if job.method == row["method"])
        assert json.loads(row["settings"]) == job.settings
        assert json.loads(row["versions"])["lanes"] == 6
        kept, alone = load(together.path / "runs" / row["job"]), load(apart.path / "runs" / job.name)
        assert kept.config["agent"]["fields"] == job.settings
        assert kept.seeds == [0, 1]
        np.testing.assert_allclose(kept.policies[row["seed"]](X), alone.policies[row["seed"]](X), atol=1e-3)
        others.append(kept.policy(X))
    assert np.abs(np.diff(others[::2], axis=0)).max((1, 2)).min() > 0.01  # settings make a difference far beyond that
    assert rendered(tables(read(tmp_path / "some.toml"), jobs, together)).count("maze2d-umaze-v1")
    page = _page(read(tmp_path / "some.toml"), jobs, together)
    assert page is not None
    runs = (together.path / "reports" / "some-maze2d-umaze-v1.html").read_text()
    assert all(job.name in runs for job in jobs)

    # Estimates are given to the settings whose policies they are of.
    def judge(folders, *_, **__):
        runs = [load(folder) for folder in folders for _ in range(2)]
        told = [{"name": run.path.name, "run": run.path.name} for run in runs]
        values = [run.config["agent"]["fields"]["alpha"] for run in runs]
        return Judged([], None, {"policies": told, "results": [{"value": values, "gain": [[v, v - 1, v + 1] for v in values]}]})

    monkeypatch.setattr("deadreckon.bench.tune.judge", judge)
    found = {row["cell"]: row for row in together.results().to_pylist()}
    assert _estimated(jobs, together, found, ["fqe"], TrialSettings()) == {
        job.method: [[v := job.settings["alpha"], v, v - 1, v + 1]] * 2 for job in jobs
    }

    # A longer one of as many lanes will take as long a step.
    longer = [dataclasses.replace(job, options=job.options | {"steps": 600}) for job in jobs]
    [program] = programs(longer)
    seconds = together.results()["seconds"][0].as_py()
    assert forecast([program], together) == {program.name: (pytest.approx(10 * seconds), True, True)}


def test_of_a_program_that_is_done_in_part_the_rest_is_run(planned, tmp_path):
    store, jobs = Store(tmp_path / "out"), planned()
    [done] = [job for job in planned(lanes=1) if (job.method, job.seeds) == ("near", (1,))]
    told = {"score": 1.0, "raw": 1.0, "steps": 60, "seconds": 1.0, "failure": "", "versions": "{}"}
    store.keep(done, JobResult([{"seed": 1} | told], []))
    rest = programs(store.undone(jobs))
    assert [([job.method for job in each.jobs], each.jobs[0].seeds) for each in rest] == [
        (["plain", "fast"], (0, 1)), (["near"], (0,)),
    ]  # fmt: skip
    assert len({each.name for each in rest} | {each.name for each in programs(jobs)}) == 3


@pytest.mark.slow
def test_a_setting_that_is_refused_fails_alone(planned, tmp_path, capsys):
    text = """
    seeds = 1
    steps = 4
    evaluations = 1
    episodes = 1
    logs = ["maze2d-umaze-v1"]
    rows = 600
    [methods]
    right = { agent = "kl_control", fields = { hidden = [8], batch_size = 16, behavior_steps = 2, target_entropy = 0.0 } }
    wrong = { agent = "kl_control", fields = { hidden = [8], batch_size = 16, behavior_steps = 2, target_entropy = -1.0 } }
    """
    store, jobs = Store(tmp_path / "out"), planned(text)
    assert len(programs(jobs)) == 1
    run(jobs, store, Lines(1), Here(store.path))
    assert [job.method for job in store.undone(jobs)] == ["wrong"]
    assert "leave out target_entropy" in store.failure(jobs[1], 0)["error"]
    assert "its settings continue one by one\n1 of 2: right on maze2d-umaze-v1, seed 0" in capsys.readouterr().out


def test_what_runs_and_how_many_wait_is_told_as_programs_begin(planned, capsys):
    packed = programs(planned())[0]
    one, two, three = (Program((job,)) for job in packed.jobs)
    lines, result = Lines(4), JobResult([{"seconds": 1.0}], [])
    for what, program, payload, waiting in [
        ("begun", packed, None, 3),
        ("progress", packed, (1, 2), None),
        ("split", packed, "no room", None),  # its three jobs go on one by one
        ("begun", one, None, 5),
        ("died", one, "code 1", None),  # and waits again
        ("begun", two, None, 5),
        ("elsewhere", two, None, None),
        ("begun", one, None, 4),
        ("begun", three, None, 3),
        ("failed", one, ("why", ""), None),
        ("done", three, [result], None),
        ("skipped", two, None, None),  # never begun
        ("begun", packed, None, 1),
    ]:
        lines(Event(what, program, payload))
        told = capsys.readouterr().out
        assert told.startswith("running: ") == (waiting is not None), what
        if waiting is not None:
            assert told == f"running: {program}; {waiting} waiting\n"


def test_a_program_that_fails_is_told_of_each_of_its_jobs(planned, tmp_path):
    store, jobs = Store(tmp_path / "out"), planned()
    lost = [dataclasses.replace(job, on="no-such-log", data="no-such-log") for job in jobs]
    lost = [dataclasses.replace(job, revisions=revisions_of(job)) for job in lost]
    events = []
    run(lost, store, events.append, Here(store.path))
    first, *others = events
    assert str(first.program) == "plain and 2 other settings of td3_bc on no-such-log, seeds 0 to 1"
    assert [(event.what, len(event.program.jobs)) for event in events] == [("split", 3), *[("failed", 1)] * 3]
    assert all("no-such-log" in store.failure(job, seed)["error"] for job in lost for seed in job.seeds)


def test_a_program_whose_run_another_command_does_is_left_to_it(planned, tmp_path):
    def work(program, folder, watch):
        raise BusyError("another command writes to this run")

    [program] = programs(planned())
    assert attempt(program, tmp_path, work, lambda done, total: None) == ("elsewhere", None)


def test_what_another_command_is_at_is_left_to_it(planned, tmp_path, capsys):
    store, jobs = Store(tmp_path / "out"), planned()
    [program] = programs(jobs)
    with alone(store.folder(program)):
        run(jobs, store, Lines(1), Here(store.path))
    assert "seeds 0 to 1: skipped, since another command is running it" in capsys.readouterr().out
    assert store.undone(jobs) == jobs
    assert store.failure(jobs[0], 0) is None

    settings = [{"alpha": 1.0}, {"alpha": 5.0}]
    asked = tuning("td3_bc", ["maze2d-umaze-v1"], settings, by="simulator", steps=100, seeds=3, rows=600)
    [program] = programs(plan(asked))
    choose = {"by": "simulator", "store": store, "executor": Here(store.path), "on_event": Lines(1)}
    with alone(store.folder(program)), pytest.raises(BusyError, match="2 of 2 jobs are being done by another command"):
        tune(asked, settings, **choose)


FROM_A_LOG = """
kind = "online"
seeds = 1
steps = 160
offline = 20
evaluations = 2
episodes = 1
tasks = ["maze2d-umaze"]
data = { maze2d-umaze = "maze2d-umaze-v1" }
rows = 600

[methods]
first = { agent = "td3_bc", fields = { hidden = [8], batch_size = 16 }, log = "first", acting = { copies = 4, block = 40 } }
"""


@pytest.mark.slow
def test_a_method_that_goes_on_from_a_log_is_told_what_it_began_with(planned, tmp_path):
    jobs, store = planned(FROM_A_LOG), Store(tmp_path / "bench")
    program = programs(jobs)[0]
    seen = []

    def stop(program, done):
        seen.append(done)
        if seen == [20, 80]:  # updates on the log, and half of those online
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(jobs, store, Lines(1), Here(store.path, stop))
    run(jobs, store, Lines(1), Here(store.path, stop))
    assert seen == [20, 80, 80, 160]  # the last chunk before the kill was not kept
    [row] = store.of(jobs).to_pylist()
    more = json.loads(row["more"])
    assert more["gain"] == pytest.approx(row["score"] - more["start"])
    assert more["lowest"] <= min(more["start"], row["score"])
    assert row["steps"] == 160
    assert store.curves()["step"].to_pylist() == [0, 80, 160]
    shown = tables(read(tmp_path / "some.toml"), jobs, store)
    assert [table.metric.column for table in shown] == ["score", "start", "gain", "lowest"]
    assert all(table.cells["first"]["maze2d-umaze"].sound for table in shown)
    offline = load(store.folder(program).with_name(f"{program.name}-offline"))
    assert (offline.config["steps"], offline.config["task"]) == (20, "maze2d-umaze")
