"""What of several suites an accelerator does in a limited time: a plan from rates, made anew whenever a process is free.

The device is one thing that programs use in turn, as far as the plan goes: programs that train side by side share its time,
and nothing is gained by that. What else a program takes goes on beside others: its start and compilation, and its evaluations,
which keep one core. So with several processes the next program is compiled, and the last one judged, while another one trains.
"""

import dataclasses
import heapq
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from deadreckon.bench.executor import Event
from deadreckon.bench.jobs import Job, Program, programs
from deadreckon.bench.plan import plan_across
from deadreckon.bench.rates import Rates
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.training.checkpoint import checkpoints

# Of a program: with more the device would make some more updates a second, but one core evaluates all of their policies, which
# takes 40 minutes for 64 lanes at full size (ten evaluations of 100 episodes).
LANES = 40
WARM_UP = 3.0  # seconds of the device after which a program's rate counts as measured


@dataclass(frozen=True)
class Load:
    """A program, and what it takes.

    Attributes:
        program: the program.
        full: whether it is of the full size of its suite.
        rate: updates of a seed per second, all lanes together, with the device to itself.
        measured: whether that was measured on such a device, else it is an estimate.
        updates: of a seed that are left, all lanes together.
        ready: seconds before its first update.
        judging: seconds of one core for all its evaluations.
        evaluations: how many these are.
    """

    program: Program
    full: bool
    rate: float
    measured: bool
    updates: int
    ready: float
    judging: float
    evaluations: int

    @property
    def training(self) -> float:
        """Seconds that it needs the device for itself."""
        return self.updates / self.rate

    def trained(self, start: float, device: float) -> float:
        """When its last update is done, where its process starts at `start` and the device is free from `device` on."""
        return max(start + self.ready, device) + self.training

    def end(self, start: float, trained: float) -> float:
        """When its last evaluation is done: all are made in turn, and the last one begins after its last update."""
        return max(trained + self.judging / self.evaluations, start + self.ready + self.judging)


class Planned(NamedTuple):
    """When a program is expected to do what, in seconds from the beginning; `end` is None where it is begun and not ended."""

    load: Load
    start: float
    trains: float
    trained: float
    end: float | None


def load_of(program: Program, full: bool, rates: Rates, store: Store) -> Load:
    """What a program takes, less what its checkpoints hold."""
    job = program.jobs[0]
    rate, measured = rates.rate(job, program.lanes)
    kept = checkpoints(store.folder(program) / "checkpoints")
    left = job.options["steps"] - (kept[-1][0] if kept else 0)
    judging = sum(rates.judging(each, len(each.seeds)) for each in program.jobs)
    evaluations = -(-job.options["steps"] // job.options["every"])
    return Load(program, full, rate, measured, left * program.lanes, rates.ready, judging, evaluations)


def missing(small: Sequence[Suite], large: Sequence[Suite], store: Store, rates: Rates, seconds: float) -> list[Load]:
    """What is not done yet, in the order of the suites, of one suite the programs with more lanes first, as these make more
    updates a second: at full size where that can be done in the time, else at the other.

    Programs do not depend on the time, so that half-done ones are found by a command that has another.

    Args:
        small: suites at the size that they have without `full`; those of other kinds than `learn` are passed over.
        large: the same at full size, those that have one.
        store: where results lie.
        rates: of the device.
        seconds: that there are.
    """
    order = {suite.name: number for number, suite in enumerate(small)}
    sizes = [(True, large), (False, small)]
    loads, full = [], set[tuple[str, str, str]]()
    for whole, suites in sizes:
        jobs = plan_across([suite for suite in suites if suite.kind == "learn"], LANES)
        left = store.undone(jobs)
        if whole:  # what is done at full size needs no other
            full |= {(job.suite, job.method, job.on) for job in jobs} - {(job.suite, job.method, job.on) for job in left}
        for program in programs(left):
            load = load_of(program, whole, rates, store)
            names = {(job.suite, job.method, job.on) for job in program.jobs}
            if whole and load.end(0.0, load.trained(0.0, 0.0)) > seconds:
                continue
            if whole:
                full |= names
            elif names <= full:
                continue
            loads.append(load)
    return sorted(loads, key=lambda load: (min(order[job.suite] for job in load.program.jobs), -load.program.lanes))


def schedule(loads: Iterable[Load], seconds: float, workers: int) -> list[Planned]:
    """What is done in the time: each program in turn by the process that is free first, unless it would not end in time; then
    what can be begun with the rest of the device's time.

    Args:
        loads: in the order of worth.
        seconds: that there are.
        workers: processes.
    """
    free, device = [0.0] * workers, 0.0
    out, rest = [], []
    for load in loads:
        start = free[0]
        trained = load.trained(start, device)
        if (end := load.end(start, trained)) > seconds:
            rest.append(load)
            continue
        heapq.heapreplace(free, end)
        out.append(Planned(load, start, trained - load.training, trained, end))
        device = trained
    for load in rest:
        start = free[0]
        begin = load.trained(start, device) - load.training
        if begin + load.ready <= seconds:  # it trains for as long as it is compiled, at least
            heapq.heapreplace(free, seconds)
            device = min(begin + load.training, seconds)
            out.append(Planned(load, start, begin, device, None))
    return out


class Use(NamedTuple):
    """What a plan makes of the time.

    Attributes:
        rate: updates of a seed per second, in the mean over the whole time.
        training: share of the time in which the device trains.
        lanes: in the mean over the time in which it trains.
    """

    rate: float
    training: float
    lanes: float


def use(planned: Sequence[Planned], seconds: float) -> Use:
    """The use that a plan makes of the device."""
    busy = [(each.trained - each.trains, each.load) for each in planned]
    training = sum(took for took, _ in busy)
    updates = sum(took * load.rate for took, load in busy)
    lanes = sum(took * load.program.lanes for took, load in busy) / training if training else 0.0
    return Use(updates / seconds, training / seconds, lanes)


@dataclass
class _Seen:
    """A program that runs: updates that are left, and, since its first chunk was done, updates and its part of the device's
    time."""

    load: Load
    left: int
    first: int | None = None
    last: int = 0
    share: float = 0.0

    @property
    def trains(self) -> bool:
        """Whether it is compiled and not at its end."""
        return self.first is not None and self.left > 0


class Filling:
    """Chooses what is begun next, see `executor.run`, and measures rates by what programs tell of their progress.

    Args:
        rates: of the device; what is measured is noted there.
        store: where results lie.
        clock: seconds.
    """

    def __init__(self, rates: Rates, store: Store, clock: Callable[[], float] = time.monotonic):
        self.rates, self.store, self.clock = rates, store, clock
        self.running: dict[str, _Seen] = {}
        self.looked = clock()
        self.updates = 0  # of a seed, since the beginning
        self.training = 0.0  # seconds in which at least one program trained

    def __call__(self, waiting: Sequence[Program], left: float | None) -> Program | None:
        """The first program that ends in time by what is known now; else the first, if the device is free before the end."""
        assert left is not None  # the time is what is filled
        busy = sum(seen.left / seen.load.rate for seen in self.running.values())
        loads = [load_of(program, False, self.rates, self.store) for program in waiting]
        fitting = [load for load in loads if load.end(0.0, load.trained(0.0, busy)) <= left]
        begun = [load for load in loads if max(load.ready, busy) + load.ready <= left]
        for load in (fitting or begun)[:1]:
            self.running[load.program.name] = _Seen(load, load.updates)
            return load.program
        return None

    def hear(self, event: Event) -> None:
        """Takes note of what happens to a program."""
        self._pass_time()
        seen = self.running.get(event.program.name)
        if seen is None or event.what == "begun":
            return
        if event.what != "progress":
            del self.running[event.program.name]
            self._measure(seen)
            return
        done, total = event.payload
        lanes = event.program.lanes
        self.updates += max(seen.left - (total - done) * lanes, 0)
        seen.left, seen.last = (total - done) * lanes, done
        if seen.first is None:  # what it took until now was mostly its compilation
            seen.first = done
        elif seen.share >= WARM_UP and not seen.load.measured:
            self._measure(seen)

    def _pass_time(self) -> None:
        """Gives programs that train equal parts of the time since the last look."""
        now, training = self.clock(), [seen for seen in self.running.values() if seen.trains]
        for seen in training:
            seen.share += (now - self.looked) / len(training)
        self.training += now - self.looked if training else 0.0
        self.looked = now

    def _measure(self, seen: _Seen) -> None:
        """Notes a rate of a program that has trained for long enough."""
        if seen.first is None or seen.share < WARM_UP or seen.last == seen.first:
            return
        program = seen.load.program
        rate = (seen.last - seen.first) * program.lanes / seen.share
        self.rates.note(program.jobs[0], program.lanes, rate)
        seen.load = dataclasses.replace(seen.load, rate=rate, measured=True)


def jobs_of(loads: Iterable[Load]) -> list[Job]:
    """The jobs of these programs, as one plan."""
    return [dataclasses.replace(job, program=number) for number, load in enumerate(loads) for job in load.program.jobs]
