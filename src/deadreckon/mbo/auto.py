"""The default method: the model that ranks held-out designs best, or the Gaussian process if it is about as good.

Below `networks_from` rows the method is the Gaussian process, with cross-validation: fitting networks several times would take
too long for a small table. From there on, the process, an ensemble and a ranking model (RaM) are fitted to the same designs,
about four fifths of them, and predict the rest. Of the methods with skill, whose order can be distinguished from chance and
whose predictions increase with the scores, the one with the greatest rank correlation is used, because proposals are chosen by
the order of their predictions. The process, if it is among them, is preferred if it is within one standard error of the best
(Breiman et al. 1984), since it separates the noise of measurements from the uncertainty of the model. If no method has skill,
the process is used and a warning says so. With a non-zero kappa the process is used without a comparison, since only it can
rank by standard deviations as well. The rule was fixed before it was applied to any table, except that methods without skill
are left out, which was added later.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from deadreckon.errors import DivergedError
from deadreckon.mbo.designer import Designer, DesignInput, Proposals
from deadreckon.mbo.forward import Forward, on_held_out
from deadreckon.mbo.gp import GP
from deadreckon.mbo.ram import RaM
from deadreckon.mbo.validation import Quality
from deadreckon.randomness import generator
from deadreckon.stats.ranks import spearman
from deadreckon.training.hyperparameters import Count, Number, Sizes, host

ALONE = "the only method that could be compared"
DRAWS = 200  # bootstrap resamples for the standard error of a difference


class Auto(Designer):
    """The Gaussian process, an ensemble or a ranking model, chosen by their predictions of held-out designs."""

    revision: ClassVar[int] = 6
    equal_rows: ClassVar[bool] = False  # the chosen method warns itself

    kappa: Number = host(0.0)
    """standard deviations added to the prediction of a Gaussian process, which is then taken: below 0 cautious, above 0 bold"""
    networks_from: Count = host(500)  # number of designs from which on networks are compared with the Gaussian process
    hidden: Sizes = host((256, 256))  # width of each hidden layer of networks
    steps: Count = host(2000)  # updates of networks

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "Auto"

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Proposals of the method chosen by the rule, with the quality of all methods that were compared."""
        gp = GP(kappa=self.kappa)
        if self.kappa or len(setting.data) < self.networks_from:
            return gp.solve(setting)
        sizes = {"hidden": self.hidden, "steps": self.steps}
        judged: list[tuple[Designer, Quality]] = []
        for method in (gp, Forward(members=5, **sizes), RaM(**sizes)):
            try:
                found = on_held_out(method, setting, scored=not isinstance(method, RaM))
            except DivergedError as error:
                told = f"{setting.data.name}: {method.label} is not compared, because its fit diverged ({error})"
                warnings.warn(told, stacklevel=4)
                continue
            if found is not None:
                judged.append((method, found))
        if not judged:
            return gp.solve(setting)
        compared = tuple(replace(quality, tried=len(judged)) for _, quality in judged)
        at, reason = chosen(compared)
        method, quality = judged[at][0], compared[at]
        # It was evaluated above, and its proposals are calibrated with that result, so it is not cross-validated again.
        if isinstance(method, GP):
            method = method.replace(folds=0)
        method.warn_of_errors(setting.data)
        made = method.solve(setting._replace(validate=False))
        return [replace(each.calibrated(quality), compared=compared, reason=reason) for each in made]


def chosen(compared: Sequence[Quality]) -> tuple[int, str]:
    """The index of the method to use, and the reason.

    Of the methods with skill it is the first of `compared`, unless that has none or another is better by more than one standard
    error. If no method has skill, it is the first.
    """
    first, rank = compared[0], [each.rank_correlation for each in compared]
    skilled = [i for i, each in enumerate(compared) if each.skilled]
    if not skilled:
        some = compared[int(np.argmax(rank))]
        which = f"which ranks unseen designs best of {len(compared)} methods" if len(compared) > 1 else ALONE
        return 0, f"of {some.method}, {which}, {some.doubt}; {first.method} is taken"
    best = max(skilled, key=lambda i: rank[i])
    if len(compared) == 1:
        return best, f"{first.method} is {ALONE} ({rank[best]:.3f})"
    told = f"{compared[best].method} ranks unseen designs best ({rank[best]:.3f})"
    if doubts := [f"of {each.method} ({each.rank_correlation:.3f}), {each.doubt}" for each in compared if not each.skilled]:
        told = f"{'; '.join(doubts)}; of the others, {told}"
    if best == 0 or 0 not in skilled:
        return best, told
    error = standard_error(first.observed, first.predicted, compared[best].predicted, first.units)
    told += f", {first.method} has {rank[0]:.3f}; the standard error of the difference is {error:.3f}"
    if rank[best] - rank[0] <= error:
        return 0, f"{told}, so {first.method} is taken"
    return best, told


def standard_error(observed: np.ndarray, a: np.ndarray, b: np.ndarray, units: np.ndarray | None = None) -> float:
    """Bootstrap standard error of the difference between the rank correlations of two predictions, `a` and `b` (rows,), with
    the same scores (rows,). Whole `units` (rows,) are resampled, or single rows if it is None."""
    rng, found = generator(0, "rows drawn anew"), []
    codes = np.arange(len(observed)) if units is None else units
    of = [np.flatnonzero(codes == code) for code in np.unique(codes)]
    for _ in range(DRAWS):
        rows = rng.integers(len(of), size=len(of))
        if len(of) < len(observed):
            rows = np.concatenate([of[i] for i in rows])
        found.append(spearman(observed[rows], a[rows]) - spearman(observed[rows], b[rows]))
    return float(np.std(found))
