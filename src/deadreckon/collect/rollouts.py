"""Logs made by policies: whole episodes, run side by side and written one after the other.

Episode `k` of a segment follows from the seed, the segment and `k` alone: its start, and the draws of its actions. So a log
depends on neither cores nor interruptions: what was on disk when a collection was killed is kept, and the rest is the same.
"""

import itertools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from deadreckon.collect.growing_log import FLUSH, Episode, GrowingLog, asked_for, collected
from deadreckon.data.dataset import Dataset
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Box
from deadreckon.data.step import Step
from deadreckon.devices import acting_platform, on_processor
from deadreckon.errors import UserError
from deadreckon.memory import memory
from deadreckon.policies.deployed import EnvPolicy, Seeing
from deadreckon.policies.kinds import ClippedGaussian, Gaussian
from deadreckon.policies.policy import Policy
from deadreckon.progress import Progress
from deadreckon.tasks.task import Simulator, Task
from deadreckon.tasks.turns import simulating

COPIES = 64  # side by side
MEMORY = 0.25  # largest share of the memory for the rows of unfinished episodes
COLUMNS: tuple[str, ...] = ("observations", "actions", "rewards", "terminals", "timeouts", "behavior_log_probs")


class StatefulController:
    """A controller with a memory of each copy's episode, so that the logged behaviour is not Markovian.

    Attributes:
        columns: what it gives beside its actions: name of the log's column to shape of a row.
    """

    columns: dict[str, tuple[int, ...]]

    def begin(self, simulator: Any, copy: int, observation: np.ndarray, generator: np.random.Generator) -> None:
        """An episode begins in a copy; all that is random in it comes from this generator."""
        raise NotImplementedError

    def act(self, observations: np.ndarray, running: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Actions (copies, size) and rows of `columns`, of which only those of the copies `running` (indices) count."""
        raise NotImplementedError


@dataclass(frozen=True)
class Segment:
    """A policy and the number of rows of a log that it collects.

    Attributes:
        policy: draws its actions; None draws them uniformly between the bounds. A `Policy` that is no `EnvPolicy` is
            called for one row at a time, with a NumPy generator that follows from seed, episode and step. A function of
            (n, *shape) observations takes one action in each, whose density there is none of: the log then has no column
            `behavior_log_probs`. So it is with a `StatefulController`, whose columns the log has, too; it acts alone.
        rows: how many.
    """

    policy: EnvPolicy | Policy | Callable[[np.ndarray], np.ndarray] | StatefulController | None
    rows: int


def collect_rollouts(
    task: Task,
    segments: Sequence[Segment],
    *,
    name: str,
    seed: int,
    provenance: Provenance,
    scratch: Path,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Dataset:
    """Runs the segments one after the other in a task and gives their log.

    The last episode of a segment is cut where its rows are full: a timeout, with the observation that came next. The column
    `behavior_log_probs` holds the log-density of each action, where all policies have one. Continuous actions of an
    `EnvPolicy` are clipped to the task's bounds; see `has_densities` for what that means for the column.

    Args:
        task: where.
        segments: at least one.
        name: of the log.
        seed: random seed.
        provenance: of the log.
        threads: to simulate with; all cores if None. The log does not depend on it.
        scratch: a folder for what is done so far; one left by a killed collection of the same log is resumed. The
            log's columns are memory-mapped there.
        progress: called now and then with the rows done and the rows in all.

    Raises:
        UserError: `scratch` holds the beginning of another log, or cannot be written; a policy has a memory of earlier steps,
            gives actions that the task does not have, or gives log-probabilities that are not finite.
    """
    kinds = column_kinds(task, segments[0].policy)
    for segment in segments:
        if isinstance(segment.policy, Policy) and jax.tree.leaves(segment.policy.start(1)):
            raise UserError(f"{name}: a policy with a memory of earlier steps cannot collect a log")
    log = GrowingLog(scratch, task, kinds, asked_for(name, seed, [segment.rows for segment in segments], provenance))
    dense = all(has_densities(each.policy, task) for each in segments)
    with on_processor():
        _collect(task, segments, log, seed, dense, threads, progress)
    return log.log(name, provenance, densities=dense)


def has_densities(policy: Any, task: Task) -> bool:
    """Whether the log of a policy, or of uniform actions (None), has the log-densities of its actions.

    `log_prob` of a Gaussian without bounds, and of a policy with wider bounds than the task's, is that of the action before it
    is clipped: at a bound it is not the probability of all that lies beyond.
    """
    if policy is None:
        return True
    if not isinstance(policy, Policy) or not policy.has_log_prob:
        return False
    if not isinstance(policy, EnvPolicy) or not isinstance(task.action_space, Box):
        return True
    if isinstance(policy.inner, Seeing):
        return has_densities(policy.inner.member, task)
    if isinstance(policy.inner, Gaussian) and not isinstance(policy.inner, ClippedGaussian):
        return False
    low, high = (np.asarray(side, np.float32) for side in (task.action_space.low, task.action_space.high))
    least, most = (-1.0, 1.0) if policy.low is None or policy.high is None else (policy.low, policy.high)
    return bool((low <= np.asarray(least)).all() and (np.asarray(most) <= high).all())


def _drawn(policy: Any) -> TypeGuard[EnvPolicy | None]:
    """Whether actions are drawn by keys, one a row."""
    return policy is None or isinstance(policy, EnvPolicy)


def played(task: Task, policy: EnvPolicy | None, rows: int, seed: int) -> Dataset:
    """What a policy does in so many rows, as a log in memory; see `collect_rollouts`."""
    provenance = Provenance("collected", seed=seed)
    with tempfile.TemporaryDirectory() as scratch:
        log = collect_rollouts(
            task, [Segment(policy, rows)], name=task.name, seed=seed, provenance=provenance, scratch=Path(scratch) / "rows"
        )
        return log.loaded()  # in memory, not where the scratch was


def _collect(
    task: Task,
    segments: Sequence[Segment],
    log: GrowingLog,
    seed: int,
    dense: bool,
    threads: int | None,
    progress: Progress | None,
) -> None:
    total = sum(segment.rows for segment in segments)
    with simulating(task, [0] * copies_of(task), threads) as simulator:
        for which, segment in enumerate(segments):
            before = sum(each.rows for each in segments[:which])
            if log.rows - before >= segment.rows:
                continue
            root = jax.random.fold_in(jax.random.key(seed), which)
            missing = segment.rows - (log.rows - before)
            copies = _SideBySide(task, simulator, segment.policy, root, [seed, which], dense, missing)
            first = log.episodes[which] if which < len(log.episodes) else 0
            told = (lambda rows, b=before, m=before + segment.rows: progress(min(b + rows, m), total)) if progress else None
            for episodes in copies.run(first, log.rows - before, segment.rows, told):
                log.append(episodes, segment.rows - (log.rows - before), which)
                if progress:
                    progress(log.rows, total)


def copies_of(task: Task) -> int:
    """How many episodes are acted side by side; the log is the same whatever it is."""
    return min(COPIES, task.most_copies or COPIES)


@eqx.filter_jit
def _draw(
    policy: EnvPolicy | None, observations: Array, root: PRNGKeyArray, episodes: Array, ages: Array, low: Any, high: Any
) -> tuple[Array, Array]:
    """Actions (n, size) and their log-densities (n,), as `EnvPolicy.log_prob` gives them for the actions that are logged.

    Discrete actions are (n,) numbers from `low`, which is 0, to `high`. A policy without densities has NaN. A row's draw
    follows from its episode and step alone, wherever it stands among the others.
    """
    discrete = jnp.issubdtype(low.dtype, jnp.integer)

    def one(observation: Array, episode: Array, age: Array) -> tuple[Array, Array]:
        key = jax.random.fold_in(jax.random.fold_in(root, episode), age)
        if policy is None and discrete:
            return jax.random.randint(key, (), low, high + 1), -jnp.log(high + 1.0)
        if policy is None:
            action = jax.random.uniform(key, low.shape, minval=low, maxval=high)
            return action, -jnp.log(high - low).sum()
        step = Step(observation[None], jnp.zeros(1), jnp.ones(1, bool))
        action = policy.act(step, policy.start(1), key, greedy=False)[0]
        action = action if discrete else jnp.clip(action, low, high)
        if not policy.has_log_prob:
            return action[0], jnp.full((), jnp.nan)
        return action[0], policy.log_prob(observation[None], action)[0]

    return jax.vmap(one)(observations, episodes, ages)


class _SideBySide:
    """Episodes of one segment, side by side: a copy that has ended one begins the next.

    Attributes:
        dense: whether the log-densities of actions are logged.
        most: number of copies in use; less than all where their rows would take too much memory.
        episode: (copies,) which each copy is in, -1 at rest.
        age: (copies,) steps of it done.
        rewards: (copies,) of the last step.
        columns: (most, steps, *shape) rows of the unfinished episodes, none of which is longer than the rows still missing.
    """

    def __init__(
        self, task: Task, simulator: Simulator, policy: Any, root: PRNGKeyArray, seed: list[int], dense: bool, missing: int
    ):
        self.task, self.simulator, self.policy, self.root, self.seed = task, simulator, policy, root, seed
        self.dense = dense
        space = task.action_space
        bounds = (space.low, space.high) if isinstance(space, Box) else (0, space.n - 1)
        self.low, self.high = (np.asarray(side, action_kind(task)[1]) for side in bounds)
        self.copies = copies_of(task)
        self.episode, self.age = np.full(self.copies, -1), np.zeros(self.copies, int)
        self.seen = np.zeros((self.copies, *task.observation_shape), task.observation_dtype)
        self.rewards = np.zeros(self.copies)
        kinds, steps = column_kinds(task, policy), min(task.horizon, missing)
        each = steps * sum(int(np.prod(shape)) * np.dtype(dtype).itemsize for shape, dtype in kinds.values())
        self.most = max(1, min(self.copies, int(MEMORY * memory()) // each))
        self.columns = {key: np.zeros((self.most, steps, *shape), dtype) for key, (shape, dtype) in kinds.items()}

    def run(self, first: int, rows: int, wanted: int, progress: Callable[[int], None] | None) -> Iterator[list[Episode]]:
        """Runs the episodes `first`, `first` + 1, ... until `rows` and theirs are `wanted`; gives them in order, bit by bit.

        The order is that of their numbers, not that in which they end: no episode is left out because it is long.
        """
        following, next_out = first, first
        done: dict[int, Episode] = {}
        ready: list[Episode] = []
        given, held = rows, 0  # rows that are out, and rows that are ready to go
        ended = lengths = 0
        for turn in itertools.count():
            if given >= wanted:
                break
            # As many side by side as will be needed, going by how long those before were.
            guess = lengths / ended if ended else self.task.horizon
            free = np.flatnonzero(self.episode[: self.most] < 0)
            running = self.most - len(free)
            missing = wanted - (rows + lengths + running * guess)
            more = free[: int(np.clip(np.ceil(missing / guess), int(running == 0), len(free)))]
            if len(more):
                self._begin(more, following)
                following += len(more)
            for number, each in self._step():
                done[number] = each
                ended, lengths = ended + 1, lengths + each.length
            while next_out in done:
                ready.append(done.pop(next_out))
                held += ready[-1].length
                next_out += 1
            front = np.flatnonzero(self.episode == next_out)
            if len(front) and 0 < wanted - given - held <= self.age[front[0]]:  # it has all the rows still missing
                ready.append(self._rows(front[0]))
                ready[-1].columns["timeouts"][-1] = True
                held += ready[-1].length
                next_out += 1
            if ready and (held >= FLUSH or given + held >= wanted):
                yield ready
                given, ready, held = given + held, [], 0
            if progress and turn % 50 == 49:
                progress(given + held)

    def _begin(self, which: np.ndarray, first: int) -> None:
        numbers = first + np.arange(len(which))
        seeds = [int(np.random.SeedSequence([*self.seed, int(n)]).generate_state(1, np.uint64)[0]) for n in numbers]
        self.seen[which] = self.simulator.reset(which, seeds)
        if isinstance(self.policy, StatefulController):
            for copy, number in zip(which, numbers):
                generator = np.random.default_rng([*self.seed, int(number), 1])
                self.policy.begin(self.simulator, int(copy), self.seen[copy], generator)
        self.episode[which], self.age[which], self.rewards[which] = numbers, 0, 0.0

    def _step(self) -> Iterator[tuple[int, Episode]]:
        """One step of all copies; gives the numbers and rows of the episodes that ended with it."""
        alive = np.flatnonzero(self.episode >= 0)
        told: dict[str, np.ndarray] = {}
        if _drawn(self.policy):
            # Always the same number of rows, so that one compiled program serves.
            where = jnp.asarray(self.episode), jnp.asarray(self.age)
            drawn = _draw(self.policy, jnp.asarray(self.seen), self.root, *where, self.low, self.high)
            actions, log_probs = np.array(drawn[0]), np.asarray(drawn[1])
        elif isinstance(self.policy, Policy):
            actions, log_probs = self._policy_actions(alive)
        else:
            if isinstance(self.policy, StatefulController):
                given, told = self.policy.act(self.seen, alive)
            else:
                given = self.policy(self.seen)
            actions, log_probs = self._checked(given, self.copies, alive), np.full(self.copies, np.nan, np.float32)
        if self.dense and not np.isfinite(log_probs[alive]).all():
            copy = alive[~np.isfinite(log_probs[alive])][0]
            what = f"the policy's log-probability of its action {actions[copy].tolist()} is {log_probs[copy]:g}"
            raise UserError(f"{self.task.name}: {what}, a finite number is needed")
        actions[self.episode < 0] = 0
        seen, rewards, terminals, timeouts = self.simulator.step(actions)
        parts = dict(zip(COLUMNS, (self.seen, actions, rewards, terminals, timeouts, log_probs))) | told
        for key, part in parts.items():
            self.columns[key][alive, self.age[alive]] = part[alive]
        self.seen, self.rewards = seen, np.array(rewards)
        self.age[alive] += 1
        for copy in alive[(terminals | timeouts)[alive]]:
            yield int(self.episode[copy]), self._rows(copy)
            self.episode[copy] = -1

    def _rows(self, copy: int) -> Episode:
        """The episode that a copy is in, so far."""
        columns = {key: column[copy, : self.age[copy]].copy() for key, column in self.columns.items()}
        return Episode(columns, self.seen[copy].copy())

    def _policy_actions(self, alive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Actions of a `Policy` and their log-densities, row by row, so that no row depends on the other copies."""
        actions = np.zeros((self.copies, *self.low.shape), self.low.dtype)
        log_probs = np.full(self.copies, np.nan, np.float32)
        for copy in alive.tolist():
            row = [copy]
            step = Step(self.seen[row], self.rewards[row], self.age[row] == 0)
            generator = np.random.default_rng([*self.seed, int(self.episode[copy]), int(self.age[copy]) + 1])
            given, _ = self.policy.act(step, self.policy.start(1), generator, greedy=False)
            actions[row] = self._checked(given, 1, np.zeros(1, int))
            if self.dense:
                density = np.asarray(self.policy.log_prob(self.seen[row], actions[row]))
                if density.shape != (1,):
                    raise UserError(f"{self.task.name}: log_prob must give one number per row, (1,), got {density.shape}")
                log_probs[row] = density
        return actions, log_probs

    def _checked(self, given: Any, n: int, alive: np.ndarray) -> np.ndarray:
        """(n, *size) actions of a user's code in the dtype of the log.

        Raises:
            UserError: they have another shape, or a discrete action of an `alive` row is not a whole number.
        """
        given, shape = np.asarray(given), (n, *self.low.shape)
        if given.shape != shape:
            wanted = f"one action of shape {self.low.shape} per row"
            raise UserError(f"{self.task.name} takes {wanted}, the policy gave shape {given.shape} for a batch of {n}")
        with np.errstate(invalid="ignore"):  # NaN is refused below, or by the simulator
            actions = given.astype(self.low.dtype)
        if self.low.dtype.kind == "i" and (wrong := (actions != given)[alive]).any():
            number = given[alive][wrong][0]
            raise UserError(f"{self.task.name}: an action is {number}, a number from 0 to {self.high} is needed")
        return actions


def action_kind(task: Task) -> tuple[tuple[int, ...], Any]:
    """Shape and dtype of one action."""
    return ((task.action_space.size,), np.float32) if isinstance(task.action_space, Box) else ((), np.int32)


def column_kinds(task: Task, policy: Any) -> dict[str, tuple[tuple[int, ...], Any]]:
    """Shape and dtype of a row of each of `COLUMNS`, and of what the policy tells if it is a `StatefulController`."""
    kinds = (task.observation_shape, np.dtype(task.observation_dtype)), action_kind(task), ((), np.float32), ((), bool)
    known = dict(zip(COLUMNS, (*kinds, ((), bool), ((), np.float32))))
    told = policy.columns if isinstance(policy, StatefulController) else {}
    return known | {key: (shape, np.float32) for key, shape in told.items()}


def acted_in(body: str, name: str, seed: int, extra: dict[str, Any]) -> Provenance:
    """Where a log comes from in which policies act in a body of the package `body` and MuJoCo.

    They act on the processor, unless `extra` names another `device`.
    """
    return collected(name, seed, ("mujoco", body, "numpy", "jax"), {"device": acting_platform()} | extra)
