"""Forests and boosted trees as oracles: trained once with scikit-learn, kept as plain arrays; judging needs numpy alone."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.errors import UserError, extra
from deadreckon.mbo.problems.oracle import Arrays, kept, split
from deadreckon.ope.metrics import rank_correlation

# Of Hamidieh's gradient boosting (2018), as the public code of the benchmark trained its oracle for superconductors until 2020.
TREES, DEPTH, RATE, SHARE = 374, 16, 0.02, 0.5


@dataclass(frozen=True)
class Trees:
    """Regression trees whose mean is the prediction.

    Attributes:
        right: (nodes,) of each inner node the child for larger values; the other child is the next node. Of a leaf: -1.
        feature: (nodes,) that decides.
        threshold: (nodes,) up to which a value is a smaller one; of a leaf its prediction.
        roots: (trees,) first nodes.
        rank_correlation: Spearman's, on rows that were held out.
        held_out: how many these were.
        kind: what they are, in words.
    """

    right: np.ndarray
    feature: np.ndarray
    threshold: np.ndarray
    roots: np.ndarray
    rank_correlation: float
    held_out: int
    kind: str

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """(rows, features) -> (rows,) predictions."""
        features = np.asarray(features, np.float32)
        rows = np.arange(len(features))[:, None]
        node = np.tile(self.roots, (len(features), 1))
        while (inner := self.right[node] >= 0).any():
            larger = features[rows, self.feature[node]] > self.threshold[node]
            node = np.where(inner, np.where(larger, self.right[node], node + 1), node)
        return self.threshold[node].mean(1)

    @property
    def about(self) -> str:
        """How true they are, in a line."""
        return f"{self.kind}; rank correlation {self.rank_correlation:.2f} on {self.held_out:,} held-out rows"


def forest(name: str, features: np.ndarray, y: np.ndarray, *, trees: int = 100, max_features: float = 1 / 3) -> Trees:
    """A random forest as the oracle of a data set: trained where it is not known yet, kept in the package's folder of designs.

    A tenth of the rows, drawn with a seed that never changes, is held out and tells how good it is.

    Raises:
        UserError: it has to be trained and scikit-learn is not installed.
    """

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[Any, list[Any], Callable[[np.ndarray], np.ndarray]]:
        from sklearn.ensemble import RandomForestRegressor

        model = RandomForestRegressor(trees, max_features=max_features, random_state=0, n_jobs=-1).fit(x, y)
        return model, [tree.tree_ for tree in model.estimators_], lambda values: values

    return _oracle(name, features, y, (trees, max_features), fit, "a random forest")


def boosted(name: str, features: np.ndarray, y: np.ndarray, *, trees: int = TREES, depth: int = DEPTH) -> Trees:
    """Gradient boosting as the oracle of a data set, as `forest`. On 15,000 rows of 81 features it takes minutes to train.

    Raises:
        UserError: it has to be trained and scikit-learn is not installed.
    """

    def fit(x: np.ndarray, y: np.ndarray) -> tuple[Any, list[Any], Callable[[np.ndarray], np.ndarray]]:
        from sklearn.ensemble import GradientBoostingRegressor

        model = GradientBoostingRegressor(
            learning_rate=RATE, n_estimators=trees, subsample=SHARE, max_depth=depth, random_state=0
        ).fit(x, y)
        # The prediction is the mean score plus the sum of all trees' steps, which is the mean over the trees of this.
        return model, [tree.tree_ for tree in model.estimators_[:, 0]], lambda values: y.mean() + RATE * trees * values

    return _oracle(name, features, y, ("boosted", trees, depth, RATE, SHARE), fit, f"gradient boosting of {trees} trees")


def _oracle(
    name: str, features: np.ndarray, y: np.ndarray, settings: tuple[Any, ...], fit: Callable[..., Any], kind: str
) -> Trees:
    features = np.ascontiguousarray(features, np.float32)
    y = np.ascontiguousarray(y, np.float64)
    arrays, known = kept(name, features, y, settings, lambda: _train(name, features, y, fit))
    fields: dict[str, Any] = {**arrays, **known}
    return Trees(**fields, kind=kind)


def _train(name: str, features: np.ndarray, y: np.ndarray, fit: Callable[..., Any]) -> Arrays:
    """The trees that `fit` grows, one after the other, and how good the model is on rows that it has not seen."""
    out, rest = split(len(y))
    try:
        model, grown, predicted = fit(features[rest], y[rest])
    except ImportError:
        raise UserError(f"{name} trains its oracle with scikit-learn: {extra('design')}") from None
    roots = np.cumsum([0, *(tree.node_count for tree in grown[:-1])])
    right, feature, threshold = [], [], []
    for root, tree in zip(roots, grown):
        leaf = tree.children_left < 0
        if not (leaf | (tree.children_left == np.arange(tree.node_count) + 1)).all():
            raise AssertionError("scikit-learn no longer stores the smaller child next to its parent")
        right.append(np.where(leaf, -1, tree.children_right + root).astype(np.int32))
        feature.append(np.where(leaf, 0, tree.feature).astype(np.int32))
        threshold.append(np.where(leaf, predicted(tree.value[:, 0, 0]), tree.threshold))
    nodes = {"right": right, "feature": feature, "threshold": threshold}
    arrays = {"roots": roots.astype(np.int32), **{key: np.concatenate(parts) for key, parts in nodes.items()}}
    return arrays, {"rank_correlation": rank_correlation(model.predict(features[out]), y[out]), "held_out": len(out)}
