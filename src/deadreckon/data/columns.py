"""The columns that a log consists of: their names in `Dataset.from_arrays`, and the names that are left for further ones."""

from collections.abc import Mapping
from typing import Any

from deadreckon.errors import UserError

NEEDED = ("observations", "actions", "rewards")
COLUMNS = (*NEEDED, "terminals", "timeouts", "next_observations", "final_observations", "final_known")
# Names that a further column cannot have, because they are arguments of `Dataset.from_arrays`.
RESERVED = frozenset({*COLUMNS, "action_space", "name", "provenance", "strict", "cls"})
LOG_PROBS = "behavior_log_probs"  # the further column of the logging policy's log-probabilities


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
