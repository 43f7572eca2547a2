"""Logs as pickles: a dict of D4RL's columns, or a list of such dicts, one per episode, as in Adroit's demonstrations."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.columns import COLUMNS, LOG_PROBS, MASKS, NEEDED
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.arrange import ENDS, arranged, as_array
from deadreckon.data.formats.build import build, stem
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.unpickle import ObjectDouble, PlainUnpickler, unpickle

_COUNT = {*COLUMNS, *MASKS, *ENDS, LOG_PROBS}  # names of columns that must not be dropped
_BUFFERS = ("ReplayBuffer", "DictReplayBuffer")  # of Stable-Baselines3


class _Ignored(ObjectDouble):
    """A placeholder for an object that no log needs, such as a random number generator."""

    def __init__(self, *given: Any):
        super().__init__()

    def __setstate__(self, state: Any) -> None:
        pass


class BufferUnpickler(PlainUnpickler):
    """Also reads Stable-Baselines3's replay buffers and Gymnasium's spaces, as placeholders that hold their fields."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        """The placeholder for a class that the pickle names; other classes are refused."""
        if module_name == "stable_baselines3.common.buffers" and global_name in _BUFFERS:
            return ObjectDouble
        if module_name.startswith(("gymnasium.spaces.", "gym.spaces.")):
            return ObjectDouble
        if (module_name, global_name) == ("torch", "device") or module_name.startswith("numpy.random."):
            return _Ignored
        return super().find_class(module_name, global_name)


def read_pickle(path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None) -> Dataset:
    """Reads a pickled log: a dict of D4RL's columns or in another library's layout, a list of dicts of D4RL's columns, one per
    episode, or a replay buffer of Stable-Baselines3.

    The human demonstrations of Adroit (dicts with `init_state_dict`, which is not kept) have T observations for T
    actions, so the last row of each episode has no known successor; their actions are bounded by -1 and 1, and
    `door-v0_demos.pickle` is called `door-human`.

    Raises:
        UserError: one line that names file, episode, column and row.
    """
    value = unpickle(path, "log")
    if isinstance(value, Mapping):
        found = arranged(path, value)
        columns = _columns(path, found.columns)
        return build(
            path, columns, source="pickle", name=name, action_space=found.space, extra=found.extra, strict=strict,
            horizon=horizon, warnings=found.told,
        )  # fmt: skip
    if not isinstance(value, list) or not value or not all(isinstance(episode, Mapping) for episode in value):
        raise UserError(f"{path}: a list of episodes (dicts of arrays) is needed, found {type(value).__name__}")
    columns = _joined(path, value)
    adroit = "init_state_dict" in value[0]
    space = None
    if adroit:
        size = columns["actions"].shape[-1]
        space = Box((-1.0,) * size, (1.0,) * size)
    if name is None:
        name = stem(path)
        task, _, rest = name.partition("-v0_")
        name = f"{task}-human" if adroit and rest == "demos" else name
    source = "adroit-demonstrations" if adroit else "pickle"
    return build(path, columns, source=source, name=name, action_space=space, strict=strict, horizon=horizon)


def _columns(path: Path | str, given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The columns of a dict: its arrays, and those of its lists that are main columns or have a number for each action."""
    found = {key: as_array(value) if isinstance(value, list) else value for key, value in given.items() if value is not None}
    for key in sorted(_COUNT & found.keys()):
        if not isinstance(found[key], np.ndarray):
            raise UserError(f"{path}: column {key} is no array of numbers in which every row has the same shape")
    arrays = {key: value for key, value in found.items() if isinstance(value, np.ndarray)}
    rows = arrays["actions"].shape[:1] if "actions" in arrays else None
    lists = {key for key in arrays.keys() - _COUNT if isinstance(given[key], list)}
    return {key: a for key, a in arrays.items() if key not in lists or (a.dtype.kind in "fiub" and a.shape[:1] == rows)}


def _joined(path: Path | str, episodes: list[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Columns of all episodes, one after another, with a timeout at the end of each that has no terminal there."""
    keys = [key for key in COLUMNS if not key.startswith("final_") and key in episodes[0]]
    for number, episode in enumerate(episodes):
        for key in sorted(ENDS & episode.keys() - set(keys)):
            call = "all need the same" if key in COLUMNS else "call it terminals (the task ended) or timeouts (a time limit)"
            raise UserError(f"{path}: episode {number} has {key}, which is not read; {call}")
        for key in dict.fromkeys((*NEEDED, *keys)):
            if not isinstance(episode.get(key), np.ndarray) or not episode[key].ndim:
                raise UserError(f"{path}: episode {number} has no array {key}")
        for key in keys:
            if len(episode[key]) != len(episode["actions"]):
                have = f"{len(episode[key])} {key} and {len(episode['actions'])} actions"
                raise UserError(f"{path}: episode {number} has {have}; equally many are needed")
        if not len(episode["actions"]):
            raise UserError(f"{path}: episode {number} has no steps")
    columns: dict[str, np.ndarray] = {}
    for key in keys:
        try:
            columns[key] = np.concatenate([episode[key] for episode in episodes])
        except ValueError as error:
            raise UserError(f"{path}: column {key} has another shape in some episode ({error})") from error
    last = np.cumsum([len(episode["actions"]) for episode in episodes]) - 1
    rows = len(columns["actions"])
    timeouts = np.asarray(columns.get("timeouts", np.zeros(rows)), bool).reshape(rows)
    timeouts[last] |= ~np.asarray(columns.get("terminals", np.zeros(rows)), bool).reshape(rows)[last]
    return {**columns, "timeouts": timeouts}
