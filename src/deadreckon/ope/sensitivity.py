"""The possible effect of unmeasured confounding on an estimate: the marginal sensitivity model (Tan 2006).

The behaviour policy may have used variables that are not in the log. The model lets the true odds of each logged action differ
from the nominal ones by a factor between 1 / Gamma and Gamma. With beta the action's nominal probability and w = pi / beta its
weight, the true weight then lies in

    [w (beta + (1 - beta) / Gamma), w (beta + (1 - beta) Gamma)],

and the self-normalised estimate between its least and its largest value over that box (Zhao, Small and Bhattacharya 2019).
That is a fractional linear program, whose solution takes one end of the box for all outcomes above a threshold and the other
below, so sorting solves it. For densities there are no odds; there the weight itself is off by up to Gamma, which is the limit
of beta = 0. For sequences a whole episode's weight lies in the product of its steps' boxes (Kallus and Zhou 2020 treat the
stationary case, which is not this one).

These bounds are sharp for the box. True weights also have mean one in every state, which would tighten the bounds (Dorn and Guo
2023), but is not used beyond the normalisation.
"""

from collections.abc import Callable

import numpy as np

from deadreckon.errors import UserError

MOST = 100.0  # factor of odds up to which the tipping point is searched
DIGITS = 2  # after the point, to which it is rounded down


def check_gamma(gamma: float) -> None:
    """Refuses invalid ratios of odds.

    Raises:
        UserError: a Gamma below one, or an infinite one.
    """
    if not 1.0 <= gamma < np.inf:
        raise UserError(f"Gamma, a ratio of odds, must be 1 or more, got {gamma:g}")


def weight_box(
    log_ratios: np.ndarray, gamma: float, log_behavior: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(rows,) logarithms of the least and the largest weight that each logged action may have.

    Sums of them over an episode are the box of the episode's weight.

    Args:
        log_ratios: (rows,) log pi(a|s) / beta(a|s) of the logged actions.
        gamma: Gamma, the factor by which odds may be off; 1 is no confounding.
        log_behavior: (rows,) log beta(a|s), for discrete actions; None for densities.

    Raises:
        UserError: a Gamma below one, or probabilities above one.
    """
    check_gamma(gamma)
    beta = np.zeros_like(log_ratios) if log_behavior is None else np.exp(log_behavior)
    if (beta > 1 + 1e-6).any():
        raise UserError(f"{beta.max():.4g} is no probability of an action; densities are not for odds, leave them out")
    beta = np.minimum(beta, 1.0)
    return log_ratios + np.log(beta + (1 - beta) / gamma), log_ratios + np.log(beta + (1 - beta) * gamma)


def bounds(
    outcomes: np.ndarray, log_low: np.ndarray, log_high: np.ndarray, baseline: np.ndarray | float = 0.0
) -> tuple[float, float]:
    """Least and largest of mean(baseline) + sum w y / sum w over weights within the box.

    With returns as outcomes these are the bounds of a value, and with a baseline of minus the logged return of each episode,
    which confounding does not affect, those of the gain over the log. With the errors r - Q(s, a) as outcomes and V(s) as
    baseline they are doubly robust: only the residual of the critic is uncertain. They are valid for any critic, because with
    true weights the mean of Q(s, a) is that of V(s).

    Args:
        outcomes: (episodes,) y, in units of the return.
        log_low: (episodes,) logarithms of the least weights; minus infinity is a weight of zero.
        log_high: (episodes,) those of the largest.
        baseline: (episodes,), or one number for all.

    Raises:
        UserError: no episode with a weight.
    """
    top = np.max(log_high, initial=-np.inf)
    if not np.isfinite(top):
        raise UserError("no episode has a weight: each has an action that the policy never takes")
    order = np.argsort(np.asarray(outcomes, float), kind="stable")
    y, low, high = np.asarray(outcomes, float)[order], np.exp(log_low - top)[order], np.exp(log_high - top)[order]
    begin = float(np.mean(baseline))
    return begin + float(_ratios(y, low, high).min()), begin + float(_ratios(y, high, low).max())


def _ratios(y: np.ndarray, below: np.ndarray, above: np.ndarray) -> np.ndarray:
    """The ratios of all thresholds in ascending y that leave some weight: weights are `above` up to it and `below` beyond.

    The least ratio has the large weights at the small outcomes, so `above` is then the upper end of the box, and inversely.
    """
    numerator, denominator = _steps(below * y, above * y), _steps(below, above)
    some = denominator > 0
    return numerator[some] / denominator[some]


def _steps(beyond: np.ndarray, until: np.ndarray) -> np.ndarray:
    """(episodes + 1,) sums of `until` up to each threshold and of `beyond` after it."""
    after = np.append(np.cumsum(beyond[::-1])[::-1], 0.0)  # not by differences, which would lose digits
    return after + np.append(0.0, np.cumsum(until))


def tipping(lower: Callable[[float], float]) -> float:
    """The largest Gamma at which `lower(Gamma)`, a lower bound of a gain that falls with it, stays above zero.

    Args:
        lower: function of Gamma, for Gamma of one or more.

    Returns:
        Gamma, rounded down to `DIGITS`; NaN where the gain is not above zero even at 1; infinity where it is still above zero
        at `MOST`.
    """
    if not lower(1.0) > 0:
        return float("nan")
    if lower(MOST) > 0:
        return float("inf")
    holds, fails = 1.0, MOST
    while fails - holds > 10.0**-DIGITS / 2:
        middle = float(np.sqrt(holds * fails))
        if lower(middle) > 0:
            holds = middle
        else:
            fails = middle
    return float(np.floor(holds * 10**DIGITS) / 10**DIGITS)
