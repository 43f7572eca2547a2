"""Logs whose pictures D4RL keeps as flat rows of numbers: those of CARLA, 48 x 48 x 3 as 6,912 numbers from 0 to 1.

They are known by name alone, that of the log or of D4RL's file: 6,912 columns of any other log stay columns.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.errors import UserError

CARLA_FILES = {  # of D4RL's logs
    "carla-lane-v0": "carla_lane_follow_flat-v0",
    "carla-town-v0": "carla_town_subsamp_flat-v0",
    "carla-town-full-v0": "carla_town_flat-v0",
}
# Rows from the top, columns, and red, green, blue.
SHAPES = dict.fromkeys((*CARLA_FILES, *CARLA_FILES.values()), (48, 48, 3))
PICTURES = ("observations", "next_observations")
_BLOCK = 1 << 24  # bytes that are converted at a time
_SLACK = 1e-3  # by which a number may miss its bounds


def picture_shape(name: str, columns: dict[str, Any]) -> tuple[int, ...] | None:
    """The shape of the flat pictures of the log `name`; None where it has none, or where they are not flat.

    Args:
        name: of a log, such as `carla-lane-v0` or `carla-lane-v0@d4rl`, or of D4RL's file without its ending.
        columns: that have shapes, by name.
    """
    shape, flat = SHAPES.get(name.partition("@")[0]), columns.get("observations")
    return None if shape is None or flat is None or flat.shape[1:] != (math.prod(shape),) else shape


def pictures(path: Path | str, column: str, flat: Any, shape: tuple[int, ...], place: Path | None = None) -> np.ndarray:
    """(rows, *shape) uint8 of (rows, n) numbers: bytes as they are, and others from 0 to 1 or from 0 to 255.

    Which of the two all numbers together say: the brightest of a log of pictures is not as dark as 1 in 255.

    Args:
        path: of the file, for errors.
        column: what it is called there.
        flat: in memory or mapped.
        shape: of a picture.
        place: of a file that takes the bytes, and is mapped; None: memory.

    Raises:
        UserError: a number is not finite or beyond both ranges, with its row.
    """
    rows = len(flat)
    if flat.dtype == np.uint8:
        return flat.reshape(rows, *shape)
    step = max(_BLOCK // max(flat[:1].nbytes, 1), 1)
    blocks = [slice(first, first + step) for first in range(0, rows, step)]
    brightest = max((float(np.max(flat[block])) for block in blocks), default=0.0)  # NaN is told below
    most = 1.0 if brightest <= 1.0 + _SLACK else 255.0
    whole = rows, *shape
    out = np.empty(whole, np.uint8) if place is None or not rows else np.memmap(place, np.uint8, "w+", shape=whole)
    for block in blocks:
        part = np.asarray(flat[block], np.float32)
        wrong = ~((part >= -_SLACK) & (part <= most + _SLACK))
        if wrong.any():
            row, at = np.argwhere(wrong)[0]
            said = f"{column} has {part[row, at]} in row {block.start + row}"
            raise UserError(f"{path}: {said}, and its images need numbers from 0 to 1, or from 0 to 255")
        out[block] = np.rint(np.clip(part, 0.0, most) * (255.0 / most)).astype(np.uint8).reshape(-1, *shape)
    return out


def as_pictures(
    path: Path | str, name: str, columns: dict[str, Any], refuse: Callable[[str], UserError] | None, scratch: Path | None = None
) -> tuple[dict[str, Any], str | None]:
    """The columns with pictures where `name` is known to have them, and a line that says so; as they are elsewhere.

    Args:
        path: of the file, for errors.
        name: see `picture_shape`.
        columns: by name.
        refuse: makes the error of who wants columns as they lie in the file; None: nobody does.
        scratch: folder that takes the bytes.
    """
    shape = picture_shape(name, columns)
    if shape is None:
        return columns, None
    found, size = dict(columns), math.prod(shape)
    for column in PICTURES:
        flat = columns.get(column)
        if flat is None or flat.shape[1:] != (size,):
            continue
        if refuse is not None and flat.dtype != np.uint8:
            raise refuse("its images are rows of numbers")
        found[column] = pictures(path, column, flat, shape, None if scratch is None else scratch / f"{column}.pictures")
    return found, f"images, {' x '.join(map(str, shape))}, of {size:,} numbers per row, as {name.partition('@')[0]} has them"
