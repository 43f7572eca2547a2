"""Settings that were tried, the choice among them, and how both are shown."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from deadreckon.ope.metrics import Metrics
from deadreckon.stats.interval import PERCENT, decimals, fixed
from deadreckon.stats.means import student_interval

By = Literal["ope", "simulator"]


@dataclass(frozen=True)
class Trial:
    """One setting.

    Attributes:
        fields: what differs from the agent's defaults.
        scores: (logs, seeds) normalised scores in the simulators; NaN where there is none, or none may be used.
        values: (seeds,) what its policies are estimated at from the log; empty where that was not asked for.
        failure: why a seed diverged, or "": then it is not chosen.
        gains: (seeds, 3) estimated gains over the behaviour policy, with ends that hold for all policies at once; likewise.
    """

    fields: dict[str, Any]
    scores: np.ndarray
    values: np.ndarray
    failure: str = ""
    gains: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def __str__(self) -> str:
        return named(self.fields)


@dataclass(frozen=True)
class Tuned:
    """What a search found.

    Attributes:
        agent: its name.
        by: what chose.
        trials: all settings.
        best: the chosen one among them.
        truth: by estimates, and where a simulator can tell: how well estimates ranked the settings; else None.
        lost: points of score that the choice has less than the best setting, where that is known.
    """

    agent: str
    by: By
    trials: tuple[Trial, ...]
    best: Trial
    truth: Metrics | None
    lost: float | None

    def __str__(self) -> str:
        width = max(len(str(trial)) for trial in self.trials)
        lines = []
        for trial in sorted(self.trials, key=self._standing, reverse=True):
            words = [f"{'*' if trial is self.best else ' '} {trial!s:<{width}}"]
            if len(trial.values):
                told = np.isfinite(trial.values).all()
                words.append(f"estimated {_interval(trial.values)}" if told else "an estimate is not finite, not chosen")
            if np.isfinite(trial.scores).all():
                words.append(f"score {_interval(trial.scores.mean(0))}")
            words += [f"FAILED, not chosen: {trial.failure}"] if trial.failure else []
            lines.append("  ".join(words))
        if any(len(trial.values) > 1 for trial in self.trials):
            lines.append(f"intervals ({PERCENT}) are over seeds of training; uncertainty from few episodes is not included")
        if self.by == "simulator" and len(self.trials) > 1:
            lines.append("the chosen setting has the best of these scores, by chance too: evaluate it again with fresh seeds")
        if len(self.best.gains):
            lines.append(self._by_episodes())
        if self.lost is not None:
            spread = np.ptp([trial.scores.mean() for trial in self.trials])
            share = f", {100 * self.lost / spread:.0f} % of the range of all" if spread > 0 else ""
            chance = np.mean([max(t.scores.mean() for t in self.trials) - trial.scores.mean() for trial in self.trials])
            lines.append(f"the choice loses {self.lost:.1f} points of score{share}; a random choice would lose {chance:.1f}")
        if self.truth is not None:
            lines.append(f"rank correlation of estimates and scores: {self.truth.rank_correlation.value:.2f}")
        return "\n".join(lines)

    def _by_episodes(self) -> str:
        """What the episodes of the log tell of the choice."""
        low, high = self.best.gains[:, 1].min(), self.best.gains[:, 2].max()
        d = decimals(low, high)
        ends = f"between {fixed(low, d)} and {fixed(high, d)}" if np.isfinite([low, high]).all() else "not known"
        told = f"by the log's episodes, gains of the chosen policies over the behaviour policy are {ends}"
        others = [trial for trial in self.trials if trial is not self.best and len(trial.gains) and not trial.failure]
        alike = sum(bool(trial.gains[:, 2].max() >= low) for trial in others)
        which = "the other setting" if len(others) == 1 else f"{alike} of the {len(others)} other settings"
        return f"{told}; those of {which} may be as large" if alike else told

    def _standing(self, trial: Trial) -> float:
        return standing_of(trial, self.by)


def named(fields: Mapping[str, Any]) -> str:
    """Settings as a method's name."""
    return ", ".join(f"{name} = {value}" for name, value in fields.items()) or "defaults"


def standing_of(trial: Trial, by: By) -> float:
    """What a setting is chosen by: the mean of its estimates, or of its scores; one without a finite mean is not chosen."""
    mean = float(np.mean(trial.values if by == "ope" else trial.scores))
    return -np.inf if trial.failure or not np.isfinite(mean) else mean


def _interval(values: np.ndarray) -> str:
    return f"{student_interval(values):.1f}"
