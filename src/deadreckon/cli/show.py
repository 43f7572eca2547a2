"""`deadreckon tasks` and `deadreckon agents`: what there is."""

from collections.abc import Sequence
from dataclasses import dataclass

from deadreckon.cli.parse import parse
from deadreckon.errors import unknown


@dataclass
class Tasks:
    """The simulators that policies are judged in."""

    domain: str | None = None  # only this domain, such as maze2d


@dataclass
class Agents:
    """The learning algorithms."""


def table(rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> str:
    """Columns of text, the first row a heading; columns in `right` are right-aligned."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = (c.rjust(w) if i in right else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths)))
        lines.append("  ".join(cells).rstrip())
    return "\n".join([lines[0], "  ".join("-" * w for w in widths), *lines[1:]])


def tasks(args: Sequence[str]) -> None:
    """Prints the tasks with horizon, reference returns and the thesis's split."""
    from deadreckon.tasks import registry

    options = parse(Tasks, args, "tasks")
    found = [registry.task(name) for name in registry.names()]
    domains = {task.domain for task in found}
    if options.domain is not None:
        if options.domain not in domains:
            raise unknown("domain", options.domain, domains)
        found = [task for task in found if task.domain == options.domain]
    rows = [["task", "steps", "random", "expert", "D4RL random", "D4RL expert", "split", "what"]]
    for t in found:
        published = (f"{t.published.random:.1f}", f"{t.published.expert:.1f}") if t.published else ("-", "-")
        references = (f"{t.reference.random:.1f}", f"{t.reference.expert:.1f}")
        rows.append([t.name, str(t.horizon), *references, *published, t.split, t.summary])
    print(table(rows, right=(1, 2, 3, 4, 5)))
    print("\nrandom and expert: mean returns that define the scores 0 and 100, measured on this simulator.")


def agents(args: Sequence[str]) -> None:
    """Prints the agents, a line each."""
    from deadreckon.agents import AGENTS

    parse(Agents, args, "agents")
    print(table([["agent", "what and whence"], *([name, line] for name, (_, _, line) in AGENTS.items())]))
    print("\ndeadreckon train --agent NAME --help shows its hyperparameters.")
