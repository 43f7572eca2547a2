"""The walker of the AntMaze logs: how it was trained, shipped and judged.

    python tools/antmaze_walker.py --train                 (45 minutes on a core; goes on where it was stopped)
    python tools/antmaze_walker.py --publish 260416        (ships the policy that was kept after so many updates)
    python tools/antmaze_walker.py --judge                 (what becomes of its errands in mazes)
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

import deadreckon as dr
from deadreckon.agents.sac import SAC
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.collect.antmaze import WALKER, Errands, walker
from deadreckon.files import read_json, write_json
from deadreckon.online import Online
from deadreckon.policies import store
from deadreckon.runs.folder import Folder
from deadreckon.tasks.antmaze import REACH_TASK, TASKS, AntMaze

STEPS = 540_000  # environment steps
SETTINGS = Online(updates_per_step=0.5)
AGENT = SAC(batch_size=128, target_entropy=-4.0)


@dataclass
class Options:
    """Online SAC on open ground, for AntMaze."""

    train: bool = False  # train what is not trained yet
    publish: int | None = None  # ship the policy after so many updates
    judge: bool = False  # send it through the mazes
    episodes: int = 100  # of open ground and of each maze
    out: str = "runs/sac-ant-reach"  # the run


def main(options: Options) -> None:
    """Does what is asked for, in this order: train, publish, judge."""
    cache_compiled_programs()
    if options.train:
        with Bar("sac in ant-reach", SETTINGS.updates(STEPS), "updates") as bar:
            dr.train_online(
                AGENT, REACH_TASK.name, steps=STEPS, settings=SETTINGS, evaluate_every=20_000, episodes=20, out=options.out,
                resume=True, watch=lambda progress, updates: bar(progress.step, updates),
            )  # fmt: skip
    if options.publish is not None:
        publish(options)
    if options.judge:
        for task in TASKS:
            print(judged(task, options.episodes), flush=True)


def judged(task: AntMaze, episodes: int) -> str:
    """A row of Markdown: what becomes of ants that are sent through a maze as in its log."""
    guide = Errands(task, walker(), copies=episodes)
    simulator = replace(task, anywhere=guide.wanders).simulate(range(episodes))
    seen = simulator.reset()
    for copy in range(episodes):
        guide.begin(simulator, copy, seen[copy], np.random.default_rng(copy))
    running, steps = np.arange(episodes), 0
    while len(running):
        seen, _, terminals, timeouts = simulator.step(guide.act(seen, running)[0])
        steps += len(running)
        running = running[~(terminals | timeouts)[running]]
    x, y = seen[:, 4:6].T
    lying = ~simulator.achieved & (x**2 + y**2 > 0.5)  # z of the torso's own axis below 0
    cells = [guide.sent / episodes, steps / guide.sent]
    shares = [simulator.achieved.mean(), lying.mean()]
    return f"| `{task.name}` | {cells[0]:.1f} | {cells[1]:.0f} | {shares[0]:.0%} | {shares[1]:.0%} |"


def publish(options: Options) -> None:
    """Writes the policy and, beside it, how it was made and what it earns on open ground."""
    folder = Folder(Path(options.out))
    config, updates = read_json(folder.config), options.publish
    assert updates is not None
    meta = {"task": REACH_TASK.name, "updates": updates, "agent": "sac"}
    store.save(WALKER, store.load(folder.policy(0, updates)), meta, half=True)
    earned = dr.evaluate(store.load(WALKER), REACH_TASK.name, episodes=options.episodes, seed=1_000_000).returns[0]
    about = {
        "task": REACH_TASK.name, "agent": config["agent"]["fields"], "online": config["online"], "seeds": config["seeds"],
        "updates": updates, "environment_steps": SETTINGS.steps(updates), "versions": config["versions"],
        "return": {"episodes": len(earned), "mean": float(earned.mean()),
                   "error": float(earned.std(ddof=1) / np.sqrt(len(earned)))},
    }  # fmt: skip
    write_json(WALKER.with_suffix(".json"), about)
    print(WALKER, about["return"])


if __name__ == "__main__":
    main(tyro.cli(Options))
