"""Logs whose images D4RL stores as flat rows of numbers: those of CARLA, 48 x 48 x 3 as 6,912 numbers from 0 to 1.

They are recognised only by name, that of the log or of D4RL's file: 6,912 columns of any other log are not converted.
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
# Shapes of images: rows from the top, columns, and red, green, blue.
SHAPES = dict.fromkeys((*CARLA_FILES, *CARLA_FILES.values()), (48, 48, 3))
PICTURES = ("observations", "next_observations")
_BLOCK = 1 << 24  # bytes that are converted at a time
_SLACK = 1e-3  # tolerance of the bounds


def picture_shape(name: str, columns: dict[str, Any]) -> tuple[int, ...] | None:
    """The shape of the flat images of the log `name`; None if it has none, or if they are not flat.

    Args:
        name: of a log, such as `carla-lane-v0` or `carla-lane-v0@d4rl`, or of D4RL's file without its ending.
        columns: arrays by name.
    """
    shape, flat = SHAPES.get(name.partition("@")[0]), columns.get("observations")
    return None if shape is None or flat is None or flat.shape[1:] != (math.prod(shape),) else shape


def pictures(path: Path | str, column: str, flat: Any, shape: tuple[int, ...], place: Path | None = None) -> np.ndarray:
    """(rows, *shape) uint8 images from (rows, n) numbers: bytes unchanged, and others converted from [0, 1] or [0, 255].

    The range is determined from all numbers, because the maximum of a log of images is above 1 in [0, 255].

    Args:
        path: of the file, for errors.
        column: its name there.
        flat: (rows, n) array, in memory or memory-mapped.
        shape: of an image.
        place: of a file for the images, which is memory-mapped; None: in memory.

    Raises:
        UserError: a number is not finite or beyond both ranges, with its row.
    """
    rows = len(flat)
    if flat.dtype == np.uint8:
        return flat.reshape(rows, *shape)
    step = max(_BLOCK // max(flat[:1].nbytes, 1), 1)
    blocks = [slice(first, first + step) for first in range(0, rows, step)]
    brightest = max((float(np.max(flat[block])) for block in blocks), default=0.0)  # NaN is refused below
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
    """The columns with flat images converted, and a message, if the log `name` has such; else the columns, and None.

    Args:
        path: of the file, for errors.
        name: see `picture_shape`.
        columns: by name.
        refuse: makes the error if columns must be memory-mapped from the file without a copy; None: they need not be.
        scratch: folder for the images; None: in memory.
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
