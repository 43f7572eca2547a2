"""Rows of replay files: what they hold, and a log made of them."""

from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Discrete
from deadreckon.tasks.task import Task
from deadreckon.training.replay import read_rows


def unpacked(rows: Any, shapes: dict[str, tuple[int, ...]]) -> dict[str, Any]:
    """Columns (*b, *shape) of rows (*b, w) that hold them one after the other."""
    edges = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    parts = zip(shapes.items(), edges, edges[1:])
    return {name: rows[..., start:end].reshape(*rows.shape[:-1], *shape) for (name, shape), start, end in parts}


def row_columns(task: Task) -> dict[str, tuple[int, ...]]:
    """What a row of a replay file holds, in this order."""
    shape = task.observation_shape
    action = () if isinstance(task.action_space, Discrete) else (task.action_space.size,)
    return {"observation": shape, "action": action, "reward": (), "next_observation": shape, "terminal": (), "timeout": ()}


def row_width(task: Task) -> int:
    """Numbers in a row of a replay file."""
    return sum(int(np.prod(shape)) for shape in row_columns(task).values())


def replay_log(path: Path, task: Task, copies: int, steps: int, *, name: str, provenance: Provenance) -> Dataset:
    """The first `steps` rows of a replay file as a log: the copies' episodes one after the other, copy by copy."""
    rows = read_rows(path, row_width(task), steps)
    rows = np.concatenate([np.asarray(rows[copy::copies]) for copy in range(copies)])
    columns = unpacked(rows, row_columns(task))
    terminals, timeouts = columns["terminal"] > 0, columns["timeout"] > 0
    timeouts[_last_rows(steps, copies)] = True  # an episode that the recording cut
    timeouts &= ~terminals
    ends = terminals | timeouts
    return Dataset.from_arrays(
        observations=columns["observation"], actions=columns["action"], rewards=columns["reward"], terminals=terminals,
        timeouts=timeouts, final_observations=columns["next_observation"][ends], action_space=task.action_space, name=name,
        provenance=provenance,
    )  # fmt: skip


def _last_rows(steps: int, copies: int) -> np.ndarray:
    """(copies,) index of each copy's last row once the copies' rows lie one after the other."""
    return np.cumsum([len(range(copy, steps, copies)) for copy in range(copies)]) - 1
