"""Vowpal Wabbit's text format for contextual bandits: `action:cost:probability | features`, and its form of several lines."""

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from deadreckon.data.columns import LOG_PROBS
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.build import build
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError, naming, reading
from deadreckon.foreign.door import opened, unpacked

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LABEL = re.compile(rf"(\d+):({_NUMBER}):({_NUMBER})")
# Not a time of day such as 12:30:00, which may be in tables with bars between columns.
_NO_CLOCK = re.compile(rf"\d+:{_NUMBER}:(?![-+]?\d\d){_NUMBER}")
_FIRST = re.compile(rf"\s*(?:shared\s[^|]*|(?:\d+\s+)*\d+:{_NUMBER}:{_NUMBER}(?:\s[^|]*)?|'?\S*\s*)\|".encode())
_MOST = 10_000  # largest number of dimensions of an observation, and of actions


@dataclass
class _Example:
    """One decision: features, the action with its cost and probability, and the legal actions."""

    line: int
    features: dict[str, float]
    action: int
    cost: float
    probability: float
    legal: list[int] = field(default_factory=list)  # empty: all


def read_vw(path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None) -> Dataset:
    """Reads a text of contextual bandits; each example is an episode of one terminal step, whose reward is minus the cost.

    Features become dimensions of the observation, 0 if they are absent, called `namespace^feature` as in VW's audit. Actions
    are counted from 0. If each action has features (a decision of several lines), the observation holds those of the shared
    line and then those of each action, `0:namespace^feature` for the first. If the legal actions differ between examples, their
    mask is at the end of the observations.

    Args:
        path: of the file, which may be gzipped.
        strict: accepted and without effect, because actions are discrete.
        name: of the log; the file's if absent.
        horizon: must be None, because decisions are independent.

    Raises:
        UserError: one line that names the file, the line and what would be right.
    """
    if horizon is not None:
        raise UserError(f"{path}: each example is an episode of one step; a horizon is for files that do not say")
    with reading(path, "VW's text"), naming(path, ""), opened(path) as file:
        lines = io.TextIOWrapper(unpacked(path, file), encoding="utf-8")
        examples, unlabelled, several = _examples(lines)
        columns, names, actions = _columns(examples)
    told = ["read as VW's layout: each example is an episode of one terminal step, the reward is minus the cost"]
    if several:
        told.append(f"decisions of several lines: shared features, and those of each of {actions} actions, are one observation")
    if unlabelled:
        told.append(f"{unlabelled} examples without action:cost:probability are left out")
    if "legal" in columns:
        names += [f"legal={action}" for action in range(1, actions + 1)]
        told.append("the legal actions differ between examples, and are appended to the observations")
    extra = {"layout": "VW", "observation_names": names}
    space = Discrete(max(actions, 2))
    return build(path, columns, source="vw", name=name, action_space=space, extra=extra, strict=strict, warnings=told)


def is_vw(head: bytes) -> bool:
    """Whether a text begins as one of VW's does, and some line of `head` has the label of a contextual bandit."""
    if b"\0" in head or not _FIRST.match(head):
        return False
    heads = [line.partition(b"|")[0].decode("latin1") for line in head.split(b"\n") if b"|" in line]
    return any(_NO_CLOCK.fullmatch(word) for text in heads for word in text.split())


def _examples(lines: Iterator[str] | io.TextIOWrapper) -> tuple[list[_Example], int, bool]:
    """All examples with a label, how many have none, and whether they are of several lines each.

    One file has one form: blocks between blank lines, or a line each.
    """
    blocks: list[list[tuple[int, str]]] = [[]]
    for number, line in enumerate(lines, 1):
        if line.strip():
            blocks[-1].append((number, line))
        elif blocks[-1]:
            blocks.append([])
    blocks = [block for block in blocks if block]
    heads = [line.partition("|")[0].strip() for block in blocks for _, line in block]
    several = len(blocks) > 1 and any(len(block) > 1 for block in blocks)
    several |= any(head.startswith(("shared", "0:")) for head in heads)  # actions of one line are counted from 1
    if several:
        read = [_of_block(block) for block in blocks]
    else:
        read = [_of_line(number, line) for block in blocks for number, line in block]
    found = [example for example in read if example is not None]
    if not found:
        raise UserError("no example has a label action:cost:probability")
    return found, len(read) - len(found), several


def _of_line(number: int, line: str) -> _Example | None:
    """An example of one line: the action that was taken has cost and probability, others may be listed as possible."""
    head, features = _split(number, line)
    labels, legal = [], []
    for word in head:
        if _LABEL.fullmatch(word) or word.isdecimal():
            legal.append(int(word.partition(":")[0]) - 1)
            labels += [word] if ":" in word else []
        elif not word.startswith("'") and (":" in word or word is not head[-1]):  # the last may be a tag
            raise UserError(f"line {number} has the label {word!r}; action:cost:probability is needed")
    if not labels:
        return None
    action, cost, probability = _label(number, labels)
    if min(legal) < 0:
        raise UserError(f"line {number} has action 0; they are counted from 1")
    return _Example(number, features, action - 1, cost, probability, legal if len(legal) > 1 else [])


def _of_block(block: list[tuple[int, str]]) -> _Example | None:
    """A decision of several lines: a shared one, if any, and one for each action, of which one has cost and probability."""
    features: dict[str, float] = {}
    labels: list[tuple[int, int, float, float]] = []
    action = 0
    for number, line in block:
        head, own = _split(number, line)
        if head and head[0] == "shared":
            if action:
                raise UserError(f"line {number}: the shared line is the first of its decision")
            features |= own
            continue
        if head and head[0] in ("ccb", "slates"):
            raise UserError(f"line {number}: {head[0]} examples are not read, contextual bandits are")
        features |= {f"{action}:{key}": value for key, value in own.items()}
        given = [word for word in head if _LABEL.fullmatch(word)]
        if given:
            _, cost, probability = _label(number, given)  # the action that a label names is ignored, as VW does
            labels.append((action, number, cost, probability))
        action += 1
    if not labels:
        return None
    if len(labels) > 1:
        raise UserError(f"line {labels[1][1]}: a second action of one decision has a cost; blank lines separate decisions")
    chosen, number, cost, probability = labels[0]
    return _Example(number, features, chosen, cost, probability, list(range(action)))


def _label(number: int, labels: list[str]) -> tuple[int, float, float]:
    if len(labels) > 1:
        raise UserError(f"line {number} has {len(labels)} actions with a cost, {' and '.join(labels[:2])}; one is read")
    action, cost, probability = labels[0].split(":")
    if not 0 < float(probability) <= 1:
        raise UserError(f"line {number} has probability {probability}, a number in (0, 1] is needed")
    return int(action), float(cost), float(probability)


def _split(number: int, line: str) -> tuple[list[str], dict[str, float]]:
    """The words before the first bar, and {`namespace^feature`: value}; the values of a repeated feature are added."""
    head, *spaces = line.rstrip("\r\n").split("|")
    if not spaces:
        raise UserError(f"line {number} has no |; action:cost:probability | features is needed")
    features: dict[str, float] = {}
    for text in spaces:
        words = text.split()
        name, scale = "", 1.0
        if text[:1].strip() and words:  # touches the bar: a namespace, maybe with a factor
            name, _, factor = words.pop(0).partition(":")
            scale = _value(number, name, factor)
        for place, word in enumerate(words):
            key, _, value = word.partition(":")
            try:
                amount = float(value) if value else 1.0
            except ValueError:  # a text: one of the feature's levels
                key, amount = f"{key}={value}", 1.0
            key = f"{name}^{key or place}" if name else key or str(place)
            features[key] = features.get(key, 0.0) + scale * amount
    return head.split(), features


def _value(number: int, name: str, text: str) -> float:
    try:
        return float(text) if text else 1.0
    except ValueError as error:
        raise UserError(f"line {number}: namespace {name} has the factor {text!r}, a number is needed") from error


def _columns(examples: list[_Example]) -> tuple[dict[str, np.ndarray], list[str], int]:
    """Columns by `from_arrays` names, names of the observation's dimensions, and the number of actions."""
    place: dict[str, int] = {}
    for example in examples:
        for key in example.features:
            place.setdefault(key, len(place))
    if len(place) > _MOST:
        raise UserError(f"there are {len(place):,} different features, at most {_MOST:,} are read; leave out identifiers")
    if not place:
        raise UserError("no example has a feature")
    rows = len(examples)
    names = sorted(place, key=lambda key: (_slot(key), place[key]))
    index = {key: number for number, key in enumerate(names)}
    observations = np.zeros((rows, len(names)), np.float32)
    actions = 1 + max(max(example.action, *example.legal) if example.legal else example.action for example in examples)
    if actions > _MOST:
        line = next(example.line for example in examples if actions - 1 in (example.action, *example.legal))
        raise UserError(f"line {line} has action {actions}, at most {_MOST:,} are read; number them from 1 without gaps")
    legal = np.ones((rows, actions if any(example.legal for example in examples) else 0), bool)
    for row, example in enumerate(examples):
        observations[row, [index[key] for key in example.features]] = list(example.features.values())
        if example.legal:
            legal[row] = np.isin(np.arange(actions), example.legal)
    columns = {
        "observations": observations,
        "actions": np.array([example.action for example in examples]),
        "rewards": -np.array([example.cost for example in examples]),
        "terminals": np.ones(rows, bool),
        LOG_PROBS: np.log([example.probability for example in examples]),
    }
    return columns if legal.all() else {**columns, "legal": legal}, names, actions


def _slot(key: str) -> int:
    """The action that a feature belongs to, -1 for those of the whole decision."""
    number, colon, _ = key.partition(":")
    return int(number) if colon and number.isdecimal() else -1
