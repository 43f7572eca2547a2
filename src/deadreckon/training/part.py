"""Lanes of a fit that learn from one log, where others beside them learn from other logs."""

from typing import Any

import jax

from deadreckon.training.fit import Chunk, Failure, Fit
from deadreckon.training.learner import lift
from deadreckon.training.sources import Source


class Part:
    """Some lanes of a fit, as whoever records their run sees them: a fit that others walk.

    Attributes:
        learners: of its lanes.
        seeds: of its lanes.
        each: the log of its lanes, for each of them.
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
        """Whether all lanes of the fit have failed, those of other logs too: until then it goes on."""
        return self.fit.ended

    @property
    def source(self) -> Source:
        """Where rows come from."""
        return self.fit.source

    def of(self, chunk: Chunk) -> Chunk:
        """What a chunk says of its lanes."""
        metrics = {name: values[self.lanes] for name, values in chunk.metrics.items()}
        return Chunk(chunk.step, self.states, metrics, chunk.failures[self.lanes])
