"""Policies to judge, from runs, folders and files, and the episodes that none of them has learned from."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.case import CrossFitted
from deadreckon.policies import library, store
from deadreckon.policies.policy import Policy
from deadreckon.policies.resolve import PICKLES, policy_of_file
from deadreckon.runs.crossfit import NAME as CROSS_FIT
from deadreckon.runs.crossfit import CrossFit, load_cross_fit
from deadreckon.runs.folder import Folder
from deadreckon.runs.seen import Seen
from deadreckon.runs.train import Run, load

NOBODY = "nobody knows whether it has learned from these episodes (--unseen says that it has not)"


class Gathered(NamedTuple):
    """A policy to judge, and what is known of it.

    Attributes:
        policy: what acts, or a cross-fit.
        run: name of the run or file that it comes from.
        seed: of the run's seeds; None where there is none.
        taught: (n,) uint64 ids of the episodes that it has learned from; None where that is not known.
        by: column whose values its run kept together when it held episodes out; None: none.
        file: where it is saved; None: nowhere that is known.
        encoded: what the table's columns became in the log that it learned from: `provenance.extra`; empty where not known.
    """

    policy: Any
    run: str
    seed: int | None
    taught: np.ndarray | None
    by: str | None = None
    file: Path | None = None
    encoded: Mapping[str, Any] = {}


def gather(given: Sequence[Any]) -> list[Gathered]:
    """Policies to judge.

    Args:
        given: runs, cross-fits, their folders, policy files (`.npz`, DOPE's `.pkl`), policies, of which nobody knows what they
            have learned from, or names of tasks whose eleven snapshots are meant.

    Raises:
        UserError: none of these.
    """
    found: list[Gathered] = []
    for number, each in enumerate(given):
        if isinstance(each, Policy):
            found.append(Gathered(each, f"policy {number}", None, None))
            continue
        if not isinstance(each, Run | CrossFit | str | Path):
            raise UserError(f"policies to judge are runs, folders, files or policies, got {type(each).__name__}")
        path = None if isinstance(each, Run | CrossFit) else Path(each)
        if isinstance(each, CrossFit) or (path is not None and (path / CROSS_FIT).exists()):
            cross = each if isinstance(each, CrossFit) else load_cross_fit(path)  # pyright: ignore[reportArgumentType]
            known = cross.path.name, cross.config["by"], cross.policy_path, _encoded(cross.runs[0])
            found += [Gathered((cross, seed), known[0], seed, None, *known[1:]) for seed in cross.runs[0].seeds]
        elif path is None or path.is_dir():
            run = each if isinstance(each, Run) else load(each)
            held = run.config["data"].get("holdout")
            by, folder = None if held is None else held["by"], Folder(run.path)
            found += [
                Gathered(policy, run.path.name, seed, run.taught, by, folder.policy(seed), _encoded(run))
                for policy, seed in zip(run.policies, run.seeds)
            ]
        elif path.exists() or path.suffix:
            policy = policy_of_file(path)
            taught = None if path.suffix in PICKLES else store.taught(path)
            found.append(Gathered(policy, path.stem, None, taught, None, path))
        else:
            if len(path.parts) > 1:
                raise UserError(f"no folder or file {path}")
            snapshots = [s for s in library.library(str(each)) if s.name.startswith("snapshot-")]
            found += [Gathered(s.policy(), f"{each} {s.name}", None, None) for s in snapshots]
    if not found:
        raise UserError("no policy to judge")
    return found


def _encoded(run: Run) -> dict[str, Any]:
    return run.config["data"].get("provenance", {}).get("extra", {})


def check_encoding(found: Sequence[Gathered], data: Dataset) -> None:
    """Refuses a log of a table whose columns became other numbers than those of the log that a policy learned from.

    Raises:
        UserError: names the policy, and what differs.
    """
    words = {
        "observation_names": "observations are", "observation_levels": "levels of observations are",
        "action_levels": "levels of actions are",
    }  # fmt: skip
    here = json.loads(json.dumps(data.provenance.extra, default=str))
    for each in found:
        for key, what in words.items():
            if key in each.encoded and key in here and each.encoded[key] != here[key]:
                raise UserError(
                    f"{each.run} learned from a log whose {what} {each.encoded[key]}; those of {data.name} are {here[key]}: "
                    "its policies would misread them"
                )


class Fresh(NamedTuple):
    """On which episodes policies are judged, and what that is worth.

    Attributes:
        held: (n,) indices of the episodes.
        against: for each policy why its estimate is not one of fresh episodes, or None where it is.
        told: in one line.
    """

    held: np.ndarray
    against: list[str | None]
    told: str


def fresh(found: Sequence[Gathered], data: Dataset, unseen: bool) -> Fresh:
    """The episodes of a log that no policy has learned from, by what the policies' files keep.

    Args:
        found: policies.
        data: the log.
        unseen: the user says that policies of which nobody knows it have not learned from this log, and that episodes equal to
            those that taught a policy are there by chance.
    """
    left = np.ones(data.episodes, bool)
    for each in {id(g.policy[0]): g.policy[0] for g in found if isinstance(g.policy, tuple)}.values():
        if (fold := each.fold_of(data)).max() >= 0:  # of another log it has seen nothing
            left &= fold >= 0
    known = Seen.of([g.taught for g in found if not isinstance(g.policy, tuple)], data)
    unknown = [not isinstance(g.policy, tuple) and g.taught is None for g in found]
    taught = int((~known.unseen).sum())
    against: list[str | None] = [None] * len(found)
    if unseen:
        held = np.flatnonzero(left)
        if not len(held):
            raise UserError("no episode is left that all of these cross-fits have held out; judge each by itself")
        more = f", although {taught:,} of them equal episodes that taught a policy" if taught else ""
        told = f"{len(held):,} episodes, which no policy has learned from as the user says{more}"
        return Fresh(held, against, told)
    crossed = not left.all()
    left &= known.unseen
    if not left.any() and crossed:
        raise UserError("no episode is left that all of these policies can be judged on; judge the cross-fit by itself")
    if not left.any():
        everything = np.arange(data.episodes)
        seen_all = "it has learned from these episodes"
        against = [NOBODY if nobody else seen_all for nobody in unknown]
        told = f"all {data.episodes:,} episodes, which policies have learned from: estimates are optimistic"
        return Fresh(everything, against, told)
    against = [NOBODY if nobody else None for nobody in unknown]
    held = np.flatnonzero(left)
    those = f"{len(held):,} episodes, none of which taught a policy"
    if taught:
        those = f"{len(held):,} held-out episodes of {data.episodes:,}"
    return Fresh(held, against, those + (", as far as is known" if any(unknown) else ""))


def for_case(g: Gathered, data: Dataset) -> Any:
    """A policy as a case takes it."""
    if not isinstance(g.policy, tuple):
        return g.policy
    cross, seed = g.policy
    if (fold := cross.fold_of(data)).max() < 0:  # another log: the policy to deploy is evaluated, not those of the folds
        return cross.policy
    return CrossFitted(tuple(run.policies[run.seeds.index(seed)] for run in cross.runs), fold)
