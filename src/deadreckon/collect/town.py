"""How logs of driving in a town are made: pure pursuit along the route that keeps to lights and keeps clear of other cars."""

import numpy as np

from deadreckon.collect.driving import CRUISE, EAGER
from deadreckon.tasks.car import actions_for
from deadreckon.tasks.town import (
    AHEAD,
    APPROACH,
    BEFORE,
    EACH,
    HEADING,
    LEFT,
    LIGHT,
    OFFSET,
    OTHERS,
    PRESENT,
    SPEED,
    TURNED,
)
from deadreckon.tasks.traffic import LENGTH, WIDTH

LOOK = 5  # m, how far along the route the place is that it steers for
FAR = 24  # m of the route that it looks at
ACROSS, GENTLE, YELLOW_BRAKING = 2.5, 2.5, 4.0  # m/s² across in bends, along, and at most to stop before yellow
SHORT, BEHIND = 0.8, 2.5  # m that it stops before lines and behind cars
CLEAR = 0.2  # m between cars that pass each other
NOISE = 0.2  # standard deviation of what is added to actions in the noisy log


def route_ahead(seen: np.ndarray) -> np.ndarray:
    """(n, `FAR` + 1, 2) m ahead and to the left of the car, the middle of the lane at each m along the route from here.

    Args:
        seen: (n, 46) observations.
    """
    middle = np.arange(FAR) + 0.5
    bend = seen[:, 4 + np.abs(AHEAD - middle[:, None]).argmin(1)]
    # Half of a piece's bend lies before its middle.
    towards = np.cumsum(bend, 1) - bend / 2 - seen[:, [HEADING]]
    steps = np.stack([np.cos(towards), np.sin(towards)], 2)
    heading, offset = seen[:, HEADING], seen[:, OFFSET]
    foot = -offset[:, None] * np.stack([np.sin(heading), np.cos(heading)], 1)
    return foot[:, None] + np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, 1)], 1)


def drive(observations: np.ndarray) -> np.ndarray:
    """(n, 2) float32 actions, a function of observations (n, 46) of `tasks.town.TownDriving`.

    It steers about the circle that leads to the middle of the lane `LOOK` m ahead (pure pursuit, Coulter 1992), and drives at
    the least of the speeds that cruising, bends, the light and cars on its way allow.
    """
    seen = observations.astype(np.float64)
    way = route_ahead(seen)
    ahead, left = way[:, LOOK].T
    circle = 2 * left / (ahead**2 + left**2)  # 1/m
    bend = np.abs(seen[:, 4 : 4 + len(AHEAD)])
    in_bends = np.sqrt((ACROSS / np.maximum(bend, 1e-3) + 2 * GENTLE * AHEAD).min(1))
    allowed = np.minimum(np.minimum(CRUISE, in_bends), np.minimum(_at_the_light(seen), _behind_others(seen, way)))
    return actions_for(circle, EAGER * (allowed - seen[:, SPEED]))


def _at_the_light(seen: np.ndarray) -> np.ndarray:
    """(n,) m/s from which it stops gently before a line that it may not pass, inf without one."""
    away, _, yellow, red = seen[:, LIGHT : LIGHT + 4].T
    needed = np.square(seen[:, SPEED]) / (2 * np.maximum(away, 0.01))
    stop = (red > 0) | ((yellow > 0) & (needed <= YELLOW_BRAKING))
    return np.where(stop, np.sqrt(2 * GENTLE * np.maximum(away - SHORT, 0.0)), np.inf)


def _behind_others(seen: np.ndarray, way: np.ndarray) -> np.ndarray:
    """(n,) m/s from which it can brake gently to the speed of the cars on its way, inf without any."""
    others = seen[:, OTHERS:].reshape(len(seen), -1, EACH)
    # Three places in each car, the middles of circles that cover it.
    third = LENGTH / 3
    body = np.array([-third, 0.0, third])
    x = others[..., [BEFORE]] + body * np.cos(others[..., [TURNED]])
    y = others[..., [LEFT]] + body * np.sin(others[..., [TURNED]])
    apart = np.hypot(x[..., None] - way[:, None, None, :, 0], y[..., None] - way[:, None, None, :, 1])
    near = (apart < WIDTH + CLEAR).any(2) & (others[..., [PRESENT]] > 0) & (x.max(2) > 0.0)[..., None]
    first = np.where(near.any(2), near.argmax(2), np.inf)  # m along the route, where it comes near to them
    gap = np.maximum(first - LENGTH / 2 + WIDTH / 2 - BEHIND, 0.0)
    along = np.maximum(seen[:, [SPEED]] + others[..., APPROACH], 0.0)
    return np.sqrt(np.where(np.isinf(first), np.inf, np.square(along) * (gap > 0.0) + 2 * GENTLE * gap)).min(1)
