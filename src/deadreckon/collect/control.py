"""How the logs of dm_control's tasks are made (thesis 8.4, Table 8.1): episodes from the whole of a training of D4PG online.

RL Unplugged (Gulcehre et al. 2020) keeps a part of what its agents did, from the first to the last of their training. So does
this: whole episodes, evenly spaced over it.
"""

import dataclasses
from pathlib import Path

import jax

from deadreckon.agents.d4pg import D4PG
from deadreckon.collect.rollouts import acted_in
from deadreckon.collect.trained import train_for_rows
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import VERSION
from deadreckon.errors import UserError
from deadreckon.online import Online, episodes_log
from deadreckon.progress import Progress
from deadreckon.tasks.control import Control

AGENT = D4PG(n_step=5)
# An update for every eight steps, as in Acme.
ONLINE = Online(copies=8, explore=1_000, updates_per_step=0.125, block=64)
# Environment steps of the training from which the episodes come: enough for D4PG to learn the task, where it does.
TRAINED = {
    "cartpole-swingup": 400_000,
    "cheetah-run": 2_000_000,
    "finger-turn-hard": 600_000,
    "fish-swim": 1_200_000,
    "humanoid-run": 20_000_000,
    "manipulator-insert-ball": 20_000_000,
    "manipulator-insert-peg": 20_000_000,
    "walker-stand": 400_000,
    "walker-walk": 400_000,
}


def collect_control(
    task: Control,
    *,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Trains D4PG in a task and keeps a part of its episodes.

    Args:
        task: where.
        name: of the recipe, such as `walker-stand-full-replay-v0`.
        steps: rows of the log, a multiple of the 1,000 of an episode. The training is as long whatever they are.
        scratch: folder of the training, which is resumed after a kill.
        seed: of the training.
        threads: to simulate with.
        progress: called with the environment steps done and those in all.

    Raises:
        UserError: no whole number of episodes, or more of them than the training has; or dm_control is not installed.
    """
    task.check_installed()
    trained = TRAINED[task.name]
    if steps % task.horizon or steps > trained:
        most = f"a multiple of {task.horizon:,}, {trained:,} at most"
        raise UserError(f"{name} has whole episodes of its training: steps must be {most}, got {steps:,}")
    extra = {
        "task": task.name, "training": vars(AGENT), "revision": AGENT.revision, "online": dataclasses.asdict(ONLINE),
        "trained": trained, "actions": "with noise, uniform at first", "device": jax.default_backend(),
    }  # fmt: skip
    provenance = acted_in("dm_control", name, seed, extra)
    path = train_for_rows(
        task, AGENT, ONLINE, name=name, steps=trained, seed=seed, folder=scratch / "training", provenance=provenance,
        threads=threads, progress=progress,
    )  # fmt: skip
    return episodes_log(
        path, task, ONLINE.copies, trained, steps // task.horizon, name=f"{name}@{VERSION}", provenance=provenance
    )
