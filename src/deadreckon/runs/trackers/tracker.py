"""The protocol of experiment trackers, the available trackers, and their names."""

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from deadreckon.errors import UserError, extra, unknown
from deadreckon.imports import imported

# name on the command line: (module beside this one, class)
TRACKERS = {
    "tensorboard": ("tensorboard", "TensorBoard"),
    "wandb": ("wandb_runs", "WandB"),
    "mlflow": ("mlflow_runs", "MLflow"),
}
_METHODS = ("start", "log", "finish")


class Tracker(Protocol):
    """Shows a run in another program during training.

    The run folder is the record and a tracker holds a copy of it. All three methods are called from one thread at a time, `log`
    in ascending order of steps. An interrupted run sends all of its points again when it is resumed: a tracker that stores them
    elsewhere adds those that it does not have yet, so that none is duplicated.
    """

    def start(self, config: Mapping[str, Any]) -> None:
        """Starts or continues the tracked run.

        Args:
            config: the contents of `run.json` (agent, data, task, seeds, steps, versions), and `folder`, the run folder,
                `name`, its last two parts, and `id`, a text that identifies the run and stays the same when it is resumed.
        """
        ...

    def log(self, step: int, seed: int, metrics: Mapping[str, float]) -> None:
        """Takes one point.

        Args:
            step: updates done.
            seed: random seed of the lane.
            metrics: `train/NAME` is a mean over a chunk of updates, `evaluation/NAME` one over the episodes of an evaluation.
        """
        ...

    def finish(self, files: Sequence[Path] | None) -> None:
        """Ends the tracked run.

        Args:
            files: files to store, `run.json` and the last policies; None: the run was interrupted and may be resumed.
        """
        ...


def trackers_of(track: Any, runs: int) -> list[list[Tracker]]:
    """The trackers of each of several runs that share a program.

    Args:
        track: a name among `TRACKERS`, `module:Class`, a class or an object with the methods of `Tracker`, several of these, or
            None.
        runs: how many there are.

    Raises:
        UserError: no such tracker, one whose package is not installed, or one object for several runs.
    """
    given = [] if track is None else list(track) if isinstance(track, Sequence) and not isinstance(track, str) else [track]
    makers = [_class(each) if isinstance(each, str) else each for each in given]
    for each in makers:
        if missing := [name for name in _METHODS if not callable(getattr(each, name, None))]:
            raise UserError(f"a tracker needs the methods {', '.join(_METHODS)}; {each!r} has no {missing[0]}")
        if runs > 1 and not isinstance(each, type):
            raise UserError(f"{runs} runs share a program, and each needs a tracker of its own: give the class of {each!r}")
    return [[each() if isinstance(each, type) else each for each in makers] for _ in range(runs)]


def _class(name: str) -> Any:
    if ":" in name:
        if (found := imported(name, "tracker", "Class")) is None:
            raise UserError(f"tracker {name}: the module has no such class")
        return found
    if name not in TRACKERS:
        raise unknown("tracker", name, TRACKERS)
    module, attribute = TRACKERS[name]
    return getattr(importlib.import_module(f"deadreckon.runs.trackers.{module}"), attribute)


def needed(module: str) -> Any:
    """A tracker's package.

    Raises:
        UserError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UserError(f"tracking needs {module}, which is not installed: {extra('track')}") from error


def files_of(seed: int, files: Sequence[Path]) -> list[Path]:
    """Those of a run's files that are of one seed, or of all."""
    return [path for path in files if not path.stem.startswith("seed") or path.stem == f"seed{seed}"]
