"""Which agents are above a log's own mean score, on the log where they are furthest above it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.agents import AGENTS, agent_class
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.report.text import words
from deadreckon.stats.comparison import paired
from deadreckon.stats.interval import ALPHA, Interval
from evidence.records import read

# Mean scores by log and rows, which are None of all of them, as suites say it: of the log's episodes, or of expert logs, of the
# policy that made them. On Maze2D, whose logged episodes go to other goals, they are of episodes of the task at the log's mean
# reward. Logs of people (the door, the kitchen) are not among them: what their episodes score is not what one policy does. Nor
# are logs whose mean nobody has noted; `LEFT_OUT` has those that the suites below have.
BEHAVIOUR: dict[tuple[str, int | None], float] = {
    (log, None if rows == "all" else int(rows.replace(",", ""))): float(score) for log, rows, score, _ in read("log-means").rows
}
LEFT_OUT = {
    "door-human-v1", "walker2d-random-v2", "walker2d-medium-expert-v2", "carla-lane-state-v0", "carla-lane-state-uniform-v0",
}  # fmt: skip
# Of agents as they are; others decide defaults or compare variants.
SUITES = [
    "gym", "gym-more", "medium", "extremes", "defaults-gym", "defaults-mazes", "carla-lane-state", "carla-lane-agents",
    "carla-lane-models", "heavy", "maze2d", "agents-hopper", "agents-maze2d", "models-hopper", "models-halfcheetah",
]  # fmt: skip


@dataclass(frozen=True)
class _Runs:
    """Runs of one method of a suite on one log."""

    agent: str
    method: str
    on: str
    suite: Suite
    scores: np.ndarray

    @property
    def whole(self) -> bool:
        """Whether all seeds of the suite are there."""
        return len(self.scores) == self.suite.seeds

    @property
    def own(self) -> float:
        """The log's own mean."""
        return BEHAVIOUR[self.on, self.suite.rows]

    def gain(self, level: float) -> Interval:
        """Over the log's own mean; one run has no interval."""
        return paired({self.on: self.scores}, {self.on: np.full_like(self.scores, self.own)}, level)


def improved(suites: Sequence[Suite], store: Store) -> str:
    """A table of all agents that learn from logs alone, in Markdown.

    Of each agent all logs are looked at whose own mean score is known, so intervals are at a level for as many
    (Bonferroni); the one whose interval begins highest is shown. Methods with a comma in their names are variants,
    which are left out. An agent improves where all runs of a suite are there and finite and the interval lies above 0. Below
    stand the others with the suites that have more runs of them.

    Args:
        suites: of which those of `SUITES` count, at their own size.
        store: the results.
    """
    rows = {row["cell"]: row for row in store.results().to_pylist()}
    found: dict[str, dict[frozenset[str], _Runs]] = {}
    waiting: dict[str, list[str]] = {}
    for suite in suites:
        if suite.name not in SUITES:
            continue
        agents = {method.name: method.agent for method in suite.methods if ", " not in method.name}
        for job in plan(suite):
            if job.method not in agents or (job.on, suite.rows) not in BEHAVIOUR:
                continue
            there = [cell for cell in job.cells if cell in rows]
            scores = np.array([rows[cell]["score"] for cell in there], float)
            runs = _Runs(agents[job.method], job.method, job.on, suite, scores)
            own = found.setdefault(runs.agent, {}) if there else {}
            # The same cells of two suites count once, as those of the one that has all of its own.
            if there and np.isfinite(runs.scores).all() and (frozenset(there) not in own or runs.whole):
                own[frozenset(there)] = runs
            if len(there) < len(job.cells):
                waiting.setdefault(runs.agent, []).append(f"`{suite.name}.toml`")
    titles = "agent", "log", "updates", "seeds", "score", "the log's own", "gain", "improves"
    lines = [f"| {' | '.join(titles)} |", "|---|---|---:|---:|---:|---:|---:|---|"]
    more: dict[str, list[str]] = {"Not shown, and more runs are declared:": [], "No result on these logs yet:": []}
    known, none = more.values()
    for agent in sorted(AGENTS):
        if not agent_class(agent).offline:
            continue
        places = [*dict.fromkeys(waiting.get(agent, ()))]
        if not found.get(agent):
            none.append(f"`{agent}`{f' ({words(places)})' if places else ''}")
            continue
        name, line, improves = _line(list(found[agent].values()))
        lines.append(line)
        if not improves and places:
            known.append(f"{name} ({words(places)})")
    lists = [f"- {title} {', '.join(agents)}" for title, agents in more.items() if agents]
    return "\n".join([*lines, *([""] if lists else []), *lists, ""])


def _line(runs: list[_Runs]) -> tuple[str, str, bool]:
    """The agent's name, its row, and whether it improves."""
    level = 1.0 - ALPHA / len(runs)
    several = [each for each in runs if each.whole and each.suite.seeds > 1]
    if several:
        best = max(several, key=lambda each: each.gain(level).low)
        gain = best.gain(level)
        told, says = f"{gain:.1f}", "yes" if 0 < gain.low < gain.high else "not shown"
    else:
        best = max(runs, key=lambda each: each.scores.mean() - each.own)
        told, says = f"{best.scores.mean() - best.own:.1f}", f"{len(best.scores)} of {best.suite.seeds} seeds"
    steps = best.suite.steps[best.on]
    of = f", best of {len(runs)}" if len(runs) > 1 else ""
    mean, seeds = f"{best.scores.mean():.1f}", len(best.scores)
    name = best.method if best.method.lower() == best.agent else f"{best.method} (`{best.agent}`)"
    return name, f"| {name} | {best.on}{of} | {steps:,} | {seeds} | {mean} | {best.own:g} | {told} | {says} |", says == "yes"
