"""The episodes of a Minari data set as columns, read in a separate process: damaged HDF5 files can hang the library."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from deadreckon.data.columns import extra_name
from deadreckon.data.formats.flatten import bounds, flatten_space, join_actions
from deadreckon.data.formats.hdf5_inside import datasets_of
from deadreckon.data.spec import Box, Discrete, action_space_to_json
from deadreckon.errors import UserError, reading
from deadreckon.foreign.limits import UNPACKED, beyond, max_unpacked
from deadreckon.foreign.reader import alive


def contents(folder: str, said: dict[str, Any], shared: Any) -> dict[str, Any]:
    """The columns of a data set.

    Args:
        folder: of its files, which holds metadata.json.
        said: known metadata, for the provenance.
        shared: not used, because columns are assembled in memory.

    Returns:
        `columns`; `extra`: `said` with further metadata; `space` of the actions as JSON values, or None; `told`: messages.

    Raises:
        UserError: one line with the episode and what is wrong.
    """
    from minari.dataset.minari_storage import MinariStorage

    path, extra = Path(folder), dict(said)
    size = 0
    for file in path.rglob("*.hdf5"):
        size += file.stat().st_size
        with reading(file, "hdf5"), h5py.File(file, "r") as opened:
            list(datasets_of(file, opened))  # refuses what lies in another file
    most, taken = max_unpacked(size), 0
    storage = MinariStorage.read(path)
    parts: dict[str, list[np.ndarray]] = {}
    for episode in storage.get_episodes(range(storage.total_episodes)):
        for key, column in _episode(episode, storage.observation_space, extra).items():
            parts.setdefault(key, []).append(column)
            taken += column.nbytes
        if taken > most:
            raise beyond(path, taken, most, UNPACKED, "unpacks to")
        alive()
    if not parts:
        raise UserError("the data set has no episodes")
    columns = _joined(parts)
    space, lines = _actions(storage.action_space, columns, extra)
    return {"columns": columns, "extra": extra, "space": None if space is None else action_space_to_json(space), "told": lines}


def _actions(space: Any, columns: dict[str, np.ndarray], extra: dict[str, Any]) -> tuple[Box | Discrete | None, list[str]]:
    """The action space of the log, None if bounds are not finite, and messages; `columns["actions"]` are converted to it."""
    from gymnasium import spaces

    if isinstance(space, spaces.Discrete):
        columns["actions"] = columns["actions"] - int(space.start)
        return Discrete(int(space.n)), []
    if isinstance(space, (spaces.MultiDiscrete, spaces.MultiBinary)):
        columns["actions"], joined, extra["action_levels"] = join_actions(space, columns["actions"])
        return joined, [f"actions of {space} are joined into {joined.n} discrete ones, one for each combination"]
    if not isinstance(space, spaces.Box):
        raise UserError(f"actions are {type(space).__name__}; Box, Discrete, MultiDiscrete or MultiBinary is needed")
    return bounds(space), []


def _observations(space: Any, values: Any, extra: dict[str, Any]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """(T + 1, *shape) observations of an episode, and further arrays in their dict."""
    from gymnasium import spaces

    if isinstance(space, spaces.Box):
        return np.asarray(values), {}
    if isinstance(space, spaces.Dict) and isinstance(space.spaces.get("observation"), spaces.Box):
        further = dict(_leaves(values, ""))
        return further.pop("observation"), further
    column, extra["observation_names"] = flatten_space(space, values)
    return column, {}


def _episode(episode: Mapping[str, Any], space: Any, extra: dict[str, Any]) -> dict[str, np.ndarray]:
    """Columns of one episode, T rows each; extras under their Minari paths."""
    number, steps = episode["id"], len(episode["rewards"])
    if not steps:
        raise UserError(f"episode {number} has no steps")
    main, observed = _observations(space, episode["observations"], extra)
    if isinstance(episode["actions"], (dict, tuple)):
        raise UserError("actions are a dict or a tuple; one array is needed")
    if len(main) != steps + 1:
        raise UserError(f"episode {number} has {len(main)} observations for {steps} steps, {steps + 1} are needed")
    columns = {"observations": main[:-1], "next_observations": main[1:], "actions": np.asarray(episode["actions"]),
               "rewards": episode["rewards"], "terminals": episode["terminations"]}  # fmt: skip
    timeouts = np.array(episode["truncations"], bool)
    timeouts[-1] |= not columns["terminals"][-1]
    columns["timeouts"] = timeouts
    for key, value in (*observed.items(), *_leaves(episode["infos"] or {}, "infos/")):
        # Infos and goals are given for every observation, including that of the reset: those at the action are kept.
        if value.dtype.kind in "fiub" and value.ndim and len(value) in (steps, steps + 1):
            columns[key if key.startswith("infos/") else f"observation/{key}"] = value[:steps]
    return columns


def _leaves(value: Any, prefix: str) -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, f"{prefix}{key}" if not isinstance(inner, Mapping) else f"{prefix}{key}/")
    elif isinstance(value, (tuple, list)):
        raise UserError("observations are a tuple or texts; an array, or a dict with one called observation, is needed")
    else:
        yield prefix, np.asarray(value)


def _joined(parts: dict[str, list[np.ndarray]]) -> dict[str, np.ndarray]:
    episodes = len(parts["actions"])
    columns: dict[str, np.ndarray] = {}
    for key, values in parts.items():
        if len(values) == episodes and len({value.shape[1:] for value in values}) == 1:
            own = "/" not in key
            place = key if own else extra_name(key.removeprefix("observation/"), columns)
            columns[place] = np.concatenate(values)
        elif "/" not in key:
            raise UserError(f"{key} have different shapes in different episodes")
    return columns
