"""Logs made by policies: whole episodes, one after the other, drawn in waves of copies side by side.

Episode `k` of an act starts from a seed of its own, and the waves follow from the seed and the rows so far alone. So a log
depends on neither cores nor interruptions: what was on disk when a collection was killed is kept, and the rest is the same.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from deadreckon.data.dataset import Dataset, Provenance
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.policies.policy import Deployed, Step
from deadreckon.tasks.task import Simulator, Task

WAVE = 64  # copies side by side; part of the recipe, so that a log does not depend on the machine
_COLUMNS: tuple[str, ...] = ("observations", "actions", "rewards", "terminals", "timeouts", "behavior_log_probs")


@dataclass(frozen=True)
class Act:
    """Who acts for how many rows.

    Attributes:
        policy: draws its actions; None draws them uniformly between the bounds.
        rows: of the log.
    """

    policy: Deployed | None
    rows: int


def perform(
    task: Task,
    acts: Sequence[Act],
    *,
    name: str,
    seed: int,
    provenance: Provenance,
    scratch: Path,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Dataset:
    """Runs the acts one after the other in a task and gives the log of it.

    An act's last episode is cut where its rows are full: a timeout, with the observation that came next. The column
    `behavior_log_probs` holds the log-density of each action.

    Args:
        task: with continuous actions and flat observations.
        acts: at least one.
        name: of the log.
        seed: of everything random.
        provenance: of the log.
        threads: to simulate with; all cores if None. The log does not depend on it.
        scratch: a folder for what is done so far; one left by a killed collection of the same log is gone on with. The
            log's columns are memory-mapped there.
        progress: called now and then with the rows done and the rows in all.

    Raises:
        UserError: `scratch` holds the beginning of another log, or cannot be written.
    """
    asked = {"name": name, "seed": seed, "rows": [act.rows for act in acts], "versions": provenance.versions,
             "extra": provenance.extra}  # fmt: skip
    asked = json.loads(json.dumps(asked))
    stage = _Stage(scratch, task, asked)
    _perform(task, acts, stage, seed, threads, progress)
    return stage.log(name, provenance)


def _perform(
    task: Task,
    acts: Sequence[Act],
    stage: "_Stage",
    seed: int,
    threads: int | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    total = sum(act.rows for act in acts)
    simulator = task.simulate([0] * WAVE, threads)
    for which, act in enumerate(acts):
        before = sum(each.rows for each in acts[:which])
        player = _Player(task, act.policy, jax.random.fold_in(jax.random.key(seed), which))
        while (done := stage.rows - before) < act.rows:
            episodes = stage.episodes[which] if which < len(stage.episodes) else 0
            # As many episodes as the rows that are missing will take, going by those there are.
            guess = done / episodes if episodes else task.horizon
            count = int(np.clip(np.ceil((act.rows - done) / guess), 1, WAVE))
            starts = np.random.SeedSequence([seed, which, episodes]).generate_state(count, np.uint64)
            most = before + act.rows  # a wave may go beyond it
            told = (lambda rows, d=before + done, m=most: progress(min(d + rows, m), total)) if progress else None
            wave = _wave(task, simulator, player, [int(s) for s in starts], episodes, told)
            stage.append(wave, act.rows - done, which)
            if progress:
                progress(stage.rows, total)


@eqx.filter_jit
def _draw(policy: Deployed, observations: Array, key: PRNGKeyArray, low: Any, high: Any) -> tuple[Array, Array]:
    """Actions (n, size) and their log-densities (n,), as `Deployed.log_prob` gives them for the actions that are logged."""
    step = Step(observations, jnp.zeros(len(observations)), jnp.ones(len(observations), bool))
    actions = policy.act(step, policy.start(len(observations)), key, greedy=False)[0]
    actions = jnp.clip(actions, low, high)
    return actions, policy.log_prob(observations, actions)


class _Player:
    """A policy, or uniform actions, as a function of a whole wave's observations."""

    def __init__(self, task: Task, policy: Deployed | None, root: PRNGKeyArray):
        if not isinstance(task.action_space, Box):
            raise UserError(f"{task.name}: logs of policies need continuous actions")
        self.policy, self.root = policy, root
        self.low, self.high = (np.asarray(side, np.float32) for side in (task.action_space.low, task.action_space.high))

    def __call__(self, observations: np.ndarray, wave: int, t: int) -> tuple[np.ndarray, np.ndarray]:
        """(n, size) actions and (n,) log-densities; `wave` is the number of episodes before it, `t` the step."""
        key = jax.random.fold_in(jax.random.fold_in(self.root, wave), t)
        if self.policy is None:
            actions = jax.random.uniform(key, (len(observations), len(self.low)), minval=self.low, maxval=self.high)
            return np.array(actions), np.full(len(observations), -np.log(self.high - self.low).sum(), np.float32)
        actions, log_probs = _draw(self.policy, jnp.asarray(observations), key, self.low, self.high)
        return np.array(actions), np.asarray(log_probs)


def _wave(
    task: Task,
    simulator: Simulator,
    player: _Player,
    seeds: list[int],
    before: int,
    progress: Callable[[int], None] | None,
) -> dict[str, np.ndarray]:
    """One episode from each seed, side by side.

    Returns:
        Columns (rows, ...), one episode after the other; `final_observations` (episodes, *shape), `lengths` (episodes,).
    """
    count = len(seeds)
    seen = np.zeros((WAVE, *task.observation_shape), np.float32)
    seen[:count] = simulator.reset(np.arange(count), seeds)
    finals = np.zeros_like(seen)
    alive = np.arange(WAVE) < count
    lengths, steps = np.zeros(WAVE, int), []
    for t in range(task.horizon):
        # Always the same number of rows: a policy's last bits may depend on how many it is asked for.
        actions, log_probs = player(seen, before, t)
        actions[~alive] = 0.0
        following, rewards, terminals, timeouts = simulator.step(actions)
        steps.append([part[:count] for part in (seen, actions, rewards, terminals, timeouts, log_probs)])
        lengths += alive
        over = alive & (terminals | timeouts)
        finals[over] = following[over]
        alive &= ~over
        seen = following
        if progress and t % 50 == 49:
            progress(int(lengths.sum()))
        if not alive.any():
            break
    columns = [np.stack(column, 1) for column in zip(*steps)]  # (episodes, steps, ...)
    keep = np.arange(len(steps)) < lengths[:count, None]
    out = {key: column[keep] for key, column in zip(_COLUMNS, columns)}
    return out | {"final_observations": finals[:count], "lengths": lengths[:count]}


class _Stage:
    """Columns that grow on disk: a raw file each, and a JSON file that says how many rows of them count."""

    def __init__(self, folder: Path, task: Task, asked: dict[str, Any]):
        self.folder, self.task, self.asked = folder, task, asked
        self.rows, self.finals = 0, 0
        self.episodes: list[int] = []
        size = task.action_space.size
        kinds = (task.observation_shape, np.float32), ((size,), np.float32), ((), np.float32), ((), bool), ((), bool)
        self.kinds: dict[str, tuple[tuple[int, ...], Any]] = dict(zip(_COLUMNS, (*kinds, ((), np.float32))))
        self.kinds["final_observations"] = (task.observation_shape, np.float32)
        if not self._state.exists():
            return
        found = read_json(self._state)
        if found.get("asked") != asked:
            raise UserError(f"{folder} holds the beginning of another collection; delete it, or ask for the same one again")
        self.rows, self.finals, self.episodes = found["rows"], found["finals"], found["episodes"]

    @property
    def _state(self) -> Path:
        return self.folder / "state.json"

    def append(self, wave: dict[str, np.ndarray], room: int, act: int) -> None:
        """Adds a wave's rows, at most `room` of them, and says so once they are on the disk."""
        ends = np.cumsum(wave["lengths"])
        whole = int(np.searchsorted(ends, room, side="right"))  # episodes that fit
        finals = wave["final_observations"][:whole]
        rows = min(int(ends[-1]), room)
        if whole < len(ends) and (whole == 0 or ends[whole - 1] < room):
            # The episode in which the rows ran out: what followed its last row is its own next observation.
            finals = np.concatenate([finals, wave["observations"][room][None]])
            wave["timeouts"][room - 1] = True
            whole += 1
        for key in _COLUMNS:
            self._write(key, wave[key][:rows], self.rows)
        self._write("final_observations", finals, self.finals)
        self.rows, self.finals = self.rows + rows, self.finals + len(finals)
        self.episodes += [0] * (act + 1 - len(self.episodes))
        self.episodes[act] += whole
        write_json(self._state, {"asked": self.asked, "rows": self.rows, "finals": self.finals, "episodes": self.episodes})

    def _write(self, key: str, rows: np.ndarray, at: int) -> None:
        shape, dtype = self.kinds[key]
        each = int(np.prod(shape)) * np.dtype(dtype).itemsize
        path = self.folder / f"{key}.bin"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with open(path, "r+b" if path.exists() else "wb") as file:
                file.truncate(at * each)
                file.seek(at * each)
                file.write(np.ascontiguousarray(rows, dtype).data)
        except OSError as error:
            raise UserError(f"cannot write {path}: {error.strerror or error}") from error

    def log(self, name: str, provenance: Provenance) -> Dataset:
        """The log of all rows so far, memory-mapped."""
        columns: dict[str, Any] = {}
        for key, (shape, dtype) in self.kinds.items():
            count = self.finals if key == "final_observations" else self.rows
            columns[key] = np.memmap(self.folder / f"{key}.bin", dtype, "r", shape=(count, *shape))
        return Dataset.from_arrays(**columns, action_space=self.task.action_space, name=name, provenance=provenance)
