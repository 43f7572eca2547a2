"""Bounds of a mean that hold for any number of episodes, by betting (Waudby-Smith and Ramdas 2024).

If the mean is m, bets on X - m are fair. A capital that starts at one and is multiplied by 1 + lambda_i (X_i - m) with each
episode, lambda_i in [0, 1 / m) chosen before X_i is observed, is then a nonnegative martingale: it ever reaches 1 / alpha with
a probability of at most alpha (Ville). The lower bound is the least m that is not rejected. The only assumptions are that X is
not negative, and that episodes are independent or at least E[X_i | earlier ones] = mu. That a lower bound of nonnegative
importance-weighted returns needs no largest weight is in Karampatziakis, Mineiro and Ramdas 2021.
"""

import numpy as np

from deadreckon.errors import UserError
from deadreckon.stats.interval import ALPHA

HALVINGS = 40  # bisections of the interval in which the bound is searched
FRACTIONS = np.geomspace(1e-4, 0.98, 24)  # shares of the capital that the mixture's bets stake; must be fixed in advance


def lower(x: np.ndarray, alpha: float = ALPHA) -> np.ndarray:
    """(...,) lower bounds of the means of (..., n) samples, each of which fails with a probability of at most `alpha`.

    The capital is divided evenly among bets of fixed fractions, lambda = c / m for c in `FRACTIONS`: a discrete form of Cover's
    portfolio. It needs no bound from above, does not depend on the order of the samples, and scales with them, as importance
    weights need, whose largest value is far beyond their mean.

    Args:
        x: (..., n) samples, not negative.
        alpha: probability that a bound fails.

    Raises:
        UserError: no samples, or some that are negative or not finite.
    """
    x = np.asarray(x, float)
    if not 0 < alpha < 1:
        raise UserError(f"alpha must be between 0 and 1, got {alpha:g}")
    if not x.shape[-1]:
        raise UserError("no samples, of which nothing can be said")
    if not (np.isfinite(x).all() and (x >= 0).all()):
        raise UserError("bounds by betting need finite samples that are not negative")
    # At the mean of the samples no bet has gained (log is concave), and towards zero all grow: the bound lies between.
    refuted = lambda mean: log_capital(x, np.maximum(mean, np.finfo(float).tiny)) >= np.log(1 / alpha)  # noqa: E731
    return _search(refuted, x.mean(-1))


def log_capital(x: np.ndarray, mean: np.ndarray, fractions: np.ndarray = FRACTIONS) -> np.ndarray:
    """(...,) log of the mixture's capital after all of (..., n) samples, against means (...,) above zero."""
    scaled = x / np.asarray(mean)[..., None] - 1.0
    logs, room = np.empty((len(fractions), *scaled.shape[:-1])), np.empty_like(scaled)
    for i, c in enumerate(fractions):  # in place: the search spends most of its time here
        logs[i] = np.log1p(np.multiply(scaled, c, out=room), out=room).sum(-1)
    return np.logaddexp.reduce(logs, axis=0) - np.log(len(fractions))


def _search(refuted, high: np.ndarray) -> np.ndarray:
    """The least mean that is not rejected, by bisection up to `high`; from the rejected side, so that rounding is safe."""
    low, high = np.zeros_like(high), np.array(high, float)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        out = refuted(middle)
        low, high = np.where(out, middle, low), np.where(out, high, middle)
    return low[()]
