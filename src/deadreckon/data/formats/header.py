"""The header, of JSON values, that files written by this package have beside the columns of a log."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict

from deadreckon.data.dataset import Dataset
from deadreckon.data.provenance import Extra, Provenance
from deadreckon.data.spec import MOST_ACTIONS, Box, Discrete, action_space_from_json, action_space_to_json
from deadreckon.errors import UserError
from deadreckon.foreign.shapes import checked, wrong
from deadreckon.foreign.text import parse_json

FORMAT = 1  # raised when older versions cannot read new files


class _Provenance(TypedDict):
    source: str
    recipe: str | None
    seed: int | None
    versions: dict[str, str]
    path: str | None
    extra: Extra


class _Discrete(TypedDict):
    kind: Literal["Discrete"]
    n: int
    masked: NotRequired[bool]


class _Box(TypedDict):
    kind: Literal["Box"]
    low: list[float]
    high: list[float]


class _Header(TypedDict):
    deadreckon: int
    name: str
    action_space: _Discrete | _Box | None
    provenance: _Provenance


@dataclass(frozen=True)
class Header:
    """The header of a log, written or still being written.

    Attributes:
        name: of the log.
        action_space: None if the log has none.
        provenance: where the log comes from.
        columns: what a format stores about its columns: their names in a folder, their shapes in Parquet; else None.
    """

    name: str
    action_space: Box | Discrete | None
    provenance: Provenance
    columns: Any = None

    @classmethod
    def of(cls, log: Dataset, columns: Any = None) -> "Header":
        """The header of a log."""
        return cls(log.name, log.action_space, log.provenance, columns)

    def to_json(self) -> dict[str, Any]:
        """As JSON values, which `from_json` reads back."""
        space = None if self.action_space is None else action_space_to_json(self.action_space)
        found = {"deadreckon": FORMAT, "name": self.name, "action_space": space, "provenance": asdict(self.provenance)}
        return found if self.columns is None else {**found, "columns": self.columns}

    @classmethod
    def parse(cls, path: Path | str, text: str | bytes) -> "Header":
        """The header in `text`.

        Raises:
            UserError: one line: it is damaged, or was written by a newer version.
        """
        try:
            value = parse_json(path, text)
        except UserError as error:
            raise damaged(path, str(error)) from error
        return cls.from_json(path, value)

    @classmethod
    def from_json(cls, path: Path | str, value: Any) -> "Header":
        """`value` as a header; raises like `parse`."""
        version = value.get("deadreckon") if isinstance(value, dict) else None
        if type(version) is not int:
            raise damaged(path, "it names no format")
        if version > FORMAT:
            raise UserError(f"{path}: written by a newer deadreckon (format {version}); update to read it")
        try:
            checked(value, _Header, path)
            if (n := (value["action_space"] or {}).get("n", 1)) > MOST_ACTIONS:
                raise wrong(path, "action_space.n", f"a whole number up to {MOST_ACTIONS:,}", n)
            space = None if value["action_space"] is None else action_space_from_json(value["action_space"])
            provenance = Provenance(**value["provenance"])
        except (KeyError, TypeError, ValueError) as error:
            raise damaged(path, str(error).removeprefix(f"{path}: ")) from error
        return cls(value["name"], space, provenance, value.get("columns"))


def damaged(path: Path | str, why: str) -> UserError:
    """The error for a header that is not valid."""
    return UserError(f"{path}: its header is damaged ({why})")
