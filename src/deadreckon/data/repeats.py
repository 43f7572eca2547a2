"""Episodes that repeat earlier ones, as where a table was stored twice or a join repeated its rows.

Copies in training and in held-out episodes make a policy look better than it is, and copies that are counted as independent
make intervals too narrow. Episodes that are copies of each other are therefore one cluster.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deadreckon.data.spec import Box

if TYPE_CHECKING:
    from deadreckon.data.dataset import Dataset

SHARE = 0.01  # of the rows or episodes, up to which copies are neglected
_STRETCH, _TOGETHER = 20, 0.5  # so many copies, and such a share of them, follow each other where a part was stored twice
_OWN = 0.9  # of the rows that are no copies: so many have a value of their own in a column that tells rows apart
_ROWS = 100_000  # in which such a column is looked for


class Copies(NamedTuple):
    """Rows or episodes that repeat an earlier one.

    Attributes:
        many: how many.
        together: share of them that follow another one as the rows that they repeat follow each other.
    """

    many: int
    together: float

    @classmethod
    def of(cls, first: np.ndarray) -> "Copies":
        """The copies among n things, of each of which the first that is equal is given: (n,) indices."""
        again = first < np.arange(len(first))
        together = again[1:] & again[:-1] & (first[1:] == first[:-1] + 1)
        return cls(int(again.sum()), float(together.sum() / max(again.sum(), 1)))

    @property
    def in_order(self) -> bool:
        """Whether they come in stretches, as where a part was stored twice."""
        return self.many >= _STRETCH and self.together >= _TOGETHER


def copied(log: "Dataset") -> np.ndarray | None:
    """(episodes,) number 0, 1, ... of each episode, the same for copies of one; None if there are none or hardly any.

    Equal episodes are copies if they come in stretches, or if a column tells rows apart; otherwise, as where little is known of
    a context, they may be equal by chance.
    """
    _, first, which = np.unique(log.episode_contents, return_index=True, return_inverse=True)
    which = which.ravel()
    found = Copies.of(first[which])
    if found.many <= SHARE * log.episodes:
        return None
    if not found.in_order:
        once = np.zeros(log.episodes, bool)
        once[first] = True
        rows = np.flatnonzero(once[log.episode_of])[:_ROWS]
        if telling_apart(log, rows, len(rows)) is None:
            return None
    return which


def telling_apart(log: "Dataset", rows: np.ndarray | slice, different: int) -> tuple[str, int] | None:
    """A column of numbers with decimals that nearly always has another one, but for copies: "observation", "action" (if these
    are continuous) or "reward", and its number among these; None if there is none.

    Args:
        log: the log.
        rows: (n,) indices of rows.
        different: number of these that are no copies.
    """
    columns = {"reward": np.asarray(log.rewards[rows])[:, None]}
    if isinstance(log.action_space, Box):
        columns = {"action": np.asarray(log.actions[rows]).reshape(len(columns["reward"]), -1)} | columns
    if len(log.spec.observation_shape) == 1:
        columns = {"observation": np.asarray(log.observations[rows])} | columns
    for role, column in columns.items():
        for i, values in enumerate(column.T):
            kinds = np.unique(values)
            if len(kinds) >= _OWN * different and (kinds != np.floor(kinds)).any():
                return role, i
    return None
