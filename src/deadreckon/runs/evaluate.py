"""Evaluation of policies in a simulator: returns per episode, scores, intervals, and the thesis's checks of a critic."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.spec import Discrete
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.policies.deployed import EnvPolicy, first_actions, picture_shape
from deadreckon.policies.resolve import policies_of
from deadreckon.randomness import check_seed
from deadreckon.runs.settings import ReturnOptions, ReturnSettings
from deadreckon.stats.crossed import mean_interval
from deadreckon.stats.interval import PERCENT, Interval
from deadreckon.tasks.registry import task as find_task
from deadreckon.tasks.task import Simulator, Task
from deadreckon.tasks.turns import begun, simulating, turns

REVISION = 1  # of the evaluation of policies in a simulator; raised when scores change (see bench/identity.py)


@dataclass(frozen=True)
class Evaluation:
    """The returns of policies in a task.

    Attributes:
        task: in which they acted.
        returns: (policies, episodes) undiscounted.
        discounted: (policies, episodes) with `discount`.
        lengths: (policies, episodes) steps.
        discount: of `discounted`, one per policy.
        names: one per policy.
        trajectories: (policies, recorded, steps, *any) observations of the first episodes before each action, or other values
            that the task shows; NaN after the end of an episode.
    """

    task: Task
    returns: np.ndarray
    discounted: np.ndarray
    lengths: np.ndarray
    discount: tuple[float, ...]
    names: tuple[str, ...]
    trajectories: np.ndarray | None = field(default=None, repr=False)

    @property
    def scores(self) -> np.ndarray | None:
        """(policies, episodes) on the scale on which random is 0 and the expert 100; None if the task has no such scale."""
        return self.task.scores(self.returns)

    def score(self, policy: int | None = None) -> Interval | None:
        """Normalised score of one policy, or of all policies together, with its interval; None if there are no scores."""
        scores = self.scores
        return None if scores is None else mean_interval(scores if policy is None else scores[policy])

    def published_score(self, policy: int | None = None) -> Interval | None:
        """The score by the benchmark's own reference returns; None if it has none, or if `score` uses them."""
        scale = self.task.published
        if scale is None or scale == self.task.reference:
            return None
        return mean_interval(scale.normalise(self.returns if policy is None else self.returns[policy]))

    def __str__(self) -> str:
        lines = [f"{self.task.name}: {self.returns.shape[1]} episodes per policy, {PERCENT} intervals"]
        width = max(map(len, self.names))
        for i, name in (*enumerate(self.names), *([(None, "all")] if len(self.names) > 1 else [])):
            line = f"  {name:<{width}}  return {mean_interval(self.returns if i is None else self.returns[i]):.1f}"
            line += f"   score {score:.1f}" if (score := self.score(i)) is not None else ""
            line += f"   by D4RL's references {theirs:.1f}" if (theirs := self.published_score(i)) is not None else ""
            lines.append(line)
        return "\n".join(lines)


def episode_seeds(seed: int, episodes: int) -> list[int]:
    """Seeds of the episodes; episode `i` starts the same way for every policy, however many there are."""
    return [int(np.random.SeedSequence([seed, i]).generate_state(1)[0]) for i in range(episodes)]


def action_key(seed: Any, t: Any) -> jax.Array:
    """The key of all policies' draws at step `t`: the draws of one do not depend on how many are evaluated beside it."""
    return jax.random.fold_in(jax.random.key(seed), t)


@eqx.filter_jit
def _act(stacked: EnvPolicy, step: Step, carry: Any, seed: jax.Array, t: jax.Array, greedy: bool) -> tuple[jax.Array, Any]:
    key = action_key(seed, t)
    return jax.vmap(lambda p, s, c: p.act(s, c, key, greedy=greedy))(stacked, step, carry)


class _Actors:
    """Several policies as one function of (policies, n, *shape) observations; networks of equal shapes are one program."""

    def __init__(self, policies: Sequence[Any], n: int, seed: int, greedy: bool):
        # Floats of a policy also become arrays, so that policies that differ in them are still one program.
        policies = [jax.tree.map(jnp.asarray, p) if isinstance(p, EnvPolicy) else p for p in policies]
        self.policies, self.seed, self.greedy = policies, seed, greedy
        self.groups: list[tuple[list[int], Any]] = []
        self.carries: list[Any] = []
        self.others: dict[int, Any] = {}
        alike: dict[Any, list[int]] = {}
        for i, policy in enumerate(policies):
            if isinstance(policy, EnvPolicy):
                shapes = tuple((leaf.shape, str(leaf.dtype)) for leaf in jax.tree.leaves(policy))
                alike.setdefault((jax.tree.structure(policy), shapes), []).append(i)
            else:
                self.others[i] = policy.start(n)
        for members in alike.values():
            stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(policies[i] for i in members))
            self.groups.append((members, stacked))
            starts = [policies[i].start(n) for i in members]
            self.carries.append(jax.tree.map(lambda *leaves: jnp.stack(leaves), *starts))

    def __call__(self, step: Step, t: int) -> np.ndarray:
        actions: dict[int, np.ndarray] = {}
        for g, (members, stacked) in enumerate(self.groups):
            part = Step(*(np.asarray(x)[members] for x in step))
            when = jnp.uint32(self.seed), jnp.int32(t)
            out, self.carries[g] = _act(stacked, part, self.carries[g], *when, self.greedy)
            actions |= dict(zip(members, np.asarray(out)))
        for i, carry in self.others.items():
            own = Step(*(np.asarray(x)[i] for x in step))
            key = np.random.default_rng([self.seed, t])
            out, self.others[i] = self.policies[i].act(own, carry, key, greedy=self.greedy)
            actions[i] = np.asarray(out)
        shapes = {actions[i].shape for i in range(len(self.policies))}
        if len(shapes) > 1:
            raise UserError(f"the policies give actions of different shapes: {', '.join(map(str, sorted(shapes)))}")
        return np.stack([actions[i] for i in range(len(self.policies))])


def evaluate(
    policies: Any,
    task: Any,
    *,
    episodes: int = 100,
    seed: int = 0,
    names: Sequence[str] | None = None,
    record: int = 0,
    **options: Unpack[ReturnOptions],
) -> Evaluation:
    """Evaluates policies in a task's simulator, with all policies and episodes in parallel.

    If a task cannot have that many copies (`Task.most_copies`), they run one after another, with the same results.

    Args:
        policies: a `Policy`, a policy file, a Run, or a sequence of these.
        task: a task, its name, or a Gymnasium environment, its id, or a function that makes one; see `tasks.registry.task`.
        episodes: for each policy; all policies get the same starts.
        seed: of initial states and of sampled actions.
        names: shown for the policies.
        record: number of episodes whose trajectories are kept for figures.
        **options: `discount` and `horizon` of the discounted returns, and `greedy`; see `runs.settings.ReturnSettings`.

    Raises:
        UserError: an unknown task, no episodes, settings out of range, or actions and observations of other sizes.
    """
    settings = ReturnSettings.of(options)
    settings.check_values()
    check_seed(seed)
    task = find_task(task)
    if episodes < 1:
        raise UserError(f"episodes must be >= 1, got {episodes}")
    found = policies_of(policies)
    if not found:
        raise UserError("no policy to evaluate")
    if len(settings.discounts) not in (1, len(found)):
        raise UserError(f"discount must be one for all policies or one each ({len(found)}), got {len(settings.discounts)}")
    discounts = np.broadcast_to(np.asarray(settings.discounts, np.float64), (len(found),))
    names = tuple(names) if names else tuple(f"policy {i}" for i in range(len(found)))
    if len(names) != len(found):
        raise UserError(f"{len(found)} policies need as many names, got {len(names)}")
    for name, policy in zip(names, found, strict=True):
        _check_fit(policy, task, name)
    shape, seeds = (len(found), episodes), episode_seeds(seed, episodes) * len(found)
    sums = _Sums(shape, settings.horizon, discounts, record)
    with simulating(task, seeds) as simulator:
        for turn in turns(task, len(seeds)):
            _run(_Actors(found, episodes, seed, settings.greedy), task, simulator, turn, seeds, sums)
    returns, discounted, lengths = sums.returns, sums.discounted, sums.lengths
    return Evaluation(task, returns, discounted, lengths, tuple(discounts.tolist()), names, sums.trajectories())


class _Sums:
    """Accumulated results of (policies, episodes): sums of rewards, lengths, and recorded frames of the first episodes."""

    def __init__(self, shape: tuple[int, int], horizon: int | None, discounts: np.ndarray, record: int):
        self.shape, self.horizon, self.discounts, self.record = shape, horizon, discounts, min(record, shape[1])
        self.returns, self.discounted, self.lengths = np.zeros(shape), np.zeros(shape), np.zeros(shape, int)
        self.frames: list[np.ndarray] = []

    def add(self, t: int, alive: np.ndarray, rewards: np.ndarray) -> None:
        """A step of the episodes that are `alive`, (policies, episodes) as the rewards, which are 0 for others."""
        self.returns += rewards
        if self.horizon is None or t < self.horizon:
            self.discounted += rewards * self.discounts[:, None] ** t
        self.lengths += alive

    def show(self, t: int, task: Task, simulator: Simulator, observations: np.ndarray, turn: np.ndarray, alive: np.ndarray):
        """Stores a frame of each copy of a turn whose episode is recorded."""
        policy, episode = np.divmod(turn, self.shape[1])
        which = np.flatnonzero(episode < self.record)
        if not len(which):
            return
        shown = task.shown(simulator, observations, which)
        if t == len(self.frames):
            self.frames.append(np.full((self.shape[0], self.record, *shown.shape[1:]), np.nan, np.float32))
        lives = alive.ravel()[turn[which]]
        self.frames[t][policy[which][lives], episode[which][lives]] = shown[lives]

    def trajectories(self) -> np.ndarray | None:
        """See `Evaluation.trajectories`."""
        return np.stack(self.frames, 2) if self.record else None


def _run(actors: _Actors, task: Task, simulator: Simulator, turn: np.ndarray, seeds: Sequence[int], sums: _Sums) -> None:
    """Runs the episodes of a turn to their ends.

    Policies always act for all episodes, with zeros for those of other turns, so that their draws do not depend on turns.
    """
    shape, t = sums.shape, 0
    observations = begun(simulator, turn, seeds)
    copies = min(task.most_copies or len(seeds), len(seeds))
    rewards, first, alive = np.zeros(shape), np.ones(shape, bool), np.isin(np.arange(len(seeds)), turn).reshape(shape)
    wanted = () if isinstance(task.action_space, Discrete) else (task.action_space.size,)
    while t < task.horizon and alive.any():
        if sums.record:
            sums.show(t, task, simulator, observations, turn, alive)
        seen = _of_all(observations, turn, len(seeds))
        actions = actors(Step(seen.reshape(*shape, *seen.shape[1:]), rewards, first), t)
        if t == 0 and actions.shape != (*shape, *wanted):
            raise UserError(f"{task.name} takes actions of shape {wanted}, the policy gave {actions.shape[2:]}")
        acted = np.zeros((copies, *wanted), actions.dtype)
        acted[: len(turn)] = actions.reshape(len(seeds), *wanted)[turn]
        observations, *told = (column[: len(turn)] for column in simulator.step(acted))
        rewards, terminal, timeout = (_of_all(column, turn, len(seeds)).reshape(shape) for column in told)
        first = np.zeros(shape, bool)
        rewards = np.where(alive, rewards, 0.0)  # undefined after an episode's end, where it can be NaN
        sums.add(t, alive, rewards)
        alive, t = alive & ~(terminal | timeout), t + 1


def _of_all(values: np.ndarray, turn: np.ndarray, episodes: int) -> np.ndarray:
    """(episodes, ...) with the values (turn, ...) for the episodes of a turn, and zeros for others."""
    if len(turn) == episodes:
        return values
    out = np.zeros((episodes, *values.shape[1:]), values.dtype)
    out[turn] = values
    return out


def _check_fit(policy: Any, task: Task, name: str) -> None:
    """Checks a policy of this package on the shape of one observation, before the simulator starts."""
    if not isinstance(policy, EnvPolicy):
        return
    if (shape := picture_shape(policy)) is not None and shape != task.observation_shape:
        raise UserError(f"{name} takes images of shape {shape}, {task.name} has {task.observation_shape}")
    try:
        seen = jax.ShapeDtypeStruct((1, *task.observation_shape), task.observation_dtype)
        jax.eval_shape(lambda observation: first_actions(policy, observation, jax.random.key(0), True), seen)
    except (TypeError, ValueError) as error:
        raise UserError(f"{name} does not take {task.name}'s observations of shape {task.observation_shape}") from error
