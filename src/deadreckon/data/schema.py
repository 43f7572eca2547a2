"""The schema of a table: role, kind, levels, unit, range and fill value of each column; also as TOML."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict, get_args

from deadreckon.errors import UserError, unknown
from deadreckon.files import read_toml, write_text
from deadreckon.names import is_control, repeated, safe_path, shown

Role = Literal[
    "observation", "action", "reward", "next_observation", "episode", "time", "group", "terminal", "timeout", "propensity",
    "legal", "next_legal", "cost", "weight", "keep", "ignore",
]  # fmt: skip
Kind = Literal["number", "integer", "category", "flag", "date"]
ROLES, KINDS = get_args(Role), get_args(Kind)
ONE = ("reward", "episode", "time", "group", "terminal", "timeout", "propensity", "weight")  # roles of one column at most
# The kinds that a column may have in a role; any kind in the others.
ALLOWED: dict[str, tuple[str, ...]] = {
    "observation": ("number", "integer", "category", "flag"), "next_observation": ("number", "integer", "category", "flag"),
    "action": ("number", "integer", "category", "flag"), "reward": ("number", "integer", "flag"),
    "time": ("number", "integer", "date"), "terminal": ("flag", "integer", "number"),
    "timeout": ("flag", "integer", "number"), "propensity": ("number", "integer"),
    "cost": ("number", "integer", "flag"), "weight": ("number", "integer"),
    "legal": ("category", "flag"), "next_legal": ("category", "flag"),
}  # fmt: skip
# What [table] may hold: the file, and the options of `formats.any_table.table_of_kind`.
_TABLE = ("path", "separator", "decimal", "thousands", "encoding", "dates", "sheet", "query", "table")

Level = str | int | float | bool


class ColumnValues(TypedDict):
    """The shape of a column in JSON and TOML."""

    role: Role
    kind: NotRequired[Kind]
    levels: NotRequired[list[Level] | None]
    unit: NotRequired[str]
    low: NotRequired[float | None]
    high: NotRequired[float | None]
    fill: NotRequired[float | None]
    marked: NotRequired[bool | None]
    keep: NotRequired[bool]
    of: NotRequired[str | None]


class SchemaValues(TypedDict):
    """The shape of a schema in JSON and TOML."""

    columns: dict[str, ColumnValues]
    table: NotRequired[dict[str, str | int]]


@dataclass(frozen=True)
class Column:
    """The description of one column of a table.

    Attributes:
        name: of the column in the table.
        role: its use; `ignore` leaves it out, `keep` stores it beside the log.
        kind: how its values are read. An observation of kind category becomes one 0/1 number per level, of kind flag one;
            an action of kind integer, category or flag is discrete, of kind number continuous.
        levels: of a category, or of a discrete action's integers, in the order of their codes; None: those that the table has.
        unit: of its numbers, such as "kW"; shown, and never converted.
        low: smallest value possible; of a continuous action the lower bound. None: not known.
        high: largest value possible; see `low`.
        fill: number that stands for missing values; None: the mean of the table.
        marked: whether a further 0/1 number marks missing values; None: if the table has missing values.
        keep: whether it is kept beside the log as an extra, too; columns of the role keep, group, cost and weight always are.
        of: of a next observation, the name of the observation that it is the next value of; of a flag of the role legal (or
            next_legal), the action that it is for. A category of that role lists actions: a list, or a text such as a|b.
        reason: of this role and kind.
        doubt: what somebody who knows the table should check; empty if nothing.
    """

    name: str
    role: Role
    kind: Kind = "number"
    levels: tuple[Any, ...] | None = None
    unit: str = ""
    low: float | None = None
    high: float | None = None
    fill: float | None = None
    marked: bool | None = None
    keep: bool = False
    of: str | None = None
    reason: str = field(default="", compare=False)
    doubt: str = field(default="", compare=False)

    def __post_init__(self):
        where = f"schema, column {self.name}"
        if self.role not in ROLES:
            raise UserError(f"{where}: {unknown('role', str(self.role), ROLES)}")
        if self.kind not in KINDS:
            raise UserError(f"{where}: {unknown('kind', str(self.kind), KINDS)}")
        if (allowed := ALLOWED.get(self.role)) and self.kind not in allowed:
            raise UserError(f"{where}: kind {self.kind} does not go with the role {self.role}; possible: {', '.join(allowed)}")
        for key in ("low", "high", "fill"):
            value = getattr(self, key)
            if value is not None and not _is_number(value):
                raise UserError(f"{where}: {key} must be a finite number, got {value!r:.60}")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise UserError(f"{where}: low must be smaller than high, got {self.low:g} and {self.high:g}")
        if self.role == "action" and self.kind == "number" and (self.low is None) != (self.high is None):
            raise UserError(f"{where}: a continuous action needs both of low and high, or neither (the range of the table)")
        if self.levels is not None:
            if not isinstance(self.levels, list | tuple) or not self.levels:
                raise UserError(f"{where}: levels must be a list of the values that the column may have, got {self.levels!r}")
            if wrong := [level for level in self.levels if not (isinstance(level, str | bool) or _is_number(level))]:
                raise UserError(f"{where}: levels are texts, numbers or truth values, got {wrong[0]!r:.60}")
            # 1 and 1.0 are one level, as are true and the text that truth values become; true and 1 are two.
            if len({str(each).lower() if isinstance(each, bool) else each for each in self.levels}) < len(self.levels):
                raise UserError(f"{where}: a level is listed twice: {', '.join(map(str, self.levels))}")
            if self.kind != "category" and (self.role != "action" or self.kind == "number"):
                which = "a discrete action (kind integer, category or flag)" if self.role == "action" else "kind category"
                raise UserError(f"{where}: levels go with {which}, not with kind {self.kind}")
            object.__setattr__(self, "levels", tuple(self.levels))
        for key in ("marked", "keep"):
            if not isinstance(getattr(self, key), bool | None):
                raise UserError(f"{where}: {key} must be true or false, got {getattr(self, key)!r}")
        for key in ("unit", "of", "reason", "doubt"):
            if not isinstance(getattr(self, key), str | None):
                raise UserError(f"{where}: {key} must be a text, got {getattr(self, key)!r}")

    def told(self) -> dict[str, Any]:
        """The column as JSON values, without its name, reason and doubt and without defaults."""
        silent = ("name", "reason", "doubt")
        given = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in silent}
        # By identity: a range that begins at 0, or a fill of 0, is equal to False. `marked` has None as its default.
        unsaid = {key for key, value in given.items() if value is None or (value is False and key != "marked") or value == ""}
        given = {key: value for key, value in given.items() if key not in unsaid}
        return {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}


@dataclass(frozen=True)
class Schema:
    """The columns of a table, and how its file is written.

    Attributes:
        columns: the description of each. Observations, and actions, are dimensions in this order.
        table: the `path` of the table's file, relative to the schema's, and options of its reader.
    """

    columns: tuple[Column, ...]
    table: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        for key, value in self.table.items():
            if key not in _TABLE:
                raise UserError(f"schema, [table]: {unknown('entry', str(key), _TABLE)}")
            if isinstance(value, bool) or not isinstance(value, str | int if key == "sheet" else str):
                raise UserError(f"schema, [table]: {key} must be a text{' or a number' * (key == 'sheet')}, got {value!r}")
        if twice := repeated(column.name for column in self.columns):
            raise UserError(f"schema: column {twice[0]} is described twice")
        for role in ONE:
            if len(found := self.named(role)) > 1:
                raise UserError(f"schema: columns {found[0]} and {found[1]} both have the role {role}; only one column can")
        observed = self.named("observation")
        for column in self.having("next_observation"):
            if column.of is None or column.of not in observed:
                told = f"the name of an observation ({', '.join(observed) or 'there is none'})"
                raise UserError(f"schema, column {column.name}: a next observation needs of = {told}")

    def having(self, *roles: Role) -> tuple[Column, ...]:
        """The columns in one of these roles."""
        return tuple(column for column in self.columns if column.role in roles)

    def named(self, *roles: Role) -> list[str]:
        """The names of the columns in one of these roles."""
        return [column.name for column in self.having(*roles)]

    def one(self, role: Role) -> Column | None:
        """The column in a role that one column can have, or None."""
        return next(iter(self.having(role)), None)

    def file_beside(self, path: Path | str) -> Path:
        """The table that the schema in the file `path` names, which lies in the same folder or below it.

        Raises:
            UserError: it names none, or one in another folder.
        """
        name = self.table.get("path")
        if not isinstance(name, str) or not name:
            text = f'{path}: the schema names no table; add path = "FILE" to its [table]'
            raise UserError(f"{text}, or give the table and --schema {path}")
        try:
            return Path(path).parent / safe_path(name, "table")
        except UserError as error:
            text = f"{path}: its table {name} must lie beside the schema ({error})"
            raise UserError(f"{text}; give the table itself and --schema {path}") from error

    def options(self) -> dict[str, Any]:
        """The options for reading the table's file: the entries of [table] except its path."""
        return {key: value for key, value in self.table.items() if key != "path"}

    def read_as(self, options: Mapping[str, Any] | None) -> "Schema":
        """The same columns for a table that is read with other options; dates keep their order unless one is given."""
        if options is None:
            return self
        dates = {key: value for key, value in self.table.items() if key == "dates"}
        return replace(self, table=dates | dict(options))

    def resolved(self, columns: Iterable[Column]) -> "Schema":
        """The same schema in which these columns replace those of their names."""
        new = {column.name: column for column in columns}
        return replace(self, columns=tuple(new.get(column.name, column) for column in self.columns))

    def to_json(self) -> dict[str, Any]:
        """As JSON values; `from_json` reads them back."""
        columns = {column.name: column.told() for column in self.columns}
        return {"columns": columns} | ({"table": dict(self.table)} if self.table else {})

    @classmethod
    def from_json(cls, value: Any, where: str = "schema") -> "Schema":
        """The inverse of `to_json`.

        Raises:
            UserError: one line that names the column and what is wrong with it.
        """
        if not isinstance(value, Mapping) or not isinstance(value.get("columns"), Mapping):
            raise UserError(f"{where}: a schema needs a table [columns.NAME] for each column")
        if more := sorted(set(value) - {"columns", "table"}):
            raise UserError(f"{where}: {unknown('entry', more[0], ('columns', 'table'))}")
        table = value.get("table", {})
        if not isinstance(table, Mapping):
            raise UserError(f"{where}: [table] holds options of the file such as separator, got {table!r}")
        known = [f.name for f in fields(Column) if f.name not in ("name", "reason", "doubt")]
        columns = []
        for name, given in value["columns"].items():
            if not isinstance(given, Mapping) or "role" not in given:
                raise UserError(f"{where}: column {name} needs a role ({', '.join(ROLES)})")
            for key in given:
                if key not in known:
                    raise UserError(f"{where}, column {name}: {unknown('entry', key, known)}")
            columns.append(Column(str(name), **given))
        return cls(tuple(columns), dict(table))

    def to_toml(self, about: str = "") -> str:
        """As TOML, with each column's reason and doubts as comments.

        Args:
            about: first comment, such as the name of the table.
        """
        lines = [f"# {shown(about)}"] if about else []
        if any(column.doubt for column in self.columns):
            lines.append("# Lines that begin with `# ?` are doubts: check them against what you know of the table.")
        lines.append("")
        if self.table:
            lines += ["[table]", *(f"{key} = {toml_value(value)}" for key, value in self.table.items()), ""]
        for column in self.columns:
            lines.append(f"[columns.{toml_value(column.name)}]")
            # On one line whatever they quote, since what follows a line break would be no comment.
            lines += [f"# ? {shown(' '.join(column.doubt.split()))}"] if column.doubt else []
            lines += [f"# {shown(' '.join(column.reason.split()))}"] if column.reason else []
            lines += [*(f"{key} = {toml_value(value)}" for key, value in column.told().items()), ""]
        return "\n".join(lines)

    def save(self, path: Path | str, about: str = "") -> None:
        """Writes the schema as TOML; see `to_toml`. Atomic."""
        write_text(path, self.to_toml(about))

    @classmethod
    def load(cls, path: Path | str) -> "Schema":
        """Reads a schema from a TOML file.

        Raises:
            UserError: one line with the file and what is wrong in it.
        """
        if not Path(path).exists():
            raise UserError(f"no file {path}; `deadreckon data describe TABLE --save {path}` drafts a schema")
        return cls.from_json(read_toml(path), str(path))


def _is_number(value: Any) -> bool:
    """Whether a value is a finite number that float64 holds; a whole one may have any number of digits."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e300 < value < 1e300


def as_schema(schema: "Schema | Mapping[str, Any] | Path | str") -> Schema:
    """A schema as users may give it: the object, its JSON values, or the path of its TOML file."""
    if isinstance(schema, Schema):
        return schema
    return Schema.from_json(schema) if isinstance(schema, Mapping) else Schema.load(schema)


def toml_value(value: Any) -> str:
    """A value as TOML writes it; JSON's texts, numbers and lists are TOML's too."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # inf, -inf and nan are TOML, and JSON has other words
    # JSON escapes the control characters of ASCII alone; TOML takes the same escapes of all others, but of no half characters.
    text = json.dumps(value, ensure_ascii=False)
    return "".join(f"\\u{ord(c):04x}" if is_control(c) and not "\ud800" <= c <= "\udfff" else c for c in text)
