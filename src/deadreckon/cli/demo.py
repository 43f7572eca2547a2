"""`deadreckon demo`: the whole path in minutes: a log, policies, a choice from the log alone, its check, and a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Bar, Watch
from deadreckon.errors import UserError

TASK, LOG = "maze2d-umaze", "maze2d-umaze-v1"
AGENTS = ("bc", "td3", "sac", "td3_bc", "bear")
HIDDEN = (64, 64)  # small networks: the demo is to be seen within minutes on two cores


@dataclass
class Demo:
    """Collect a maze log, learn from it five ways, choose from the log alone, check that. A second run reuses all."""

    out: str = "runs/demo"  # folder of the log, the runs and report.html
    seed: int = 0  # of the log and the first of each agent's
    seeds: int = 2  # an agent
    log_steps: int = 200_000  # collected
    steps: int = 25_000  # updates an agent


def demo(args: Sequence[str]) -> None:
    """Runs the demo and prints its table."""
    options = parse(Demo, args, "demo")
    from deadreckon.agents import agent_class
    from deadreckon.collect import collect
    from deadreckon.data.io import read
    from deadreckon.ope import FQE, BehaviorModel
    from deadreckon.report import headline, table, write
    from deadreckon.runs.offline import checked, judge
    from deadreckon.runs.train import train

    if min(options.steps, options.seeds, options.log_steps) < 1 or options.seed < 0:
        raise UserError("steps, seeds and log_steps must be >= 1, seed >= 0")
    out = Path(options.out)
    path = out / f"{LOG}-{options.log_steps}-seed{options.seed}.hdf5"
    if not path.exists():
        with Bar(f"collecting {LOG}", options.log_steps, "steps") as bar:
            collect(LOG, steps=options.log_steps, seed=options.seed, out=path, progress=bar)
    log = read(path)
    print(f"{log}\n")

    folders = []
    for name in AGENTS:
        folder = out / name
        with Bar(f"{name:<7}", options.steps, "updates") as bar:
            agent = agent_class(name)().replace(hidden=HIDDEN)
            train(
                agent, log, steps=options.steps, seeds=options.seeds, seed=options.seed, task=TASK, out=folder,
                resume=folder.exists(), watch=lambda progress, steps, bar=bar: bar(progress.step, steps),
            )  # fmt: skip
        folders.append(folder)
    # A quick target network: values reach back from the goal in fewer updates.
    estimator = FQE(hidden=HIDDEN, lr=1e-3, target_rate=0.02, members=3, steps=max(1, options.steps // 2))
    with Watch() as watch:
        judged = judge(
            folders, log, [estimator], out=out / "ope", task=TASK, discount=0.99, greedy=True, seed=options.seed,
            model=BehaviorModel(hidden=HIDDEN, lr=1e-3, steps=max(1, options.steps // 5)), watch=watch,
        )  # fmt: skip
    page = write(folders, out / "report.html", title="From a log to a judged policy", estimates=out / "ope")
    print(f"{table(folders)}\n\nin the simulator: {headline(folders)}")
    print(f"\nfrom the log alone: {judged.choice}\nchecked: {checked(judged.told)}\n\nreport: {page}")
