"""Explains a policy by a small decision tree with a measured fidelity, and by the columns that affect its actions.

The log's episodes (or clusters of them) are divided into three parts: a tree is fitted to the policy's greedy actions on the
first part, its depth is chosen on the second, and its fidelity is measured on the third, which was used for neither. A tree
that is not significantly better there than the constant action explains nothing, and is not shown. The importance of a column
is measured on the policy itself and not on the tree: its values are permuted between fresh rows, and the change of the policy's
actions is measured.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.history import stacked
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.split import units_of
from deadreckon.data.told import action_names, columns_of, observation_names, schema_of
from deadreckon.errors import UserError, extra
from deadreckon.files import content_digest, write_json
from deadreckon.policies.deployed import history_of
from deadreckon.policies.pure import MEMBER, Pure, pure
from deadreckon.provided import Shown
from deadreckon.randomness import generator
from deadreckon.runs.explained_tree import Node, node_of
from deadreckon.runs.subject import subject
from deadreckon.stats import inference
from deadreckon.stats.interval import ALPHA, Interval

NAME = "explain.json"
DEPTHS = range(1, 7)
ROWS = 20_000  # most rows of the log that are used
PARTS = 0.6, 0.2  # shares of the units for fitting trees and for choosing the depth; the rest are fresh
FEWEST = 15  # fewest units; a log of fewer episodes is divided into so many blocks of rows
EXCHANGES = 5  # permutations of each column's values


@dataclass(frozen=True)
class Matters:
    """The importance of a column.

    Attributes:
        column: its name.
        change: share of fresh rows in which permuted values lead to another action; for continuous actions the root mean square
            change, in standard deviations of the policy's actions.
        low, high: its interval.
    """

    column: str
    change: float
    low: float
    high: float


@dataclass(frozen=True)
class Explained(Shown):
    """A tree that imitates a policy, and its fidelity.

    Attributes:
        name, log: names of the policy and of the log.
        discrete: whether its actions are discrete.
        rows: fresh rows, on which all numbers are measured.
        depth: of the tree; 0: the constant action was best.
        fidelity: share of fresh rows in which the tree takes the policy's action; for continuous actions the share of the
            variance of the policy's actions that it explains (R squared).
        low, high: its interval.
        constant: the fidelity of the constant action, which is the most common one, or the mean.
        explains: whether the tree is significantly better than the constant action.
        tree: its root; None if it explains nothing.
        columns: by importance, the most important first.
        digest: hash of the policy's file, by which a page checks whether the file has changed; None: not known.
    """

    name: str
    log: str
    discrete: bool
    rows: int
    depth: int
    fidelity: float
    low: float
    high: float
    constant: float
    explains: bool
    tree: Node | None
    columns: tuple[Matters, ...]
    digest: str | None = None

    def as_json(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, told: dict[str, Any]) -> "Explained":
        """The inverse of `as_json`."""
        tree = None if told.get("tree") is None else Node.from_json(told["tree"])
        fields: dict[str, Any] = {**told, "tree": tree, "columns": tuple(Matters(**each) for each in told["columns"])}
        return cls(**fields)

    @property
    def headline(self) -> str:
        """How well the tree imitates the policy, in one sentence."""
        rows = f"{self.rows:,} fresh rows of {self.log}"
        if self.constant >= 1.0 - 1e-9:
            return f"the policy takes the same action in all of {rows}"
        spread = f"{self.fidelity:.1%} [{self.low:.1%}, {self.high:.1%}]"
        if not self.explains:
            return f"fidelity: none. On {rows} no tree of depth {DEPTHS[-1]} or less is clearly better than a constant action"
        if self.discrete:
            text = f"a tree of depth {self.depth} takes the policy's action in {spread} of {rows}"
            return f"{text}; the constant action in {self.constant:.1%}"
        return f"a tree of depth {self.depth} explains {spread} of the variance of the policy's actions in {rows}"

    def __str__(self) -> str:
        unit = "share of rows that get another action"
        if not self.discrete:
            unit = "root mean square change of the actions, in their standard deviations"
        shown = [(each, f"{each.change:.3f} [{each.low:.3f}, {each.high:.3f}]") for each in self.columns]
        width = max((len(each.column) for each, _ in shown), default=0)
        lines = [f"{self.name}: {self.headline}"]
        lines += [] if self.tree is None else ["", *self.tree.lines()]
        lines += ["", f"columns that matter: {unit}, if a column's values are permuted between rows"]
        return "\n".join([*lines, *(f"  {each.column:<{width}}  {text}" for each, text in shown)])


def explain(run: Any, log: Any = None, *, seed: int | None = None) -> Explained:
    """Fits a small tree to a policy's actions and measures its fidelity.

    Without `log`, the result is written to the folder of the run or cross-fit, if there is one.

    Args:
        run: the run, its folder, a cross-fit's folder or a policy file.
        log: whose rows are used, a `Dataset`, a file or a data frame; None: the log that the policy was trained on.
        seed: of the run's policy; None: the first that has not failed.

    Raises:
        UserError: image observations, too few rows, a policy that cannot act on single rows, or scikit-learn is missing.
    """
    one = subject(run, seed)
    function, data = pure(one.policy), one.log(log, option="a second argument (in Python log=)")
    if len(data.spec.observation_shape) > 1:
        raise UserError(f"{data.name}: image observations (shape {data.spec.observation_shape}) cannot be explained by columns")
    found = _explained(one.name, function, data, history_of(one.policy))
    found = replace(found, digest=None if one.file is None else content_digest(one.file))
    if one.folder is not None and log is None:
        write_json(one.folder / NAME, found.as_json())
    return found


def _explained(name: str, function: Pure, data: Dataset, steps: int) -> Explained:
    rng = generator(0, "explain")
    at = np.unique(np.linspace(0, len(data) - 1, min(len(data), ROWS)).astype(int))
    x = np.asarray(stacked(data, steps).observations[at], np.float32)
    unit, discrete = _units(data, at), data.spec.discrete
    ask = _asker(function)
    done = ask(x, np.arange(len(x)))
    first, chooses, fresh = _parted(unit, rng)
    scale = np.ones(1) if discrete else done[first].std(0)
    scale = np.where(scale > 1e-9, scale, np.inf)  # a constant action has no error

    def loss(guess: np.ndarray, part: np.ndarray) -> np.ndarray:
        return _apart(guess if discrete else guess.reshape(len(guess), -1), done[part], scale, discrete)

    base: Any = np.bincount(done[first]).argmax() if discrete else done[first].mean(0)
    constant = lambda part: np.broadcast_to(base, done[part].shape)  # noqa: E731
    shown = _in_units(data, steps, x)
    trees = [None, *(_fitted(shown[first], done[first], depth, discrete) for depth in DEPTHS)]
    guess = lambda tree, part: constant(part) if tree is None else np.asarray(tree.predict(shown[part]))  # noqa: E731
    losses = np.stack([loss(guess(tree, chooses), chooses) for tree in trees])
    depth = _simplest(losses, unit[chooses])
    own, plain = loss(guess(trees[depth], fresh), fresh), loss(constant(fresh), fresh)
    names = _names(data, steps)
    explains = depth > 0 and _mean(plain - own, unit[fresh]).low > 0
    fidelity = _agreement(own, unit[fresh]) if discrete else _explained_variance(own, plain, unit[fresh])
    still = 1.0 - float(plain.mean()) if discrete else float(plain.mean() < 1e-12)
    said = action_names(data)
    tree = None
    if explains:
        units, acts = _measures(data)
        measures = [*(units + acts) * (steps - 1), *units]
        marks, fills = _marks(data, steps), _fills(data, steps)
        tree = node_of(trees[depth], shown, names, marks, fills, measures, said, acts, discrete)
    again = lambda other: ask(other, fresh)  # noqa: E731
    matters = _matters(again, x[fresh], done[fresh], unit[fresh], _groups(data, steps), scale, discrete, rng)
    ends = fidelity.value, fidelity.low, fidelity.high
    return Explained(name, data.name, discrete, len(own), depth, *ends, still, bool(explains), tree, matters)


def _apart(one: np.ndarray, other: np.ndarray, scale: np.ndarray, discrete: bool) -> np.ndarray:
    """(rows,) difference of actions: 1 where discrete ones differ, else the mean square over the dimensions that vary.

    Args:
        one, other: the actions.
        scale: of each dimension, infinite where the policy's action is constant.
        discrete: whether actions are codes.
    """
    if discrete:
        return (one != other).astype(float)
    return np.square((one - other) / scale).sum(1) / max(int(np.isfinite(scale).sum()), 1)


def _asker(function: Pure) -> Any:
    """A function from (rows, size) observations and the numbers of these rows to actions; each member of a mixture acts in its
    share of the rows, always the same ones."""
    call = jax.jit(lambda *given: function.call(*given)[0])

    def ask(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
        given = [jnp.asarray(x)]
        if MEMBER in function.inputs:
            given.append(jnp.asarray(rows % function.members, jnp.int32))
        return np.asarray(call(*given))

    return ask


def _units(data: Dataset, rows: np.ndarray) -> np.ndarray:
    """(rows,) number of the unit that each belongs to: an episode, a cluster, or a block of a log of few episodes."""
    unit = units_of(data)[data.episode_at(rows)]
    return unit if len(np.unique(unit)) >= FEWEST else np.arange(len(rows)) * FEWEST // len(rows)


def _parted(unit: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows for fitting trees, rows for choosing the depth, and fresh rows, by whole units."""
    units = rng.permutation(np.unique(unit))
    ends = np.cumsum([int(part * len(units)) for part in PARTS])
    parts = [np.flatnonzero(np.isin(unit, each)) for each in np.split(units, ends)]
    if min(map(len, parts)) < 2:
        raise UserError(f"{len(unit)} rows are too few to fit a tree, choose its depth and measure it on fresh ones")
    return parts[0], parts[1], parts[2]


def _fitted(x: np.ndarray, done: np.ndarray, depth: int, discrete: bool) -> Any:
    try:
        from sklearn.tree import DecisionTreeClassifier, DecisionTreeRegressor
    except ImportError:
        raise UserError(f"explain fits trees with scikit-learn: {extra('explain')}") from None
    kind = DecisionTreeClassifier if discrete else DecisionTreeRegressor
    return kind(max_depth=depth, min_samples_leaf=max(5, len(x) // 100), random_state=0).fit(x, done)


def _simplest(losses: np.ndarray, unit: np.ndarray) -> int:
    """The least depth whose loss is within a standard error of the least one, of (depths, rows) losses."""
    best = int(losses.mean(1).argmin())
    for depth, loss in enumerate(losses):
        spread = _mean(loss - losses[best], unit)
        if spread.value <= (spread.high - spread.value) / 2:  # an interval of 95 % is two standard errors wide on each side
            return depth
    return best


def _mean(x: np.ndarray, unit: np.ndarray) -> Interval:
    """The mean of (rows,) numbers with an interval by units."""
    _, place = np.unique(unit, return_inverse=True)
    totals, rows = np.bincount(place, x), np.bincount(place)
    mean = float(x.mean())
    influence = len(rows) * (totals - mean * rows) / len(x)
    low, high = inference.student(np.array([mean]), influence[:, None])
    return Interval(mean, float(low[0]), float(high[0]))


def _agreement(wrong: np.ndarray, unit: np.ndarray) -> Interval:
    """The share of rows that are not wrong; if none is, the lower end is Clopper and Pearson's for so many units."""
    right = _mean(1.0 - wrong, unit)
    low = (ALPHA / 2) ** (1 / len(np.unique(unit))) if not wrong.any() else right.low
    return Interval(right.value, max(low, 0.0), min(right.high, 1.0))


def _explained_variance(own: np.ndarray, plain: np.ndarray, unit: np.ndarray) -> Interval:
    """1 minus the ratio of two mean losses, with an interval by the linearised ratio."""
    whole = max(float(plain.mean()), 1e-12)
    ratio = float(own.mean()) / whole
    spread = _mean(own - ratio * plain, unit)
    half = (spread.high - spread.value) / whole
    return Interval(1.0 - ratio, 1.0 - ratio - half, min(1.0 - ratio + half, 1.0))


def _names(data: Dataset, steps: int) -> list[str]:
    """The name of each number of an observation, or of a history."""
    names = observation_names(data)
    acted = action_names(data)
    out = []
    for back in range(steps - 1, 0, -1):
        out += [f"{name}, {back} back" for name in (*names, *(f"action {name}" for name in acted))]
    return [*out, *names]


def _marks(data: Dataset, steps: int) -> dict[int, str]:
    """The indices of numbers that are 0 or 1, of an observation or a history, and the meaning of 1: a column has a level, an
    action is legal, or a value is missing."""
    names, said = observation_names(data), {}
    for each in columns_of(data):
        if each.role == "observation" and each.kind == "category":
            said |= {i: f"{each.name} is {names[i].removeprefix(f'{each.name}=')}" for i in each.dimensions}
        if each.marked and each.dimensions:
            said[each.dimensions[-1]] = f"{each.name} has no value"
    legal = range(len(names) - data.spec.mask_size, len(names))
    said |= {i: f"legal is {names[i].removeprefix('legal=')}" for i in legal if names[i].startswith("legal=")}
    width, now = len(names) + len(action_names(data)), steps - 1
    past = {(now - back) * width + i: f"{text}, {back} back" for back in range(now, 0, -1) for i, text in said.items()}
    return past | {now * width + i: text for i, text in said.items()}


def _fills(data: Dataset, steps: int) -> dict[int, float]:
    """The indices of numbers of an observation or a history that are set where a value is missing, and what they are set to."""
    schema, width = schema_of(data), len(observation_names(data)) + len(action_names(data))
    known = {column.name: column.fill for column in schema.columns if column.fill is not None} if schema else {}
    own = {each.dimensions[0]: known[each.name] for each in columns_of(data) if each.marked and each.name in known}
    return {step * width + i: fill for step in range(steps) for i, fill in own.items()}


def _in_units(data: Dataset, steps: int, x: np.ndarray) -> np.ndarray:
    """(rows, size) observations or histories with earlier continuous actions as they were logged."""
    if data.spec.discrete or steps == 1:
        return x
    size, acts, view = data.spec.observation_size, data.spec.action_size, Normalizer.of(data.spec)
    out = x.copy()
    for start in range(size, (steps - 1) * (size + acts), size + acts):
        out[:, start : start + acts] = view.from_unit(x[:, start : start + acts])
    return out


def _measures(data: Dataset) -> tuple[list[str], list[str]]:
    """The units of measurement of each number of an observation and of each action, empty where the log's schema has none."""
    schema = schema_of(data)
    known = {column.name: column.unit for column in schema.columns} if schema else {}
    acts = [known.get(name, "") if not data.spec.discrete else "" for name in action_names(data)]
    return [known.get(name, "") for name in observation_names(data)], acts


def _groups(data: Dataset, steps: int) -> list[tuple[str, list[int]]]:
    """Columns with the indices of their numbers in an observation or a history, whose values are permuted together."""
    size, acts = len(observation_names(data)), action_names(data)
    groups = [(each.name, list(each.dimensions)) for each in columns_of(data) if each.role == "observation" and each.dimensions]
    rest = sorted(set(range(size)) - {i for _, dimensions in groups for i in dimensions})
    groups += [("legal actions", rest)] if rest else []
    width = size + len(acts)  # of an earlier step
    done = [("action", list(range(size, width)))]  # one-hot if it is discrete
    done = done if data.spec.discrete else [(f"action {name}", [size + i]) for i, name in enumerate(acts)]
    past = [
        (f"{name}, {back} back", [(steps - 1 - back) * width + i for i in each])
        for back in range(steps - 1, 0, -1) for name, each in [*groups, *done]
    ]  # fmt: skip
    return [*past, *((name, [(steps - 1) * width + i for i in each]) for name, each in groups)]


def _matters(
    ask: Any, x: np.ndarray, done: np.ndarray, unit: np.ndarray, groups: Sequence[tuple[str, list[int]]], scale: np.ndarray,
    discrete: bool, rng: np.random.Generator,
) -> tuple[Matters, ...]:  # fmt: skip
    """Change of the policy's actions when a column's values are permuted between rows, the largest first."""
    out = []
    for name, dimensions in groups:
        change = np.zeros(len(x))
        for _ in range(EXCHANGES):
            other = x.copy()
            other[:, dimensions] = x[rng.permutation(len(x))][:, dimensions]
            change += _apart(ask(other), done, scale, discrete)
        mean = _mean(change / EXCHANGES, unit)
        ends = (mean.value, max(mean.low, 0.0), mean.high)
        value, low, high = ends if discrete else np.sqrt(np.maximum(ends, 0.0)).tolist()
        out.append(Matters(name, float(value), float(low), float(high)))
    return tuple(sorted(out, key=lambda each: -each.change))
