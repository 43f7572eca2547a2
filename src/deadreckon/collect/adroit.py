"""How the Adroit logs are made (thesis 7.3): human demonstrations, the policies that DAPG trained from them, and our clones.

Two things come from Rajeswaran et al.'s repository, once, into the package's folder: demonstrations and policies. A file
that lies there already is taken as it is, and without one a copy of the human log that was downloaded from D4RL.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.agents.bc import BC
from deadreckon.collect.rollouts import Segment, acted_in, collect_rollouts
from deadreckon.data.batch import TransitionSource
from deadreckon.data.catalogue import cached_path, load
from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import ORIGINAL, VERSION
from deadreckon.data.formats.pickles import read_pickle
from deadreckon.data.provenance import Provenance
from deadreckon.data.transfer import download_file
from deadreckon.errors import UserError
from deadreckon.files import home
from deadreckon.policies.dapg import load_dapg
from deadreckon.policies.deployed import EnvPolicy, first_actions
from deadreckon.progress import Progress
from deadreckon.tasks.adroit import Adroit
from deadreckon.training.fit import Fit, complete
from deadreckon.training.learner import lane_of

ROOT = ("DEADRECKON_DAPG_URL", "https://raw.githubusercontent.com/aravindr93/hand_dapg/master/dapg")
BODY = "gymnasium-robotics"  # the package that has the hand
UPDATES = 10_000  # of the clone behind the cloned logs
_CHUNK = 2_000  # updates between its checkpoints


def demonstrations_file(task: Adroit) -> Path:
    """The 25 demonstrations of a task as Rajeswaran et al. published them, downloaded if they are not there.

    Raises:
        UserError: one line: what went wrong with which address, and where the file may be put by hand.
    """
    return _source(f"{task.name}-v0_demos.pickle", f"demonstrations/{task.name}-v0_demos.pickle", read_pickle)


def policy_file(task: Adroit) -> Path:
    """The policy that DAPG trained for a task, downloaded if it is not there; see `demonstrations_file`."""
    return _source(f"{task.name}-v0_dapg_policy.pickle", f"policies/{task.name}-v0.pickle", load_dapg)


def _source(name: str, address: str, check: Callable[[Path], Any]) -> Path:
    place = home() / "data" / "adroit" / name
    variable, root = ROOT
    try:
        return download_file(f"{os.environ.get(variable, root).rstrip('/')}/{address}", place, check)
    except UserError as error:
        raise UserError(f"{error}; the file can be put manually at {place}") from error


def human(task: Adroit) -> Dataset:
    """The demonstrations of a task, with actions clipped to ±1, which is how the environment takes them and D4RL wrote them.

    They are those of the authors' pickle, whose last row of each demonstration has no known successor; where that has not
    been downloaded and D4RL's file has, of that. The Minari twin is never taken: it may have the rewards of newer environments.

    Raises:
        UserError: as `demonstrations_file`.
    """
    name = f"{task.name}-human-v1"
    copy, own = f"{name}@{ORIGINAL}", home() / "data" / "adroit" / f"{task.name}-v0_demos.pickle"
    copied = cached_path(copy).exists() and not own.exists()
    log = load(copy) if copied else read_pickle(demonstrations_file(task))
    if log.observations.shape[1:] != task.observation_shape:
        raise UserError(f"{log.name} has observations {log.observations.shape[1:]}, {task.name} has {task.observation_shape}")
    return Dataset.from_arrays(
        observations=log.observations, actions=np.clip(log.actions, -1.0, 1.0), rewards=log.rewards, terminals=log.terminals,
        timeouts=log.timeouts, final_observations=log.final_observations, final_known=log.final_known,
        action_space=task.action_space, name=name,
        provenance=acted_in(BODY, name, 0, {"task": task.name, "from": log.name, "actions": "as demonstrated, clipped to 1"}),
    )  # fmt: skip


def collect_adroit(
    task: Adroit,
    kind: str,
    *,
    name: str,
    steps: int,
    scratch: Path,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Makes one of the three kinds of log: `human`, `expert`, or `cloned`, which is half the one and half a clone of it.

    Actions are drawn, and clipped to ±1. The logs have no log-densities: the policies' are of the actions before the clipping,
    and nobody knows those of people.

    Args:
        task: where.
        kind: `human`, `expert` or `cloned`.
        name: of the recipe, such as `door-cloned-v1`.
        steps: rows; of the human log at most what there is.
        scratch: folder of a collection under way.
        seed: random seed; the human log has nothing random, so 0.
        threads: to simulate with.
        progress: called with rows done and rows in all.

    Raises:
        UserError: too many or too few rows, a seed for the human log, or a source file that cannot be had.
    """
    full = f"{name}@{VERSION}"
    if kind == "expert":
        provenance = acted_in(BODY, name, seed, {"task": task.name, "policies": ["DAPG's"], "actions": "drawn, clipped to 1"})
        return _acted(task, load_dapg(policy_file(task)), steps, full, seed, provenance, threads, scratch, progress)
    people = human(task)
    if kind == "human":
        if steps > len(people) or seed:
            raise UserError(f"{name}: people made {len(people):,} steps, once: steps must not be more, and seed must be 0")
        return _repeated(people, steps, full)
    if steps < 2:
        raise UserError(f"{name}: steps must be 2 or more, got {steps}")
    shown = steps // 2
    extra = {"task": task.name, "policies": ["people", "bc"], "updates": UPDATES, "rows": [shown, steps - shown],
             "from": people.provenance.extra["from"], "actions": "as demonstrated, then drawn; clipped to 1"}  # fmt: skip
    provenance = acted_in(BODY, name, seed, extra)
    clone = cloned_policy(people, seed, scratch / "clone")
    told = (lambda rows, total: progress(shown + rows, steps)) if progress else None
    acted = _acted(task, clone, steps - shown, full, seed, provenance, threads, scratch / "rows", told)
    return _joined([_repeated(people, shown, full), acted], full, provenance)


def cloned_policy(log: Dataset, seed: int = 0, folder: Path | None = None) -> EnvPolicy:
    """Behaviour cloning of a log with the agent `bc` as it is.

    Args:
        log: of the demonstrations.
        seed: of the training.
        folder: of its checkpoints, from which a killed collection resumes.
    """
    agent = BC()
    rows = TransitionSource(log, agent.needs(log.spec))
    job = Fit([agent], rows, [seed], UPDATES, _CHUNK, folder)
    complete(job, f"{log.name}: its clone", lambda done: None, advice="")
    return EnvPolicy.of(agent.policy(lane_of(job.states, 0)), rows.view)


def successes(task: Adroit, policy: EnvPolicy, *, episodes: int = 100, seed: int = 0, greedy: bool = False) -> tuple[Any, Any]:
    """What a policy earns in the simulator, and where it succeeds, as D4RL counts it (`Adroit.enough`).

    Args:
        task: where.
        policy: acts.
        episodes: run side by side, from the seeds `seed`, `seed` + 1, ...
        seed: of the first.
        greedy: its means, or its draws.

    Returns:
        (episodes,) undiscounted returns, and (episodes,) bool.
    """
    simulator, key = task.simulate(range(seed, seed + episodes)), jax.random.key(seed)
    seen = simulator.reset()
    returns, reached, alive = np.zeros(episodes), np.zeros(episodes, int), np.ones(episodes, bool)
    for age in range(task.horizon):
        actions = first_actions(policy, jnp.asarray(seen), jax.random.fold_in(key, age), greedy)
        seen, rewards, terminals, timeouts = simulator.step(np.clip(actions, -1.0, 1.0))
        returns += rewards
        reached += simulator.achieved & alive
        alive &= ~(terminals | timeouts)
        if not alive.any():
            break
    return returns, reached > task.enough


def _acted(
    task: Adroit, policy: EnvPolicy, rows: int, name: str, seed: int, provenance: Provenance, threads: int | None,
    scratch: Path, progress: Progress | None,
) -> Dataset:  # fmt: skip
    return collect_rollouts(
        task, [Segment(policy, rows)], name=name, seed=seed, provenance=provenance, threads=threads, scratch=scratch,
        progress=progress,
    )  # fmt: skip


def _repeated(log: Dataset, rows: int, name: str) -> Dataset:
    """The first `rows` rows of the log, over and over; what is cut ends with a timeout and the observation that came next."""
    times = -(-rows // len(log))
    whole = log.select(np.tile(np.arange(log.episodes), times))
    kept = int(np.searchsorted(whole.starts, rows))  # episodes of which there is a row
    final, known = whole.final_observations[:kept].copy(), whole.final_known[:kept].copy()
    timeouts = whole.timeouts[:rows].copy()
    if rows < len(whole) and whole.ends[kept - 1] >= rows:
        final[-1], known[-1], timeouts[-1] = whole.observations[rows], True, True
    return Dataset.from_arrays(
        observations=whole.observations[:rows], actions=whole.actions[:rows], rewards=whole.rewards[:rows],
        terminals=whole.terminals[:rows], timeouts=timeouts, final_observations=final, final_known=known,
        action_space=log.action_space, name=name, provenance=replace(log.provenance, recipe=name.split("@")[0]),
    )  # fmt: skip


def _joined(parts: list[Dataset], name: str, provenance: Provenance) -> Dataset:
    """Logs one after the other."""
    columns = ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations", "final_known")
    whole: dict[str, Any] = {key: np.concatenate([getattr(part, key) for part in parts]) for key in columns}
    return Dataset.from_arrays(**whole, action_space=parts[0].action_space, name=name, provenance=provenance)
