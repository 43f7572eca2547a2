"""Batches of proposals: all different, some distance apart and from the data, and within all rules.

A method's designs are moved to the nearest ones that satisfy all rules, and are then taken in their order. The batch is
completed with random variations of these designs and of the best designs of the data, those with the highest predictions first.
"""

from collections.abc import Callable

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nn_distance import (
    distance_to_others,
    distance_to_tried,
    nearest_scored,
    nn_distance,
    tried,
)
from deadreckon.mbo.rules import written
from deadreckon.randomness import generator

Value = Callable[[np.ndarray], np.ndarray]  # (m, variables) designs -> (m,) values to maximise
# Default of the least distance of proposals from each other and from the data, in typical distances between neighbours of the
# data. It is the same for both, because a design near a measured row or near another proposal would repeat that experiment; and
# it is small compared with distances over which scores change, so that it hardly costs any score.
APART = 0.1
ROUNDS = 12  # rounds of completion; the least distances are halved in each from the third on, and are 0 in the last four
TRIED = 4  # designs tried in a round for each that is missing
# Share of the largest distance to the data to which designs are moved, so that rounding keeps most of them within it. Whole
# numbers and levels in order may be rounded beyond it; `repaired` leaves such designs out.
WITHIN = 0.98
NEAREST, FURTHEST = 0.05, 1.0  # size of the random changes in the first and the last round, in ranges of the data


def batch(
    data: Designs, x: np.ndarray, n: int, value: Value | None = None, *, repeat: bool = False, seed: int = 0
) -> np.ndarray:
    """A batch of n different designs: those of a method, completed with random variations.

    Args:
        data: scored designs. Unless `repeat`, none of these and of those without a score is proposed, nor, if there are enough
            others, any design that is nearly the same as one of them.
        x: (m, variables) designs of the method, in order of preference.
        n: size of the batch.
        value: function that ranks the variations, the greatest values first; None: they are chosen at random.
        repeat: whether designs of the data may be proposed, including those without a score.
        seed: random seed of the variations.

    Returns:
        (n, variables) float32.

    Raises:
        UserError: fewer than n such designs were found.
    """
    rng = generator(seed, "filling a batch")
    apart, strict = least_distance(data), data.rules.apart is not None
    away = 0.0 if repeat else least_from_data(data)
    chosen = Chosen(data, repeat)
    usable = repaired(data, x)
    chosen.add(usable, n, apart, away)
    found, sources = [usable], np.concatenate([usable[:n], data.x[data.best(min(n, len(data)))]])
    for i in range(ROUNDS):
        missing = n - len(chosen.x)
        if missing <= 0:
            break
        reach = NEAREST * (FURTHEST / NEAREST) ** (i / (ROUNDS - 1))
        around = sources[rng.integers(len(sources), size=max(TRIED * missing, 32))]
        around = repaired(data, moved(data, around, reach, rng))
        if value is not None and len(around):
            around = around[np.argsort(-np.asarray(value(around)), kind="stable")]
        found.append(around)
        eased = 0.0 if i >= ROUNDS - 4 else 0.5 ** max(i - 1, 0)
        chosen.add(around, n, apart if strict else apart * eased, away * eased)
    chosen.add(np.concatenate(found), n, apart if strict else 0.0)  # those that were too near, if there are no others
    if len(chosen.x) < n:
        asked = ["differ", *([] if repeat else ["are not in the data (--repeat allows those)"])]
        asked += [f"lie {data.rules.apart:g} typical distances apart"] if strict else []
        said = " and ".join(filter(None, [", ".join(asked[:-1]), asked[-1]]))
        near = data.rules.max_distance is not None
        limits = "bounds, constraints and largest distance to the data" if near else "bounds and constraints"
        remedies = f"{'make --apart smaller, ' if strict else ''}{'make --max-distance larger, ' if near else ''}"
        raise UserError(
            f"{data.name}: {n:,} proposals that {said} were asked for, and only {len(chosen.x):,} were found within the "
            f"{limits}; ask for fewer, {remedies}or allow more"
        )
    return np.stack(chosen.x).astype(np.float32)


def least_distance(data: Designs) -> float:
    """Least distance between proposals, in the space of `Coordinates.place`."""
    return (APART if data.rules.apart is None else data.rules.apart) * data.usual_distance


def least_from_data(data: Designs) -> float:
    """Least distance of proposals from designs of the table, in the same space; not above one that is given for proposals."""
    return min(APART, data.rules.apart or APART) * data.usual_distance


def nearly_tried(data: Designs, x: np.ndarray) -> np.ndarray:
    """(m,) bool: which designs are nearer to one of the table than `least_from_data`."""
    return distance_to_tried(data, x) < least_from_data(data) * (1 - 1e-9)


def untried(data: Designs, x: np.ndarray, n: int) -> np.ndarray:
    """Those of (m, variables) designs that are not nearly in the table (`nearly_tried`), if there are `n`; else all."""
    new = ~nearly_tried(data, x)
    return x[new] if new.sum() >= n else x


def repeats_told(data: Designs, x: np.ndarray) -> list[str]:
    """A message on proposals that are nearly, but not exactly, designs of the table; exact repeats were requested."""
    count = int((nearly_tried(data, x) & (distance_to_tried(data, x) > 0)).sum())
    if not count:
        return []
    return [
        f"{count:,} of {len(x):,} proposals nearly {'repeats' if count == 1 else 'repeat'} a design of the table (less than "
        f"{least_from_data(data) / data.usual_distance:g} typical distances away): there are too few others, or repeats were "
        "allowed"
    ]


class Chosen:
    """The designs of a batch that have been chosen so far."""

    def __init__(self, data: Designs, repeat: bool = False):
        self.data = data
        self.x: list[np.ndarray] = []
        self.z = data.coordinates.place(data.x[:0])
        self.known = taken(data, repeat)

    def add(self, x: np.ndarray, n: int, apart: float, away: float = 0.0) -> None:
        """Adds designs (m, variables) that are new, at least `apart` from all chosen ones, and at least `away` from those of
        the table (`Coordinates.place`), until there are n."""
        x = x[distance_to_tried(self.data, x) >= away] if away and len(x) else x
        for row, key, z in zip(x, keys(self.data, x), self.data.coordinates.place(x)):
            if len(self.x) >= n:
                return
            if key in self.known or (len(self.z) and np.square(self.z - z).sum(1).min() < apart**2):
                continue
            self.known.add(key)
            self.x.append(row)
            self.z = np.concatenate([self.z, z[None]])


def taken(data: Designs, repeat: bool) -> set[bytes]:
    """Keys of the designs that are not proposed: those of the table, scored or not; none if `repeat`."""
    return set() if repeat else set(keys(data, tried(data)))


def keys(data: Designs, x: np.ndarray) -> list[bytes]:
    """Keys of (rows, variables) designs; designs with equal keys count as the same experiment.

    Whole numbers, levels and numbers in steps are exact. Others have six significant digits, and up to three more if the range
    of the data is small compared with its values: between 1,000 and 1,001 the seventh digit matters.
    """
    largest, spread = np.abs(data.x).max(0), np.ptp(data.x, axis=0)
    alike = np.floor(np.log10(np.where(spread > 0, largest / np.where(spread > 0, spread, 1.0), 1.0))).clip(0, 3)
    exact = [v.kind != "continuous" or v.step is not None for v in data.variables]
    digits = [9 if e else 6 + int(a) for e, a in zip(exact, alike)]  # nine significant digits identify a float32
    return [",".join(f"{value + 0.0:.{d}g}" for value, d in zip(row, digits)).encode() for row in x]


def repaired(data: Designs, x: np.ndarray) -> np.ndarray:
    """(rows, variables) designs, moved to the nearest ones that satisfy all rules; those without such a one are left out."""
    if not len(x):
        return np.asarray(x, np.float32)
    moved, good = data.repair.exact(np.asarray(x, np.float32))
    limit = data.rules.max_distance
    if limit is not None:
        moved, good = data.repair.exact(pulled(data, moved[good], limit))
        good &= nn_distance(data, moved) <= limit
    return moved[good]


def pulled(data: Designs, x: np.ndarray, limit: float) -> np.ndarray:
    """(rows, variables) designs; those more than `limit` typical distances from the data are moved towards the nearest row.

    Fixed variables keep their values. So rows that are too far by these alone do not count, and if all are, no design is moved.
    Categories become those of the row only where they alone, beside the fixed variables, are too far from it.
    """
    x, view, usual = np.array(x, np.float32), data.coordinates, data.usual_distance
    fixed = [column for column, _ in data.rules.fixed]
    held = data.x.copy()
    held[:, fixed] = [value for _, value in data.rules.fixed]
    room = np.square(WITHIN * limit * usual) - _squares(data, held, data.x).sum(1)
    if (room < 0).all():
        return x
    far, near = nearest_scored(data, x, np.flatnonzero(room >= 0))
    over = far > limit * usual
    here, row, room = x[over], data.x[near[over]], room[near[over]]
    squares, open_ = _squares(data, here, row), np.isin(np.arange(x.shape[1]), fixed, invert=True)
    levels = open_ & [v.kind == "categorical" for v in data.variables]
    kept = squares[:, levels].sum(1) <= room
    room = room - np.where(kept, squares[:, levels].sum(1), 0.0)
    share = np.sqrt(room / np.maximum(squares[:, open_ & ~levels].sum(1), 1e-12)).clip(0.0, 1.0)[:, None]
    z, to = (view.encode(each).astype(np.float64) for each in (here, row))
    found = view.decode(to + share * (z - to))
    found[:, levels] = np.where(kept[:, None], here[:, levels], row[:, levels])
    found[:, fixed] = here[:, fixed]
    x[over] = found
    return x


def _squares(data: Designs, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(rows, variables) squared distances of designs by single variables, whose sum is that of `Coordinates.place`."""
    view = data.coordinates
    out = 2.0 * (a != b)
    z, to = (view.encode(each)[:, : len(view.numeric)].astype(np.float64) for each in (a, b))
    out[:, view.numeric] = np.square(z - to)
    return out


def moved(data: Designs, x: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
    """Random variations of (rows, variables) designs: in each a random subset of the variables is changed, at least one.

    Numbers change by a normal deviate with a standard deviation of `reach` ranges of the data (of its logarithms on a log
    scale); whole numbers, ordered levels and numbers in steps by at least one step. Categories change to a random level.
    """
    x = np.array(x, np.float64)
    fixed = [column for column, _ in data.rules.fixed]
    open_ = np.array([i not in fixed for i in range(x.shape[1])])
    if not open_.any():
        return x
    share = max(0.5 * min(1.0, 8 * reach), 1.0 / open_.sum())
    changed = (rng.random(x.shape) < share) & open_
    changed[np.arange(len(x)), rng.choice(np.flatnonzero(open_), len(x))] = True
    for i, v in enumerate(data.variables):
        rows = changed[:, i]
        count = int(rows.sum())
        if v.kind == "categorical":
            x[rows, i] = rng.integers(len(v.levels), size=count)
            continue
        seen = data.x[:, i]
        if v.log:
            away = reach * np.log(seen.max() / seen.min()) * rng.standard_normal(count)
            away = x[rows, i] * np.expm1(away)
        else:
            away = reach * float(np.ptp(seen)) * rng.standard_normal(count)
        if (step := v.step or (1 if v.kind != "continuous" else None)) is not None:
            away = float(step) * np.where(away < 0, -1, 1) * np.maximum(np.round(np.abs(away) / float(step)), 1)
        x[rows, i] = (x[rows, i] + away).clip(v.low, v.high)
    return x


def check_batch(data: Designs, x: np.ndarray, repeat: bool) -> None:
    """Refuses proposals that violate a rule, coincide, or are in the data; a safeguard, as `batch` makes none of these.

    Raises:
        UserError: one line with the proposal and the rule.
    """
    for i, row in enumerate(written(data.variables, x)):
        if (rule := data.rules.broken(data.variables, row)) is not None:
            raise UserError(f"{data.name}: proposal {i} breaks {rule}")
    made = keys(data, x)
    if len(set(made)) < len(made) or not taken(data, repeat).isdisjoint(made):
        raise UserError(f"{data.name}: a proposal is there twice, or is in the data")
    apart = data.rules.apart
    if apart is not None and len(x) > 1 and distance_to_others(data, x).min() < apart * (1 - 1e-9):
        raise UserError(f"{data.name}: two proposals lie less than {apart:g} typical distances apart")
