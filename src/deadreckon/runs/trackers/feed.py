"""How trackers learn of a run: from its folder, in order, when a checkpoint has made sure of it."""

import contextlib
import math
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.foreign.parquet import read_parquet
from deadreckon.names import safe_name
from deadreckon.runs.folder import Folder
from deadreckon.runs.trackers.tracker import Tracker

NAME = "track.json"
_KEYS = ("step", "seed", "episode")


class _Told(TypedDict):
    """What trackers know a run by."""

    id: str


class Tracking:
    """Gives the points of one run to its trackers, by a thread of its own, so that no server holds training up.

    What fails in a tracker ends that tracker with a warning and not the run, whose folder has everything: when the run is
    resumed, its trackers get what they missed.
    """

    def __init__(self, folder: Folder, trackers: Sequence[Tracker]):
        self.folder, self.trackers = folder, list(trackers)
        self.waiting: list[int] = []
        self.pending: list[Future] = []
        self.problems: list[str] = []
        self.pool = ThreadPoolExecutor(1)
        self.started, self.seeds = False, []

    def start(self) -> None:
        """Starts the trackers and gives them what the folder has already."""
        known, path = self.folder, self.folder.path / NAME
        if not path.exists():
            write_json(path, {"id": uuid.uuid4().hex[:12]})
        whole = self.folder.path.absolute()
        known_id = safe_name(read_json(path, _Told)["id"], f"{path}: id")
        named = {"folder": str(whole), "name": "/".join(whole.parts[-2:]), "id": known_id}
        config = known.read_config() | named
        self.seeds, self.started = config["seeds"], True
        for tracker in self.trackers:
            try:
                tracker.start(config)
            except Exception as error:  # whatever it raises, the user is there to mend it
                why = " ".join(f"{type(error).__name__}: {error}".split())
                again = f"no update was made; --resume, or resume=True, continues {self.folder.path}"
                raise UserError(f"{type(tracker).__name__} cannot start: {why}; {again}") from error
        steps = {int(part.stem) for part in (whole / "metrics").glob("*.parquet")} | set(known.policy_steps())
        self.waiting = sorted(steps)

    def told(self, step: int) -> None:
        """A chunk has ended after `step` updates: points before it are certain now, since their checkpoint is on disk."""
        self._tell()
        self.pending.append(self.pool.submit(self._give, step, step))

    def finish(self, files: Sequence[Path] | None) -> None:
        """Gives what is left, where the run has ended, and finishes the trackers.

        Args:
            files: see `Tracker.finish`; None after an interruption.
        """
        if not self.started:
            return
        if files is not None:
            self.pending.append(self.pool.submit(self._give, None, math.inf))
        self.pool.shutdown(wait=True, cancel_futures=files is None)
        self._each(lambda tracker: tracker.finish(files))
        self._tell()

    def _tell(self) -> None:
        """Warns of what went wrong in the other thread."""
        for each in [each for each in self.pending if each.done()]:
            self.pending.remove(each)
            if not each.cancelled() and (error := each.exception()) is not None:
                self.problems.append(f"points of {self.folder.path} cannot be read and are not tracked: {error}")
        while self.problems:
            warnings.warn(self.problems.pop(0), stacklevel=4)

    def _each(self, call: Callable[[Tracker], Any]) -> None:
        for tracker in list(self.trackers):
            try:
                call(tracker)
            except Exception as error:  # noqa: BLE001 - a tracker may raise anything, and a run must not be lost by that
                self.trackers.remove(tracker)
                why = " ".join(f"{type(error).__name__}: {error}".split())
                name = type(tracker).__name__
                self.problems.append(f"{name} failed and gets no more points of {self.folder.path} ({why}); the run continues")

    def _give(self, new: int | None, below: float) -> None:
        """Gives all points of steps below a bound, as far as their evaluations are done."""
        if new is not None and new not in self.waiting:
            self.waiting.append(new)
        while self.waiting and self.waiting[0] < below and self._complete(self.waiting[0]):
            step = self.waiting.pop(0)
            for seed, point in self._points(step).items():
                self._each(lambda tracker, seed=seed, step=step, point=point: tracker.log(step, seed, point))

    def _complete(self, step: int) -> bool:
        judged = any(self.folder.policy(seed, step).exists() for seed in self.seeds)
        return not judged or self.folder.part("evaluations", step).exists()

    def _points(self, step: int) -> dict[int, dict[str, float]]:
        """What is known of each seed after `step` updates; without numbers that are not finite, for which `failed` stands."""
        points: dict[int, dict[str, float]] = {}
        for kind, prefix in (("metrics", "train"), ("evaluations", "evaluation")):
            path = self.folder.part(kind, step)
            table = read_parquet(path, "a table of a run").to_pydict() if path.exists() else {}
            seeds = np.asarray(table.get("seed", []))
            for seed in dict.fromkeys(seeds.tolist()):
                means = {
                    f"{prefix}/{name}": float(np.mean(np.asarray(column, float)[seeds == seed]))
                    for name, column in table.items() if name not in _KEYS
                }  # fmt: skip
                finite = {name: value for name, value in means.items() if math.isfinite(value)}
                if kind == "metrics" and len(finite) < len(means):
                    finite["train/failed"] = 1.0
                points.setdefault(seed, {}).update(finite)
        return points


@contextlib.contextmanager
def tracked(folders: Sequence[Folder], trackers: Sequence[Sequence[Tracker]]) -> Iterator[list[Tracking]]:
    """The trackings of runs, for those that have trackers; they end as the block does."""
    every = [Tracking(folder, own) for folder, own in zip(folders, trackers) if own]
    try:
        yield every
    except BaseException:
        for each in every:
            each.finish(None)
        raise
    for each in every:
        each.finish([each.folder.config, *map(each.folder.policy, each.seeds)])
