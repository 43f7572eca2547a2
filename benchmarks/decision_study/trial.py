"""One log from its seed to what each rule said and what was true, as plain numbers."""

import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import deadreckon.ope
from deadreckon.files import digest, read_json, write_json
from decision_study import FAMILIES
from decision_study.learn import learned
from decision_study.problem import WORSE, Family
from decision_study.rules import RULES, Task, Verdict

NONE_BETTER = 0.25  # share of the logs of which the candidates that are better are taken away
CONFIRM = 1_000_000  # the first seed that nobody has looked at
# The second is for what had changed after the confirmatory one, the third for the rules of 30 November 2026.
FIRST = {"development": 0, "confirmatory": CONFIRM, "second": 2 * CONFIRM, "third": 3 * CONFIRM}


@cache
def code() -> str:
    """A digest of what a decision is made by: the package's estimators and rule, and this study."""
    files = [path for folder in (Path(deadreckon.ope.__file__).parent, Path(__file__).parent) for path in folder.glob("*.py")]
    return digest([path.read_text() for path in sorted(files, key=lambda path: path.name)], 12)


def seeds(split: str, trials: int) -> range:
    """Of a part of the study."""
    return range(FIRST[split], FIRST[split] + trials)


def prepared(family: Family, seed: int, rows: int | None = None) -> Task:
    """A log, its parts, and the policies that are judged: in some logs those alone that are not better than the log's own."""
    problem = family.log(seed, rows)
    learning, held = problem.parts(seed)
    part = problem.part(learning)[0]
    out, hidden = problem.part(held)
    found = learned(part, problem.estimand.discount, seed)
    task = Task(problem, {**found, **problem.candidates}, part, out, hidden, found["bc"], seed)
    if not problem.null and np.random.default_rng([seed, WORSE]).random() < NONE_BETTER:
        task = task.without_better()
    return task


def trial(family: str, seed: int, rules: Sequence[str], path: Path, rows: int | None = None) -> dict[str, Any]:
    """What is found of a log, kept in a file; what the file has already is not done again, except `rules` that it lacks."""
    known = read_json(path) if path.exists() else {}
    wanted = [rule for rule in rules if rule not in known.get("rules", {})]
    if known and not wanted:
        return known
    began = time.perf_counter()
    task = prepared(FAMILIES[family], seed, rows)
    learned_in = time.perf_counter() - began
    found = known or {"family": family, "seed": seed, **_facts(task), "rules": {}, "seconds": {"learn": learned_in}}
    found["seconds"]["truth"] = found["seconds"].get("truth", time.perf_counter() - began - learned_in)
    for rule in wanted:
        start = time.perf_counter()
        found["rules"][rule] = _plain(RULES[rule](task)) | {"code": code()}
        found["seconds"][rule] = time.perf_counter() - start
    write_json(path, found)
    return found


def _facts(task: Task) -> dict[str, Any]:
    """Of a log, with the truth."""
    problem, (gains, wrong, own, error) = task.problem, task.truth
    each = task.scores
    return {
        "log": problem.log.name, "rows": len(problem.log), "episodes": problem.log.episodes, "held": task.held.episodes,
        "clusters": each.shape[1] if problem.cluster else None, "discount": problem.estimand.discount,
        "horizon": problem.estimand.horizon, "known": problem.known, "supported": problem.supported, "null": problem.null,
        "policies": list(task.policies), "gains": gains.tolist(), "errors": wrong.tolist(), "behavior": own,
        "ratio": float(np.max(wrong / np.maximum(error, 1e-12))),
    }  # fmt: skip


def _plain(verdict: Verdict) -> dict[str, Any]:
    """Infinite ends are null: JSON has no infinity."""
    numbers = lambda x: [float(v) if np.isfinite(v) else None for v in np.asarray(x, float)]  # noqa: E731
    found: dict[str, Any] = {
        "choice": None if verdict.choice is None else int(verdict.choice), "gain": numbers(verdict.gain),
        "low": numbers(verdict.low), "high": numbers(verdict.high), "why": verdict.why,
    }  # fmt: skip
    if verdict.told is not None:
        found["told"] = verdict.told.tolist()
    if verdict.true is not None:
        found["true"] = verdict.true.tolist()
    return found
