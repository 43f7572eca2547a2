"""How the Gym-MuJoCo logs are made (thesis 7.3): by the policies of the package, and medium-replay by training again."""

import warnings
from pathlib import Path
from typing import Any

import jax

from deadreckon.agents.sac import SAC
from deadreckon.collect.rollouts import Segment, acted_in, collect_rollouts
from deadreckon.collect.trained import train_for_rows
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import VERSION
from deadreckon.errors import UserError
from deadreckon.online import Online, replay_log
from deadreckon.policies import library
from deadreckon.progress import Progress
from deadreckon.tasks.gym_mujoco import GymMujoco
from deadreckon.training.field_names import with_field_names
from deadreckon.versions import differences, versions

UNIFORM = "uniform"  # actions drawn uniformly between the bounds, thesis A.4
# Who acts in equal parts of each kind of log. "random" is a randomly initialised policy (7.3), which is not uniform.
KINDS: dict[str, tuple[str, ...]] = {
    "random": ("snapshot-00",),
    "uniform": (UNIFORM,),
    "medium": ("medium",),
    "expert": ("expert",),
    "medium-expert": ("medium", "expert"),
    "uniform-expert": (UNIFORM, "expert"),
}


def behavior_return(task: str, kind: str) -> float:
    """Mean undiscounted return of an episode of a kind of log: measured in the simulator, of medium-replay in the buffer.

    A log with two parts has equal rows of them, and so more of the shorter episodes.

    Args:
        task: such as `hopper`.
        kind: among `KINDS`, or `medium-replay`.
    """
    about = library.about(task)
    if kind == "medium-replay":
        return about["medium_replay"]["mean"]
    uniform = library.Returns(**about["uniform"])
    parts = [uniform if part == UNIFORM else library.snapshot(task, part).sampled for part in KINDS[kind]]
    return sum(part.mean / part.length for part in parts) / sum(1.0 / part.length for part in parts)


def collect_gym(
    task: GymMujoco,
    kind: str,
    *,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Collects one of `KINDS`; see `collect.rollouts.collect_rollouts`.

    Args:
        task: where.
        kind: among `KINDS`.
        name: of the recipe, such as `hopper-medium-v2`.
        steps: rows; of kinds with two parts, half each.
        seed: random seed.
        threads: to simulate with.
        scratch: folder of a collection under way.
        progress: called with rows done and rows in all.
    """
    parts = KINDS[kind]
    if steps < len(parts):
        raise UserError(f"{name}: steps must be {len(parts)} or more, got {steps}")
    first = steps // len(parts)
    rows = [first] * (len(parts) - 1) + [steps - first * (len(parts) - 1)]
    policies = [None if part == UNIFORM else library.snapshot(task.name, part).policy() for part in parts]
    segments = [Segment(policy, n) for policy, n in zip(policies, rows)]
    taken = {part: library.snapshot(task.name, part).updates for part in parts if part != UNIFORM}
    extra = {"task": task.name, "policies": list(parts), "updates": taken, "rows": rows, "actions": "drawn"}
    return collect_rollouts(
        task, segments, name=f"{name}@{VERSION}", seed=seed, provenance=acted_in("gymnasium", name, seed, extra),
        threads=threads, scratch=scratch, progress=progress,
    )  # fmt: skip


def collect_replay(
    task: GymMujoco,
    *,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Trains the task's behaviour policy again up to `medium` and gives every step that it took on the way.

    With seed 0 it is the run that the shipped policies come from: to the bit with the versions and the number of threads
    that it was made with (one: `taskset -c 0`), else the same in kind, which a warning then says.

    Args:
        task: where.
        name: of the recipe, such as `hopper-medium-replay-v2`.
        steps: environment steps, the random ones at the beginning included.
        seed: of the training.
        threads: to simulate with.
        scratch: folder of the training, which is resumed after a kill.
        progress: called with rows done and rows in all.
    """
    run = library.about(task.name)["run"]
    settings, agent = Online(**run["online"]), SAC(**with_field_names(SAC, _fields(run["agent"])))
    now = versions()
    if seed == 0 and (different := differences(run["versions"], now, [*now])):
        text = f"{name}: not the run that the policies come from, but another of the same kind: {'; '.join(different)}"
        warnings.warn(text, stacklevel=2)
    extra = {"task": task.name, "training": run["agent"], "online": run["online"], "actions": "drawn, uniform at first",
             "trained_with": now, "device": jax.default_backend()}  # fmt: skip
    provenance = acted_in("gymnasium", name, seed, extra)
    path = train_for_rows(
        task, agent, settings, name=name, steps=steps, seed=seed, folder=scratch / "replay", provenance=provenance,
        threads=threads, progress=progress,
    )  # fmt: skip
    return replay_log(path, task, settings.copies, steps, name=f"{name}@{VERSION}", provenance=provenance)


def _fields(values: dict[str, Any]) -> dict[str, Any]:
    """Fields as JSON has them, as an agent takes them."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
