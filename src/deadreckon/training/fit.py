"""The one training loop: compiled chunks of updates, checkpoints, resume, and lanes whose numbers go bad.

All randomness is folded from the seed, a purpose and the step, and a chunk's length is an argument of one compiled
program, so neither the chunk length nor an interruption changes a bit of the result.
"""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from deadreckon.data.batch import Batch, Rows
from deadreckon.data.points import Points
from deadreckon.data.spec import Box, Discrete, Spec
from deadreckon.errors import DivergedError, UserError
from deadreckon.training.checkpoint import load_tree, save_tree
from deadreckon.training.learner import lift
from deadreckon.training.replay import Experience

INIT, DRAW, UPDATE, PREPARE, STARTS, ACT = range(6)  # purposes of randomness
KEPT = 2  # checkpoints on disk: the newest, and one more in case the disk lies about having written it
BLOCK = 65_536  # rows that are packed at a time
ROUNDED = 2**28  # bytes up to which a log's rows are rounded up
RESIDENT_SHARE = 0.4  # of the device's memory that a log may take before its batches are streamed


class Failure(NamedTuple):
    """Why a lane stopped: the first metric that was not finite, and the update at which it was seen."""

    metric: str
    step: int


class Progress(NamedTuple):
    """What `fit` tells after every chunk.

    Attributes:
        step: updates done.
        states: (lanes, ...) states.
        metrics: per name (lanes,) means over the chunk; of a failed lane NaN.
        failures: per lane None or why it stopped.
    """

    step: int
    states: Any
    metrics: dict[str, np.ndarray]
    failures: tuple[Failure | None, ...]


@dataclass
class Fitted:
    """The end of a fit: states with a leading lane axis, per lane None or its failure, and the updates done."""

    states: Any
    failures: tuple[Failure | None, ...]
    step: int

    def lane(self, index: int) -> Any:
        """The state of one lane."""
        return jax.tree.map(lambda leaf: leaf[index], self.states)


class Column(NamedTuple):
    """Where a batch's field lies in the packed matrix (`start` >= 0) or, for images, that it is its own array."""

    name: str
    start: int
    shape: tuple[int, ...]
    dtype: str


def _layout(fields: dict[str, tuple[tuple[int, ...], Any]]) -> tuple[Column, ...]:
    columns, start = [], 0
    for name, (shape, dtype) in fields.items():
        packed = dtype != np.uint8
        columns.append(Column(name, start if packed else -1, tuple(shape), str(dtype)))
        start += int(np.prod(shape)) if packed else 0
    return tuple(columns)


def _pack(columns: dict[str, np.ndarray], layout: tuple[Column, ...], axes: int) -> dict[str, np.ndarray]:
    """Columns as one float32 matrix, so that a batch is one gather; images stay beside it. `axes`: leading index axes."""
    packed = [columns[c.name] for c in layout if c.start >= 0]
    lead = packed[0].shape[:axes]
    out = {"packed": np.concatenate([p.reshape(*lead, -1).astype(np.float32, copy=False) for p in packed], -1)}
    return out | {c.name: columns[c.name] for c in layout if c.start < 0}


def _unpack(taken: dict[str, Array], layout: tuple[Column, ...], axes: int) -> dict[str, Array]:
    out = {}
    for c in layout:
        if c.start < 0:
            out[c.name] = taken[c.name]
            continue
        matrix = taken["packed"]
        part = matrix[..., c.start : c.start + int(np.prod(c.shape))].reshape(*matrix.shape[:axes], *c.shape)
        out[c.name] = part.astype(c.dtype)
    return out


class _Plan(NamedTuple):
    """What shapes the compiled chunk; hashable."""

    layout: tuple[Column, ...]
    batch_size: int
    window: int
    initial: int
    resident: bool
    grows: bool  # each lane has rows of its own, on the device


def _draw(plan: _Plan, root: PRNGKeyArray, step: Int[Array, ""], rows: Int[Array, ""]) -> Int[Array, "b *w"]:
    """Indices of the rows of one batch: the same function whether the rows lie on the device or are fetched."""
    key = jax.random.fold_in(jax.random.fold_in(root, DRAW), step)
    index = jax.random.randint(key, (plan.batch_size,), 0, rows)
    if plan.window:
        index = jnp.minimum(index[:, None] + jnp.arange(plan.window), rows - 1)
    return index


@eqx.filter_jit
def _indices(
    plan: _Plan, roots: PRNGKeyArray, start: Int[Array, ""], rows: Int[Array, ""], length: int
) -> Int[Array, "t lanes b *w"]:
    steps = start + jnp.arange(length)
    return jax.vmap(lambda step: jax.vmap(lambda root: _draw(plan, root, step, rows))(roots))(steps)


def _batch(plan: _Plan, taken: dict[str, Array], initial: dict[str, Array] | None, root: PRNGKeyArray, step: Array) -> Batch:
    fields = _unpack(taken, plan.layout, 2 if plan.window else 1)
    if plan.window:
        left = fields.pop("_left")[:, :1]
        fields["mask"] = (jnp.arange(plan.window) <= left).astype(jnp.float32)
    if initial is not None:
        key = jax.random.fold_in(jax.random.fold_in(root, STARTS), step)
        index = jax.random.randint(key, (plan.initial,), 0, len(initial["initial_observation"]))
        fields |= {name: column[index] for name, column in initial.items()}
    known = {name: fields.pop(name) for name in Batch._fields if name in fields}
    # Keeps the compiler from fusing the fetch into the update, whose bits then do not depend on where rows come from.
    return jax.lax.optimization_barrier(Batch(**known, extra=fields or None))


@eqx.filter_jit
def _advance(
    learner: Any,
    plan: _Plan,
    states: Any,
    data: dict[str, Array],
    initial: dict[str, Array] | None,
    roots: PRNGKeyArray,
    start: Int[Array, ""],
    stop: Int[Array, ""],
    rows: Int[Array, ""],
) -> tuple[Any, dict[str, Float[Array, "lanes"]], dict[str, Int[Array, "lanes"]]]:
    """Updates `start` .. `stop` - 1 of all lanes as one program.

    The log is an argument, never a closure (that would be compiled in). Nothing is donated: the states from before the
    chunk are what a failed lane falls back to, for one copy of the states a chunk.

    Returns:
        The states, each metric's mean, and per metric the first step at which it was not finite (-1 if none).
    """
    single = roots.shape[0] == 1

    if single and plan.grows:  # before the loop, where it costs nothing
        data = {name: column.reshape(column.shape[1:]) for name, column in data.items()}

    def one(learner: Any, state: Any, root: PRNGKeyArray, fetched: Any, step: Array) -> tuple[Any, dict[str, Array]]:
        if plan.resident:
            index = _draw(plan, root, step, rows)
            own = fetched if plan.grows and not single else data
            fetched = {name: column[index] for name, column in own.items()}
        batch = _batch(plan, fetched, initial, root, step)
        key = jax.random.fold_in(jax.random.fold_in(root, UPDATE), step)
        return learner.update(state, batch, step=step, key=key)

    def all_lanes(states: Any, step: Array) -> tuple[Any, dict[str, Array]]:
        fetched = None if plan.resident else {name: column[step - start] for name, column in data.items()}
        if plan.grows and not single:
            fetched = data
        if single:  # a lane axis of one would make every product a batched one
            squeeze = lambda tree: jax.tree.map(lambda x: x[0], tree)  # noqa: E731
            out = one(squeeze(learner), squeeze(states), roots[0], squeeze(fetched), step)
            return jax.tree.map(lambda x: x[None], out)
        return jax.vmap(one, (0, 0, 0, 0, None))(learner, states, roots, fetched, step)

    def body(step: Array, carry: Any) -> Any:
        states, sums, bad = carry
        states, metrics = all_lanes(states, step)
        sums = jax.tree.map(jnp.add, sums, metrics)
        bad = jax.tree.map(lambda b, m: jnp.where((b < 0) & ~jnp.isfinite(m), step, b), bad, metrics)
        return states, sums, bad

    shapes = jax.eval_shape(all_lanes, states, start)[1]
    sums = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    bad = jax.tree.map(lambda s: jnp.full(s.shape, -1, jnp.int32), shapes)
    states, sums, bad = jax.lax.fori_loop(start, stop, body, (states, sums, bad))
    count = jnp.maximum(stop - start, 1)
    return states, jax.tree.map(lambda s: s / count, sums), bad


@eqx.filter_jit
def _init(learner: Any, spec: Spec, roots: PRNGKeyArray) -> Any:
    one = lambda learner, root: learner.init(spec, jax.random.fold_in(root, INIT))  # noqa: E731
    return jax.vmap(one)(learner, roots)


def _shape(spec: Spec) -> Spec:
    """One spec for all logs of a shape, so that they share a program."""
    return _shaped(spec.observation_shape, spec.action if spec.discrete else spec.action_size)


@lru_cache
def _shaped(observation_shape: tuple[int, ...], action: Discrete | int) -> Spec:
    space = Box((-1.0,) * action, (1.0,) * action) if isinstance(action, int) else action
    return Spec.empty(observation_shape, space, "any")


@jax.jit
def _finite(states: Any) -> Array:
    """(lanes,) whether every number of a lane is finite."""
    flags = [
        jnp.isfinite(leaf).reshape(leaf.shape[0], -1).all(1)
        for leaf in jax.tree.leaves(states)
        if jnp.issubdtype(leaf.dtype, jnp.floating)
    ]
    return jnp.stack(flags).all(0)


@jax.jit
def choose(take_new: Array, new: Any, old: Any) -> Any:
    """Of two stacks (lanes, ...) each lane from the one that (lanes,) says."""
    return jax.tree.map(lambda n, o: jnp.where(take_new.reshape(-1, *[1] * (n.ndim - 1)), n, o), new, old)


def _room(rows: Rows | Points) -> int:
    """Rows of the arrays on the device: rounded up by an eighth at the most, so that logs of about one size share a program."""
    if rows.nbytes > ROUNDED:
        return rows.count
    step = 1 << max((rows.count - 1).bit_length() - 4, 0)
    return -(-rows.count // step) * step


def _packed(rows: Rows | Points, layout: tuple[Column, ...]) -> dict[str, np.ndarray]:
    """All rows as `_pack` gives them, made block by block so that a second copy of them never is in memory."""
    out: dict[str, np.ndarray] = {}
    room = _room(rows)
    for start in range(0, rows.count, BLOCK):
        part = _pack(rows.take(np.arange(start, min(start + BLOCK, rows.count))), layout, 1)
        for name, column in part.items():
            if name not in out:
                out[name] = np.zeros((room, *column.shape[1:]), column.dtype)
            out[name][start : start + len(column)] = column
    return out


class _Source:
    """Rows on the device, or fetched for each chunk while the one before is computed."""

    def __init__(self, rows: Rows | Points, plan: _Plan, chunk: int):
        self.rows, self.plan, self.chunk = rows, plan, chunk
        self.resident: dict[str, Any] | None = None
        if plan.resident:
            self.resident = jax.device_put(_packed(rows, plan.layout))
        self.pool = None if plan.resident else ThreadPoolExecutor(1)
        self.ahead: tuple[int, Future] | None = None

    def get(self, roots: PRNGKeyArray, start: int, following: int | None) -> dict[str, Any]:
        """Data of the chunk that begins at `start`; the fetch of the one that begins at `following` is set going."""
        if self.resident is not None or self.pool is None:
            return self.resident or {}
        if self.ahead is not None and self.ahead[0] == start:
            data = self.ahead[1].result()
        else:
            data = self._fetch(roots, start)
        self.ahead = None if following is None else (following, self.pool.submit(self._fetch, roots, following))
        return data

    def _fetch(self, roots: PRNGKeyArray, start: int) -> dict[str, Any]:
        # Always a whole chunk of draws, so that one compiled program serves the last, shorter chunk too.
        index = np.asarray(_indices(self.plan, roots, jnp.int32(start), jnp.int32(self.rows.count), self.chunk))
        return _pack(self.rows.take(index), self.plan.layout, index.ndim)

    def close(self) -> None:
        if self.pool is not None:
            self.pool.shutdown(wait=True, cancel_futures=True)


def _fits(rows: Rows | Points) -> bool:
    stats = jax.devices()[0].memory_stats()
    if stats and "bytes_limit" in stats:
        return rows.nbytes < RESIDENT_SHARE * stats["bytes_limit"]
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return rows.nbytes < RESIDENT_SHARE * memory


def _earliest(steps: list[np.ndarray]) -> np.ndarray:
    """(lanes,) the first step in any block at which a metric was not finite, -1 if none."""
    stacked = np.stack(steps)
    found = np.where(stacked < 0, np.iinfo(np.int32).max, stacked).min(0)
    return np.where((stacked < 0).all(0), -1, found)


def _checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """Step and path of every checkpoint, oldest first."""
    found = ((re.fullmatch(r"(\d+)\.npz", p.name), p) for p in folder.glob("*.npz"))
    return sorted((int(m[1]), p) for m, p in found if m)


@dataclass
class Fit:
    """A fit that can be walked chunk by chunk, stopped anywhere and taken up again.

    Attributes:
        learners: one a lane, alike in everything but float fields.
        rows: the log or the designs as the learners need them, or experience that grows while they learn.
        seeds: one a lane.
        steps: updates in all.
        chunk: most updates between two looks from outside; also what a kill can lose.
        folder: of the checkpoints; None keeps nothing on disk.
        stream: fetch batches from the host instead of keeping the log on the device; None decides by memory.
        stops: further steps at which a chunk must end, such as evaluations, as a period; 0 for none.
    """

    learners: Sequence[Any]
    rows: Rows | Points | Experience
    seeds: Sequence[int]
    steps: int
    chunk: int = 1000
    folder: Path | None = None
    stream: bool | None = None
    stops: int = 0

    def __post_init__(self):
        if self.steps < 1 or self.chunk < 1:
            raise UserError(f"steps and chunk must be >= 1, got {self.steps} and {self.chunk}")
        if len(self.learners) != len(self.seeds) or not self.seeds:
            raise UserError(f"one learner a seed is needed, got {len(self.learners)} and {len(self.seeds)}")
        needs, spec = self.rows.needs, self.rows.spec
        if any(learner.needs(spec) != needs for learner in self.learners):
            raise UserError("lanes of one program must need the same batches (discount with n-step rows, standardisation)")
        if self.stops:
            self.chunk = min(self.chunk, self.stops)
        self.experience = None if isinstance(self.rows, Rows | Points) else self.rows
        resident, initial = True, None
        if isinstance(self.rows, Rows | Points):
            resident = not self.stream if self.stream is not None else _fits(self.rows)
            initial = self.rows.initial
        else:
            # Chunks and pauses end where blocks do, so that neither changes when a policy acts.
            block = self.rows.block
            self.steps, self.chunk, self.stops = (-(-n // block) * block for n in (self.steps, self.chunk, self.stops))
            if hasattr(self.learners[0], "prepare"):
                raise UserError(f"{type(self.learners[0]).__name__} prepares itself on a whole log and cannot learn online")
        self.learner = lift(self.learners)
        self.roots = jnp.stack([jax.random.key(seed) for seed in self.seeds])
        grows = self.experience is not None
        self.plan = _Plan(_layout(self.rows.fields), needs.batch_size, needs.window, needs.initial, resident, grows)
        self.initial = None if initial is None else jax.device_put(initial)
        by_shape = getattr(type(self.learners[0]), "init_by_shape", False)
        self.states = _init(self.learner, _shape(spec) if by_shape else spec, self.roots)
        self.failures: tuple[Failure | None, ...] = (None,) * len(self.seeds)
        self.step = 0

    def resume(self) -> None:
        """Takes up the newest whole checkpoint in `folder`; a broken one is passed over for the one before it."""
        found = _checkpoints(self.folder) if self.folder else []
        problem = None
        for _, path in reversed(found):
            try:
                tree, meta = load_tree(path, self._tree())
                states = tree
                if self.experience is not None:
                    states = tree["learner"]
                    self.experience.restore(tree["experience"])  # refuses if the rows it counts are not all there
            except UserError as error:
                problem = error
                continue
            self.states = jax.device_put(states)
            self.step = int(meta["step"])
            self.failures = tuple(None if f is None else Failure(*f) for f in meta["failures"])
            return
        if problem is not None:
            raise problem

    def chunks(self) -> Iterator[Progress]:
        """Walks to the end, giving `Progress` after every chunk.

        The checkpoint is written when the caller comes back for more, so what the caller wrote for a chunk is on disk
        before it; after a kill in between, the chunk is computed and written again, the same.
        """
        source = _Source(self.rows, self.plan, self.chunk) if isinstance(self.rows, Rows | Points) else None
        refresh = self._refresh
        prepares = hasattr(self.learners[0], "prepare")
        try:
            if self.step == 0:
                self.save()
            while self.step < self.steps and not all(self.failures):
                if prepares and (self.step == 0 or (refresh and self.step % refresh == 0)):
                    self._prepare()
                stop = self._stop(self.step)
                if source is None:
                    new, means, bad = self._take_turns(stop)
                else:
                    data = source.get(self.roots, self.step, stop if stop < self.steps else None)
                    new, means, bad = self._update(self.states, data, self.step, stop, self.rows.count)
                metrics = self._accept(new, jax.device_get(means), jax.device_get(bad), stop)
                self.step = stop
                yield Progress(stop, self.states, metrics, self.failures)
                self.save()
        finally:
            if source is not None:
                source.close()

    def _update(self, states: Any, data: dict[str, Any], start: int, stop: int, rows: int) -> Any:
        bounds = jnp.int32(start), jnp.int32(stop), jnp.int32(rows)
        return _advance(self.learner, self.plan, states, data, self.initial, self.roots, *bounds)

    def _take_turns(self, stop: int) -> Any:
        """Acts and learns, block by block, until `stop` updates are done."""
        experience, states = self.experience, self.states
        assert experience is not None
        means, bad = [], []
        for start in range(self.step, stop, experience.block):
            states, data = experience.extend(self.learner, states, self.roots, start)
            states, mean, first = self._update(states, data, start, start + experience.block, experience.count)
            means.append(mean)
            bad.append(first)
        means, bad = jax.device_get((means, bad))
        mean = {name: np.mean([part[name] for part in means], 0) for name in means[0]} | experience.metrics
        return states, mean, {name: _earliest([part[name] for part in bad]) for name in bad[0]}

    def _tree(self) -> Any:
        """What a checkpoint holds."""
        if self.experience is None:
            return self.states
        return {"learner": self.states, "experience": self.experience.state()}

    @property
    def _refresh(self) -> int:
        return getattr(self.learners[0], "refresh", 0)

    def _stop(self, step: int) -> int:
        """Where the chunk that begins at `step` ends."""
        ends = [(step // period + 1) * period for period in (self.stops, self._refresh) if period]
        return min([step + self.chunk, self.steps, *ends])

    def _accept(self, new: Any, means: dict[str, Any], bad: dict[str, Any], stop: int) -> dict[str, np.ndarray]:
        """Takes the new states of the healthy lanes; a failed lane keeps the state from before the chunk."""
        failures = list(self.failures)
        finite = np.asarray(_finite(new))
        for lane, already in enumerate(self.failures):
            if already is not None:
                continue
            seen = [(int(steps[lane]), name) for name, steps in bad.items() if steps[lane] >= 0]
            if seen:
                step, name = min(seen)
                failures[lane] = Failure(name, step)
            elif not finite[lane]:
                failures[lane] = Failure("parameters", stop - 1)
        self.failures = tuple(failures)
        healthy = np.asarray([f is None for f in failures])
        self.states = new if healthy.all() else choose(jnp.asarray(healthy), new, self.states)
        return {name: np.where(healthy, np.asarray(value, np.float64), np.nan) for name, value in means.items()}

    def _prepare(self) -> None:
        assert isinstance(self.rows, Rows)  # `__post_init__` has refused anything else
        log = self.rows.log

        def inner(learner: Any, steps: int, key: PRNGKeyArray) -> Any:
            seed, spec = int(jax.random.bits(key, dtype=jnp.uint32)), self.rows.spec
            learner = learner.resolve(spec, steps) if hasattr(learner, "resolve") else learner
            rows = Rows(log, learner.needs(spec))
            result = fit([learner], rows, [seed], steps, chunk=self.chunk, stream=self.stream)
            if result.failures[0] is not None:
                raise DivergedError(f"{result.failures[0].metric}: not finite")
            return result.lane(0)

        lanes, failures = [], list(self.failures)
        for i, learner in enumerate(self.learners):
            key = jax.random.fold_in(jax.random.fold_in(self.roots[i], PREPARE), self.step)
            state = jax.tree.map(lambda leaf, i=i: leaf[i], self.states)
            # The first preparation may take hours: a kill loses that of one lane only.
            kept = self.folder / f"prepared-{i}.npz" if self.folder is not None and self.step == 0 else None
            if failures[i] is None:
                try:
                    if kept is not None and kept.exists():
                        state = load_tree(kept, state)[0]
                    else:
                        state = learner.prepare(state, self.rows, key, inner)
                        if kept is not None:
                            save_tree(kept, state, {})
                except DivergedError as error:  # what went bad stands before the colon
                    failures[i] = Failure(f"{str(error).partition(':')[0]} (while preparing)", self.step)
            lanes.append(state)
        self.failures = tuple(failures)
        self.states = jax.tree.map(lambda *leaves: jnp.stack(leaves), *lanes)

    def save(self) -> None:
        """Writes a checkpoint, where there is a folder."""
        if self.folder is None:
            return
        if self.experience is not None:
            self.experience.flush()  # first the rows, then the checkpoint that counts them
        save_tree(self.folder / f"{self.step:010d}.npz", self._tree(), {"step": self.step, "failures": self.failures})
        for _, path in _checkpoints(self.folder)[:-KEPT]:
            path.unlink()
        for path in self.folder.glob("prepared-*.npz") if self.step else ():
            path.unlink()


def complete(job: Fit, what: str, told: Callable[[Progress], None]) -> None:
    """Takes a fit to its end, from its checkpoints where it has some.

    Args:
        job: not yet begun.
        what: is fitted, for the error.
        told: called after every chunk.

    Raises:
        DivergedError: a lane's numbers went bad.
    """
    job.resume()
    for progress in job.chunks():
        told(progress)
    for seed, failure in zip(job.seeds, job.failures):
        if failure is not None:
            whose = f" with seed {seed}" if len(job.seeds) > 1 else ""
            bad = f"{what}: {failure.metric} was not finite at update {failure.step}{whose}"
            raise DivergedError(f"{bad}; a lower learning rate may help")


def fit(
    learners: Sequence[Any],
    rows: Rows | Points,
    seeds: Sequence[int],
    steps: int,
    *,
    chunk: int = 1000,
    stream: bool | None = None,
    on_chunk: Callable[[Progress], None] = lambda progress: None,
) -> Fitted:
    """Trains in memory, without a folder; see `Fit` for the arguments."""
    job = Fit(learners, rows, seeds, steps, chunk=chunk, stream=stream)
    for progress in job.chunks():
        on_chunk(progress)
    return Fitted(job.states, job.failures, job.step)
