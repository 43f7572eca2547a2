"""The methods of a suite: what a line of `[methods]` may say."""

import math
from dataclasses import dataclass, field, fields
from typing import Any, get_args

from deadreckon.agents import canonical_name
from deadreckon.errors import UserError, unknown

LOG = ("first", "beside")  # what a task's log is for


@dataclass(frozen=True)
class Method:
    """A way to learn, to design or to estimate.

    Attributes:
        name: in tables.
        agent: its name in `deadreckon agents`, or of a designer in `deadreckon design methods`, or of an estimator in
            `deadreckon ope --list`; or `module:function` of a study, which is called with a case, `seed=` and the fields, and
            returns numbers by name.
        fields: settings that differ from the defaults, or from the preset.
        preset: whether it begins from the settings published for what it is run on, where there are any.
        acting: online, what differs from how the agent's own acting and learning take turns: fields of `online.Online`.
        history: of a suite of kind `learn`: last observations that policies act on.
        encoder: likewise, of logs of pictures: the network before the agent's own; "" for the default.
        shift: likewise, the most pixels by which pictures are moved; None for the task's.
        log: online, what the task's log is for: `first` to learn from before it acts and then in the replay, `beside` in the
            replay alone; "" for nothing.
    """

    name: str
    agent: str
    fields: dict[str, Any] = field(default_factory=dict)
    preset: bool = False
    acting: dict[str, Any] = field(default_factory=dict)
    history: int = 1
    encoder: str = ""
    shift: int | None = None
    log: str = ""


def check_count(where: str, what: str, value: Any, least: int = 1) -> None:
    """Refuses what is no number of things.

    Raises:
        UserError: it is no whole number of `least` or more.
    """
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise UserError(f"{where}: {what} must be a whole number of {least} or more, got {value!r}")


def method(where: str, kind: str, name: str, table: Any) -> Method:
    """A line of `[methods]`.

    Args:
        where: the file, for errors.
        kind: of the suite.
        name: of the method.
        table: what the line says.

    Raises:
        UserError: it says something that cannot be.
    """
    kinds = {"agent": str, "fields": dict, "preset": bool}
    own = {"online": {"acting": dict, "log": str}, "learn": {"history": int, "encoder": str, "shift": int}}
    kinds |= own.get(kind, {})
    if not isinstance(table, dict) or "agent" not in table:
        raise UserError(f"{where}: method {name!r} must say its agent, such as {name} = {{ agent = 'bc' }}")
    for key in table:
        if key not in kinds:
            raise UserError(f"{where}: {unknown(f'key of method {name!r}', key, kinds)}")
    for key, value in table.items():
        if not isinstance(value, kinds[key]):
            raise UserError(f"{where}: {key} of method {name!r} must be a {kinds[key].__name__}, got {value!r}")
    check_count(where, f"shift of method {name!r}", table.get("shift", 0), least=0)
    check_count(where, f"history of method {name!r}", history := table.get("history", 1))
    if history > 1:
        from deadreckon.runs.settings import MOST_HISTORY  # with all that a run needs

        if history > MOST_HISTORY:
            raise UserError(f"{where}: history of method {name!r} must be <= {MOST_HISTORY:,}, got {history:,}")
    for key, value in table.get("fields", {}).items():
        if not _is_plain(value):
            plain = "a finite number, a text, a truth value or a list of such"
            raise UserError(f"{where}: {key} of method {name!r} must be {plain}, got {value!r}")
    if table.get("preset") and kind not in ("learn", "online"):
        has = "only agents have published settings, in suites of kind learn or online"
        raise UserError(f"{where}: preset of method {name!r}: {has}")
    if "encoder" in table:
        _check_encoder(where, f"encoder of method {name!r}", table["encoder"])
    if table.get("log", LOG[0]) not in LOG:
        raise UserError(f"{where}: log of method {name!r} must be one of {', '.join(LOG)}, got {table['log']!r}")
    if acting := table.get("acting"):
        _check_acting(where, f"acting of method {name!r}", acting)
    # A cell is the same in whatever order its settings are written, and however its agent is spelled.
    given: dict[str, Any] = {key: dict(sorted(v.items())) if isinstance(v, dict) else v for key, v in table.items()}
    if kind in ("learn", "online"):
        given["agent"] = canonical_name(given["agent"])
    return Method(name, **given)


def _is_plain(value: Any) -> bool:
    """Whether JSON can hold a value of TOML, which has dates, infinities and NaN too, and a field can be it."""
    if isinstance(value, list):
        return all(map(_is_plain, value))
    return math.isfinite(value) if isinstance(value, float) else isinstance(value, bool | int | str)


def _check_encoder(where: str, whose: str, name: str) -> None:
    """Refuses what no network of pictures is."""
    from deadreckon.nets.encoder import Kind  # which loads JAX

    if name not in get_args(Kind):
        raise UserError(f"{where}: {whose} must be one of {', '.join(get_args(Kind))}, got {name!r}")


def _check_acting(where: str, whose: str, acting: dict[str, Any]) -> None:
    """Refuses what `online.Online` does not have."""
    from deadreckon.online import Online

    defaults = {f.name: f.default for f in fields(Online)}
    for key, value in acting.items():
        if key not in defaults:
            raise UserError(f"{where}: {unknown(f'key of {whose}', key, defaults)}")
        whole = not isinstance(defaults[key], float)
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
            raise UserError(f"{where}: {key} of {whose} must be a {'whole ' if whole else ''}number, got {value!r}")
