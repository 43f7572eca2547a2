"""Columns of a log that are computed when their rows are read, so that the log is not copied."""

from typing import Any

import numpy as np


class Computed:
    """(rows, size) numbers that look like a memory-mapped column: they have a shape and are read by indices of rows.

    Attributes:
        shape: rows, and numbers in each.
        dtype: of the numbers.
    """

    ndim = 2
    shape: tuple[int, int]
    dtype: np.dtype

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy is False:
            raise ValueError("these rows are computed when they are read, which needs a copy")
        return np.asarray(self[:], dtype)

    def __getitem__(self, index: Any) -> np.ndarray:
        raise NotImplementedError
