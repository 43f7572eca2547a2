"""A run that is stopped and gone on with, beside one that is not."""

from pathlib import Path
from typing import Any

import deadreckon as dr
from deadreckon.online import Online


def whole_and_resumed(agent: Any, settings: Online, folder: Path, part: int, whole: int, chunk: int) -> tuple[Any, Any]:
    """Runs of `whole` environment steps on the inverted pendulum; the second stopped after `part` of them."""

    def train(out: str, steps: int, resume: bool = False) -> Any:
        return dr.train_online(
            agent, "inverted-pendulum", steps=steps, settings=settings, out=folder / out, evaluate_every=40, episodes=1,
            chunk=chunk, threads=1, resume=resume,
        )  # fmt: skip

    uncut = train("whole", whole)
    train("part", part)
    return uncut, train("part", whole, resume=True)
