"""Metrics by hand, and the published tables against their own medians."""

import itertools

import numpy as np
import pytest
from scipy.stats import spearmanr

from deadreckon.errors import UserError
from deadreckon.ope import dope
from deadreckon.ope import metrics as m
from deadreckon.runs import dope as protocol
from deadreckon.stats.ranks import spearman_of_each


def test_by_hand():
    truth = np.array([0.0, 10.0, 5.0])
    estimates = np.array([3.0, 8.0, 9.0])
    assert m.absolute_error(estimates, truth) == pytest.approx(3.0)
    assert m.rank_correlation(estimates, truth) == pytest.approx(0.5)
    assert m.regret(estimates, truth) == 5.0
    assert m.regret(estimates, truth, 2) == 0.0
    np.testing.assert_allclose(m.normalise(estimates, truth), [0.3, 0.8, 0.9])
    assert m.sharpe_ratio(estimates, truth, behavior=4.0, k=2) == pytest.approx((10.0 - 4.0) / 2.5)
    # Above 4 are the last two in truth; the estimates put the first at 3 and both others above.
    assert m.error_rates(estimates, truth, 4.0) == (0.0, 0.0)
    assert m.error_rates(estimates, truth, 2.5) == (1.0, 0.0)
    assert m.error_rates(estimates, truth, 8.5) == (0.5, 1.0)


def test_rank_correlation_is_that_of_ranks():
    """E.3 is Pearson's formula; on ranks a monotone map changes nothing."""
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 11))
    assert m.rank_correlation(np.exp(3 * a), b) == pytest.approx(m.rank_correlation(a, b))
    assert m.rank_correlation(a, a**3) == pytest.approx(1.0)
    assert np.isnan(m.rank_correlation(np.ones(3), np.arange(3)))


@pytest.mark.parametrize("k", [1, 2, 3])
def test_regret_among_ties_is_a_mean_over_orders(k):
    truth, estimates = np.array([1.0, 4.0, 2.0, 9.0]), np.array([5.0, 5.0, 5.0, 1.0])
    orders = [truth[list(order)][:k].max() for order in itertools.permutations(range(3))]
    assert m.regret(estimates, truth, k) == pytest.approx(9.0 - np.mean(orders))


@pytest.mark.slow
def test_clipping_makes_ties_of_overestimates():
    """The public notebook's form: two policies estimated above twice the range cannot be told apart."""
    truth = np.array([0.0, 1.0, 0.5])
    estimates = np.array([0.0, 2.5, 3.0])
    plain, clipped = (m.compare(estimates, truth, clip=clip) for clip in (None, m.PUBLIC_CLIP))
    assert clipped.regret.mean < plain.regret.mean
    assert clipped.absolute_error.mean < plain.absolute_error.mean
    # In the set as it is: the two are a tie of the best and the middle one, and stand 1 and 1.5 off.
    assert (plain.regret.value, clipped.regret.value) == (0.5, 0.25)
    assert (plain.absolute_error.value, clipped.absolute_error.value) == pytest.approx((4 / 3, 2.5 / 3))


@pytest.mark.slow
def test_bootstrap_over_policies():
    rng = np.random.default_rng(0)
    truth = rng.standard_normal(11)
    found = m.compare(truth + 0.1 * rng.standard_normal(11), truth)
    assert found.count == 11
    assert 0.9 < found.rank_correlation.mean <= 1.0
    assert 0.0 <= found.regret.mean < 0.1
    assert 0.0 < found.absolute_error.spread < found.absolute_error.mean
    assert found == m.compare(truth + 0.1 * np.random.default_rng(0).standard_normal(22)[11:], truth)


@pytest.mark.slow
def test_the_metric_itself_stands_beside_its_mean_over_redrawn_policies():
    """Two policies, the worse estimated higher: regret 1. Of the four draws with replacement two are of one policy alone."""
    truth, estimates = np.array([0.0, 1.0]), np.array([5.0, 4.0])
    found = m.compare(estimates, truth, normalised=False)
    assert found.regret == (1.0, 1.0, 0.0)  # draws of one policy have no ranks and are left out
    assert found.rank_correlation == pytest.approx((-1.0, -1.0, 0.0))
    assert found.absolute_error == pytest.approx((4.0, 4.0, 0.0))
    # The best of ten is estimated best, so the regret is 0; the others are in reverse, and where it is not drawn, as in
    # 0.9^10 of all draws, the worst of those drawn is chosen. The greatest of ten draws of 0 .. 8 is on average:
    greatest = 8 - sum((j / 9) ** 10 for j in range(1, 9))
    truth = np.arange(10.0)
    found = m.compare(np.append(-truth[:9], 1.0), truth, normalised=False, resamples=4000)
    assert found.regret.value == 0.0
    assert found.regret.mean == pytest.approx(0.9**10 * (2 * greatest - 8), abs=0.2)
    assert found.regret.spread > 1
    assert found.rank_correlation.value == pytest.approx(m.rank_correlation(np.append(-truth[:9], 1.0), truth))


def test_refusals():
    with pytest.raises(UserError, match="as many true values"):
        m.compare(np.zeros(3), np.zeros(4))
    with pytest.raises(UserError, match=r"k must be 1 \.\. the number of policies, of which there are 3, got 4"):
        m.compare(np.arange(3), np.arange(3), k=4)
    with pytest.raises(UserError, match="same true value"):
        m.compare(np.arange(3), np.ones(3))
    with pytest.raises(UserError, match="the true value of policy 1 is not finite"):
        m.compare(np.arange(3), np.array([0.0, np.nan, 1.0]))
    with pytest.raises(UserError, match="the estimate of policy 1 is not finite"):
        m.compare(np.array([0.0, np.inf, 1.0]), np.arange(3))


def test_published_tables_have_their_printed_medians():
    """Where the scan has all cells of a column, its median is the printed one; else the printed one is within reach."""
    published, checked = m.published(), 0
    for metric, domains in published["median"].items():
        for domain, printed in domains.items():
            table = published[metric][domain]
            for method, median in printed.items():
                cells = [row.get(method) for row in table.values()]
                known = [cell[0] for cell in cells if cell is not None]
                lost = len(cells) - len(known)
                if median is None:
                    continue
                reach = [np.median([*known, *[fill] * lost]) for fill in (-np.inf, np.inf)]
                digits = 0.006 if median < 100 else 0.6
                assert reach[0] - digits <= median <= reach[1] + digits
                if not lost:
                    assert np.median(known) == pytest.approx(median, abs=digits)
                    checked += 1
    assert checked == 19
    assert published["regret_at_1"]["d4rl"]["hopper-medium"]["IS"] == [0.38, 0.28]


def test_published_returns_of_dm_control_are_in_the_ranges_of_dope():
    found = m.published_returns()
    assert sum(map(len, found.values())) == 861
    for task, (least, most) in {
        "cartpole-swingup": (2, 869), "cheetah-run": (49, 597), "finger-turn-hard": (102, 798), "fish-swim": (73, 547),
        "humanoid-run": (0.6, 575), "manipulator-insert-ball": (34, 597), "manipulator-insert-peg": (43, 396),
        "walker-stand": (341, 950), "walker-walk": (28, 956),
    }.items():  # fmt: skip
        means = [each.mean for each in found[task]]
        assert (min(means), max(means)) == pytest.approx((least, most), abs=1.0)
        assert len({(each.agent, each.seed, each.updates) for each in found[task]}) == len(found[task])
        assert {each.seed for each in found[task]} == {0, 1, 2}
    assert ("ABM", 2, 200_001, 301.47, 212.09) in found["cheetah-run"]
    assert ("CRR", 2, 800_001, 560.03, 114.97) in found["humanoid-run"]
    assert ("D4PG", 0, 25_001, 29.36, 0.16) in found["cartpole-swingup"]


def test_tables_of_dm_control_are_those_of_the_thesis_for_it():
    log, d4rl = "walker-stand-full-replay-v0@dr1", "hopper-medium-v2@dr1"
    assert dope.of_unplugged(log) == "walker-stand"
    assert dope.of_unplugged(d4rl) is None
    assert dope.of_unplugged(f"{log}-2000-steps") is None
    assert dope.printed("rank_correlation", log, "WPDIS") == (0.59, 0.08)
    assert dope.printed("absolute_error", log, "FQE-L2") == (6.51, 0.71)
    assert dope.printed("regret", log, "WPDIS") is None  # Table E.3 has regret@5
    assert dope.printed("regret", log, "WPDIS", 5) == (0.54, 0.11)
    assert dope.printed("regret", d4rl, "WPDIS", 5) is None
    assert dope.printed("regret", d4rl, "WPDIS") == (0.38, 0.28)
    none, some = np.zeros(6), np.arange(6.0)
    numbers = 0.0, some, none, some, none, none, 0.0, (), ""
    made = [dope.Result(each, "FQE-L2", tuple("abcdef"), *numbers) for each in (d4rl, log)]
    assert [(each.metric, each.k) for each in dope.shown_metrics(made[:1])][-1] == ("regret", 1)
    assert dope.shown_metrics(made)[-1] == ("regret", 5, "Regret@5, in ranges of the true values")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"half": "rlu"}, "unknown half of DOPE 'rlu'"),
        ({"tasks": ()}, "no log is selected: name a task"),
        ({"kinds": ()}, "no log is selected: name a task"),
        ({"half": "unplugged", "tasks": ["walker-run"]}, "unknown recipe 'walker-run-full-replay-v0'"),
        ({"half": "unplugged", "tasks": ["humanoid-run"]}, "there are no policies of 'humanoid-run' in the package"),
    ],
)
def test_what_the_protocol_refuses_before_it_begins(options, message):
    with pytest.raises(UserError, match=message):
        protocol.dope(["fqe"], **options)


def test_many_rank_correlations_are_those_of_scipy():
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 4, (50, 6)).astype(float), rng.normal(size=(50, 6))  # with many ties
    a[0] = 2.0
    found = spearman_of_each(a, b)
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[1:], [spearmanr(x, y).statistic for x, y in zip(a[1:], b[1:])], rtol=1e-12)
    assert spearman_of_each(a[:0], b[:0]).shape == (0,)
