"""What a judge is: a simulator, a horizon and reference scores. Nothing here knows of methods."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from deadreckon.data.spec import Box, Discrete


@dataclass(frozen=True)
class Reference:
    """Mean undiscounted returns that define the scores 0 (uniform random actions) and 100 (expert), thesis 7.3."""

    random: float
    expert: float
    source: str

    def normalise(self, returns: np.ndarray | float) -> np.ndarray:
        """Returns on the scale where random is 0 and the expert is 100."""
        return 100.0 * (np.asarray(returns, np.float64) - self.random) / (self.expert - self.random)


class Simulator(Protocol):
    """Several copies of one environment, stepped together; copy `i` depends on its own seed and actions alone."""

    def reset(self) -> np.ndarray:
        """Starts one episode in every copy and gives their observations, (copies, *shape)."""
        ...

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) actions; gives observations, rewards, terminals and timeouts, one row a copy.

        After a copy's episode has ended, its rows mean nothing until the next `reset`.
        """
        ...


@dataclass(frozen=True)
class Task:
    """A place where policies are judged. Domains subclass it and implement `simulate`.

    Attributes:
        name: such as `maze2d-umaze` or `maze2d-eval-large-dense`.
        domain: such as `maze2d`.
        horizon: steps after which an episode times out.
        observation_shape: of one observation.
        action_space: bounds of the environment.
        gym_id: the Gymnasium id of the same environment.
        reference: measured on this simulator, for normalised scores.
        published: the original benchmark's reference scores, where they exist; shown beside, never mixed in.
        split: "training" (settings may be tuned here) or "evaluation", thesis Table D.3.
        summary: one line on what is to be done.
    """

    name: str
    domain: str
    horizon: int
    observation_shape: tuple[int, ...]
    action_space: Box | Discrete
    gym_id: str
    reference: Reference
    published: Reference | None = None
    split: str = "training"
    summary: str = ""
    # Left out of the hash, which a dict has none of, so that tasks can be keys.
    extra: dict[str, Any] = field(default_factory=dict, hash=False)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> Simulator:
        """One copy of the environment for each seed.

        Args:
            seeds: one a copy, 0 or more.
            threads: to step with; all cores if None. Results do not depend on it.
        """
        raise NotImplementedError
