"""A log of what a policy, or chance, does in any task."""

import hashlib
import shutil
from pathlib import Path
from typing import Any

import jax
import numpy as np

from deadreckon.collect.growing_log import collected
from deadreckon.collect.rollouts import Segment, collect_rollouts
from deadreckon.data.environments import SPEC
from deadreckon.devices import acting_platform
from deadreckon.errors import UserError
from deadreckon.files import alone
from deadreckon.interrupts import resumable
from deadreckon.names import file_part
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.resolve import policies_of
from deadreckon.progress import Progress
from deadreckon.randomness import check_seed
from deadreckon.tasks.registry import own_fields, registered_fields
from deadreckon.tasks.registry import task as find_task

RANDOM = "random"  # uniform actions, in place of a policy


def collect_in_task(
    task: Any,
    policy: Any = RANDOM,
    *,
    steps: int = 10_000,
    seed: int = 0,
    out: Path | str | None = None,
    by: str | None = None,
    threads: int | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Lets a policy act in a task and writes the log as an HDF5 file with D4RL's column names.

    Actions are drawn, not greedy, and their log-probabilities are logged where the policy has any of its actions within the
    task's bounds (see `collect.rollouts.has_densities`). After a kill the same command goes on where it was: what is done so
    far lies in a hidden folder beside the file. A task with other fields than the one of its name, such as another horizon,
    is another collection; the log notes these fields, and all of a task that the user has registered. A policy of code of its
    own, or an environment that is an object without a spec, cannot be told from another: it begins anew once that folder is
    deleted.

    Args:
        task: a task, its name, or a Gymnasium environment; see `tasks.registry.task`.
        policy: "random", which draws actions uniformly; a policy, a policy file or a run of one seed. A policy with a memory
            of earlier steps is refused.
        steps: rows. The last episode is cut where they are full, by a timeout.
        seed: random seed of starts and actions.
        out: the file; None: one named after task and policy in the current folder.
        by: what the policy is called in the log; None: the name of its kind.
        threads: to simulate with; all cores if None. The log does not depend on it.
        force: replace a file that is there.
        progress: called now and then with the rows done and the rows in all.

    Returns:
        The file's path. It is written whole or not at all.

    Raises:
        UserError: an unknown task, no single policy, settings out of range, a file `out` that is there already, the
            beginning of another collection beside it, or what `collect.rollouts.collect_rollouts` refuses.
    """
    from deadreckon.data.formats.hdf5 import write_hdf5

    named = isinstance(task, str)
    task = find_task(task)
    if steps < 1:
        raise UserError(f"steps must be 1 or more, got {steps}")
    check_seed(seed)
    chance = isinstance(policy, str) and policy == RANDOM
    found = [None] if chance else policies_of(policy)
    if len(found) != 1:
        raise UserError(f"one policy makes a log, got {len(found)}; give one of them")
    by = RANDOM if chance else by or type(getattr(found[0], "inner", found[0])).__name__
    name = f"{task.name} {by}"
    path = Path(out) if out is not None else Path(f"{file_part(name.replace(' ', '-').replace(':', '-'))}.hdf5")
    if path.exists() and not force:
        raise UserError(f"{path} exists already; --force (force=True) replaces it")
    extra = {"task": task.name, "policy": by, "actions": "drawn", "device": acting_platform()}
    content = None if chance else _content(found[0])
    extra |= task.described | ({} if content is None else {"policy_content": content})
    extra |= {"task_fields": own} if (own := own_fields(task)) else {}
    extra |= {"task_registered": registered} if (registered := registered_fields(task)) else {}
    provenance = collected(None, seed, ("mujoco", "numpy", "jax"), extra, task.versions)
    scratch = path.parent / f".{path.name}.part"
    # Of an environment that is given as an object nobody knows the settings, unless Gymnasium can make it again.
    alike = named or SPEC in extra or not _of_gymnasium(task)
    known = alike and (chance or content is not None)
    with alone(path), resumable(*[scratch] if known else []):
        who = "policy" if alike else "environment"
        if scratch.exists() and not known:
            raise UserError(f"{scratch} holds the beginning of a collection, maybe by another {who}; delete it to start again")
        log = collect_rollouts(
            task, [Segment(found[0], steps)], name=name, seed=seed, provenance=provenance, threads=threads, scratch=scratch,
            progress=progress,
        )  # fmt: skip
        write_hdf5(log, path, compress=True)
        shutil.rmtree(scratch, ignore_errors=True)
    return path


def _of_gymnasium(task: Any) -> bool:
    """Whether a task is an environment of Gymnasium, which costs 150 ms to import."""
    from deadreckon.tasks.gymnasium_task import GymnasiumTask

    return isinstance(task, GymnasiumTask)


def _content(policy: Any) -> str | None:
    """Hex digest of a policy's kind, settings and numbers; None where it is other code, which nobody can tell from another."""
    if not isinstance(policy, EnvPolicy):
        return None
    leaves, structure = jax.tree.flatten(policy)
    found = hashlib.blake2b(str(structure).encode(), digest_size=16)
    for leaf in map(np.asarray, leaves):
        found.update(f"{leaf.shape}{leaf.dtype}".encode() + leaf.tobytes())
    return found.hexdigest()
