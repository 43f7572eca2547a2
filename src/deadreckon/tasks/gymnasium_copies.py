"""Copies of any Gymnasium environment, stepped one after the other.

They are not stepped by Gymnasium's vector environments: these begin the next episode by themselves, or refuse to step while a
copy's episode is over, where here it rests until its `reset`. The steps are the same bit for bit (a test compares them).
"""

import math
import weakref
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.tasks.task import Starts, checked_actions

if TYPE_CHECKING:
    from deadreckon.tasks.gymnasium_task import GymnasiumTask


class GymnasiumCopies:
    """A `Simulator` of one kind of environment. Each episode begins with `env.reset(seed=...)`.

    So an episode follows from its seed and actions alone, as far as the environment keeps Gymnasium's rule that all that is
    random in it is drawn from `np_random`. See `episode_seed`.
    """

    def __init__(self, task: "GymnasiumTask", seeds: Sequence[int]):
        copies = len(seeds)
        self.task = task
        self._starts = Starts(seeds, lambda generator: np.zeros(0))  # which counts; environments draw for themselves
        self._envs: list[Any] = [None] * copies
        self._discrete = isinstance(task.action_space, Discrete)
        size = () if self._discrete else (task.action_space.size,)
        self._shape = copies, *size
        self._taken = np.zeros((copies, task.horizon, *size), np.int32 if self._discrete else np.float32)
        self._seen = np.zeros((copies, *task.observation_shape), task.observation_dtype)
        self._age = np.zeros(copies, int)
        self._alive = np.zeros(copies, bool)
        self._gained = np.zeros(copies)  # rewards of the episode under way
        self._end = weakref.finalize(self, _close, self._envs)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Starts episodes; see `Simulator.reset`."""
        which, _ = self._starts.begun(which, seeds)
        for i in which.tolist():
            self._seen[i] = self._begin(i)
        self._age[which], self._alive[which], self._gained[which] = 0, True, 0.0
        return self._seen[which]

    def _begin(self, copy: int) -> np.ndarray:
        """Begins the episode that the count of starts says; gives its first observation."""
        if self._envs[copy] is None:
            self._envs[copy] = self.task.make()
        seed = episode_seed(int(self._starts.seeds[copy]), int(self._starts.drawn[copy]) - 1)
        call = f"reset(seed={seed})"
        try:
            seen = self.task.spaces.observe(self._envs[copy].reset(seed=seed)[0])
        except Exception as error:  # whatever the environment raises is its author's to mend
            raise _broken(self.task.name, call, error) from error
        return self._finite(call, seen)

    def _advance(self, copy: int, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool]:
        try:
            seen, reward, terminated, truncated, _ = self._envs[copy].step(self.task.spaces.act(action))
            seen, reward = self.task.spaces.observe(seen), float(reward)
            done = bool(terminated), bool(truncated)
        except Exception as error:  # whatever the environment raises is its author's to mend
            raise _broken(self.task.name, f"step({action.tolist()})", error) from error
        return self._finite(f"step({action.tolist()})", seen, reward), reward, *done

    def _finite(self, call: str, seen: np.ndarray, reward: float = 0.0) -> np.ndarray:
        """The observation, refused where it or the reward is not finite."""
        if not math.isfinite(reward):
            raise UserError(f"{self.task.name}: the environment's {call} gave the reward {reward}, a finite number is needed")
        if seen.dtype.kind == "f" and not np.isfinite(seen).all():
            numbers = " ".join(f"{each:g}" for each in seen.ravel()[:8])
            raise UserError(f"{self.task.name}: the environment's {call} gave an observation that is not finite: {numbers}")
        return seen

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) continuous actions or (copies,) numbers of discrete ones; see `Simulator.step`.

        Rewards are float64, as the environment gives them. A copy whose episode has ended rests until its `reset`.
        """
        running = np.flatnonzero(self._alive)
        actions = self._checked(actions, running)
        rewards = np.zeros(len(self._age))
        terminals, timeouts = np.zeros((2, len(self._age)), bool)
        for i in running.tolist():
            self._seen[i], rewards[i], terminals[i], timeouts[i] = self._advance(i, actions[i])
        self._gained += rewards
        self._taken[running, self._age[running]] = actions[running]
        self._age[running] += 1
        timeouts = self._alive & ~terminals & (timeouts | (self._age >= self.task.horizon))
        self._alive &= ~(terminals | timeouts)
        return self._seen.copy(), rewards, terminals, timeouts

    def _checked(self, actions: np.ndarray, running: np.ndarray) -> np.ndarray:
        """Actions as they are kept.

        Raises:
            UserError: another shape, a number that is not finite, or none of the discrete actions.
        """
        if not self._discrete:
            return checked_actions(actions, self._shape, self.task.name, running)
        actions, count = np.asarray(actions), self.task.action_space.size
        if actions.shape != self._shape:
            raise UserError(f"{self.task.name}: actions have shape {actions.shape}, {self._shape} is needed")
        chosen = actions[running]
        wrong = ~((chosen >= 0) & (chosen < count) & (chosen == np.floor(chosen)))
        if wrong.any():
            raise UserError(f"{self.task.name}: an action is {chosen[wrong][0]}, a number from 0 to {count - 1} is needed")
        return np.where(self._alive, actions, 0).astype(np.int32)

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`. What the environments hold is left out: it follows from seeds and the episodes' actions."""
        return {"taken": self._taken.copy(), "last": self._seen.copy(), "age": self._age.copy(), "alive": self._alive.copy(),
                "gained": self._gained.copy(), **self._starts.state()}  # fmt: skip

    def restore(self, state: dict[str, np.ndarray]) -> np.ndarray | None:
        """See `Simulator.restore`. The episodes under way are played again, at most a horizon of steps.

        Returns:
            Copies that show or pay something else then than they did: their environment draws from elsewhere than from its
            seed, or keeps something from episode to episode.
        """
        self._taken[:], self._seen[:] = state["taken"], state["last"]
        self._age[:], self._alive[:] = state["age"], state["alive"]
        self._starts.restore(state)
        before = state["gained"]
        lost = []
        for i in np.flatnonzero(self._alive).tolist():
            seen, over, self._gained[i] = self._begin(i), False, 0.0
            for action in self._taken[i, : self._age[i]]:
                if over:
                    break
                seen, reward, terminated, truncated = self._advance(i, action)
                self._gained[i] += reward
                over = terminated or truncated
            if over or self._gained[i] != before[i] or not np.array_equal(seen, self._seen[i], equal_nan=True):
                lost.append(i)
        return np.array(lost) if lost else None

    def close(self) -> None:
        """Closes the environments, as losing the simulator does."""
        self._end()


def episode_seed(seed: int, number: int) -> int:
    """What `env.reset(seed=...)` gets, below 2^32, for a copy's episode of that number, from 0.

    The first episode gets the copy's own seed (reduced if it is 2^32 or more), later ones follow from it and the number: so no
    episode depends on how long those before it were.
    """
    if number == 0 and seed < 2**32:
        return seed
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def _broken(name: str, call: str, error: Exception) -> UserError:
    what = " ".join(str(error).split())[:200]
    return UserError(f"{name}: the environment's {call} raised {type(error).__name__}: {what}")


def _close(envs: list[Any]) -> None:
    for env in envs:
        if env is not None:
            env.close()
    envs[:] = [None] * len(envs)
