"""Vectors from observations and actions of Gymnasium's spaces, in the order of `gymnasium.spaces.utils.flatten`, with names."""

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError

MOST_JOINED = 10_000  # largest number of combinations of joined actions
MOST_NUMBERS = 100_000  # largest number of dimensions of a flattened observation


def flatten_space(space: Any, values: Any, name: str = "") -> tuple[np.ndarray, list[str]]:
    """(rows, size) float32 vectors of observations, and the names of their dimensions.

    Box and MultiBinary are flattened, Discrete and MultiDiscrete are one-hot, the parts of Tuple and Dict are concatenated.

    Args:
        space: Gymnasium's, of one observation.
        values: of all rows: an array, or a dict or tuple of arrays, matching the space.
        name: of the space; "observation" if empty.

    Raises:
        UserError: a kind of space that has no fixed number of dimensions, an image, or a value outside of the space.
    """
    from gymnasium import spaces

    title = name or "observation"
    if isinstance(space, spaces.Dict):
        parts = [flatten_space(inner, values[key], _inside(name, key)) for key, inner in space.spaces.items()]
        return _beside(parts, title)
    if isinstance(space, spaces.Tuple):
        parts = [flatten_space(inner, values[index], _inside(name, index)) for index, inner in enumerate(space.spaces)]
        return _beside(parts, title)
    if not isinstance(space, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)):
        known = "Box, Discrete, MultiBinary, MultiDiscrete, and Dict and Tuple of these are read"
        raise UserError(f"{title} is {type(space).__name__}, which has no fixed number of dimensions; {known}")
    column = np.asarray(values)
    if isinstance(space, spaces.Discrete):
        return one_hot(column.reshape(len(column)), int(space.n), int(space.start), title)
    if isinstance(space, spaces.MultiDiscrete):
        counts, starts = np.ravel(space.nvec).tolist(), np.ravel(space.start).tolist()
        cells = _cells(title, space.nvec.shape)
        flat = column.reshape(len(column), -1)
        return _beside([one_hot(flat[:, i], counts[i], starts[i], cells[i]) for i in range(len(counts))], title)
    return _numbers(column, title)


def join_arrays(parts: Mapping[str, np.ndarray]) -> tuple[np.ndarray, list[str]]:
    """(rows, size) float32 concatenation of a dict of arrays (rows, ...) in the order of their names, like Gymnasium's Dict
    space; and the names of its dimensions.

    Raises:
        UserError: the arrays have different numbers of rows, or one is an image.
    """
    found = [_numbers(parts[key], key) for key in sorted(parts)]
    if len({len(column) for column, _ in found}) > 1:
        raise UserError(f"{', '.join(sorted(parts))} have different numbers of rows")
    return _beside(found, "observation")


def one_hot(column: np.ndarray, count: int, start: int, name: str) -> tuple[np.ndarray, list[str]]:
    """(rows, count) float32 one-hot vectors of a column (rows,) of integers from `start` on, and the names of the dimensions.

    Raises:
        UserError: a value that is not one of `count`.
    """
    index = column.astype(np.int64) - start
    wrong = (index < 0) | (index >= count) | (column != np.floor(column))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"{name} has {column[row]} in row {row}, {start} .. {start + count - 1} is needed")
    if count > MOST_NUMBERS:
        raise UserError(f"{name} has {count} values, at most {MOST_NUMBERS} are read as one-hot numbers")
    out = np.zeros((len(column), count), np.float32)
    out[np.arange(len(column)), index] = 1
    return out, [f"{name}={start + level}" for level in range(count)]


def join_actions(space: Any, values: np.ndarray) -> tuple[np.ndarray, Discrete, list[list[int]]]:
    """Joins actions of several integers into one: (rows,) indices, their space, and the integers of each index.

    Args:
        space: MultiDiscrete or MultiBinary of Gymnasium.
        values: (rows, ...) integers.

    Raises:
        UserError: there are too many combinations, or a value is outside of the space.
    """
    counts = np.ravel(getattr(space, "nvec", np.full(space.shape, 2)))
    starts = np.ravel(getattr(space, "start", np.zeros(space.shape, int)))
    combinations = math.prod(counts.tolist())
    if combinations > MOST_JOINED:
        kind = f"actions are {type(space).__name__} with {combinations:,} combinations"
        raise UserError(f"{kind}; at most {MOST_JOINED:,} are joined into one discrete action")
    flat = np.asarray(values).reshape(len(values), -1)
    index = flat.astype(np.int64) - starts
    wrong = ((index < 0) | (index >= counts) | (flat != np.floor(flat))).any(1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"actions have {flat[row].tolist()} in row {row}, which is not in {space}")
    levels = itertools.product(*(range(start, start + count) for start, count in zip(starts.tolist(), counts.tolist())))
    codes = np.asarray(np.ravel_multi_index(tuple(index.T), tuple(counts.tolist())))
    return codes, Discrete(combinations), [list(level) for level in levels]


def bounds(space: Any) -> Box | None:
    """The bounds of Gymnasium's Box; None if they are not finite."""
    if not (np.isfinite(space.low).all() and np.isfinite(space.high).all()):
        return None
    low, high = (bound.astype(np.float64).ravel().tolist() for bound in (space.low, space.high))
    return Box(tuple(low), tuple(high))


def _inside(name: str, key: Any) -> str:
    return f"{name}/{key}" if name else str(key)


def _numbers(column: np.ndarray, name: str) -> tuple[np.ndarray, list[str]]:
    shape = column.shape[1:]
    if column.dtype == np.uint8 and len(shape) >= 2:
        raise UserError(f"{name} is an image of shape {shape} beside other observations; images alone or numbers are read")
    if math.prod(shape) > MOST_NUMBERS:
        raise UserError(f"{name} has {math.prod(shape)} numbers, at most {MOST_NUMBERS} are read")
    return column.reshape(len(column), -1).astype(np.float32), _cells(name, shape)


def _cells(name: str, shape: tuple[int, ...]) -> list[str]:
    return [f"{name}[{','.join(map(str, index))}]" if index else name for index in np.ndindex(*shape)]


def _beside(parts: list[tuple[np.ndarray, list[str]]], name: str) -> tuple[np.ndarray, list[str]]:
    if not parts:
        raise UserError(f"{name} holds nothing")
    return np.concatenate([column for column, _ in parts], 1), [text for _, names in parts for text in names]
