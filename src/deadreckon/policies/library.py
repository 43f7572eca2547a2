"""The policies in the package, snapshots of training runs, and their values.

`library/TASK.json` says how the runs were made and, for each snapshot, its returns; `library/TASK/NAME.npz` are the policies,
float16. Made by `deadreckon.runs.publish`.
"""

import difflib
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from deadreckon.errors import UserError, unknown
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.store import load

ROOT = Path(__file__).parent / "library"
SNAPSHOTS = 11  # evenly spaced over one run, the first before any update (DOPE), except of a run on a log
OF_LOGS = ("medium", "expert")  # policies that logs are made with: some snapshots once more
# Tasks whose logs differ while their episodes are the same have the same policies.
SHARED = {"antmaze-umaze-diverse": "antmaze-umaze", "antmaze-medium-diverse": "antmaze-medium-play",
          "antmaze-large-diverse": "antmaze-large-play"}  # fmt: skip


@dataclass(frozen=True)
class Returns:
    """The value of a policy in its task, over `episodes` episodes.

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
        name: of one run `snapshot-00` .. `snapshot-10`, and where logs are made with them `medium` and `expert`; of several
            runs their agent, seed and updates, such as `d4pg-0-10000`.
        updates: of the run when it was taken.
        environment_steps: likewise.
        sampled: its value with sampled actions, as in logs.
        greedy: its value with mean actions; None if that was not measured.
    """

    task: str
    name: str
    updates: int
    environment_steps: int
    sampled: Returns
    greedy: Returns | None

    def policy(self) -> EnvPolicy:
        """The policy itself."""
        return load(self.file)

    @property
    def file(self) -> Path:
        """Where it is saved."""
        return ROOT / self.task / f"{self.name}.npz"


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
        near = difflib.get_close_matches(task, library_tasks(), 1, 0.7)
        meant = f": did you mean {near[0]}?" if near else f", only of {', '.join(library_tasks())};"
        raise UserError(
            f"there are no policies of {task!r} in the package{meant} `python -m deadreckon.runs.publish` makes them "
            "from a run, and tools/unplugged_policies.py of a clone those of dm_control's tasks"
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
    """All policies of a task: those for evaluation (`evaluated`), then `medium` and `expert` if there are any."""
    own = SHARED.get(task, task)
    return [
        Snapshot(
            own, name, e["updates"], e["environment_steps"], Returns(**e["sampled"]),
            Returns(**e["greedy"]) if "greedy" in e else None,
        )
        for name, e in about(task)["policies"].items()
    ]  # fmt: skip


def evaluated(task: str) -> list[Snapshot]:
    """The policies of a task whose values estimators are to find (DOPE): of one run in order of training."""
    return [s for s in library(task) if s.name not in OF_LOGS]


def load_policies(task: str) -> list[EnvPolicy]:
    """The policies of a task whose values estimators are to find (DOPE, thesis 8.4).

    In most tasks they are 11, evenly spaced over one run to its end: of SAC in Gym-MuJoCo and of DAPG in Maze2D and Adroit, the
    first of them untrained, and of behaviour cloning in AntMaze, the first of them a little trained. Of dm_control they are 24,
    two snapshots of four agents and three seeds, which were trained on the task's log; those of some tasks have to be made
    first
    (`tools/unplugged_policies.py`). `about(task)` says how they were made.

    Args:
        task: such as `hopper`, `maze2d-umaze-dense`, `walker-stand` or `door`.

    Raises:
        UserError: the task has no policies, or their files are not there.
    """
    return [s.policy() for s in evaluated(task)]
