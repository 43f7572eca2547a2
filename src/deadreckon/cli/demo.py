"""`deadreckon demo`: the whole path in minutes: a log, policies, a decision from the log alone, its check, and a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Bar, Watch
from deadreckon.errors import UserError
from deadreckon.files import alone
from deadreckon.interrupts import resumable

AGENTS = ("bc", "bcq", "iql", "cql", "rem")
HIDDEN = (64, 64)  # small networks: the demo is to be seen within minutes on two cores
HELD = 0.2  # of the days are held out to judge on
EPISODES = 400  # of each policy in the simulator; as training goes on, half as many


@dataclass
class Demo:
    """Collect a battery operator's log, train five agents on it, decide on held-out days and check; results are reused."""

    out: str = "runs/demo"  # folder of the log, the runs and report.html
    seed: int = 0  # random seed of the log, and first seed of each agent
    seeds: int = 3  # number of runs of each agent
    days: int = 2_000  # number of logged days
    steps: int = 6_000  # updates of each run


def demo(args: Sequence[str]) -> None:
    """Runs the demo and prints its table."""
    options = parse(Demo, args, "demo")
    if min(options.steps, options.seeds, options.days) < 1 or options.seed < 0:
        raise UserError("steps, seeds and days must be >= 1, seed >= 0")
    out = Path(options.out)
    with alone(out, what=str(out)), resumable(out):
        _demonstrate(options, out)


def _demonstrate(options: Demo, out: Path) -> None:
    """The demo in the folder `out`, which nobody else writes to."""
    from deadreckon.agents import agent_class
    from deadreckon.collect.battery import collect_battery
    from deadreckon.data.formats.hdf5 import write_hdf5
    from deadreckon.data.formats.io import read
    from deadreckon.report import table, write
    from deadreckon.runs.offline import checked, grounds, judge, supports
    from deadreckon.runs.train import train
    from deadreckon.tasks.battery import TASK

    path = out / f"{TASK.name}-{options.days}-days-seed{options.seed}.hdf5"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_hdf5(collect_battery(options.days, options.seed), path)
    log = read(path)
    print(f"{log}\n")

    folders = []
    for name in AGENTS:
        folder = out / name
        with Bar(f"{name:<7}", options.steps, "updates") as bar:
            agent = agent_class(name)()
            agent = agent.replace(**{field: HIDDEN for field in ("hidden", "behavior_hidden") if hasattr(agent, field)})
            train(
                agent, log, steps=options.steps, seeds=options.seeds, seed=options.seed, task=TASK, holdout=HELD, out=folder,
                episodes=EPISODES // 2, resume=folder.exists(),
                watch=lambda progress, steps, bar=bar: bar(progress.step, steps),
            )  # fmt: skip
        folders.append(folder)
    # A day ends by itself, so nothing needs discounting. What is deployed takes its best action: even a clone earns more
    # without what the operator tries now and then. The simulator is asked after the decision.
    with Watch() as watch:
        judged = judge(
            folders, log, "auto", out=out / "ope", task=TASK, episodes=EPISODES, discount=1.0, greedy=True, seed=options.seed,
            watch=watch,
        )  # fmt: skip
    page = write(folders, out / "report.html", title="From a log to a decision", estimates=out / "ope")
    print(f"in the simulator:\n\n{table(folders)}\n")
    held = dict(grounds(judged.results))["evaluated on"]
    print(f"from the log alone, on {held}:\n\n{judged.estimates[0]}\n\n{supports(judged.results)}\n")
    print(f"{judged.choice}\n\nchecked: {checked(judged.results)}\n\nreport: {page}")
