"""The lanes of a fit that are trained on one of several logs."""

from typing import Any

import jax

from deadreckon.training.fit import Chunk, Failure, Fit
from deadreckon.training.learner import lift
from deadreckon.training.sources import Source


class Part:
    """Some lanes of a fit, for the recorder of their run: it has the attributes of a fit, but does not train.

    Attributes:
        learners: of its lanes.
        seeds: of its lanes.
        each: the rows of its log, once per lane.
        learner: the learners as one, see `lift`.
    """

    def __init__(self, fit: Fit, lanes: slice):
        self.fit, self.lanes = fit, lanes
        self.learners, self.seeds, self.each = fit.learners[lanes], fit.seeds[lanes], fit.each[lanes]
        self.learner = lift(self.learners)

    @property
    def states(self) -> Any:
        """(lanes, ...) states."""
        return jax.tree.map(lambda leaf: leaf[self.lanes], self.fit.states)

    @property
    def failures(self) -> tuple[Failure | None, ...]:
        """Per lane None or why it stopped."""
        return self.fit.failures[self.lanes]

    @property
    def step(self) -> int:
        """Updates done."""
        return self.fit.step

    @property
    def steps(self) -> int:
        """Updates in all."""
        return self.fit.steps

    @property
    def ended(self) -> bool:
        """Whether all lanes of the fit have failed, also those of other logs: until then it continues."""
        return self.fit.ended

    @property
    def source(self) -> Source:
        """The source of the rows."""
        return self.fit.source

    def of(self, chunk: Chunk) -> Chunk:
        """The part of a chunk for its lanes."""
        metrics = {name: values[self.lanes] for name, values in chunk.metrics.items()}
        return Chunk(chunk.step, self.states, metrics, chunk.failures[self.lanes])
