"""Chapter 5 as one declared set of runs: MBPO beside SAC and its rivals (Figure 5.2), and what of it matters (5.3).

    python examples/mbpo_curves.py --task inverted-pendulum --steps 10000 --seeds 1     (a quarter of an hour a run on a CPU)
    python examples/mbpo_curves.py --task hopper --steps 130000 --seeds 3 --groups compare length         (a GPU)

Runs go on where they were stopped. Returns after so many environment steps are printed as Markdown, and --picture draws them.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import deadreckon as dr
from deadreckon.agents import MBPO, MVE, PETS, PPO, SAC, SLBO, STEVE
from deadreckon.agents.agent import Agent
from deadreckon.agents.model_based import PRESETS
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.online import Online
from deadreckon.report import picture


@dataclass
class Options:
    """MBPO, and SAC without a model."""

    task: str = "hopper"  # simulator to learn in
    groups: tuple[str, ...] = ("compare",)  # among compare, rivals, pets, ratio, length, expansion
    only: tuple[str, ...] = ()  # of their runs, by name; none: all
    rollouts: int | None = None  # of MBPO, begun for each real step; None: 400; give OUT another name than before
    updates: float | None = None  # a real step, of MBPO, MVE, STEVE and the SAC beside them; None: the task's
    steps: int = 130_000  # environment steps, the 5,000 random ones included
    seeds: int = 3  # of each run, as one program
    every: int = 1000  # environment steps between evaluations
    episodes: int = 10  # an evaluation
    out: str = "runs/mbpo"  # the runs are OUT/TASK/VARIANT
    picture: str | None = None  # SVG file of the learning curves


Runs = dict[str, tuple[Agent, Online]]


def variants(group: str, task: str, rollouts: int | None = None, updates: float | None = None) -> Runs:
    """The runs of a group, by name."""
    acting = MBPO.acting(task) | ({} if updates is None else {"updates_per_step": updates})
    made = {} if rollouts is None else {"rollouts_per_step": rollouts}
    own = PRESETS.get(task, {}).get("target_entropy")

    def sac(ratio: float) -> tuple[Agent, Online]:
        return SAC(target_entropy=own), Online(**acting | {"updates_per_step": ratio})

    def mbpo(*length: int) -> tuple[Agent, Online]:
        return MBPO(rollout_length=length or None, **made), Online(**acting)

    return {
        # SAC with as many updates a step as MBPO, and as it usually is.
        "compare": {"mbpo": mbpo(), f"sac-{acting['updates_per_step']:g}": sac(acting["updates_per_step"]), "sac-1": sac(1)},
        "rivals": {"mve": (MVE(), Online(**acting)), "steve": (STEVE(), Online(**acting)),
                   "slbo": (SLBO(), Online(**SLBO.acting(task))), "ppo": (PPO(), Online(**PPO.acting(task)))},
        "pets": {"pets": (PETS(), Online(**PETS.acting(task))), "pets-small": (PETS.small(), Online(**PETS.acting(task)))},
        "expansion": {f"mve-h{h}": (MVE(horizon=h), Online(**acting)) for h in (3, 5)},
        "ratio": {f"sac-{ratio}": sac(ratio) for ratio in (1, 5, 10, 20, 40)},
        "length": {name: mbpo(*length) for name, length in lengths(task).items()},
    }[group]


def lengths(task: str) -> dict[str, tuple[int, ...]]:
    """Rollout lengths to compare: 1, a schedule (the task's own where it has one), 200 and 500."""
    own = PRESETS.get(task, {}).get("rollout_length", (1, 1))
    schedule = {"mbpo": ()} if own[0] < own[1] else {"mbpo-k1-15": (1, 15, 1, 5)}
    return schedule | {f"mbpo-k{k}": (k, k, 1, 2) for k in (1, 200, 500)}


def main(options: Options) -> None:
    """Trains what is not trained yet, prints, and draws."""
    cache_compiled_programs()
    groups = [variants(group, options.task, options.rollouts, options.updates) for group in options.groups]
    known = {name: run for group in groups for name, run in group.items()}
    if missing := set(options.only).difference(known):
        raise SystemExit(f"--only: no run is called {', '.join(sorted(missing))}: choose from {', '.join(known)}")
    asked = {name: run for name, run in known.items() if not options.only or name in options.only}
    folders = {name: Path(options.out) / options.task / name for name in asked}
    for name, (agent, settings) in asked.items():
        with Bar(f"{name} in {options.task}", settings.updates(options.steps), "updates") as bar:
            dr.train_online(
                agent, options.task, steps=options.steps, seeds=options.seeds, settings=settings, out=folders[name],
                evaluate_every=options.every, episodes=options.episodes, resume=True,
                watch=lambda progress, updates, bar=bar: bar(progress.step, updates),
            )  # fmt: skip
    print(markdown(folders, {name: settings for name, (_, settings) in asked.items()}))
    if options.picture:
        names = {folder.name: name for name, folder in folders.items()}
        print(picture(options.picture, {options.task: list(folders.values())}, quantity="return", names=names))


def markdown(folders: dict[str, Path], settings: dict[str, Online]) -> str:
    """Mean returns of all seeds and episodes, from least to greatest seed, after six shares of the run."""
    rows = []
    for name, folder in folders.items():
        run = dr.load_run(folder)
        found = run.evaluations.to_pydict()
        updates, returns, seeds = (np.asarray(found[key]) for key in ("step", "return", "seed"))
        judged, cells = np.unique(updates), []
        for update in judged[np.linspace(0, len(judged) - 1, 6).astype(int)]:
            means = [returns[(updates == update) & (seeds == seed)].mean() for seed in run.seeds]
            spread = f" ({min(means):,.0f} to {max(means):,.0f})" if len(means) > 1 else ""
            cells.append(f"{settings[name].steps(int(update)):,}: {np.mean(means):,.0f}{spread}")
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(["| run |" + " return after so many environment steps |" * 6, "|---|" + "---:|" * 6, *rows])


if __name__ == "__main__":
    main(tyro.cli(Options))
