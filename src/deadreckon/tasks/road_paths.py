"""Paths of lines and arcs on the ground: where they lead, and how far along them points are. Both exact, and vectorised.

Metres and radians. x points east and y north; angles count from x towards y, and lateral offsets are positive to the left of
the direction of travel. A line is an arc whose curvature is 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from deadreckon.errors import UserError


class Pose(NamedTuple):
    """Places on a path, all arrays of one shape.

    Attributes:
        x: m.
        y: m.
        heading: rad, in the direction of travel; may be beyond pi, for it is not wrapped.
        curvature: 1/m, positive where the path bends to the left.
    """

    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    curvature: np.ndarray


class Projection(NamedTuple):
    """Where points are relative to a path, (n,) each.

    Attributes:
        distance: m along the path to the foot, the nearest place on it.
        lateral: m from the foot to the point, positive to the left; at an end of what is searched, the part across the path.
        heading: rad, of the path at the foot.
    """

    distance: np.ndarray
    lateral: np.ndarray
    heading: np.ndarray


@dataclass(frozen=True, eq=False)
class Path:
    """Pieces one behind the other, each a line or an arc; all arrays are (pieces,) float64.

    Attributes:
        x: m, of the beginnings.
        y: m, of the beginnings.
        heading: rad, at the beginnings.
        curvature: 1/m.
        length: m, above 0; no arc may go round more than once.
        closed: whether the first piece follows the last. Distances then count on from lap to lap, else they end at the ends.
    """

    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    curvature: np.ndarray
    length: np.ndarray
    closed: bool = False

    @cached_property
    def starts(self) -> np.ndarray:
        """(pieces + 1,) distance at which each piece begins, in m, and behind these the length of the path."""
        return np.concatenate([[0.0], np.cumsum(self.length)])

    @property
    def total(self) -> float:
        """Length of the path, in m."""
        return float(self.starts[-1])

    def within(self, distance: np.ndarray | float) -> np.ndarray:
        """Distances (...) in m as they are on the path: of a closed one in the first lap, of others between the ends."""
        distance = np.asarray(distance, np.float64)
        return distance % self.total if self.closed else np.clip(distance, 0.0, self.total)

    def piece(self, distance: np.ndarray) -> np.ndarray:
        """(...) int, the piece on which distances (...) lie that are `within` the path."""
        return np.clip(np.searchsorted(self.starts, distance, "right") - 1, 0, len(self.length) - 1)

    def pose(self, distance: np.ndarray | float) -> Pose:
        """Poses (...) at distances (...) in m. Beyond the ends of a path that is not closed they are those of the ends."""
        distance = self.within(distance)
        piece = self.piece(distance)
        return self.along(piece, distance - self.starts[piece])

    def ends(self) -> Pose:
        """(pieces,) pose at the end of each piece."""
        return self.along(np.arange(len(self.length)), self.length)

    def project(self, points: np.ndarray, near: np.ndarray | float | None = None, window: float = 10.0) -> Projection:
        """The nearest places on the path, by closed forms.

        Only what is at most `window` from `near` along the path is searched, so that progress does not jump where the path
        crosses itself or comes back beside itself.

        Args:
            points: (n, 2) x and y in m.
            near: (n,) or one distance in m where the points are about, such as that of a moment ago; `None`: anywhere.
            window: m before and behind `near`, above 0.

        Returns:
            Distances of a closed path are in the lap of `near`, or just before or behind it: they less `near` are the progress.
        """
        points = np.asarray(points, np.float64)
        begins = np.concatenate([self.starts - self.total, self.starts[1:], self.starts[1:] + self.total])
        lap = np.zeros(len(points))
        if near is None:
            low, high = np.zeros(len(points)), np.full(len(points), self.total)
        else:
            near = np.broadcast_to(np.asarray(near, np.float64), len(points))
            here = self.within(near)
            reach = min(window, self.total / 2) if self.closed else window
            low, high = here - reach, here + reach
            if self.closed:
                lap = near - here
            else:
                low, high = np.maximum(low, 0.0), np.minimum(high, self.total)
        first = np.searchsorted(begins, low, "right") - 1
        last = np.searchsorted(begins, high, "left") - 1
        # (n, candidates) pieces of three laps; those behind the last of a point repeat it.
        turn = np.minimum(first[:, None] + np.arange(max(int((last - first).max(initial=0)), 0) + 1), last[:, None])
        turn = np.clip(turn, 0, len(begins) - 2)
        piece, begin = turn % len(self.length), begins[turn]
        along = self.foot(points, piece, low[:, None] - begin, high[:, None] - begin)
        pose = self.along(piece, along)
        right, up = points[:, :1] - pose.x, points[:, 1:] - pose.y
        best = np.arange(len(points)), np.argmin(right**2 + up**2, axis=1)
        heading = pose.heading[best]
        lateral = up[best] * np.cos(heading) - right[best] * np.sin(heading)
        return Projection(begin[best] + along[best] + lap, lateral, heading)

    def along(self, piece: np.ndarray, along: np.ndarray) -> Pose:
        """Poses (...) so many m (...) behind the beginnings of pieces (...)."""
        curvature = self.curvature[piece]
        half = curvature * along / 2
        chord = along * np.sinc(half / np.pi)  # sin(half) / half, which is 1 on a line
        towards = self.heading[piece] + half
        return Pose(
            self.x[piece] + chord * np.cos(towards), self.y[piece] + chord * np.sin(towards), towards + half, curvature
        )  # fmt: skip

    def foot(self, points: np.ndarray, piece: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(n, candidates) m from the beginnings of pieces (n, candidates) to their places nearest to points (n, 2).

        These lie between `low` and `high`, (n, candidates) m, and on the pieces.
        """
        low, high = np.maximum(low, 0.0), np.minimum(high, self.length[piece])
        cos, sin, curvature = self._cos[piece], self._sin[piece], self.curvature[piece]
        right, up = points[:, :1] - self.x[piece], points[:, 1:] - self.y[piece]
        ahead, left = cos * right + sin * up, cos * up - sin * right
        straight = np.abs(curvature) < 1e-12  # over any length that a road can have
        bend = np.where(straight, 1.0, curvature)
        turned = np.arctan2(bend * ahead, 1.0 - bend * left) / bend
        # Of all turns of a circle the one nearest to the middle: if it lies outside, the end beside it is nearest.
        turned -= np.round((turned - (low + high) / 2) * np.abs(bend) / (2 * np.pi)) * (2 * np.pi / np.abs(bend))
        return np.clip(np.where(straight, ahead, turned), low, np.maximum(low, high))

    @cached_property
    def _cos(self) -> np.ndarray:
        return np.cos(self.heading)

    @cached_property
    def _sin(self) -> np.ndarray:
        return np.sin(self.heading)

    def offset(self, lateral: float) -> "Path":
        """The path that runs beside this one.

        Args:
            lateral: m to the left.

        Raises:
            UserError: an arc bends more sharply than that.
        """
        stretch = 1.0 - self.curvature * lateral
        if not (stretch > 0.0).all():
            tightest = 1.0 / np.abs(self.curvature).max()
            raise UserError(f"an arc of radius {tightest:.4g} m has no path {abs(lateral):.4g} m inside of it")
        return Path(
            self.x - lateral * self._sin, self.y + lateral * self._cos, self.heading, self.curvature / stretch,
            self.length * stretch, self.closed,
        )  # fmt: skip

    def reversed(self) -> "Path":
        """The same path from its end to its beginning."""
        ends = self.ends()
        return Path(
            ends.x[::-1], ends.y[::-1], ends.heading[::-1] + np.pi, -self.curvature[::-1], self.length[::-1], self.closed
        )  # fmt: skip


def joined(paths: Sequence[Path], closed: bool = False) -> Path:
    """One path of the pieces of several, at least one, in their order; whether each begins where the one before ends is not
    checked.

    Args:
        paths: in the order of travel.
        closed: whether the first follows the last.
    """
    rows = np.concatenate([[path.x, path.y, path.heading, path.curvature, path.length] for path in paths], axis=1)
    return Path(rows[0], rows[1], rows[2], rows[3], rows[4], closed)


def gaps(ends: Pose, begins: Pose) -> tuple[np.ndarray, np.ndarray]:
    """How far ends and the beginnings behind them are apart: (n,) m, and (n,) rad between 0 and pi."""
    turn = (ends.heading - begins.heading + np.pi) % (2 * np.pi) - np.pi
    return np.hypot(ends.x - begins.x, ends.y - begins.y), np.abs(turn)
