"""Agents beside the logs' own mean scores: what counts as an improvement."""

from pathlib import Path

import pytest

from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from evidence.improved import BEHAVIOUR, SUITES, improved
from tests.results import keep

SUITE = """
kind = "learn"
ledger = "ledger"
seeds = 3
steps = 100
evaluations = 1
logs = ["hopper-medium-v2", "halfcheetah-medium-v2", "door-human-v1"]

[methods]
AWAC = { agent = "awac" }
"AWAC, other" = { agent = "awac", fields = { temperature = 1.0 } }
"""
HOPPER, CHEETAH = BEHAVIOUR["hopper-medium-v2", None], BEHAVIOUR["halfcheetah-medium-v2", None]


@pytest.fixture
def row(tmp_path, monkeypatch):
    """A function that gives AWAC's row, from scores by the method and the beginning of the log's name; `below` what follows."""
    monkeypatch.setattr("evidence.improved.SUITES", ["one"])
    monkeypatch.chdir(tmp_path)

    def told(scores, rows=""):
        (tmp_path / "one.toml").write_text(rows + SUITE)
        suite = read("one.toml")
        store = store_of([suite], tmp_path)
        for job in plan(suite):
            if values := scores.get((job.method, job.on.partition("-")[0])):
                keep(store, job, values)
        lines = improved([suite], store).splitlines()
        told.below = [line for line in lines if line.startswith("- ") and "AWAC" in line.replace("`awac`", "AWAC")]
        found = [line for line in lines if line.startswith("| AWAC |")]
        return [cell.strip() for line in found for cell in line.strip("|").split("|")]

    return told


def test_the_suites_that_count_are_there():
    folder = Path(__file__).parent.parent / "evidence"
    assert set(SUITES) <= {path.stem for path in folder.glob("*.toml")}


def test_the_log_with_the_highest_lower_end_is_shown(row):
    wide, narrow = [HOPPER + x for x in (0.0, 30.0, 60.0)], [CHEETAH + x for x in (4.0, 5.0, 6.0)]
    found = row({("AWAC", "hopper"): wide, ("AWAC", "halfcheetah"): narrow})
    assert found[:4] == ["AWAC", "halfcheetah-medium-v2, best of 2", "100", "3"]
    assert row.below == []
    assert found[-1] == "yes"
    assert found[-2] == "5.0 [1.4, 8.6]"  # 5 -+ 6.205 / sqrt(3): Student's interval of 97.5 %, as two logs were looked at


def test_the_best_of_two_logs_has_to_be_above_at_a_level_for_two(row):
    """Alone the interval of 95 % would lie above: 3 -+ 4.303 / sqrt(3)."""
    above = {("AWAC", "hopper"): [HOPPER + x for x in (2.0, 3.0, 4.0)]}
    assert row(above)[-2:] == ["3.0 [0.5, 5.5]", "yes"]
    found = row(above | {("AWAC", "halfcheetah"): [CHEETAH - x for x in (2.0, 3.0, 4.0)]})
    assert found[-2:] == ["3.0 [-0.6, 6.6]", "not shown"]


def test_a_suite_that_has_fewer_of_its_seeds_does_not_hide_one_that_has_all(tmp_path, monkeypatch):
    monkeypatch.setattr("evidence.improved.SUITES", ["one", "two"])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.toml").write_text(SUITE)
    (tmp_path / "two.toml").write_text(SUITE.replace("seeds = 3", "seeds = 5"))
    suites = [read("one.toml"), read("two.toml")]
    store = store_of(suites, tmp_path)
    job = next(job for job in plan(suites[0]) if (job.method, job.on) == ("AWAC", "hopper-medium-v2"))
    keep(store, job, [HOPPER + x for x in (10.0, 11.0, 12.0)])
    lines = [line for line in improved(suites, store).splitlines() if line.startswith("| AWAC |")]
    assert lines[0].endswith("| yes |")


def test_a_part_of_the_seeds_shows_nothing(row):
    assert row({("AWAC", "hopper"): [99.0, 99.5]})[-2:] == [f"{99.25 - HOPPER:.1f}", "2 of 3 seeds"]
    assert row.below == ["- Not shown, and more runs are declared: AWAC (`one.toml`)"]


def test_equal_scores_of_all_seeds_show_nothing(row):
    assert row({("AWAC", "hopper"): [99.0] * 3})[-1] == "not shown"
    assert row.below == ["- Not shown, and more runs are declared: AWAC (`one.toml`)"]


def test_a_part_of_a_log_has_a_mean_of_its_own(row):
    part = BEHAVIOUR["hopper-medium-v2", 200_000]
    assert part != HOPPER
    found = row({("AWAC", "hopper"): [part + x for x in (2.0, 3.0, 4.0)]}, "rows = 200_000")
    assert found[5:7] == [f"{part:g}", "3.0 [0.5, 5.5]"]
    assert not row({("AWAC", "hopper"): [part + x for x in (2.0, 3.0, 4.0)]}, "rows = 100_000")  # nobody has noted its mean
    [below] = row.below
    assert below.startswith("- No result on these logs yet: ")


def test_variants_and_logs_of_people_do_not_count(row):
    assert not row({("AWAC, other", "hopper"): [99.0, 98.0, 97.0], ("AWAC", "door"): [99.0, 98.0, 97.0]})
    [below] = row.below
    assert "`awac` (`one.toml`)" in below
