"""The work of `recommend` in a separate process: pilots, training, evaluation and the check in a simulator.

A program that is being compiled cannot be interrupted from within its process, so `recommend` ends this process when its time
is over. Results are therefore reported at once, as lines of JSON on standard output, and files are complete or absent.

    python -m deadreckon.runs.attempt      reads its task, one JSON line, from standard input, and ends when that is closed
"""

import contextlib
import dataclasses
import json
import os
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.batch import TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.history import stacked
from deadreckon.data.info import warnings_for
from deadreckon.data.leaks import leaks
from deadreckon.data.split import Holdout, clusters, units_in_words
from deadreckon.errors import UserError
from deadreckon.ope.basis import UNITS
from deadreckon.ope.behavior_model import PROPENSITIES
from deadreckon.ope.costs import limits_of
from deadreckon.ope.features import Features, Table
from deadreckon.ope.fqe import FQE
from deadreckon.ope.linear import TAUGHT, LinearFQE
from deadreckon.ope.settings import EvidenceSettings
from deadreckon.runs import offline
from deadreckon.runs.callback import StopTraining
from deadreckon.runs.candidates import CONTINUOUS, DISCRETE, Candidate, agent_of, units
from deadreckon.runs.decision_record import ESTIMATES, write_results
from deadreckon.runs.durations import in_words
from deadreckon.runs.holdout import divided, of_share, too_few, usual
from deadreckon.runs.run import Run
from deadreckon.runs.settings import JudgeSettings, RecommendSettings
from deadreckon.runs.together import judge_of
from deadreckon.runs.train import train
from deadreckon.stats.interval import decimals, fixed
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Chunk, Fit

LARGE, SMALL = (256, 256), (64, 64)  # widths of hidden layers
DEARER = 10.0  # rough time of an update of another candidate, as a multiple of one of the first, behaviour cloning
MOST = 100_000  # most updates of a candidate
WORTH = 10_000  # updates that each should have before another candidate is tried
ENOUGH = 3  # candidates that should be tried, if necessary with small networks
FEWEST = 200  # fewest updates with which a candidate is evaluated
TRIED, LONGEST = 20, 1.0  # updates between two time checks of a pilot, and seconds of updates after which it ends
PILOTS, SECOND = 0.2, 0.5  # shares of the time by which a further pilot must end; by which that of the second candidate begins
SPARING = 400.0  # seconds of budget below which large networks are not tried, because their compilation takes too long
LOOKS = 2.0  # approximate seconds between two time checks
SAFETY = 0.85  # share of the time that is planned, because the speed of machines varies
LATE = 1.5  # largest time of the evaluation that is planned for, as a multiple of the expected time
LEAST = 0.3  # least share of the time after the pilots that is for training, whatever time the evaluation needs
EPISODES, FEW = 20, 5  # most episodes in the simulator, if there is one, and fewest for a check
BLOCK = 1024  # rows on which the time of linear critics is measured
FEWEST_FITS, MOST_FITS = 1_000, 20_000  # updates of FQE, if model-based estimates decide
DESCRIBED = 2_000_000  # most rows of a log that is described, which takes a second or two
FAULT = "fault.txt"  # file with the traceback of an unexpected error
MEMBERS = 5  # critics per policy in FQE, whose spread gives the interval


@dataclass(frozen=True)
class Job:
    """The input of an attempt.

    Attributes:
        data: a log's name or file.
        out: folder of the runs and estimates.
        budget: in seconds, as it was given.
        began, end: wall-clock times (`time.time`); at `end` everything must be written.
        settings: of `recommend`.
    """

    data: str
    out: str
    budget: float
    began: float
    end: float
    settings: RecommendSettings = field(default_factory=RecommendSettings)

    def as_json(self) -> dict[str, Any]:
        """As JSON values; NumPy scalars become plain numbers.

        Raises:
            UserError: a setting is an object that no file can hold.
        """
        try:
            return json.loads(json.dumps(dataclasses.asdict(self), default=_number))
        except TypeError as error:
            raise UserError(f"settings of recommend must be numbers, texts and lists of these: {error}") from error

    @classmethod
    def of_json(cls, values: dict[str, Any]) -> Self:
        """The inverse of `as_json`."""
        settings = dict(values["settings"])
        if isinstance(settings["holdout"], dict):
            settings["holdout"] = Holdout(**settings["holdout"])
        fields: dict[str, Any] = values | {"settings": RecommendSettings(**settings)}
        return cls(**fields)


@dataclass(frozen=True)
class Pilot:
    """The speed of training a candidate.

    Attributes:
        start: seconds until its first updates were done, mostly compile time.
        rate: updates per second after that.
    """

    start: float
    rate: float


class Attempt:
    """Trains and evaluates candidates on a log in a given time; each result is passed to `send` at once."""

    def __init__(self, job: Job, send: Callable[[str, Any], None]):
        self.job, self.settings, self.send = job, job.settings, send
        self.out = Path(job.out)
        self.told: list[dict[str, Any]] = []  # of each candidate, as sent to `recommend`
        self.units: dict[str, Any] = {}  # settings of all candidates that scale observations and rewards

    def left(self) -> float:
        """Seconds until everything must be written."""
        return self.job.end - time.time()

    def run(self) -> None:
        """All stages, from reading the log to the check in a simulator."""
        log, judge_in, holdout = self._log()
        learning = stacked(divided(log, holdout, None, None).learning, self.settings.history)  # the rest is held out
        self.units = units(learning)
        if told := _changed(self.units):
            self.send("line", told)
        self._stage("pilots")
        candidates, hidden, pilots = self._pilots(learning)
        if not candidates:
            raise Unfinished("all candidates diverged (NaN or Inf) in their pilots")
        judging = self._judging(log, learning, len(candidates), hidden, pilots)
        runs = self._learn(candidates, hidden, pilots, judging, log, holdout)
        if not runs:
            if any(told["state"] == "not begun" for told in self.told):
                raise self._short("the candidates that were trained diverged (NaN or Inf), the others were not started")
            raise Unfinished("all candidates diverged (NaN or Inf) in training")
        judged = self._judge(runs, log, hidden, pilots, judging)
        self._check(runs, judge_in, judged)

    # ---- the log ------------------------------------------------------------------------------------------------------

    def _log(self) -> tuple[Dataset, Task | None, Holdout]:
        self._stage("reading the log")
        log = catalogue.load(self.job.data, **(self.settings.columns or {}))
        limits_of(self.settings.cost_limit, log)
        judge_in = judge_of(log, self.settings.task)
        log = log.with_action_space(log.action_space if judge_in is None else judge_in.action_space)
        if len(log.spec.observation_shape) != 1:
            seen = f"{log.name} has shape {log.spec.observation_shape}"
            raise UserError(f"recommend needs flat observations, but {seen}; use train and ope")
        if log.successors is not None:  # the rules for decisions need ratios of episodes
            raise UserError(f"{log.name}: its rows do not follow each other, which recommend needs; use train and ope")
        given = self.settings.holdout
        holdout = usual(log) if given is None else given if isinstance(given, Holdout) else of_share(log, given)
        parts = holdout.parts(log)  # an impossible holdout is refused before training
        if few := too_few(log, holdout):
            raise UserError(f"{few}, and a card rests on them; hold out by other values, or record more")
        manner = f"{len(log):,} rows, {log.episodes:,} episodes"
        self.send("state", {"log": log.name, "rows": len(log), "episodes": log.episodes})
        by = {"random": "at random", "time": "the latest"}.get(holdout.by, f"by {holdout.by}")
        # Whole clusters seldom give the exact share.
        share = f"{len(parts.held):,} of them ({100 * len(parts.held) / log.episodes:.0f} %)"
        self.send("line", f"{log.name}: {manner}; {share} are held out for the card, {by}")
        if (count := len(np.unique(clusters(log, holdout.by)[parts.held]))) < UNITS:
            told = f"only {count} {units_in_words(log, holdout.by)} are held out, and no policy is recommended on fewer than"
            every = len(np.unique(clusters(log, holdout.by)))
            do = "hold out a larger share (--holdout), or record more"
            if every < UNITS:  # whatever is held out
                do = f"the log has {every}; without --group the card would be for these alone, and not for others"
            self.send("line", f"{told} {UNITS}: {do}")
        self._warn(log)
        return log, judge_in, holdout

    def _warn(self, log: Dataset) -> None:
        """Reports warnings of `data info`: suspected leaks on the card, as warnings, all others as lines."""
        self.send("state", {"leaks": leaks(log)})
        short = len(log) <= DESCRIBED
        for line in warnings_for(log) if short else log.warnings:
            self.send("line", f"! {line}")
        if not short:
            self.send("line", "! the log is long; `deadreckon data info` checks its rewards, observations and episodes too")

    # ---- pilots -------------------------------------------------------------------------------------------------------

    def _pilots(self, log: Dataset) -> tuple[list[Candidate], tuple[int, ...], list[Pilot]]:
        """The candidates, the widths of their networks, and their speeds, by the part of the log for training."""
        whole, known = self.left(), DISCRETE if log.spec.discrete else CONTINUOUS
        if self.settings.accept_model_based:  # then deterministic candidates come next to behaviour cloning
            known = tuple(sorted(known, key=lambda each: (each.name != "bc", not each.deterministic)))
        spent = lambda: (whole - self.left()) / max(whole, 1e-9)  # noqa: E731
        candidates: list[Candidate] = []
        pilots: list[Pilot] = []
        hidden, last = LARGE if whole > SPARING else SMALL, 0.0
        for candidate in known:
            # A card for behaviour cloning alone would be of little use, so there is a second candidate if at all possible.
            if (len(candidates) > 1 and spent() + last > PILOTS) or (len(candidates) == 1 and spent() > SECOND):
                break
            begun = self.left()
            found = self._pilot(candidate, hidden, log)
            if found and not candidates and hidden == LARGE:
                rates = [found.rate, *[found.rate / DEARER] * (ENOUGH - 1)]
                if self._steps(0.5 * self.left(), rates) < WORTH:
                    hidden, found = SMALL, self._pilot(candidate, SMALL, log)
            last = (begun - self.left()) / max(whole, 1e-9)
            if found is None:
                self.send("line", f"pilot: {candidate.name} is left out, because it diverges (NaN or Inf) on this log")
                continue
            rates = [each.rate for each in (*pilots, found)]
            if len(candidates) >= ENOUGH and self._steps(0.5 * self.left(), rates) < WORTH:
                break  # more updates of the earlier candidates are more useful
            candidates.append(candidate)
            pilots.append(found)
            self.send("line", f"pilot: {candidate.name}, {found.rate:,.0f} updates per second with layers of {hidden[0]} units")
        self.told = [
            {"name": each.name, "agent": each.agent, "why": each.why, "deterministic": each.deterministic, "updates": 0,
             "planned": 0, "state": "not begun"}
            for each in candidates
        ]  # fmt: skip
        self._tell()
        return candidates, hidden, pilots

    def _pilot(self, candidate: Candidate, hidden: tuple[int, ...], log: Dataset) -> Pilot | None:
        """The speed of the first updates of a candidate; None if it diverges. Training then uses the compiled program again."""
        self.send("watch", [f"pilot of {candidate.name}", 0, 1])
        begun = time.perf_counter()
        agent = self._agent(candidate, hidden).resolve(log.spec, MOST)
        fit = Fit([agent], TransitionSource(log, agent.needs(log.spec)), [self.settings.seed], MOST, chunk=TRIED)
        first: float | None = None
        rate = 1.0
        for progress in fit.chunks():
            now = time.perf_counter()
            if first is None:
                first = now
                continue
            rate = (progress.step - TRIED) / max(now - first, 1e-9)
            if now - first > LONGEST:
                fit.steps = progress.step  # which ends it
        return None if any(fit.failures) or first is None else Pilot(first - begun, rate)

    def _agent(self, candidate: Candidate, hidden: tuple[int, ...]) -> Agent:
        return agent_of(candidate, hidden=hidden, discount=self.settings.discount, **self.units)

    def _steps(self, seconds: float, rates: Sequence[float]) -> int:
        """Number of updates of each candidate that fit into so many seconds, at these numbers of updates per second."""
        return int(SAFETY * seconds / sum(1.0 / rate for rate in rates))

    def _judging(self, log: Dataset, learning: Dataset, count: int, hidden: tuple[int, ...], pilots: list[Pilot]) -> float:
        """Expected seconds of the evaluation: compilation, propensity networks, and sums of features, measured here."""
        start, rate = max(each.start for each in pilots), pilots[0].rate
        wide = (hidden[0] / PROPENSITIES.hidden[0]) ** 1.5  # propensities have small networks, one per fold
        networks = PROPENSITIES.steps * 5 / (rate * wide)
        whole = stacked(log, self.settings.history)
        known = whole if log.spec.discrete else learning
        features = Features(known, LinearFQE().fourier_features, self.settings.seed, Table.of(known))
        rows = np.arange(min(BLOCK, len(learning)))
        seen, size = np.asarray(learning.observations[rows]), learning.spec.action_size
        shape = (len(rows), 1, size) if learning.spec.discrete else (len(rows), 1, LinearFQE().samples, size)
        begun = time.perf_counter()
        phi = features.taken(seen, np.asarray(learning.actions[rows]))
        _ = phi.T @ features.expected(seen, np.full(shape, 1.0 / size, np.float32))[:, 0]
        row = (time.perf_counter() - begun) / len(rows)
        held = len(log) - len(learning)
        sums = row * (count + 1) * (min(len(learning), TAUGHT) + 3 * held)
        return 2.0 * start + networks + sums + 3.0

    # ---- training -----------------------------------------------------------------------------------------------------

    def _learn(
        self, candidates: list[Candidate], hidden: tuple[int, ...], pilots: list[Pilot], judging: float, log: Dataset,
        holdout: Holdout,
    ) -> list[Run]:  # fmt: skip
        left = self.left()
        time_for = max(left - LATE * judging, LEAST * left)
        begin = 0.3 * sum(each.start for each in pilots)  # for folders, and for programs that are compiled again
        rates = [each.rate for each in pilots]
        steps = min(self._steps(max(time_for - begin, 0.0), rates), MOST)
        least = min(max(steps, FEWEST), 1_000)
        spent = time.time() - self.job.began
        needs = lambda updates: (spent + begin + updates * sum(1 / rate for rate in rates) + LATE * judging) / SAFETY  # noqa: E731
        self.send("state", {"need": needs(least), "need for worth": needs(WORTH)})
        if steps < FEWEST:
            # A candidate after hardly any training would be evaluated as no better, which differs from not knowing.
            text = f"{steps} updates of each candidate would fit, and at least {FEWEST} are needed"
            raise self._short(f"{text}; reading, compiling and pilots took {spent:.0f} s")
        for told in self.told:
            told["planned"] = steps
        self._tell()
        self.send("line", self._plan(hidden, steps, rates, time_for, judging))
        self._stage("training")
        end, runs = time.time() + time_for, []
        for i, (candidate, told) in enumerate(zip(candidates, self.told)):
            now = time.time()
            if i and now >= end:
                self.send("line", f"{candidate.name} is not started: the time for training is over")
                continue
            own = now + max(end - now, 0.0) / rates[i] / sum(1 / rate for rate in rates[i:])
            run = self._learned(candidate, told, hidden, steps, rates[i], own, log, holdout)
            if failure := run.failures[0]:
                told["state"] = "diverged"
                self.send("line", f"{candidate.name} is left out: its {failure.metric} was not finite at update {failure.step}")
            elif run.config["steps"] < FEWEST:
                told |= {"state": "too few updates", "updates": run.config["steps"]}
                self.send("line", f"{candidate.name} is left out: its time was over after {run.config['steps']:,} updates")
            else:
                told |= {"state": "learned", "updates": run.config["steps"]}
                if run.config["steps"] < steps:
                    self.send("line", f"{candidate.name} was stopped after {run.config['steps']:,} updates: its time was over")
                runs.append(run)
            self._tell()
        if not runs and any(told["state"] == "too few updates" for told in self.told):
            raise self._short(f"no candidate reached {FEWEST} updates, the fewest for an evaluation")
        return runs

    def _short(self, why: str) -> "Unfinished":
        """The exception that ends an attempt for lack of time, which the card also shows."""
        self.send("state", {"short": True})
        return Unfinished(f"not enough time: {why}")

    def _learned(
        self, candidate: Candidate, told: dict[str, Any], hidden: tuple[int, ...], steps: int, rate: float, end: float,
        log: Dataset, holdout: Holdout,
    ) -> Run:  # fmt: skip
        told["state"] = "learning"
        self._tell()

        def look(progress: Chunk, steps: int) -> None:
            self.send("watch", [candidate.name, progress.step, steps])
            if time.time() > end:
                raise StopTraining

        return train(
            self._agent(candidate, hidden), log, steps=steps, seed=self.settings.seed, task=False,
            out=self.out / candidate.name, evaluate_every=steps, episodes=1, holdout=holdout, watch=look,
            chunk=min(max(int(LOOKS * rate), 1), steps), history=self.settings.history,
        )  # fmt: skip

    def _plan(self, hidden: tuple[int, ...], steps: int, rates: Sequence[float], learning: float, judging: float) -> str:
        """The plan in words: the times, and the candidates."""
        width = max(len(each["name"]) for each in self.told)
        lines = []
        for each, rate in zip(self.told, rates):
            no = "; deterministic: model-based estimate only" if each["deterministic"] else ""
            may = "" if not no or self.settings.accept_model_based else ", so deployed with --accept-model-based only"
            lines.append(f"  {each['name']:<{width}}  {in_words(steps / rate):>6}  {each['why']}{no}{may}")
        head = f"{len(lines)} candidates of {steps:,} updates, hidden layers of {', '.join(map(str, hidden))} units"
        total = min(learning, sum(steps / rate for rate in rates)) + judging
        times = f"training until {in_words(learning)} from now, evaluation about {in_words(judging)}"
        parts = f"about {in_words(total)} more: {times}"
        return "\n".join([parts, head, *lines])

    # ---- evaluation ---------------------------------------------------------------------------------------------------

    def _judge(
        self, runs: list[Run], log: Dataset, hidden: tuple[int, ...], pilots: list[Pilot], judging: float
    ) -> offline.Judged:
        self._stage("evaluation")
        left, model = self.left(), PROPENSITIES
        if left < judging:  # the machine has become slower; propensities have early stopping anyway
            steps = int(PROPENSITIES.steps * left / (LATE * judging))
            model = dataclasses.replace(PROPENSITIES, steps=max(steps // 100 * 100, 500))
            self.send("line", f"time is short: {model.steps:,} updates of propensities, not {PROPENSITIES.steps:,}")
        learned = [each for each in self.told if each["state"] == "learned"]
        estimators: Any = "auto"
        if self.settings.accept_model_based and any(each["deterministic"] for each in learned):
            rate = pilots[0].rate / (MEMBERS * len(runs))  # updates per second of so many critics
            steps = min(max(int(0.3 * left * rate), FEWEST_FITS), MOST_FITS)
            estimators = [FQE(hidden=hidden, members=MEMBERS, steps=steps, lr=1e-3, tau=0.02)]
        settings = JudgeSettings(
            out=self.out, discount=self.settings.discount, seed=self.settings.seed, model=model,
            **self.settings.only(EvidenceSettings),
            watch=lambda what, step, steps: self.send("watch", [what, step, steps]),
        )  # fmt: skip
        judged = offline.judge_alone(runs, log, estimators, None, settings)  # the parent process holds the lock
        self.send("state", {"judged": True})
        return judged

    def _check(self, runs: list[Run], judge_in: Task | None, judged: offline.Judged) -> None:
        """Evaluates the policies in the simulator, after the decision, as far as time allows."""
        if judge_in is None:
            return
        self._stage("checking in the simulator")

        def seen(episodes: int) -> dict[str, Any]:
            acting, estimand = [run.policy for run in runs], judged.results["estimand"]
            return offline.simulated(acting, judge_in, estimand, episodes=episodes, seed=self.settings.seed)

        begun = time.perf_counter()
        if self.left() > 0:
            seen(2)  # includes compilation; the second call measures the time
            if self.left() > 0:
                again = time.perf_counter()
                seen(2)
                each = (time.perf_counter() - again) / 2
                episodes = min(int(0.7 * self.left() / max(each, 1e-9)), EPISODES)
                if episodes >= FEW:
                    write_results(self.out / ESTIMATES, judged.results | {"truth": seen(episodes)})
                    self.send("state", {"checked": True})
                    return
        took = in_words(time.perf_counter() - begun)
        self.send("line", f"not checked in {judge_in.name}: no time is left (a trial took {took})")

    # ---- messages -----------------------------------------------------------------------------------------------------

    def _stage(self, name: str) -> None:
        self.send("state", {"stage": name, "since": time.time()})

    def _tell(self) -> None:
        self.send("state", {"candidates": self.told})


class Unfinished(Exception):
    """There is nothing to evaluate, for a reason that is shown on the card."""


def _number(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"got {type(value).__name__}")


def _changed(units: dict[str, Any]) -> str:
    """A line about the scaling of observations and rewards for candidates; empty without scaling."""
    parts = ["with standardised observations"] if "standardise" in units else []
    changes = [f"times {units['reward_scale']:g}"] if "reward_scale" in units else []
    shift = units.get("reward_shift")
    changes += [] if shift is None else [fixed(shift, decimals(shift), "+")]
    if changes:
        parts.append(f"on rewards {' '.join(changes)} where agents can scale them")
    return f"candidates are trained {' and '.join(parts)}, since numbers of this log are far from 1 in size" if parts else ""


def attempt(job: Job, send: Callable[[str, Any], None]) -> None:
    """Does the work of a job, and sends how it ended: `done`, or the reason as `refused`, `unfinished` or `fault`."""
    try:
        Attempt(job, send).run()
        send("done", True)
    except UserError as error:
        send("refused", str(error))
    except Unfinished as error:
        send("unfinished", str(error))
    except Exception as error:  # noqa: BLE001 - the card reports any error
        with contextlib.suppress(OSError):
            (Path(job.out) / FAULT).write_text(traceback.format_exc())
        send("fault", f"{type(error).__name__}: {' '.join(str(error).split())[:300]} ({FAULT} has all of it)")


def main() -> None:
    """Reads the job from standard input and does it; standard output has only lines of JSON."""
    pipe = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to standard error
    job = Job.of_json(json.loads(sys.stdin.buffer.readline()))
    lock = threading.Lock()

    def orphaned() -> None:
        sys.stdin.buffer.read()  # until it is closed: the parent process has ended
        os._exit(1)

    def send(what: str, value: Any) -> None:
        with lock:
            pipe.write(json.dumps({what: value}) + "\n")
            pipe.flush()

    warnings.showwarning = lambda message, *rest, **options: send("line", f"warning: {message}")
    threading.Thread(target=orphaned, daemon=True).start()
    attempt(job, send)
    pipe.flush()
    os._exit(0)  # without waiting for threads of simulators


if __name__ == "__main__":
    main()
