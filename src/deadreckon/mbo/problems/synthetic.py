"""Functions whose best design is known, as design problems that need no data from elsewhere.

The classic test functions of global optimisation (Surjanovic and Bingham's collection), turned around so that large is good,
and Kauffman's NK landscapes over letters, where all designs are few enough to be looked at.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.problem import Problem, hidden
from deadreckon.mbo.variables import Variable

_A = np.array([[10, 3, 17, 3.5, 1.7, 8], [0.05, 10, 17, 0.1, 8, 14], [3, 3.5, 1.7, 10, 17, 8], [17, 8, 0.05, 10, 0.1, 14]])
_P = 1e-4 * np.array(
    [[1312, 1696, 5569, 124, 8283, 5886], [2329, 4135, 8307, 3736, 1004, 9991],
     [2348, 1451, 3522, 2883, 3047, 6650], [4047, 8828, 8732, 5743, 1091, 381]]
)  # fmt: skip
_ALPHA = np.array([1.0, 1.2, 3.0, 3.2])


def ackley(x: np.ndarray) -> np.ndarray:
    """One deep well in a field of shallow ones; 0 at 0."""
    bowl, waves = np.sqrt(np.square(x).mean(-1)), np.cos(2 * np.pi * x).mean(-1)
    return 20 * np.exp(-0.2 * bowl) + np.exp(waves) - 20 - np.e


def branin(x: np.ndarray) -> np.ndarray:
    """Three equal hills in two dimensions; -0.397887 at (pi, 2.275) and two others."""
    a, b = x[..., 0], x[..., 1]
    curve = b - 5.1 / (4 * np.pi**2) * a**2 + 5 / np.pi * a - 6
    return -(curve**2 + 10 * (1 - 1 / (8 * np.pi)) * np.cos(a) + 10)


def hartmann6(x: np.ndarray) -> np.ndarray:
    """Four bumps in six dimensions; 3.32237."""
    distance = (_A * np.square(x[..., None, :] - _P)).sum(-1)
    return (_ALPHA * np.exp(-distance)).sum(-1)


def rastrigin(x: np.ndarray) -> np.ndarray:
    """A bowl with regular waves; 0 at 0."""
    return -(np.square(x) - 10 * np.cos(2 * np.pi * x) + 10).sum(-1)


def rosenbrock(x: np.ndarray) -> np.ndarray:
    """A curved ridge; 0 at 1."""
    return -(100 * np.square(x[..., 1:] - np.square(x[..., :-1])) + np.square(1 - x[..., :-1])).sum(-1)


class Function(NamedTuple):
    """A test function, where it lives and what it reaches."""

    fn: Callable[[np.ndarray], np.ndarray]
    dimensions: int  # unless asked otherwise; fixed where `free` is false
    bounds: tuple[tuple[float, float], ...]  # one for all dimensions, or one each
    optimum: float
    free: bool = True  # whether it is there in any number of dimensions


FUNCTIONS = {
    "ackley": Function(ackley, 10, ((-32.768, 32.768),), 0.0),
    "branin": Function(branin, 2, ((-5.0, 10.0), (0.0, 15.0)), -0.39788735772973816, False),
    "hartmann6": Function(hartmann6, 6, ((0.0, 1.0),), 3.322368011415512, False),
    "rastrigin": Function(rastrigin, 10, ((-5.12, 5.12),), 0.0),
    "rosenbrock": Function(rosenbrock, 10, ((-5.0, 10.0),), 0.0),
}


def synthetic(
    name: str, *, dimensions: int | None = None, rows: int = 5000, shown: float = 60.0, noise: float = 0.0, seed: int = 0
) -> Problem:
    """Evenly drawn designs of a test function, of which the worse part is shown.

    Args:
        name: among `FUNCTIONS`.
        dimensions: None: the function's usual number.
        rows: designs in all.
        shown: percentile of the scores up to which designs are shown.
        noise: standard deviation of the errors of the shown scores; the oracle has none.
        seed: of designs and noise.
    """
    found = FUNCTIONS[name]
    size = found.dimensions if dimensions is None else dimensions
    if not found.free and size != found.dimensions:
        raise UserError(f"{name} has {found.dimensions} dimensions, got {size}")
    if size < (2 if name == "rosenbrock" else 1):
        raise UserError(f"{name} needs {2 if name == 'rosenbrock' else 1} or more dimensions, got {size}")
    bounds = found.bounds if len(found.bounds) > 1 else found.bounds * size
    variables = [Variable(f"x{i}", "continuous", low, high) for i, (low, high) in enumerate(bounds)]
    rng = np.random.default_rng([seed, 0])
    low, high = np.array(bounds, np.float32).T
    x = rng.uniform(low, high, (rows, size)).astype(np.float32)
    oracle = lambda x: found.fn(np.asarray(x, np.float64))  # noqa: E731
    y = oracle(x) + noise * rng.standard_normal(rows)
    about = f"exact; the greatest score is {found.optimum:.6g}"
    full = Designs(x, y, tuple(variables), name)
    return hidden(name, full, oracle, about, most=shown, optimum=found.optimum)


def nk(*, length: int = 8, letters: int = 4, neighbours: int = 2, shown: float = 50.0, seed: int = 0) -> Problem:
    """An NK landscape (Kauffman and Weinberger 1989): every design's score is known, the better part is hidden.

    A site's worth, drawn evenly from [0, 1], depends on its letter and those of the `neighbours` sites after it; a design's is
    the mean over its sites.

    Args:
        length: sites.
        letters: levels a site.
        neighbours: K, how rugged it is: 0 .. length - 1.
        shown: percentile of the scores up to which designs are shown.
        seed: of the landscape.
    """
    if not 0 <= neighbours < length:
        raise UserError(f"nk: neighbours must be 0 .. {length - 1}, got {neighbours}")
    if not 2 <= letters <= 26 or letters**length > 1_000_000:
        raise UserError(f"nk: {letters} letters at {length} sites: 2 to 26 letters and at most 1,000,000 designs are looked at")
    table = np.random.default_rng(seed).random((length, letters ** (neighbours + 1)))

    def oracle(x: np.ndarray) -> np.ndarray:
        x = np.asarray(x).astype(int)
        code = np.sum([np.roll(x, -i, 1) * letters**i for i in range(neighbours + 1)], 0)
        return np.take_along_axis(table.T, code, 0).mean(1)

    x = np.indices((letters,) * length).reshape(length, -1).T
    levels = tuple("ABCDEFGHIJKLMNOPQRSTUVWXYZ"[:letters])
    variables = tuple(Variable(f"site{i}", "categorical", levels=levels) for i in range(length))
    y = oracle(x)
    full = Designs(x, y, variables, "nk")
    return hidden("nk", full, oracle, f"exact; the greatest score is {y.max():.6g}", most=shown, optimum=float(y.max()))
