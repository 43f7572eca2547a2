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
        block: updates between two collections of rows; runs are paused and saved after whole blocks.
        logged: rows of each batch that come from a log, which `extend` returns beside the lanes' own; 0 without a log.
        copies: number of environments in a lane; row r + copies follows row r.
        metrics: further metrics, each (lanes,), that are reported with those of the updates.
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
        """Number of rows to train on, the same in every lane."""
        ...

    @property
    def environment_steps(self) -> int:
        """Steps taken so far, in every lane."""
        ...

    def extend(self, learner: Any, states: Any, roots: Key[Array, "lanes"], step: int) -> tuple[Any, dict[str, Array]]:
        """Acts until there are the rows for the updates `step` .. `step + block - 1`.

        Returns:
            The states, which it may have updated from the rows, and all rows, lanes first; with a log also "logged", its rows
            and their number.
        """
        ...

    def flush(self) -> None:
        """Writes rows that are not yet on disk."""
        ...

    def state(self) -> dict[str, np.ndarray]:
        """The state, beside the rows on disk, on which later rows depend."""
        ...

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Continues from a `state`; rows that were added after it are dropped."""
        ...


@partial(jax.jit, donate_argnums=0)
def _write(
    buffer: Float[Array, "lanes n w"], rows: Float[Array, "lanes k v"], at: Any, column: Any = 0
) -> Float[Array, "lanes n w"]:
    return jax.lax.dynamic_update_slice(buffer, rows, (0, at, column))


AMENDED = 1024  # rows that `amend` writes at a time, so that one compiled program serves any number of rows


class Replay:
    """Float32 rows of equal width for several lanes: on the device for training, and in an append-only file per lane.

    Args:
        width: numbers per row.
        capacity: most rows per lane.
        lanes: number of lanes.
        learnable: function from (lanes, k, width) rows as they are stored to rows as learners get them.
        paths: of the files, one per lane; none keeps nothing on disk.
        learned: numbers per row as learners get it; None: `width`.
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
        """Appends rows; they are on disk after the next `flush`."""
        assert self.count + rows.shape[1] <= self.buffer.shape[1], "the replay buffer is full"
        self.buffer = _write(self.buffer, self.learnable(rows), self.count)
        self.count += rows.shape[1]
        if self.paths:
            self._waiting.append(rows)

    def amend(self, first: int, columns: Float[np.ndarray, "lanes n c"]) -> None:
        """Replaces the last columns of the rows from `first` on, as learners get them, but not in the files.

        Args:
            first: first row.
            columns: (lanes, capacity, c) of all rows, also of those that do not exist yet.
        """
        capacity, column = self.buffer.shape[1], self.buffer.shape[2] - columns.shape[-1]
        span = min(AMENDED, capacity)
        for start in range(first, self.count, span):
            at = min(start, capacity - span)
            self.buffer = _write(self.buffer, columns[:, at : at + span], at, column)

    def set(self, lane: int, row: int, column: int, value: float) -> None:
        """Changes one number of a row in the file of a lane, which `restore` then reads."""
        write_at(self.paths[lane], (row * self.width + column) * 4, np.float32(value).data, cut=False)

    def flush(self) -> None:
        """Appends the rows that were added since the last call to the files, and waits until they are on disk.

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
        """Loads the first `count` rows of the files, in place of all others.

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
