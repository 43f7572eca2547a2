"""From a log and so much time to a decision: which agents to try, how long, and what their policies are worth."""

import dataclasses
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from deadreckon.agents import agent_class
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.batch import Rows
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.estimate import BehaviorModel, Case
from deadreckon.ope.fqe import FQE
from deadreckon.policies.policy import Deployed
from deadreckon.runs.durations import in_words, seconds_of
from deadreckon.runs.offline import Judged, judge
from deadreckon.runs.recorder import Enough
from deadreckon.runs.train import Run, judge_of, train
from deadreckon.training.fit import Fit, Progress


@dataclass(frozen=True)
class Candidate:
    """An agent with settings that is worth a try.

    Attributes:
        name: in tables and of its run folder.
        agent: its registered name.
        fields: settings that differ from its defaults.
        why: in a few words.
    """

    name: str
    agent: str
    fields: dict[str, Any]
    why: str


# In the order in which they are worth their time; more time tries more of them. All are cheap: an hour is better spent on
# more updates of these than on agents that draw ten actions a row. The settings are those that their papers vary.
CONTINUOUS = (
    Candidate("bc", "bc", {}, "copies the log; what the others must beat"),
    Candidate("td3_bc", "td3_bc", {}, "stays near the logged actions, improves where the values are sure"),
    Candidate("iql", "iql", {}, "weighs logged actions by their advantage; joins parts of episodes"),
    Candidate("td3_bc-loose", "td3_bc", {"alpha": 10.0}, "for logs of poor or varied behaviour"),
    Candidate("iql-bold", "iql", {"expectile": 0.9, "sharpness": 10.0}, "for rewards that are rare"),
    Candidate("awac", "awac", {}, "advantage-weighted imitation with a policy's own values"),
    Candidate("td3_bc-close", "td3_bc", {"alpha": 1.0}, "for narrow logs of good behaviour"),
    Candidate("rebrac", "rebrac", {"batch_size": 256}, "TD3+BC with penalised targets and normalised critics"),
)
DISCRETE = (
    Candidate("bc", "bc", {}, "copies the log; what the others must beat"),
    Candidate("iql", "iql", {}, "weighs logged actions by their advantage"),
    Candidate("cql", "cql", {"conservatism": 1.0}, "values of actions that the log lacks are pushed down"),
    Candidate("bcq", "bcq", {}, "takes the best among actions that the log takes often enough"),
    Candidate("iql-bold", "iql", {"expectile": 0.9, "sharpness": 10.0}, "for rewards that are rare"),
    Candidate("cql-strict", "cql", {"conservatism": 5.0}, "for logs that show few actions a state"),
)
CHUNK, TOLD = 200, 100  # updates between two looks at the clock, of agents and of the pilot's FQE
FEWEST, MOST = 1_000, 100_000  # updates of a candidate: with fewer nothing is told
WORTH = 10_000  # updates that each should have before another candidate is tried
ENOUGH = 3  # candidates that should be tried, with small networks if need be
LARGE, SMALL = (256, 256), (64, 64)  # networks
PILOT = 0.2  # share of the budget after which the pilot looks no further
SHARES = {"train": 0.55, "estimate": 0.25}  # of what the pilot leaves; the rest is for coverage, the page and what takes longer
SAFETY = 0.85  # of a share is planned with: machines have moods
FEWEST_FITS = 1_000  # updates of FQE: with fewer its values have not left where they began
MEMBERS = 5  # critics a policy in FQE, whose spread is the interval
EPISODES = 20  # in the simulator, where there is one


@dataclass(frozen=True)
class Plan:
    """What will be done, and how long it will take.

    Attributes:
        candidates: that are tried.
        hidden: width of their layers.
        steps: updates of each.
        rates: of each, updates a second as the pilot found them.
        estimates: updates of FQE.
        seconds: expected, from now to the end.
    """

    candidates: tuple[Candidate, ...]
    hidden: tuple[int, ...]
    steps: int
    rates: tuple[float, ...]
    estimates: int
    seconds: float

    def __str__(self) -> str:
        width = max(len(each.name) for each in self.candidates)
        took = [in_words(self.steps / rate) for rate in self.rates]
        lines = [f"  {each.name:<{width}}  {time:>6}  {each.why}" for each, time in zip(self.candidates, took)]
        head = f"{len(lines)} candidates of {self.steps:,} updates, networks of {', '.join(map(str, self.hidden))}"
        return "\n".join([f"about {in_words(self.seconds)}: {head}, then FQE of {self.estimates:,} updates", *lines])


@dataclass(frozen=True)
class Recommendation:
    """What came of it.

    Attributes:
        plan: what was tried.
        runs: one a candidate.
        judged: estimates of all their policies, and the choice among them.
        seconds: that it took.
    """

    plan: Plan
    runs: list[Run]
    judged: Judged
    seconds: float


def recommend(
    data: Dataset | str | Path,
    budget: float | str = "30m",
    *,
    task: str | None = None,
    discount: float = 0.99,
    seed: int = 0,
    out: Path | str = "runs/recommend",
    tell: Callable[[str], None] = lambda line: None,
    watch: Callable[[str, int, int], None] = lambda what, step, steps: None,
) -> Recommendation:
    """Tries agents and settings on a log, estimates all of them from the log alone, and says whether to deploy which.

    A pilot measures how fast each candidate learns here; then it is said how long it will take, and done. The better of the
    settings are found by the estimates, never by a simulator. Where there is one, the choice is checked in it afterwards.

    Args:
        data: a log, the name of a known one, or a file.
        budget: seconds, or a time such as `30m`; all together, from the pilot to the card.
        task: simulator to check the choice in; None: that of a known log, and none for others.
        discount: of the returns.
        seed: of everything random.
        out: folder of the runs and of `estimates.json`; must not be there yet.
        tell: gets lines as they come: the plan first.
        watch: called while something is fitted, with its name, updates done and in all.

    Raises:
        UserError: a log or budget that does not fit, or a budget that is too short for anything, in one line.
    """
    began = time.perf_counter()
    limit = seconds_of(budget) if isinstance(budget, str) else float(budget)
    left = lambda: limit - (time.perf_counter() - began)  # noqa: E731
    out = Path(out)
    if out.exists():
        raise UserError(f"{out} is there already; give another --out")
    log = data if isinstance(data, Dataset) else catalogue.load(data)
    if not 0.0 <= discount < 1.0:
        raise UserError(f"discount must be 0 .. 1 without 1, got {discount}")
    judge_in = judge_of(log, task)
    log = log.with_action_space(log.action_space if judge_in is None else judge_in.action_space)
    plan = _plan(log, left, discount, seed, tell)
    tell(str(plan))

    costs, training = [1.0 / rate for rate in plan.rates], SHARES["train"] * left()
    ends = time.perf_counter() + training * np.cumsum(costs) / sum(costs)

    def learned(candidate: Candidate, end: float) -> Run:
        def look(progress: Progress, steps: int) -> None:
            watch(candidate.name, progress.step, steps)
            if time.perf_counter() > end:
                raise Enough

        return train(
            _agent(candidate, plan.hidden, discount), log, steps=plan.steps, seed=seed, task=judge_in, watch=look,
            out=out / candidate.name, evaluate_every=plan.steps, episodes=EPISODES, chunk=CHUNK,
        )  # fmt: skip

    runs = []
    for candidate, end in zip(plan.candidates, ends):
        run = learned(candidate, end)
        if failure := run.failures[0]:
            tell(f"{candidate.name} is left out: its {failure.metric} was not finite at update {failure.step}")
            continue
        if run.config["steps"] < plan.steps:
            tell(f"{candidate.name} was ended after {run.config['steps']:,} updates: its time was over")
        runs.append(run)
    if not runs:
        raise UserError(f"no candidate learned anything from {log.name}: the numbers of all of them went bad")

    def in_time(what: str, step: int, steps: int) -> None:
        watch(what, step, steps)
        if left() < 0:
            given = log.name if isinstance(data, Dataset) else data
            words = ["deadreckon", "ope", "--data", given, "--policies", *(run.path for run in runs), "--estimators", "fqe",
                     "--greedy", "--discount", discount, "--steps", plan.estimates, "--members", MEMBERS,
                     "--hidden", *plan.hidden, "--select"]  # fmt: skip
            raise UserError(f"the {in_words(limit)} are over before {what} is; this goes on: {shlex.join(map(str, words))}")

    model = BehaviorModel(hidden=plan.hidden, lr=1e-3, steps=max(TOLD, plan.estimates // 4))
    judged = judge(
        runs, log, [_estimator(plan.hidden, plan.estimates)], out=out, task=judge_in, episodes=EPISODES, discount=discount,
        greedy=True, seed=seed, model=model, watch=in_time,
    )  # fmt: skip
    return Recommendation(plan, runs, judged, limit - left())


def _agent(candidate: Candidate, hidden: tuple[int, ...], discount: float) -> Agent:
    kind = agent_class(candidate.agent)
    own = {f.name for f in dataclasses.fields(kind)}
    common = {name: value for name, value in {"hidden": hidden, "discount": discount}.items() if name in own}
    return kind(**common | candidate.fields)


def _estimator(hidden: tuple[int, ...], steps: int) -> FQE:
    return FQE(hidden=hidden, members=MEMBERS, steps=steps, lr=1e-3, target_rate=0.02)


def _plan(log: Dataset, left: Callable[[], float], discount: float, seed: int, tell: Callable[[str], None]) -> Plan:
    """How many candidates, which networks and how many updates fit, by the pilot's rates."""
    whole = left()
    candidates: list[Candidate] = []
    for hidden, fewest in ((LARGE, 1), (SMALL, ENOUGH)):
        candidates, rates, policies = [], [], []
        for candidate in DISCRETE if log.spec.discrete else CONTINUOUS:
            if left() < (1.0 - 2.0 * PILOT) * whole:
                break
            found = _pilot(_agent(candidate, hidden, discount), log, seed)
            if found is None:
                tell(f"pilot: {candidate.name} is left out, its numbers go bad on this log")
                continue
            rate, policy = found
            tell(f"pilot: {candidate.name}, {rate:,.0f} updates a second with networks of {hidden[0]}")
            if len(candidates) >= fewest and _steps(left(), [*rates, rate]) < WORTH:
                break  # more updates of the earlier ones are worth more
            candidates, rates, policies = [*candidates, candidate], [*rates, rate], [*policies, policy]
            if len(candidates) >= ENOUGH and left() < (1.0 - PILOT) * whole:
                break
        if len(candidates) >= ENOUGH and _steps(left(), rates) >= WORTH:
            break
    if not candidates:
        raise UserError(f"{in_words(whole)} are over before a candidate of {log.name} is tried; give it more, such as 30m")
    clock, before = _Clock(), time.perf_counter()
    options = {"discount": discount, "seed": seed, "greedy": True, "logged": True}
    _estimator(hidden, 10 * TOLD).on(Case(log, policies, **options, watch=clock))
    # What the policies do at all rows is asked before FQE begins, and so is the compiler.
    once = max(time.perf_counter() - before - 10 * TOLD / clock.rate, 0.0)
    steps = min(_steps(left(), rates), MOST) // CHUNK * CHUNK
    estimates = min(int((SAFETY * SHARES["estimate"] * left() - once) * clock.rate), MOST) // CHUNK * CHUNK
    if steps < FEWEST or estimates < FEWEST_FITS:
        learning = FEWEST * sum(1.0 / rate for rate in rates) / (SAFETY * SHARES["train"])
        fitting = (FEWEST_FITS / clock.rate + once) / (SAFETY * SHARES["estimate"])
        need = in_words(1.2 * (whole - left() + max(learning, fitting)))
        raise UserError(f"{in_words(whole)} are too short for this log on this machine; give it {need} or more")
    rest = (1.0 - sum(SHARES.values())) * left()
    seconds = sum(steps / rate for rate in rates) + once + estimates / clock.rate + 0.5 * rest
    return Plan(tuple(candidates), hidden, steps, tuple(rates), estimates, seconds)


def _steps(left: float, rates: Sequence[float]) -> int:
    """Updates of each that fit into what is left."""
    return int(SAFETY * SHARES["train"] * left / sum(1.0 / rate for rate in rates))


def _pilot(agent: Agent, log: Dataset, seed: int) -> tuple[float, Deployed] | None:
    """Updates a second after the first chunk, which is compiled, and the policy as far as it is; None: its numbers go bad."""
    agent = agent.resolve(log.spec, MOST)
    fit, clock = Fit([agent], Rows(log, agent.needs(log.spec)), [seed], 3 * CHUNK, chunk=CHUNK), _Clock()
    for progress in fit.chunks():
        clock("", progress.step, fit.steps)
    if any(fit.failures):
        return None
    state = jax.tree.map(lambda leaf: leaf[0], fit.states)
    return clock.rate, Deployed.of(agent.policy(state), fit.rows.view)


class _Clock:
    """Hears of chunks, and tells how fast they come after the first."""

    def __init__(self):
        self.seen: list[tuple[float, int]] = []

    def __call__(self, what: str, step: int, steps: int) -> None:
        self.seen.append((time.perf_counter(), step))

    @property
    def rate(self) -> float:
        """Updates a second."""
        (first, done), *_, (last, more) = self.seen
        return (more - done) / (last - first)
