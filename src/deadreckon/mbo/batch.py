"""Batches of proposals: all different, some distance apart, not in the data, and within all rules.

A method's own proposals are kept as they are where they satisfy that, in their order. What is missing is filled from designs
around them and around the best of the data, those that the method predicts the highest scores for first.
"""

from collections.abc import Callable

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nn_distance import distance_to_others, nearest_scored, nn_distance, usual_distance
from deadreckon.mbo.rules import written
from deadreckon.randomness import generator

Value = Callable[[np.ndarray], np.ndarray]  # (m, variables) designs -> (m,) what to make large
APART = 0.1  # least distance between proposals, in typical distances between neighbours of the data, where none is asked for
ROUNDS = 12  # of filling; that distance is halved in each from the third on, and none in the last four
TRIED = 4  # designs tried in a round for each that is missing
NEAREST, FURTHEST = 0.05, 1.0  # deviations of the first and the last round's designs from those that they are made of


def batch(
    data: Designs, x: np.ndarray, n: int, value: Value | None = None, *, repeat: bool = False, seed: int = 0
) -> np.ndarray:
    """Different designs, made of those of a method.

    Args:
        data: scored designs. None of them is proposed unless `repeat`, nor one of those without a score.
        x: (m, variables) of the method, in the order in which they are wanted.
        n: how many.
        value: by which missing ones are chosen; None: at random.
        repeat: whether designs of the data may be proposed, and those without a score.
        seed: of the designs that are tried.

    Returns:
        (n, variables) float32.

    Raises:
        UserError: there are not so many designs, or none was found.
    """
    rng = generator(seed, "filling a batch")
    apart, strict = least_distance(data), data.rules.apart is not None
    chosen = Chosen(data, repeat)
    usable = repaired(data, x)
    chosen.add(usable, n, apart)
    sources = np.concatenate([usable[:n], data.x[data.best(min(n, len(data)))]])
    for i in range(ROUNDS):
        missing = n - len(chosen.x)
        if missing <= 0:
            break
        reach = NEAREST * (FURTHEST / NEAREST) ** (i / (ROUNDS - 1))
        tried = sources[rng.integers(len(sources), size=max(TRIED * missing, 32))]
        tried = repaired(data, moved(data, tried, reach, rng))
        if value is not None and len(tried):
            tried = tried[np.argsort(-np.asarray(value(tried)), kind="stable")]
        eased = 0.0 if i >= ROUNDS - 4 else apart * 0.5 ** max(i - 1, 0)
        chosen.add(tried, n, apart if strict else eased)
    if len(chosen.x) < n:
        asked = ["differ", *([] if repeat else ["are not in the data (--repeat allows those)"])]
        asked += [f"lie {data.rules.apart:g} typical distances apart"] if strict else []
        said = " and ".join(filter(None, [", ".join(asked[:-1]), asked[-1]]))
        raise UserError(
            f"{data.name}: {n:,} proposals that {said} were asked for, and only {len(chosen.x):,} were found within the "
            f"bounds and constraints; ask for fewer, {'make --apart smaller, ' if strict else ''}or allow more"
        )
    return np.stack(chosen.x).astype(np.float32)


def least_distance(data: Designs) -> float:
    """Between proposals, by their places (`Coordinates.place`)."""
    return (APART if data.rules.apart is None else data.rules.apart) * usual_distance(data)


class Chosen:
    """Designs that were taken, one after the other."""

    def __init__(self, data: Designs, repeat: bool = False):
        self.data = data
        self.x: list[np.ndarray] = []
        self.z = data.coordinates.place(data.x[:0])
        self.known = taken(data, repeat)

    def add(self, x: np.ndarray, n: int, apart: float) -> None:
        """Takes those that are new and at least so far, by their places, from all that were taken, until there are n."""
        for row, key, z in zip(x, keys(self.data, x), self.data.coordinates.place(x)):
            if len(self.x) >= n:
                return
            if key in self.known or (len(self.z) and np.square(self.z - z).sum(1).min() < apart**2):
                continue
            self.known.add(key)
            self.x.append(row)
            self.z = np.concatenate([self.z, z[None]])


def taken(data: Designs, repeat: bool) -> set[bytes]:
    """Keys of the designs that are not proposed: those of the data, and those that were tried or planned and have no score."""
    old = data.x if data.unscored is None else np.concatenate([data.x, data.unscored])
    return set() if repeat else set(keys(data, old))


def keys(data: Designs, x: np.ndarray) -> list[bytes]:
    """What tells (rows, variables) designs apart: whole numbers, levels and steps as they are, other numbers to six digits.

    The seventh is no other experiment, but where it is the first that differs: of values between 1,000 and 1,001 it counts.
    """
    largest, spread = np.abs(data.x).max(0), np.ptp(data.x, axis=0)
    alike = np.floor(np.log10(np.where(spread > 0, largest / np.where(spread > 0, spread, 1.0), 1.0))).clip(0, 3)
    exact = [v.kind != "continuous" or v.step is not None for v in data.variables]
    digits = [9 if e else 6 + int(a) for e, a in zip(exact, alike)]  # nine are what 32 bits hold
    return [",".join(f"{value + 0.0:.{d}g}" for value, d in zip(row, digits)).encode() for row in x]


def repaired(data: Designs, x: np.ndarray) -> np.ndarray:
    """(rows, variables) those that satisfy all rules after the nearest such designs were looked for."""
    if not len(x):
        return np.asarray(x, np.float32)
    moved, good = data.repair.exact(np.asarray(x, np.float32))
    limit = data.rules.max_distance
    if limit is not None:
        moved, good = data.repair.exact(pulled(data, moved[good], limit))
        good &= nn_distance(data, moved) <= limit
    return moved[good]


def pulled(data: Designs, x: np.ndarray, limit: float) -> np.ndarray:
    """Designs that lie further from the data than the limit, moved towards the nearest scored one."""
    far, rows = nearest_scored(data, x)
    far = far / usual_distance(data)
    over = far > limit
    share = np.where(over, 0.98 * limit / np.maximum(far, 1e-12), 1.0)[:, None]
    view = data.coordinates
    z, near = view.encode(x).astype(np.float64), view.encode(data.x[rows]).astype(np.float64)
    return np.where(over[:, None], view.decode(near + share * (z - near)), x).astype(np.float32)


def moved(data: Designs, x: np.ndarray, reach: float, rng: np.random.Generator) -> np.ndarray:
    """Designs around these: a random part of the variables of each is changed, at least one.

    Numbers move by a normal deviate of `reach` ranges of the data, whole numbers, ordered levels and numbers in steps by one
    step or more, categories to any level.
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
    """Refuses proposals that break a rule, or that are the same or in the data; what `batch` made is none of that.

    Raises:
        UserError: with the proposal and the rule.
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
