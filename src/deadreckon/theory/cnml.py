"""Conditional normalised maximum likelihood over enumerable model classes, exactly (thesis 6.2 and 6.4).

A class is an array `likelihoods` (models, labels): each model's distribution of the label at one query point; `evidence`
(models,) is each model's log-likelihood of the data.
"""

import numpy as np
from jaxtyping import Float


def experts(likelihoods: Float[np.ndarray, "m y"], evidence: Float[np.ndarray, "m"]) -> Float[np.ndarray, "y y"]:
    """Row y*: the distribution of the model that is most likely on the data with (x, y*) appended; ties go to the first."""
    with np.errstate(divide="ignore"):
        total = evidence[:, None] + np.log(likelihoods)
    return likelihoods[total.argmax(0)]


def p_nml(likelihoods: Float[np.ndarray, "m y"], evidence: Float[np.ndarray, "m"]) -> Float[np.ndarray, "y"]:
    """Each label's probability under its own expert, normalised (6.2)."""
    own = np.diagonal(experts(likelihoods, evidence))
    return own / own.sum()


def individual_regret(q: Float[np.ndarray, "y"], likelihoods: np.ndarray, evidence: np.ndarray) -> Float[np.ndarray, "y"]:
    """log p(y | expert of y) - log q(y), for each label; p_NML makes its greatest value least, and all alike."""
    return np.log(np.diagonal(experts(likelihoods, evidence))) - np.log(q)


def minimax_regret(likelihoods: np.ndarray, evidence: np.ndarray) -> float:
    """Gamma = log sum_y p(y | expert of y)."""
    return float(np.log(np.diagonal(experts(likelihoods, evidence)).sum()))


def functional_regret(
    q: Float[np.ndarray, "y"], likelihoods: np.ndarray, evidence: np.ndarray, g: Float[np.ndarray, "y"]
) -> Float[np.ndarray, "y"]:
    """|E_q[g] - E[g] under the expert of y*|, for each y* (Definition 6.4.1)."""
    return np.abs(q @ g - experts(likelihoods, evidence) @ g)


def printed_bound(likelihoods: np.ndarray, evidence: np.ndarray, g: np.ndarray) -> float:
    """2 g_max sqrt(Gamma / 2), Theorem 6.4.1 as printed. It does not hold: see `bound`."""
    return float(2.0 * g.max() * np.sqrt(max(minimax_regret(likelihoods, evidence), 0.0) / 2.0))


def bound(likelihoods: np.ndarray, evidence: np.ndarray, g: np.ndarray) -> float:
    """(g_max - g_min) sqrt(D / 2) with D = max over y, y* of log p(y | expert of y*) - log p_NML(y), which is Gamma or more.

    The proof as printed takes p(y | expert of y) for an upper bound of p(y | expert of y*), which maximum likelihood on data
    *and* label does not give. With D, Pinsker's inequality and |E_p[g] - E_q[g]| <= (g_max - g_min) TV(p, q) suffice.
    """
    known = experts(likelihoods, evidence)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.where(known > 0.0, np.log(known) - np.log(p_nml(likelihoods, evidence)), -np.inf)
    return float((g.max() - g.min()) * np.sqrt(max(gap.max(), 0.0) / 2.0))  # rounding aside, D >= Gamma >= 0
