"""Agents beside what they were: which runs are paired, and the mean over logs."""

from math import nan

import pytest

from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from evidence.changed import changed
from tests.results import keep

PAIRS = """
kind = "learn"
ledger = "ledger"
seeds = 2
steps = 100
evaluations = 1
logs = ["hopper-medium-v2", "door-human-v1"]

[methods]
CRR = { agent = "crr" }
"CRR, before" = { agent = "crr", fields = { likelihood = "tanh_normal" } }
BC = { agent = "bc" }
"""
MORE = PAIRS.replace(', "door-human-v1"', "").replace("seeds = 2", "seeds = 3").replace("CRR, before", "CRR, tanh-normal")
HOPPER = {("CRR", "hopper"): [11.0, 13.0, 15.0], ("CRR, tanh-normal", "hopper"): [10.0, 11.0, 12.0]}


@pytest.fixture
def row(tmp_path, monkeypatch):
    """A function that gives CRR's row, from scores by the method and the beginning of the log's name."""
    for name, text in ("one", PAIRS), ("two", MORE):
        (tmp_path / f"{name}.toml").write_text(text)
    monkeypatch.setattr("evidence.changed.PAIRS", ["one"])
    monkeypatch.setattr("evidence.changed.MORE", ["two"])
    monkeypatch.chdir(tmp_path)
    suites = [read("one.toml"), read("two.toml")]
    store = store_of(suites, tmp_path)

    def told(scores, logs=()):
        for job in (job for suite in suites for job in plan(suite)):
            if values := scores.get(where := (job.method, job.on.partition("-")[0])):
                keep(store, job, values, **({"log": logs[where]} if where in logs else {}))
        (line,) = changed(suites, store).splitlines()[2:]
        return [cell.strip() for cell in line.strip("|").split("|")]

    return told


def test_differences_are_of_the_same_seeds_of_all_suites(row):
    """2 -+ 4.303 / sqrt(3), and -4 -+ 12.706 * 2; their mean has the variance (1/3 + 4) / 4, with 1.17 degrees of freedom."""
    found = row(HOPPER | {("CRR", "door"): [3.0, 5.0], ("CRR, before", "door"): [9.0, 7.0]})
    assert found == ["CRR", "2.0 [-0.5, 4.5] (3)", "-4.0 [-29.4, 21.4] (2)", "-1.0 [-10.5, 8.5]"]


def test_a_log_with_one_seed_in_common_or_a_score_that_is_not_finite_does_not_count(row):
    assert row(HOPPER | {("CRR", "door"): [3.0, 5.0], ("CRR, before", "door"): [9.0]})[2:] == ["-", "2.0 [-0.5, 4.5]"]


def test_runs_on_different_collections_of_a_log_are_no_pairs(row):
    found = row(HOPPER | {("CRR", "door"): [3.0, 5.0], ("CRR, before", "door"): [9.0, 7.0]}, {("CRR", "door"): "elsewhere"})
    assert found[2:] == ["-", "2.0 [-0.5, 4.5]"]


def test_a_score_that_is_not_finite_is_told(row):
    found = row(HOPPER | {("CRR", "door"): [3.0, nan], ("CRR, before", "door"): [9.0, 7.0]})
    assert found[2:] == ["not finite", "2.0 [-0.5, 4.5]"]
