"""The interface of design methods: proposals that should score high, from scored designs alone (thesis chapter 6)."""

import contextlib
import dataclasses
import hashlib
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.errors import UserError
from deadreckon.files import alone
from deadreckon.mbo.batch import batch, check_batch
from deadreckon.mbo.design_source import DesignSource
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.local_search import on_grid
from deadreckon.mbo.replicates import noise_beyond
from deadreckon.mbo.validation import Quality
from deadreckon.progress import Watcher, unwatched
from deadreckon.provided import Shown
from deadreckon.randomness import generator
from deadreckon.training.checkpoint import folder_of, inherit
from deadreckon.training.fit import Fit, complete
from deadreckon.training.hyperparameters import check_fields, described, on_device
from deadreckon.training.learner import unstack
from deadreckon.training.revisions import revisions

# Coordinates (n, size) -> standardised means (n,) and standard deviations (n,); either may be None.
Belief = Callable[[Array], tuple[Any, Any]]
AROUND = 0.3  # standard deviation of further starting points around a design, in standardised coordinates


@dataclass(frozen=True)
class Proposals(Shown):
    """Designs that a method proposes.

    Attributes:
        method: name of the method.
        x: (n, variables) as the data holds them; see `Designs.decode` for a table.
        predicted: (n,) the method's predictions of their scores; NaN if it has none.
        predicted_std: (n,) standard deviation of a new measurement, noise included, or of the true score (`noisy`); NaN if
            the method has none.
        seed: random seed.
        seconds: computation time of all seeds together.
        quality: how well the method predicts held-out designs; None if that was not tested.
        fitted: the model, for predictions of other designs; None if the method has no model of the score.
        compared: the quality of all methods that were compared, if the method was chosen among several.
        reason: why this method was chosen; None if it was not chosen among several.
        mean_std: (n,) standard deviation of the true score, the expected value of a measurement. True scores are not observed,
            so it is multiplied by the same factor as that of a row. None if the method does not separate it from noise.
        noisy: whether `predicted_std` is of a measurement, noise included.
        beyond: standard deviation of the noise of a single measurement in addition to that of a usual row, which may be the
            mean of several.
        minimise: whether the score was negated, as in `Designs`: `predicted` is then minus the value of the table.
        measured: whether the proposals are designs of the data, and `predicted` their measured scores.
        requested: whether `predicted` is the score for which the designs were made, not the prediction of a model.
    """

    method: str
    x: np.ndarray
    predicted: np.ndarray
    predicted_std: np.ndarray
    seed: int
    seconds: float = 0.0
    quality: Quality | None = None
    fitted: Fitted | None = dataclasses.field(default=None, repr=False)
    mean_std: np.ndarray | None = None
    compared: tuple[Quality, ...] = ()
    reason: str | None = None
    noisy: bool = True
    beyond: float = 0.0
    minimise: bool = False
    measured: bool = False
    requested: bool = False

    def __len__(self) -> int:
        return len(self.x)

    @property
    def predicts(self) -> bool:
        """Whether the method predicts the scores of its designs."""
        return bool(np.isfinite(self.predicted).all())

    @property
    def how(self) -> str:
        """Where `predicted` is from: "measured", "requested" or "predicted"."""
        return "measured" if self.measured else "requested" if self.requested else "predicted"

    @property
    def of_what(self) -> str:
        """The quantity that the intervals cover, in words."""
        return "a new measurement, noise included" if self.noisy else "the true score, without a measurement's noise"

    @property
    def warning(self) -> str | None:
        """A warning to read before the proposals are tried; None if there is none."""
        if self.quality is not None:
            return self.quality.warning
        if self.fitted is None and not np.isfinite(self.predicted_std).any():
            return None  # nothing is predicted
        return "how well the method predicts unseen designs was not tested; its predictions may be worthless"

    @property
    def by_chance(self) -> bool:
        """Whether the model was tested, and its order of unseen designs cannot be distinguished from chance."""
        return self.quality is not None and not self.quality.skilled

    def calibrated(self, quality: Quality) -> "Proposals":
        """The same proposals with predictions calibrated on scores of unseen designs, also those of the model.

        The scores of the calibration have the noise of a row; the further noise of a single measurement (`beyond`) is added.
        The standard deviations of true scores, which are not observed, are multiplied by the same factor as those of rows.
        """
        if quality.calibration is None:
            return dataclasses.replace(self, quality=quality)
        mean, std, factor = quality.calibration.of_one(self.predicted, self.predicted_std, self.beyond)
        return dataclasses.replace(
            self,
            predicted=mean,
            predicted_std=std,
            quality=quality,
            mean_std=None if self.mean_std is None else self.mean_std * factor,
            fitted=self.fitted and self.fitted.calibrated(quality.calibration, self.beyond),
        )


class DesignInput(NamedTuple):
    """The arguments of `Designer.solve`; see `Designer.propose`."""

    data: Designs
    n: int
    seeds: list[int]
    out: Path | None
    watch: Watcher
    distinct: bool = False
    repeat: bool = False
    validate: bool = False

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(size,) least and greatest coordinates, which are equal for fixed variables."""
        low, high = self.data.coordinates.bounds
        return jnp.asarray(low), jnp.asarray(high)

    def train(self, learner: Any, steps: int, what: str, more: dict[str, np.ndarray] | None = None) -> list[Any]:
        """States of a learner after `steps` updates on the designs, one per seed; resumes from checkpoints in `out`.

        Args:
            learner: as for `training.fit`.
            steps: number of updates.
            what: name of the fit.
            more: further columns of the rows; see `DesignSource`.

        Raises:
            UserError: it diverged (NaN or infinite numbers).
        """
        points = DesignSource(self.data, learner.needs(self.data.coordinates), more)
        folder = None if self.out is None else self._folder(learner, points, steps, what)
        job = Fit([learner] * len(self.seeds), points, self.seeds, steps, chunk=max(1, min(500, steps // 10)), folder=folder)
        with contextlib.nullcontext() if folder is None else alone(folder, f"fits {what} already"):
            complete(job, what, lambda progress: self.watch(what, progress.step, steps))
        return unstack(job.states, len(self.seeds))

    def _folder(self, learner: Any, points: DesignSource, steps: int, what: str) -> Path:
        """The folder of checkpoints, a different one for each combination of data and settings."""
        assert self.out is not None
        data = hashlib.blake2b(digest_size=16)
        for column in points.columns.values():
            data.update(np.ascontiguousarray(column).tobytes())
        trained = described(on_device(learner))
        trained = {"settings": trained, "revisions": revisions(learner)}
        asked = {"learner": trained, "steps": steps, "n": self.n, "seeds": self.seeds, "data": data.hexdigest()}
        folder = folder_of(self.out, what, asked)
        inherit(folder)
        return folder


class Designer(eqx.Module):
    """Base class of design methods: its fields are hyperparameters, and `propose` returns proposals.

    Attributes:
        revision: raised in the class whose code has changed the proposals; here for the code that all designers share (class
            attribute). It identifies results of suites (see bench/identity.py).
    """

    revision: ClassVar[int] = 1
    from_data: ClassVar[bool] = False  # whether it always proposes designs of the data
    equal_rows: ClassVar[bool] = True  # whether its fit ignores the standard errors of rows

    def settings_text(self, data: Designs) -> str:
        """All settings that proposals for some data depend on, as text."""
        return described(self)

    def propose(
        self,
        data: Designs,
        n: int = 128,
        *,
        seed: int = 0,
        out: Path | str | None = None,
        watch: Watcher = unwatched,
        distinct: bool = True,
        repeat: bool = False,
        validate: bool = False,
    ) -> Proposals:
        """Designs that should score high.

        Args:
            data: scored designs, the only input.
            n: how many to propose.
            seed: random seed.
            out: folder of checkpoints, from which a killed fit resumes; None: no checkpoints.
            watch: called with the name of the fit, the updates done and the total.
            distinct: whether proposals are made different and satisfy the rules of the data (`mbo.batch`); False: the method's
                proposals are returned unchanged, as in published comparisons.
            repeat: whether designs of the data may be proposed.
            validate: whether `forward` and ensembles also fit a part of the data and predict the rest, which gives
                `Proposals.quality` and calibrated standard deviations (`gp` and `auto` always do).

        Raises:
            UserError: invalid settings, a fit that diverged, or fewer designs than requested.
        """
        asked = {"distinct": distinct, "repeat": repeat, "validate": validate}
        return self.propose_many(data, n, seeds=[seed], out=out, watch=watch, **asked)[0]

    def propose_many(
        self,
        data: Designs,
        n: int = 128,
        *,
        seeds: Sequence[int],
        out: Path | str | None = None,
        watch: Watcher = unwatched,
        distinct: bool = True,
        repeat: bool = False,
        validate: bool = False,
    ) -> list[Proposals]:
        """Proposals for several seeds, whose networks, if the method has any, are trained in one program; see `propose`."""
        check_asked(n, seeds)
        check_fields(self)
        if distinct and self.from_data and data.rules.apart is not None:
            raise UserError(f"{self.label} proposes designs of the data as they are, not at a least distance; leave apart out")
        self.warn_of_errors(data)
        begun = time.perf_counter()
        folder = None if out is None else Path(out)
        found = self.solve(DesignInput(data, n, list(seeds), folder, watch, distinct, repeat, validate))
        seconds = time.perf_counter() - begun
        for each in found:
            data.check(each.x)
            if distinct and not self.from_data:
                check_batch(data, each.x, repeat)
        return [dataclasses.replace(each, seconds=seconds, minimise=data.minimise) for each in found]

    def warn_of_errors(self, data: Designs) -> None:
        """Warns if the standard errors of rows, given or from replicates, differ and the fit ignores them."""
        if self.equal_rows and data.std_error is not None and np.ptp(data.std_error) > 0:
            told = f"{data.name}: {self.label} treats all rows as equally exact in its fit, regardless of their standard errors"
            warnings.warn(f"{told} and replicates; the Gaussian process does not (--method gp)", stacklevel=3)

    @property
    def label(self) -> str:
        """Its name in tables."""
        return type(self).__name__

    def solve(self, setting: DesignInput) -> list[Proposals]:
        """The method itself, implemented by subclasses: proposals, one per seed."""
        raise NotImplementedError

    def replace(self, **changes: Any) -> Any:
        """The same designer with some fields changed."""
        return dataclasses.replace(self, **changes)

    def decoded(
        self, setting: DesignInput, seed: int, z: Any, believed: Belief | None = None, noisy: bool = True,
        climbed: Callable[[Array], Any] | None = None,
    ) -> Proposals:  # fmt: skip
        """Proposals from coordinates (n, size).

        Args:
            setting: the arguments of the method.
            seed: of the proposals.
            z: the coordinates; the nearest designs, with whole numbers and single levels, are proposed.
            believed: function from coordinates to standardised means and standard deviations (n,), either of which may be None;
                evaluated at the proposed designs. None: the method makes no predictions.
            climbed: function from coordinates to the value (n,) that the method has maximised. It guides the search over
                numbers in steps that share a constraint (`local_search.on_grid`) and, if `believed` is None, ranks the designs
                that replace coinciding ones. None: no such search.
            noisy: whether standard deviations are those of a row, noise included; else those of the true score.
        """
        view = setting.data.coordinates
        x = view.decode(np.asarray(z))
        if setting.distinct:
            value = None if believed is None else lambda x: np.asarray(believed(jnp.asarray(view.encode(x)))[0])
            if climbed is not None:
                model = Fitted.of(setting.data, lambda x: (climbed(x), None), is_order=True)
                order = lambda x: model.predict(x)[0]  # noqa: E731
                x = on_grid(setting.data, x, order, generator(seed, "search on a grid"))
                value = value or order
            x = batch(setting.data, x, setting.n, value, repeat=setting.repeat, seed=seed)
        mean = predicted_std = None
        if believed is not None:
            mean, predicted_std = believed(jnp.asarray(view.encode(x)))
        nan = np.full(setting.n, np.nan)
        predicted = nan if mean is None else view.score(np.asarray(mean, np.float64))
        beyond = noise_beyond(setting.data) if noisy else 0.0
        spread = nan if predicted_std is None else np.hypot(view.y_std * np.asarray(predicted_std, np.float64), beyond)
        fitted = None if believed is None else Fitted.of(setting.data, believed, beyond)
        return Proposals(self.label, x, predicted, spread, seed, fitted=fitted, noisy=noisy, beyond=beyond)


def check_asked(n: int, seeds: Sequence[int]) -> None:
    """Refuses an invalid number of proposals and invalid seeds.

    Raises:
        UserError: n is below 1, there is no seed, or one is not in 0 .. 2^32 - 1.
    """
    if n < 1:
        raise UserError(f"n must be 1 or more, got {n}")
    if not seeds or min(seeds) < 0 or max(seeds) >= 2**32:
        raise UserError(f"seeds must be 0 .. 2^32 - 1 and at least one, got {list(seeds)}")


def starts(data: Designs, n: int, worst: bool = False) -> Float[Array, "n z"]:
    """Coordinates of the n best designs of the data, or the worst, and of random points near them if there are fewer."""
    view, rows = data.coordinates, data.best(min(n, len(data)), worst)
    x = view.encode(data.x[np.resize(rows, n)])
    away = np.random.default_rng(0).standard_normal(x[len(rows) :].shape)
    x[len(rows) :] = np.clip(x[len(rows) :] + AROUND * away, view.low, view.high)
    if data.rules.fixed:
        x = np.clip(x, *view.bounds)
    return jnp.asarray(x)
