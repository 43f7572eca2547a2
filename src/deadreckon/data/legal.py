"""Masks of legal discrete actions, as the last numbers of observations, so that everything with an observation has them.

A log with `Discrete(n, masked=True)` has n numbers at the end of every observation, 1 if an action is legal and otherwise 0.
Networks give illegal actions `nets.mlp.ILLEGAL`, so that maxima, softmaxes, samples and targets exclude them without further
code.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from deadreckon.data.checks import flags, known_finals
from deadreckon.data.columns import MASKS
from deadreckon.data.scratch import BLOCK
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError


def joined_masks(
    log: str, columns: Mapping[str, Any], space: Box | Discrete | None
) -> tuple[dict[str, Any], Box | Discrete | None]:
    """Columns without separate masks, which become the last numbers of the observations, and the masked action space.

    Where `next_observations` are given without `next_legal`, what is legal in a next observation is known where the next row
    continues; elsewhere an episode's last row has no known successor, unless it is a terminal. The same holds of
    `final_observations` without `final_legal`.

    Args:
        log: its name, for errors.
        columns: by `Dataset.from_arrays` names, those that are given.
        space: of the actions, if it is known.

    Raises:
        UserError: one line that names the column and the row.
    """
    given = {key: value for key, value in columns.items() if key not in MASKS}
    if "legal" not in columns:
        if found := [key for key in MASKS if key in columns]:
            raise UserError(f"{log}: {found[0]} needs legal as well, the legal actions of each row")
        return given, space
    if isinstance(space, Box):
        raise UserError(f"{log}: legal says which discrete actions could be taken, but actions are continuous ({space})")
    observations = _numbers(log, "observations", columns["observations"])
    if callable(function := columns["legal"]):
        asked = {key: columns.get(key.replace("legal", "observations")) for key in ("next_legal", "final_legal")}
        told = {key: _told(log, function, np.asarray(seen)) for key, seen in asked.items() if seen is not None}
        columns = {**columns, "legal": _told(log, function, observations), **told}
    masks = {key: _mask(log, key, columns[key]) for key in MASKS if key in columns}
    legal = _some_legal(log, "legal", masks["legal"], np.zeros(1, bool))
    rows, size = legal.shape
    if observations.ndim != 2:
        raise UserError(f"{log}: legal needs flat observations (rows, numbers), got shape {observations.shape}")
    if len(observations) != rows:
        raise UserError(f"{log}: column legal has {rows} rows, observations have {len(observations)}")
    terminals = flags(log, "terminals", columns.get("terminals", np.zeros(rows)), rows)
    if space is not None and space.n != size:
        raise UserError(f"{log}: legal has a column for each of {size} actions, the action space has {space.n}")
    for key in ("next_legal", "final_legal"):
        wanted = f"{key.partition('_')[0]}_observations"
        if key in masks and (wanted not in columns or masks[key].shape != (len(columns[wanted]), size)):
            raise UserError(f"{log}: {key} needs {wanted} as well, and {size} truth values for each of them")
    if (following := columns.get("next_observations")) is not None:
        following = _numbers(log, "next_observations", following)
        if following.shape != observations.shape:
            raise UserError(f"{log}: next_observations have shape {following.shape}, observations {observations.shape}")
        if (mask := masks.get("next_legal")) is None:
            mask, ends = _following_masks(log, columns, terminals, observations, following, legal)
            given |= ends
        mask = _some_legal(log, "next_legal", mask, terminals)
        given["next_observations"] = _beside(following, mask)
    elif (final := columns.get("final_observations")) is not None:
        final = _numbers(log, "final_observations", final).reshape(len(final), -1)
        if (mask := masks.get("final_legal")) is None:
            mask = np.zeros((len(final), size), bool)
        known = known_finals(log, columns, len(final))
        given["final_known"], mask = known & mask.any(1), mask | ~mask.any(1, keepdims=True)
        given["final_observations"] = _beside(final, mask)
    return given | {"observations": _beside(observations, legal)}, Discrete(size, masked=True)


def _following_masks(
    log: str, columns: Mapping[str, Any], terminals: np.ndarray, observations: np.ndarray, following: np.ndarray,
    legal: np.ndarray,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:  # fmt: skip
    """(rows, n) what is legal in next observations, as the following rows tell; `timeouts` and `final_known` go with it."""
    rows = len(legal)
    continues = np.append((observations[1:] == following[:-1]).all(1), False)
    if "timeouts" in columns:
        timeouts = flags(log, "timeouts", columns["timeouts"], rows).copy()
    else:
        timeouts = ~continues & ~terminals
    timeouts[-1] |= not terminals[-1]
    ends = terminals | timeouts
    known = known_finals(log, columns, int(ends.sum()))
    if (lost := ~continues & ~ends).any():
        row = int(np.argmax(lost))
        text = f"the next observation of row {row} is not the following row's, so its legal actions are not known"
        raise UserError(f"{log}: {text}; give next_legal")
    mask = np.ones_like(legal)
    mask[:-1][~ends[:-1]] = legal[1:][~ends[:-1]]
    return mask, {"timeouts": timeouts, "final_known": known & terminals[ends]}


def _numbers(log: str, key: str, column: Any) -> np.ndarray:
    """(rows, ...) observations, a vector as one column."""
    column = np.asarray(column)
    if column.dtype.kind not in "fiub":
        raise UserError(f"{log}: column {key} holds {column.dtype}, numbers are needed")
    return column[:, None] if column.ndim == 1 else column


def _told(log: str, function: Callable[[np.ndarray], Any], observations: np.ndarray) -> np.ndarray:
    """(rows, n) that a function of observations (rows, numbers) gives."""
    seen = observations.reshape(len(observations), -1)
    mask = np.asarray(function(seen))
    if mask.ndim != 2 or len(mask) != len(seen):
        raise UserError(f"{log}: the function of legal actions must give shape ({len(seen)}, actions), got {mask.shape}")
    return mask


def _mask(log: str, key: str, column: Any) -> np.ndarray:
    """(rows, n) bool of a mask as it was given."""
    try:
        mask = np.asarray(column)
    except ValueError as error:  # rows of several lengths
        raise UserError(f"{log}: {key} must be truth values of shape (rows, actions), its rows differ in length") from error
    if mask.ndim != 2 or mask.shape[1] < 2:
        raise UserError(f"{log}: {key} must be truth values of shape (rows, actions), got shape {mask.shape}")
    if mask.dtype != bool and (wrong := ~np.isin(mask, (0, 1)).all(1)).any():
        row = int(np.argmax(wrong))
        raise UserError(f"{log}: {key} has {mask[row].tolist()} in row {row}, each must be 0 or 1")
    return mask.astype(bool)


def _some_legal(log: str, key: str, mask: np.ndarray, ended: np.ndarray) -> np.ndarray:
    """The mask, with all actions legal where the task has `ended` and nothing is done; refused where else none is."""
    if (none := ~mask.any(1) & ~ended).any():
        raise UserError(f"{log}: {key} allows no action in row {int(np.argmax(none))}; at least one must be legal")
    return mask | ~mask.any(1, keepdims=True)


def _beside(observations: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.concatenate([observations, mask.astype(np.float32)], 1, dtype=np.float32, casting="unsafe")


def check_masks(log: str, observations: np.ndarray, actions: np.ndarray, space: Box | Discrete) -> None:
    """Refuses a log whose observations do not end in masks, or whose actions are not legal by them.

    Raises:
        UserError: one line with the row.
    """
    if not (isinstance(space, Discrete) and space.masked):
        return
    if observations.ndim != 2 or observations.shape[1] < space.n:
        raise UserError(f"{log}: observations of shape {observations.shape} cannot end in the mask of {space.n} actions")
    count, first = 0, -1
    for start in range(0, len(actions), BLOCK):
        mask = np.asarray(observations[start : start + BLOCK, -space.n :])
        if (wrong := ~np.isin(mask, (0, 1)).all(1)).any():
            row = start + int(np.argmax(wrong))
            raise UserError(f"{log}: the observation of row {row} does not end in the mask of {space.n} actions, 0 or 1 each")
        illegal = mask[np.arange(len(mask)), np.asarray(actions[start : start + BLOCK])] == 0
        first = start + int(np.argmax(illegal)) if first < 0 and illegal.any() else first
        count += int(illegal.sum())
    if count:
        text = f"{count:,} of {len(actions):,} rows take an action that is illegal there, first row {first}"
        raise UserError(f"{log}: {text}: correct the legal actions, or leave them out")


def legal_at(observations: np.ndarray, space: Box | Discrete) -> np.ndarray | None:
    """(rows, n) bool, which actions are legal at these observations; None where all are everywhere."""
    if not (isinstance(space, Discrete) and space.masked):
        return None
    return np.asarray(observations)[:, -space.n :] > 0.5
