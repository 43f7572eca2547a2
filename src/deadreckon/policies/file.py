"""What a policy file holds, read without JAX: its JSON tree and its arrays."""

from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np

from deadreckon.errors import reading
from deadreckon.foreign.archive import read_arrays
from deadreckon.foreign.shapes import checked
from deadreckon.foreign.text import parse_json
from deadreckon.policies import portable


class _Policy(TypedDict):
    kind: str
    inner: dict[str, Any]


class _Tree(TypedDict):
    format: int
    policy: _Policy
    meta: NotRequired["_Meta"]


class _Meta(TypedDict):
    log: NotRequired[dict[str, Any] | None]


def read_policy(path: Path | str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The JSON tree of a policy file, and its arrays.

    Raises:
        UserError: the file is missing, broken or not a policy file.
    """
    arrays = read_arrays(path, "a policy file")
    if (text := arrays.get(portable.TREE)) is not None:
        checked(parse_json(path, text.tobytes()), _Tree, path)
    with reading(path, "a policy file"):
        return portable.tree_of(arrays)
