"""Shortest ways through a grid, for all goals at once, by Q-iteration (thesis 7.3: "a planner that generates waypoints")."""

from functools import lru_cache

import numpy as np

DISCOUNT = 0.99  # of the Q-iteration


def routes(grid: np.ndarray) -> np.ndarray:
    """What `next_cells` says of a grid, planned once."""
    return _planned(grid.tobytes(), grid.shape)


@lru_cache
def _planned(grid: bytes, shape: tuple[int, int]) -> np.ndarray:
    return next_cells(np.frombuffer(grid, bool).reshape(shape))


def next_cells(grid: np.ndarray) -> np.ndarray:
    """Which cell to go to next, for every goal and every cell.

    Args:
        grid: (rows, columns) bool, True where free; cells are numbered as `np.argwhere(grid)` lists them.

    Returns:
        (cells, cells) int; entry [goal, cell] is the neighbour (or the cell itself) to move to. Entry [goal, goal] is
        the goal, and a cell from which the goal cannot be reached stays where it is.
    """
    cells = np.argwhere(grid)
    count = len(cells)
    index = np.full(np.add(grid.shape, 2), -1)  # with a border, so that no move leaves the array
    index[1:-1, 1:-1][grid] = np.arange(count)
    rows, columns = (cells + 1).T
    moves = np.stack([index[rows - 1, columns], index[rows + 1, columns], index[rows, columns - 1], index[rows, columns + 1]])
    moves = np.where(moves < 0, np.arange(count), moves)  # (4, cells); into a wall means to stay

    at_goal = np.eye(count)
    value, before = at_goal, np.zeros((count, count))  # [goal, cell]
    while (value != before).any():
        # Reward 1 for being at the goal, where the episode ends.
        value, before = np.where(at_goal, 1.0, DISCOUNT * value[:, moves].max(1)), value
    best = moves[value[:, moves].argmax(1), np.arange(count)]
    return np.where((at_goal > 0) | (value == 0), np.arange(count), best)
