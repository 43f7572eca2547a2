"""A decision tree in the names of a log, independent of the library that fitted it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

DIGITS = 4  # of a threshold, or as many more as it takes to divide the rows as the tree does


@dataclass(frozen=True)
class Node:
    """A question with two answers, or a leaf with an action.

    Attributes:
        text: the question, such as "age <= 50", or the action.
        share: of the tree's training rows, those that reach this node.
        yes, no: the next nodes; None for a leaf.
    """

    text: str
    share: float
    yes: "Node | None" = None
    no: "Node | None" = None

    @classmethod
    def from_json(cls, told: dict[str, Any]) -> "Node":
        """A tree from nested dictionaries of its fields."""
        parts = {key: None if told.get(key) is None else cls.from_json(told[key]) for key in ("yes", "no")}
        return cls(told["text"], told["share"], **parts)

    @property
    def leaf(self) -> bool:
        """Whether this is a leaf."""
        return self.yes is None or self.no is None

    def lines(self) -> Iterator[str]:
        """The tree as text, one line per node."""
        yield from self._lines("", "")

    def _lines(self, before: str, rest: str) -> Iterator[str]:
        if self.yes is None or self.no is None:
            yield f"{before}{self.text} ({self.share:.0%} of rows)"
            return
        yield f"{before}{self.text}?"
        yield from self.yes._lines(f"{rest}├─ yes: ", f"{rest}│  ")
        yield from self.no._lines(f"{rest}└─ no:  ", f"{rest}   ")


def node_of(
    tree: Any, rows: np.ndarray, names: Sequence[str], marks: Mapping[int, str], fills: Mapping[int, float],
    units: Sequence[str], actions: Sequence[str], of_actions: Sequence[str], discrete: bool,
) -> Node:  # fmt: skip
    """The root of a fitted tree of scikit-learn.

    Args:
        tree: fitted.
        rows: (rows, inputs) which the tree in names divides as the fitted one does.
        names: of its input numbers.
        marks: by the index of each input that is 0 or 1, the meaning of 1, such as "plan is new".
        fills: by the index of each input that is set where a value is missing, what it is set to.
        units: of its input numbers, empty if unknown.
        actions: names of discrete actions, or of the dimensions of continuous ones.
        of_actions: units of continuous actions.
        discrete: whether actions are discrete.
    """
    inner = tree.tree_
    total = float(inner.weighted_n_node_samples[0])

    def made(i: int) -> Node:
        share = float(inner.weighted_n_node_samples[i]) / total
        left, right = int(inner.children_left[i]), int(inner.children_right[i])
        if left < 0:
            return Node(_action(inner.value[i], tree, actions, of_actions, discrete), share)
        yes, no = made(left), made(right)
        if yes.leaf and no.leaf and yes.text == no.text:
            return Node(yes.text, share)  # a question whose answer changes nothing
        which = int(inner.feature[i])
        if which in marks:  # not by its name, which may look like that of a level, such as "NaCl=g/l"
            return Node(marks[which], share, no, yes)
        threshold = float(inner.threshold[i])
        question = _measured(f"{names[which]} <= {_edge(threshold, rows[:, which])}", units[which])
        missing = which in fills and np.float32(fills[which]) <= threshold
        return Node(f"{question}, or no value" if missing else question, share, yes, no)

    return made(0)


def _edge(threshold: float, values: np.ndarray) -> str:
    """A threshold as text, with as few digits as divide (rows,) values as it does, but no fewer than `DIGITS`."""
    values = np.asarray(values, np.float64)  # numbers of 32 bits would be compared in 32 bits
    low = values <= threshold
    rounded = (float(f"{threshold:.{digits}g}") for digits in range(DIGITS, 18))
    found = next((each for each in rounded if ((values <= each) == low).all()), threshold)
    return repr(found).removesuffix(".0")


def _measured(text: str, unit: str) -> str:
    return f"{text} {unit}" if unit else text


def _action(value: Any, tree: Any, actions: Sequence[str], units: Sequence[str], discrete: bool) -> str:
    if discrete:
        return str(actions[int(tree.classes_[int(value[0].argmax())])])
    numbers = value.reshape(-1)
    if len(numbers) == 1:
        return _measured(f"{actions[0]} = {numbers[0]:.4g}", units[0])
    shown = ", ".join(_measured(f"{name} = {number:.3g}", unit) for name, unit, number in zip(actions[:4], units, numbers))
    return shown + (", ..." if len(numbers) > 4 else "")
