"""How the kitchen logs are made: a scripted demonstrator takes the place of people (thesis 7.3; Gupta et al. 2020).

It leads the hand from waypoint to waypoint through MuJoCo's Jacobian, sub-task by sub-task. It knows where the things stand,
sees what a policy sees, and remembers how far it has got, so the behaviour that is logged is not Markovian.

Rewards and ends are those that D4RL's script gives demonstrations (`generate_kitchen_datasets.py`), which are not the task's:
a row earns as many of the wanted sub-tasks as are done in what it observes, and the last one of a demonstration is a terminal.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.collect.growing_log import asked_for, collected, same_collection
from deadreckon.collect.kitchen_demonstrator import KNOWN, Demonstrator
from deadreckon.data.catalogue import version_of
from deadreckon.data.dataset import Dataset
from deadreckon.data.kitchen import ELEMENTS, JOINTS
from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.progress import Progress
from deadreckon.tasks.kitchen import Kitchen

BATCH = 16  # episodes side by side; part of the recipe, so that data does not depend on the machine
DIRECTED = 4  # in the partial log, one episode in so many is directed to the task
_COLUMNS = ("observations", "actions", "rewards")


def _errand(task: Kitchen, number: int, generator: np.random.Generator) -> list[str]:
    """What an episode's demonstrator is told to do: the task, or four sub-tasks at random."""
    kind = task.name.removeprefix("kitchen-")
    if kind == "complete" or (kind == "partial" and number % DIRECTED == 0):
        return list(task.elements)
    while True:
        drawn = [KNOWN[i] for i in generator.permutation(len(KNOWN))[: len(task.elements)]]
        if set(drawn) != set(task.elements):  # only the directed ones solve the task
            return drawn


def collect_kitchen(
    task: Kitchen,
    *,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Collects one of the three kinds of log, which the task's name says.

    `kitchen-complete`: the task's four sub-tasks in order; episodes at whose end not all are done are left out.
    `kitchen-partial`: one episode in four tries these, the others four of the six sub-tasks that the demonstrator knows, at
    random. `kitchen-mixed`: only others, so that none solves the task. An episode ends where the demonstrator is through with
    its list, or after 280 steps: in both cases with a terminal, as in D4RL's logs.

    Args:
        task: where, and which kind.
        name: of the recipe, such as `kitchen-mixed-v0`.
        steps: rows; the last episode is cut where they are full, by a timeout.
        scratch: folder of a collection under way, which is resumed after a kill.
        seed: random seed.
        threads: to simulate with; all cores if None. The log does not depend on it.
        progress: called now and then with the rows done and `steps`.
    """
    extra = {"task": task.name, "policies": ["demonstrator"], "noise": [task.noise, task.object_noise]}
    provenance = collected(name, seed, ("mujoco", "gymnasium-robotics", "numpy"), extra)
    same_collection(scratch, asked_for(name, seed, [steps], provenance))
    parts: list[dict[str, np.ndarray]] = []
    rows, batch = 0, 0
    while rows < steps:
        if batch > 10 and not parts:
            raise UserError(f"{name}: the demonstrator solved none of the first {batch * BATCH} episodes")
        path = scratch / f"batch-{batch:05d}.npz"
        if not path.exists():
            made = _batch(task, batch, seed, threads)
            with replacing(path) as temporary, open(temporary, "wb") as file:
                np.savez(file, **made)  # pyrefly: ignore[bad-argument-type] - no array is called `allow_pickle`
        with np.load(path) as found:
            episodes = _split(dict(found))
        kept = [each for each in episodes if task.name != "kitchen-complete" or each["rewards"][-1] == len(task.elements)]
        parts += kept
        rows += sum(len(each["rewards"]) for each in kept)
        batch += 1
        if progress:
            progress(min(rows, steps), steps)
    columns: dict[str, Any] = {key: np.concatenate([part[key] for part in parts])[:steps] for key in _COLUMNS}
    lengths = np.array([len(part["rewards"]) for part in parts])
    ends = np.cumsum(lengths) - 1
    last = int(np.searchsorted(ends, steps - 1))  # the episode in which the rows are full
    final = np.stack([part["final"][0] for part in parts[: last + 1]])
    timeouts = np.zeros(steps, bool)
    if ends[last] >= steps:
        final[-1] = np.concatenate([part["observations"] for part in parts])[steps]
        timeouts[-1] = True
    terminals = np.isin(np.arange(steps), ends)
    return Dataset.from_arrays(
        **columns, terminals=terminals, timeouts=timeouts, final_observations=final, action_space=task.action_space,
        name=f"{name}@{version_of(name)}", provenance=provenance,
    )  # fmt: skip


def _batch(task: Kitchen, batch: int, seed: int, threads: int | None) -> dict[str, np.ndarray]:
    """`BATCH` episodes as columns, one after the other, with their lengths."""
    numbers = batch * BATCH + np.arange(BATCH)
    sequences = [np.random.SeedSequence([seed, int(number)]).spawn(2) for number in numbers]
    # Where everything is to be done, which the demonstrator cannot, no episode ends with the task's own sub-tasks.
    endless = replace(task, elements=tuple(ELEMENTS))
    simulator = endless.simulate([int(own.generate_state(1, np.uint64)[0]) for own, _ in sequences], threads)
    leader = Demonstrator(BATCH)
    for copy, (number, (_, other)) in enumerate(zip(numbers, sequences)):
        generator = np.random.default_rng(other)
        leader.begin(copy, _errand(task, int(number), generator), generator)
    goal = task.goal.astype(np.float32)
    seen = simulator.reset()
    seen[:, JOINTS:] = goal
    rows: list[list[tuple[Any, ...]]] = [[] for _ in numbers]
    final = np.zeros_like(seen)
    running = np.ones(BATCH, bool)
    while running.any():
        actions = np.zeros((BATCH, 9), np.float32)
        for copy in np.flatnonzero(running).tolist():
            actions[copy] = leader.act(copy, seen[copy, :JOINTS].astype(np.float64), task)
        rewards = task.done(seen[:, :JOINTS].astype(np.float64)).sum(1).astype(np.float32)
        following, _, _, timeouts = simulator.step(actions)
        following[:, JOINTS:] = goal
        for copy in np.flatnonzero(running).tolist():
            rows[copy].append((seen[copy], actions[copy], rewards[copy]))
            # The last row is one in which the demonstrator is through with its list, with success or without.
            if leader.finished(copy) or timeouts[copy]:
                running[copy], final[copy] = False, following[copy]
        seen = following
    columns = zip(*(row for episode in rows for row in episode))
    made = {key: np.stack(column) for key, column in zip(_COLUMNS, columns)}
    return {**made, "final": final, "lengths": np.array([len(episode) for episode in rows])}


def _split(batch: dict[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    """The episodes of a batch."""
    cuts = np.cumsum(batch["lengths"])[:-1]
    columns = {key: np.split(batch[key], cuts) for key in _COLUMNS}
    columns["final"] = np.split(batch["final"], len(batch["final"]))
    return [{key: column[i] for key, column in columns.items()} for i in range(len(batch["final"]))]
