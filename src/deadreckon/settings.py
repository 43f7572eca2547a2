"""Settings that functions take as keywords, hold as one object and pass on."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from deadreckon.errors import unknown


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of all settings: each field is declared and described once, for Python and for the command line."""

    @classmethod
    def of(cls, keywords: Mapping[str, Any]) -> Self:
        """Settings from keywords.

        Raises:
            UserError: there is no such setting.
        """
        names = [field.name for field in dataclasses.fields(cls)]
        for name in keywords:
            if name not in names:
                raise unknown("setting", name, names)
        return cls(**keywords)

    def check_values(self) -> None:
        """Refuses values that are out of range, whatever the log is.

        Raises:
            UserError: names the value and its range.
        """

    def only(self, kind: type["Settings"]) -> dict[str, Any]:
        """The settings of a base class, as keywords for the function that takes these."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(kind)}
