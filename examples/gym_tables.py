"""Results on the Gym-MuJoCo logs: the tables and figures of thesis chapters 4 and 7, from one declared set of runs.

    python examples/gym_tables.py --steps 20000 --seeds 3                                    (CPU budget)
    python examples/gym_tables.py --steps 500000 --seeds 5 --episodes 100 --out runs/gym-full         (a GPU)
    python examples/gym_tables.py --groups constraint ablations --steps 500000 --seeds 5 --out runs/gym-full

Logs are collected where they are missing; runs go on where they were stopped; each log gets a report page, and the table of
all logs is printed as Markdown.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro

import deadreckon as dr
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.collect import collect, recipe
from deadreckon.collect.recipes import default_path
from deadreckon.report import picture, table, write
from deadreckon.stats.crossed import mean_interval

AGENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "bc": ("bc", {}),
    "td3": ("td3", {}),
    "td3_bc": ("td3_bc", {}),
    "sac": ("sac", {}),
    "bear": ("bear", {}),
}
# BEAR and what chapter 4 and appendix A change about it.
CONSTRAINTS = {
    "bear": ("bear", {}),
    "bear-n10": ("bear", {"behavior_samples": 10}),
    "bear-kl": ("bear", {"constraint": "kl"}),
}
ABLATIONS = {
    "bear-kl-tuned-0.1": ("bear", {"constraint": "kl", "dual": False, "multiplier": 0.1}),
    "bear-kl-tuned-1": ("bear", {"constraint": "kl", "dual": False, "multiplier": 1.0}),
    "bear-kl-tuned-10": ("bear", {"constraint": "kl", "dual": False, "multiplier": 10.0}),
    "bear-laplacian-10": ("bear", {"bandwidth": 10.0}),
    "bear-laplacian-40": ("bear", {"bandwidth": 40.0}),
    "bear-gaussian": ("bear", {"kernel": "gaussian"}),
    "bear-mixture": ("bear", {"kernel": "mixture"}),
    "bear-actor": ("bear", {"test_action": "actor"}),
    "bear-no-actor-maximisation": ("bear", {"warm_start": 2**31 - 1}),  # longer than any run
    "bear-density-weighting": ("bear", {"density_weighting": True}),
    "bear-vae": ("bear", {"behavior": "vae"}),
    "bear-mean-critic": ("bear", {"actor_value": "mean"}),  # better on Walker2d (A.4)
    "bear-threshold-0.25": ("bear", {"threshold": 0.25}),  # above what two sets of draws of one policy have: can be met
}


@dataclass(frozen=True)
class Group:
    """Logs, the agents trained on each of them, and how many rows of the logs they see (None: all)."""

    logs: tuple[str, ...]
    agents: dict[str, tuple[str, dict[str, Any]]]
    rows: tuple[int | None, ...] = (None,)
    about: str = ""


GROUPS = {
    "table": Group(
        tuple(f"{task}-{kind}-v2" for kind in ("medium", "random", "medium-expert") for task in ("hopper", "halfcheetah")),
        AGENTS, about="thesis Table 7.1; Figure 4.3, medium",
    ),
    "medium": Group(("walker2d-medium-v2", "ant-medium-v2"), AGENTS, about="Figure 4.3, the other two"),
    "extremes": Group(
        tuple(f"{task}-{kind}-v2" for kind in ("uniform", "expert") for task in ("hopper", "halfcheetah", "walker2d", "ant")),
        {name: AGENTS[name] for name in ("bc", "td3", "bear")}, about="Figure 4.5",
    ),
    "humanoid": Group(("humanoid-medium-v2", "humanoid-uniform-v2"), AGENTS, about="Figure 4.4; needs policies of humanoid"),
    "size": Group(
        ("halfcheetah-expert-v2",), {name: AGENTS[name] for name in ("sac", "td3")}, (10_000, 100_000, None), "Figure 4.1"
    ),
    "constraint": Group(("hopper-medium-v2", "walker2d-medium-v2"), CONSTRAINTS, about="Figure 4.6"),
    "ablations": Group(("hopper-medium-v2", "walker2d-medium-v2"), ABLATIONS, about="A.3-A.5, Figures A.2-A.6"),
}  # fmt: skip


@dataclass
class Options:
    """Results on the Gym-MuJoCo logs."""

    groups: tuple[str, ...] = ("table",)  # which of table, medium, extremes, humanoid, size, constraint, ablations
    logs: tuple[str, ...] = ()  # only these logs of the groups; none: all of them
    only: tuple[str, ...] = ()  # only these agents of the groups; none: all of them
    steps: int = 20_000  # updates an agent
    seeds: int = 3  # an agent
    episodes: int = 10  # an evaluation, a seed
    log_steps: int | None = None  # rows of the logs; None: all of them
    hidden: tuple[int, ...] = (256, 256)  # layers of actor and critics
    out: str = "runs/gym"  # folder of runs and pages
    picture: str | None = None  # SVG file of curves, a panel a log
    quantity: str = "score"  # what is drawn there: a column of the evaluations or metrics, such as q or mmd
    symlog: bool = False  # on a symmetric logarithmic axis


def main(options: Options) -> None:
    """Trains what is not trained yet; then shows all of it."""
    cache_compiled_programs()
    shown: dict[str, list[Path]] = {}
    for name in options.groups:
        group = GROUPS[name]
        for log in (one for one in group.logs if not options.logs or one in options.logs):
            for rows in group.rows:
                folder = Path(options.out) / (log if rows is None else f"{log}-{rows}-rows")
                for label, (agent, fields) in group.agents.items():
                    if options.only and label not in options.only:
                        continue
                    shown.setdefault(folder.name, []).append(folder / label)
                    _train(folder / label, log, rows, agent, fields, options)
    for name, folders in shown.items():
        print(f"\n{name}\n{table(folders)}")
        print(write(folders, Path(options.out) / name / "report.html", title=f"{name}, {options.steps:,} updates"))
    if options.picture:
        of_logs = {name: {"behaviour": behaviour(dr.load_run(folders[0]))} for name, folders in shown.items()}
        references = of_logs if options.quantity == "score" else None
        print(picture(options.picture, shown, quantity=options.quantity, references=references, symlog=options.symlog))
    print("\n" + markdown(shown))


def _train(folder: Path, log: str, rows: int | None, agent: str, fields: dict[str, Any], options: Options) -> None:
    data = log_of(log, options.log_steps)
    if rows is not None:
        data = data.select(np.arange(np.searchsorted(data.ends, rows)), name=f"{data.name}-{rows}-rows")
    with Bar(f"{folder.name} on {folder.parent.name}", options.steps, "updates") as bar:
        dr.train(
            dr.agents.agent_class(agent)(hidden=options.hidden, **fields), data, steps=options.steps, seeds=options.seeds,
            episodes=options.episodes, out=folder, resume=folder.exists(), chunk=min(1000, options.steps),
            watch=lambda progress, steps: bar(progress.step, steps),
        )  # fmt: skip


@lru_cache(1)
def log_of(name: str, steps: int | None) -> dr.Dataset:
    """A log of the catalogue, or as many of its steps; collected where it is missing."""
    path = default_path(recipe(name), steps, 0)
    if not path.exists():
        with Bar(f"collecting {name}", steps or recipe(name).steps, "steps") as bar:
            collect(name, steps=steps, out=path, progress=bar)
    return dr.read(path)


def behaviour(run: dr.Run) -> float:
    """Score of the log's own policy."""
    return float(dr.tasks.task(run.config["task"]).reference.normalise(run.config["data"]["behavior"]["mean"]))


def markdown(shown: dict[str, list[Path]]) -> str:
    """Scores of the last evaluation with 95 % intervals over seeds and episodes, a row a log, a column an agent."""
    labels = list(dict.fromkeys(path.name for folders in shown.values() for path in folders))
    lines = ["| log | behaviour | " + " | ".join(labels) + " |", "|---|---:|" + "---:|" * len(labels)]
    for name, folders in shown.items():
        runs = {folder.name: dr.load_run(folder) for folder in folders}
        cells = [last_score(runs[label]) if label in runs else "" for label in labels]
        lines.append(f"| {name} | {behaviour(next(iter(runs.values()))):.1f} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def last_score(run: dr.Run) -> str:
    """Score of the last evaluation, with a 95 % interval over seeds and episodes."""
    # A seed that failed keeps its last good policy, which is what is judged of it; the table says so.
    steps = np.asarray(run.evaluations["step"])
    last = run.evaluations.filter(steps == steps.max())
    scores = np.asarray(last["score"]).reshape(len(run.seeds), -1)
    failed = sum(failure is not None for failure in run.failures)
    return str(mean_interval(scores)) + (f" ({failed} of {len(run.seeds)} failed)" if failed else "")


if __name__ == "__main__":
    main(tyro.cli(Options))
