"""The held-out episodes of a run: it is not trained on them, so `deadreckon ope` can evaluate its policies on them."""

import warnings
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import RANDOM, TIME, Fold, Holdout, clusters, group_of, units_in_words
from deadreckon.errors import UserError
from deadreckon.tasks.task import Task

FEWEST = 10  # fewest episodes or clusters of which some are held out


class Divided(NamedTuple):
    """A log in two parts.

    Attributes:
        learning: the part that methods are trained on.
        taught: (learning,) uint64 `episode_ids` of that part.
        held: (held,) uint64 `episode_ids` of the rest; empty if nothing is held out.
        told: the record for `run.json`; None if nothing is held out.
    """

    learning: Dataset
    taught: np.ndarray
    held: np.ndarray
    told: dict[str, Any] | None


def divided(log: Dataset, given: Holdout | Fold | float | None, judge: Task | None, before: dict[str, Any] | None) -> Divided:
    """A log as a run divides it.

    Args:
        log: the log.
        given: the `holdout` of `runs.train.train`.
        judge: the simulator in which the policies are evaluated, if any: then nothing is held out unless requested.
        before: `run.json` of a run that is continued, which keeps its held-out episodes unless others are requested.

    Raises:
        UserError: the requested episodes cannot be held out of this log, or those of the continued run were held out in another
            way.
    """
    known = None if given is not None or before is None else before.get("data", {}).get("holdout")
    if given is None and before is not None:
        asked = _read(known)
    elif given is None:
        asked = None if judge is not None else usual(log)
    elif isinstance(given, Holdout | Fold):
        asked = given
    else:
        asked = of_share(log, given) if given else None
    if isinstance(asked, Holdout) and (few := too_few(log, asked)):
        warnings.warn(f"{few}: all are used for training, and none is left for the evaluation", stacklevel=5)
        asked = None
    if asked is None:
        return Divided(log, log.episode_ids, np.zeros(0, np.uint64), None)
    parts = asked.parts(log)
    told = asked.told() | {"learning": len(parts.learning), "held": len(parts.held)}
    if (different := len(np.unique(clusters(log, asked.by)))) < log.episodes and asked.by in (RANDOM, TIME):
        told["different"] = different
        if known is not None and known.get("different") != different:
            raise UserError(
                f"{log.name}: this run was begun before copies of an episode were held out together, so it cannot be "
                "continued; train it again"
            )
    return Divided(log.select(parts.learning), log.episode_ids[parts.learning], log.episode_ids[parts.held], told)


def too_few(log: Dataset, asked: Holdout) -> str | None:
    """A message that there are too few episodes or clusters to hold some out; None if there are enough."""
    if (count := int(clusters(log, asked.by).max()) + 1) >= FEWEST:
        return None
    return f"{log.name}: {count} {units_in_words(log, asked.by)} are too few to hold some out ({FEWEST} are needed)"


def trial_parts(log: Dataset) -> tuple[Dataset, Dataset]:
    """The two parts of a user's log for tuning settings: for training, and for choosing among them.

    The episodes that `train` holds out by default are in neither part, so they are still unused when a policy with the chosen
    settings is evaluated on them. The rest is divided again. If there are very few episodes, they are in both parts, with a
    warning.
    """
    rest = divided(log, None, None, None).learning
    tried = divided(rest, Holdout(seed=1, by=group_of(log) or RANDOM), None, None)
    if tried.told is None:
        return rest, rest
    return tried.learning, rest.select(np.flatnonzero(np.isin(rest.episode_ids, tried.held)))


def usual(log: Dataset) -> Holdout:
    """The episodes that are held out by default.

    A fifth: whole groups, if the log names a group column; in a memory-mapped log the latest episodes, because a random part
    would be copied into memory.
    """
    if (group := group_of(log)) is not None:
        return Holdout(by=group)
    return Holdout(by=TIME) if isinstance(log.observations, np.memmap) else Holdout()


def of_share(log: Dataset, share: float) -> Holdout:
    """The episodes that are held out for a given share: whole groups, if the log names a group column."""
    return Holdout(share, by=group_of(log) or RANDOM)


def _read(told: dict[str, Any] | None) -> Holdout | Fold | None:
    """The holdout by its record in `run.json`; None without a record, as in runs of older versions."""
    if told is None:
        return None
    if "fold" in told:
        return Fold(told["fold"], told["folds"], told["by"], told["seed"])
    return Holdout(told["share"], told["by"], told["seed"])
