"""The one training loop: chunks of updates, checkpoints, resume, and lanes that diverge (NaN or infinite numbers).

Lanes are the fits that one compiled program trains at once, such as the seeds of a run.
"""

import contextlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from deadreckon.data.batch import BatchSource, TransitionSource
from deadreckon.errors import DivergedError, UserError
from deadreckon.interrupts import holding
from deadreckon.randomness import key_for
from deadreckon.training.checkpoint import checkpoints, load_tree, save_tree
from deadreckon.training.learner import lane_of, lift, stack, unstack
from deadreckon.training.pictures import USUAL, Sight
from deadreckon.training.program import PARAMETERS, advance, begin, choose, finite
from deadreckon.training.replay import Experience
from deadreckon.training.sources import source_of

KEPT = 2  # checkpoints on disk: the newest, and one more in case the disk has not completely written it


class Failure(NamedTuple):
    """Why a lane stopped: the first metric that was not finite, and the update at which it was seen."""

    metric: str
    step: int


class Chunk(NamedTuple):
    """A finished chunk of updates.

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
        return lane_of(self.states, index)


@dataclass
class Fit:
    """A fit that runs chunk by chunk, and can be stopped anywhere and resumed.

    Attributes:
        learners: one per lane, which differ in float fields alone.
        rows: the log or the designs as the learners need them, or experience that grows during training; or a sequence of logs
            of one shape, one a lane.
        seeds: one per lane.
        steps: updates in all.
        chunk: most updates between two values of `chunks`; also the most that an interruption can lose.
        folder: of the checkpoints; None keeps nothing on disk.
        stream: fetch batches from the host instead of keeping the log on the device; None decides by memory.
        stops: further steps at which a chunk must end, such as evaluations, as a period; 0 for none.
        sight: settings for image observations.

    Raises:
        UserError: numbers out of range or of different lengths, lanes that need different batches or programs, or a learner
            that cannot be trained online.
    """

    learners: Sequence[Any]
    rows: BatchSource | Experience | Sequence[BatchSource]
    seeds: Sequence[int]
    steps: int
    chunk: int = 1000
    folder: Path | None = None
    stream: bool | None = None
    stops: int = 0
    sight: Sight = USUAL

    def __post_init__(self):
        if self.steps < 1 or self.chunk < 1:
            raise UserError(f"steps and chunk must be >= 1, got {self.steps} and {self.chunk}")
        if len(self.learners) != len(self.seeds) or not self.seeds:
            raise UserError(f"one learner a seed is needed, got {len(self.learners)} and {len(self.seeds)}")
        if isinstance(self.rows, Sequence) and len(self.rows) != len(self.seeds):
            raise UserError(f"one log a lane is needed, got {len(self.rows)} logs and {len(self.seeds)} lanes")
        self.each = self.rows if isinstance(self.rows, Sequence) else [self.rows] * len(self.seeds)
        needs = self.each[0].needs
        if any(needs != own.needs or needs != learner.needs(own.spec) for learner, own in zip(self.learners, self.each)):
            raise UserError("lanes of one program must need the same batches (discount with n-step rows, standardisation)")
        if self.stops:
            self.chunk = min(self.chunk, self.stops)
        if isinstance(self.rows, Experience) and hasattr(self.learners[0], "prepare"):
            raise UserError(f"{type(self.learners[0]).__name__} prepares itself on a whole log and cannot learn online")
        self.learner = lift(self.learners)
        self.roots = jnp.stack([jax.random.key(seed) for seed in self.seeds])
        self.source = source_of(self.rows, self.roots, self.chunk, self.stream)
        # Chunks and stops are whole blocks of updates, so that they do not change when a policy acts.
        block = self.source.block
        self.steps, self.chunk, self.stops = (-(-n // block) * block for n in (self.steps, self.chunk, self.stops))
        self.states = begin(self.learner, [own.spec for own in self.each], self.roots, self.sight)
        self.failures: tuple[Failure | None, ...] = (None,) * len(self.seeds)
        self.step = 0

    @property
    def ended(self) -> bool:
        """Whether all lanes have failed."""
        return all(self.failures)

    def resume(self) -> None:
        """Resumes from the newest complete checkpoint in `folder`; a damaged one is reported, and an older one used.

        Raises:
            UserError: all checkpoints are damaged.
        """
        found = checkpoints(self.folder) if self.folder else []
        problem = None
        for _, path in reversed(found):
            try:
                tree, meta = load_tree(path, self.source.tree(self.states))
                states = self.source.restore(tree)
            except UserError as error:
                problem = error
                continue
            self.states = jax.device_put(states)
            self.step = int(meta["step"])
            self.failures = tuple(None if f is None else Failure(*f) for f in meta["failures"])
            if problem is not None:
                told = f"a damaged checkpoint is skipped, and training resumes from update {self.step:,}"
                warnings.warn(f"{told}: {problem}", stacklevel=2)
            return
        if problem is not None:
            raise problem

    def chunks(self) -> Iterator[Chunk]:
        """Trains to the end, and yields a `Chunk` after every chunk.

        The checkpoint is written when the caller requests the next chunk, so what the caller wrote for a chunk is on disk
        before it; after an interruption in between, the same chunk is computed and written again.
        """
        refresh = self._refresh
        prepares = hasattr(self.learners[0], "prepare")
        with self.source as source:
            if self.step == 0:
                self.save()
            self._forget()  # the last run may have been killed before it did this
            while self.step < self.steps and not self.ended:
                if prepares and (self.step == 0 or (refresh and self.step % refresh == 0)):
                    self._prepare()
                # A signal waits until the chunk is on disk.
                with contextlib.nullcontext() if self.folder is None else holding():
                    stop = self._stop(self.step)
                    new, means, bad = source.advance(self._update, self.learner, self.states, self.step, stop, self.steps)
                    metrics = self._accept(new, jax.device_get(means), jax.device_get(bad), stop)
                    self.step = stop
                    yield Chunk(stop, self.states, metrics, self.failures)
                    self.save()

    def _update(self, states: Any, data: dict[str, Any], start: int, stop: int, rows: int) -> Any:
        bounds = jnp.int32(start), jnp.int32(stop), jnp.int32(rows)
        return advance(self.learner, self.source.plan, states, data, self.source.initial, self.roots, *bounds)

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
        sound = bad.pop(PARAMETERS) < 0 if PARAMETERS in bad else np.asarray(finite(new))
        for lane, already in enumerate(self.failures):
            if already is not None:
                continue
            seen = [(int(steps[lane]), name) for name, steps in bad.items() if steps[lane] >= 0]
            if seen:
                step, name = min(seen)
                failures[lane] = Failure(name, step)
            elif not sound[lane]:
                failures[lane] = Failure(PARAMETERS, stop - 1)
        self.failures = tuple(failures)
        healthy = np.asarray([f is None for f in failures])
        self.states = new if healthy.all() else choose(jnp.asarray(healthy), new, self.states)
        return {name: np.where(healthy, np.asarray(value, np.float64), np.nan) for name, value in means.items()}

    def _prepare(self) -> None:
        def inner(own: TransitionSource, learner: Any, steps: int, key: PRNGKeyArray) -> Any:
            seed, spec = int(jax.random.bits(key, dtype=jnp.uint32)), own.spec
            learner = learner.resolve(spec, steps) if hasattr(learner, "resolve") else learner
            rows = TransitionSource(own.log, learner.needs(spec))
            result = fit([learner], rows, [seed], steps, chunk=self.chunk, stream=self.stream)
            if result.failures[0] is not None:
                raise DivergedError(f"{result.failures[0].metric}: not finite")
            return result.lane(0)

        lanes, failures = [], list(self.failures)
        states = unstack(self.states, len(self.learners))
        for i, (learner, own, state) in enumerate(zip(self.learners, self.each, states)):
            assert isinstance(own, TransitionSource)  # `__post_init__` has refused anything else
            key = key_for(self.roots[i], "prepare", self.step)
            # The first preparation may take hours: an interruption loses that of one lane only.
            kept = self.folder / f"prepared-{i}.npz" if self.folder is not None and self.step == 0 else None
            if failures[i] is None:
                try:
                    prepared = None if kept is None or not kept.exists() else self._prepared(kept, state)
                    if prepared is not None:
                        state = prepared
                    else:
                        state = learner.prepare(state, own, key, partial(inner, own))
                        if kept is not None:
                            save_tree(kept, state, {})
                except DivergedError as error:  # the text before the colon names what diverged
                    failures[i] = Failure(f"{str(error).partition(':')[0]} (while preparing)", self.step)
            lanes.append(state)
        self.failures = tuple(failures)
        self.states = stack(lanes)

    @staticmethod
    def _prepared(path: Path, state: Any) -> Any:
        """The state of a lane that was prepared before an interruption; None where its file is damaged."""
        try:
            return load_tree(path, state)[0]
        except UserError as error:
            warnings.warn(f"a damaged file is skipped, and the lane is prepared again: {error}", stacklevel=2)
            return None

    def save(self) -> None:
        """Writes a checkpoint, where there is a folder."""
        if self.folder is None:
            return
        self.source.flush()  # first the rows, then the checkpoint that counts them
        tree = self.source.tree(self.states)
        save_tree(self.folder / f"{self.step:010d}.npz", tree, {"step": self.step, "failures": self.failures})
        self._forget()

    def _forget(self) -> None:
        """Removes files that newer checkpoints have made useless."""
        if self.folder is None:
            return
        for _, path in checkpoints(self.folder)[:-KEPT]:
            path.unlink(missing_ok=True)
        for path in self.folder.glob("prepared-*.npz") if self.step else ():
            path.unlink(missing_ok=True)


def complete(job: Fit, what: str, on_chunk: Callable[[Chunk], None], advice: str = "; a lower learning rate may help") -> None:
    """Runs a fit to its end, from its checkpoints if it has any.

    Args:
        job: a fit that has not begun.
        what: name of the fit, for the error.
        on_chunk: called after every chunk.
        advice: how the error ends; empty where nobody sets the learning rate.

    Raises:
        UserError: all its checkpoints are damaged.
        DivergedError: a lane diverged.
    """
    job.resume()
    for progress in job.chunks():
        on_chunk(progress)
    for seed, failure in zip(job.seeds, job.failures):
        if failure is not None:
            whose = f" with seed {seed}" if len(job.seeds) > 1 else ""
            bad = f"{what}: {failure.metric} was not finite at update {failure.step}{whose}"
            raise DivergedError(f"{bad}{advice}")


def fit(
    learners: Sequence[Any],
    rows: BatchSource | Sequence[BatchSource],
    seeds: Sequence[int],
    steps: int,
    *,
    chunk: int = 1000,
    stream: bool | None = None,
    on_chunk: Callable[[Chunk], None] = lambda progress: None,
) -> Fitted:
    """Trains in memory, without a folder; see `Fit` for the arguments and errors."""
    job = Fit(learners, rows, seeds, steps, chunk=chunk, stream=stream)
    for progress in job.chunks():
        on_chunk(progress)
    return Fitted(job.states, job.failures, job.step)
