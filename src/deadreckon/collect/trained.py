"""Rows of a training online, which logs are made of."""

from pathlib import Path

from deadreckon.agents.agent import Agent
from deadreckon.collect.growing_log import asked_for, same_collection
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Spec
from deadreckon.online import Exploration, Online
from deadreckon.progress import Progress
from deadreckon.tasks.task import Task
from deadreckon.training.fit import Fit, complete

CHUNK = 2000  # updates between checkpoints


def train_for_rows(
    task: Task,
    agent: Agent,
    settings: Online,
    *,
    name: str,
    steps: int,
    seed: int,
    folder: Path,
    provenance: Provenance,
    threads: int | None,
    progress: Progress | None,
) -> Path:
    """Trains an agent online; goes on with what it finds in `folder`.

    Args:
        task: where.
        agent: that learns.
        settings: how acting and learning take turns.
        name: of the recipe, for messages.
        steps: environment steps, the random ones at the beginning included.
        seed: of the training.
        folder: of the training, which is resumed after a kill.
        provenance: of the log: a folder with the beginning of another is refused.
        threads: to simulate with.
        progress: called with rows done and rows in all.

    Returns:
        The replay file, with `steps` rows or more.
    """
    spec = Spec.empty(task.observation_shape, task.action_space, task.name)
    # The last block goes beyond the rows where they do not fill it.
    updates = settings.updates(max(steps, settings.explore + 1) + settings.block - 1)
    lanes, path = [agent.resolve(spec, updates)], folder / "rows.bin"
    same_collection(folder, asked_for(name, seed, [steps], provenance))
    experience = Exploration(task, lanes[0], [seed], updates, settings, [path], threads)
    job = Fit(lanes, experience, [seed], updates, CHUNK, folder / "checkpoints")
    told = (lambda done: progress(min(experience.count, steps), steps)) if progress else (lambda done: None)
    complete(job, f"{name}: training with seed {seed}", told, advice="")
    return path
