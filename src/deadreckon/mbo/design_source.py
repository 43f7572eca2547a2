"""Designs as rows for the training loop."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from deadreckon.mbo.designs import Designs


class DesignSource:
    """Rows of designs for `training.fit`: coordinates `x` and standardised scores `y`, in a batch's `extra`.

    Args:
        designs: the training data.
        needs: the learner's `BatchSpec`, of which only the batch size is used.
        more: further columns, one row per design.
    """

    initial: dict[str, np.ndarray] | None = None
    view: Any = None  # the coordinates of policies; those of designs are `spec`

    def __init__(self, designs: Designs, needs: Any, more: Mapping[str, np.ndarray] | None = None):
        self.needs = needs
        self.spec: Any = designs.coordinates
        y = (designs.y - self.spec.y_mean) / self.spec.y_std
        self.columns = {"x": self.spec.encode(designs.x), "y": y.astype(np.float32), **(more or {})}
        self.count = len(designs)
        self.fields = {name: (column.shape[1:], column.dtype) for name, column in self.columns.items()}

    @property
    def nbytes(self) -> int:
        """Memory of all columns, in bytes."""
        return sum(column.nbytes for column in self.columns.values())

    def take(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Columns at these indices."""
        return {name: column[index] for name, column in self.columns.items()}

