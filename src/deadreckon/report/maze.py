"""Pictures of a maze from above, as its layout is written: rows run down."""

from collections.abc import Sequence

import numpy as np

from deadreckon.report.axes import svg
from deadreckon.report.markup import Markup, tag
from deadreckon.tasks.mazes import Maze

CELL = 60  # pixels
RIM = 0.3  # of the outer walls that is shown
LOW = 0.5 - RIM  # row and column of the picture's corner
BINS = 6  # squares along the side of a cell, where visits are counted
SHADES = 6
JUMP = 0.25  # cells; a longer step is a reset, not a move: the ball moves 0.05 at most, the ant 0.1
NEAR = 0.025  # cells; points nearer than this to the last one drawn are left out


def picture(task: Maze, paths: Sequence[np.ndarray], slots: Sequence[int], title: str, starts: bool) -> Markup:
    """A maze with paths in it.

    Args:
        task: whose walls and goal.
        paths: (steps, 2 or more) positions each, x and y first, NaN after an end.
        slots: colour of each path.
        title: for screen readers.
        starts: dots where paths begin and end.
    """
    paths = [task.grid_places(path[:, :2]) for path in paths]
    parts = []
    for path, slot in zip(paths, slots):
        drawn = _d(path)
        if drawn:
            parts.append(tag("path", d=drawn, class_=f"way s{slot}"))
    parts.append(_goal(task))
    if starts:
        for path, slot in zip(paths, slots):
            known = path[np.isfinite(path[:, 0])]
            if len(known):
                (x, y), (ex, ey) = _place(known[0]), _place(known[-1])
                parts.append(tag("circle", cx=f"{ex:.1f}", cy=f"{ey:.1f}", r=3.5, class_=f"finish s{slot}"))
                parts.append(tag("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=5.5, class_=f"start s{slot}"))
    return _maze(task, title, parts)


def visits(task: Maze, positions: np.ndarray) -> np.ndarray:
    """How many of positions (n, 2) lie in each square of a maze, with `BINS` squares along the side of a cell.

    Returns:
        (rows * BINS, columns * BINS) int, zeros in walls.
    """
    size = BINS * np.array(task.grid.shape)
    at = np.floor(BINS * (task.grid_places(positions) + 0.5)).astype(int)
    row, column = np.clip(at, 0, size - 1).T
    found = np.zeros(size, int)
    np.add.at(found, (row, column), 1)
    return found * np.repeat(np.repeat(task.grid, BINS, 0), BINS, 1)


def density(task: Maze, found: np.ndarray, title: str) -> Markup:
    """A maze with what `visits` found, the darker the more often (thesis D.6)."""
    side = CELL / BINS
    levels = np.ceil(SHADES * np.sqrt(found / max(found.max(), 1))).astype(int)  # the root, because starts are crowded
    parts = []
    for level in range(1, SHADES + 1):
        corners = _place(np.argwhere(levels == level) / BINS - 0.5)
        squares = "".join(f"M{x:.1f} {y:.1f}h{side:g}v{side:g}h{-side:g}Z" for x, y in corners)
        parts.append(tag("path", d=squares, class_="visited s0", fill_opacity=f"{level / SHADES:.2f}"))
    return _maze(task, title, [*parts, _goal(task)])


def _place(points: np.ndarray) -> np.ndarray:
    """Rows and columns in pixels, to the right and down."""
    return (points - LOW)[..., ::-1] * CELL


def _maze(task: Maze, title: str, parts: Sequence[Markup]) -> Markup:
    height, width = (round((cells - 1.5 + RIM - LOW) * CELL) for cells in task.grid.shape)
    blocks = "".join(f"M{x:.1f} {y:.1f}h{CELL}v{CELL}h{-CELL}Z" for x, y in _place(np.argwhere(~task.grid) - 0.5))
    gx, gy = _place(task.grid_places(task.goal_place()))
    reach, side = (CELL * length / task.width for length in (task.reach, 2 * (task.reach + task.goal_spread)))
    # Where a step can be rewarded: within reach of the goal, or of a square of goals, whose corners are then round.
    zone = {"x": f"{gx - side / 2:.1f}", "y": f"{gy - side / 2:.1f}", "width": f"{side:.1f}", "height": f"{side:.1f}"}
    below = [
        tag("rect", width=width, height=height, class_="floor"),
        tag("rect", **zone, rx=f"{reach:.1f}", class_="reach"),
        tag("path", d=blocks, class_="wall"),
    ]  # fmt: skip
    return svg([*below, *parts], width, height, title, "maze")


def _goal(task: Maze) -> Markup:
    x, y = _place(task.grid_places(task.goal_place()))
    return tag("path", d=_star(float(x), float(y), 13.0), class_="star")


def _d(path: np.ndarray) -> str:
    """Path data; broken at resets and where numbers end."""
    out: list[str] = []
    before = drawn = None
    for point in path:
        if not np.isfinite(point).all():
            before = drawn = None
            continue
        if before is None or drawn is None or np.abs(point - before).max() > JUMP:
            x, y = _place(point)
            out.append(f"M{x:.1f} {y:.1f}")
            drawn = point
        elif np.abs(point - drawn).max() >= NEAR:
            x, y = _place(point)
            out.append(f"L{x:.1f} {y:.1f}")
            drawn = point
        before = point
    return "".join(out)


def _star(x: float, y: float, radius: float) -> str:
    angles = np.pi * (np.arange(10) / 5 - 0.5)
    reach = np.where(np.arange(10) % 2 == 0, radius, 0.42 * radius)
    points = zip(x + reach * np.cos(angles), y + reach * np.sin(angles))
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points) + "Z"
