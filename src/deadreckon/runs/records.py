"""The shapes of what run folders say in JSON: they come from elsewhere, and are checked before anything looks into them.

Keys that older versions did not write need not be there, and keys that are not listed are kept as they are.
"""

from pathlib import Path
from typing import Any, NotRequired, TypedDict

from deadreckon.files import read_json
from deadreckon.foreign.shapes import same_length, wrong
from deadreckon.online import Online


class Agent(TypedDict):
    """The agent of a run."""

    name: str
    fields: dict[str, Any]


class Provenance(TypedDict):
    """Where its log comes from."""

    source: NotRequired[str | None]
    recipe: NotRequired[str | None]
    seed: NotRequired[int | None]
    versions: NotRequired[dict[str, Any] | None]
    path: NotRequired[str | None]
    extra: NotRequired[dict[str, Any] | None]


class Behavior(TypedDict):
    """What the behaviour policy returned."""

    mean: float
    low: float
    high: float


class Data(TypedDict):
    """The log of a run."""

    name: str
    fingerprint: NotRequired[str | None]
    rows: NotRequired[int]
    episodes: NotRequired[int]
    usable: NotRequired[int]
    holdout: NotRequired[dict[str, Any] | None]
    warnings: NotRequired[list[str]]
    behavior: NotRequired[Behavior | None]
    provenance: NotRequired[Provenance | None]


class Evaluation(TypedDict):
    """How often a run is evaluated."""

    every: NotRequired[int | None]
    episodes: NotRequired[int | None]


class Start(TypedDict):
    """What an online run goes on from."""

    path: str
    updates: int


class Held(TypedDict):
    """How many episodes are held out."""

    held: int


class Log(TypedDict):
    """The log in an online run's replay."""

    name: str
    rows: int
    share: float
    holdout: Held | None


class RunConfig(TypedDict):
    """`run.json`."""

    agent: Agent
    data: Data
    task: str | None
    seeds: list[int]
    steps: int
    versions: NotRequired[dict[str, Any]]
    evaluation: NotRequired[Evaluation]
    revisions: NotRequired[dict[str, Any]]
    online: NotRequired[Online | None]
    start: NotRequired[Start | None]
    log: NotRequired[Log | None]
    demonstrations: NotRequired[dict[str, Any] | None]
    history: NotRequired[Any]
    encoder: NotRequired[Any]
    shift: NotRequired[Any]
    together: NotRequired[Any]


class Status(TypedDict):
    """`status.json`."""

    step: NotRequired[int]
    steps: NotRequired[int]
    finished: NotRequired[bool]
    failures: NotRequired[list[tuple[str, int] | None] | None]


class CrossFitData(TypedDict):
    """The log of a cross-fit."""

    name: str
    fingerprint: str


class CrossFitConfig(TypedDict):
    """`crossfit.json`."""

    folds: int
    by: str
    seed: int
    data: CrossFitData
    deliver: str
    agent: NotRequired[Any]
    episodes: NotRequired[list[int]]
    members: NotRequired[list[tuple[int, int]]]


def read_run(path: Path | str) -> dict[str, Any]:
    """`run.json`; a run that has a seed twice or fewer steps than one is refused."""
    found = read_json(path, RunConfig)
    seeds = found["seeds"]
    if not seeds or len(set(seeds)) < len(seeds) or min(seeds) < 0:
        raise wrong(path, "seeds", "different whole numbers of 0 or more, at least one", seeds)
    return found


def read_status(path: Path | str, seeds: int | None = None) -> dict[str, Any]:
    """`status.json` of a run of so many seeds."""
    found = read_json(path, Status)
    if seeds is not None and found.get("failures") is not None:
        same_length(path, "failures", found["failures"], seeds)
    return found


def read_cross_fit(path: Path | str) -> dict[str, Any]:
    """`crossfit.json`."""
    found = read_json(path, CrossFitConfig)
    if not 2 <= found["folds"] <= 1_000:
        raise wrong(path, "folds", "a whole number from 2 to 1,000", found["folds"])
    return found
