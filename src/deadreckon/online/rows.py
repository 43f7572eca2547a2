"""Rows of replay files: their columns, and logs made of them."""

from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError
from deadreckon.tasks.task import Task
from deadreckon.training.replay import read_rows


def unpacked(rows: Any, shapes: dict[str, tuple[int, ...]]) -> dict[str, Any]:
    """Columns (*b, *shape) of rows (*b, w) that hold them one after the other."""
    edges = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    parts = zip(shapes.items(), edges, edges[1:])
    return {name: rows[..., start:end].reshape(*rows.shape[:-1], *shape) for (name, shape), start, end in parts}


def row_columns(task: Task) -> dict[str, tuple[int, ...]]:
    """The columns of a row of a replay file, in order, with their shapes."""
    shape = task.observation_shape
    action = () if isinstance(task.action_space, Discrete) else (task.action_space.size,)
    return {"observation": shape, "action": action, "reward": (), "next_observation": shape, "terminal": (), "timeout": ()}


def row_width(task: Task) -> int:
    """Numbers in a row of a replay file."""
    return sum(int(np.prod(shape)) for shape in row_columns(task).values())


def replay_log(path: Path, task: Task, copies: int, steps: int, *, name: str, provenance: Provenance) -> Dataset:
    """The first `steps` rows of a replay file as a log: the copies' episodes one after the other, copy by copy.

    Raises:
        UserError: the file is missing or too short.
    """
    rows = read_rows(path, row_width(task), steps)
    rows = np.concatenate([np.asarray(rows[copy::copies]) for copy in range(copies)])
    return _log(rows, _last_rows(steps, copies), task, name, provenance)


def episodes_log(
    path: Path, task: Task, copies: int, steps: int, episodes: int, *, name: str, provenance: Provenance
) -> Dataset:
    """Whole episodes of a replay file, evenly spaced over its first `steps` rows: of a task whose episodes only time out.

    Args:
        path: of the file.
        task: where its rows come from.
        copies: number of environments, whose rows are interleaved.
        steps: rows of the file that count: a multiple of the copies' episodes.
        episodes: number of episodes, in their order; two or more include the first and the last.
        name: of the log.
        provenance: of the log.

    Raises:
        UserError: the file is missing or too short, or its episodes do not end together, each at the horizon.
    """
    horizon = task.horizon
    rows = read_rows(path, row_width(task), steps)
    marked = unpacked(rows, row_columns(task))
    ended = (np.asarray(marked["timeout"]) + np.asarray(marked["terminal"]) > 0).reshape(-1, horizon, copies)
    if not ended[:, -1].all() or ended[:, :-1].any():
        raise UserError(f"{path}: episodes do not all end after {horizon} steps of their copy, so none can be taken out of it")
    chosen = np.linspace(0, steps // horizon - 1, episodes).round().astype(int)  # numbered as they came, copies in order
    first = chosen // copies * horizon * copies + chosen % copies
    index = (first[:, None] + np.arange(horizon) * copies).reshape(-1)
    return _log(np.asarray(rows[index]), np.arange(1, episodes + 1) * horizon - 1, task, name, provenance)


def _log(rows: np.ndarray, cut: np.ndarray, task: Task, name: str, provenance: Provenance) -> Dataset:
    """A log of consecutive rows; `cut`: those after which the recording was cut off, if no episode ends there."""
    columns = unpacked(rows, row_columns(task))
    terminals, timeouts = columns["terminal"] > 0, columns["timeout"] > 0
    timeouts[cut] = True
    timeouts &= ~terminals
    ends = terminals | timeouts
    return Dataset.from_arrays(
        observations=columns["observation"], actions=columns["action"], rewards=columns["reward"], terminals=terminals,
        timeouts=timeouts, final_observations=columns["next_observation"][ends], action_space=task.action_space, name=name,
        provenance=provenance,
    )  # fmt: skip


def _last_rows(steps: int, copies: int) -> np.ndarray:
    """(copies,) index of each copy's last row if the copies' rows are ordered copy by copy."""
    return np.cumsum([len(range(copy, steps, copies)) for copy in range(copies)]) - 1
