"""The forms in which users may give policies, and their conversion to policies."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deadreckon.errors import UserError
from deadreckon.policies import store
from deadreckon.policies.dope import load_dope
from deadreckon.policies.policy import Policy

PICKLES = (".pkl", ".pickle")  # of DOPE


def policy_of_file(path: Path | str) -> Any:
    """The policy in a file of the package's (`.npz`) or of DOPE's (`.pkl`).

    Raises:
        UserError: it is neither.
    """
    path = Path(path)
    return load_dope(path) if path.suffix in PICKLES else store.load(path)


def policies_of(given: Any, kinds: tuple[type, ...] = ()) -> list[Any]:
    """Policies, in order.

    Args:
        given: a `Policy`, a policy file, a run, or a sequence of these.
        kinds: further types that stand for one policy each.

    Raises:
        UserError: none of these.
    """
    if isinstance(given, (Policy, *kinds)):
        return [given]
    if hasattr(given, "policies"):  # a run
        return list(given.policies)
    if isinstance(given, str | os.PathLike):
        return [policy_of_file(os.fspath(given))]
    if isinstance(given, Sequence) and not isinstance(given, bytes):
        return [policy for one in given for policy in policies_of(one, kinds)]
    raise UserError(f"policies must be policies, policy files or runs, got {type(given).__name__}")
