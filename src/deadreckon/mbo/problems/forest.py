"""Random forests as oracles: trained once with scikit-learn, kept as plain arrays, so that judging needs numpy alone."""

from dataclasses import dataclass

import numpy as np

from deadreckon.errors import UserError
from deadreckon.mbo.problems.oracle import Arrays, kept, split
from deadreckon.ope.metrics import rank_correlation


@dataclass(frozen=True)
class Forest:
    """Regression trees whose mean is the prediction.

    Attributes:
        right: (nodes,) of each inner node the child for larger values; the other child is the next node. Of a leaf: -1.
        feature: (nodes,) that decides.
        threshold: (nodes,) up to which a value is a smaller one; of a leaf its prediction.
        roots: (trees,) first nodes.
        rank_correlation: Spearman's, on rows that were held out.
        held_out: how many these were.
    """

    right: np.ndarray
    feature: np.ndarray
    threshold: np.ndarray
    roots: np.ndarray
    rank_correlation: float
    held_out: int

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
        """How true it is, in a line."""
        return f"a random forest; rank correlation {self.rank_correlation:.2f} on {self.held_out:,} held-out rows"


def forest(name: str, features: np.ndarray, y: np.ndarray, *, trees: int = 100, max_features: float = 1 / 3) -> Forest:
    """The oracle of a data set: trained where it is not known yet, kept in the package's folder of designs.

    A tenth of the rows, drawn with a seed that never changes, is held out and tells how good it is.

    Raises:
        UserError: it has to be trained and scikit-learn is not installed.
    """
    features = np.ascontiguousarray(features, np.float32)
    y = np.ascontiguousarray(y, np.float64)
    train = lambda: _train(name, features, y, trees, max_features)  # noqa: E731
    arrays, known = kept(name, features, y, (trees, max_features), train)
    return Forest(**arrays, **known)


def _train(name: str, features: np.ndarray, y: np.ndarray, trees: int, max_features: float) -> Arrays:
    try:
        from sklearn.ensemble import RandomForestRegressor
    except ImportError:
        raise UserError(f"{name} trains its oracle with scikit-learn: pip install 'deadreckon[design]'") from None
    out, rest = split(len(y))
    model = RandomForestRegressor(trees, max_features=max_features, random_state=0, n_jobs=-1).fit(features[rest], y[rest])
    grown = [tree.tree_ for tree in model.estimators_]
    roots = np.cumsum([0, *(tree.node_count for tree in grown[:-1])])
    right, feature, threshold = [], [], []
    for root, tree in zip(roots, grown):
        leaf = tree.children_left < 0
        if not (leaf | (tree.children_left == np.arange(tree.node_count) + 1)).all():
            raise AssertionError("scikit-learn no longer stores the smaller child next to its parent")
        right.append(np.where(leaf, -1, tree.children_right + root).astype(np.int32))
        feature.append(np.where(leaf, 0, tree.feature).astype(np.int32))
        threshold.append(np.where(leaf, tree.value[:, 0, 0], tree.threshold))
    nodes = {"right": right, "feature": feature, "threshold": threshold}
    arrays = {"roots": roots.astype(np.int32), **{key: np.concatenate(parts) for key, parts in nodes.items()}}
    return arrays, {"rank_correlation": rank_correlation(model.predict(features[out]), y[out]), "held_out": len(out)}
