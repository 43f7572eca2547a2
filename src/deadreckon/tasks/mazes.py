"""What mazes have in common: a layout of cells, and where these lie on the ground."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from deadreckon.errors import UserError
from deadreckon.tasks.task import Task


@dataclass(frozen=True)
class Maze(Task):
    """A task in a maze. Observations begin with x and y. Domains subclass it and say where cells lie.

    Attributes:
        layout: rows of the maze from the top, joined by "/": "#" wall, "G" the goal, the others free.
        marks: letters besides "#" and "O", each of which stands in a layout once.
        width: side of a cell, in the units of x and y.
        reach: distance from the goal within which a step is rewarded.
    """

    revision: ClassVar[int] = 1

    layout: str = ""
    marks: str = "G"
    width: float = 1.0
    reach: float = 0.5

    def __post_init__(self):
        rows = self.layout.split("/")
        # A border that leaks would let what moves away for ever.
        closed = set(rows[0] + rows[-1] + "".join(row[:1] + row[-1:] for row in rows)) == {"#"}
        once = all(self.layout.count(mark) == 1 for mark in self.marks)
        if len({len(row) for row in rows}) != 1 or set(self.layout) - set(f"#O{self.marks}/") or not once or not closed:
            marks = " and ".join(f"one '{mark}'" for mark in self.marks)
            raise UserError(f"{self.name}: layout needs equal rows of '#', 'O' and {marks}, closed by '#', got {self.layout!r}")

    @cached_property
    def grid(self) -> np.ndarray:
        """(rows, columns) bool, True where a cell is free."""
        return np.array([[cell != "#" for cell in row] for row in self.layout.split("/")])

    @cached_property
    def cells(self) -> np.ndarray:
        """(cells, 2) int row and column of each free cell; the goal's is among them."""
        return np.argwhere(self.grid)

    def marked(self, mark: str) -> np.ndarray:
        """(2,) row and column of the cell with that letter."""
        return np.array(divmod(self.layout.replace("/", "").index(mark), self.grid.shape[1]))

    def middles(self, cells: np.ndarray) -> np.ndarray:
        """(n, 2) x and y of the middles of cells (n, 2), row and column."""
        raise NotImplementedError

    def grid_places(self, positions: np.ndarray) -> np.ndarray:
        """(..., 2) row and column, with fractions, of positions (..., 2); the inverse of `middles`."""
        raise NotImplementedError

    def goal_place(self) -> np.ndarray:
        """(2,) x and y of the goal, or of the middle of where goals may be."""
        raise NotImplementedError

    @property
    def goal_spread(self) -> float:
        """Half the side of the square about `goal_place` in which each episode's goal lies; 0 where it is always the same."""
        return 0.0

    def walls(self) -> np.ndarray:
        """(walls, 4) x low, y low, x high, y high of each wall box, in the observations' coordinates."""
        middle = self.middles(np.argwhere(~self.grid))
        return np.hstack([middle - self.width / 2, middle + self.width / 2])

    def cell_of(self, positions: np.ndarray) -> np.ndarray:
        """(n,) index into `cells` of the cell that each of (n, 2) positions is in, -1 inside a wall."""
        row, column = np.rint(self.grid_places(positions)).astype(int).T
        return self._index[row, column]

    @cached_property
    def _index(self) -> np.ndarray:
        index = np.full(self.grid.shape, -1)
        index[self.grid] = np.arange(len(self.cells))
        return index
