"""The numbers, against a computation of their own."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from run_folders import TASK, compared, write_run

from deadreckon.report.entries import read
from deadreckon.report.page import render
from deadreckon.report.rows import against, paired, rows, versus
from deadreckon.report.terminal import headline, table
from deadreckon.stats.crossed import mean_interval
from deadreckon.stats.interval import ALPHA, Interval
from deadreckon.tasks import registry


def test_rows_equal_an_independent_computation(runs):
    found = {r.label: r for r in rows(read(runs))}
    assert list(found) == ["behaviour policy", "TD3+BC", "BC", "TD3"]
    last = pq.read_table(runs[1] / "evaluations" / "0000000200.parquet").to_pandas()
    row = found["TD3+BC"]
    assert row.returns.value == pytest.approx(last["return"].mean())
    assert row.score.value == pytest.approx(last["score"].mean())
    assert row.per_seed == pytest.approx(list(last.groupby("seed")["score"].mean()))
    assert row.value == pytest.approx(45.0)
    assert row.truth == pytest.approx(last["discounted_return"].mean())
    assert row.over == pytest.approx(45.0 - last["discounted_return"].mean())
    assert row.mmd == pytest.approx(0.3)
    assert row.outside == pytest.approx(0.05)
    assert (row.updates, row.entry.failed, row.baseline) == (200, [], False)
    assert found["TD3"].entry.failed == [(1, "critic_loss", 150)]
    assert found["BC"].baseline
    assert found["BC"].value is None
    log = found["behaviour policy"]
    reference = registry.task(TASK).reference
    assert log.score.value == pytest.approx(100 * (25 - reference.random) / (reference.expert - reference.random))


def test_a_constant_gain_has_no_spread_when_paired():
    b = np.array([[0.0, 10.0, 50.0], [0.0, 10.0, 50.0]])
    gap = paired(b + 3, b)
    assert (gap.value, gap.low, gap.high) == pytest.approx((3, 3, 3))
    alone = mean_interval(b)
    assert alone.high - alone.low > 10  # what pairing takes away


def test_paired_difference_by_hand():
    # One seed each, differences 0 and 4: a deviation of 2 of their mean, one degree of freedom.
    t = 12.7062
    gap = paired(np.array([[1.0, 5.0]]), np.array([[1.0, 1.0]]))
    assert (gap.value, gap.low, gap.high) == pytest.approx((2, 2 - 2 * t, 2 + 2 * t), rel=1e-4)
    # Seeds count too: seed means 0 and 2 against 0, a deviation of 1.
    gap = paired(np.array([[0.0, 0.0], [2.0, 2.0]]), np.zeros((1, 2)))
    assert (gap.value, gap.low, gap.high) == pytest.approx((1, 1 - t, 1 + t), rel=1e-4)
    # More episodes on one side: only the common starts count.
    assert paired(np.array([[1.0, 1.0, 99.0]]), np.array([[0.0, 0.0]])).value == pytest.approx(1)


def test_difference_to_an_estimate_carries_its_uncertainty():
    gap = against(np.full((1, 4), 10.0), Interval(4.0, 3.0, 5.0))
    assert gap.value == pytest.approx(6)
    assert (gap.low, gap.high) == pytest.approx((5, 7), abs=0.1)
    gap = against(np.array([[9.0, 11.0]]), Interval(4.0, np.nan, np.nan))  # of a log of one episode
    assert gap.value == pytest.approx(6)
    assert np.isnan([gap.low, gap.high]).all()


@pytest.mark.parametrize(("seeds", "between"), [(1, 0.0), (3, 2.0), (3, 0.3), (3, 0.0), (20, 0.5)])
def test_interval_covers(seeds, between):
    """Few seeds or many, whether seeds, starts or neither make most of the difference; for means and for paired gains."""
    rng = np.random.default_rng(0)
    hits, gains = 0, 0
    for _ in range(600):
        starts = rng.normal(0, 1, 30)
        a, b = (starts + rng.normal(0, between, (seeds, 1)) + rng.normal(0, 0.7, (seeds, 30)) for _ in range(2))
        found, gain = mean_interval(a), paired(a, b)
        hits += found.low <= 0 <= found.high
        gains += gain.low <= 0 <= gain.high
    assert 0.93 <= hits / 600 <= 0.99
    assert 0.93 <= gains / 600 < 1.0  # of two sets of three seeds that do not differ, it is wider than it need be


def test_the_simulator_compares_and_decides_nothing(tmp_path, runs):
    found = compared(read(runs))
    assert found.best.label == "TD3+BC"
    assert found.headline.startswith("Best in the simulator: TD3+BC, score ")
    assert found.standing == "Best in the simulator"
    assert "eploy" not in found.headline
    assert found.compared == 3 + 2  # each with the behaviour policy, and all but cloning with cloning
    assert found.versus_log.worth.low > 0
    assert found.versus_cloning.worth.value == pytest.approx(found.best.score.value - found.cloning.score.value)
    text = " ".join(found.beaten)
    assert "Clearly better than behaviour cloning (BC): TD3+BC by" in text
    assert "Not clearly better: TD3" in text
    assert "TD3's critic estimated 3.00e7" in text
    seed = write_run(tmp_path / "seed", "sac", 300.0, failures={0: ("q", 100)})
    found = compared(read([*runs, seed]))
    assert found.best.label == "SAC"
    assert "1 of 2 seeds of SAC failed" in " ".join(found.caveats)
    assert "One seed of" not in " ".join(found.caveats)
    lone = compared(read([*runs, write_run(tmp_path / "lone", "awac", 10.0, seeds=1)]))
    assert "One seed of AWAC: differences are those of these policies" in " ".join(lone.caveats)
    assert "chance" in compared(read([write_run(tmp_path / "same", "sac", 25.0)])).headline
    assert "below the behaviour policy" in compared(read([write_run(tmp_path / "worse", "sac", -80.0)])).headline
    assert "not finished" in compared(read([write_run(tmp_path / "now", "sac", 300.0, finished=False)])).caveats[0]
    unknown = compared(read([write_run(tmp_path / "none", "sac", 300.0, behavior=None)]))
    assert (unknown.compared, unknown.versus_log) == (0, None)


def test_a_run_that_is_not_evaluated_yet_is_not_beaten(tmp_path):
    """The stamp and the sentence below it say the same of how many were compared."""
    runs = [write_run(tmp_path / "done", "iql", 60.0), write_run(tmp_path / "begun", "cql", finished=False)]
    for part in (tmp_path / "begun" / "evaluations").iterdir():
        part.unlink()
    page = read(runs)
    found = compared(page)
    assert found.standing == "In the simulator"
    assert found.headline.startswith("In the simulator: IQL,")
    assert "Best in the simulator" not in render(page)


def test_differences_hold_for_all_that_are_compared(tmp_path):
    """Bonferroni: the more is compared, the wider; as wide as the interval at that level, computed anew."""
    runs = [write_run(tmp_path / f"a{i}", "sac", 80.0 - i, seeds=4, seed=i) for i in range(4)]
    few, many = compared(read(runs[:1])), compared(read(runs))
    assert (few.compared, many.compared) == (1, 4)
    best = many.best
    reach = lambda gap: gap.worth.high - gap.worth.low  # noqa: E731
    assert reach(many.versus_log) > 1.2 * reach(few.versus_log)
    assert many.versus_log.worth == versus(best, many.log, ALPHA / 4).worth
    one = paired(best.entry.last("score"), np.zeros((1, 6)), 0.05)
    assert paired(best.entry.last("score"), np.zeros((1, 6)), 0.05 / 4).high > one.high


def test_without_a_gain_the_page_does_not_claim_one(tmp_path):
    page = read([write_run(tmp_path / "a", "bc", 60.0), write_run(tmp_path / "b", "sac", 60.0, seed=1)])
    assert compared(page).beaten[0].startswith("No agent clearly beats BC")


def test_a_private_task_is_shown_in_returns(tmp_path):
    page = read([write_run(tmp_path / "a", "bc", 60.0, task="mine"), write_run(tmp_path / "b", "sac", 200.0, task="mine")])
    log, best, _ = rows(page)
    assert log.score is None
    assert versus(best, log).worth.value == pytest.approx(best.returns.value - 25)


def test_terminal_table_shows_the_same_numbers(runs):
    text = table(runs)
    assert text.isascii()
    for r in rows(read(runs)):
        line = next(line for line in text.splitlines() if line.startswith(r.label + " "))
        digits = 1 if max(abs(r.score.value), abs(r.score.low), abs(r.score.high)) >= 10 else 2
        assert f"{r.score.value:.{digits}f} [{r.score.low:.{digits}f}, {r.score.high:.{digits}f}]" in line
    assert headline(runs).startswith("Best in the simulator: TD3+BC, score ")
    assert headline(runs).isascii()
