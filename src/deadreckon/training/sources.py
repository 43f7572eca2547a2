"""Where the rows of batches come from: the device, the host, or experience that grows during training."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from deadreckon.data.batch import BatchSource
from deadreckon.errors import UserError
from deadreckon.memory import memory
from deadreckon.training.program import Column, Plan, indices, layout_of, pack
from deadreckon.training.replay import Experience

BLOCK = 65_536  # rows that are packed at a time
FETCHED = 2**28  # bytes of batches that are fetched from the host at a time
ROUNDED = 2**28  # bytes of a log up to which its number of rows is rounded up
RESIDENT_SHARE = 0.4  # share of the device's memory that a log may take; batches of larger ones are streamed

# Updates `start` .. `stop` - 1: (states, data, start, stop, rows) to states, means of metrics, and when one was not finite.
Update = Callable[[Any, dict[str, Any], int, int, int], tuple[Any, dict[str, Any], dict[str, Any]]]


class Source:
    """The rows to train on; a context manager that is entered when training begins and left when it ends.

    Attributes:
        plan: settings of the compiled program.
        initial: columns of initial observations on the device, or None.
        block: a chunk has a multiple of this number of updates.
    """

    plan: Plan
    initial: dict[str, Any] | None = None
    block = 1

    def __enter__(self) -> "Source":
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def advance(self, update: Update, learner: Any, states: Any, start: int, stop: int, end: int) -> tuple[Any, Any, Any]:
        """The updates `start` .. `stop` - 1 of a fit of `end` updates.

        Returns:
            States, means of metrics (lanes,), and the first step at which each was not finite (-1: none).
        """
        raise NotImplementedError

    def tree(self, states: Any) -> Any:
        """The pytree that a checkpoint holds."""
        return states

    def restore(self, tree: Any) -> Any:
        """Continues from a checkpoint; returns its states.

        Raises:
            UserError: rows that it counts are missing.
        """
        return tree

    def flush(self) -> None:
        """Writes rows that the next checkpoint counts to disk."""

    @property
    def environment_steps(self) -> int | None:
        """Steps in the environment so far, in every lane; None for a log."""
        return None


class Resident(Source):
    """A log on the device."""

    def __init__(self, rows: BatchSource, plan: Plan):
        self.rows, self.plan = rows, plan
        self.initial = None if rows.initial is None else jax.device_put(rows.initial)
        self.data: dict[str, Any] = {}

    def __enter__(self):
        self.data = jax.device_put(packed_rows([self.rows], self.plan.layout))
        return self

    def __exit__(self, *_):
        self.data = {}

    def advance(self, update, learner, states, start, stop, end):
        """See `Source`."""
        return update(states, self.data, start, stop, self.rows.count)


class ResidentLogs(Source):
    """Logs of one shape, one after the other on the device: each lane draws from the rows of its log.

    Args:
        rows: one a lane, the same object for lanes of the same log.
        plan: settings of the compiled program.
    """

    def __init__(self, rows: Sequence[BatchSource], plan: Plan):
        self.plan, self.logs = plan, list({id(own): own for own in rows}.values())
        first = dict(zip(map(id, self.logs), np.cumsum([0, *(own.count for own in self.logs)])))
        spans = [first[id(own)] for own in rows], [own.count for own in rows]
        self.spans = tuple(np.asarray(part, np.int32) for part in spans)
        self.data: dict[str, Any] = {}

    def __enter__(self):
        self.data = jax.device_put(packed_rows(self.logs, self.plan.layout) | {"spans": self.spans})
        return self

    def __exit__(self, *_):
        self.data = {}

    def advance(self, update, learner, states, start, stop, end):
        """See `Source`."""
        return update(states, self.data, start, stop, 0)  # the spans have the number of rows of each lane


class Streamed(Source):
    """A log on the host, whose batches are fetched for each chunk while the one before is computed."""

    def __init__(self, rows: BatchSource, plan: Plan, roots: Key[Array, "lanes"], chunk: int):
        self.rows, self.plan, self.roots = rows, plan, roots
        # Batches of images for a whole chunk would be gigabytes.
        update = len(roots) * plan.batch_size * max(plan.window, 1) * _row_bytes(rows)
        self.part = min(chunk, max(FETCHED // update, 1))  # updates whose batches are fetched at a time
        self.initial = None if rows.initial is None else jax.device_put(rows.initial)
        self.ahead: tuple[int, Future] | None = None

    def __enter__(self):
        self.pool = ThreadPoolExecutor(1)
        return self

    def __exit__(self, *_):
        self.pool.shutdown(wait=True, cancel_futures=True)
        self.ahead = None

    def advance(self, update, learner, states, start, stop, end):
        """See `Source`; also starts to fetch the batches of the next part."""
        means, bad, counts = [], [], []
        for first in range(start, stop, self.part):
            last = min(first + self.part, stop)
            if self.ahead is not None and self.ahead[0] == first:
                data = self.ahead[1].result()
            else:
                data = self._fetch(first)
            self.ahead = (last, self.pool.submit(self._fetch, last)) if last < end else None
            states, mean, where = update(states, data, first, last, self.rows.count)
            means.append(mean)
            bad.append(where)
            counts.append(last - first)
        if len(means) == 1:
            return states, means[0], bad[0]
        means, bad = jax.device_get((means, bad))
        mean = {name: np.average([part[name] for part in means], 0, counts) for name in means[0]}
        return states, mean, {name: _earliest([part[name] for part in bad]) for name in bad[0]}

    def _fetch(self, start: int) -> dict[str, Any]:
        # Always the same number of draws, so that the last, shorter part needs no further compilation.
        index = np.asarray(indices(self.plan, self.roots, jnp.int32(start), jnp.int32(self.rows.count), self.part))
        return pack(self.rows.take(index), self.plan.layout, index.ndim)


class Growing(Source):
    """Experience: acting and updates alternate, block by block."""

    def __init__(self, experience: Experience, plan: Plan, roots: Key[Array, "lanes"]):
        self.experience, self.plan, self.roots, self.block = experience, plan, roots, experience.block

    def advance(self, update, learner, states, start, stop, end):
        """See `Source`."""
        experience, means, bad = self.experience, [], []
        for step in range(start, stop, self.block):
            states, data = experience.extend(learner, states, self.roots, step)
            states, mean, first = update(states, data, step, step + self.block, experience.count)
            means.append(mean)
            bad.append(first)
        means, bad = jax.device_get((means, bad))
        mean = {name: np.mean([part[name] for part in means], 0) for name in means[0]} | experience.metrics
        return states, mean, {name: _earliest([part[name] for part in bad]) for name in bad[0]}

    def tree(self, states):
        """The states of the learners and of the experience."""
        return {"learner": states, "experience": self.experience.state()}

    def restore(self, tree):
        """See `Source`."""
        self.experience.restore(tree["experience"])
        return tree["learner"]

    def flush(self):
        """See `Source`."""
        self.experience.flush()

    @property
    def environment_steps(self):
        """See `Source`."""
        return self.experience.environment_steps


def source_of(
    rows: BatchSource | Experience | Sequence[BatchSource], roots: Key[Array, "lanes"], chunk: int, stream: bool | None
) -> Source:
    """The source for these rows.

    Args:
        rows: a log or designs, or experience; or several logs, one a lane.
        roots: (lanes,) keys of the lanes.
        chunk: most updates of a chunk.
        stream: fetch batches from the host instead of keeping the log on the device; None decides by memory.

    Raises:
        UserError: several logs that cannot share a program.
    """
    if isinstance(rows, Sequence):
        return _several(rows, stream)
    needs, layout = rows.needs, layout_of(rows.fields)
    if isinstance(rows, Experience):
        shape = needs.batch_size, needs.window, needs.initial
        plan = Plan(layout, *shape, resident=True, grows=True, logged=rows.logged)
        if needs.sums:
            plan = plan._replace(n_step=needs.n_step, stride=rows.copies, gamma=needs.gamma)
        return Growing(rows, plan, roots)
    resident = not stream if stream is not None else _fits(rows.nbytes)
    plan = Plan(layout, needs.batch_size, needs.window, needs.initial, resident=resident, grows=False)
    return Resident(rows, plan) if resident else Streamed(rows, plan, roots, chunk)


def _several(rows: Sequence[BatchSource], stream: bool | None) -> Source:
    """The source for lanes that are trained on different logs.

    Raises:
        UserError: the logs differ in the shape of their rows, draw initial observations, or do not fit on the device.
    """
    first, logs = rows[0], list({id(own): own for own in rows}.values())
    layout = layout_of(first.fields)
    if any(layout_of(own.fields) != layout for own in logs):
        raise UserError("logs of one program must have observations and actions of the same shape")
    if first.needs.initial:
        raise UserError("a method that draws initial observations learns from one log in all lanes")
    if stream or not _fits(sum(own.nbytes for own in logs)):
        raise UserError("several logs of one program must fit on the device together; train on them one by one")
    return ResidentLogs(rows, Plan(layout, first.needs.batch_size, first.needs.window, 0, resident=True, grows=False))


def _room(logs: Sequence[BatchSource]) -> int:
    """Rows of the arrays on the device: rounded up by at most an eighth, so that logs of similar sizes share a program."""
    count = sum(rows.count for rows in logs)
    if sum(rows.nbytes for rows in logs) > ROUNDED:
        return count
    step = 1 << max((count - 1).bit_length() - 4, 0)
    return -(-count // step) * step


def packed_rows(logs: Sequence[BatchSource], layout: tuple[Column, ...]) -> dict[str, np.ndarray]:
    """All rows of one log after the other as `pack` returns them, made block by block, so that memory holds no second copy."""
    out: dict[str, np.ndarray] = {}
    room, offset = _room(logs), 0
    for rows in logs:
        block = min(BLOCK, max(FETCHED // _row_bytes(rows), 1))
        for start in range(0, rows.count, block):
            part = pack(rows.take(np.arange(start, min(start + block, rows.count))), layout, 1)
            for name, column in part.items():
                if name not in out:
                    out[name] = np.zeros((room, *column.shape[1:]), column.dtype)
                out[name][offset + start : offset + start + len(column)] = column
        offset += rows.count
    return out


def _row_bytes(rows: BatchSource) -> int:
    return max(sum(int(np.prod(shape)) * np.dtype(dtype).itemsize for shape, dtype in rows.fields.values()), 1)


def _fits(size: int) -> bool:
    """Whether so many bytes may be kept on the device."""
    stats = jax.devices()[0].memory_stats()
    if stats and "bytes_limit" in stats:
        return size < RESIDENT_SHARE * stats["bytes_limit"]
    return size < RESIDENT_SHARE * memory()


def _earliest(steps: list[np.ndarray]) -> np.ndarray:
    """(lanes,) the first step in any block at which a metric was not finite, -1 if none."""
    stacked = np.stack(steps)
    found = np.where(stacked < 0, np.iinfo(np.int32).max, stacked).min(0)
    return np.where((stacked < 0).all(0), -1, found)
