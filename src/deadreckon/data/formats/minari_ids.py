"""Ids of Minari data sets: their form, and the folders of the data sets, without importing Minari."""

import os
import re
from pathlib import Path

from deadreckon.errors import UserError, unknown
from deadreckon.names import file_part

PREFIX = "minari:"
METADATA = "metadata.json"
ROOT = "MINARI_DATASETS_PATH"  # environment variable


def find(source: Path | str) -> Path:
    """The folder with `metadata.json` of a data set given by folder, or by `minari:` and an id.

    Raises:
        UserError: there is none (the line names similar ids), or the id is not valid.
    """
    text = str(source)
    by_id = text.startswith(PREFIX)
    folder = root() / checked_id(text.removeprefix(PREFIX)) if by_id else Path(text)
    if not by_id and not folder.exists() and installed(text):
        folder = root() / text
    for inner in (folder / "data", folder):
        if (inner / METADATA).is_file():
            return inner
    if not by_id:
        raise UserError(f"{text}: no {METADATA}; a Minari data set has one in its data folder ({PREFIX}ID names one by id)")
    there = [str(file.parent.parent.relative_to(root())) for file in root().glob(f"**/data/{METADATA}")]
    if not there:
        raise UserError(f"no Minari data set {text.removeprefix(PREFIX)!r}: {root()} ({ROOT}) holds none")
    raise unknown("Minari data set", text.removeprefix(PREFIX), there)


def installed(text: str) -> bool:
    """Whether `text` is the id of a data set that is installed here; Minari is not imported."""
    return _inside(text) and (root() / text / "data" / METADATA).is_file()


def is_id(text: str) -> bool:
    """Whether `text` looks like a Minari id with a namespace, such as `mujoco/hopper/medium-v0`."""
    return re.fullmatch(r"[\w-]+(/[\w.-]+)+-v\d+", text) is not None


def missing(dataset_id: str) -> str:
    """The message on a data set that is not installed here."""
    told = f"no file {dataset_id}, and no Minari data set of this id in {root()} ({ROOT})"
    return f"{told}; `minari download {dataset_id}` fetches it"


def checked_id(dataset_id: str) -> str:
    """`dataset_id`, if it is a valid id within Minari's folder.

    Raises:
        UserError: it is not.
    """
    from minari.dataset.minari_dataset import parse_dataset_id

    try:
        parse_dataset_id(dataset_id)
        good = _inside(dataset_id)
    except (ValueError, TypeError):  # a TypeError is raised for an id without a version
        good = False
    if not good:
        raise UserError(f"{dataset_id!r} is no Minari id; it should look like mine/pointmaze-v0")
    return dataset_id


def _inside(dataset_id: str) -> bool:
    """Whether a data set of that id lies in Minari's folder."""
    return all(file_part(part) == part for part in dataset_id.split("/"))


def root() -> Path:
    """The folder of the data sets that are installed here."""
    return Path(os.environ.get(ROOT) or Path.home() / ".minari" / "datasets")
