"""How often a table of experiments is said to have changed along its rows: where it did, and where it did not.

    python -m benchmarks.design_order [TABLES]

Of tables of 40, 80 and 200 rows, at a signal-to-noise ratio (of standard deviations) of two unless said otherwise: one input
that rises along the table and three at random, with a score that rises, too ("drift"), that is noise, or that follows the
input; the drift with a quarter of the rows at one centre, and with a catalyst that takes the place of another; fifty inputs of
which the score follows a wave of one that rises; noise rounded to five values, in its order; Hartmann's function of six inputs
at random, in the order of one input, and in a search that stays near the best row so far; and Branin's function on a grid, row
by row, with noise and without. Printed are the shares of tables with a message.
"""

import sys
import warnings
from collections.abc import Callable

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.over_time import about_order
from deadreckon.mbo.problems.synthetic import branin, hartmann6
from deadreckon.mbo.variables import Variable

RATIO = 2.0


def noisy(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Scores with noise."""
    return y + y.std() / RATIO * rng.standard_normal(len(y))


def rising(rng: np.random.Generator, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Four inputs of which the first rises along the table, and the time of each row."""
    time = (np.arange(rows) + 0.5) / rows
    x = rng.random((rows, 4))
    x[:, 0] = np.clip(0.1 + 0.8 * time + 0.15 * rng.standard_normal(rows), 0.0, 1.0)
    return x, time


def searched(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Rows near the best one so far, or one in five at random."""
    x = [rng.random(6) for _ in range(5)]
    for i in range(5, rows):
        scores = hartmann6(np.array(x))
        best = x[int(np.argmax(scores + 0.1 * rng.standard_normal(len(scores))))]
        near = np.clip(best + 0.2 * (1 - 0.5 * i / rows) * rng.standard_normal(6), 0.0, 1.0)
        x.append(near if rng.random() < 0.8 else rng.random(6))
    return np.array(x)


def grid(rows: int) -> np.ndarray:
    """A square grid of about as many rows."""
    axis = np.linspace(0.0, 1.0, int(np.ceil(np.sqrt(rows))))
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)


def _noise(rng, rows):
    x, _ = rising(rng, rows)
    return x, rng.standard_normal(rows)


def _drift(rng, rows):
    x, time = rising(rng, rows)
    return x, noisy(time, rng)


def _effect(rng, rows):
    x, _ = rising(rng, rows)
    return x, noisy(x[:, 0], rng)


def _random(rng, rows):
    x = rng.random((rows, 6))
    return x, noisy(hartmann6(x), rng)


def _ordered(rng, rows):
    x = rng.random((rows, 6))
    x = x[np.argsort(x[:, 0])]
    return x, noisy(hartmann6(x), rng)


def _searched(rng, rows):
    x = searched(rng, rows)
    return x, noisy(hartmann6(x), rng)


def _grid(rng, rows):
    x = grid(rows)
    return x, noisy(branin(15 * x - np.array([5, 0])), rng)


def _exact(rng, rows):
    x = grid(rows)
    return x, branin(15 * x - np.array([5, 0]))


def _centred(rng, rows):
    x, y = _drift(rng, rows)
    x[::4] = 0.5
    return x, y


def _catalyst(rng, rows):
    x, time = rising(rng, rows)
    x[:, 0] = rng.random(rows) < time
    return x, noisy(time, rng)


def _wide(rng, rows):
    x = np.column_stack([rising(rng, rows)[0][:, 0], rng.random((rows, 49))])
    return x, noisy(np.cos(2 * np.pi * x[:, 0]), rng)


def _by_score(rng, rows):
    x, _ = rising(rng, rows)
    return x, np.sort(np.round(rng.standard_normal(rows)))


TABLES: dict[str, Callable[[np.random.Generator, int], tuple[np.ndarray, np.ndarray]]] = {
    "drift": _drift,
    "drift, with a centre": _centred,
    "drift, another catalyst": _catalyst,
    "noise": _noise,
    "effect": _effect,
    "fifty inputs": _wide,
    "in the order of rounded scores": _by_score,
    "at random": _random,
    "in the order of an input": _ordered,
    "a search": _searched,
    "a grid": _grid,
    "a grid, no noise": _exact,
}


def told(name: str, seed: int, rows: int) -> bool:
    """Whether one table gives a message."""
    x, y = TABLES[name](np.random.default_rng([seed, rows]), rows)
    variables = [Variable(f"x{i}", low=0.0, high=1.0) for i in range(x.shape[1])]
    if "catalyst" in name:
        variables[0] = Variable("x0", kind="categorical", levels=("A", "B"))
    return bool(about_order(Designs(x, y, tuple(variables))))


def main(tables: int) -> None:
    """Prints a line a kind of table."""
    for name in TABLES:
        shares = [np.mean([told(name, seed, rows) for seed in range(tables)]) for rows in (40, 80, 200)]
        print(f"{name}: " + ", ".join(f"{share:.1%}" for share in shares), flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
