"""Conversion of the end flags of any library to terminals and timeouts; contradictions are refused."""

from collections.abc import Mapping

import numpy as np

from deadreckon.data.columns import done_alone
from deadreckon.errors import UserError

MEANINGS = ("terminals", "timeouts")  # possible meanings of a column `done` without other end flags


def ends(
    roles: Mapping[str, np.ndarray], names: Mapping[str, str], rows: int, done: str | None, told: list[str]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(rows,) bool terminals, and (rows,) bool timeouts without those from identifiers of episodes; None without such flags.

    Args:
        roles: columns (rows,) or (rows, 1) called terminated, truncated, done, alive, discount; see `Layout.names`.
        names: what each of them is called in the source.
        rows: of the log.
        done: meaning of a column `done` without other end flags, one of `MEANINGS`; None: it is refused.
        told: list to which messages on unusual flags are added.

    Raises:
        UserError: one line that names the columns, the row, and what would be right.
    """
    flags = {key: _flag(names[key], roles[key], rows) for key in ("terminated", "truncated", "done", "alive") if key in roles}
    claims = {names["terminated"]: flags["terminated"]} if "terminated" in flags else {}
    if "alive" in flags:
        claims[names["alive"]] = ~flags["alive"]
    if "discount" in roles:
        claims[names["discount"]] = _discount(names["discount"], roles["discount"], rows)
    truncated, ended = flags.get("truncated"), flags.get("done")
    if claims:
        (first, terminated), *others = claims.items()
        for name, claim in others:
            _agree(terminated == claim, f"{first} and {name} contradict each other on whether the task ended")
        return terminated, _timeouts(terminated, truncated, ended, names, told, strict="alive" not in flags)
    if ended is None:
        if truncated is not None:
            name = names["truncated"]
            raise UserError(f"column {name} without a flag of terminations: add one (terminated), all 0 if the task never ends")
        return None, None
    if truncated is not None:
        if (truncated & ~ended).any():
            row, name = int(np.argmax(truncated & ~ended)), names["done"]
            seen = f"row {row} has {names['truncated']} and not {name}"
            raise UserError(f"column {name} must be called terminals if it marks no time limits, else all ends; {seen}")
        return ended & ~truncated, truncated
    if done is None:
        raise done_alone(names["done"])
    return (ended, None) if done == "terminals" else (np.zeros(rows, bool), ended)


def _timeouts(
    terminated: np.ndarray, truncated: np.ndarray | None, ended: np.ndarray | None, names: Mapping[str, str], told: list[str],
    strict: bool,
) -> np.ndarray | None:  # fmt: skip
    if ended is None:
        return truncated
    early = terminated & ~ended
    if strict:
        _agree(~early, f"the task ended ({names.get('terminated', names.get('discount'))}) and {names['done']} is not set")
    elif early.any():
        told.append(
            f"in {int(early.sum())} of {len(early)} rows the task ended ({names['alive']}) inside a trajectory "
            f"({names['done']}); the next row is read as the start of another episode"
        )
    if truncated is not None:
        _agree(ended == (terminated | truncated), f"{names['done']} is not {names['truncated']} or a termination")
    return ended & ~terminated


def _agree(good: np.ndarray, text: str) -> None:
    if not good.all():
        raise UserError(f"{text}, first in row {int(np.argmin(good))}; correct the flags, or leave one of them out")


def _flag(name: str, column: np.ndarray, rows: int) -> np.ndarray:
    if column.size != rows or column.dtype.kind not in "fiub":
        raise UserError(f"column {name} of shape {column.shape} holds {column.dtype}, one truth value per row is needed")
    column = column.reshape(rows)
    wrong = ~np.isin(column, (0, 1))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"column {name} has {column[row]} in row {row}, 0 or 1 is needed")
    return column != 0


def _discount(name: str, column: np.ndarray, rows: int) -> np.ndarray:
    if column.size != rows or column.dtype.kind not in "fiub":
        raise UserError(f"column {name} of shape {column.shape} holds {column.dtype}, one number per row is needed")
    column = column.reshape(rows)
    wrong = ~((column >= 0) & (column <= 1))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UserError(f"column {name} has {column[row]} in row {row}, a number in 0 .. 1 is needed")
    return column == 0


def in_episodes(episode: np.ndarray | None, time: np.ndarray | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(rows,) order in which the rows of each episode are together, None if they are; and (rows,) bool, the last rows of
    episodes in that order, None without identifiers.

    Args:
        episode: (rows,) identifiers, or None.
        time: (rows,) numbers that grow within an episode, or None.
    """
    if episode is None:
        return None, None
    _, first, codes = np.unique(episode.reshape(-1), return_index=True, return_inverse=True)
    place = first[codes]  # episodes stay in the order in which they begin
    order = np.argsort(place, kind="stable") if time is None else np.lexsort((time.reshape(-1), place))
    change = np.append(np.diff(place[order]) != 0, True)
    return (None if (order == np.arange(len(order))).all() else order), change
