"""Local search for designs of great value by random changes, among those that satisfy bounds and linear constraints."""

from collections.abc import Callable

import numpy as np

from deadreckon.mbo.batch import Value, least_distance, moved, pulled
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nn_distance import nn_distance

REACH = 0.5, 0.003  # size of the random changes in the first and the last round, in ranges of the data
NEAR, AFTER = 0.1, 12  # size of the first changes, and number of rounds, for designs that were found by gradient ascent


def improved(
    data: Designs,
    x: np.ndarray,
    value: Value,
    rounds: int,
    kept: int,
    rng: np.random.Generator,
    more: Callable[[np.ndarray], np.ndarray] | None = None,
    reach: tuple[float, float] = REACH,
) -> np.ndarray:
    """(kept, variables) or fewer different designs, those of the greatest values that were found, the greatest first.

    Args:
        data: scored designs, with the rules.
        x: (m, variables) initial designs.
        value: function to maximise.
        rounds: number of rounds of changes.
        kept: number of designs kept after each round, at a least distance, so that they do not all become the same one.
        rng: of the changes.
        more: function from (k, variables) designs to (k, variables) further ones to try, such as gradient steps; None: none.
        reach: size of the changes in the first and the last round, in ranges of the data.
    """
    x = moved_inside(data, x)
    worth, apart = value(x), least_distance(data)
    for i in range(rounds):
        order = spaced(data, x, worth, apart, kept)
        x, worth = x[order], worth[order]
        near = reach[0] * (reach[1] / reach[0]) ** (i / max(rounds - 1, 1))
        tried = [moved(data, x, near, rng), *([] if more is None else [more(x)])]
        new = np.unique(moved_inside(data, np.concatenate(tried)).astype(np.float32), axis=0)
        x, worth = np.concatenate([x, new]), np.concatenate([worth, value(new)])
        _, first = np.unique(x.astype(np.float32), axis=0, return_index=True)
        x, worth = x[first], worth[first]
    return x[spaced(data, x, worth, apart, kept)].astype(np.float32)


def on_grid(data: Designs, x: np.ndarray, value: Value, rng: np.random.Generator) -> np.ndarray:
    """Designs found by gradient ascent, improved by a local search if numbers in steps share a constraint; else unchanged.

    The design nearest to one that violates a sum is often not the best one nearby, and can have a much smaller value.
    """
    if not data.repair.tied_steps:
        return x
    return improved(data, x, value, AFTER, 4 * len(x), rng, reach=(NEAR, REACH[1]))


def spaced(data: Designs, x: np.ndarray, value: np.ndarray, apart: float, kept: int) -> np.ndarray:
    """(kept,) or fewer rows, the greatest values first, none of which is nearer than `apart` to an earlier one."""
    z = data.coordinates.place(x)
    free, order = np.ones(len(z), bool), []
    for i in np.argsort(-value, kind="stable"):
        if free[i]:
            order.append(i)
            if len(order) == kept:
                break
            free &= np.square(z - z[i]).sum(1) >= apart**2
    return np.array(order)


def moved_inside(data: Designs, x: np.ndarray) -> np.ndarray:
    """(rows, variables) designs moved into bounds, linear constraints and the largest distance to the data, up to rounding
    errors, without forbidden ones."""
    x, limit = data.repair.nearly(x), data.rules.max_distance
    if limit is not None:
        x = data.repair.nearly(pulled(data, x, limit))
        near = nn_distance(data, x) <= limit
        x = x[near] if near.any() else x
    good = data.repair.allowed(x)
    # If all are forbidden, the nearest ones that are not are computed one by one, for a few.
    return x[good] if good.any() else data.repair.exact(x[:8])[0].astype(np.float64)
