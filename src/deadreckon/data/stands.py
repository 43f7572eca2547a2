"""When the Gym-MuJoCo bodies stand, of states (n, positions + velocities): Gymnasium's rules, for arrays of NumPy or JAX."""

from typing import Any


def _between(column: Any, low: float, high: float) -> Any:
    return (low < column) & (column < high)


def _finite(state: Any) -> Any:
    return (abs(state) < float("inf")).all(1)


def pendulum(state: Any) -> Any:
    """The pole leans less than 0.2 rad."""
    return _finite(state) & (abs(state[:, 1]) <= 0.2)


def hopper(state: Any) -> Any:
    """The torso is above 0.7 m and upright."""
    bounded = (abs(state[:, 2:]) < 100.0).all(1)
    return bounded & (state[:, 1] > 0.7) & _between(state[:, 2], -0.2, 0.2)


def walker(state: Any) -> Any:
    """The torso is between 0.8 and 2 m, and upright."""
    return _between(state[:, 1], 0.8, 2.0) & _between(state[:, 2], -1.0, 1.0)


def ant(state: Any) -> Any:
    """The torso is between 0.2 and 1 m."""
    return _finite(state) & (state[:, 2] >= 0.2) & (state[:, 2] <= 1.0)


def humanoid(state: Any) -> Any:
    """The torso is between 1 and 2 m."""
    return _between(state[:, 2], 1.0, 2.0)
