"""The agent's own experience: its policy acts in copies of a task, alternating with its updates."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PRNGKeyArray, Shaped

from deadreckon.agents.agent import Agent
from deadreckon.data.batch import BatchSpec
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.sizes import about_dimensions, large
from deadreckon.data.spec import Spec, Statistics
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.online.rows import row_columns, row_width, unpacked
from deadreckon.online.turns import Online
from deadreckon.randomness import key_for, sequence
from deadreckon.tasks.task import Task
from deadreckon.training.replay import Replay, read_rows

LARGEST = 1e6  # size of an action of a policy that diverged, which stays finite in the units of the environment


@eqx.filter_jit
def _act(
    learner: Any, states: Any, seen: Float[Array, "l n o"], carry: Any, roots: Key[Array, "l"], t: Array
) -> tuple[Shaped[Array, "l n *a"], Any]:
    """Actions in [-1, 1] or numbers of discrete ones, and the policies' memory for the next step."""

    def one(learner: Any, state: Any, seen: Array, carry: Any, root: PRNGKeyArray) -> tuple[Array, Any]:
        step = Step(seen, jnp.zeros(len(seen)), jnp.zeros(len(seen), bool))
        action, carry = learner.policy(state).act(step, carry, _key(root, t), greedy=False)
        if learner.exploration_noise:
            noise = jax.random.normal(key_for(root, "exploration", t), action.shape)
            action = jnp.clip(action + learner.exploration_noise * noise, -1.0, 1.0)
        # A lane that diverged is marked as failed after its updates; until then it must not stop the simulator.
        return jnp.nan_to_num(action, posinf=LARGEST, neginf=-LARGEST), carry

    return jax.vmap(one)(learner, states, seen, carry, roots)


@eqx.filter_jit
def _explore(roots: Key[Array, "l"], t: Array, shape: tuple[int, int], discrete: bool) -> Shaped[Array, "l n *a"]:
    """Uniform actions of `shape[0]` copies: `shape[1]` numbers in [-1, 1] each, or one of `shape[1]` discrete actions."""
    if discrete:
        return jax.vmap(lambda root: jax.random.randint(_key(root, t), shape[:1], 0, shape[1]))(roots)
    return jax.vmap(lambda root: jax.random.uniform(_key(root, t), shape, minval=-1.0, maxval=1.0))(roots)


def _key(root: PRNGKeyArray, t: Array) -> PRNGKeyArray:
    return key_for(root, "act", t)


class Exploration:
    """The rows that agents collect in a task: an `Experience` for `Fit`.

    A row in the file is observation, action, reward, next observation, terminal, timeout, float32. Row `r` comes from copy
    `r % copies`. Actions are as the policy drew them; the simulator gets them clipped to the bounds.

    Args:
        task: in which agents act.
        agent: one of the lanes; it defines the contents of batches.
        seeds: one per lane.
        updates: in the whole run.
        settings: of the alternation of acting and updates.
        paths: of the replay files, one per lane; none: rows are kept only in memory.
        threads: of the simulator; None: all cores.

    Raises:
        UserError: a task or an agent that does not support online training.
    """

    revision: ClassVar[int] = 1
    logged = 0  # see `Experience`

    def __init__(
        self,
        task: Task,
        agent: Agent,
        seeds: Sequence[int],
        updates: int,
        settings: Online,
        paths: Sequence[Path] = (),
        threads: int | None = None,
    ):
        if len(task.observation_shape) != 1:
            raise UserError(f"{task.name}: online learning needs flat observations, it has shape {task.observation_shape}")
        self.task, self.settings, self.seeds, self.paths = task, settings, list(seeds), list(paths)
        self.learns = type(agent).__name__
        self.spec = self._spec()
        self.needs = needs = agent.needs(self.spec)
        shape = task.observation_shape
        self.columns = row_columns(task)
        # Transitions of several steps are summed when they are drawn, up to the ends of their episodes.
        sums = self._sums and needs.sums
        fields = {name: shape for name, shape in self.columns.items() if sums or name != "timeout"} | self._further(needs)
        # All columns are float32 in the file, which holds the numbers of discrete actions exactly.
        kinds = {"action": np.dtype(np.int32)} if self.spec.discrete else {}
        self.fields = {name: (shape, kinds.get(name, np.dtype(np.float32))) for name, shape in fields.items()}
        plain = (sums or needs.n_step == 1) and not (needs.window or needs.initial)
        if set(needs.columns) - {*fields, *(["discount"] * sums)} or not plain or not self._fits(agent):
            raise UserError(f"{type(agent).__name__} does not {self._learning}")
        if needs.standardise and self._as_it_is:
            why = "observations are standardised by those of a log, and nothing is known of a task"
            how = ", or continue a run on a log" if agent.fine_tunes else ""
            raise UserError(f"{type(agent).__name__}.standardise: {why}; leave it out{how}")
        self.view = Normalizer.of(self.spec, needs.standardise)
        self.block = settings.updates_per_block
        self.copies = settings.copies
        seeds_of = [sequence(seed, "act").generate_state(self.copies, np.uint64) for seed in seeds]
        self.simulator: Any = task.simulate([int(s) for s in np.concatenate(seeds_of)], threads)
        self._shape = len(seeds), self.copies
        self.metrics: dict[str, np.ndarray] = {}
        self.seen = self.simulator.reset().reshape(*self._shape, *shape)
        self._action = slice(shape[0], shape[0] + int(np.prod(self.columns["action"])))
        # The memory of policies that have one, at the start of an episode.
        begin = lambda: agent.policy(agent.init(self.spec, jax.random.key(0))).start(self.copies)  # noqa: E731
        remembers = jax.tree.leaves(eqx.filter_eval_shape(begin))
        self._fresh = jax.tree.map(lambda leaf: jnp.stack([leaf] * len(seeds)), begin()) if remembers else ()
        self.carry = self._fresh
        self.replay = Replay(row_width(task), settings.steps(updates), len(seeds), self._learnable, paths, self._learned)
        self._begin(agent)

    _learning = "learn online"  # what a refused agent cannot do, for the error
    _as_it_is = True  # whether agents get observations as they are in the task
    _sums = True  # whether transitions of several steps are supported; subclasses with other rows do not support them

    def _spec(self) -> Spec:
        """The spec before there are rows."""
        if self.settings.explore < 1:
            raise UserError(
                "explore, the number of environment steps with random actions before the first update, must be 1 or more where "
                f"no log is learned from, got {self.settings.explore}"
            )
        return Spec.empty(self.task.observation_shape, self.task.action_space, self.task.name)

    def _fits(self, agent: Agent) -> bool:
        """Whether an agent can be trained on such rows."""
        return agent.online

    def _further(self, needs: BatchSpec) -> dict[str, tuple[int, ...]]:
        """Further columns, as learners get them, whose values become known only after their row."""
        return {}

    @property
    def _learned(self) -> int | None:
        """Numbers in a row as learners get it; None: as many as in the files."""
        return None

    def _begin(self, agent: Any) -> None:
        """Further initialisation of subclasses; `agent` is one of the lanes."""

    def show(self, log: Dataset) -> None:
        """Takes demonstrations, on which some agents are trained first.

        Raises:
            UserError: this agent takes none.
        """
        raise UserError(f"{self.learns} takes no demonstrations")

    def _learnable(self, rows: np.ndarray) -> np.ndarray:
        out = rows.copy()
        out[..., self._action] = self.view.to_unit(rows[..., self._action])
        return out

    @property
    def count(self) -> int:
        """See `Experience`."""
        return self.replay.count

    @property
    def environment_steps(self) -> int:
        """Steps taken, in every lane."""
        return self.replay.count

    def extend(self, learner: Any, states: Any, roots: Key[Array, "l"], step: int) -> tuple[Any, dict[str, Array]]:
        """See `Experience`."""
        self._collect(learner, states, roots, self.settings.steps(step + self.block))
        return states, {"packed": self.replay.buffer}

    def last(self, steps: int) -> dict[str, Float[Array, "l n *s"]]:
        """Columns of the last rows of all lanes."""
        rows = jax.lax.dynamic_slice_in_dim(self.replay.buffer, self.environment_steps - steps, steps, 1)
        return unpacked(rows, self.columns)

    def _collect(self, learner: Any, states: Any, roots: Key[Array, "l"], due: int) -> None:
        """Acts until there are `due` rows."""
        rows = [self._step(learner, states, roots, at) for at in range(self.replay.count, due, self.copies)]
        if rows:
            made = np.concatenate(rows, 1)
            if self._as_it_is and self.replay.count == 0:
                self._tell(made[0, :, : self.spec.observation_size])
            self._keep(made)

    def _tell(self, observed: Float[np.ndarray, "n o"]) -> None:
        """Warns of large observations; whether they stay small is not known after a few steps."""
        seen = Statistics.of(observed)
        if told := about_dimensions(seen, large(seen), [f"observation {i}" for i in range(observed.shape[1])]):
            do = "observe it in other units, by `gymnasium.wrappers.TransformObservation` for example"
            warnings.warn(f"{self.task.name}: {told}; networks learn slowly from large numbers: {do}", stacklevel=2)

    def _keep(self, rows: Float[np.ndarray, "l n w"]) -> None:
        """Adds the lanes' new rows to the training rows."""
        self.replay.append(rows)

    def _step(self, learner: Any, states: Any, roots: Key[Array, "l"], at: int) -> np.ndarray:
        """One step of every copy as rows; `at` is the number of steps that a lane has taken before."""
        turn = jnp.int32(at // self.copies)
        if at < self.settings.explore:
            unit = _explore(roots, turn, (self.copies, self.spec.action_size), self.spec.discrete)
        else:
            seen = jnp.asarray(self.view.observe(self.seen))
            unit, self.carry = _act(learner, states, seen, self.carry, roots, turn)
        unit = np.asarray(unit)
        actions = np.asarray(self.view.from_unit(unit), np.float32)
        actions = actions.reshape(-1, *self.columns["action"])
        taken = actions if self.spec.discrete else np.clip(actions, self.view.low, self.view.high)
        seen, reward, terminal, timeout = self.simulator.step(taken)
        flat = (self.seen.reshape(seen.shape), actions.reshape(len(seen), -1), reward[:, None], seen,
                terminal[:, None], timeout[:, None])  # fmt: skip
        rows = np.concatenate([np.asarray(part, np.float32) for part in flat], 1)
        over = np.flatnonzero(terminal | timeout)
        self.seen = seen.reshape(self.seen.shape)
        if len(over):
            self._begin_episodes(over)
        return rows.reshape(*self._shape, -1)

    def _begin_episodes(self, over: np.ndarray) -> None:
        """Begins an episode in these copies, numbered through all lanes."""
        seen = self.seen.reshape(-1, *self.seen.shape[2:])
        seen[over] = self.simulator.reset(over)
        begins = np.isin(np.arange(len(seen)), over).reshape(self._shape)
        self.carry = jax.tree.map(lambda now, fresh: _where(begins, fresh, now), self.carry, self._fresh)
        self.seen = seen.reshape(self.seen.shape)

    def flush(self) -> None:
        """See `Experience`."""
        self.replay.flush()

    def state(self) -> dict[str, Any]:
        """See `Experience`: the simulator's state, the last observations, the policies' memory, and the number of rows."""
        own = {"seen": self.seen, "count": np.asarray(self.replay.count), "carry": self.carry}
        return {"simulator": self.simulator.state(), **own}

    def restore(self, state: dict[str, Any]) -> None:
        """See `Experience`."""
        lost = self.simulator.restore(state["simulator"])
        self.seen = np.array(state["seen"])
        self.carry = jax.device_put(state["carry"])
        if lost is not None:
            self._cut(lost, int(state["count"]))
        self.replay.restore(int(state["count"]))
        if lost is not None:
            told = "when seed and actions are repeated it shows something else, so it draws from elsewhere"
            warnings.warn(f"{self.task.name}: {told}; {len(lost)} episodes start again", stacklevel=2)
            self._begin_episodes(lost)

    def _cut(self, lost: np.ndarray, count: int) -> None:
        """Ends the episodes of these copies, numbered through all lanes, by a timeout in their last rows in the files."""
        terminal, timeout = self.replay.width - 2, self.replay.width - 1
        for lane, copy in zip(*np.divmod(lost, self.copies)) if count else ():
            row = count - self.copies + int(copy)
            if not read_rows(self.paths[lane], self.replay.width, count)[row, terminal]:
                self.replay.set(int(lane), row, timeout, 1.0)


def _where(which: np.ndarray, fresh: Array, now: Array) -> Array:
    """`fresh` (lanes, copies, ...) where `which` (lanes, copies) is true, else `now`."""
    return jnp.where(which.reshape(*which.shape, *[1] * (now.ndim - 2)), fresh, now)
