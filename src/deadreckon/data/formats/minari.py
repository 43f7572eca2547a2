"""Minari data sets: read from a folder or by id, and written, under `MINARI_DATASETS_PATH`."""

import os
import shutil
import warnings
from pathlib import Path

from deadreckon.data.dataset import Dataset
from deadreckon.data.environments import environment_of
from deadreckon.data.formats.build import build
from deadreckon.data.formats.header import Header
from deadreckon.data.formats.minari_ids import METADATA, PREFIX, ROOT, checked_id, find, root
from deadreckon.data.formats.minari_rows import buffers, spaces_of
from deadreckon.data.spec import action_space_from_json
from deadreckon.errors import UserError, cannot_write, naming
from deadreckon.files import alone, read_json
from deadreckon.foreign.child import read_apart
from deadreckon.foreign.door import file_size, refuse_links
from deadreckon.imports import environment_variable
from deadreckon.names import safe_name
from deadreckon.temporaries import beside, put, recover

_KEPT = ("dataset_id", "algorithm_name", "code_permalink", "ref_min_score", "ref_max_score", "minari_version")


def read_minari(source: Path | str, *, strict: bool = False, name: str | None = None) -> Dataset:
    """Reads a Minari data set.

    If observations are dicts with an array called `observation`, that is the observation, and the rest (such as `desired_goal`)
    and the infos become extras. Other dicts, tuples, and discrete observations are flattened as in Gymnasium, discrete ones
    one-hot; the names of the dimensions are in `provenance.extra["observation_names"]`. Actions of several integers are joined
    into one, whose integers are in `provenance.extra["action_levels"]`. Terminations are terminals, truncations timeouts.

    Args:
        source: its folder, or its id, such as `minari:D4RL/pointmaze/umaze-v2`; `minari:` may be left out if it is installed.
        strict: refuse actions out of bounds.
        name: of the log; that in the data set, else the id without its namespace, if absent.

    Raises:
        UserError: one line with the folder, the episode and what is wrong.
    """
    folder = find(source)
    metadata = read_json(folder / METADATA, dict)
    if "data_format" not in metadata:
        raise UserError(f"{folder / METADATA}: no data_format; is this a Minari data set?")
    for key in ("observation_space", "action_space"):
        # Without one of them Minari would create the environment that the file names, which can execute any code.
        if not isinstance(metadata.get(key), str):
            raise UserError(f"{folder / METADATA}: no {key}, which is needed as JSON; no environment is made to ask for it")
    said = {key: metadata[key] for key in _KEPT if key in metadata}
    with naming(folder, str(folder)):
        held = read_apart("minari", folder, "a Minari data set", size=_size(folder), folder=str(folder), said=said)
    columns, extra = held["columns"], held["extra"]
    space = None if held["space"] is None else action_space_from_json(held["space"])
    about = metadata.get("deadreckon")
    header = None if about is None else Header.from_json(folder / METADATA, about)
    if name is None and header is None:
        name = str(metadata.get("dataset_id", folder.parent.name)).rpartition("/")[2]
    return build(
        folder, columns, header, source="minari", name=name, action_space=space, extra=extra, strict=strict,
        warnings=held["told"],
    )


def write_minari(log: Dataset, dataset_id: str, *, force: bool = False) -> Path:
    """Writes `log` as a local Minari data set and returns its folder. Extras become infos.

    If the log's environment is known (`data.environments`), the data set names it, so that Minari's `recover_environment`
    opens it, and has its bounds of observations, widened to contain all rows. Actions that were joined or counted from 0 for
    the log are written as the environment takes them.

    Minari cannot mark the final observation of an episode as unknown: the last row of such an episode is left out, and its
    observation becomes the final one.

    Args:
        log: a log whose next observations are those of the following rows.
        dataset_id: such as `mine/pointmaze-v0`; a namespace needs two letters or more.
        force: replace a data set of this id.

    Raises:
        UserError: the id is not valid, or exists; a column's name would be a path; or the log has other next observations.
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
            # So that a data set appears in Minari's real root only when complete.
            with environment_variable(ROOT, str(scratch)), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # on the missing author, code link, ...
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
            # Minari needs a file with a description of each namespace in the id.
            for parent in Path(dataset_id).parents:
                note = Path(scratch, parent, "namespace_metadata.json")
                (root() / parent).mkdir(parents=True, exist_ok=True)
                if note.exists() and not (root() / parent / note.name).exists():
                    shutil.copy(note, root() / parent / note.name)
            put(scratch / dataset_id, target)
    except OSError as error:
        raise cannot_write(target, error) from error
    except ValueError as error:
        raise UserError(f"cannot write {target}: {' '.join(str(error).split())}") from error
    return target


def _size(folder: Path) -> int:
    """Bytes of the files that are read, all of which lie in the folder.

    Raises:
        UserError: one is not a regular file, or is a link.
    """
    refuse_links(folder, "a Minari data set")
    return sum(file_size(Path(place, name)) for place, _, names in os.walk(folder) for name in names)
