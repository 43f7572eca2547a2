"""DOPE's policies of dm_control (thesis 8.4): how they learn from the tasks' logs, and how they are published.

    python tools/unplugged_policies.py --train --only walker-stand --budget package       (goes on where it was stopped)
    python tools/unplugged_policies.py --publish --only walker-stand --budget package --episodes 30 --most 30
    python tools/unplugged_policies.py --table

Four agents learn from each log, three seeds each; some of what they were on the way is published. The log is collected first
where it is not there yet. A fifth of its episodes is held out, so that policies can be judged on episodes that none has seen.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import tyro

import deadreckon as dr
from deadreckon.agents import ABM, BC, CRRD, D4PG
from deadreckon.agents.agent import Agent
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.collect import collect
from deadreckon.ope.metrics import published_returns
from deadreckon.policies.library import ROOT, Returns, evaluated, library_tasks
from deadreckon.runs.publish import Shipping, publish_runs
from deadreckon.stats.comparison import between
from deadreckon.tasks.control import TASKS

SEEDS = 3
HELD_OUT = 0.2


class Size(NamedTuple):
    """What learns, and which policies are kept."""

    agents: dict[str, Agent]
    snapshots: tuple[int, ...]  # updates; DOPE's are exponentially spaced


# Narrower networks, since the package is to ship the policies; and rates of 3e-4, for updates that are few. After 10,000 of
# them D4PG returned 54, 67 and 163 in walker-stand, where uniform actions return 126: targets had been copied 100 times.
_NARROW: dict[str, Agent] = {
    "d4pg": D4PG(actor_lr=3e-4, critic_lr=3e-4, hidden=(128, 128), critic_hidden=(256, 256)),
    "abm": ABM(actor_lr=3e-4, prior_lr=3e-4, critic_lr=3e-4, hidden=(128, 128), samples=5),
    "bc": BC(model="normal", hidden=(128, 128)),
    "crr_d": CRRD(actor_lr=3e-4, critic_lr=3e-4, hidden=(128, 128), critic_hidden=(256, 256)),
}
SIZES = {
    "full": Size(
        {
            "d4pg": D4PG(), "abm": ABM(hidden=(256, 256, 256), batch_size=1024), "bc": BC(model="normal", batch_size=1024),
            "crr_d": CRRD(hidden=(256, 256, 256), batch_size=1024),
        },
        (25_000, 50_000, 100_000, 200_000, 400_000, 800_000, 1_600_000, 3_200_000),
    ),
    "package": Size(_NARROW, (10_000, 100_000)),  # on a GPU
    "cpu": Size(_NARROW, (5_000, 25_000)),
}  # fmt: skip


@dataclass
class Options:
    """Policies of dm_control's tasks as DOPE made them."""

    only: tuple[str, ...] = tuple(task.name for task in TASKS)  # of these tasks
    agents: tuple[Literal["d4pg", "abm", "bc", "crr_d"], ...] = ("d4pg", "abm", "bc", "crr_d")
    """that are trained; a task's policies can be published once all four are"""
    budget: Literal["full", "package", "cpu"] = "full"
    """3,200,000 updates and eight policies a run; 100,000 and two, with narrower networks; or 25,000 and two"""
    train: bool = False  # train what is not trained yet
    publish: bool = False  # write the library and measure it
    episodes: int = 1000  # a policy, with drawn actions
    most: int = 1000  # episodes at most, where the error is still large
    processes: int = 1  # that measure policies side by side
    table: bool = False  # print what the package's policies return
    out: str = "runs"  # the runs are OUT/unplugged-BUDGET-TASK-AGENT
    library: str = str(ROOT)  # folder that is published to


def main(options: Options) -> None:
    """Does what is asked for, in this order: train, publish, table."""
    cache_compiled_programs()
    size = SIZES[options.budget]
    every, total = size.snapshots[0], size.snapshots[-1]
    for task in options.only:
        folders = {name: Path(options.out) / f"unplugged-{options.budget}-{task}-{name}" for name in size.agents}
        if options.train:
            log = dr.load(collect(f"{task}-full-replay-v0"))
            for name in options.agents:
                agent = size.agents[name]
                with Bar(f"{name} on {task}", total, "updates") as bar:
                    dr.train(
                        agent, log, steps=total, seeds=SEEDS, evaluate_every=every, episodes=1, holdout=HELD_OUT,
                        out=folders[name], resume=True, watch=lambda progress, whole, bar=bar: bar(progress.step, whole),
                    )  # fmt: skip
        if options.publish:
            shipping = Shipping(
                episodes=options.episodes, most=options.most, processes=options.processes, out=options.library
            )  # fmt: skip
            print(publish_runs(folders, size.snapshots, shipping, watch=print))
    if options.table:
        print(table(options.only))


def table(names: tuple[str, ...]) -> str:
    """What the package's policies return with drawn actions, ± one standard error, by seed: a row for each task and agent.

    The last column is the difference to BC of the last snapshots' means over seeds, with Welch's interval. Below the table:
    the range of the returns of the package's policies, and of DOPE's.
    """
    published, ranges = published_returns(), []
    lines = ["| task | agent | updates | first snapshot | last snapshot | difference to BC |", "|---|---|---:|---|---|---:|"]
    for name in (name for name in names if name in published and name in library_tasks()):
        found: dict[str, dict[int, list[Returns]]] = {}
        for s in evaluated(name):
            found.setdefault(s.name.split("-")[0], {}).setdefault(s.updates, []).append(s.sampled)
        for agent, kept in found.items():
            first, last = min(kept), max(kept)
            seeds = (", ".join(f"{r.mean:,.0f} ± {r.error:.0f}" for r in kept[at]) for at in (first, last))
            own, clones = ([[r.mean] for r in each] for each in (kept[last], found["bc"][last]))
            gain = "" if agent == "bc" else f"{between(own, clones):.0f}"
            lines.append(f"| `{name}` | {agent} | {first:,}, {last:,} | {' | '.join(seeds)} | {gain} |")
        ours = [r.mean for kept in found.values() for returns in kept.values() for r in returns]
        theirs = [each.mean for each in published[name]]
        ranges.append(f"`{name}`: {min(ours):.0f} to {max(ours):.0f}, DOPE's {min(theirs):.0f} to {max(theirs):.0f}")
    return "\n".join([*lines, "", *ranges])


if __name__ == "__main__":
    main(tyro.cli(Options))
