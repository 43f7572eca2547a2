"""What a judge is: a simulator, a horizon and reference scores. Nothing here knows of methods."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.versions import cores

if TYPE_CHECKING:
    from deadreckon.data.dataset import Dataset


@dataclass(frozen=True)
class Reference:
    """Mean undiscounted returns that define the scores 0 (random actions) and 100 (expert), thesis 7.3."""

    random: float
    expert: float
    source: str

    def normalise(self, returns: np.ndarray | float) -> np.ndarray:
        """Returns on the scale where random is 0 and the expert is 100."""
        return 100.0 * (np.asarray(returns, np.float64) - self.random) / (self.expert - self.random)


# Of tasks and their logs: thesis 7.2, and behind these what Table 8.1 adds (H, L and T there; R are sparse rewards).
PROPERTIES = (
    "narrow data", "undirected data", "sparse rewards", "suboptimal data", "non-representable policies",
    "non-Markovian policies", "partial observability", "realistic",
    "high-dimensional", "long horizon", "temporally extended",
)  # fmt: skip


class Simulator(Protocol):
    """Several copies of one environment, stepped together; copy `i` depends on its own seed and actions alone."""

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Starts an episode in the copies `which` (indices; all if None) and gives their observations, (which, *shape).

        A copy's episodes are drawn from its seed one after the other; `seeds`, one for each of `which`, begin anew.
        """
        ...

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) actions; gives observations, rewards, terminals and timeouts, one row a copy.

        After a copy's episode has ended, its rows mean nothing until the next `reset`.
        """
        ...

    def state(self) -> dict[str, np.ndarray]:
        """Everything that the future depends on, as arrays of fixed shapes; `restore` takes it."""
        ...

    def restore(self, state: dict[str, np.ndarray]) -> np.ndarray | None:
        """Goes on where `state` was taken, in any simulator of the same task and number of copies.

        Returns:
            Copies (indices) whose episode could not be taken up again, which need a `reset`; None: all go on.
        """
        ...


class Starts:
    """Where the episodes of several copies begin: a generator a copy, whose place is told by its seed and a count.

    Args:
        seeds: one a copy.
        draw: gives a start from a generator.
        generator: of a seed.

    Raises:
        UserError: no seed, or one below 0.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        draw: Callable[[Any], np.ndarray],
        generator: Callable[[int], Any] = np.random.default_rng,
    ):
        self.seeds = np.zeros(len(seeds), np.uint64)
        self.draw, self._generator = draw, generator
        self.drawn = np.zeros(len(seeds), np.int64)
        self._generators: list[Any] = [None] * len(seeds)
        self.begin(np.arange(len(seeds)), seeds)

    def begin(self, which: np.ndarray, seeds: Sequence[int]) -> None:
        """Gives the copies `which` new seeds."""
        if len(which) == 0 or len(which) != len(seeds) or any(seed < 0 for seed in seeds):
            raise UserError(f"one seed per copy is needed, each 0 or more, got {list(seeds)} for {len(which)} copies")
        for i, seed in zip(which, seeds):
            self.seeds[i], self.drawn[i] = seed, 0
            self._generators[i] = self._generator(int(seed))

    def begun(self, which: np.ndarray | None, seeds: Sequence[int] | None) -> tuple[np.ndarray, list[np.ndarray]]:
        """The copies (indices) in which `Simulator.reset` with these arguments starts episodes, and the start of each."""
        which = np.arange(len(self.seeds)) if which is None else np.asarray(which)
        if seeds is not None:
            self.begin(which, seeds)
        return which, [self.next(copy) for copy in which]

    def next(self, copy: int | np.integer) -> np.ndarray:
        """The copy's next start."""
        self.drawn[copy] += 1
        return self.draw(self._generators[copy])

    def state(self) -> dict[str, np.ndarray]:
        """Seeds and counts."""
        return {"seeds": self.seeds.copy(), "drawn": self.drawn.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where `state` was taken, by drawing again what had been drawn."""
        self.begin(np.arange(len(self.seeds)), [int(seed) for seed in state["seeds"]])
        for copy, drawn in enumerate(state["drawn"]):
            for _ in range(int(drawn)):
                self.next(copy)


def checked_actions(actions: np.ndarray, shape: tuple[int, ...], task: str, running: np.ndarray) -> np.ndarray:
    """Actions as float32, which is what logs hold: a log, replayed, then repeats itself.

    Raises:
        UserError: another shape than (copies, size), or a `running` copy's action that is not finite.
    """
    actions = np.asarray(actions, np.float32)
    if actions.shape != shape:
        raise UserError(f"{task}: actions have shape {actions.shape}, {shape} is needed")
    if not np.isfinite(actions[running]).all():
        copy = int(running[np.argwhere(~np.isfinite(actions[running]))[0][0]])
        raise UserError(f"{task}: the action of copy {copy} is {actions[copy].tolist()}, numbers are needed")
    return actions


def thread_count(threads: int | None, task: str) -> int:
    """`threads`, or all cores that this process may use.

    Raises:
        UserError: fewer than one.
    """
    if threads is not None and threads < 1:
        raise UserError(f"{task}: threads must be 1 or more, got {threads}")
    return threads or len(cores())


@dataclass(frozen=True)
class Task:
    """A place where policies are judged. Domains subclass it and implement `simulate`.

    Attributes:
        revision: raised in the class whose code has changed observations, rewards, ends or scores (class attribute).
            Results of suites are told apart by it (see bench/identity.py).
        name: such as `maze2d-umaze` or `maze2d-eval-large-dense`.
        domain: such as `maze2d`.
        horizon: steps after which an episode times out.
        observation_shape: of one observation.
        action_space: bounds of the environment.
        gym_id: the Gymnasium id of the same environment.
        reference: for normalised scores: measured on this simulator, or the benchmark's where its scale is everybody's. None
            where none is known: then there are raw returns, and no scores.
        published: the original benchmark's reference scores, where they exist.
        split: "training" or "evaluation" (where settings must not be tuned), thesis Table D.3; empty where the table has none.
        summary: one line on what is to be done.
        properties: what makes it hard, among `PROPERTIES`: thesis 7.3, and Table 8.1 where it has the task.
        source: where the task comes from, thesis Table D.2.
        observation_dtype: numpy name of the dtype of observations: "float32", or "uint8" for pictures.
        places_matter: whether a picture that is moved by some pixels asks for other actions, as for one who drives.
    """

    revision: ClassVar[int] = 1

    name: str
    domain: str
    horizon: int
    observation_shape: tuple[int, ...]
    action_space: Box | Discrete
    gym_id: str
    reference: Reference | None
    published: Reference | None = None
    split: str = ""
    summary: str = ""
    properties: tuple[str, ...] = ()
    source: str = ""
    observation_dtype: str = "float32"
    places_matter: bool = False
    # Left out of the hash, which a dict has none of, so that tasks can be keys.
    extra: dict[str, Any] = field(default_factory=dict, hash=False)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> Simulator:
        """One copy of the environment for each seed.

        Args:
            seeds: one a copy, 0 or more.
            threads: to step with; all cores if None. Results do not depend on it.
        """
        raise NotImplementedError

    def scores(self, returns: np.ndarray | float) -> np.ndarray | None:
        """Returns on the scale of the reference; None where no reference is known."""
        return None if self.reference is None else self.reference.normalise(returns)

    @property
    def described(self) -> dict[str, Any]:
        """What logs of it say of the environment, as JSON values: see `data.environments`, which knows the package's tasks."""
        return {}

    @property
    def versions(self) -> Mapping[str, str]:
        """Of packages that results depend on beside those that are noted anyway (`versions.versions`)."""
        return {}

    def shown(self, simulator: Simulator, observations: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(which, *any) what pictures of these copies are drawn from, NaN where there is nothing: observations, or more.

        Args:
            simulator: of this task.
            observations: (copies, *shape), the last.
            which: copies.
        """
        return observations[which]

    @property
    def most_copies(self) -> int | None:
        """Copies that can be stepped side by side; None: any number. `simulate` refuses more; see `tasks.turns`."""
        return None

    @property
    def logs_pay_alike(self) -> bool:
        """Whether its logs have the rewards of the task, so that values estimated from them compare with returns in it."""
        return True

    def logged_returns(self, log: "Dataset") -> np.ndarray:
        """(episodes,) what the task pays for the episodes of one of its logs, undiscounted: here what the log says."""
        return log.returns()

    @property
    def ends(self) -> Callable[[Any], Any] | None:
        """Tells of observations (n, *shape), as numpy or JAX arrays, whether an episode ends there: (n,) bool.

        None where observations alone do not tell.
        """
        return None


def keeping_horizon(task: Task, horizon: int | None) -> Task:
    """The task, whose horizon is its own.

    Args:
        task: such as one of the package, or of a user.
        horizon: that is asked for; None: none.

    Raises:
        UserError: one is asked for, even if it is equal.
    """
    if horizon is not None:
        raise UserError(f"{task.name} has a horizon of its own, {task.horizon} steps; leave the other out")
    return task
