"""The numbers of a report: one row per policy, and intervals of their differences. Page and terminal both show these."""

from dataclasses import dataclass

import numpy as np

from deadreckon.ope.estimates import LOGGED
from deadreckon.report.entries import Entry, Page
from deadreckon.stats.crossed import against, mean_interval, paired
from deadreckon.stats.interval import ALPHA, Interval
from deadreckon.tasks.task import Task

BEHAVIOR = LOGGED

@dataclass(frozen=True)
class Row:
    """What one run's policies were worth at the last evaluation; None where it was not measured.

    Attributes:
        label: of the agent, or `BEHAVIOR`.
        entry: the run; None for the behaviour policy.
        returns: undiscounted, mean over seeds and episodes.
        score: the same on the scale from random (0) to expert (100).
        per_seed: mean score (or return, if there is no score) of each seed.
        value: the critic's estimate at the start of the episodes.
        truth: the discounted return that came of it.
        mmd: distance of the policy's actions to the logged ones.
        copy: what that of a copy of the log's policy stays below in 95 % of samples; None of runs from before it was measured.
        outside: share of its actions beyond the log's range.
        updates: before the evaluation.
        acted: steps in the environment before it; None of a run that learned from a log.
    """

    label: str
    entry: Entry | None = None
    returns: Interval | None = None
    score: Interval | None = None
    per_seed: tuple[float, ...] = ()
    value: float | None = None
    truth: float | None = None
    mmd: float | None = None
    copy: float | None = None
    outside: float | None = None
    updates: int | None = None
    acted: int | None = None

    @property
    def baseline(self) -> bool:
        """Behaviour cloning, which any agent has to beat."""
        return self.entry is not None and self.entry.agent == "bc"

    @property
    def online(self) -> bool:
        """Whether it learned by acting in the simulator."""
        return self.entry is not None and self.entry.online is not None

    @property
    def worth(self) -> Interval | None:
        """The score, or the return where there is no score."""
        return self.score or self.returns

    @property
    def over(self) -> float | None:
        """Overestimation: the critic's estimate minus the realised return."""
        return None if self.value is None or self.truth is None else self.value - self.truth


@dataclass(frozen=True)
class Difference:
    """Mean of one policy's worth minus another's, with intervals, in returns and (where known) in scores."""

    returns: Interval
    score: Interval | None

    @property
    def worth(self) -> Interval:
        """In scores, or in returns where there are none."""
        return self.score or self.returns


def to_score(task: Task | None, returns: Interval) -> Interval | None:
    """Returns as scores; None where the task's references are not known here, or where it has none."""
    if task is None or (reference := task.reference) is None:
        return None
    return Interval(*(float(reference.normalise(v)) for v in (returns.value, returns.low, returns.high)))


def behavior(entry: Entry) -> Interval | None:
    """The return of the policy that made the run's log."""
    known = entry.behavior
    if not known:
        return None
    return Interval(known["mean"], *(np.nan if known[end] is None else known[end] for end in ("low", "high")))


def versus(a: Row, b: Row, miss: float = ALPHA) -> Difference | None:
    """How much `a`, a run, is worth beyond `b`, a run or the behaviour policy.

    Args:
        a: a run.
        b: what it is compared with.
        miss: how often the interval may miss.
    """
    assert a.entry is not None
    mine = a.entry.last("return")
    if mine is None or b.returns is None:
        return None
    scores = a.entry.last("score")
    if b.entry is None:
        score = against(scores, b.score, miss) if scores is not None and b.score is not None else None
        return Difference(against(mine, b.returns, miss), score)
    theirs, their_scores = b.entry.last("return"), b.entry.last("score")
    if theirs is None:
        return None
    score = paired(scores, their_scores, miss) if scores is not None and their_scores is not None else None
    return Difference(paired(mine, theirs, miss), score)


_MEANS = "estimated_value", "discounted_return", "mmd_to_data", "mmd_of_copy", "outside_range"


def row(entry: Entry) -> Row:
    """The numbers of one run at its last evaluation."""
    returns, scores = entry.last("return"), entry.last("score")
    values = scores if scores is not None else returns
    updates = entry.last_step if entry.last_step is not None else entry.status.get("step")
    return Row(
        entry.label,
        entry,
        None if returns is None else mean_interval(returns),
        None if scores is None else mean_interval(scores),
        () if values is None else tuple(float(v) for v in values.mean(1)),
        *(_mean(entry.last(name)) for name in _MEANS),
        updates=updates,
        acted=entry.environment_steps(updates),
    )


def log_rows(page: Page) -> list[Row]:
    """One row for the policy behind each log (one log, as a rule)."""
    logs = {entry.config["data"]["fingerprint"]: entry for entry in reversed(page.entries) if behavior(entry)}
    out = []
    for entry in reversed(logs.values()):
        returns = behavior(entry)
        assert returns is not None
        label = BEHAVIOR if len(logs) == 1 else f"{BEHAVIOR} ({entry.config['data']['name']})"
        out.append(Row(label, None, returns, to_score(page.task, returns)))
    return out


def log_row(page: Page, entry: Entry) -> Row | None:
    """The row of the policy behind this run's log."""
    returns = behavior(entry)
    return None if returns is None else Row(BEHAVIOR, None, returns, to_score(page.task, returns))


def rows(page: Page) -> list[Row]:
    """All rows: the behaviour policy, then the runs, best first."""
    runs = [row(entry) for entry in page.entries]
    runs.sort(key=lambda r: -np.inf if r.worth is None or np.isnan(r.worth.value) else r.worth.value, reverse=True)
    return log_rows(page) + runs


def _mean(values: np.ndarray | None) -> float | None:
    if values is None or not np.isfinite(values).any():
        return None
    return float(values[np.isfinite(values)].mean())
