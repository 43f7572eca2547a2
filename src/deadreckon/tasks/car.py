"""The car that is driven in the tasks of driving: a bicycle model, in numpy.

It has two axles, each as far from its middle, which is what a position means.
"""

from typing import Any

import numpy as np

AXLE = 1.25  # m from the middle to an axle
STEER, STEER_RATE = 0.6, 3.0  # rad of the front wheels at an action of 1, and rad/s by which they can turn
DRIVE, BRAKE = 4.0, 8.0  # m/s² at an action of 1 and of -1
ROLL, DRAG = 0.15, 0.004  # m/s² that a rolling car loses, and 1/m times its squared speed
GRIP = 8.0  # m/s² across, beyond which tyres slide and a bend becomes wider
STEP, PARTS = 0.05, 5  # s of a step, and parts in which it is integrated

X, Y, YAW, VELOCITY, WHEEL = range(5)  # columns of a car's state


def moved(cars: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """(n, 5) cars after a step: x and y in m, heading in rad, speed in m/s, angle of the front wheels in rad.

    The kinematic bicycle model with the reference point in the middle (Kong et al. 2015, eq. 1). Where the tyres would have
    to bear more than `GRIP`, the car turns as fast as they can make it.

    Args:
        cars: (n, 5) before it.
        actions: (n, 2) throttle, or brake where negative, and steering to the right, as CARLA counts it, in ±1.
    """
    pedal, wheel = np.clip(actions, -1.0, 1.0).astype(np.float64).T
    x, y, yaw, speed, angle = cars.T.copy()
    part = STEP / PARTS
    for _ in range(PARTS):
        angle = angle + np.clip(-STEER * wheel - angle, -STEER_RATE * part, STEER_RATE * part)
        force = np.where(pedal >= 0.0, DRIVE * pedal, BRAKE * pedal) - ROLL - DRAG * speed**2
        before, speed = speed, np.maximum(speed + force * part, 0.0)  # neither brakes nor resistance drive it backwards
        mean = (before + speed) / 2.0
        bend = curvature(angle, mean)
        towards = yaw + np.arcsin(bend * AXLE) + bend * mean * part / 2.0
        x, y, yaw = x + mean * np.cos(towards) * part, y + mean * np.sin(towards) * part, yaw + bend * mean * part
    return np.stack([x, y, yaw, speed, angle], 1)


def actions_for(bend: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(n, 2) float32 actions by which cars follow a curvature (n,) in 1/m, and accelerate by (n,) m/s²; the inverse of `moved`
    for wheels that are there already, tyres that hold, and no resistance."""
    wheels = np.arctan(2 * np.tan(np.arcsin(np.clip(bend * AXLE, -1.0, 1.0))))
    pedal = np.where(force >= 0.0, force / DRIVE, force / BRAKE)
    return np.clip(np.stack([pedal, -wheels / STEER], 1), -1.0, 1.0).astype(np.float32)


def curvature(wheels: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """(n,) 1/m, the curvature of the ways of the middles of cars, by (n,) rad and m/s: no more than `GRIP` allows."""
    tightest = GRIP / np.maximum(speed, 1e-3) ** 2
    return np.clip(np.sin(np.arctan(np.tan(wheels) / 2.0)) / AXLE, -tightest, tightest)


def course(cars: np.ndarray) -> np.ndarray:
    """(n,) rad, the direction in which the middles of cars (n, 5) move."""
    return cars[:, YAW] + np.arcsin(curvature(cars[:, WHEEL], cars[:, VELOCITY]) * AXLE)


def off_the_road(offset: Any, width: float) -> Any:
    """(...) bool: beyond the right edge of the lane, or the left one of the lane beside it.

    Args:
        offset: (...) m of the middles of cars from the middle of the lane, positive to the left, as numpy or JAX arrays.
        width: m, of a lane.
    """
    return (offset < -0.5 * width) | (offset > 1.5 * width)
