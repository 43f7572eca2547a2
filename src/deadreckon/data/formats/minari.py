"""Minari data sets: read from a folder or by id, and written, under `MINARI_DATASETS_PATH`."""

import contextlib
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.columns import extra_name
from deadreckon.data.dataset import Dataset
from deadreckon.data.environments import environment_of
from deadreckon.data.formats.build import build
from deadreckon.data.formats.flatten import bounds, flatten_space, join_actions
from deadreckon.data.formats.header import Header
from deadreckon.data.formats.minari_ids import METADATA, PREFIX, ROOT, checked_id, find, root
from deadreckon.data.formats.minari_rows import buffers, spaces_of
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError, naming, reading
from deadreckon.files import alone, read_json
from deadreckon.names import safe_name
from deadreckon.temporaries import beside, put, recover

_KEPT = ("dataset_id", "algorithm_name", "code_permalink", "ref_min_score", "ref_max_score", "minari_version")


def read_minari(source: Path | str, *, strict: bool = False, name: str | None = None) -> Dataset:
    """Reads a Minari data set.

    Of observations that are dicts with an array called `observation`, that is the observation, and the rest (such as
    `desired_goal`) and the infos become extras. Other dicts, tuples, and discrete observations are flattened as Gymnasium does
    it, discrete ones one-hot; what each dimension is goes to `provenance.extra["observation_names"]`. Actions of several
    integers are joined into one, whose integers are in `provenance.extra["action_levels"]`. Terminations are terminals,
    truncations timeouts.

    Args:
        source: its folder, or its id, such as `minari:D4RL/pointmaze/umaze-v2`; `minari:` may be left out if it is here.
        strict: refuse actions out of bounds.
        name: of the log; what the data set says, else the id without its namespace, if absent.

    Raises:
        UserError: one line with the folder, the episode and what is wrong.
    """
    folder = find(source)
    metadata = read_json(folder / METADATA)
    if not isinstance(metadata, dict) or "data_format" not in metadata:
        raise UserError(f"{folder / METADATA}: no data_format; is this a Minari data set?")
    from minari.dataset.minari_storage import MinariStorage

    broken = (ValueError, KeyError, TypeError, RuntimeError, AssertionError, NotImplementedError)
    with reading(folder, "a Minari data set", *broken), naming(folder, ""):
        storage = MinariStorage.read(folder)
        extra = {key: metadata[key] for key in _KEPT if key in metadata}
        parts: dict[str, list[np.ndarray]] = {}
        for episode in storage.get_episodes(range(storage.total_episodes)):
            for key, column in _episode(episode, storage.observation_space, extra).items():
                parts.setdefault(key, []).append(column)
        if not parts:
            raise UserError("the data set has no episodes")
        columns = _joined(parts)
        space, lines = _actions(storage.action_space, columns, extra)
    about = metadata.get("deadreckon")
    header = None if about is None else Header.from_json(folder / METADATA, about)
    if name is None and header is None:
        name = str(metadata.get("dataset_id", folder.parent.name)).rpartition("/")[2]
    return build(
        folder, columns, header, source="minari", name=name, action_space=space, extra=extra, strict=strict, warnings=lines
    )


def write_minari(log: Dataset, dataset_id: str, *, force: bool = False) -> Path:
    """Writes `log` as a local Minari data set and gives its folder. Extras become infos.

    Where the log's environment is known (`data.environments`), the data set names it, so that Minari's `recover_environment`
    opens it, and has its bounds of observations, widened where a row is beyond them. Actions that were joined or counted from 0
    for the log are written as the environment takes them.

    Minari has no way to say that an episode's final observation is unknown: the last row of such an episode is left
    out, and its observation becomes the final one.

    Args:
        log: whose next observations are the following rows'.
        dataset_id: such as `mine/pointmaze-v0`; a namespace needs two letters or more.
        force: replace a data set of this id.

    Raises:
        UserError: the id is not one, or exists; a column's name would be a path; or the log has next observations of its own.
    """
    from minari import create_dataset_from_buffers

    dataset_id = checked_id(dataset_id.removeprefix(PREFIX))
    if log.successors is not None:
        raise UserError(f"{log.name}: its next observations are not the following rows; Minari cannot store it, write .hdf5")
    for key in log.extras:
        safe_name(key, f"{PREFIX}{dataset_id}: column")
    target = root() / dataset_id
    recover(target)
    if target.exists() and not force:
        raise UserError(f"{target} exists already; --force replaces it")
    if target.exists() and not (target / "data" / METADATA).is_file():
        raise UserError(f"{target} is a folder that holds no Minari data set, so it is not replaced; choose another id")
    environment = environment_of(log)
    observation_space, action_space = spaces_of(log, environment)
    try:
        root().mkdir(parents=True, exist_ok=True)
        with alone(target, what=str(target)), beside(root() / target.name, folder=True) as scratch:
            with _root_is(str(scratch)), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that there is no author, code link, ...
                made = create_dataset_from_buffers(
                    dataset_id,
                    buffer=list(buffers(log)),
                    observation_space=observation_space,
                    action_space=action_space,
                    algorithm_name=log.provenance.recipe or log.provenance.source,
                    jpeg_encoding=False,
                )
                known = {} if environment is None else {"env_spec": environment.spec}
                made.storage.update_metadata({"deadreckon": Header.of(log).to_json(), **known})
            # Namespaces on the way have a description each, which Minari wants to see.
            for parent in Path(dataset_id).parents:
                note = Path(scratch, parent, "namespace_metadata.json")
                (root() / parent).mkdir(parents=True, exist_ok=True)
                if note.exists() and not (root() / parent / note.name).exists():
                    shutil.copy(note, root() / parent / note.name)
            put(scratch / dataset_id, target)
    except (OSError, ValueError) as error:
        raise UserError(f"cannot write {target}: {' '.join(str(error).split())}") from error
    return target


@contextlib.contextmanager
def _root_is(folder: str) -> Iterator[None]:
    """Minari writes below `folder` meanwhile, so that a data set appears in its real root only when complete."""
    before = os.environ.get(ROOT)
    os.environ[ROOT] = folder
    try:
        yield
    finally:
        if before is None:
            del os.environ[ROOT]
        else:
            os.environ[ROOT] = before


def _actions(space: Any, columns: dict[str, np.ndarray], extra: dict[str, Any]) -> tuple[Box | Discrete | None, list[str]]:
    """Our action space, None where the bounds are not finite, and what to say; `columns["actions"]` become actions of it."""
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
    """(T + 1, *shape) observations of an episode, and what else came with them."""
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
        # Infos and goals come with every observation, the first of reset included: those at action time are kept.
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
