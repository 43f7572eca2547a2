"""Further inputs of an online run: a run on a log that it continues, and a log in its replay."""

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.agents.agent import Agent
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.online.mixed import check_bounds, check_sizes
from deadreckon.runs.folder import Folder
from deadreckon.runs.holdout import divided
from deadreckon.runs.lanes import agents_of
from deadreckon.runs.reading import ENCODED, HORIZON, Read, read_like
from deadreckon.runs.run import Run, load
from deadreckon.tasks.registry import of_run
from deadreckon.tasks.task import Task
from deadreckon.training.checkpoint import checkpoints, load_arrays, load_tree


class Start(NamedTuple):
    """A run on a log that an online run continues.

    Attributes:
        run: the run.
        agents: one per seed, with the settings of training on the log.
        checkpoint: of its last update.
        lanes: the lanes of this run in the checkpoint.
    """

    run: Run
    agents: list[Agent]
    checkpoint: Path
    lanes: slice

    def states(self, like: Any) -> Any:
        """The states (lanes, ...) after its last update: networks, targets and optimisers.

        Args:
            like: states of the same shapes.

        Raises:
            UserError: the agent that continues it has other networks.
        """
        return load_tree(self.checkpoint, like, self.lanes)[0]

    @property
    def log(self) -> dict[str, Any]:
        """The record of its training log, as in `Beside.told`."""
        data, task = self.run.config["data"], self.run.config["task"]
        path = (data.get("provenance") or {}).get("path")
        known = {name: data.get(name) for name in ("name", "fingerprint", "holdout")}
        return known | {"path": path, "task": task}

    @property
    def read(self) -> Read:
        """How its training log was read."""
        return Read.of(self.run.config["data"].get("provenance"), None, None)

    @property
    def told(self) -> dict[str, Any]:
        """The record for `run.json`: its path, its updates, and a hash of its states."""
        arrays, _ = load_arrays(self.checkpoint)
        content = hashlib.blake2b(digest_size=8)
        for name, array in sorted(arrays.items()):
            content.update(name.encode())
            content.update(np.ascontiguousarray(array[self.lanes]).tobytes())
        return {"path": str(self.run.path), "updates": self.run.config["steps"], "states": content.hexdigest()}


def start_of(given: object) -> Start:
    """A run to continue.

    Args:
        given: the run, or its folder.

    Raises:
        UserError: it is no finished run on a log, one of its seeds failed, or it acts on histories.
    """
    if not isinstance(given, Run | Path | str):
        raise UserError(f"start takes a run or its folder, got {given!r}")
    run = given if isinstance(given, Run) else load(given)
    config = run.config
    if "online" in config:
        raise UserError(f"{run.path} is an online run already; --resume with more --steps continues it")
    if config.get("history", 1) > 1:
        raise UserError(f"{run.path} acts on the last {config['history']} observations, which online runs do not keep")
    for seed, failure in zip(run.seeds, run.failures):
        if failure is not None:
            raise UserError(f"seed {seed} of {run.path} failed at update {failure.step}; train it again before continuing it")
    together = config.get("together")
    folder = Folder(run.path.parent if together else run.path).checkpoints
    found = [path for step, path in checkpoints(folder) if step == config["steps"]]
    if not found:
        raise UserError(f"{folder} has no checkpoint of update {config['steps']:,}, the last of {run.path}")
    first = together.index(run.path.name) * len(run.seeds) if together else 0
    return Start(run, agents_of(config), found[0], slice(first, first + len(run.seeds)))


class Beside(NamedTuple):
    """A log in the replay of an online run.

    Attributes:
        log: its training episodes.
        taught, held: `episode_ids` of these, and of the held-out episodes.
        told: the record for `run.json`.
        read: the record of how it was read, also for `run.json`.
    """

    log: Dataset
    taught: np.ndarray
    held: np.ndarray
    told: dict[str, Any]
    read: dict[str, Any]


def beside(
    given: Dataset | str | Path | None, before: dict[str, Any] | None, read: Read, task: Task, share: float
) -> Beside | None:
    """The log in the replay: the given one, or the one of the earlier run; None if there is neither.

    Episodes that were held out before stay held out.

    Args:
        given: the log, the name of a known one, or a file.
        before: the record of the log that it must be, as in `Beside.told`; None: any log.
        read: how it was read before; tables are read with the same schema again.
        task: the task of the online run.
        share: of the log in each batch.

    Raises:
        UserError: it is another log than before, or of another task's sizes.
    """
    if given is None and before is None:
        return None
    known = before or {"task": task.name, "holdout": None}
    source = given if given is not None else known["path"] or known["name"]
    log = source if isinstance(source, Dataset) else read_like(known.get("name", str(source)), read, source)
    check_sizes(log, task)
    bounds = known["task"]
    judge = None if bounds is None else task if bounds == task.name else of_run(bounds)
    if judge is not None:
        log = log.with_action_space(judge.action_space)
    if log.fingerprint != known.get("fingerprint", log.fingerprint):
        learned = f"{known['name']} ({known['fingerprint']}), the log of the run"
        raise UserError(f"{log.name} is another log ({log.fingerprint}) than {learned}; give that one as data")
    part = divided(log, None, judge, {"data": known})
    check_bounds(part.learning, task)
    told = {
        "name": log.name, "fingerprint": log.fingerprint, "rows": len(part.learning), "episodes": part.learning.episodes,
        "path": log.provenance.path, "task": bounds, "holdout": part.told, "share": share,
    }  # fmt: skip
    extra = {key: value for key, value in log.provenance.extra.items() if key in ("schema", HORIZON, *ENCODED)}
    return Beside(part.learning, part.taught, part.held, told, {"extra": extra, "path": log.provenance.path})
