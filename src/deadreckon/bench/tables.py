"""A suite's results as a table: means with intervals, the bold rule, published numbers beside them, and what is missing."""

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.agents import agent_class
from deadreckon.bench import published
from deadreckon.bench.checked import names_of, number
from deadreckon.bench.jobs import Job, log_name
from deadreckon.bench.store import RESULT, Store
from deadreckon.bench.suite import Metric, Suite
from deadreckon.data.entries import has_original
from deadreckon.errors import UserError, unknown
from deadreckon.mbo.protocol import published as designs_published
from deadreckon.ope.dope import METRICS as OPE_METRICS
from deadreckon.ope.dope import printed as ope_printed
from deadreckon.ope.registry import estimator
from deadreckon.stats.comparison import bold
from deadreckon.stats.interval import PERCENT, Interval
from deadreckon.stats.means import student_interval
from deadreckon.stats.scores import interval, iqm
from deadreckon.training.field_names import with_field_names

# What published numbers are of.
SOURCES = {
    "learn": {
        "thesis": "Table 7.1, after 500,000 updates on D4RL's logs: not the same data, not the same simulator",
        "CORL": "last scores of its README (commit 2ed69e3) on D4RL's logs: not the same data, not the same simulator",
    },
    "design": {"thesis": "Tables 6.1 and 6.2, 16 trials of 128 designs on Design-Bench's data and oracles"},
    "ope": {
        "thesis": "appendix E.2, on the original logs, means over redrawn policies of DOPE: "
        "neither data nor policies are the same"
    },
}
SHOWN = ("deadreckon", "jax", "numpy", "mujoco", "python", "device", "cpu")  # versions under a table
# Agents in the published tables; in the thesis's BRAC has a name for each form.
THEIRS = {
    "thesis": {"bc": "BC", "sac": "SAC-off", "bear": "BEAR", "brac": "BRAC-v", "awr": "AWR", "bcq": "BCQ",
               "algae_dice": "aDICE", "cql": "CQL"},
    "CORL": {"bc": "BC", "td3_bc": "TD3+BC", "awac": "AWAC", "cql": "CQL", "iql": "IQL", "rebrac": "ReBRAC", "sac_n": "SAC-N",
             "edac": "EDAC", "decision_transformer": "DT"},
}  # fmt: skip
# Fields that leave a method what was published: widths of layers, how long a model of the log's policy is fitted, and the form
# of BRAC, by which it is named; how far designs may move, which the thesis does not limit; of estimators, how the behaviour
# policy is known, over which rows ratios are weighted, and by which range and folds.
UNCHANGED = {
    "learn": {"hidden", "critic_hidden", "behavior_steps", "value_penalty"},
    "design": {"max_travel"},
    "ope": {"behavior", "log_ratio_range", "alive_only", "folds"},
}


_SCORE = Metric("score", "normalised score")
_RETURN = Metric("raw", "return", joint=False)
METRICS: dict[str, tuple[Metric, ...]] = {
    "learn": (_SCORE,), "online": (_SCORE,),
    "design": (
        Metric("raw", "the best of the designs", digits=3, joint=False),
        Metric("median_raw", "their median", digits=3, joint=False),
        Metric("score", "the best of the designs, 100 being the best of all data"),
        Metric("median", "their median, 100 being the best of all data"),
    ),
    "ope": tuple(Metric(name, words, name == "rank_correlation", 2) for name, words in OPE_METRICS.items()),
}  # fmt: skip


FINE_TUNED = (
    Metric("start", "score of the policy before it acts"), Metric("gain", "last score minus that of the policy before it acts"),
    Metric("lowest", "lowest score of all evaluations"),
)  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """Scores of one method on one thing, one per seed."""

    scores: np.ndarray
    missing: int
    failed: int
    bold: bool = False

    @property
    def sound(self) -> bool:
        """Whether all seeds are there, have a score, and none diverged."""
        return not (self.missing or self.failed) and len(self.scores) > 0 and bool(np.isfinite(self.scores).all())

    @property
    def estimate(self) -> Interval:
        """Their mean with Student's interval; a single seed has none."""
        return student_interval(self.scores)


@dataclass(frozen=True)
class Table:
    """A suite's results in one metric.

    Attributes:
        suite: what was asked for.
        metric: of the scores.
        cells: method -> what it was run on -> scores, of which there may be none yet.
        printed: what it was run on -> source (`thesis`, `CORL`) -> method -> the score that is published for it.
        whole: method -> interquartile mean over all, of methods that have all seeds of all.
        notes: what a reader must know, one line each.
    """

    suite: Suite
    metric: Metric
    cells: dict[str, dict[str, Cell]]
    printed: dict[str, dict[str, dict[str, float]]]
    whole: dict[str, Interval]
    notes: tuple[str, ...]

    @property
    def best_of(self) -> str:
        """Which methods the best is chosen from, in words: empty where these are all."""
        complete = all(cell.sound for row in self.cells.values() for cell in row.values())
        return "" if complete else " of the methods without missing or failed runs"


def tables(suite: Suite, jobs: Sequence[Job], store: Store, any_revision: bool = False) -> list[Table]:
    """What is known of a suite: a table a metric of its kind.

    Args:
        suite: the suite.
        jobs: its plan.
        store: where results lie.
        any_revision: take results that other revisions of a method or the protocol made, too, where the present ones have none.

    Raises:
        UserError: a study has results, and none has one of the metrics.
    """
    return [_table(suite, metric, jobs, store, any_revision) for metric in suite.metrics or _metrics(suite)]


def _metrics(suite: Suite) -> tuple[Metric, ...]:
    """The metrics of a suite that is no study: those of its kind; where methods go on from a log, also what they gained and how
    far they fell; where tasks have no scale of scores, raw returns as well, or alone."""
    from deadreckon.tasks.registry import task

    known = METRICS[suite.kind] + (FINE_TUNED if suite.data else ())
    if suite.kind != "online" or all(scored := [task(on).reference is not None for on in suite.on]):
        return known
    return (*known, _RETURN) if any(scored) else (_RETURN,)


def _table(suite: Suite, metric: Metric, jobs: Sequence[Job], store: Store, any_revision: bool) -> Table:
    column, name = ("content", Job.content) if any_revision else ("cell", Job.cell)
    present = {cell for job in jobs for cell in job.cells}
    by_cell: dict[str, dict[str, Any]] = {}
    for row in store.of(jobs, any_revision).to_pylist():  # the newest last; of the present revisions, where there are any
        known = by_cell.get(row[column])
        if known is None or row["cell"] in present or known["cell"] not in present:
            by_cell[row[column]] = row
    cells: dict[str, dict[str, Cell]] = {}
    shown: list[dict[str, Any]] = []
    for job in jobs:
        names = [name(job, seed) for seed in job.seeds]
        own = [by_cell[name] | {"method": job.method, "on": job.on} for name in names if name in by_cell]
        shown += own
        before = cells.setdefault(job.method, {}).get(job.on, Cell(np.zeros(0), 0, 0))
        scores = np.concatenate([before.scores, np.array([number(row, metric.column) for row in own], float)])
        failed = before.failed + sum(row["failure"] != "" for row in own)
        cells[job.method][job.on] = Cell(scores, before.missing + len(names) - len(own), failed)
    for on in suite.on:
        sign = 1.0 if metric.higher else -1.0
        whole = {method: sign * row[on].scores for method, row in cells.items() if row[on].sound}
        for method, marks in (bold({method: [scores] for method, scores in whole.items()}) if whole else {}).items():
            cells[method][on] = dataclasses.replace(cells[method][on], bold=bool(marks[0]))
    given = names_of(shown) if suite.kind == "study" else set()
    if given and metric.column not in given:
        returned = given - set(RESULT.names)
        raise UserError(f"{suite.name}: no method returns {unknown('metric', metric.column, returned)}")
    full = {method: row for method, row in cells.items() if metric.joint and all(cell.sound for cell in row.values())}
    means = {method: interval({on: cell.scores for on, cell in row.items()}, iqm) for method, row in full.items()}
    printed = {on: _printed(suite, on, metric) for on in suite.on}
    missing = [(job, s) for job in jobs for s in job.seeds if name(job, s) not in by_cell]
    spread = f"{suite.seeds} seeds; means with Student's {PERCENT} intervals over seeds, wide where these are few"
    if suite.kind in ("learn", "online"):
        spread += "; all seeds are evaluated from the same starts, and intervals do not include how starts vary"
    notes = [spread if suite.seeds > 1 else "1 seed, so that the spread over seeds is not known; the best of a row is marked"]
    if means and len(suite.on) > 1:
        told = "over all logs or tasks intervals are a bootstrap's over runs"
        notes.append(f"{told} ({PERCENT}), too narrow where seeds are few")
    beside = {source for own in printed.values() for source in own}
    notes += [f"{source}: {told}" for source, told in SOURCES.get(suite.kind, {}).items() if source in beside]
    if suite.kind == "learn":
        notes += _best(suite)
    if suite.kind == "design" and (alike := _same_resamples(suite)):
        told = "members have the same bootstrap samples with all seeds, so intervals do not include how these vary"
        notes.append(f"{', '.join(alike)}: {told}")
    notes += _notes(jobs, missing, store, shown)
    return Table(suite, metric, cells, printed, means, tuple(" ".join(line.split()) for line in notes))


def _printed(suite: Suite, on: str, metric: Metric) -> dict[str, dict[str, float]]:
    """Source -> method -> the score that it publishes for it there."""
    if suite.kind == "learn":
        scores = {source: published.scores(on, table) for source, table in published.TABLES.items()}
    elif suite.kind == "design":
        found = designs_published().get({"raw": "100", "median_raw": "50"}.get(metric.column, ""), {}).get(on, {})
        scores = {"thesis": {theirs: pair[0] for theirs, pair in found.items()}}
    elif suite.kind == "ope" and metric.column != "absolute_error":  # E.2 has errors in returns
        labels = [estimator(method.agent).label for method in suite.methods]
        pairs = {label: ope_printed(metric.column, on, label) for label in labels}
        scores = {"thesis": {label: pair[0] for label, pair in pairs.items() if pair is not None}}
    else:
        return {}
    names = {source: _as_published(suite, source) for source in scores}
    beside = {
        source: {ours: own[theirs] for theirs, ours in names[source].items() if theirs in own} for source, own in scores.items()
    }
    return {source: own for source, own in beside.items() if own}


def _as_published(suite: Suite, source: str) -> dict[str, str]:
    """Name in a published table -> the suite's method that is this one and no variant; the first where there are several.

    A method with its defaults or with a preset is, and one that sets fields of `UNCHANGED` alone; of a part of a log none is.
    """
    if suite.rows:
        return {}
    found: dict[str, str] = {}
    for method in suite.methods:
        name, fields = method.agent, method.fields
        if suite.kind == "ope":
            name = estimator(method.agent).label
        elif suite.kind == "learn":
            if (name := THEIRS[source].get(method.agent, "")) == "":
                continue
            fields = with_field_names(agent_class(method.agent), fields)
            if method.agent == "brac" and not fields.get("value_penalty", True):
                name = "BRAC-p"
        whole = method.history == 1 and not method.encoder and method.shift is None
        if whole and fields.keys() <= UNCHANGED[suite.kind]:
            found.setdefault(name, method.name)
    return found


def _best(suite: Suite) -> list[str]:
    """The best published score of each log, whatever agents the suite has."""
    known = {on: found for on in suite.on if (found := published.best(on))}
    told = [f"{on} {found.score:.1f} ({found.algorithm}, {found.source})" for on, found in known.items()]
    return [f"best published in Table 7.1 (its online SAC aside) and in CORL: {'; '.join(told)}"] if told else []


def _same_resamples(suite: Suite) -> list[str]:
    """The methods of designs whose members are fitted on the same bootstrap samples with every seed."""
    from deadreckon.mbo.registry import designer  # which loads JAX

    made = {method.name: designer(method.agent, **method.fields) for method in suite.methods}
    return [name for name, one in made.items() if getattr(one, "members", 1) > 1]


def _notes(jobs: Sequence[Job], missing: Sequence[tuple[Job, int]], store: Store, found: list[dict[str, Any]]) -> list[str]:
    notes = []
    again = sorted({log_name(job) for job in jobs if "@dr" in job.data})
    if again:
        own = [on for on in again if not has_original(on)]
        if remade := [on for on in again if on not in own]:
            notes.append(f"collected again by this package, not the original files: {', '.join(remade)}")
        if own:
            notes.append(f"collected by this package; there are no others: {', '.join(own)}")
    logs = {job.on: log_name(job) for job in jobs}
    copies = {log: len({row["log"] for row in found if logs.get(row["on"]) == log and row["log"]}) for log in again}
    if several := [f"{on} ({count} logs)" for on, count in copies.items() if count > 1]:
        told = "collected on machines that round differently, so methods were trained on copies that differ"
        notes.append(f"{told}: {', '.join(several)}")
    notes += dict.fromkeys(f"oracle of {row['on']}: {row['oracle']}" for row in map(_with_more, found) if "oracle" in row)
    notes += _tuned(jobs)
    blind = sorted({row["on"] for row in found if row["kind"] == "learn" and np.isnan(row["score"])})
    if blind:
        notes.append(f"no simulator to evaluate in, so no scores: {', '.join(blind)}")
    present = {cell for job in jobs for cell in job.cells}
    if others := sum(row["cell"] not in present for row in found):
        notes.append(f"{others:,} of {len(found):,} results are of other revisions of their method or of the protocol")
    versions = [json.loads(row["versions"]) for row in found]
    known = {name: sorted({str(each[name]) for each in versions if name in each}) for name in SHOWN}
    if told := [f"{name} {' and '.join(values)}" for name, values in known.items() if values]:
        notes.append(f"made with {', '.join(told)}")
    failures = [(job, store.failure(job, seed)) for job, seed in missing]
    notes += dict.fromkeys(f"FAILED: {job.method} on {job.on}: {failure['error']}" for job, failure in failures if failure)
    if waiting := sum(failure is None for _, failure in failures):
        notes.append(f"without a result yet: {waiting:,} of {sum(len(job.seeds) for job in jobs):,} cells")
    for row in (row for row in found if row["failure"]):
        told = row["failure"] + ("; its last good policy counts" if row["kind"] in ("learn", "online") else "")
        notes.append(f"seed {row['seed']} of {row['method']} on {row['on']} failed: {told}")
    return notes


def _with_more(row: dict[str, Any]) -> dict[str, Any]:
    return row | json.loads(row["more"] or "{}")


def _tuned(jobs: Sequence[Job]) -> list[str]:
    """Presets that were tuned on a task that the thesis keeps for evaluation (Table D.3)."""
    from deadreckon.tasks.registry import of_log

    found = []
    for job in jobs:
        task = of_log(job.on) if job.kind == "learn" else None
        if job.preset and task is not None and task.split == "evaluation":
            found.append(f"{job.method} on {job.on}")
    found = list(dict.fromkeys(found))
    told = "settings published for a task that the thesis keeps for evaluation (Table D.3), tuned on it"
    return [f"{told}: {', '.join(found)}"] if found else []
