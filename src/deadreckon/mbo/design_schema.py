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

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from deadreckon.data.formats.kind import READING
from deadreckon.data.kinds import check_column
from deadreckon.data.schema import toml_value
from deadreckon.errors import UserError, unknown
from deadreckon.files import read_toml, replacing
from deadreckon.foreign.shapes import checked, wrong
from deadreckon.mbo.constraints import quoted
from deadreckon.mbo.design_table import as_numbers, name_of, named_levels, read_designs, warn
from deadreckon.mbo.design_values import DesignValues
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.variables import KINDS
from deadreckon.names import shown

ROLES = ("input", "target", "std_error", "weighted", "group", "ignore")
# The entries of a column in each role, beside role and unit; an ignored column may have any of them.
_ENTRIES: dict[str, set[str]] = {
    "input": {"kind", "low", "high", "levels", "step", "log", "fix"},
    "target": set(),
    "std_error": set(),
    "weighted": {"weight"},
    "group": set(),
}
_LISTS = ("constraints", "mixtures", "forbidden")


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
    levels: tuple[Any, ...] | None = None
    step: float | None = None
    log: bool = False
    fix: Any = None
    weight: float | None = None
    unit: str = ""
    about: str = field(default="", compare=False)


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
    table: Mapping[str, Any] = field(default_factory=dict)

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
        targets = set(more.get("targets", ()))
        numbers = targets | {asked["target"], *asked["weights"], *as_numbers(asked["kinds"])}
        ignored, texts = set(asked["ignore"]) - targets, named_levels(asked["kinds"], asked["levels"])
        table, _, told, converts = read_designs(path, ways, ignored, numbers, targets or {asked["target"]}, texts)
        warn(path, told)
        target = asked.pop("target")
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
        known = [f.name for f in fields(cls)]
        for key in given:
            if key not in known:
                raise UserError(f"{path}: {unknown('entry', key, known)}")
        if not isinstance(given.get("columns"), Mapping):
            raise UserError(f"{path}: a schema needs a table [columns.NAME] for each column")
        columns = {name: _column(f"{path}, column {name}", told) for name, told in given["columns"].items()}
        for role in ("target", "std_error", "group"):
            if len(both := [name for name, column in columns.items() if column.role == role]) > 1:
                raise UserError(f"{path}: columns {both[0]} and {both[1]} both have the role {role}; only one column can")
        for key in _LISTS:
            if not isinstance(given.get(key, []), list):
                raise UserError(f"{path}: {key} must be a list, got {given[key]!r}")
        if not isinstance(given.get("table", {}), Mapping):
            raise UserError(f"{path}: [table] holds options of the file such as separator, got {given['table']!r}")
        for key in given.get("table", {}):
            if key not in READING:
                raise UserError(f"{path}, [table]: {unknown('entry', key, READING)}")
            if key != "sheet" and not isinstance(given["table"][key], str):
                raise wrong(path, f"table.{key}", "a text", given["table"][key])
        checked(given, DesignValues, path)
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
        with replacing(path) as temporary:
            temporary.write_text(self.to_toml(about), encoding="utf-8")


def _column(where: str, told: Any) -> DesignColumn:
    known = [f.name for f in fields(DesignColumn) if f.name != "about"]
    if not isinstance(told, Mapping) or told.get("role") not in ROLES:
        got = told.get("role") if isinstance(told, Mapping) else told
        raise UserError(f"{where} needs a role ({', '.join(ROLES)}), got {got!r}")
    for key, value in told.items():
        if key not in known:
            raise UserError(f"{where}: {unknown('entry', key, known)}")
        if key in ("low", "high", "step", "weight") and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise UserError(f"{where}: {key} must be a number, got {value!r}")
    role = told["role"]
    for key in told:
        if key not in _ENTRIES.get(role, set(known)) | {"role", "unit"}:
            owner = next(each for each, entries in _ENTRIES.items() if key in entries)
            raise UserError(f"{where}: {key} is of the role {owner}, and its role is {role}; leave {key} out")
    if told.get("kind", KINDS[0]) not in KINDS:
        raise UserError(f"{where}: {unknown('kind', str(told['kind']), KINDS)}")
    if ("low" in told) != ("high" in told):
        raise UserError(f"{where}: low and high go together; one of them is missing")
    if role == "weighted" and "weight" not in told:
        raise UserError(f"{where}: a weighted column needs weight, a number")
    if "levels" in told and not (isinstance(told["levels"], list) and told["levels"]):
        raise UserError(f"{where}: levels must be a list of values, got {told['levels']!r}")
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
