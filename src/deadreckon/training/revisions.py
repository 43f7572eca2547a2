"""Revisions of the code that decides numbers: whoever changes the numbers raises the one that stands in that file."""

from typing import Any

from deadreckon.data import batch
from deadreckon.training import program


def revisions(made: Any) -> list[int]:
    """Of a method, a task or the like, or of its class: `revision` of each class that it inherits from and that has one of its
    own, the nearest first, then those of what it holds, such as the critics of a doubly robust estimator.
    """
    kind = made if isinstance(made, type) else type(made)
    own = [vars(each)["revision"] for each in kind.__mro__ if "revision" in vars(each)]
    held = () if made is kind else vars(made).values()
    return own + [number for each in held if hasattr(type(each), "revision") for number in revisions(each)]


def of_learning() -> dict[str, int]:
    """Of how rows become batches, and of the training loop."""
    return {"batches": batch.REVISION, "training": program.REVISION}
