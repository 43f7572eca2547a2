"""From a log and a time budget to a decision: which agents to try, for how long, and the values of their policies.

The work is done in a separate process (`runs.attempt`), because only a process can be ended at any moment. This side keeps the
time: it prints how the time is divided, passes on messages, ends the process when the time is over, and ensures that there is
always a card, if necessary one that says how far the work came and how much time would be enough.
"""

import math
import shlex
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.folder import write_folder
from deadreckon.errors import UserError, cannot_write
from deadreckon.files import alone
from deadreckon.ope.select import Choice
from deadreckon.progress import Watcher, unwatched
from deadreckon.provided import Shown
from deadreckon.runs.attempt import WORTH, Job
from deadreckon.runs.clock import Clock
from deadreckon.runs.decision_record import ESTIMATES, read_results, write_results
from deadreckon.runs.durations import in_words
from deadreckon.runs.follow import Found, followed
from deadreckon.runs.offline import checked, grounds, supports
from deadreckon.runs.run import Run, load
from deadreckon.runs.settings import RecommendOptions, RecommendSettings
from deadreckon.stats.interval import PERCENT, decimals

EVER = 4.0  # multiple of the budget that is proposed if the necessary time is not known
LOG = ".log"  # folder of a log that was given in memory
MANY_DIGITS = 10  # width of a printed number
# States of candidates, as they are shown.
STATES = {
    "learning": "was training", "learned": "trained", "diverged": "diverged (NaN or Inf)", "not begun": "not started",
    "too few updates": "stopped after too few updates for an evaluation",
}  # fmt: skip


@dataclass(frozen=True)
class Recommendation(Shown):
    """The result of `recommend`.

    Attributes:
        path: folder of the runs and of `estimates.json`.
        results: the contents of `estimates.json`; under "recommend", the candidates that were tried and their progress.
        seconds: the time it took.
    """

    path: Path
    results: dict[str, Any]
    seconds: float

    @property
    def judged(self) -> bool:
        """Whether policies were evaluated; otherwise the card says what was missing."""
        return bool(self.results["results"])

    @property
    def failed(self) -> bool:
        """Whether it ended with an error, which the card shows."""
        return self.results["recommend"]["failed"]

    @property
    def choice(self) -> Choice:
        """The decision."""
        return _choice(self.results)

    @property
    def runs(self) -> list[Run]:
        """One run for each candidate that was trained."""
        candidates = self.results["recommend"]["candidates"]
        return [load(self.path / each["name"]) for each in candidates if each["state"] == "learned"]

    def __str__(self) -> str:
        return card(self.results)


def recommend(
    data: Dataset | str | Path,
    budget: float | str = "30m",
    *,
    out: Path | str = "runs/recommend",
    page: Callable[[Path, bool], Any] | None = None,
    tell: Callable[[str], None] = lambda line: None,
    watch: Watcher = unwatched,
    began: float | None = None,
    **options: Unpack[RecommendOptions],
) -> Recommendation:
    """Tries agents and settings on a log, evaluates them on held-out episodes, and decides which policy to deploy, if any.

    There is always a card when the time is over: if the time was not enough, it says so, and how far the work came. Candidates,
    settings and the amount of training depend only on the log's design and the measured speed, never on rewards of the held-out
    episodes. If there is a simulator, the choice is checked in it afterwards, if time is left.

    Args:
        data: a log, the name of a known one, or a file.
        budget: seconds, or a time such as `30m`, for everything from reading the log to the card.
        out: folder of the runs, of `estimates.json` and of the page; must not exist.
        page: writes a page from the folder; its argument says whether it has to be quick. None: no page.
        tell: receives lines as they come, first how the time is divided.
        watch: called while something is fitted, with its name, updates done and in all.
        began: start of the budget, by `time.perf_counter()`; None: now.
        **options: `task`, `discount`, `seed`, `holdout`, `accept_model_based`, `cost_limit`, `stationary`, `history` and
            `columns`; see `runs.settings.RecommendSettings`.

    Raises:
        UserError: an invalid log or option, in one line; nothing is written then.
    """
    clock = Clock.of(budget, began)
    settings = RecommendSettings.of(options)
    settings.check_values()
    out = Path(out)
    with alone(out, what=str(out)):
        if out.exists():
            raise UserError(f"{out} exists already; give another --out")
        if not isinstance(data, Dataset) and not isinstance(data, Path) and not str(data):
            raise UserError("no log is named")
        source, columns = str(data), settings.columns
        if isinstance(data, Dataset):
            if columns:
                raise UserError("columns say which column of a file is what; a Dataset has its columns already: leave them out")
            source = str(out / LOG)
            settings = replace(settings, columns={"mmap": isinstance(data.observations, np.memmap)})
        now = time.time()
        job = Job(source, str(out), clock.budget, now - clock.spent(), now + clock.left(), settings).as_json()
        tell(clock.divided())
        try:
            if isinstance(data, Dataset):
                write_folder(data, source)
            else:
                try:
                    out.mkdir(parents=True)
                except OSError as error:
                    raise cannot_write(out, error) from error
            found = followed(job, clock, tell, watch)
        except Exception:  # there is no card yet, and a folder would prevent another attempt
            shutil.rmtree(out, ignore_errors=True)
            raise
        finally:
            shutil.rmtree(out / LOG, ignore_errors=True)
        if found.refused and not found.state.get("candidates"):
            shutil.rmtree(out, ignore_errors=True)
            raise UserError(found.refused)
        name = data.name if isinstance(data, Dataset) else found.state.get("log", str(data))
        again = () if isinstance(data, Dataset) or columns else ("--data", str(data), *options_of(settings))
        told = _written(out, name, again, found, clock)
        if page is not None:
            page(out, True)
            if told["results"] and clock.spent() < clock.budget:
                try:
                    page(out, False)
                except Exception as error:  # noqa: BLE001 - the card exists, and is more important than its figures
                    tell(f"report.html has only the card; its figures failed with {type(error).__name__}: {error}")
        return Recommendation(out, told, clock.spent())


# ---- the card ---------------------------------------------------------------------------------------------------------


def options_of(settings: RecommendSettings) -> list[str]:
    """The options of `deadreckon ope` for the same decision."""
    limits = settings.cost_limit
    if isinstance(limits, Mapping):
        named = [f"{key}={limit}" for key, limit in limits.items()]
    else:
        named = [] if limits is None else [str(limits)] if isinstance(limits, str | float | Real) else list(limits)
    options = ["--discount", str(settings.discount), "--seed", str(settings.seed)]
    options += ["--cost-limit", *named] if named else []
    options += ["--accept-model-based"] if settings.accept_model_based else []
    return options + (["--stationary"] if settings.stationary else [])


def _written(out: Path, log: str, again: Sequence[str], found: Found, clock: Clock) -> dict[str, Any]:
    """Writes `estimates.json`: the estimates, or the reason why there are none, and the candidates that were tried."""
    path = out / ESTIMATES
    state = found.state
    candidates = state.get("candidates", [])
    told = read_results(path) if path.exists() else None
    mine = {
        "budget": clock.budget, "seconds": clock.spent(), "rows": state.get("rows"), "episodes": state.get("episodes"),
        "candidates": candidates, "late": found.late, "failed": found.fault is not None,
    }  # fmt: skip
    if told is None:
        told = _unjudged(out, log, again, found, clock)
    elif found.fault is not None:
        told["choice"]["warnings"].append(f"the steps after the evaluation were not done: {found.fault}")
    told["choice"]["warnings"] += [*state.get("leaks", []), *(_few_updates(state, clock) if told["results"] else [])]
    told["recommend"] = mine
    write_results(path, told)
    return told


def _unjudged(out: Path, log: str, again: Sequence[str], found: Found, clock: Clock) -> dict[str, Any]:
    """The card if no policy was evaluated: do not deploy, the reason, the progress, and a budget that should suffice."""
    state, stage = found.state, found.state.get("stage", "starting")
    candidates = state.get("candidates", [])
    evidence = []
    for each in candidates:
        updates = f", {each['updates']:,} of {each['planned']:,} updates" if each["planned"] else ""
        evidence.append(f"{each['name']}: {STATES.get(each['state'], each['state'])}{updates}")
    if found.refused or found.unfinished or found.fault:
        reason = str(found.refused or found.unfinished or found.fault)
        if state.get("short"):
            evidence.append(f"a budget of {_enough(state, clock)} should be sufficient")
    else:
        learned = sum(each["state"] == "learned" for each in candidates)
        of = f"{learned} of {len(candidates)} candidates are trained, none is evaluated"
        came = of if candidates else "no candidate is trained"
        reason = f"not enough time: the budget of {in_words(clock.budget)} was used up (at this stage: {stage}); {came}"
        evidence.append(f"still to be done: {', '.join(_rest(stage, bool(candidates)))}")
        evidence.append(f"a budget of {_enough(state, clock)} should be sufficient")
    learned = [each for each in candidates if each["state"] == "learned"]
    if learned and again:
        words = ["deadreckon", "ope", *again, "--policies", *(str(out / each["name"]) for each in learned), "--select"]
        evidence.append(f"this evaluates the trained candidates: {shlex.join(words)}")
    choice = {
        "name": None, "deploy": False, "gain": [math.nan] * 3, "level": None, "reason": reason, "evidence": evidence,
        "warnings": [], "objections": [],
    }  # fmt: skip
    return {"log": log, "estimand": None, "truth": None, "policies": [], "judged": None, "results": [], "choice": choice}


def _few_updates(state: dict[str, Any], clock: Clock) -> list[str]:
    """A warning if policies were evaluated after fewer than `WORTH` updates, with a budget for these."""
    learned = [each for each in state.get("candidates", []) if each["state"] == "learned"]
    few = [each for each in learned if each["updates"] < WORTH]
    if not few or "need for worth" not in state:
        return []
    updates = ", ".join(f"{each['name']} {each['updates']:,}" for each in few)
    budget = _in_minutes(_with_margin(state["need for worth"], clock))
    return [f"few updates: {updates} ({WORTH:,} are advised); a budget of about {budget} should be sufficient for them"]


def _rest(stage: str, planned: bool) -> list[str]:
    order = ["starting", "reading the log", "pilots", "training", "evaluation"]
    at = order.index(stage) if stage in order else 0
    return [each for each in order[max(at, 1) :] if each != "pilots" or not planned]


def _enough(state: dict[str, Any], clock: Clock) -> str:
    """A budget that should suffice, in whole minutes."""
    need = state.get("need")
    seconds = EVER * clock.budget if need is None else _with_margin(need, clock)
    if state.get("stage") == "evaluation":  # which took longer than expected
        seconds = max(seconds, clock.budget + 2.0 * (time.time() - state["since"]))
    return _in_minutes(seconds)


def _with_margin(need: float, clock: Clock) -> float:
    """Seconds of a budget for what is expected to need so many, more than the budget that there was."""
    return max(1.2 * need, 1.25 * clock.budget)


def _in_minutes(seconds: float) -> str:
    """A budget of whole minutes, at least two."""
    return f"{max(math.ceil(seconds / 60), 2)}m"


def _choice(told: dict[str, Any]) -> Choice:
    choice = told["choice"]
    difference, low, high = choice["gain"]
    return Choice(
        choice["name"] or "nothing", choice["deploy"], difference, low, high, choice["reason"], tuple(choice["evidence"]),
        tuple(choice["warnings"]), objections=tuple(map(tuple, choice["objections"])),
        **({} if choice["level"] is None else {"level": choice["level"]}),
    )  # fmt: skip


def card(told: dict[str, Any]) -> str:
    """The contents of `estimates.json` for a terminal, with the decision last."""
    choice = str(_choice(told))
    if not told["results"]:
        return choice
    first = told["results"][0]
    names = [*(each["name"] for each in told["policies"]), "behaviour policy"]
    width = max(map(len, names))
    d = decimals(*first["value"], *first["low"], *first["high"])
    number = lambda x: "-" if math.isnan(x) else f"{x:.{d}f}"  # noqa: E731
    lines = [f"evaluated on {dict(grounds(told))['evaluated on']}", ""]
    lines.append(f"{first['title']}: {told['estimand']['words']}; {PERCENT} intervals")
    for name, value, low, high in zip(names, first["value"], first["low"], first["high"]):
        lines.append(f"  {name:<{width}}  {number(value):>{MANY_DIGITS}} [{number(low)}, {number(high)}]")
    lines += ["", supports(told), "", choice]
    if told["truth"] is not None:
        lines.append(f"checked: {checked(told)}")
    return "\n".join(lines)
