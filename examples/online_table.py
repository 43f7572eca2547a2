"""SAC that learns online with as many steps as a task's log has rows, the first column of thesis Table 7.1.

    python examples/online_table.py --steps 30000                             (CPU budget, about ten minutes a task)
    python examples/online_table.py --seeds 3 --episodes 100 --out runs/online-full                    (as many as the logs)

Runs go on where they were stopped, and the table is printed as Markdown.
"""

from dataclasses import dataclass
from pathlib import Path

import tyro

import deadreckon as dr
from deadreckon.agents.sac import SAC
from deadreckon.bench.published import scores
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.data.catalogue import entry
from deadreckon.online import Online

LOGS = (
    "maze2d-umaze-v1", "antmaze-umaze-v2", "door-human-v1", "kitchen-complete-v0", "flow-ring-controller-v0",
    "flow-merge-controller-v0", "hopper-medium-v2", "halfcheetah-medium-v2", "walker2d-medium-v2",
)  # fmt: skip


@dataclass
class Options:
    """Online SAC, every field at its default."""

    logs: tuple[str, ...] = LOGS  # in whose tasks; each stands for all logs of its task
    steps: int | None = None  # environment steps; None: rows of the log, of short ones 1,000,000
    seeds: int = 3  # side by side
    episodes: int = 20  # an evaluation, a seed
    threads: int | None = None  # to simulate with; None: all cores
    out: str = "runs/online"  # the runs are OUT/TASK


def main(options: Options) -> None:
    """Trains what is not trained yet, and prints the table."""
    cache_compiled_programs()
    rows = []
    for log in options.logs:
        task = entry(log).task
        # Of people's demonstrations there are too few to learn from them online: the task's other logs have so many.
        steps = options.steps or max(entry(log).rows, 1_000_000)
        with Bar(f"sac in {task}", Online(**SAC.acting(task)).updates(steps), "updates") as bar:
            run = dr.train_online(
                SAC(), task, steps=steps, seeds=options.seeds, evaluate_every=-(-steps // 5), episodes=options.episodes,
                threads=options.threads, out=Path(options.out) / task, resume=True,
                watch=lambda progress, updates, bar=bar: bar(progress.step, updates),
            )  # fmt: skip
        found = dr.evaluate(run, task, episodes=options.episodes)
        by_seed = ", ".join(f"{each.mean():.1f}" for each in found.scores)
        thesis = scores(log).get("SAC")
        cells = [task, f"{steps:,}", found.score(), by_seed, f"{found.returns.mean():.1f}", "" if thesis is None else thesis]
        rows.append(f"| {' | '.join(map(str, cells))} |")
        print(rows[-1], flush=True)
    print("| task | steps | score | by seed | return | thesis |\n|---|---:|---|---|---:|---:|")
    print("\n".join(rows))


if __name__ == "__main__":
    main(tyro.cli(Options))
