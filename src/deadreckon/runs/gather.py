"""Policies to evaluate, from runs, folders and files, and the episodes that none of them was trained on."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import alike_in
from deadreckon.data.split import clusters
from deadreckon.errors import UserError
from deadreckon.ope.case import CrossFitted
from deadreckon.policies import library, store
from deadreckon.policies.dope import load_dope
from deadreckon.policies.policy import Policy
from deadreckon.policies.resolve import PICKLES
from deadreckon.randomness import generator
from deadreckon.runs.crossfit import CrossFit, load_cross_fit
from deadreckon.runs.folder import Folder
from deadreckon.runs.reading import Read, check_encoding, check_episodes
from deadreckon.runs.records import CROSS_FIT
from deadreckon.runs.run import Run, load
from deadreckon.runs.seen import unseen_by

NOBODY = "it is not known whether it was trained on these episodes (--unseen asserts that it was not)"
LEARNED = "it was trained on these episodes"
NO_LOG = {"extra": {}}  # how an online run's own steps were read


class Gathered(NamedTuple):
    """A policy to evaluate, and what is known of it.

    Attributes:
        policy: the policy; None for a cross-fit, whose policies differ from episode to episode.
        run: name of the run or file that it comes from.
        seed: of the run's or cross-fit's seeds; None where there is none.
        taught: (n,) uint64 ids of the episodes that it was trained on; None if that is not known.
        by: column whose values its run kept together when it held out episodes; None: none.
        file: the file of exactly this policy; None: not known.
        read: how the log was read that it was trained on.
        task: in which its run was evaluated, or whose snapshot it is; None: not known, or `unnamed`.
        unnamed: whether its run was trained in a task that its name does not find.
        cross: the cross-fit, of which `seed` is evaluated; None for a policy.
    """

    policy: Any
    run: str
    seed: int | None
    taught: np.ndarray | None
    by: str | None = None
    file: Path | None = None
    read: Read = Read()
    task: str | None = None
    unnamed: bool = False
    cross: CrossFit | None = None

    @property
    def name(self) -> str:
        """Name of the run, with its seed."""
        return self.run if self.seed is None else f"{self.run} seed {self.seed}"

    @property
    def acting(self) -> Any:
        """The policy that acts in a simulator: for a cross-fit, the one that would be deployed."""
        if self.cross is None:
            return self.policy
        assert self.seed is not None
        return self.cross.policy_of(self.seed)


def gather(given: Any) -> list[Gathered]:
    """Policies to evaluate.

    Args:
        given: runs, cross-fits, their folders, policy files (`.npz`, DOPE's `.pkl`), policies, whose training episodes are not
            known, or names of tasks, for their snapshots; a sequence of these, or a single one.

    Raises:
        UserError: none of these.
    """
    if isinstance(given, Run | CrossFit | str | Path) or not isinstance(given, Sequence):
        given = [given]
    found: list[Gathered] = []
    for number, each in enumerate(given):
        if isinstance(each, Policy):
            found.append(Gathered(each, f"policy {number}", None, None))
            continue
        if not isinstance(each, Run | CrossFit | str | Path):
            raise UserError(f"policies to evaluate are runs, folders, files or policies, got {type(each).__name__}")
        path = None if isinstance(each, Run | CrossFit) else Path(each)
        if isinstance(each, CrossFit) or (path is not None and (path / CROSS_FIT).exists()):
            cross = each if isinstance(each, CrossFit) else load_cross_fit(path)  # pyrefly: ignore[bad-argument-type] - a path
            name, by, read, task = cross.path.name, cross.config["by"], _read(cross.runs[0]), cross.runs[0].config["task"]
            found += [
                Gathered(None, name, seed, None, by, cross.file_of(seed), read, task, cross=cross)
                for seed in cross.runs[0].seeds
            ]
        elif path is None or path.is_dir():
            run = each if isinstance(each, Run) else load(each)
            held = run.config["data"].get("holdout") or (run.config.get("log") or {}).get("holdout")
            by, folder, read = None if held is None else held["by"], Folder(run.path), _read(run)
            unnamed = "task_fields" in run.config
            task = None if unnamed else run.config["task"]
            found += [
                Gathered(policy, run.path.name, seed, run.taught, by, folder.policy(seed), read, task, unnamed)
                for policy, seed in zip(run.policies, run.seeds)
            ]
        elif path.exists() or path.suffix:
            theirs = path.suffix in PICKLES
            found.append(Gathered(load_dope(path), path.stem, None, None, file=path) if theirs else _saved(path, path.stem))
        else:
            if len(path.parts) > 1:
                raise UserError(f"no folder or file {path}")
            for s in library.evaluated(str(each)):
                found.append(_saved(s.file, f"{each} {s.name}")._replace(file=None, task=str(each)))
    if not found:
        raise UserError("no policy to evaluate")
    return found


def _saved(file: Path, name: str) -> Gathered:
    """The policy of a policy file of this package."""
    saved = store.load_all(file)
    # Older online runs recorded an empty list of episodes.
    taught = None if saved.taught is None or not len(saved.taught) else saved.taught
    read = Read.of(saved.meta.get("log") or NO_LOG, taught, saved.held)
    return Gathered(saved.policy, name, None, taught, saved.meta.get("by"), file, read)


def _read(run: Run) -> Read:
    # For an online run with a log in its replay, how that log was read; the run's own steps need no reading.
    known = run.config["data"].get("provenance") or run.config.get("log_read")
    return Read.of(known or (NO_LOG if "online" in run.config else None), run.taught, run.held)


def check_encodings(found: Sequence[Gathered], data: Dataset) -> None:
    """`reading.check_encoding` for all policies."""
    for each in found:
        check_encoding(each.run, each.read, data)


class Fresh(NamedTuple):
    """The episodes on which policies are evaluated, and objections to them.

    Attributes:
        held: (n,) indices of the episodes.
        against: for each policy the reason why its estimate is not of held-out episodes, or None if it is.
        told: a description of the episodes, in one line.
    """

    held: np.ndarray
    against: list[str | None]
    told: str


def fresh(found: Sequence[Gathered], data: Dataset, unseen: bool) -> Fresh:
    """The episodes of a log that no policy was trained on, according to the policies' files.

    Args:
        found: policies.
        data: the log.
        unseen: the user states that policies whose training episodes are not known were not trained on this log, and that
            episodes equal to a policy's training episodes are there by chance.

    Raises:
        UserError: the training episodes of a policy cannot be determined, or no episode is left.
    """
    # Snapshots were trained on all episodes of a replay log that reproduces their training.
    found = [g._replace(taught=data.episode_ids) if _of_training(g, data) else g for g in found]
    if not unseen:
        for each in {id(g.read): g for g in found}.values():  # the seeds of a run share theirs
            check_episodes(each.run, each.read, data)
    left = np.ones(data.episodes, bool)
    for each in {id(g.cross): g for g in found if g.cross is not None}.values():
        if (fold := _folds(each, data, unseen)) is not None:
            left &= (fold >= 0) & _together(data, fold)
    known = _fresh_of([g.taught for g in found if g.cross is None], data)
    unknown = [g.cross is None and g.taught is None for g in found]
    taught = int((~known).sum())
    against: list[str | None] = [None] * len(found)
    if unseen:
        if not left.any():
            raise UserError("no episode is left that all of these cross-fits have held out; evaluate each by itself")
        # If a policy's file lists all of these episodes, the log is its training log, and its training episodes are known.
        own = [g for g in found if g.taught is not None and g.cross is None and _covers(g.read.episodes, data)]
        fresh_too = left & _fresh_of([g.taught for g in own], data)
        if not fresh_too.any():
            against = [LEARNED if any(g is each for each in own) else None for g in found]
            told = f"{int(left.sum()):,} episodes, on which policies were trained: their estimates are optimistic"
            return Fresh(np.flatnonzero(left), against, told)
        held = np.flatnonzero(fresh_too)
        equal = int((~known[held]).sum())
        more = f", although {equal:,} of them equal a policy's training episodes" if equal else ""
        told = f"{len(held):,} episodes on which no policy was trained, according to --unseen{more}"
        return Fresh(held, against, told)
    crossed = not left.all()
    left &= known
    if not left.any() and crossed:
        told = "no episode is left on which all of these policies can be evaluated: evaluate the cross-fit by itself"
        raise UserError(told if data.copied is None else f"{told}, or train it again, if its folds divide copies of episodes")
    if not left.any():
        everything = np.arange(data.episodes)
        against = [NOBODY if nobody else LEARNED for nobody in unknown]
        told = f"all {data.episodes:,} episodes, on which policies were trained: estimates are optimistic"
        return Fresh(everything, against, told)
    against = [NOBODY if nobody else None for nobody in unknown]
    held = np.flatnonzero(left)
    those = f"{len(held):,} episodes on which no policy was trained"
    if taught:
        those = f"{len(held):,} held-out episodes of {data.episodes:,}"
    return Fresh(held, against, those + (", as far as is known" if any(unknown) else ""))


def _of_training(each: Gathered, data: Dataset) -> bool:
    """Whether a log is the replay of the online run that the package's snapshots come from; see `collect_replay`."""
    made = data.provenance
    return each.file is None and made.recipe == f"{each.task}-medium-replay-v2" and made.seed == 0


def _covers(episodes: np.ndarray | None, data: Dataset) -> bool:
    """Whether a log is the one whose episodes a policy's file lists, or a part of it.

    Episodes of one step, and others that occur several times in that log, may be equal by chance. If the log is not known to be
    a part, there must be as many of these as the file lists.
    """
    if episodes is None or not np.isin(data.episode_ids, episodes).all():
        return False
    if data.selected or len(np.unique(episodes)) == data.episodes:
        return True
    return bool(data.lengths.max() > 1 and alike_in(data, episodes).mean() < 0.5)


def _fresh_of(taught: Sequence[np.ndarray | None], data: Dataset) -> np.ndarray:
    """(episodes,) bool: `unseen_by`, and no copy of a training episode, as where an older run or a column has divided them."""
    unseen, alike = unseen_by(taught, data), clusters(data)
    return ~np.isin(alike, alike[~unseen])


def _together(data: Dataset, fold: np.ndarray) -> np.ndarray:
    """(episodes,) bool: whether all copies of an episode are in one of the folds (episodes,)."""
    alike = clusters(data)
    least, most = np.full(len(alike), fold.max()), np.full(len(alike), fold.min())
    np.minimum.at(least, alike, fold)
    np.maximum.at(most, alike, fold)
    return (least == most)[alike]


def _folds(g: Gathered, data: Dataset, unseen: bool) -> np.ndarray | None:
    """(episodes,) the fold of a cross-fit in which each episode was held out, -1 for none; None for another log, whose episodes
    may still equal some of its own by chance."""
    assert g.cross is not None
    fold = g.cross.fold_of(data)
    own = _covers(g.read.episodes, data) if unseen else fold.max() >= 0
    return fold if own else None


def for_case(g: Gathered, data: Dataset, unseen: bool = False) -> Any:
    """A policy in the form that `OPEInput` takes.

    Of a cross-fit, on its own log that is each fold's policy on the fold's episodes. On another log the policy to deploy is
    evaluated; if that is the mixture of the folds' policies, each episode is given one of them at random, as when it acts.

    Args:
        g: the policy.
        data: the log.
        unseen: see `fresh`.
    """
    if (cross := g.cross) is None:
        return g.policy
    assert g.seed is not None
    members = tuple(run.policies[run.seeds.index(g.seed)] for run in cross.runs)
    if (fold := _folds(g, data, unseen)) is None:
        if cross.config["deliver"] != "mixture":
            return g.acting
        fold = generator(0, "policies of a mixture").permutation(np.arange(data.episodes) % len(cross.runs))
        return CrossFitted(members, fold, drawn=True)
    return CrossFitted(members, fold)
