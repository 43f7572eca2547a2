"""Conversion of columns with the names of another library to the columns of a log."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.checks import SLACK
from deadreckon.data.columns import LOG_PROBS, METADATA, NEEDED, d4rl_metadata, d4rl_name, extra_name
from deadreckon.data.formats.flatten import join_arrays
from deadreckon.data.formats.layout_ends import MEANINGS, ends, in_episodes
from deadreckon.data.formats.layout_rows import Parts
from deadreckon.data.formats.layouts import Layout, flat, layout_of, plain_name, told
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError, naming

_MAIN = ("observation", "observations", "obs")  # the observation among the columns of a dict of them
# Names of end flags: one without a role is refused, because as an extra it would have no effect.
ENDS = {"terminals", "timeouts", "terminated", "truncated", "terminateds", "truncateds", "terminations", "truncations", "done",
        "dones", "masks"}  # fmt: skip
_FLAGS = ("terminated", "truncated", "done", "alive", "discount")
_CORE = ("observations", "next_observations")


@dataclass(frozen=True)
class Arranged:
    """Columns as `Dataset.from_arrays` takes them.

    Attributes:
        columns: by its names; others become extras.
        told: messages on how they were read, one line each.
        extra: for the provenance: the layout, names of the observation's dimensions, columns left out.
        space: of the actions, if the source has it.
    """

    columns: dict[str, np.ndarray]
    told: list[str] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    space: Box | Discrete | None = None


def arranged(path: Path | str, columns: Mapping[str, Any], done: str | None = None) -> Arranged:
    """The columns of a log, from a mapping of arrays under our names or those of a known layout.

    Args:
        path: named in errors.
        columns: {name: (rows, ...)}, possibly nested dicts as in RLlib or TorchRL; numbers and texts may be among them.
        done: meaning of a column `done` without other end flags, "terminals" or "timeouts"; None: it is refused.

    Raises:
        UserError: one line that names the column and the row.
    """
    if done is not None and done not in MEANINGS:
        raise UserError(f'{path}: done is {done!r}, "terminals" or "timeouts" is needed')
    parts = _parts(columns)
    layout = layout_of(parts.arrays.keys() | parts.other.keys())
    if layout is None or layout.ours:
        lines, extra = ([], {}) if layout is None else ([told(layout)], {"layout": layout.library})
        with naming(path, ""):
            given, metadata = _plain(columns, done)
        return Arranged(given, lines, {**extra, "metadata": metadata} if metadata else extra)
    with naming(path, ""):
        given = {plain_name(key): value for key, value in flat(columns).items()}
        for name in (name for name, role in layout.names.items() if role == "episode"):
            if (codes := _codes(name, given.get(name))) is not None:
                parts.arrays[name] = codes
                parts.other.pop(name, None)
        return _read(layout, parts, done)


def _codes(name: str, values: Any) -> np.ndarray | None:
    """(rows,) integer codes of names of episodes, which are texts or integers of any size; None for other values."""
    if isinstance(values, np.ndarray):
        values = values.reshape(-1).tolist() if values.dtype.kind in "OUS" and values.ndim else None
    if not isinstance(values, list) or not any(isinstance(value, str | bytes | int) for value in values):
        return None
    if (row := next((row for row, value in enumerate(values) if not isinstance(value, str | bytes | int)), None)) is not None:
        raise UserError(f"column {name} has {values[row]!r} in row {row}, the name of an episode is a text or an integer")
    first = {value: number for number, value in enumerate(dict.fromkeys(values))}
    return np.array([first[value] for value in values], np.int64)


def _parts(columns: Mapping[str, Any]) -> Parts:
    parts = Parts({})
    for key, value in flat(columns).items():
        key = plain_name(key)
        if isinstance(value, list):
            value = as_array(value)
        elif hasattr(value, "detach"):  # a tensor of torch
            value = np.asarray(value.detach().cpu())
        if isinstance(value, np.ndarray) and value.ndim and value.dtype.kind in "fiub":
            parts.arrays[key] = value
        else:
            parts.other[key] = value[()] if isinstance(value, np.ndarray) and not value.ndim else value
    return parts


def as_array(values: Any) -> Any:
    """An array of a list or a value, or the list itself where its entries have different shapes."""
    try:
        return np.asarray(values)
    except ValueError:
        return values


def _plain(columns: Mapping[str, Any], done: str | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Columns with our names, and D4RL's metadata; a column `done` without other end flags becomes the column named `done`."""
    named = {str(key): column for key, column in columns.items()}
    given = {key: column for key, column in named.items() if "/" not in key}
    metadata: dict[str, Any] = {}
    for key in (key for key in named if key not in given):
        if key.startswith(METADATA):
            said = as_array(named[key])
            metadata |= d4rl_metadata(key, said) if isinstance(said, np.ndarray) else {}
        else:
            given[d4rl_name(key, given)] = named[key]
    name = next((key for key in ("dones", "done") if key in given), None)
    if done is not None and name is not None and not {"terminals", "timeouts"} & given.keys():
        given[done] = given.pop(name)
    return given, metadata


def _read(layout: Layout, parts: Parts, done: str | None) -> Arranged:
    lines = [told(layout)]
    _same_rows(layout, parts)
    for key in NEEDED:
        named = [name for name, role in layout.names.items() if role == key]
        if (other := next((name for name in named if name in parts.other), None)) and not parts.arrays.keys() & {*named}:
            raise UserError(f"column {other} is no array of numbers in which every row has the same shape")
    if layout.order is not None:
        layout.order(parts)
    lines += parts.told
    extra: dict[str, Any] = {"layout": layout.library}
    if parts.names is not None:
        extra["observation_names"] = parts.names
    roles, names, further = _roles(layout, parts, extra)
    for key in NEEDED:
        if key not in roles:
            found = ", ".join(sorted(parts.arrays.keys() - {"cut"}))
            raise UserError(f"no {key} among the columns {found} of {layout.library}'s layout")
    rows = len(roles["actions"])
    order, change = in_episodes(roles.get("episode"), roles.get("time"))
    if order is not None:
        roles = {key: column[order] for key, column in roles.items()}
        further = {key: column[order] for key, column in further.items() if len(column) == rows}
        lines.append(f"rows are put together by {names['episode']}, which they were not")
    terminals, timeouts = ends(roles, names, rows, done, lines)
    columns = {key: roles[key] for key in (*_CORE, "actions", "rewards") if key in roles}
    if terminals is not None:
        columns["terminals"] = terminals
    cuts = [flag.reshape(-1) != 0 for flag in (timeouts, change, roles.get("cut")) if flag is not None]
    if cuts:
        columns["timeouts"] = np.logical_or.reduce(cuts) & ~(terminals if terminals is not None else np.zeros(rows, bool))
    if "unknown" in roles:
        _forget(columns, roles["unknown"])
    if parts.last is not None:
        columns |= _finals(columns, roles["cut"], parts.last)
    columns |= _log_probs(roles, names)
    if "legal" in roles:
        columns |= {key: roles[key].reshape(rows, -1) != 0 for key in ("legal", "next_legal") if key in roles}
        lines.append(f"{names['legal']} says which actions are legal and becomes the end of the observations")
    for key in sorted(ENDS & further.keys()):
        have = ", ".join(names[role] for role in _FLAGS if role in names) or "none"
        raise UserError(f"column {key} says how episodes end, beside {have} of {layout.library}'s layout; leave one out")
    left_out = []
    for key, column in further.items():
        if len(column) == rows:
            columns[extra_name(key, columns)] = column
        else:
            left_out.append(key)
    return Arranged(columns, lines, {**extra, "left_out": left_out} if left_out else extra, parts.space)


def _same_rows(layout: Layout, parts: Parts) -> None:
    """Refuses columns of a log that do not have as many rows as its actions."""
    name = next((name for name, role in layout.names.items() if role == "actions" and name in parts.arrays), None)
    for key in () if name is None else (key for other in layout.names for key in parts.under(other)):
        if len(parts.arrays[key]) != len(parts.arrays[name or ""]):
            raise UserError(f"column {key} has {len(parts.arrays[key])} rows, {name} has {len(parts.arrays[name or ''])}")


def _roles(
    layout: Layout, parts: Parts, extra: dict[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, str], dict[str, np.ndarray]]:
    """The columns by their roles, what each is called in the source, and the columns that have none."""
    roles: dict[str, np.ndarray] = {}
    names: dict[str, str] = {}
    further = dict(parts.arrays)
    for name, role in layout.names.items():
        keys = parts.under(name)
        if not keys or role in roles:
            continue
        if keys == [name]:
            roles[role] = further.pop(name)
        elif role in _CORE:
            whole = {key.removeprefix(f"{name}/"): further.pop(key) for key in keys if key in further}
            main = next((key for key in _MAIN if key in whole), None)
            if main is None:
                roles[role], extra["observation_names"] = join_arrays(whole)
            else:
                roles[role] = whole.pop(main)
                if role == "observations":
                    further |= whole
        else:
            raise UserError(f"{name} is a dict of columns, one array is needed")
        names[role] = name
    return roles, names, further


def _log_probs(roles: Mapping[str, np.ndarray], names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """The behaviour policy's log-probabilities of the logged actions, if the source has them."""
    if "log_probs" in roles:
        return {LOG_PROBS: roles["log_probs"].reshape(len(roles["log_probs"]))}
    if "probs" not in roles:
        return {}
    probs = roles["probs"].reshape(len(roles["probs"]))
    if not (probs > 0).all():
        row = int(np.argmin(probs > 0))
        raise UserError(f"column {names['probs']} has {probs[row]} in row {row}, a positive probability is needed")
    large = np.log(probs) > SLACK
    if roles["actions"].dtype.kind in "iub" and large.any():  # for continuous actions it may be a density
        row = int(np.argmax(large))
        raise UserError(f"column {names['probs']} has {probs[row]} in row {row}, a probability in (0, 1] is needed")
    return {LOG_PROBS: np.log(probs)}


def _finals(columns: Mapping[str, np.ndarray], cut: np.ndarray, last: np.ndarray) -> dict[str, np.ndarray]:
    """The final observations of episodes, of which those after rows where the recording is `cut` are `last`, others unknown."""
    ended = columns["timeouts"] | columns.get("terminals", np.zeros(len(cut), bool))
    known = cut[ended]
    final = np.zeros((len(known), *columns["observations"].shape[1:]), columns["observations"].dtype)
    final[known] = last
    return {"final_observations": final, "final_known": known}


def _forget(columns: dict[str, np.ndarray], unknown: np.ndarray) -> None:
    """Replaces next observations by final ones, with those marked that are not known; within episodes the next row has them."""
    following = columns.pop("next_observations")
    ended = columns.get("terminals", np.zeros(len(unknown), bool)) | columns.get("timeouts", np.zeros(len(unknown), bool))
    ended[-1] = True
    columns["final_observations"] = following[ended]
    columns["final_known"] = ~unknown.reshape(-1)[ended]
