"""Conditional normalised maximum likelihood over enumerable model classes, exactly (thesis 6.2 and 6.4).

A class is an array `likelihoods` (m, y): each model's distribution of the label at one query point; `evidence` (m,) is each
model's log-likelihood of the data. All else follows from its experts, `known` (..., y, y): row y* is the distribution of the
model that is most likely on the data with (x, y*) appended.

Theorem 6.4.1 as printed, 2 g_max sqrt(Γ / 2), does not hold: its proof takes p(y | expert of y) for an upper bound of
p(y | expert of y*), which maximum likelihood on data *and* label does not give, and g_max for the range of g. With
D = max over y, y* of log p(y | expert of y*) - log p_NML(y), which is Γ or more, |E_p g - E_q g| <= (g_max - g_min) TV(p, q)
and Pinsker's inequality give `bound`. `sharp_bound` needs no Pinsker: where p <= e^D q, TV(p, q) = Σ (p - q)^+ <= Σ p (1 -
e^-D) <= 1 - e^-D, which is met by experts that are certain, and never above sqrt(D / 2).
"""

import math

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln, logsumexp, xlogy


def experts(likelihoods: Float[np.ndarray, "m y"], evidence: Float[np.ndarray, "m"]) -> Float[np.ndarray, "y y"]:
    """Row y*: the distribution of the model that is most likely on the data with (x, y*) appended; ties go to the first."""
    with np.errstate(divide="ignore"):
        total = evidence[:, None] + np.log(likelihoods)
    return likelihoods[total.argmax(0)]


def own(known: Float[np.ndarray, "*n y y"]) -> Float[np.ndarray, "*n y"]:
    """p(y | expert of y)."""
    return np.diagonal(known, axis1=-2, axis2=-1)


def p_nml(known: Float[np.ndarray, "*n y y"]) -> Float[np.ndarray, "*n y"]:
    """Each label's probability under its own expert, normalised (6.2)."""
    return own(known) / own(known).sum(-1, keepdims=True)


def individual_regret(q: Float[np.ndarray, "*n y"], known: Float[np.ndarray, "*n y y"]) -> Float[np.ndarray, "*n y"]:
    """log p(y | expert of y) - log q(y), for each label; p_NML makes its greatest value least, and all alike."""
    return np.log(own(known)) - np.log(q)


def minimax_regret(known: Float[np.ndarray, "*n y y"]) -> Float[np.ndarray, "*n"]:
    """Γ = log Σ_y p(y | expert of y)."""
    return np.log(own(known).sum(-1))


def functional_regret(q: Float[np.ndarray, "*n y"], known: np.ndarray, g: Float[np.ndarray, "y"]) -> Float[np.ndarray, "*n y"]:
    """|E_q[g] - E[g] under the expert of y*|, for each y* (Definition 6.4.1)."""
    return np.abs((q @ g)[..., None] - known @ g)


def divergence(known: Float[np.ndarray, "*n y y"]) -> Float[np.ndarray, "*n"]:
    """D = max over y, y* of log p(y | expert of y*) - log p_NML(y)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.where(known > 0.0, np.log(known) - np.log(p_nml(known))[..., None, :], -np.inf)
    return np.maximum(gap.max((-2, -1)), 0.0)  # rounding aside, D >= Γ >= 0


def printed_bound(known: np.ndarray, g: np.ndarray) -> np.ndarray:
    """2 g_max sqrt(Γ / 2), Theorem 6.4.1 as printed. It does not hold."""
    return 2.0 * g.max() * np.sqrt(np.maximum(minimax_regret(known), 0.0) / 2.0)


def bound(known: np.ndarray, g: np.ndarray) -> np.ndarray:
    """(g_max - g_min) sqrt(D / 2)."""
    return np.ptp(g) * np.sqrt(divergence(known) / 2.0)


def sharp_bound(known: np.ndarray, g: np.ndarray) -> np.ndarray:
    """(g_max - g_min) (1 - e^-D)."""
    return -np.ptp(g) * np.expm1(-divergence(known))


# ---- Bernoulli models, and Jeffreys' prior ----------------------------------------------------------------------------


def next_label(ones: np.ndarray, n: int) -> dict[str, np.ndarray]:
    """The probability of a one after `ones` of n, by p_NML of (6.2) and by Bayes' rule under Jeffreys' prior.

    With the claim appended the most likely coins are (ones + 1) / (n + 1) and ones / (n + 1), so p_NML is Laplace's rule
    (ones + 1) / (n + 2): Bayes under the *uniform* prior. Jeffreys' is (ones + 1/2) / (n + 1); they are within 1 / (2 n + 2).
    """
    return {"cnml": (ones + 1.0) / (n + 2.0), "jeffreys": (ones + 0.5) / (n + 1.0)}


def sequence_regret(n: int) -> float:
    """log Σ_k C(n, k) (k/n)^k (1 - k/n)^(n-k): what NML of whole sequences of n coins regrets, whatever the sequence."""
    k = np.arange(n + 1)
    chosen = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
    return float(np.asarray(logsumexp(chosen + xlogy(k, k / n) + xlogy(n - k, 1.0 - k / n))))


def jeffreys_regret(n: int) -> Float[np.ndarray, "k"]:
    """The same for Bayes under Jeffreys' prior, by the number of ones 0 .. n.

    It comes near NML's, log(π n / 2) / 2, wherever the share of ones stays inside (0, 1), which is what "asymptotically
    equivalent" (6.2) means; with no ones at all it stays log(2) / 2 above.
    """
    k = np.arange(n + 1)
    mixed = gammaln(k + 0.5) + gammaln(n - k + 0.5) - gammaln(n + 1.0) - math.log(math.pi)
    return xlogy(k, k / n) + xlogy(n - k, 1.0 - k / n) - mixed
