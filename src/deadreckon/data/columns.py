"""The columns that a log consists of: their names in `Dataset.from_arrays`, and the names that are left for further ones."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data import roles
from deadreckon.errors import UserError

NEEDED = ("observations", "actions", "rewards")
COLUMNS = (*NEEDED, "terminals", "timeouts", "next_observations", "final_observations", "final_known")
MASKS = ("legal", "next_legal", "final_legal")  # become part of the observations
# Names that a further column cannot have, because they are arguments of `Dataset.from_arrays`.
RESERVED = frozenset({*COLUMNS, *MASKS, "action_space", "name", "provenance", "strict", "cls"})
_ENDS = {"timeouts", "next_observations", "final_observations"}  # any of these tells where episodes end
LOG_PROBS = "behavior_log_probs"  # the further column of the logging policy's log-probabilities
METADATA = "metadata/"  # before D4RL's names of what is no column
_D4RL = {"infos/action_log_probs": LOG_PROBS}  # its names of further columns, and ours


def extra_name(key: str, taken: Mapping[str, Any]) -> str:
    """The name of a further column for a path such as `infos/goal`: `goal`, or `infos_goal` where that is taken.

    Raises:
        UserError: that is taken too, so one of the two would be lost.
    """
    parts = key.split("/")
    short = "_".join(parts[1:] if parts[0] == "infos" and len(parts) > 1 else parts)
    found = "_".join(parts) if short in RESERVED or short in taken else short
    if found in taken:
        raise UserError(f"two columns would be called {found}, {key} and another; rename one")
    return found


def d4rl_name(key: str, taken: Mapping[str, Any]) -> str:
    """The name of a further column of D4RL's; raises as `extra_name`."""
    return _D4RL[key] if key in _D4RL and _D4RL[key] not in taken else extra_name(key, taken)


def d4rl_metadata(key: str, value: Any) -> dict[str, Any]:
    """What D4RL says beside its columns under `METADATA`, if it is a text or a number; `value` has a shape and a dtype."""
    if value.shape not in ((), (1,)) or value.dtype.kind not in "fiubSUO":
        return {}
    said = np.asarray(value[()]).reshape(()).item()
    if isinstance(said, bytes):
        said = said.decode("utf-8", "replace")
    return {key.removeprefix(METADATA): said} if isinstance(said, str | bool | int | float) else {}


def given_columns(source: Path | str, columns: Mapping[str, Any]) -> dict[str, Any]:
    """`columns` as arguments of `from_arrays`; see `renamed`.

    Args:
        source: named in errors.
        columns: by `from_arrays` names; other names are extras.

    Raises:
        UserError: a column that a log needs is missing, ends are marked by a column that does not say which, or two columns
            would have one name.
    """
    for key in NEEDED:
        if key not in columns:
            found = ", ".join(sorted(columns)) or "none"
            raise UserError(f"{source}: no column {key}; {', '.join(NEEDED)} are needed, the file has {found}")
    # Read as mere extras, these would leave a log without ends: better no log than a wrong one.
    for key in sorted(columns, key=lambda key: key != "masks"):  # which says more than the `dones` beside it
        if (error := _without_effect(key, columns)) is not None:
            raise UserError(f"{source}: {error}")
    return renamed(source, columns)


def _without_effect(key: str, columns: Mapping[str, Any]) -> UserError | None:
    """The error for a column whose name is that of an end flag, and which would be an extra of a log without such ends."""
    if key in COLUMNS or np.size(columns[key]) != np.size(columns["rewards"]):  # several a row, such as masks of actions
        return None
    if "terminals" in columns:
        return None if _ENDS & columns.keys() or not roles.like("timeout", key) else _to_be_called(key, "timeouts")
    if key == "masks":
        how = "are there; add terminals = (masks == 0) if masks are 1 while the task has not ended, or else rename them"
        return UserError(f"column masks says nothing of how episodes end unless terminals {how}")
    for role, name in (("terminal", "terminals"), ("timeout", "timeouts")):
        if roles.like(role, key) and name not in columns:
            return _to_be_called(key, name)
    if key in ("dones", "done"):
        return done_alone(key)
    ended = key == "dones_float" or (roles.DONE.fullmatch(key.lower()) and key.lower() != "is_first")
    if ended and "timeouts" in columns and not (np.ravel(columns[key]) > np.ravel(columns["timeouts"])).any():
        return None  # it says no more than the timeouts
    return _to_be_called(key, "terminals (the task ended) or timeouts (a time limit)") if ended else None


def _to_be_called(key: str, name: str) -> UserError:
    return UserError(f"column {key} must be called {name}: under its own name it would be kept and mark no end of an episode")


def renamed(source: Path | str, columns: Mapping[str, Any]) -> dict[str, Any]:
    """`columns`, where further ones that are called like an argument of `from_arrays` become `infos_...`.

    Raises:
        UserError: two columns would have one name.
    """
    given: dict[str, Any] = {}
    for key, column in columns.items():
        key = f"infos_{key}" if key in RESERVED and key not in (*COLUMNS, *MASKS) else key
        if key in given:
            raise UserError(f"{source}: two columns would be called {key}; rename one")
        given[key] = column
    return given


def in_memory(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a log's fields that hold memory-mapped columns, read into memory."""
    read = lambda column: np.array(column) if isinstance(column, np.memmap) else column  # noqa: E731
    found = {name: read(value) for name, value in columns.items() if isinstance(value, np.memmap)}
    return found | {"extras": {key: read(value) for key, value in columns["extras"].items()}}


def unmarked(given: Mapping[str, Any], lengths: np.ndarray) -> list[str]:
    """What to say of a log of the columns `given`, whose episodes have `lengths`, if nothing in it marks time limits."""
    if lengths.max() <= 1 or _ENDS & given.keys():
        return []
    return ["no timeouts and no next_observations: time limits that are not marked would be crossed"]


def done_alone(name: str) -> UserError:
    """The error for an end flag that does not say how an episode ended."""
    return UserError(
        f"column {name} must be called terminals (the task ended) or timeouts (a time limit), as it does not say which; "
        'in Python, Dataset.from_dict(columns, done="terminals") or done="timeouts" says it'
    )
