"""What out-of-fold errors say against the model: single rows far from what all others predict, and errors that grow."""

import numpy as np

from deadreckon.mbo.design_table import rows_told
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nn_distance import neighbours
from deadreckon.mbo.validation import Quality
from deadreckon.stats.ranks import spearman

LEAST = 20  # fewest rows
FAR = 5.0  # robust standard deviations of the errors, beyond which a row is named
LARGE = 1.5  # standard deviations of the other scores that its error must be, too
FEW = 0.05  # share of rows beyond it, above which errors have long tails and no row is named
NEIGHBOURS = 4  # rows of which one at least is alike at a cliff
NAMED = 3  # most rows that are named
SURE = 2.6  # standard errors of a rank correlation above zero, which chance exceeds in one of 200 tables


def misfits_told(data: Designs, quality: Quality | None) -> list[str]:
    """Messages on rows whose scores are far from their predictions by models of the others, which fitted models follow all the
    same, and on errors that grow with predictions.

    Args:
        data: scored designs.
        quality: of a model of them; None: it was not tested.
    """
    if quality is None or not quality.scored or len(quality.observed) < LEAST:
        return []
    mean = quality.crosswise[0]
    error = np.abs(quality.observed - mean)
    usual = float(np.median(error)) / 0.6745
    beyond = error > FAR * usual
    units = np.arange(len(error)) if quality.units is None else quality.units
    if quality.skilled and (growing := _growing(data, quality.observed, mean, error, ~beyond, units)):
        return growing  # then large errors are those of large scores
    rows = np.arange(len(error)) if quality.rows is None else quality.rows
    beyond &= error > LARGE * quality.observed[~beyond].std()  # of exact scores all errors are small, also the largest
    beyond[beyond] = _apart(data, rows[beyond]) > FAR * usual
    if not 0 < beyond.sum() <= max(FEW * len(error), 1):
        return []
    return _far(data, quality, rows, mean, np.flatnonzero(beyond)[np.argsort(-error[beyond], kind="stable")])


def _apart(data: Designs, rows: np.ndarray) -> np.ndarray:
    """(n,) by how much the scores of some rows differ at least from those of the nearest others: at a cliff that the model has
    smoothed some are alike."""
    if not len(rows):
        return np.zeros(0)
    _, near = neighbours(data, data.x[rows], 1 + NEIGHBOURS)
    return np.where(near == rows[:, None], np.inf, np.abs(data.y[near] - data.y[rows, None])).min(1)


def _far(data: Designs, quality: Quality, rows: np.ndarray, mean: np.ndarray, beyond: np.ndarray) -> list[str]:
    """A message on the rows `beyond` among those of `quality`, the farthest first."""
    worst = beyond[:NAMED]
    pairs = [(float(data.shown(quality.observed[i])), float(data.shown(mean[i]))) for i in worst]
    said = [
        f"{rows_told(data.numbered(rows[[i]]), ' (counted from 0)')} has {score:.4g}, where the other rows predict {guess:.4g}"
        for i, (score, guess) in zip(worst, pairs)
    ]
    more = f", and {len(beyond) - len(worst):,} more" if len(beyond) > len(worst) else ""
    one = "it" if len(beyond) == 1 else "them"
    return [
        f"{data.target}: {'; '.join(said)}{more}: the model is fitted to {one} and proposals may follow {one}; measure {one} "
        f"again, or leave {one} out, if {'it is an error' if len(beyond) == 1 else 'they are errors'}"
    ]


def _growing(
    data: Designs, observed: np.ndarray, mean: np.ndarray, error: np.ndarray, some: np.ndarray, units: np.ndarray
) -> list[str]:
    """A message on positive scores whose errors are larger where predictions are higher, which are often relative ones; of
    `some` rows (rows,), averaged over units."""
    unit = np.unique(units[some], return_inverse=True)[1]
    sizes = np.bincount(unit)
    mean, error = (np.bincount(unit, each[some]) / sizes for each in (mean, error))
    if data.minimise or (observed <= 0).any() or len(sizes) < LEAST:
        return []
    if (found := spearman(error, mean)) < SURE / np.sqrt(len(sizes) - 1):
        return []
    return [
        f"errors of predictions of {data.target} grow with the predictions (rank correlation {found:.2f}), so that the "
        f"intervals of the best ones are too narrow: if errors are shares of the score, use the logarithm of {data.target} as "
        "the target, in a column of its own"
    ]
