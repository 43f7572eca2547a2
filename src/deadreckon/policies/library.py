"""The behaviour policies that come with the package: snapshots of one training run a task, and what they are worth.

`library/TASK.json` says how the run was made and, for each snapshot, its returns; `library/TASK/NAME.npz` are the policies,
float16. Made by `deadreckon.runs.publish`.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from deadreckon.errors import UserError, unknown
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.store import load

ROOT = Path(__file__).parent / "library"
SNAPSHOTS = 11  # evenly spaced over the run, the first before any update (DOPE), except of a run on a log
# Tasks whose logs differ while their episodes are the same have the same policies.
SHARED = {"antmaze-umaze-diverse": "antmaze-umaze", "antmaze-medium-diverse": "antmaze-medium-play",
          "antmaze-large-diverse": "antmaze-large-play"}  # fmt: skip


@dataclass(frozen=True)
class Returns:
    """What a policy is worth in its task, over `episodes` episodes.

    Attributes:
        episodes: run.
        mean, error: undiscounted, and its standard error.
        discounted, discounted_error: with `discount`, from the start.
        discount: DOPE's 0.995.
        length: mean steps an episode.
    """

    episodes: int
    mean: float
    error: float
    discounted: float
    discounted_error: float
    discount: float
    length: float


@dataclass(frozen=True)
class Snapshot:
    """One policy of the library.

    Attributes:
        task: whose episodes it was measured in, by name.
        name: `snapshot-00` .. `snapshot-10`, and where logs are made with them `medium` and `expert`.
        updates: of the run when it was taken.
        environment_steps: likewise.
        sampled: its worth when it draws its actions, which is how logs are made.
        greedy: its worth when it acts with its mean.
    """

    task: str
    name: str
    updates: int
    environment_steps: int
    sampled: Returns
    greedy: Returns

    def policy(self) -> EnvPolicy:
        """The policy itself."""
        return load(ROOT / self.task / f"{self.name}.npz")


def library_tasks() -> list[str]:
    """Tasks that have policies."""
    own = [path.stem for path in ROOT.glob("*.json")]
    return sorted(own + [task for task, other in SHARED.items() if other in own])


@lru_cache
def about(task: str) -> dict[str, Any]:
    """How the run behind a task's policies was made, and all that was measured.

    Raises:
        UserError: the task has no policies.
    """
    if task not in library_tasks():
        raise UserError(
            f"there are no policies of {task!r}, only of {', '.join(library_tasks())}; "
            "`python -m deadreckon.runs.publish` makes them from a run"
        )
    return json.loads((ROOT / f"{SHARED.get(task, task)}.json").read_text())


def snapshot(task: str, name: str) -> Snapshot:
    """One policy of a task, such as `medium`.

    Raises:
        UserError: no such task or policy.
    """
    found = {s.name: s for s in library(task)}
    if name not in found:
        raise unknown(f"policy of {task}", name, found)
    return found[name]


def library(task: str) -> list[Snapshot]:
    """All policies of a task: the 11 snapshots in order of training, then `medium` and `expert` where there are such."""
    own = SHARED.get(task, task)
    return [
        Snapshot(own, name, e["updates"], e["environment_steps"], Returns(**e["sampled"]), Returns(**e["greedy"]))
        for name, e in about(task)["policies"].items()
    ]


def load_policies(task: str) -> list[EnvPolicy]:
    """The 11 policies of a task, evenly spaced over one run to its end (DOPE, thesis 8.4).

    The runs are of SAC in Gym-MuJoCo and of DAPG in Maze2D and Adroit, whose first policies are untrained, and of behaviour
    cloning in AntMaze, whose first ones are a little trained; `about(task)` says how they were made.

    Args:
        task: such as `hopper`, `maze2d-umaze-dense` or `door`.

    Raises:
        UserError: the task has no policies.
    """
    found = [s.policy() for s in library(task) if s.name.startswith("snapshot-")]
    if len(found) != SNAPSHOTS:
        raise UserError(f"{task}: {len(found)} snapshots in {ROOT}, {SNAPSHOTS} are needed; is the installation whole?")
    return found
