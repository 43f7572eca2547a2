"""`estimates.json`, which `judge` and `recommend` write: its fields, which are checked when it is read, numbers that JSON does
not have, and the files of its policies.
"""

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict

from deadreckon.errors import UserError
from deadreckon.files import content_digest, is_there, read_json, write_json
from deadreckon.foreign.shapes import checked, same_length, wrong

ESTIMATES = "estimates.json"
Number = float | None | Literal["Infinity", "-Infinity"]


class Estimand(TypedDict):
    """What is estimated."""

    words: str
    discount: NotRequired[float]
    horizon: NotRequired[int | None]
    greedy: NotRequired[bool]


class JudgedPolicy(TypedDict):
    """A policy that was evaluated."""

    name: str
    run: str
    seed: int | None
    file: NotRequired[str | None]
    beside: NotRequired[str | None]
    digest: NotRequired[str | None]


class JudgedOn(TypedDict):
    """The episodes on which they were evaluated."""

    words: str
    episodes: int
    of: int
    fresh: bool
    cluster: str | None
    units: NotRequired[int]
    clusters: NotRequired[int | None]


class Looks(TypedDict):
    """The number of evaluations on these episodes."""

    number: int
    policies: int
    counted: bool
    alpha: NotRequired[float]


class Support(TypedDict):
    """The support of the log for each policy, as one number per policy."""

    missing: list[Number]
    ratio: list[Number]
    degenerate: NotRequired[list[bool]]


class Result(TypedDict):
    """The estimates of an estimator for each policy, and last for the behaviour policy."""

    method: str
    title: str
    value: list[Number]
    low: list[Number]
    high: list[Number]
    gain: list[tuple[Number, Number, Number]]
    effective: list[Number] | None
    corrected: NotRequired[bool]
    seconds: NotRequired[Number]
    warnings: NotRequired[list[str]]
    diagnostics: NotRequired[dict[str, list[Number]]]


class Cost(TypedDict):
    """The total of a cost."""

    column: str
    limit: float | None
    ends: list[tuple[Number, Number, Number]]


class Group(TypedDict):
    """The gain in a group."""

    name: str
    episodes: int
    gain: Number
    low: Number
    high: Number
    why: NotRequired[str | None]


class Groups(TypedDict):
    """Gains in groups, or the reason why they are not known."""

    column: str
    refused: NotRequired[str]
    values: NotRequired[list[Group]]


class Latest(TypedDict):
    """The gain of the chosen policy in the latest third of the episodes, or the reason why it is not compared."""

    why: str
    p_value: float | None
    before: float | None
    gain: float | None
    low: float | None
    high: float | None


class OverTime(TypedDict):
    """The test whether the behaviour policy changed along the log or its clusters, and whether estimates are adjusted."""

    stationary: bool
    p_value: Number
    adjusted: bool
    within_clusters: NotRequired[bool]
    latest: NotRequired[Latest]


class Choice(TypedDict):
    """The decision."""

    name: str | None
    deploy: bool
    gain: tuple[Number, Number, Number]
    level: float | None
    reason: str
    evidence: list[str]
    warnings: list[str]
    objections: list[list[str]]
    costs: NotRequired[list[Cost]]
    groups: NotRequired[Groups]
    over_time: NotRequired[OverTime]


class Truth(TypedDict):
    """Values from a simulator; `apart` has the standard errors of the differences of all policies."""

    episodes: int
    mean: list[float]
    error: list[float]
    apart: NotRequired[list[list[float]]]
    task: NotRequired[str]
    beyond: NotRequired[float]


class Candidate(TypedDict):
    """A candidate that `recommend` has tried."""

    name: str
    updates: int
    planned: int
    state: str
    why: str | None


class Recommended(TypedDict):
    """What `recommend` adds."""

    budget: float
    seconds: float
    rows: int | None
    episodes: int | None
    candidates: list[Candidate]
    late: Any
    failed: bool


class Estimates(TypedDict):
    """`estimates.json`."""

    log: str
    estimand: Estimand | None
    truth: Truth | None
    policies: list[JudgedPolicy]
    judged: JudgedOn | None
    results: list[Result]
    choice: Choice
    looks: NotRequired[Looks]
    support: NotRequired[Support]
    propensities: NotRequired[Literal["logged", "learned"]]
    seed: NotRequired[int]
    recommend: NotRequired[Recommended]


def saved_at(file: Path | None, out: Path | str | None) -> dict[str, str | None]:
    """The record of a policy's file: its path, its path relative to the record's folder `out`, and its content."""
    if file is None or not is_there(file):  # of a run in memory, whose folder is gone
        return {"file": None if file is None else str(file)}
    beside = None
    if out is not None and Path(file).absolute().drive == Path(out).absolute().drive:
        beside = Path(os.path.relpath(Path(file).absolute(), Path(out).absolute())).as_posix()
    return {"file": str(file), "beside": beside, "digest": content_digest(file)}


def file_of(policy: Mapping[str, Any], folder: Path) -> Path | None:
    """The file of an evaluated policy: at its path relative to the record's folder, or at its former path; None: gone.

    Raises:
        UserError: the file holds another policy, or the path is not a file.
    """
    there = _places(policy, folder)
    same = [place for place in there if is_same(policy, place)]
    if there and not same:
        text = f"{there[0]} is not the policy that was evaluated as {policy['name']}: it was trained further, or exchanged"
        raise UserError(f"{folder}: {text}; estimate it again, or name its run to use it nevertheless")
    return same[0] if same else None


def _places(policy: Mapping[str, Any], folder: Path) -> list[Path]:
    """Existing files that may be that of a policy, by a record in `folder`."""
    places = [folder / beside] if (beside := policy.get("beside")) else []
    places += [Path(file)] if (file := policy.get("file")) else []
    return [place for place in places if is_there(place)]


def records_beside(folder: Path, name: str) -> list[Path]:
    """The folders beside a run's that hold a record `name`, such as runs/clinic-ope of runs/clinic; the newest first."""
    found = [file.parent for file in folder.parent.glob(f"*/{name}") if file.parent not in (folder, folder.parent)]
    return sorted(found, key=lambda each: (each / name).stat().st_mtime, reverse=True)


def has_changed(policy: Mapping[str, Any], folder: Path, owner: Path) -> bool:
    """Whether its place in `owner`, the folder of its run or cross-fit, holds another policy than the one that was evaluated.

    Args:
        policy: as the record has it.
        folder: of the record.
        owner: only files in it count: another file that still holds the evaluated policy is ignored.
    """
    own = [place for place in _places(policy, folder) if place.resolve().is_relative_to(owner.resolve())]
    return bool(own) and not any(is_same(policy, place) for place in own)


def is_same(policy: Mapping[str, Any], file: Path) -> bool:
    """Whether a file holds the policy that was evaluated, as far as the record shows."""
    return policy.get("digest") is None or content_digest(file) == policy["digest"]


def write_results(path: Path | str, results: Mapping[str, Any]) -> None:
    """Writes `estimates.json`, with "Infinity", "-Infinity" and null for numbers that JSON does not have. Atomic."""
    write_json(path, _finite(results))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return None if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")


def _known(value: Any) -> Any:
    """The inverse of `_finite` in lists of numbers, where null is NaN."""
    if isinstance(value, list):
        return [_known(each) for each in value]
    return math.nan if value is None else float(value)


def is_from(policy: Mapping[str, Any], folder: Path) -> bool:
    """Whether an evaluated policy belongs to a run's or cross-fit's folder: by its file, or by its name if it is gone."""
    if policy["run"] != folder.name:
        return False
    file = policy.get("file")
    return file is None or not is_there(file) or Path(file).resolve().is_relative_to(folder.resolve())


def read_results(path: Path | str) -> dict[str, Any]:
    """`estimates.json`, whose lists have a number for each policy.

    Raises:
        UserError: names the field that does not have the form that `judge` writes.
    """
    found = read_json(path, dict)
    if "estimand" not in found:
        raise UserError(f"{path} is from a version that evaluated policies on their training rows; estimate them again")
    checked(found, Estimates, path)
    policies, choice = len(found["policies"]), found["choice"]
    choice["gain"] = _known(choice["gain"])
    for number, each in enumerate(found["results"]):
        each |= {field: _known(each[field]) for field in ("value", "low", "high", "gain")}
        for field in ("value", "low", "high", *(["effective"] if each["effective"] else [])):
            same_length(path, f"results[{number}].{field}", each[field], policies + 1)
        if len(each["gain"]) not in (policies, policies + 1):
            raise wrong(path, f"results[{number}].gain", f"a list of {policies + 1}", each["gain"])
    if not found["results"]:
        return found
    for key in ("estimand", "judged", "looks", "support"):
        if found.get(key) is None:
            raise UserError(f"{path}: it lacks {key}")
    if choice["name"] not in [each["name"] for each in found["policies"]]:
        raise wrong(path, "choice.name", "the name of one of the policies", choice["name"])
    if choice["level"] is None or not 0.0 < choice["level"] < 1.0:
        raise wrong(path, "choice.level", "a number between 0 and 1", choice["level"])
    for key in ("missing", "ratio"):
        same_length(path, f"support.{key}", found["support"][key], policies)
    same_length(path, "choice.objections", choice["objections"], policies)
    for number, cost in enumerate(choice.get("costs", ())):
        cost["ends"] = _known(cost["ends"])
        same_length(path, f"choice.costs[{number}].ends", cost["ends"], policies + 1)
    for key in ("mean", "error") if found["truth"] else ():
        same_length(path, f"truth.{key}", found["truth"][key], policies)
    if found["truth"] and (apart := found["truth"].get("apart")) is not None:
        for own in (apart, *apart):
            same_length(path, "truth.apart", own, policies)
    return found
