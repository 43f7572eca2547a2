"""Bounds of a mean that hold for any number of episodes, by betting (Waudby-Smith and Ramdas 2024).

Whoever thinks that the mean is m offers fair bets on X - m. A capital that starts at one and is multiplied by
1 + lambda_i (X_i - m) with each episode, lambda_i in [0, 1 / m) chosen before X_i is seen, is a nonnegative martingale if that
is true: it ever reaches 1 / alpha with a chance of at most alpha (Ville). The lower bound is the least m that is not refuted.
Nothing is asked of X but that it is not negative, that the episodes are independent or at least E[X_i | earlier ones] = mu,
and for what is bounded above also that bound.

That importance-weighted returns may be clipped, and that a lower bound of nonnegative ones needs no largest weight at all, is
in Karampatziakis, Mineiro and Ramdas 2021.

All functions take (..., n) samples, n in the order of the log, and bound the mean of each row.
"""

from typing import Literal

import numpy as np

from deadreckon.errors import UserError
from deadreckon.ope.intervals import ALPHA

Bets = Literal["mixture", "hedged"]

HALVINGS = 40  # of the interval that the bound is searched in
MOST = 0.5  # of the capital that a hedged bet risks: c of the paper
FRACTIONS = np.geomspace(1e-4, 0.98, 24)  # of the capital that the mixture's bets risk; fixed, or the bound would not hold


def lower(x: np.ndarray, alpha: float = ALPHA, *, most: float = np.inf, bets: Bets = "mixture") -> np.ndarray:
    """(...,) lower bounds of the means of (..., n) samples, each of which fails with a chance of at most `alpha`.

    `mixture` divides the capital evenly among bets of fixed fractions, lambda = c / m for c in `FRACTIONS`: a discrete form of
    Cover's portfolio. It needs no bound from above, does not depend on the order of the samples, and scales with them. It is
    the one for importance weights, whose largest value is far beyond their mean.

    `hedged` bets lambda_i = min(sqrt(2 log(1 / alpha) / (n s_{i-1}^2)), c / m) on x / most, where s_{i-1}^2 is the variance of
    the samples before, with a prior that counts as one sample: the one-sided part of the paper's hedged capital, tuned to n,
    with c = 1/2. It depends on the order and on `most`, and is the tighter one where x / most is spread over 0 .. 1.

    Args:
        x: (..., n) samples, not negative.
        alpha: chance that a bound fails.
        most: the largest value that a sample can have, known without looking at them; `mixture` does without.
        bets: how the capital is bet.

    Raises:
        UserError: samples that are negative or exceed `most`, or no `most` where one is needed.
    """
    x = _checked(x, alpha, most)
    if bets == "hedged":
        if not np.isfinite(most):
            raise UserError("hedged bets need the largest value that a sample can have; mixed ones do not")
        return most * _hedged(x / most, alpha)
    if bets != "mixture":
        raise UserError(f"bets are mixture or hedged, got {bets!r}")
    return _mixture(x, alpha)


def interval(
    x: np.ndarray, least: float, most: float, alpha: float = ALPHA, *, bets: Bets = "mixture"
) -> tuple[np.ndarray, np.ndarray]:
    """(...,) bounds from both sides, each failing with a chance of at most `alpha` / 2, for samples in [least, most].

    With hedged bets this is the paper's hedged capital interval with theta = 1/2: the larger half of a capital reaches
    1 / alpha where either, on its own, reaches 2 / alpha.
    """
    x = np.asarray(x, float)
    span = most - least
    if not (np.isfinite(span) and span > 0):
        raise UserError(f"an interval from both sides needs a finite range of the samples, got {least:g} .. {most:g}")
    return least + lower(x - least, alpha / 2, most=span, bets=bets), most - lower(most - x, alpha / 2, most=span, bets=bets)


def bernstein_lower(x: np.ndarray, most: float, alpha: float = ALPHA) -> np.ndarray:
    """(...,) lower bounds by the empirical Bernstein supermartingale with predictable bets, in closed form.

        (sum lambda_i x_i - log(1 / alpha) - sum 4 (x_i - m_{i-1})^2 psi(lambda_i)) / sum lambda_i

    with psi(l) = (-log(1 - l) - l) / 4, for x / most (Waudby-Smith and Ramdas 2024, theorem 2, tuned to a fixed n). Looser than
    bets, but without a search.

    Args:
        x: (..., n) samples in [0, most].
        most: their largest possible value, known without looking at them.
        alpha: chance that a bound fails.
    """
    x = _checked(x, alpha, most) / most
    mean, bet = _predicted(x, alpha)
    bet = np.minimum(bet, MOST)
    cost = np.square(x - mean) * (-np.log1p(-bet) - bet)
    return most * np.maximum(0.0, ((bet * x - cost).sum(-1) - np.log(1 / alpha)) / bet.sum(-1))


def weighted_lower(
    log_weights: np.ndarray, returns: np.ndarray, least: float, alpha: float = ALPHA, *, clip: float = np.inf
) -> np.ndarray:
    """(...,) lower bounds of E[w G], the value of a policy, from importance weights of whole episodes and their returns.

    X = min(w, clip) (G - least) is not negative and has at most the mean of w (G - least), which is that of w G less `least`
    because weights have mean one. So what bounds X from below bounds the value, whatever is clipped, and even without a largest
    weight. The weights must be true ratios: with learned propensities nothing is guaranteed.

    Args:
        log_weights: (..., n) of each episode; minus infinity is a weight of zero.
        returns: (n,) or (..., n).
        least: the smallest return that an episode can have, known without looking at them.
        alpha: chance that a bound fails.
        clip: largest weight, chosen without looking at these episodes.

    Raises:
        UserError: a return below `least`.
    """
    gain = np.asarray(returns, float) - least
    if (gain < 0).any():
        raise UserError(f"an episode returns {np.min(returns):g}, less than the least return of {least:g} that was given")
    with np.errstate(over="ignore"):
        return least + lower(np.minimum(np.exp(log_weights), clip) * gain, alpha)


def weighted_interval(
    log_weights: np.ndarray, returns: np.ndarray, least: float, most: float, alpha: float = ALPHA, *, clip: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """(...,) bounds from both sides, each failing with a chance of at most `alpha` / 2, for returns in [least, most].

    The upper one is a lower bound of what is missing to `most`: weights need no bound from above there either.
    """
    above = weighted_lower(log_weights, -np.asarray(returns, float), -most, alpha / 2, clip=clip)
    return weighted_lower(log_weights, returns, least, alpha / 2, clip=clip), -above


def log_capital(x: np.ndarray, mean: np.ndarray, fractions: np.ndarray = FRACTIONS) -> np.ndarray:
    """(...,) log of the mixture's capital after all of (..., n) samples, against means (...,) above zero."""
    scaled = x / np.asarray(mean)[..., None] - 1.0
    logs, room = np.empty((len(fractions), *scaled.shape[:-1])), np.empty_like(scaled)
    for i, c in enumerate(fractions):  # in one piece of memory: this is what the search spends its time on
        logs[i] = np.log1p(np.multiply(scaled, c, out=room), out=room).sum(-1)
    return np.logaddexp.reduce(logs, axis=0) - np.log(len(fractions))


def _mixture(x: np.ndarray, alpha: float) -> np.ndarray:
    # At the samples' own mean no bet has gained (log is concave), and towards zero all grow: the bound lies between.
    high = x.mean(-1)
    refuted = lambda mean: log_capital(x, np.maximum(mean, np.finfo(float).tiny)) >= np.log(1 / alpha)  # noqa: E731
    return _search(refuted, high)


def _hedged(x: np.ndarray, alpha: float) -> np.ndarray:
    _, bet = _predicted(x, alpha)

    def refuted(mean: np.ndarray) -> np.ndarray:
        mean = np.maximum(mean, np.finfo(float).tiny)[..., None]
        capital = np.cumsum(np.log1p(np.minimum(bet, MOST / mean) * (x - mean)), -1)
        return capital.max(-1) >= np.log(1 / alpha)  # once refuted, always

    return _search(refuted, np.ones(x.shape[:-1]))


def _predicted(x: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """(..., n) means of what came before each sample, and the bets that they suggest; x within [0, 1]."""
    n = x.shape[-1]
    count = np.arange(1, n + 1)
    mean = (0.5 + np.cumsum(x, -1)) / (count + 1)
    var = (0.25 + np.cumsum(np.square(x - mean), -1)) / (count + 1)
    shifted = lambda past, prior: np.concatenate([np.full((*x.shape[:-1], 1), prior), past[..., :-1]], -1)  # noqa: E731
    return shifted(mean, 0.5), np.sqrt(2 * np.log(1 / alpha) / (n * shifted(var, 0.25)))


def _search(refuted, high: np.ndarray) -> np.ndarray:
    """The least mean that is not refuted, where all below are: always from the refuted side, so that rounding is safe."""
    low, high = np.zeros_like(high), np.array(high, float)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        out = refuted(middle)
        low, high = np.where(out, middle, low), np.where(out, high, middle)
    return low[()]


def _checked(x: np.ndarray, alpha: float, most: float) -> np.ndarray:
    x = np.asarray(x, float)
    if not 0 < alpha < 1:
        raise UserError(f"alpha must be between 0 and 1, got {alpha:g}")
    if not x.shape[-1]:
        raise UserError("no samples, of which nothing can be said")
    if not (np.isfinite(x).all() and (x >= 0).all()):
        raise UserError("bounds by betting need finite samples that are not negative")
    if x.max() > most:
        raise UserError(f"a sample is {x.max():.4g}, more than the largest possible value of {most:.4g} that was given")
    return x
