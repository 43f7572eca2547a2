"""Pytrees of arrays on disk, without pickle, in files that are either whole or absent."""

import json
import re
from pathlib import Path
from typing import Any

import jax
import numpy as np

from deadreckon._version import __version__
from deadreckon.errors import UserError
from deadreckon.files import digest, read_json, replacing, write_json
from deadreckon.foreign.archive import read_arrays
from deadreckon.foreign.shapes import checked
from deadreckon.foreign.text import parse_json
from deadreckon.training.revisions import of_learning

_META = "meta.json"


def folder_of(out: Path, what: str, asked: dict[str, Any]) -> Path:
    """The folder of a fit's checkpoints below `out`, named by `what` and a hash of all its settings `asked`, which are also
    written into it.

    The hash includes the version of the package and revisions of the training loop, whose change may change updates.
    """
    asked = asked | {"version": __version__, "revisions": of_learning()}
    folder = out / f"{what}-{digest(asked, 6)}"
    if not (folder / "asked.json").exists():
        write_json(folder / "asked.json", asked)
    return folder


def checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """Step and path of every checkpoint of a fit, oldest first."""
    found = ((re.fullmatch(r"(\d+)\.npz", p.name), p) for p in folder.glob("*.npz"))
    return sorted((int(m[1]), p) for m, p in found if m)


def inherit(folder: Path) -> None:
    """Lets a fit continue a shorter one that differs in `steps` alone: the newest checkpoint of that one is copied.

    For learners whose updates do not depend on the number of updates that remain.

    Args:
        folder: of the fit, from `folder_of`; nothing is done if it has a checkpoint.
    """
    if checkpoints(folder):
        return
    found, asked = [], read_json(folder / "asked.json", dict)
    for note in folder.parent.glob(f"{folder.name.rpartition('-')[0]}-*/asked.json"):
        if read_json(note, dict) | {"steps": asked["steps"]} == asked:
            found += [(step, path) for step, path in checkpoints(note.parent) if step <= asked["steps"]]
    for _, path in sorted(found, reverse=True):
        try:
            arrays, meta = load_arrays(path)
        except UserError:  # damaged, or removed meanwhile; an older one is used
            continue
        return save_arrays(folder / path.name, arrays, meta)


def save_arrays(path: Path, arrays: dict[str, np.ndarray], meta: dict[str, Any]) -> None:
    """Writes named arrays and JSON values as one npz file, atomically."""
    text = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **{_META: text}, **arrays)  # pyrefly: ignore[bad-argument-type] - none is called `allow_pickle`


def load_arrays(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads what `save_arrays` wrote.

    Raises:
        UserError: the file is missing, truncated or of another kind.
    """
    arrays = read_arrays(path, "a checkpoint")
    if (text := arrays.pop(_META, None)) is None:
        raise UserError(f"{path} is not a whole deadreckon file: it lacks {_META}")
    return arrays, checked(parse_json(path, text.tobytes()), dict, path)


def _named(tree: Any) -> dict[str, Any]:
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]}


def save_tree(path: Path, tree: Any, meta: dict[str, Any]) -> None:
    """Writes a pytree of arrays under the names of its paths."""
    save_arrays(path, {name: np.asarray(leaf) for name, leaf in jax.device_get(_named(tree)).items()}, meta)


def load_tree(path: Path, like: Any, lanes: slice | None = None) -> tuple[Any, dict[str, Any]]:
    """Reads a pytree of the same structure, shapes and dtypes as `like`; with `lanes`, only these of stacked states.

    Raises:
        UserError: the file is damaged, or holds something else.
    """
    arrays, meta = load_arrays(path)
    if lanes is not None:
        arrays = {name: array[lanes] for name, array in arrays.items()}
    wanted = _named(like)
    found = {name: (value.shape, value.dtype) for name, value in arrays.items()}
    expected = {name: (leaf.shape, leaf.dtype) for name, leaf in wanted.items()}
    if found != expected:
        name = sorted(n for n in found.keys() | expected.keys() if found.get(n) != expected.get(n))[0]
        raise UserError(f"{path} does not fit: {name} is {found.get(name)}, {expected.get(name)} is needed")
    return jax.tree.unflatten(jax.tree.structure(like), [arrays[name] for name in wanted]), meta
