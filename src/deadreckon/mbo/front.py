"""Several targets: designs that are expected to extend the Pareto front of the data, by a Gaussian process for each target.

Candidates are found by maximising augmented Chebyshev scalarisations of the predicted means with random weights (Knowles 2006),
within all rules. From these a batch is chosen greedily by expected hypervolume improvement, over joint draws of the true scores
of candidates and of the data's front, whose scores are noisy as well (Daulton et al. 2021). A candidate's gain never grows as
others are chosen, so that only the gain of the best one is computed again, until it stays the best (Minoux 1978).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.batch import batch, check_batch, least_distance, untried
from deadreckon.mbo.calibration import Calibration
from deadreckon.mbo.designer import DesignInput, Proposals, check_asked
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import keeping, permitted
from deadreckon.mbo.gp import GP, search
from deadreckon.mbo.hypervolume import dominators, hypervolume, improvement, non_dominated, range_of, reference_of
from deadreckon.mbo.misfits import misfits_told
from deadreckon.mbo.process import Process, fit
from deadreckon.mbo.validation import Quality
from deadreckon.progress import Watcher, unwatched
from deadreckon.randomness import generator

WEIGHTS = 12  # number of random scalarisations, in addition to one for each target
ROUNDS = 15  # of each search
KEPT = 32  # least number of designs that each search keeps
DRAWS = 32  # joint draws of the true scores
MOST = 300  # largest number of rows of the data whose true scores are drawn for the reported gain
EXPLAINED = 0.8  # out-of-fold R2 of a target below which the gain is reported to be too high
AUGMENTED = 0.05  # weight of the sum of scores, which augments the least of them
LABEL = "GP for each target, expected hypervolume improvement"


@dataclass(frozen=True)
class Front:
    """Proposals for several targets; all scores are maximised, like `Designs.y`.

    Attributes:
        data: (targets,) the same designs with the scores of each target.
        made: (targets,) the same proposals with the predictions for each target.
        reference: (targets,) the point from which hypervolumes are measured.
        before: hypervolume of the measured scores of the rows that satisfy the rules, or of all rows if none does.
        gain: expected increase of the hypervolume of the data's true scores by the proposals' true scores. The data are all
            rows of `contenders`, not only the measured front: if noise is large, others may be as good.
    """

    data: tuple[Designs, ...]
    made: tuple[Proposals, ...]
    reference: np.ndarray
    before: float
    gain: float

    @property
    def observed(self) -> np.ndarray:
        """(rows, targets) scores of the data."""
        return np.stack([each.y for each in self.data], 1)

    @property
    def best(self) -> np.ndarray:
        """(rows,) bool: which rows of the data are on its front."""
        return on_front(self.data)

    @property
    def predicted(self) -> np.ndarray:
        """(n, targets) predicted scores."""
        return np.stack([each.predicted for each in self.made], 1)

    def shown(self, scores: np.ndarray) -> np.ndarray:
        """(..., targets) scores with the signs of the table."""
        return np.stack([each.shown(scores[..., k]) for k, each in enumerate(self.data)], -1)

    @property
    def unskilled(self) -> list[str]:
        """Targets whose model was not tested, or cannot be distinguished from chance: the gain is then not known."""
        return [each.target for each, made in zip(self.data, self.made) if made.quality is None or made.by_chance]

    @property
    def noisy(self) -> list[str]:
        """Targets for which the model's out-of-fold R2 is below `EXPLAINED`, with R2."""
        pairs = [(each.target, made.quality.r2) for each, made in zip(self.data, self.made) if made.quality is not None]
        return [f"{target} {r2:.2f}" for target, r2 in pairs if r2 < EXPLAINED]

    @property
    def warnings(self) -> list[str]:
        """Warnings to read before the proposals are tried, by target."""
        pairs = list(zip(self.data, self.made))
        fits = [line for each, made in pairs for line in misfits_told(each, made.quality)]
        return [*fits, *(f"{each.target}: {made.warning}" for each, made in pairs if made.warning)]

    @property
    def notes(self) -> list[str]:
        """Remarks that are needed to interpret the hypervolume and the gain."""
        lines = []
        if not keeping(self.data[0]).any():
            lines.append("no row of the data satisfies the rules of the proposals, so that the hypervolume is that of all rows")
        if self.before == 0:
            lines.append("no eligible row lies above the reference point in all targets")
        if self.gain == 0 and not self.unskilled:
            lines.append(
                "no proposal is expected to add anything, above the reference point in all targets and beyond the front; "
                "they are those of the greatest predictions, all targets together"
            )
        elif not self.unskilled and (noisy := self.noisy):
            lines.append(f"the expected gain is too high where noise is large (R2 out of fold: {', '.join(noisy)})")
        return lines


@dataclass(frozen=True)
class Scalarised:
    """The augmented Chebyshev scalarisation of several processes of the same designs, used as a process in `mbo.gp.search`.

    Attributes:
        processes: one per target.
        weight: (targets,) weights of the scores in units of `span`.
        origin, span: (targets,) origin and unit of the scores.
    """

    processes: tuple[Process, ...]
    weight: np.ndarray
    origin: np.ndarray
    span: np.ndarray

    def _parts(self, x: np.ndarray) -> np.ndarray:
        mean = np.stack([each.mean(x) for each in self.processes], 1)
        return self.weight * (mean - self.origin) / self.span

    def mean(self, x: np.ndarray) -> np.ndarray:
        """(m,) the least weighted score, plus `AUGMENTED` times their sum."""
        parts = self._parts(x)
        return parts.min(1) + AUGMENTED * parts.sum(1)

    def slope(self, x: np.ndarray, kappa: float) -> np.ndarray:
        """(m, features) gradient of `mean`; `kappa` is ignored."""
        least = self._parts(x).argmin(1)
        total: Any = 0.0
        for k, each in enumerate(self.processes):
            scale = self.weight[k] * each.y_std / self.span[k]
            total = total + (scale * ((least == k) + AUGMENTED))[:, None] * each.slope(x, 0.0)
        return total


def propose_front(
    data: Sequence[Designs],
    n: int = 128,
    *,
    seed: int = 0,
    reference: Sequence[float] | None = None,
    repeat: bool = False,
    watch: Watcher = unwatched,
) -> Front:
    """Designs that are expected to extend the front of several targets.

    Args:
        data: the same designs, with the scores of one target each (`targets_of`).
        n: how many to propose; all different.
        seed: random seed.
        reference: (targets,) point from which hypervolumes are measured, with the signs of the table; None: `reference_of`.
        repeat: whether designs of the data may be proposed.
        watch: called with the name of the fit, the targets done and the total.

    Raises:
        UserError: fewer than two targets, an invalid seed, a reference point of another size or with numbers that are not
            finite, or fewer designs than requested.
    """
    data, gp = tuple(data), GP()
    check_asked(n, [seed])
    if len(data) < 2:
        raise UserError(f"a front needs two targets or more, got {len(data)}")
    if reference is not None and len(reference) != len(data):
        raise UserError(f"the reference point needs {len(data)} numbers, one for each target, got {len(reference)}")
    if reference is not None and not np.isfinite(reference).all():
        raise UserError(f"the reference point needs finite numbers, got {', '.join(f'{each:g}' for each in reference)}")
    y, counts = np.stack([each.y for each in data], 1), permitted(data[0])
    signs = np.where([each.minimise for each in data], -1.0, 1.0)
    point = reference_of(y, counts) if reference is None else signs * np.asarray(reference, np.float64)
    low, span = range_of(y, counts)
    processes, qualities = [], []
    for k, each in enumerate(data):
        watch("targets", k, len(data))
        processes.append(fit(gp.used(each), rows=gp.fit_rows))
        quality = gp.quality(DesignInput(each, n, [seed], None, unwatched))
        qualities.append(quality and replace(quality, method=each.target))
    rows = np.flatnonzero(on_front(data))
    pool = candidates(data[0], tuple(processes), low, span, n, seed)
    pool = pool if repeat else untried(data[0], pool, n)
    gains = Gains(processes, pool, data[0].x[rows], point, seed)
    value = Scalarised(tuple(processes), np.ones(len(data)), low, span).mean
    order = gains.greedy(2 * n, value(pool), data[0].coordinates.place(pool), least_distance(data[0]))
    x = batch(data[0], pool[order], n, value, repeat=repeat, seed=seed)
    check_batch(data[0], x, repeat)
    made = tuple(_predicted(each, process, x, seed, quality) for each, process, quality in zip(data, processes, qualities))
    worth = [None if quality is None else quality.calibration for quality in qualities]
    gain = Gains(processes, x, data[0].x[contenders(data[0], processes)], point, seed, worth).total()
    return Front(data, made, point, hypervolume(y[rows], point), gain)


def _predicted(data: Designs, process: Process, x: np.ndarray, seed: int, quality: Quality | None) -> Proposals:
    mean, std = process.posterior(x)
    more = {"mean_std": std, "beyond": process.beyond, "minimise": data.minimise}
    made = Proposals(LABEL, x, mean, np.hypot(std, process.noise), seed, **more)
    return made.calibrated(quality) if quality else made


def on_front(data: Sequence[Designs]) -> np.ndarray:
    """(rows,) bool: which designs of the data are on the Pareto front of those that are `permitted`."""
    rows = np.flatnonzero(permitted(data[0]))
    found = np.zeros(len(data[0]), bool)
    found[rows[non_dominated(np.stack([each.y[rows] for each in data], 1))]] = True
    return found


def contenders(data: Designs, processes: Sequence[Process]) -> np.ndarray:
    """Rows of the data that may be on the front of its true scores: those that are `permitted`, at most `MOST`.

    If there are more, those that the fewest others dominate by their predictions are used: a random sample would miss the few
    that matter, and the greatest measured scores are partly due to noise.
    """
    rows = np.flatnonzero(permitted(data))
    if len(rows) <= MOST:
        return rows
    parts = np.array_split(data.x[rows], -(-len(rows) // MOST))  # covariances with all rows at once are too many
    mean = np.stack([np.concatenate([process.mean(part) for part in parts]) for process in processes], 1)
    return rows[np.argsort(dominators(mean), kind="stable")[:MOST]]


def candidates(
    data: Designs, processes: tuple[Process, ...], low: np.ndarray, span: np.ndarray, n: int, seed: int
) -> np.ndarray:
    """(m, variables) different designs with great scalarised scores for some weights; `low` and `span` are origin and unit."""
    count = len(processes)
    drawn = generator(seed, "weights of targets").dirichlet(np.ones(count), WEIGHTS)
    alone = 0.02 + (1 - 0.02 * count) * np.eye(count)
    found = []
    for i, share in enumerate([*alone, *drawn]):
        process: Any = Scalarised(processes, 1 / np.maximum(share, 0.02), low, span)
        found.append(search(data, process, 0.0, ROUNDS, max(KEPT, 4 * n // (WEIGHTS + count)), seed + i))
    return np.unique(np.concatenate(found), axis=0)


class Gains:
    """Joint draws of the true scores of candidates and of the data's front, and the expected gains of hypervolume.

    Args:
        processes: one per target, independent of each other.
        x: (m, variables) candidates.
        front: (f, variables) designs of the data, among which the front of each draw is found.
        reference: (targets,) point of the hypervolume.
        seed: of the draws.
        calibrations: one per target, which are applied to the draws; None: draws are those of the process.
    """

    def __init__(
        self, processes: Sequence[Process], x: np.ndarray, front: np.ndarray, reference: np.ndarray, seed: int,
        calibrations: Sequence[Calibration | None] | None = None,
    ):  # fmt: skip
        rng, both = generator(seed, "draws of true scores"), np.concatenate([x, front])
        drawn = [_draws(process, both, rng, each) for process, each in zip(processes, calibrations or [None] * len(processes))]
        y = np.stack(drawn, -1)  # (draws, m + f, targets)
        self.y, self.reference = y[:, : len(x)], reference
        self.fronts = [_kept(each, reference) for each in y[:, len(x) :]]

    def of(self, i: int, fronts: Sequence[np.ndarray]) -> float:
        """The expected hypervolume improvement by one candidate, given the front of each draw."""
        return float(np.mean([improvement(y[i], front, self.reference) for y, front in zip(self.y, fronts)]))

    def greedy(self, n: int, value: np.ndarray, z: np.ndarray | None = None, apart: float = 0.0) -> np.ndarray:
        """(n,) or fewer candidates, in the order in which they are chosen; each has the greatest gain given those before it.

        Args:
            n: how many.
            value: (candidates,) by which they are chosen if none has a gain.
            z: (candidates, features) of `Coordinates.place`, if there is a least distance.
            apart: least distance between those that are chosen.
        """
        fronts = list(self.fronts)
        gain = np.array([self.of(i, fronts) for i in range(self.y.shape[1])])
        order: list[int] = []
        for _ in range(min(n, len(gain))):
            fresh: set[int] = set()
            while (i := int(gain.argmax())) not in fresh and gain[i] > 0:
                gain[i] = self.of(i, fronts)
                fresh.add(i)
            if gain[i] == -np.inf:  # all others are too near
                break
            if gain[i] <= 0:
                i = int(np.where(gain > -np.inf, value, -np.inf).argmax())
            order.append(i)
            gain[i] = -np.inf
            if z is not None:
                gain[np.square(z - z[i]).sum(1) < apart**2] = -np.inf
            fronts = [_kept(np.concatenate([front, y[i : i + 1]]), self.reference) for front, y in zip(fronts, self.y)]
        return np.array(order)

    def total(self) -> float:
        """The expected hypervolume improvement by all candidates together."""
        volume: Callable[[np.ndarray], float] = lambda y: hypervolume(y, self.reference)  # noqa: E731
        both = [volume(np.concatenate([front, y])) - volume(front) for front, y in zip(self.fronts, self.y)]
        return float(np.mean(both))


def _draws(process: Process, x: np.ndarray, rng: np.random.Generator, calibration: Calibration | None) -> np.ndarray:
    """(DRAWS, m) joint draws of true scores."""
    values, vectors = np.linalg.eigh(process.covariance(x))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    mean, off = process.mean(x), process.y_std * rng.standard_normal((DRAWS, len(x))) @ root.T
    return np.add(*((mean, off) if calibration is None else calibration.of_true(mean, off)))


def _kept(y: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The non-dominated rows above the reference point, which determine the hypervolume."""
    y = y[(y > reference).all(1)]
    return y[non_dominated(y)] if len(y) else y


def targets_of(read: Callable[..., Designs], targets: Sequence[str], minimise: Sequence[str], **options: Any) -> list[Designs]:
    """The same designs with the scores of each target.

    Args:
        read: function that returns designs, called with `target`, `minimise`, `ignore`, `targets` and `options`, such as
            `Designs.from_frame` of a table.
        targets: columns of the scores.
        minimise: those of them that are minimised.
        options: further keywords of `read`.

    Raises:
        UserError: there are fewer than two different targets, or one in `minimise` is not a target.
    """
    if len(set(targets)) < max(len(targets), 2):
        raise UserError(f"a front needs two different targets or more, got {', '.join(targets)}")
    if strangers := [name for name in minimise if name not in targets]:
        raise UserError(f"{strangers[0]} is to be made small and is no target; targets are {', '.join(targets)}")
    ignore = tuple(options.pop("ignore", ()))
    others = lambda target: (*ignore, *(name for name in targets if name != target))  # noqa: E731
    each = lambda name: {"target": name, "minimise": name in minimise, "ignore": others(name), "targets": targets}  # noqa: E731
    return [read(**each(name), **options) for name in targets]
