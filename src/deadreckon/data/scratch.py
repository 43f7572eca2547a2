"""Where columns are kept while a table is read: in memory, or in files of a folder, for tables larger than memory."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

BLOCK = 262_144  # rows that are moved or looked at together, so that no memory-mapped column is loaded whole


class Scratch:
    """Makes arrays.

    Args:
        folder: that takes a file for each array, which is then memory-mapped; None: arrays are in memory.
    """

    def __init__(self, folder: Path | None = None):
        self.folder, self.count = folder, 0

    def empty(self, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        """A new array, which holds anything."""
        if self.folder is None:
            return np.empty(shape, dtype)
        self.count += 1
        return np.lib.format.open_memmap(self.folder / f"{self.count}.npy", "w+", dtype, shape)

    def keep(self, column: np.ndarray) -> np.ndarray:
        """The same values where this keeps its arrays; in memory the array itself."""
        if self.folder is None:
            return column
        out = self.empty(column.shape, column.dtype)
        out[...] = column
        return out

    def stacked(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """(rows, size) columns side by side, as `numpy.stack` puts them."""
        if self.folder is None:
            return np.stack(columns, 1)
        out = self.empty((len(columns[0]), len(columns)), np.result_type(*columns))
        for index, column in enumerate(columns):
            out[:, index] = column
        return out

    def ordered(self, column: np.ndarray, order: np.ndarray | slice) -> np.ndarray:
        """(rows, ...) the rows of a column in another order."""
        if self.folder is None or isinstance(order, slice):
            return column[order]
        out = self.empty(column.shape, column.dtype)
        for start in range(0, len(out), BLOCK):
            out[start : start + BLOCK] = column[order[start : start + BLOCK]]
        return out
