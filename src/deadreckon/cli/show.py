"""`deadreckon tasks` and `deadreckon agents`: what there is."""

from collections.abc import Sequence
from dataclasses import dataclass

from deadreckon.cli.parse import parse
from deadreckon.errors import unknown
from deadreckon.text_table import table


@dataclass
class Tasks:
    """List the simulators that policies are evaluated in."""

    domain: str | None = None  # domain to show, such as maze2d; None: all


@dataclass
class Agents:
    """List the learning algorithms."""


def tasks(args: Sequence[str]) -> None:
    """Prints the tasks with horizon, reference returns and the thesis's split, then the logs and policies made in them."""
    from deadreckon.tasks import registry

    options = parse(Tasks, args, "tasks")
    found = [registry.task(name) for name in registry.names()]
    domains = {task.domain for task in found}
    if options.domain is not None:
        if options.domain not in domains:
            raise unknown("domain", options.domain, domains)
        found = [task for task in found if task.domain == options.domain]
    rows = [["task", "steps", "random", "expert", "D4RL random", "D4RL expert", "split", "description"]]
    for t in found:
        known = [(f"{each.random:.1f}", f"{each.expert:.1f}") if each else ("-", "-") for each in (t.reference, t.published)]
        rows.append([t.name, str(t.horizon), *known[0], *known[1], t.split or "-", t.summary])
    print(table(rows, right=(1, 2, 3, 4, 5), sparse=True))
    print("\nrandom and expert: mean returns that define the scores 0 and 100; D4RL's where it has them, except for Maze2D")
    print("and Flow; in AntMaze, 100 means that all episodes reach the goal. Any Gymnasium environment is a task too, such as")
    print("--task gymnasium:Pendulum-v1; its scores are raw returns.")
    _logs([task for task in found if task.domain in ("antmaze", "adroit", "kitchen", "flow", "control")])
    hard = {task.domain: task for task in found if task.properties}
    rows = [[domain, ", ".join(task.properties), task.source] for domain, task in hard.items()]
    if rows:
        print("\n" + table([["domain", "what makes it hard (thesis 7.3, Table 8.1)", "from"], *rows]))
    _own_logs([task for task in found if task.domain == "gym"])
    _policies(found)


def _logs(tasks: Sequence) -> None:
    """Logs of tasks that the package's policies do not make; those that they make have a table of their own."""
    from deadreckon.collect.recipes import recipe, recipe_names

    if not tasks:
        return
    rows = [["data set", "steps", "behaviour policy"]]
    for task in tasks:
        found = [recipe(name) for name in recipe_names() if recipe(name).task == task.name]
        rows += [[each.name, f"{each.steps:,}", each.summary] for each in found]
    print("\n" + table(rows, right=(1,)))


def _own_logs(tasks: Sequence) -> None:
    """Logs of tasks that the package's policies make."""
    from deadreckon.collect.gym import behavior_return
    from deadreckon.collect.recipes import recipe, recipe_names
    from deadreckon.policies.library import library_tasks

    logs = [["data set", "steps", "return", "score", "behaviour policy"]]
    for task in (task for task in tasks if task.name in library_tasks()):
        for name in (n for n in recipe_names() if recipe(n).task == task.name):
            mean = behavior_return(task.name, name.removeprefix(f"{task.name}-").removesuffix("-v2"))
            score = f"{task.reference.normalise(mean):.1f}"
            logs.append([name, f"{recipe(name).steps:,}", f"{mean:.1f}", score, recipe(name).summary])
    if len(logs) > 1:
        print("\n" + table(logs, right=(1, 2, 3)))
        print("\nreturn: mean of an episode; of two parts, from the measured returns and lengths of both. `deadreckon data")
        print("collect NAME` makes a log, offline.")


def _policies(tasks: Sequence) -> None:
    """Policies of the tasks that have some in the package."""
    from deadreckon.policies.library import SHARED, library, library_tasks

    known = [task for task in tasks if task.name in library_tasks()]
    drawing = "return", "error", "score", "discounted"
    policies = [["policy", "updates", "environment steps", *drawing, "with mean actions", "score"]]
    for task in (task for task in known if task.name not in SHARED):
        snapshots = library(task.name)
        # Hundredths of shares of success, tenths of other returns.
        digits = 2 if max(abs(s.sampled.mean) for s in snapshots) < 10 else 1
        short = lambda x, digits=digits: f"{x:,.{digits}f}"  # noqa: E731
        for s in snapshots:
            score = lambda r, task=task: f"{round(task.reference.normalise(r.mean), 1) + 0.0:.1f}"  # noqa: E731
            drawn = short(s.sampled.mean), short(s.sampled.error), score(s.sampled), short(s.sampled.discounted)
            at = f"{s.updates:,}", f"{s.environment_steps:,}" if s.environment_steps or not s.updates else ""
            means = (short(s.greedy.mean), score(s.greedy)) if s.greedy else ("", "")
            policies.append([f"{task.name} {s.name}", *at, *drawn, *means])
    if len(policies) > 1:
        print("\n" + table(policies, right=range(1, 9), sparse=True))
        print("\nreturn with its standard error, score and discounted return (0.995) with sampled actions; where there is")
        print("such a column, return and score of mean actions.")
        print("`dr.load_policies(TASK)` gives the policies.")
        for task in (task for task in known if task.name in SHARED):
            print(f"{task.name} has those of {SHARED[task.name]}")


def agents(args: Sequence[str]) -> None:
    """Prints the agents, a line each."""
    from deadreckon.agents import AGENTS, plugins, presets

    parse(Agents, args, "agents")
    known = [[name, line] for name, (_, _, line) in AGENTS.items()] + [[name, path] for name, path in plugins().items()]
    print(table([["agent", "algorithm and source"], *known]))
    lines = [
        [agent, name, ", ".join(f"{field} {value}" for field, value in fields.items())]
        for agent, known in presets().items()
        for name, fields in known.items()
    ]
    print("\n" + table([["agent", "preset, for logs whose names begin with it", "published settings"], *lines]))
    print("\ndeadreckon train --agent NAME --help shows its hyperparameters; --preset NAME starts from a preset.")
    print("--agent MODULE:CLASS takes an agent of your own; see the documentation, Your own agent.")
