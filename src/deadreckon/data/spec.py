"""The spec of a log: spaces, ranges and statistics, without its rows."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from deadreckon.data.scratch import BLOCK
from deadreckon.errors import UserError

if TYPE_CHECKING:
    from deadreckon.data.dataset import Dataset


@dataclass(frozen=True)
class Box:
    """Continuous actions between `low` and `high`, each a tuple with one number per dimension."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self):
        # Floats whatever was given, so that equal bounds are equal, print alike and give one fingerprint.
        object.__setattr__(self, "low", tuple(map(float, self.low)))
        object.__setattr__(self, "high", tuple(map(float, self.high)))
        if len(self.low) != len(self.high) or not all(a < b for a, b in zip(self.low, self.high)):
            raise UserError(f"action bounds must satisfy low < high in every dimension, got {self.low} and {self.high}")

    @property
    def size(self) -> int:
        """Number of action dimensions."""
        return len(self.low)


@dataclass(frozen=True, repr=False)
class Discrete:
    """Actions 0 .. n-1.

    Attributes:
        n: number of actions.
        masked: whether not all of them are legal everywhere: the last `n` numbers of every observation are then 1 for those
            that are and 0 for the others (see `data.legal`).
    """

    n: int
    masked: bool = False

    def __repr__(self) -> str:
        return f"Discrete(n={self.n}{', masked=True' if self.masked else ''})"

    @property
    def size(self) -> int:
        """Number of actions, which is the width of a one-hot action or a row of logits."""
        return self.n


MOST_ACTIONS = 1_000_000  # discrete ones, of files from elsewhere: each takes room in memory
PICTURED = 2**24  # numbers of pictures that are in memory as float64 at once


@dataclass(frozen=True, eq=False)
class Statistics:
    """Per-dimension mean, standard deviation and range of a column, float64 arrays of the column's shape."""

    mean: np.ndarray
    std: np.ndarray
    min: np.ndarray
    max: np.ndarray

    @classmethod
    def of(cls, column: np.ndarray) -> "Statistics":
        """One pass over `column` (rows first) in blocks, so that a memory-mapped column is never loaded whole."""
        rows, shape, block = len(column), column.shape[1:], BLOCK
        if column.dtype == np.uint8:  # pictures
            block = max(1, PICTURED // max(1, int(np.prod(shape))))
        total, square = np.zeros(shape), np.zeros(shape)
        low, high = np.full(shape, np.inf), np.full(shape, -np.inf)
        # Shifted by the first row, so that squares of large offsets do not swallow the variance.
        shift = np.asarray(column[0], np.float64)
        for start in range(0, rows, block):
            part = np.asarray(column[start : start + block], np.float64)
            low, high = np.minimum(low, part.min(0)), np.maximum(high, part.max(0))
            part = part - shift
            total, square = total + part.sum(0), square + np.square(part).sum(0)
        mean = total / rows
        return cls(mean + shift, np.sqrt(np.maximum(square / rows - np.square(mean), 0.0)), low, high)


@dataclass(frozen=True, eq=False)
class Spec:
    """The spec of a log, which methods use before they receive rows.

    Attributes:
        observation_shape: shape of one observation.
        observation_dtype: numpy name, "float32" or, for images, "uint8".
        action: the action space as declared (environment) or, failing that, the range of the data.
        observation: statistics of the observations.
        actions: statistics of the logged actions; for `Discrete`, of their indices.
        reward: statistics of the rewards (scalars).
        rows: number of logged steps.
        episodes: number of episodes.
        longest: steps in the longest episode.
        returns: smallest and largest undiscounted return of an episode.
        name: the log's name, such as `maze2d-umaze-v1@dr1`.
    """

    observation_shape: tuple[int, ...]
    observation_dtype: str
    action: Box | Discrete
    observation: Statistics
    actions: Statistics
    reward: Statistics
    rows: int
    episodes: int
    longest: int
    returns: tuple[float, float]
    name: str

    @classmethod
    def empty(cls, observation_shape: tuple[int, ...], action: Box | Discrete, name: str) -> "Spec":
        """The spec of a log that has yet to be collected; its statistics are placeholders (mean 0, deviation 1)."""
        nothing = lambda shape: Statistics(np.zeros(shape), np.ones(shape), np.zeros(shape), np.zeros(shape))  # noqa: E731
        actions = nothing(() if isinstance(action, Discrete) else (action.size,))
        columns = nothing(observation_shape), actions, nothing(())
        return cls(observation_shape, "float32", action, *columns, 0, 0, 0, (0.0, 0.0), name)

    @property
    def observation_size(self) -> int:
        """Numbers in one observation."""
        return int(np.prod(self.observation_shape))

    @property
    def action_size(self) -> int:
        """Dimensions of a `Box` action, number of `Discrete` ones."""
        return self.action.size

    @property
    def discrete(self) -> bool:
        """Whether actions are indices."""
        return isinstance(self.action, Discrete)

    @property
    def mask_size(self) -> int:
        """Number of an observation's last numbers that mark legal actions; 0 if all are legal."""
        return self.action.n if isinstance(self.action, Discrete) and self.action.masked else 0


def spec_of(log: "Dataset") -> Spec:
    """The shape, bounds and statistics of a log."""
    returns = log.returns()
    return Spec(
        observation_shape=log.observations.shape[1:],
        observation_dtype=str(log.observations.dtype),
        action=log.action_space,
        observation=Statistics.of(log.observations),
        actions=Statistics.of(log.actions),
        reward=Statistics.of(log.rewards),
        rows=len(log),
        episodes=log.episodes,
        longest=int(log.lengths.max()),
        returns=(float(returns.min()), float(returns.max())),
        name=log.name,
    )


def action_space_to_json(space: Box | Discrete) -> dict[str, Any]:
    """An action space as plain JSON values; `action_space_from_json` reads it back."""
    fields = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(space).items()}
    if fields.get("masked") is False:  # as it was written before there were masks
        del fields["masked"]
    return {"kind": type(space).__name__, **fields}


def action_space_from_json(value: dict[str, Any]) -> Box | Discrete:
    """The inverse of `action_space_to_json`."""
    if value["kind"] == "Discrete":
        return Discrete(int(value["n"]), bool(value.get("masked", False)))
    return Box(tuple(map(float, value["low"])), tuple(map(float, value["high"])))
