"""Revisions of code that determines results: a change that alters the numbers must raise the revision in its file."""

from typing import Any

from deadreckon.data import batch
from deadreckon.training import program


def revisions(made: Any) -> list[int]:
    """Revisions of a method, a task or the like, or of its class: `revision` of each of its classes that defines one, the most
    derived first; then those of the objects in its fields, such as the critics of a doubly robust estimator.
    """
    kind = made if isinstance(made, type) else type(made)
    own = [vars(each)["revision"] for each in kind.__mro__ if "revision" in vars(each)]
    held = () if made is kind else vars(made).values()
    return own + [number for each in held if hasattr(type(each), "revision") for number in revisions(each)]


def of_learning() -> dict[str, int]:
    """Revisions of the making of batches from rows, and of the training loop."""
    return {"batches": batch.REVISION, "training": program.REVISION}
