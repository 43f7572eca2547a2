"""Every agent that learns from a log alone without a model of it, side by side on the same logs, beside thesis Table 7.1.

    python examples/agents_table.py                                                     (CPU budget, hours on two cores)
    python examples/agents_table.py --full --steps 500000 --seeds 8 --episodes 100 --logs ... --out runs/agents-full  (a GPU)

Each agent has the settings published for the log where there are any, else its defaults, at the CPU budget with the changes of
`BUDGET`: models of the log's policy are fitted for half the updates, and the networks of Maze2D are small. Logs are collected
where they are missing, runs go on where they were stopped, and the table is printed as Markdown.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gym_tables
import tyro

import deadreckon as dr
from deadreckon.agents import agent_class, preset, preset_for
from deadreckon.agents.agent import Agent
from deadreckon.bench.published import scores
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.report import write

# What is compared, by the name in the table: the agent, and the fields that differ from its preset or defaults.
COMPARED: dict[str, tuple[str, dict[str, Any]]] = {
    "BC": ("bc", {}),
    "SAC-off": ("sac", {}),
    "BEAR": ("bear", {}),
    "BRAC-p": ("brac", {"value_penalty": False}),
    "BRAC-v": ("brac", {}),
    "AWR": ("awr", {}),
    "BCQ": ("bcq", {}),
    "AlgaeDICE": ("algae_dice", {}),
    "CQL": ("cql", {}),
    "TD3": ("td3", {}),
    "TD3+BC": ("td3_bc", {}),
    "KL-control": ("kl_control", {}),
    "DQfD": ("dqfd", {}),
    "REM": ("rem", {}),
    "IQL": ("iql", {}),
    "XQL": ("xql", {}),
    "AWAC": ("awac", {}),
    "CRR": ("crr", {}),
    "ReBRAC": ("rebrac", {}),
    "SAC-N": ("sac_n", {}),
    "EDAC": ("edac", {}),
    "FQL": ("fql", {}),
    "Decision Transformer": ("decision_transformer", {}),
}
# What is smaller at the CPU budget, by agent.
BUDGET: dict[str, dict[str, Any]] = {
    "sac_n": {"critics": 10},
    "cql": {"hidden": (256, 256)},
    "fql": {"hidden": (256,) * 4},
    "decision_transformer": {"batch_size": 16, "lr": 1e-3, "warmup_steps": 1000},
}
@dataclass
class Options:
    """All agents on the same logs."""

    logs: tuple[str, ...] = ("maze2d-umaze-v1", "hopper-medium-v2")  # of the catalogue
    only: tuple[str, ...] = ()  # of the agents, by their names in the table; none: all
    steps: int = 10_000  # updates
    seeds: int = 3  # of each, as one program
    episodes: int = 20  # an evaluation, a seed
    full: bool = False  # settings as they are published, however long they take
    log_steps: int | None = 200_000  # rows of the logs; None: all of them
    width: int | None = None  # of every layer, for a quick look; None: as described above
    out: str = "runs/agents"  # the runs are OUT/LOG/AGENT


def settings(label: str, log: str, options: Options) -> Agent:
    """An agent for a log, within the budget."""
    name, fields = COMPARED[label]
    published = preset_for(name, log)
    kind = agent_class(name)
    agent = kind(**(preset(name, published) if published else {}) | fields)
    if not options.full:
        fitted = {"behavior_steps": options.steps // 2} if hasattr(agent, "behavior_steps") else {}
        agent = agent.replace(**BUDGET.get(name, {}) | fitted)
    width = options.width or (64 if log.startswith("maze2d") and not options.full else None)
    widths = [field for field in ("hidden", "behavior_hidden") if width and getattr(agent, field, None)]
    return agent.replace(**{field: (width,) * len(getattr(agent, field)) for field in widths})


def main(options: Options) -> None:
    """Trains what is not trained yet; then shows all of it."""
    cache_compiled_programs()
    labels = list(options.only or COMPARED)
    if missing := [label for label in labels if label not in COMPARED]:
        raise SystemExit(f"--only: no agent is called {', '.join(missing)}: choose from {', '.join(COMPARED)}")
    folders = {log: {label: Path(options.out) / log / label for label in labels} for log in options.logs}
    for log, runs in folders.items():
        data = gym_tables.log_of(log, options.log_steps)
        for label, folder in runs.items():
            with Bar(f"{label} on {log}", options.steps, "updates") as bar:
                dr.train(
                    settings(label, log, options), data, steps=options.steps, seeds=options.seeds, episodes=options.episodes,
                    out=folder, resume=folder.exists(), chunk=min(1000, options.steps),
                    watch=lambda progress, steps, bar=bar: bar(progress.step, steps),
                )  # fmt: skip
        title = f"{log}, {options.steps:,} updates"
        print(write(list(runs.values()), Path(options.out) / log / "report.html", title=title))
    print("\n" + markdown(folders))


def markdown(folders: dict[str, dict[str, Path]]) -> str:
    """Scores of the last evaluation with 95 % intervals over seeds and episodes, a row an agent, the thesis's beside them."""
    logs = list(folders)
    behaviour = [f"{gym_tables.behaviour(dr.load_run(next(iter(runs.values())))):.1f}" for runs in folders.values()]
    heads = [head for log in logs for head in (f"{log}: score", "thesis")]
    lines = ["| agent | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    lines.append("| the log's own policy | " + " | ".join(f"{mean} | " for mean in behaviour) + " |")
    for label in next(iter(folders.values())):
        cells = []
        for log in logs:
            run = dr.load_run(folders[log][label])
            cells += [gym_tables.last_score(run), str(scores(log).get({"AlgaeDICE": "aDICE"}.get(label, label), ""))]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main(tyro.cli(Options))
