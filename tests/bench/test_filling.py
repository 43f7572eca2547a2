"""Filling a device in a limited time: the plan, what is chosen next, measured rates, one program of several logs."""

import dataclasses
import json
import os
import re
from itertools import pairwise
from pathlib import Path

import pytest

from deadreckon.bench.device import platforms_of, required, shared
from deadreckon.bench.executor import Event, attempt, run
from deadreckon.bench.filling import LANES, Filling, Load, jobs_of, missing, schedule, use
from deadreckon.bench.jobs import Job, Program, programs
from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import _shape, plan, plan_across, plan_all
from deadreckon.bench.rates import Rates, work
from deadreckon.bench.store import Store
from deadreckon.bench.suite import queue, read
from deadreckon.bench.work import perform
from deadreckon.cli import gpu
from deadreckon.cli.bench import bench
from deadreckon.errors import BusyError, UserError

SUITE = """
kind = "learn"
seeds = 2
steps = 40
evaluations = 2
episodes = 2
ledger = "ledger"
logs = ["maze2d-umaze-v1", "maze2d-medium-v1", "hopper-medium-v2"]
rows = 600

[methods]
plain = { agent = "td3_bc", fields = { hidden = [8], batch_size = 16 } }
near = { agent = "td3_bc", fields = { hidden = [8], batch_size = 16, alpha = 0.1 } }

[full]
seeds = 3
steps = 4_000_000
"""
EVIDENCE = Path(__file__).resolve().parents[2] / "evidence"
H100 = "NVIDIA H100 80GB HBM3"


@pytest.fixture
def suite(tmp_path):
    (path := tmp_path / "some.toml").write_text(SUITE)
    return path


def job(agent="td3_bc", seeds=(0,), steps=1000, **settings):
    whole = {"hidden": [256, 256], "batch_size": 256} | settings
    options = {"steps": steps, "every": steps // 2, "episodes": 1}
    return Job("learn", "method", agent, whole, "", "my.csv", "my.csv", options, seeds)


def load(name, updates, rate=10.0, ready=10.0, judging=20.0, evaluations=2):
    program = Program((dataclasses.replace(job(), on=name, data=name),))
    return Load(program, True, rate, True, updates, ready, judging, evaluations)


# ---- packing -------------------------------------------------------------------------------------------------------


def test_logs_of_one_shape_share_a_program_and_cells_keep_their_names(suite):
    alone, together = plan(read(suite)), plan_across([read(suite)])
    assert [each.cells for each in together] == [each.cells for each in alone]
    found = [sorted({one.on for one in each.jobs}) for each in programs(together)]
    assert found == [["maze2d-medium-v1", "maze2d-umaze-v1"], ["hopper-medium-v2"]]
    mazes, hopper = programs(together)
    assert mazes.lanes == 8
    assert str(mazes) == "plain and 1 other setting of td3_bc on 2 logs, seeds 0 to 1"
    assert str(hopper) == "plain and 1 other setting of td3_bc on hopper-medium-v2, seeds 0 to 1"
    assert mazes.name.startswith("td3_bc-2_logs-")


def test_other_suites_share_it_too_and_what_depends_on_more_of_a_log_does_not(suite, tmp_path):
    (other := tmp_path / "other.toml").write_text(SUITE.replace("rows = 600", "rows = 700"))
    assert [each.lanes for each in programs(plan_across([read(suite), read(other)]))] == [16, 8]
    assert [each.lanes for each in programs(plan_across([read(suite)], lanes=3))] == [2] * 6
    (same := tmp_path / "same.toml").write_text(SUITE)
    assert plan_across([read(suite), read(same)]) == plan_across([read(suite)])
    head = SUITE.partition("[methods]")[0]
    for name in ("algae_dice", "decision_transformer"):  # initial observations, the length of episodes
        (alone := tmp_path / "alone.toml").write_text(head + f'[methods]\nalone = {{ agent = "{name}" }}\n')
        assert [each.lanes for each in programs(plan_across([read(alone)]))] == [2, 2, 2], name


@pytest.mark.parametrize(("method", "lanes"), [
    ('agent = "mopo"', [2, 2]),  # a robot's own rule ends episodes in the model
    ('agent = "mopo", fields = { termination = "learned" }', [4]), ('agent = "td3_bc"', [4]),
])  # fmt: skip
def test_robots_of_one_shape_share_a_program_where_their_ends_have_no_part(method, lanes, tmp_path):
    head = re.sub(r"logs = .*", 'logs = ["halfcheetah-medium-v2", "walker2d-medium-v2"]', SUITE.partition("[methods]")[0])
    (path := tmp_path / "robots.toml").write_text(f"{head}[methods]\none = {{ {method} }}\n")
    assert [each.lanes for each in programs(plan_across([read(path)]))] == lanes


@pytest.mark.parametrize(("agent", "lanes"), [("cal_ql", [2, 2]), ("cql", [4])])
def test_settings_share_a_program_unless_their_batches_have_discounts_of_their_own(agent, lanes, tmp_path):
    head = re.sub(r"logs = .*", 'logs = ["hopper-medium-v2"]', SUITE.partition("[methods]")[0])
    methods = "".join(f'"{d}" = {{ agent = "{agent}", fields = {{ discount = {d} }} }}\n' for d in (0.99, 0.995))
    (path := tmp_path / "discounts.toml").write_text(f"{head}[methods]\n{methods}")
    assert [each.lanes for each in programs(plan_across([read(path)]))] == lanes


# ---- rates ---------------------------------------------------------------------------------------------------------


def test_rates_are_the_measured_ones_or_estimates_that_do_not_exceed_them():
    rates = Rates(H100)
    assert rates.rate(job(), 64) == (pytest.approx(54_116), True)
    assert rates.rate(job(), 16) == (pytest.approx(35_894), True)
    between = rates.rate(job(), 32)
    assert between.measured
    assert between.value == pytest.approx((35_894 * 54_116) ** 0.5)  # in the middle, in logarithms
    assert rates.rate(job(), 200).value == pytest.approx(54_116)  # more lanes than were measured: no faster
    assert rates.rate(job("bc", hidden=[64, 64]), 16) == (pytest.approx(35_894), False)  # less work, but no faster
    half = rates.rate(job(batch_size=512), 16)
    assert half == (pytest.approx(35_894 / 2), False)
    assert rates.rate(job("my:agent"), 16).value == min(rates.rate(job(name), 16).value for name in ("my:agent", "cql", "sac"))
    assert Rates("NVIDIA A100").rate(job(), 16) == (pytest.approx(35_894), False)
    wide, usual = (work("td3_bc", job(hidden=[width, width]).settings) for width in (512, 256))
    assert wide == pytest.approx(usual * (512**2 + 2 * 24 * 512) / (256**2 + 2 * 24 * 256))


def test_what_was_measured_here_is_kept_and_comes_first(tmp_path):
    path = tmp_path / "rates.json"
    rates = Rates(H100, path)
    rates.note(job("bc"), 16, 1000.0)
    rates.note(job("bc"), 16, 2000.0)  # the newer of the same
    rates.note(job("bc", hidden=[8]), 16, 9000.0)
    for known in (rates, Rates(H100, path)):
        assert known.rate(job("bc"), 16) == (2000.0, True)
        assert known.rate(job("bc"), 64) == (pytest.approx(2000.0 * 54_116 / 35_894), True)  # as lanes of TD3+BC grow
        assert known.rate(job("bc", hidden=[8]), 16) == (9000.0, True)
    assert not Rates("NVIDIA A100", path).rate(job("bc"), 16).measured
    assert len(json.loads(path.read_text())) == 2


# ---- the plan ------------------------------------------------------------------------------------------------------


def test_the_plan_is_what_one_gets_by_hand():
    # Two processes. Starts of 10 s are beside each other; the device trains one after the other; evaluations take 20 s of a
    # core, at least 10 of them after the last update.
    loads = [load("a", 1000), load("b", 300), load("c", 200), load("d", 5000), load("e", 100)]
    planned = schedule(loads, 200.0, 2)
    assert [(one.load.program.jobs[0].on, one.start, one.trains, one.trained, one.end) for one in planned] == [
        ("a", 0.0, 10.0, 110.0, 120.0),
        ("b", 0.0, 110.0, 140.0, 150.0),
        ("c", 120.0, 140.0, 160.0, 170.0),
        # Process 2 is free at 150, and the device at 160; d would take 500 s, and e comes before it.
        ("e", 150.0, 160.0, 170.0, 180.0),
        ("d", 170.0, 180.0, 200.0, None),  # begun with what is left
    ]
    made = use(planned, 200.0)
    assert made.rate == (1000 + 300 + 200 + 100 + 200) / 200
    assert made.training == (100 + 30 + 20 + 10 + 20) / 200
    assert made.lanes == 1.0
    assert schedule(loads, 5.0, 2) == []


def test_evaluations_that_take_longer_than_training_end_a_program_late():
    [one] = schedule([load("a", 100, judging=400.0)], 1000.0, 1)
    assert (one.trained, one.end) == (20.0, 410.0)
    assert schedule([load("a", 100, judging=400.0)], 405.0, 1)[0].end is None


def test_the_full_size_is_planned_where_it_fits_and_programs_do_not_depend_on_the_time(suite, tmp_path):
    small, large = [read(suite)], [read(suite, full=True)]
    store, rates = Store(tmp_path / "out"), Rates(H100)

    def found(seconds):
        return missing(small, large, store, rates, seconds)

    short, long = found(60.0), found(1e7)
    assert [each.full for each in short] == [False, False]
    assert [each.full for each in long] == [True, True]
    steps = [each.program.jobs[0].options["steps"] for each in (*short, *long)]
    assert steps == [40, 40, 4_000_000, 4_000_000]
    assert {job.name for each in short for job in each.program.jobs} == {each.name for each in plan_across(small)}
    assert {each.program.name for each in found(61.0)} == {each.program.name for each in short}
    # Updates that a checkpoint holds are not made again.
    kept = store.folder(short[0].program) / "checkpoints"
    kept.mkdir(parents=True)
    (kept / "0000000030.npz").touch()
    assert found(60.0)[0].updates == 10 * 8
    assert short[0].updates == 40 * 8


def test_what_is_done_at_full_size_is_not_run_at_the_other(suite, tmp_path, monkeypatch):
    small, large = [read(suite)], [read(suite, full=True)]
    undone = lambda self, jobs: [job for job in jobs if job.options["steps"] == 40]  # noqa: E731 - all of the full size is done
    monkeypatch.setattr(Store, "undone", undone)
    assert missing(small, large, Store(tmp_path / "out"), Rates(H100), 60.0) == []
    assert len(missing(small, [], Store(tmp_path / "out"), Rates(H100), 60.0)) == 2


def test_of_one_suite_programs_with_more_lanes_come_first(tmp_path):
    mazes = ', "maze2d-umaze-v1", "maze2d-medium-v1"'
    suites = []
    for name, logs in (("one", f'"hopper-medium-v2"{mazes}'), ("two", '"hopper-random-v2"')):
        logs = SUITE.replace('"maze2d-umaze-v1", "maze2d-medium-v1", "hopper-medium-v2"', logs).replace("[8]", f"[{len(logs)}]")
        (path := tmp_path / f"{name}.toml").write_text(logs)
        suites.append(read(path))
    loads = missing(suites, [], Store(tmp_path), Rates(H100), 60.0)
    assert [(load.program.jobs[0].suite, load.program.lanes) for load in loads] == [("one", 8), ("one", 4), ("two", 4)]


FIRST = ("gym", "medium", "extremes", "gym-more", "bear-constraint")


@pytest.mark.slow
@pytest.mark.parametrize("whole", [False, True], ids=["five suites with nothing done", "the queue with its ledger"])
def test_forty_minutes_of_an_h100_are_filled_with_evidence(whole, monkeypatch, tmp_path):
    monkeypatch.chdir(EVIDENCE.parent)
    small, large = (queue(EVIDENCE / "queue.toml", full=full) for full in (False, True))
    if not whole:
        small, large = ([suite for suite in suites if suite.name in FIRST] for suites in (small, large))
    store = store_of(small, tmp_path) if whole else Store(tmp_path)
    loads = missing(small, large, store, Rates(H100), 2400.0)
    planned = schedule(loads, 2400.0, 8)
    made = use(planned, 2400.0)
    assert made.rate >= 30_000
    assert made.training >= 0.85
    assert made.lanes >= (32 if whole else 25)
    # The same sums by another way.
    done = [one for one in planned if one.end is not None]
    assert done
    for one in done:
        each = one.load.program.jobs[0].options["steps"]
        assert one.trained - one.trains == pytest.approx(each * one.load.program.lanes / one.load.rate)
    assert all(one.end <= 2400.0 for one in done)
    turns = sorted((one.trains, one.trained) for one in planned)
    assert all(first[1] <= second[0] + 1e-6 for first, second in pairwise(turns))  # one at a time has the device
    cells = [cell for one in planned for job in one.load.program.jobs for cell in job.cells]
    assert len(set(cells)) == len(cells)
    # Cells are those that `bench --full` and `bench` without it would run.
    learned = [[suite for suite in suites if suite.kind == "learn"] for suites in (small, large)]
    assert set(cells) <= {cell for suites in learned for job in plan_all(suites, 1) for cell in job.cells}


@pytest.mark.slow
def test_programs_of_the_queue_have_as_many_lanes_as_there_are_cells_for(monkeypatch, tmp_path):
    """TD3+BC and methods of its size have 32 lanes and more wherever as many cells of one shape are left."""
    monkeypatch.chdir(EVIDENCE.parent)
    large = [suite for suite in queue(EVIDENCE / "queue.toml", full=True) if suite.kind == "learn"]
    found: dict[str, list[int]] = {}
    for program in programs(store_of(large, tmp_path).undone(plan_across(large, LANES))):
        job = program.jobs[0]
        if job.agent in ("bc", "td3", "td3_bc", "sac"):
            found.setdefault(_shape(job, across=True), []).append(program.lanes)
    assert max(max(lanes) for lanes in found.values()) == LANES
    assert [lanes for lanes in found.values() if sum(each < 32 for each in lanes) > 1] == []


# ---- while it runs -------------------------------------------------------------------------------------------------


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_what_is_begun_next_fits_into_what_is_left_by_rates_measured_so_far(tmp_path):
    clock, rates = Clock(), Rates(H100, tmp_path / "rates.json")
    filling = Filling(rates, Store(tmp_path), clock)
    sizes = (8, 10**6), (9, 10**7), (10, 10)
    first, second, short = (Program((job("bc", (0,), steps, hidden=[width]),)) for width, steps in sizes)
    waiting = [second, first, short]
    assert filling(waiting, 400.0) is first  # the second would take more than the time by the estimate
    waiting.remove(first)
    clock.now = 50.0
    filling.hear(Event("progress", first, (1000, 10**6)))
    assert not rates.rate(first.jobs[0], 1).measured  # the first chunk tells of compiling
    clock.now = 52.0
    filling.hear(Event("progress", first, (1200, 10**6)))
    clock.now = 54.0
    filling.hear(Event("progress", first, (1400, 10**6)))
    clock.now = 55.0
    filling.hear(Event("progress", first, (1500, 10**6)))
    assert rates.rate(first.jobs[0], 1) == (100.0, True)
    # By that it takes 9,985 s more, so the device is not free before the end and nothing is begun.
    assert filling(waiting, 345.0) is None
    filling.hear(Event("done", first, []))
    assert filling(waiting, 345.0) is short
    assert filling([second], 345.0) is second  # begun, and gone on with another time
    assert filling([second], 80.0) is None  # it would train for less time than it is compiled, 45 s
    assert filling.training == 5.0
    assert filling.updates == 1500


def test_programs_that_train_side_by_side_share_the_time(tmp_path):
    clock, rates = Clock(), Rates(H100)
    filling = Filling(rates, Store(tmp_path), clock)
    both = [Program((job("bc", (0,), 10_000, hidden=[width]),)) for width in (8, 9)]
    for program in both:
        assert filling([program], 1000.0) is program
        filling.hear(Event("progress", program, (0, 10_000)))
    for clock.now in (5.0, 10.0):
        for program in both:
            filling.hear(Event("progress", program, (int(clock.now) * 100, 10_000)))
    assert [rates.rate(program.jobs[0], 1).value for program in both] == pytest.approx([200.0, 200.0])  # alone twice as fast


# ---- the device ----------------------------------------------------------------------------------------------------


@pytest.fixture
def control(tmp_path, monkeypatch):
    """A control program of the service that notes what it is told; gives what it was told so far."""
    (folder := tmp_path / "bin").mkdir()
    script = folder / "nvidia-cuda-mps-control"
    told, there = tmp_path / "told", tmp_path / "runs"
    script.write_text(
        "#!/bin/sh\n"
        f'if [ "$1" = -d ]; then echo start >> {told}; [ -e {tmp_path}/broken ] && exit 1; touch {there}; exit 0; fi\n'
        f'read what; echo "$what" >> {told}; [ -e {there} ] || exit 1; [ "$what" = quit ] && rm {there}; exit 0\n'
    )
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/bin:/usr/bin")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return lambda: told.read_text().split() if told.exists() else []


def test_the_service_is_started_and_stopped_only_where_it_does_not_run(control, tmp_path):
    before = dict(os.environ)
    with shared() as how:
        assert "stopped at the end" in how
        assert os.environ["CUDA_MPS_PIPE_DIRECTORY"].startswith(str(tmp_path))
        assert os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] == "false"
    assert control()[-2:] == ["start", "quit"]
    assert dict(os.environ) == before
    (tmp_path / "runs").touch()
    with shared() as how:
        assert "runs already" in how
        assert "CUDA_MPS_PIPE_DIRECTORY" not in os.environ
    assert control()[-2:] == ["quit", "get_server_list"]
    assert (tmp_path / "runs").exists()


def test_without_the_service_processes_take_turns(control, tmp_path, monkeypatch):
    (tmp_path / "broken").touch()
    with shared() as how:
        assert "does not start" in how
        assert "CUDA_MPS_PIPE_DIRECTORY" not in os.environ
    assert "quit" not in control()
    monkeypatch.setenv("PATH", "/nowhere")
    with shared() as how:
        assert "there is no nvidia-cuda-mps-control" in how


def test_a_device_that_is_filled_is_left_to_the_command_that_does_it(control, tmp_path, monkeypatch):
    with shared():
        with pytest.raises(BusyError, match="this GPU"), shared():
            pass
        assert "quit" not in control()
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1")  # another one
        with shared() as how:
            assert "service" in how


@pytest.mark.parametrize(
    ("backend", "version", "platforms"),
    [
        ("gpu", "PJRT C API\ncuda 13000", "cuda,cpu"), ("gpu", "rocm 60300", "rocm,cpu"), ("tpu", "libtpu", "tpu,cpu"),
        ("cpu", "cpu", "cpu"), ("gpu", "another", ""),
    ],
)  # fmt: skip
def test_processes_are_told_the_accelerator_that_they_may_not_do_without(backend, version, platforms):
    assert platforms_of(backend, version) == platforms


def test_while_the_device_is_required_processes_are_told_so(monkeypatch):
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    with required():
        assert os.environ["JAX_PLATFORMS"] == "cpu"
    assert "JAX_PLATFORMS" not in os.environ
    monkeypatch.setenv("JAX_PLATFORMS", "tpu")
    with required():
        assert os.environ["JAX_PLATFORMS"] == "tpu"


# ---- the command ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--gpu"], "set it with --for"),
        (["--gpu", "--for", "40m", "--full"], "--full does not go with --gpu"),
        (["--gpu", "--for", "40m", "--idle"], "--idle does not go with --gpu"),
        (["--gpu", "--for", "40m", "--executor", "ray"], "--executor does not go with --gpu"),
        (["--gpu", "--for", "40m"], "needs an accelerator, and JAX sees none"),
    ],
)
def test_what_does_not_go_together_is_refused(suite, options, words):
    with pytest.raises(UserError, match=words):
        bench([str(suite), *options])


def test_a_dry_run_prints_the_plan_without_a_device(suite, tmp_path, capsys):
    bench([str(suite), "--out", str(tmp_path / "out"), "--gpu", "--for", "10m", "--dry-run"])
    told = capsys.readouterr().out
    assert "some: 10 min of one H100, which this machine does not have, and 16 cores, 8 processes" in told
    assert "plain and 1 other setting of td3_bc on 2 logs, seeds 0 to 1, CPU size, 8 lanes: trains" in told
    assert "12 cells would be done; 0 that train on logs would be left" in told
    assert not (tmp_path / "out").exists()


class Here:
    """An executor in this process; `watch` is called as work goes on, and may end it as a kill does."""

    workers, lanes = 1, None

    def __init__(self, path, watch):
        self.path, self.watch, self.told = path, watch, []
        self.program = None

    @property
    def room(self):
        return self.program is None and not self.told

    def begin(self, program):
        self.program = program

    def wait(self, timeout=None):
        if self.program is not None:
            program, self.program = self.program, None

            def watched(done, total):
                self.told.append(Event("progress", program, (done, total)))
                self.watch(done)

            what, found = attempt(program, self.path, perform, watched)
            self.told.append(Event(what, program, found))
        return self.told.pop(0)

    def close(self):
        pass


@pytest.mark.slow
def test_a_device_is_filled_and_gone_on_with_after_a_kill(tmp_path, monkeypatch, capsys):
    (path := tmp_path / "some.toml").write_text(SUITE.replace(', "hopper-medium-v2"', ""))

    def killed(done):
        if done >= 20:
            raise BrokenPipeError

    watches = [killed, lambda done: None]
    monkeypatch.setattr(gpu, "device_kind", lambda: H100)
    monkeypatch.setattr(gpu, "_executor", lambda path, workers: Here(path, watches.pop(0)))
    arguments = [str(path), "--out", str(tmp_path / "out"), "--gpu", "--for", "10m"]
    with pytest.raises(BrokenPipeError):
        bench(arguments)
    [small] = queue(path)
    store = store_of([small], tmp_path / "out")
    assert store.results().num_rows == 0
    bench(arguments)
    assert "2 logs" in capsys.readouterr().out
    # The cells are those of a run on a processor, which has nothing left to do.
    assert not store.undone(plan_all([small], 1))
    rows = store.of(plan(small)).to_pylist()
    assert {(row["on"], row["method"], row["seed"]) for row in rows} == {
        (on, method, seed) for on in small.on for method in ("plain", "near") for seed in (0, 1)
    }
    for row in rows:
        assert json.loads(row["versions"])["lanes"] == 8
        assert (tmp_path / "out" / "runs" / row["job"] / "run.json").exists()
    # And a run alone gives what its lanes gave.
    own = Store(tmp_path / "alone")
    one = [each for each in plan(small, 1) if each.method == "near"][-1:]
    run(one, own, lambda event: None, Here(tmp_path / "alone", lambda done: None))
    [alone] = own.of(one).to_pylist()
    [beside] = [row for row in rows if row["cell"] == alone["cell"]]
    assert beside["score"] == pytest.approx(alone["score"], abs=0.5)
    assert beside["log"] == alone["log"]


def test_programs_of_two_plans_are_not_mixed_up(suite, tmp_path):
    loads = missing([read(suite)], [read(suite, full=True)], Store(tmp_path), Rates(H100), 2000.0)
    assert [each.name for each in programs(jobs_of(loads))] == [load.program.name for load in loads]
