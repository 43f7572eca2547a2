"""Experience that grows during training: its protocol for `fit`, and the replay buffer."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from deadreckon.data.batch import BatchSpec
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.files import write_at


@runtime_checkable
class Experience(Protocol):
    """Rows from the learners' own policies, collected alternately with updates.

    Attributes:
        block: updates between two turns of acting; also the unit in which runs are paused and saved.
        logged: rows of each batch that come from a log instead, which `extend` gives beside the lanes' own; 0 without one.
        copies: of the environment in a lane; row r + copies is what followed row r.
        metrics: numbers of its own, each (lanes,), that are told with those of the updates.
        needs, spec, view, fields: as of `TransitionSource`.
    """

    block: int
    logged: int
    copies: int
    metrics: dict[str, np.ndarray]
    needs: BatchSpec
    spec: Spec
    view: Normalizer
    fields: dict[str, tuple[tuple[int, ...], Any]]

    @property
    def count(self) -> int:
        """Rows to learn from, the same in every lane."""
        ...

    @property
    def environment_steps(self) -> int:
        """Steps taken so far, in every lane."""
        ...

    def extend(self, learner: Any, states: Any, roots: Key[Array, "lanes"], step: int) -> tuple[Any, dict[str, Array]]:
        """Acts until the updates `step` .. `step + block - 1` have the rows they are due.

        Returns:
            The states, in which it may have put what it made of the rows, and all rows, lanes first; with a log also "logged",
            its rows and their number.
        """
        ...

    def flush(self) -> None:
        """Puts what is not yet on disk there."""
        ...

    def state(self) -> dict[str, np.ndarray]:
        """What the future depends on beside the rows on disk."""
        ...

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where `state` was taken; rows that came after it are forgotten."""
        ...


@partial(jax.jit, donate_argnums=0)
def _write(
    buffer: Float[Array, "lanes n w"], rows: Float[Array, "lanes k v"], at: Any, column: Any = 0
) -> Float[Array, "lanes n w"]:
    return jax.lax.dynamic_update_slice(buffer, rows, (0, at, column))


AMENDED = 1024  # rows that are written at a time where columns are amended: one program for all numbers of them


class Replay:
    """Float32 rows of equal width for several lanes: on the device for learning, and in an append-only file per lane.

    Args:
        width: numbers per row.
        capacity: most rows per lane.
        lanes: how many.
        learnable: makes of rows as they are kept what learners see.
        paths: of the files, one per lane; none keeps nothing on disk.
        learned: numbers per row as learners see it; None: as many.
    """

    def __init__(
        self,
        width: int,
        capacity: int,
        lanes: int,
        learnable: Callable[[np.ndarray], np.ndarray] = lambda rows: rows,
        paths: Sequence[Path] = (),
        learned: int | None = None,
    ):
        self.width, self.learnable, self.paths = width, learnable, list(paths)
        self.count = 0
        self.buffer = jnp.zeros((lanes, capacity, learned or width), jnp.float32)
        self._waiting: list[np.ndarray] = []  # (lanes, k, width) blocks that are not on disk yet

    def append(self, rows: Float[np.ndarray, "lanes k w"]) -> None:
        """Adds rows behind those that are there; they are on disk after the next `flush`."""
        assert self.count + rows.shape[1] <= self.buffer.shape[1], "the replay buffer is full"
        self.buffer = _write(self.buffer, self.learnable(rows), self.count)
        self.count += rows.shape[1]
        if self.paths:
            self._waiting.append(rows)

    def amend(self, first: int, columns: Float[np.ndarray, "lanes n c"]) -> None:
        """Writes the last columns of the rows from `first` on anew, as learners see them; nothing of it goes to the files.

        Args:
            first: row.
            columns: of all rows, also of those that are not there yet.
        """
        capacity, column = self.buffer.shape[1], self.buffer.shape[2] - columns.shape[-1]
        span = min(AMENDED, capacity)
        for start in range(first, self.count, span):
            at = min(start, capacity - span)
            self.buffer = _write(self.buffer, columns[:, at : at + span], at, column)

    def set(self, lane: int, row: int, column: int, value: float) -> None:
        """Changes one number of a row in the file, whose other rows stay, and which `restore` then reads."""
        write_at(self.paths[lane], (row * self.width + column) * 4, np.float32(value).data, cut=False)

    def flush(self) -> None:
        """Appends to the files what was added since the last time, and sees it onto the disk.

        Raises:
            UserError: a file cannot be written.
        """
        if not self._waiting:
            return
        rows = np.concatenate(self._waiting, 1)
        start = self.count - rows.shape[1]
        for path, part in zip(self.paths, rows):
            write_at(path, start * self.width * 4, np.ascontiguousarray(part).data)
        self._waiting = []

    def restore(self, count: int) -> None:
        """Takes up the first `count` rows of the files.

        Raises:
            UserError: a file is missing or too short.
        """
        self.count, self._waiting = 0, []
        if count == 0:
            return
        rows = np.stack([read_rows(path, self.width, count) for path in self.paths])
        self.append(rows)
        self._waiting = []


def read_rows(path: Path, width: int, count: int) -> Float[np.ndarray, "count w"]:
    """The first `count` rows of a replay file, memory-mapped.

    Raises:
        UserError: it is missing or too short.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror or error}") from error
    if size < count * width * 4:
        raise UserError(f"{path} holds {size // (width * 4)} rows, the checkpoint counts {count}")
    return np.memmap(path, np.float32, "r", shape=(count, width))
