"""Pictures of a maze from above: x, the row of the layout, runs down; y runs to the right."""

from collections.abc import Sequence

import numpy as np

from deadreckon.report.markup import Markup, tag
from deadreckon.tasks.maze2d import REACH, Maze2D

CELL = 60  # pixels
RIM = 0.3  # of the outer walls that is shown
JUMP = 0.25  # a longer step is a reset, not a move: the ball moves 0.05 at most
NEAR = 0.025  # points nearer than this to the last one drawn are left out


def picture(task: Maze2D, paths: Sequence[np.ndarray], slots: Sequence[int], title: str, starts: bool) -> Markup:
    """A maze with paths in it.

    Args:
        task: whose walls and goal.
        paths: (steps, 2 or more) positions each, NaN after an end.
        slots: colour of each path.
        title: for screen readers.
        starts: dots where paths begin and end.
    """
    walls = task.walls()
    low, high = walls[:, :2].min(0) + 1 - RIM, walls[:, 2:].max(0) - 1 + RIM

    def place(points: np.ndarray) -> np.ndarray:
        return (points[..., :2] - low)[..., ::-1] * CELL

    height, width = (high - low) * CELL
    parts = [tag("title", title), tag("rect", width=f"{width:.0f}", height=f"{height:.0f}", class_="floor")]
    blocks = "".join(f"M{y:.1f} {x:.1f}h{CELL}v{CELL}h{-CELL}Z" for y, x in place(walls[:, :2]))
    gy, gx = place(task.goal)
    parts.append(tag("circle", cx=f"{gy:.1f}", cy=f"{gx:.1f}", r=REACH * CELL, class_="reach"))
    parts.append(tag("path", d=blocks, class_="wall"))
    for path, slot in zip(paths, slots):
        drawn = _d(path, place)
        if drawn:
            parts.append(tag("path", d=drawn, class_=f"way s{slot}"))
    parts.append(tag("path", d=_star(float(gy), float(gx), 13.0), class_="star"))
    if starts:
        for path, slot in zip(paths, slots):
            known = path[np.isfinite(path[:, 0])]
            if len(known):
                (y, x), (ey, ex) = place(known[0]), place(known[-1])
                parts.append(tag("circle", cx=f"{ey:.1f}", cy=f"{ex:.1f}", r=3.5, class_=f"finish s{slot}"))
                parts.append(tag("circle", cx=f"{y:.1f}", cy=f"{x:.1f}", r=5.5, class_=f"start s{slot}"))
    return tag("svg", parts, viewBox=f"0 0 {width:.0f} {height:.0f}", role="img", aria_label=title, class_="maze")


def _d(path: np.ndarray, place) -> str:
    """Path data; broken at resets and where numbers end."""
    out: list[str] = []
    before = drawn = None
    for point in path[:, :2]:
        if not np.isfinite(point).all():
            before = drawn = None
            continue
        if before is None or drawn is None or np.abs(point - before).max() > JUMP:
            y, x = place(point)
            out.append(f"M{y:.1f} {x:.1f}")
            drawn = point
        elif np.abs(point - drawn).max() >= NEAR:
            y, x = place(point)
            out.append(f"L{y:.1f} {x:.1f}")
            drawn = point
        before = point
    return "".join(out)


def _star(x: float, y: float, radius: float) -> str:
    angles = np.pi * (np.arange(10) / 5 - 0.5)
    reach = np.where(np.arange(10) % 2 == 0, radius, 0.42 * radius)
    points = zip(x + reach * np.cos(angles), y + reach * np.sin(angles))
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points) + "Z"
