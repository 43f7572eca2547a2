"""Whether rewards arrive late: earlier rows tell them better than their own, on held-out episodes; or those of the latest
episodes are zero, as if they were not known yet."""

import math
from statistics import NormalDist

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box

LAGS = (1, 2, 3, 5, 10)  # rows by which a reward may be late
_DIMENSIONS = 30  # of the observation that are used
_LEVELS = 20  # discrete actions, or values of one observation, that get a number each
_PRODUCTS = 100  # of an observation and an action, beyond which they are left out: the fit takes time
_UNITS = 10  # held-out parts below which nothing is said
_LEAST = 5  # episodes at the end, below which nothing is said
_LONGER = 3  # times the longest series of zeros before, by which one at the end is more than that
_RIDGE = 1e-3  # of a row, so that columns that repeat one another do no harm


def late_reward(log: Dataset, level: float) -> str | None:
    """A line if some earlier row's observation and action tell the reward better than its own row's, or None.

    Ridge regression on the observation, its squares, the action and their products is fitted to half of the episodes; on the
    other half the squared errors of both are compared by episode, and so are those of the earlier row and of the mean. Both
    differences must be significant at `level`, divided by the number of lags. Few episodes are cut into parts of equal length.

    Args:
        log: some thousand rows.
        level: probability of a false line where no lag is better.
    """
    rewards = np.asarray(log.rewards, np.float64)
    within = np.arange(len(log)) - log.starts[log.episode_of]
    most = max((lag for lag in LAGS if (within >= lag).sum() >= 0.5 * len(log)), default=0)
    if most == 0 or rewards.std() == 0:
        return None
    rows = np.flatnonzero(within >= most)  # the same rows for all lags, so that errors compare
    units = log.episode_of[rows]
    if log.episodes < 2 * _UNITS:
        units = np.arange(len(rows)) * 4 * _UNITS // len(rows)
    units = np.unique(units, return_inverse=True)[1]
    learn = units % 2 == 0
    if len(np.unique(units[~learn])) < _UNITS:
        return None
    features = _features(log)
    if learn.sum() < 3 * features.shape[1]:
        return None
    target = rewards[rows]
    mean = (target - target[learn].mean()) ** 2
    lags = [lag for lag in LAGS if lag <= most]
    own, z = _errors(features[rows], target, learn), NormalDist().inv_cdf(1 - level / len(lags))
    best: tuple[float, int] | None = None
    for lag in lags:
        earlier = _errors(features[rows - lag], target, learn)
        better = [_significance((other - earlier)[~learn], units[~learn]) for other in (own, mean)]
        if min(better) > z and (best is None or earlier[~learn].mean() < best[0]):
            best = (float(earlier[~learn].mean()), lag)
    if best is None:
        return None
    variance = float(mean[~learn].mean())
    told = 1 - best[0] / variance, 1 - float(own[~learn].mean()) / variance
    steps = f"{best[1]} row" + ("s" if best[1] > 1 else "")
    text = f"the reward may arrive {steps} late: the observation and action {steps} earlier explain {told[0]:.0%} of it"
    return f"{text}, those of its own row {max(told[1], 0):.0%} (R² on held-out rows); if so, move the column of the reward up"


def rewards_to_come(log: Dataset, level: float) -> str | None:
    """A line if the returns of all episodes at the end of a log are zero, and before there was nothing like it, or None.

    A row whose reward is not known when the table is made often has 0 there, such as a purchase within thirty days. The number
    of episodes must have a probability of at most `level` by the share of zeros before, and be `_LONGER` times the longest
    series of zeros before, as returns of neighbouring episodes may be alike. Says nothing of tables in the order of the reward.

    Args:
        log: in the order of time.
        level: probability of a false line where episodes are independent of each other.
    """
    returns = log.returns(1.0)
    others = np.flatnonzero(returns != 0.0)
    count = len(returns) - 1 - others[-1] if len(others) else len(returns)
    before = returns[: len(returns) - count]
    if count < _LEAST or len(before) < count or (np.diff(before) >= 0).all() or (np.diff(before) <= 0).all():
        return None
    zero = before == 0.0
    chance = count * math.log((zero.sum() + 1) / (len(before) + 1))
    longest = int(np.diff(np.flatnonzero(~np.concatenate([[False], zero, [False]]))).max()) - 1
    if chance > math.log(level) or count <= _LONGER * longest:
        return None
    text = f"the latest {count:,} episodes have a return of 0, and {zero.mean():.0%} of the {len(before):,} before"
    return f"{text}: if their rewards are not known yet, leave these episodes out"


def _features(log: Dataset) -> np.ndarray:
    """(rows, size) a constant, the observation and its squares, the action, and the products of both."""
    flat = np.asarray(log.observations, np.float64).reshape(len(log), -1)
    flat = flat[:, flat.std(0) > 0][:, :_DIMENSIONS]
    values = np.unique(flat) if flat.shape[1] == 1 else np.zeros(0)
    if 1 < len(values) <= _LEVELS:  # a code, such as the number of a state
        flat = (flat == values).astype(np.float64)
    scaled = (flat - flat.mean(0)) / np.maximum(flat.std(0), 1e-12)
    acted = np.asarray(log.actions, np.float64).reshape(len(log), -1)
    if not isinstance(log.action_space, Box):
        taken = np.unique(acted)[:_LEVELS]
        acted = (acted == taken).astype(np.float64)
    acted = (acted - acted.mean(0)) / np.maximum(acted.std(0), 1e-12)
    acted = acted[:, :_DIMENSIONS]
    parts = [np.ones((len(log), 1)), scaled, np.clip(scaled, -5, 5) ** 2, acted]
    parts += [acted**2] if isinstance(log.action_space, Box) else []
    if scaled.shape[1] * acted.shape[1] <= _PRODUCTS:
        parts.append((scaled[:, :, None] * acted[:, None, :]).reshape(len(log), -1))
    return np.concatenate(parts, 1)


def _errors(features: np.ndarray, target: np.ndarray, learn: np.ndarray) -> np.ndarray:
    """(rows,) squared errors of the regression that was fitted to the rows `learn`."""
    x, y = features[learn], target[learn]
    weights = np.linalg.solve(x.T @ x + _RIDGE * len(x) * np.eye(x.shape[1]), x.T @ y)
    return (target - features @ weights) ** 2


def _significance(gain: np.ndarray, units: np.ndarray) -> float:
    """Mean of the parts' mean gains in standard errors."""
    parts, at = np.unique(units, return_inverse=True)
    means = np.bincount(at, gain) / np.bincount(at)
    error = float(means.std(ddof=1)) / math.sqrt(len(parts))
    return float(means.mean()) / error if error > 0 else 0.0
