"""The fits of a case: made once, resumed from checkpoints, and checked for convergence."""

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from deadreckon.data.batch import TransitionSource
from deadreckon.files import alone, read_json, write_json
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.settings import FitSettings
from deadreckon.training.checkpoint import folder_of
from deadreckon.training.fit import Chunk, Fit, complete
from deadreckon.training.hyperparameters import described, on_device
from deadreckon.training.learner import lane_of

BLOCK = 65_536  # rows at a time
SETTLED = 0.05  # relative change of a fit's metric over its last fifth above which a warning is given
REVISION = 2  # of the metrics that a finished fit keeps; checkpoints of another one are not taken up


class _Kept(TypedDict):
    """The metrics of a fit, as stored in a file."""

    metrics: list[tuple[int, dict[str, float]]]


class Fits:
    """Fits of one log and set of policies.

    Args:
        estimand: of the fits.
        settings: random seed, folder of checkpoints, and the function that is called during a fit.

    Raises:
        UserError: a seed out of range.
    """

    def __init__(self, estimand: Estimand, settings: FitSettings):
        settings.check_values()
        self.estimand, self.seed, self.watch = estimand, settings.seed, settings.watch
        self.out = None if settings.out is None else Path(settings.out)
        self._kept: dict[Any, Any] = {}
        self._metrics: dict[str, dict[int, dict[str, float]]] = {}  # of each fit, by number of updates

    @cached_property
    def policies_digest(self) -> str:
        """Identifies the set of policies."""
        raise NotImplementedError

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """The result of `make`, computed once."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def train(self, learner: Any, rows: TransitionSource, steps: int, what: str) -> Any:
        """The state of a learner after `steps` updates, resumed from its checkpoints if there are any.

        Raises:
            DivergedError: it diverged (NaN or infinite numbers).
            BusyError: another process does the same fit.
        """
        folder = None if self.out is None else self._folder(learner, rows, steps, what)
        with contextlib.nullcontext() if folder is None else alone(folder, f"fits {what} already"):
            return self._train(learner, rows, steps, what, folder)

    def _train(self, learner: Any, rows: TransitionSource, steps: int, what: str, folder: Path | None) -> Any:
        job = Fit([learner], rows, [self.seed], steps, chunk=max(1, min(1000, steps // 10)), folder=folder)
        kept = None if folder is None else folder / "metrics.json"
        known = read_json(kept, _Kept)["metrics"] if kept is not None and kept.exists() else []
        seen = self._metrics[what] = {step: metrics for step, metrics in known}

        def told(progress: Chunk) -> None:
            # After an interruption, updates since the last checkpoint are done again, and their metrics replaced.
            seen[progress.step] = {name: float(value[0]) for name, value in progress.metrics.items()}
            if kept is not None:  # for later calls, which load the finished fit
                write_json(kept, {"metrics": list(seen.items())})
            self.watch(what, progress.step, steps)

        complete(job, what, told)
        return lane_of(job.states, 0)

    def _last_fifth(self, what: str) -> tuple[dict[int, dict[str, float]], int | None, int]:
        """The metrics of a fit by step, and the steps at which its last fifth begins and ends; None if it is not known."""
        seen = self._metrics.get(what, {})
        last = max(seen, default=0)
        return seen, max((step for step in seen if step <= 0.8 * last), default=None), last

    def convergence(self, what: str, names: Sequence[str]) -> tuple[np.ndarray, list[str]]:
        """Whether each policy's critics have converged, (policies,), and a warning if one's have not.

        They have where their mean value changed over the last fifth of the fit by at most 5 % of their root mean square, by
        `critics.sizes`; values around zero have no relative change.

        Args:
            what: the fit.
            names: of its policies.
        """
        seen, early, last = self._last_fifth(what)
        if early is None:
            return np.ones(len(names), bool), []
        of = lambda step, metric: np.array([seen[step][f"{metric} {i}"] for i in range(len(names))])  # noqa: E731
        change = np.abs(of(last, "q") - of(early, "q")) / np.maximum(of(last, "size"), 1e-12)
        settled, worst = change <= SETTLED, int(change.argmax())
        if settled.all():
            return settled, []
        found = f"the values of {names[worst]} by {100 * change[worst]:.0f} % over its last fifth"
        return settled, [f"{what} still changes: {found}; more than {last:,} updates are needed"]

    def convergence_warnings(self, what: str, metric: str) -> list[str]:
        """A warning if a metric of a fit still changed by more than 5 % over its last fifth, else nothing."""
        seen, early, last = self._last_fifth(what)
        if early is None:
            return []
        value, before = seen[last][metric], seen[early][metric]
        change = abs(value - before) / max(abs(value), abs(before), 1e-12)
        if change <= SETTLED:
            return []
        found = f"{metric} by {100 * change:.0f} % over its last fifth"
        return [f"{what} still changes: {found}; more than {last:,} updates are needed"]

    def _folder(self, learner: Any, rows: TransitionSource, steps: int, what: str) -> Path:
        """The folder of a fit's checkpoints, a different one for every log, set of policies and settings."""
        assert self.out is not None
        # Only these columns say which rows each model is trained on: they encode held-out episodes, clusters and folds.
        columns = {name: _digest(column) for name, column in {**rows.extra, **(rows.initial or {})}.items()}
        asked = {
            "learner": described(on_device(learner)), "steps": steps, "log": rows.log.fingerprint,
            "policies": self.policies_digest, "columns": columns, "estimand": self.estimand.as_json(), "seed": self.seed,
            "revision": REVISION,
        }  # fmt: skip
        return folder_of(self.out, what, asked)


def _digest(column: np.ndarray) -> str:
    """Hash of a column's shape, type and numbers, a block at a time, because the column may be memory-mapped."""
    found = hashlib.blake2b(f"{column.shape} {column.dtype}".encode(), digest_size=16)
    for start in range(0, len(column), BLOCK):
        found.update(np.ascontiguousarray(column[start : start + BLOCK]).tobytes())
    return found.hexdigest()
