"""A large class of curves whose maximum likelihood is found exactly: what NML believes, without networks (Figures 6.1 and 6.3).

The curves are linear between knots, take whole levels there, and change by at most `slope` levels from knot to knot. The
label's distribution is a discretised Gaussian around the curve. There are at most levels x (2 slope + 1)^(knots - 1) curves,
but the likelihood is a sum over the stretches between knots, so the best curve is a shortest path, and the posterior under a
uniform prior a sum over paths. Nothing is approximated.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import log_softmax, logsumexp

from deadreckon.theory.cnml import p_nml


@dataclass(frozen=True)
class Curves:
    """The class.

    Attributes:
        knots: (n,) increasing places.
        levels: how many; labels are levels too.
        slope: most change of level between neighbouring knots.
        spread: standard deviation of a label around the curve, in levels.
    """

    knots: np.ndarray
    levels: int
    slope: int
    spread: float

    @property
    def count(self) -> float:
        """How many curves there are."""
        level = np.arange(self.levels)
        step = (np.abs(level[:, None] - level) <= self.slope).astype(float)
        return float(np.linalg.matrix_power(step, len(self.knots) - 1).sum())

    def log_probs(self, height: np.ndarray) -> np.ndarray:
        """(..., levels) log-probabilities of the labels where a curve has a height."""
        return log_softmax(-0.5 * ((np.arange(self.levels) - height[..., None]) / self.spread) ** 2, axis=-1)

    def place(self, x: float) -> tuple[int, np.ndarray]:
        """The stretch in which x lies, and the heights (levels, levels) there by the levels at its ends."""
        i = int(np.clip(np.searchsorted(self.knots, x, side="right") - 1, 0, len(self.knots) - 2))
        share = (x - self.knots[i]) / (self.knots[i + 1] - self.knots[i])
        level = np.arange(self.levels)
        return i, (1.0 - share) * level[:, None] + share * level

    def scores(
        self, x: np.ndarray, label: Int[np.ndarray, "r"], weight: np.ndarray | None = None
    ) -> Float[np.ndarray, "n l l"]:
        """Log-likelihood of rows by stretch and by the levels at its ends; -inf where a curve may not go."""
        level = np.arange(self.levels)
        allowed = np.abs(level[:, None] - level) <= self.slope
        total = np.tile(np.where(allowed, 0.0, -np.inf), (len(self.knots) - 1, 1, 1))
        for at, y, w in zip(x, label, np.ones(len(x)) if weight is None else weight):
            if w:
                i, heights = self.place(at)
                total[i] += w * self.log_probs(heights)[..., y]
        return total

    def best(self, scores: Float[np.ndarray, "n l l"]) -> Int[np.ndarray, "k"]:
        """The levels of the most likely curve at the knots."""
        ahead = _messages(scores[::-1].swapaxes(1, 2), np.max)[::-1]  # what is still to come, from each knot
        path = [int(ahead[0].argmax())]
        for score, after in zip(scores, ahead[1:]):
            path.append(int((score[path[-1]] + after).argmax()))
        return np.array(path)

    def through(self, scores: np.ndarray, x: float, *, summed: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """(levels, levels) log-likelihood of the best curve by its levels around x, or of all of them; and heights at x."""
        reduce = logsumexp if summed else np.max
        i, heights = self.place(x)
        before = _messages(scores[:i], reduce)[-1]
        after = _messages(scores[:i:-1].swapaxes(1, 2), reduce)[-1]
        return before[:, None] + scores[i] + after, heights

    def experts(self, scores: np.ndarray, x: float) -> Float[np.ndarray, "y y"]:
        """For `cnml`: row y* is the distribution at x of the most likely curve on the data with (x, y*) appended."""
        total, heights = self.through(scores, x)
        own = self.log_probs(heights)
        which = (total[..., None] + own).reshape(-1, self.levels).argmax(0)
        return np.exp(own.reshape(-1, self.levels)[which])

    def posterior(self, scores: np.ndarray, x: float) -> Float[np.ndarray, "y"]:
        """What Bayes' rule says of the label at x, all curves alike before."""
        total, heights = self.through(scores, x, summed=True)
        share = np.exp(total - logsumexp(total))
        return (share[..., None] * np.exp(self.log_probs(heights))).sum((0, 1))


def _messages(scores: np.ndarray, reduce) -> np.ndarray:
    """(n + 1, levels) best or total score of what lies before each knot."""
    found = [np.zeros(scores.shape[-1])]
    for score in scores:
        found.append(reduce(found[-1][:, None] + score, axis=0))
    return np.array(found)


@dataclass(frozen=True)
class Beliefs:
    """What three methods believe of the label, by query.

    Attributes:
        curves: the class.
        x, label: the data.
        queries: (q,) places.
        truth: (q,) heights, in levels.
        nml, bayes, bootstrap: (q, levels) distributions.
        known: (q, levels, levels) NML's experts.
    """

    curves: Curves
    x: np.ndarray
    label: np.ndarray
    queries: np.ndarray
    truth: np.ndarray
    nml: np.ndarray
    bayes: np.ndarray
    bootstrap: np.ndarray
    known: np.ndarray


SEEN = (-4.0, -1.0), (1.5, 3.0)  # where there is data, as in evidence/studies/nml_sine.py


def sine(points: int = 60, queries: int = 65, members: int = 32, seed: int = 0) -> Beliefs:
    """Figure 6.3 in exact arithmetic: sin(x) seen in two stretches, by NML, by Bayes and by curves fitted to redrawn data."""
    rng = np.random.default_rng(seed)
    curves = Curves(np.linspace(-8.0, 8.0, 17), levels=32, slope=14, spread=1.0)
    low, high = np.array(SEEN)[rng.integers(0, len(SEEN), points)].T
    x = rng.uniform(low, high)
    height = lambda at: (np.sin(at) + 1.0) / 2.0 * (curves.levels - 1)  # noqa: E731
    label = np.clip(np.rint(height(x) + curves.spread * rng.standard_normal(points)), 0, curves.levels - 1).astype(int)
    asked = np.linspace(-8.0, 8.0, queries)
    scores = curves.scores(x, label)
    known = np.stack([curves.experts(scores, at) for at in asked])
    paths = []
    for _ in range(members):
        weight = np.bincount(rng.integers(0, points, points), minlength=points)
        paths.append(np.interp(asked, curves.knots, curves.best(curves.scores(x, label, weight))))
    bootstrap = np.exp(curves.log_probs(np.array(paths))).mean(0)
    bayes = np.stack([curves.posterior(scores, at) for at in asked])
    return Beliefs(curves, x, label, asked, height(asked), p_nml(known), bayes, bootstrap, known)
