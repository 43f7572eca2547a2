"""Encoded observations as rows of a table again, so that what encodes rows can be checked on a log that is encoded already."""

from typing import Any

import numpy as np

from deadreckon.policies.table_encoder import TableEncoder


def decoded(encoder: TableEncoder, observations: np.ndarray) -> dict[str, list[Any]]:
    """Columns whose rows the encoder makes these observations of; missing values are None.

    Args:
        encoder: of the policy's log.
        observations: (rows, size) float32, without the numbers that say which actions are legal.
    """
    out: dict[str, list[Any]] = {}
    for key, column in encoder.observed.items():
        place = encoder.places[key]
        if column["kind"] == "category":
            levels = [*column["levels"], None]
            seen = observations[:, place : place + len(levels) - 1]
            codes = np.where(seen.any(1), seen.argmax(1), len(levels) - 1)
            out[key] = [levels[code] for code in codes]
        else:
            values = observations[:, place].astype(float).tolist()
            missing = observations[:, place + 1] > 0.5 if column.get("marked") else np.zeros(len(values), bool)
            out[key] = [None if gone else value for value, gone in zip(values, missing)]
    return out
