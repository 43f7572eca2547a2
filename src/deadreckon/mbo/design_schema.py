"""The schema of a table of experiments: roles of its columns and rules of proposals, as a TOML file to check and edit.

    target = "yield"
    constraints = ["a + b <= 0.8"]

    [columns.temp]
    role = "input"
    kind = "continuous"
    low = 20.0
    high = 90.0
    step = 5.0
"""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from deadreckon.data.formats.kind import READING
from deadreckon.data.kinds import check_column
from deadreckon.data.schema import toml_value
from deadreckon.errors import UserError, unknown
from deadreckon.files import read_toml, write_text
from deadreckon.foreign.shapes import checked, wrong
from deadreckon.mbo.constraints import quoted
from deadreckon.mbo.design_table import name_of, read_for, warn
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.variables import KINDS
from deadreckon.names import shown

ROLES = ("input", "target", "std_error", "weighted", "group", "ignore")
# The entries of columns in one role alone, beside role and unit; an ignored column may have any of them.
_ENTRIES = {"input": ("kind", "low", "high", "levels", "step", "log", "fix"), "weighted": ("weight",)}
_LISTS = ("constraints", "mixtures", "forbidden")

Value = str | bool | int | float | datetime.date | datetime.datetime | datetime.time  # of TOML


@dataclass(frozen=True)
class DesignColumn:
    """Role and properties of a column of a table of experiments.

    Attributes:
        role: `input` (a variable), `target` (the score), `std_error` (of the target), `weighted` (added to the score with a
            weight, such as a cost), `group` (of rows that are held out together, such as a batch) or `ignore`.
        kind: of an input, among `mbo.variables.KINDS`.
        low, high: its bounds; None: the range of the data.
        levels: of a categorical or ordinal input; of an ordinal one in order.
        step: proposals are multiples of it.
        log: whether models use its logarithm.
        fix: the value that proposals have; None: it is searched.
        weight: of a weighted column.
        unit: of its numbers, for readers of the file; it has no effect.
        about: a comment on the contents of the column.
    """

    role: str
    kind: str | None = None
    low: float | None = None
    high: float | None = None
    levels: tuple[Value, ...] | None = None
    step: float | None = None
    log: bool = False
    fix: Value | None = None
    weight: float | None = None
    unit: str = ""
    about: str = field(default="", compare=False)


_IN_FILE = [each.name for each in fields(DesignColumn) if each.name != "about"]  # entries of a column in a file


@dataclass(frozen=True)
class DesignSchema:
    """Columns, rules of proposals, and options of the reader.

    Attributes:
        columns: by name.
        minimise: whether the target is minimised; if a column has that role, it applies to this column only.
        constraints, mixtures, forbidden: see `mbo.rules.Rules.of`.
        max_distance, apart: see `mbo.rules.Rules`.
        table: options of the reader of tables, such as `separator` and `decimal`.
    """

    columns: Mapping[str, DesignColumn]
    minimise: bool = False
    constraints: tuple[str, ...] = ()
    mixtures: tuple[tuple[str, ...], ...] = ()
    forbidden: tuple[str, ...] = ()
    max_distance: float | None = None
    apart: float | None = None
    table: Mapping[str, str | int] = field(default_factory=dict)

    def named(self, role: str) -> list[str]:
        """The columns in a role."""
        return [name for name, column in self.columns.items() if column.role == role]

    def options(self) -> dict[str, Any]:
        """The schema as keywords of `Designs.from_frame`, including `target`."""
        inputs = {name: column for name, column in self.columns.items() if column.role == "input"}
        targets, errors, groups = self.named("target"), self.named("std_error"), self.named("group")
        return {
            "target": targets[0] if targets else None,
            "minimise": self.minimise,
            "ignore": tuple(self.named("ignore")),
            "std_error": errors[0] if errors else None,
            "groups": groups[0] if groups else None,
            "weights": {name: self.columns[name].weight for name in self.named("weighted")},
            "kinds": {name: column.kind for name, column in inputs.items() if column.kind},
            "bounds": {name: (c.low, c.high) for name, c in inputs.items() if c.low is not None and c.high is not None},
            "levels": {name: column.levels for name, column in inputs.items() if column.levels},
            "steps": {name: column.step for name, column in inputs.items() if column.step is not None},
            "logs": tuple(name for name, column in inputs.items() if column.log),
            "fixed": tuple(f"`{name}` = {quoted(column.fix)}" for name, column in inputs.items() if column.fix is not None),
            "constraints": self.constraints, "mixtures": self.mixtures, "forbidden": self.forbidden,
            "max_distance": self.max_distance, "apart": self.apart,
        }  # fmt: skip

    def called(self, more: Mapping[str, Any]) -> "DesignSchema":
        """The schema for a call with further keywords `more` of `Designs.from_frame`, including `target`.

        A column that the call uses as an output (target, standard error, weighted) or as groups loses its role in the schema,
        and a column that it ignores is no input. The schema's target, standard error and groups are ignored if the call names
        others. `minimise`, the standard error and weighted columns belong to the schema's target and apply to no other one.
        """
        own, said = self.named("target"), more.get("target")
        mine = not own or said in (None, *own)
        old = [*(own if said else ()), *(self.named("std_error") if more.get("std_error") or not mine else ())]
        old += [*([] if mine else self.named("weighted")), *(self.named("group") if more.get("groups") else ())]
        outputs = said, more.get("std_error"), more.get("groups"), *(more.get("weights") or ())
        ignored = more.get("ignore") or ()
        columns = {
            name: DesignColumn("ignore") if name in old else column for name, column in self.columns.items()
            if name not in outputs and not (name in ignored and column.role == "input")
        }  # fmt: skip
        return replace(self, columns=columns, minimise=self.minimise and mine)

    def read(self, path: Path | str, **more: Any) -> Designs:
        """Reads the designs of a file by this schema.

        Args:
            path: of the file.
            more: keywords of `Designs.from_frame`, whose mappings and lists are added to those of the schema and whose other
                values replace them; and options of the reader, which replace those of the schema.

        Raises:
            UserError: there is no target, a column is not in the file (one that the schema ignores need not be), or
                `Designs.from_frame` refuses the table.
        """
        ways = {**self.table, **{key: more.pop(key) for key in READING if key in more}}
        called = self.called(more)
        asked = together(called.options(), more)
        target = asked.pop("target")
        table, told, converts = read_for(path, ways, target, asked)
        warn(path, told)
        if target is None:
            raise UserError(f'{path}: no column is the target; give one the role "target" in the schema, or name it (--target)')
        name, noticed = asked.pop("name", name_of(path)), asked.pop("noticed", ())
        for column in called.named("input"):
            check_column(table, column, name)
        known = {*self.columns, target, asked["std_error"], asked["groups"], *asked["weights"], *asked["ignore"]}
        strangers = [name for name in table.column_names if name not in known and name.strip()]
        left = [f"not in the schema and left out: {', '.join(strangers)}"] if strangers else []
        warn(path, left)
        here = [each for each in asked["ignore"] if each in table.column_names or each in (more.get("ignore") or ())]
        asked["ignore"] = [*here, *strangers]
        asked.setdefault("converted", converts)
        return Designs.from_frame(table, target, name=name, noticed=[*noticed, *told, *left], **asked)

    @classmethod
    def load(cls, path: Path | str) -> "DesignSchema":
        """Reads a schema from a TOML file.

        Raises:
            UserError: one line with the file, the column and what is wrong.
        """
        if not Path(path).exists():
            raise UserError(f"no file {path}; `deadreckon design describe TABLE --save {path}` drafts a schema")
        given = read_toml(path)
        if not isinstance(given.get("columns"), Mapping):
            raise UserError(f"{path}: a schema needs a table [columns.NAME] for each column")
        for name, told in given["columns"].items():
            if not isinstance(told, Mapping) or told.get("role") not in ROLES:
                got = told.get("role") if isinstance(told, Mapping) else told
                raise UserError(f"{path}, column {name} needs a role ({', '.join(ROLES)}), got {got!r}")
            for key in told:
                if key not in _IN_FILE:  # comments on a column stand behind #
                    raise UserError(f"{path}, column {name}: {unknown('entry', key, _IN_FILE)}")
        if not isinstance(given.get("table", {}), Mapping):
            raise UserError(f"{path}: [table] holds options of the file such as separator, got {given['table']!r}")
        for key, value in given.get("table", {}).items():
            if key not in READING:
                raise UserError(f"{path}, [table]: {unknown('entry', key, READING)}")
            if key != "sheet" and not isinstance(value, str):
                raise wrong(path, f"table.{key}", "a text", value)
        checked(given, cls, path)
        columns = {name: _column(f"{path}, column {name}", told) for name, told in given["columns"].items()}
        for role in ("target", "std_error", "group"):
            if len(both := [name for name, column in columns.items() if column.role == role]) > 1:
                raise UserError(f"{path}: columns {both[0]} and {both[1]} both have the role {role}; only one column can")
        rest = {key: value for key, value in given.items() if key != "columns"}
        rest |= {key: tuple(map(tuple if key == "mixtures" else str, rest[key])) for key in _LISTS if key in rest}
        return cls(columns, **rest)

    def to_toml(self, about: str = "") -> str:
        """The schema as TOML, with comments on the contents of the columns."""
        lines = [f"# {shown(about)}", ""] if about else []
        lines += [
            "# What proposals must satisfy. Examples:",
            '#   constraints = ["a + 2 b <= 0.8"]  mixtures = [["a", "b", "c"]]  forbidden = ["solvent = water & temp > 80"]',
            "# Columns of numbers may have low, high, step, log = true and fix; ordinal ones need their levels in order.",
            f"minimise = {toml_value(self.minimise)}",
            *(f"{key} = {toml_value(getattr(self, key))}" for key in _LISTS),
            *(f"{key} = {toml_value(far)}" for key in ("max_distance", "apart") if (far := getattr(self, key)) is not None), "",
        ]  # fmt: skip
        if self.table:
            lines += ["[table]", *(f"{key} = {toml_value(value)}" for key, value in self.table.items()), ""]
        for name, column in self.columns.items():
            lines.append(f"[columns.{toml_value(name)}]")
            lines += [f"# {shown(' '.join(column.about.split()))}"] if column.about else []
            told = [(f.name, getattr(column, f.name), f.default) for f in fields(column) if f.name != "about"]
            lines += [f"{key} = {toml_value(value)}" for key, value, usual in told if value != usual]
            lines.append("")
        return "\n".join(lines)

    def save(self, path: Path | str, about: str = "") -> None:
        """Writes the schema as TOML; see `to_toml`. Atomic."""
        write_text(path, self.to_toml(about))


def _column(where: str, told: Mapping[str, Any]) -> DesignColumn:
    """The column of entries whose types are right."""
    role = told["role"]
    for owner, entries in _ENTRIES.items():
        for key in told:
            if key in entries and role not in (owner, "ignore"):
                raise UserError(f"{where}: {key} is of the role {owner}, and its role is {role}; leave {key} out")
    if told.get("kind", KINDS[0]) not in KINDS:
        raise UserError(f"{where}: {unknown('kind', told['kind'], KINDS)}")
    if ("low" in told) != ("high" in told):
        raise UserError(f"{where}: low and high go together; one of them is missing")
    if role == "weighted" and "weight" not in told:
        raise UserError(f"{where}: a weighted column needs weight, a number")
    if told.get("levels") == []:
        raise UserError(f"{where}: levels must be a list of values, got []")
    given: dict[str, Any] = {key: tuple(value) if key == "levels" else value for key, value in told.items()}
    return DesignColumn(**given)


def together(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Merges options: mappings and tuples of `second` are added to those of `first`; other values replace them, except None,
    and except False for a key of `first`."""
    out = dict(first)
    for key, value in second.items():
        before = out.get(key)
        if isinstance(before, Mapping):
            out[key] = {**before, **(value or {})}
        elif isinstance(before, tuple):
            out[key] = (*before, *(value or ()))
        elif value is not None and (value is not False or key not in first):
            out[key] = value
    return out
