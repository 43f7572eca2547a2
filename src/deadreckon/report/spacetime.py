"""Space-time diagrams of traffic: where every car is, coloured by its speed."""

from collections.abc import Sequence

import numpy as np

from deadreckon.report.axes import POINTS, Axis, columns, path, svg
from deadreckon.report.markup import Markup, tag

SPEEDS = 0.5, 2.0, 5.0, 10.0  # m/s, between one colour of `spacetime` and the next
WRAP = 0.5  # of a road: a car that moves further between two steps has come round


def spacetime(
    cars: np.ndarray, seconds: float, learners: Sequence[int], title: str, size: tuple[int, int] = (480, 300)
) -> Markup:
    """Where cars are against time, coloured by their speed: waves of stopping and going are bands that run backwards.

    Args:
        cars: (steps, cars, 2) positions in m and speeds in m/s, NaN where there is no car.
        seconds: of a step.
        learners: cars whose lines are set off.
        title: read by screen readers.
        size: of the drawing.
    """
    width, height = size
    bottom, left, top, right = height - 38, 52, 30, width - 14
    steps = np.unique(np.linspace(0, len(cars) - 1, POINTS).astype(int))
    places, speeds = cars[steps, :, 0], cars[steps, :, 1]
    if not np.isfinite(places).any():
        return tag("p", "nothing finite to draw", class_="empty")
    longest = float(np.nanmax(places))
    x, y = Axis(0.0, float(steps[-1] * seconds), left, right, most=7), Axis(0.0, longest, bottom, top)
    px, py = x(steps * seconds), y(places)
    drawn: list[list[str]] = [[] for _ in range(len(SPEEDS) + 1)]
    own: list[str] = []
    for car in range(cars.shape[1]):
        ahead = np.abs(np.diff(places[:, car])) < WRAP * longest  # false of NaN
        own += [path(*part) for part in _runs(px, py[:, car], ahead, ahead)] if car in learners else []
        colours = np.digitize((speeds[1:, car] + speeds[:-1, car]) / 2, SPEEDS)
        for colour in range(len(drawn)):
            drawn[colour] += [path(*part) for part in _runs(px, py[:, car], ahead, colours == colour)]
    parts = columns(x, top, bottom + 24)
    parts += [tag("text", y.label(t), x=left - 7, y=f"{y(t) + 4:.1f}", class_="tick end") for t in y.ticks]
    parts.append(tag("text", "m", x=4, y=14, class_="axis"))
    parts.append(tag("text", "s", x=right, y=bottom + 34, class_="axis end"))
    names = [f"< {limit:g}" for limit in SPEEDS] + [f"{SPEEDS[-1]:g} m/s and more"]
    at = left
    for colour, name in enumerate(names):
        parts.append(tag("path", d=f"M{at} 10h16", class_=f"car speed{colour}"))
        parts.append(tag("text", name, x=at + 21, y=14, class_="axis"))
        at += 34 + 7 * len(name)
    parts += [tag("path", d="".join(d), class_=f"car speed{colour}") for colour, d in enumerate(drawn) if d]
    parts.append(tag("path", d="".join(own), class_="car own"))
    return svg(parts, width, height, title, f"chart v{width}")


def _runs(x: np.ndarray, y: np.ndarray, ahead: np.ndarray, wanted: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The stretches of a line whose pieces, one less than its points, all are both `ahead` and `wanted`."""
    good = np.concatenate([[False], ahead & wanted, [False]])
    begins, ends = np.flatnonzero(good[1:] & ~good[:-1]), np.flatnonzero(good[:-1] & ~good[1:])
    return [(x[begin : end + 1], y[begin : end + 1]) for begin, end in zip(begins, ends)]
