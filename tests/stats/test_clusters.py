"""What rows in clusters are worth, against numbers by hand."""

import numpy as np
import pytest

from deadreckon.stats.clusters import effective, intraclass


def test_intraclass_correlation_by_hand():
    """Clusters (1, 3) and (5, 7): mean squares 16 between and 2 within, so (16 - 2) / (16 + 2)."""
    assert intraclass(np.array([1.0, 3.0, 5.0, 7.0]), np.array([0, 0, 1, 1])) == pytest.approx(14 / 18)
    assert intraclass(np.array([1.0, 7.0, 1.0, 7.0]), np.array([0, 0, 1, 1])) == 0.0  # below 0 it would be
    assert intraclass(np.array([1.0, 1.0, 5.0, 5.0]), np.array([0, 0, 1, 1])) == 1.0


def test_intraclass_correlation_of_clusters_of_unequal_size():
    values, codes = np.array([1.0, 2.0, 4.0, 8.0, 6.0, 7.0]), np.array([0, 0, 0, 3, 3, 5])
    a, b = values[:3], values[3:5]
    between = (3 * (a.mean() - values.mean()) ** 2 + 2 * (b.mean() - values.mean()) ** 2 + (7 - values.mean()) ** 2) / 2
    within = (((a - a.mean()) ** 2).sum() + ((b - b.mean()) ** 2).sum()) / 3
    usual = (6 - (9 + 4 + 1) / 6) / 2
    assert intraclass(values, codes) == pytest.approx((between - within) / (between + (usual - 1) * within))


def test_rows_alike_within_clusters_are_worth_one_each_and_others_all():
    codes = np.repeat(np.arange(5), 4)
    alike, rng = np.arange(5.0)[codes], np.random.default_rng(0)
    assert effective(codes, alike) == 5.0
    assert effective(np.arange(20), rng.standard_normal(20)) == 20.0
    assert effective(np.zeros(20, int), rng.standard_normal(20)) == 1.0  # of a single cluster nothing tells
    within = np.tile([0.0, 1.0, 2.0, 3.0], 5)  # nothing in common within a cluster
    assert effective(codes, alike, within) == 20.0
    y = alike + rng.standard_normal(20)
    assert effective(codes, y) == pytest.approx(20 / (1 + 3 * intraclass(y, codes)))
    assert effective(codes, y, y) == pytest.approx(20 / (1 + 3 * intraclass(y, codes) ** 2))


def test_large_clusters_of_like_rows_are_worth_less_than_their_number():
    """Two of ten rows and four of one: 24^2 / (100 + 100 + 4) = 2.8 and not 6, as a mean of rows is mostly that of the two."""
    codes = np.repeat(np.arange(6), (10, 10, 1, 1, 1, 1))
    assert effective(codes, np.arange(6.0)[codes]) == pytest.approx(24**2 / 204)


@pytest.mark.parametrize("sizes", [(6,) * 8, (20, 20, *(1,) * 10)], ids=["equal", "unequal"])
def test_scores_that_have_nothing_to_do_with_predictions_correlate_no_more_often_than_said(sizes):
    """Of rows that share much within each cluster, a fifth went beyond the limit of independent ones."""
    rng = np.random.default_rng(0)
    codes, beyond, naive = np.repeat(np.arange(len(sizes)), sizes), 0, 0
    for _ in range(600):
        a, b = (0.9 * rng.standard_normal(len(sizes))[codes] + 0.4 * rng.standard_normal(len(codes)) for _ in range(2))
        r = float(np.corrcoef(a, b)[0, 1])
        worth = effective(codes, a, b)
        beyond += worth >= 5 and r > np.tanh(1.96 / (worth - 3) ** 0.5)  # of fewer than five nothing is said
        naive += r > np.tanh(1.96 / (len(codes) - 3) ** 0.5)
    assert beyond <= 600 * 0.04
    assert naive > 600 * 0.1
