"""`agent.fit(log)`: training with defaults, into a new folder with every call."""

import itertools
from pathlib import Path
from typing import Any

from deadreckon.agents import short_name
from deadreckon.agents.agent import Agent
from deadreckon.data import catalogue
from deadreckon.data.dataset import Dataset
from deadreckon.names import file_part
from deadreckon.runs.run import Run
from deadreckon.runs.train import train


def fit(agent: Agent, data: Dataset | str | Path, *, out: Path | str | None = None, **settings: Any) -> Run:
    """Implements `agent.fit(data)`: `train` in a new folder."""
    if out is None:
        log = data if isinstance(data, Dataset) else catalogue.load(data, strict=bool(settings.get("strict")))
        data, stem = log, file_part(f"{short_name(agent)}-{log.name}")
        names = (stem if number == 1 else f"{stem}-{number}" for number in itertools.count(1))
        out = next(path for name in names if not (path := Path("runs") / name).exists())
    return train(agent, data, out=out, **settings)
