"""The method by a rule that was fixed before any table was seen: what ranks unseen designs best, else the process.

Up to `networks_from` rows the method is the Gaussian process, cross-validated: fitting networks several times would take longer
than the table is worth. From there on the process, an ensemble and a model that ranks are all fitted on the same four fifths of
the designs and asked about the rest. The one with the greatest rank correlation is taken, because proposals are chosen by their
order; but the process where it is within one standard error of that (Breiman et al. 1984), since it tells noise from doubt.
Where no method's order can be distinguished from chance, the process is taken and a warning says so. With a kappa it is taken
untried, since it alone ranks by deviations too.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from deadreckon.mbo.designer import Designer, DesignInput, Proposals
from deadreckon.mbo.forward import Forward, on_held_out
from deadreckon.mbo.gp import GP
from deadreckon.mbo.ram import RaM
from deadreckon.mbo.validation import Quality
from deadreckon.randomness import generator
from deadreckon.stats.ranks import spearman
from deadreckon.training.hyperparameters import Count, Number, Sizes, host

DRAWS = 200  # of rows, for the standard error of a difference


class Auto(Designer):
    """The Gaussian process, an ensemble or a model that ranks: by their predictions of designs that they have not seen."""

    revision: ClassVar[int] = 4
    equal_rows: ClassVar[bool] = False  # that of the method that it takes counts

    kappa: Number = host(0.0)
    """standard deviations added to the prediction of a Gaussian process, which is then taken: below 0 cautious, above 0 bold"""
    networks_from: Count = host(500)  # number of designs from which on networks are tried beside the Gaussian process
    hidden: Sizes = host((256, 256))  # width of each hidden layer of networks
    steps: Count = host(2000)  # updates of networks

    @property
    def label(self) -> str:
        """What tables call it."""
        return "Auto"

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """Proposals of the method that the rule takes, with the quality of all that were tried."""
        gp = GP(kappa=self.kappa)
        if self.kappa or len(setting.data) < self.networks_from:
            return gp.solve(setting)
        sizes = {"hidden": self.hidden, "steps": self.steps}
        tried = [gp, Forward(members=5, **sizes), RaM(**sizes)]
        judged = [on_held_out(method, setting, scored=not isinstance(method, RaM)) for method in tried]
        compared = [replace(each, tried=len(tried)) for each in judged if each is not None]
        if not compared:
            return gp.solve(setting)
        at, reason = chosen(compared)
        method, quality = tried[at], compared[at]
        # Judged it is already: what it proposes is calibrated by that.
        if isinstance(method, GP):
            method = method.replace(folds=0)
        method.warn_of_errors(setting.data)
        found = method.solve(setting._replace(validate=False))
        return [replace(each.calibrated(quality), compared=tuple(compared), reason=reason) for each in found]


def chosen(compared: list[Quality]) -> tuple[int, str]:
    """The index of the method that is taken, the first unless another is better by more than one standard error, and why."""
    first, rank = compared[0], [each.rank_correlation for each in compared]
    best = int(np.argmax(rank))
    if not any(each.skilled for each in compared):
        some = compared[best]
        told = f"of {some.method}, which ranks unseen designs best of {len(compared)} methods, {some.doubt}"
        return 0, f"{told}; {first.method} is taken"
    if best == 0:
        return 0, f"{first.method} ranks unseen designs best ({rank[0]:.3f})"
    error = standard_error(first.observed, first.predicted, compared[best].predicted, first.units)
    told = f"{compared[best].method} ranks unseen designs best ({rank[best]:.3f}), {first.method} has {rank[0]:.3f}; "
    told += f"the standard error of the difference is {error:.3f}"
    if rank[best] - rank[0] <= error:
        return 0, f"{told}, so {first.method} is taken"
    return best, told


def standard_error(observed: np.ndarray, a: np.ndarray, b: np.ndarray, units: np.ndarray | None = None) -> float:
    """Of the difference of the rank correlations of two predictions (rows,) of the same scores, by drawing units anew, of
    which each row is one where they are None."""
    rng, found = generator(0, "rows drawn anew"), []
    codes = np.arange(len(observed)) if units is None else units
    of = [np.flatnonzero(codes == code) for code in np.unique(codes)]
    for _ in range(DRAWS):
        rows = rng.integers(len(of), size=len(of))
        if len(of) < len(observed):
            rows = np.concatenate([of[i] for i in rows])
        found.append(spearman(observed[rows], a[rows]) - spearman(observed[rows], b[rows]))
    return float(np.std(found))
