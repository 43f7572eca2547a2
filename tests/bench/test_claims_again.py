"""The second stage of claims: comparisons that are open with all their cells are made again, with fresh seeds alone."""

from pathlib import Path

import numpy as np
import pytest

from deadreckon.bench.claims import verdict
from deadreckon.bench.claims_file import claims
from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from deadreckon.errors import UserError
from deadreckon.stats.comparison import paired
from tests.results import keep

SUITE = """
kind = "learn"
ledger = "ledger"
seeds = 4
steps = 100
evaluations = 1
logs = ["hopper-medium-v2"]

[methods]
BC = { agent = "bc" }
TD3 = { agent = "td3" }
"""
AGAIN = SUITE.replace("seeds = 4", "seeds = 5\nfirst_seed = 4")
CLAIMS = """
[[claims]]
id = "A"
says = "TD3 is better."
place = "1"
tests = [{ suite = "suite.toml", method = "TD3", than = ["BC"], again = { suite = "again.toml" } }]
"""
OPEN = {"BC": [10.0, 20.0, 30.0, 40.0], "TD3": [12.0, 10.0, 42.0, 35.0]}
BETTER = {"BC": [10.0, 20.0, 30.0, 40.0, 50.0], "TD3": [21.0, 32.0, 41.0, 52.0, 61.0]}
WORSE = {"BC": BETTER["TD3"], "TD3": BETTER["BC"]}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    for name, text in {"suite": SUITE, "again": AGAIN, "claims": CLAIMS}.items():
        (tmp_path / f"{name}.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def kept(name, scores, full=False):
    """The suite's store with these scores: method -> one a seed."""
    suite = read(name, full)
    store = store_of([suite], Path())
    for job in plan(suite):
        if job.method in scores:
            assert len(scores[job.method]) == len(job.seeds)
            keep(store, job, scores[job.method])
    return store


def said(store):
    (claim,) = claims("claims.toml")
    return verdict(claim, store)


def test_a_suite_has_the_seeds_that_it_says():
    assert [job.seeds for job in plan(read("again.toml"))] == [(4, 5, 6, 7, 8)] * 2
    first = {cell for job in plan(read("suite.toml")) for cell in job.cells}
    assert not first & {cell for job in plan(read("again.toml")) for cell in job.cells}


def test_fresh_seeds_alone_decide_what_the_first_ones_left_open():
    kept("suite.toml", OPEN)
    assert said(kept("again.toml", BETTER)).state == "holds"
    (one,) = said(kept("again.toml", BETTER)).comparisons
    ours, theirs = ({"hopper": np.array(BETTER[name])} for name in ("TD3", "BC"))
    assert one.again is not None
    assert one.again.gain == paired(ours, theirs, 0.975)  # half the error of a first stage
    assert one.gain == paired({"hopper": np.array(OPEN["TD3"])}, {"hopper": np.array(OPEN["BC"])}, 0.95)


def third(folder, first_seed=9):
    (folder / "third.toml").write_text(SUITE.replace("seeds = 4", f"seeds = 6\nfirst_seed = {first_seed}"))
    (folder / "claims.toml").write_text(CLAIMS.replace('"again.toml" }', '"again.toml", again = { suite = "third.toml" } }'))


def test_a_third_stage_decides_at_a_quarter_of_the_level_what_two_left_open(folder):
    third(folder)
    kept("suite.toml", OPEN)
    store = kept("again.toml", {name: [*values, 30.0] for name, values in OPEN.items()})
    assert (said(store).state, said(store).missing) == ("open", 12)
    fresh = {"BC": [10.0, 20.0, 30.0, 40.0, 50.0, 60.0], "TD3": [21.0, 32.0, 41.0, 52.0, 61.0, 69.0]}
    found = said(kept("third.toml", fresh))
    assert (found.state, found.missing) == ("holds", 0)
    (one,) = found.comparisons
    assert [each.level for each in one.stages] == [0.95, 0.975, 0.9875]
    assert one.stages[-1].gain == paired({"hopper": np.array(fresh["TD3"])}, {"hopper": np.array(fresh["BC"])}, 0.9875)


def test_a_third_stage_has_seeds_of_neither_before(folder):
    for seed in (2, 6):
        third(folder, seed)
        with pytest.raises(UserError, match=r"third.toml has seeds of (suite|again).toml; its first_seed must be 9 or more"):
            claims("claims.toml")


@pytest.mark.parametrize("more", ["log = true }", 'again = { suite = "third.toml", log = true } }'])
def test_no_later_stage_of_a_test_with_a_range_takes_logarithms(folder, more):
    third(folder, 9)
    text = CLAIMS.replace('"again.toml" }', f'"again.toml", {more}')
    (folder / "claims.toml").write_text(text.replace('than = ["BC"]', 'than = ["BC"], range = [0, 99]'))
    with pytest.raises(UserError, match="again: range is for tests without log; leave range or log out"):
        claims("claims.toml")


def test_they_contradict_as_well():
    kept("suite.toml", OPEN)
    assert said(kept("again.toml", WORSE)).state == "contradicted"


def test_what_is_decided_stays_so_whatever_fresh_seeds_say():
    kept("suite.toml", {name: values[:4] for name, values in BETTER.items()})
    found = said(kept("again.toml", WORSE))
    assert (found.state, found.comparisons[0].again) == ("holds", None)


def test_a_first_stage_without_all_its_cells_has_no_second_one():
    kept("suite.toml", {"BC": OPEN["BC"]})
    found = said(kept("again.toml", BETTER))
    assert (found.state, found.cells, found.missing) == ("open", 8, 4)


def test_cells_of_the_second_stage_are_missing_once_it_counts():
    found = said(kept("suite.toml", OPEN))
    assert (found.state, found.cells, found.missing) == ("open", 18, 10)


def test_the_full_size_has_no_second_stage(folder):
    (folder / "suite.toml").write_text(SUITE + "\n[full]\nsteps = 200\n")
    kept("suite.toml", OPEN)
    kept("suite.toml", OPEN, full=True)
    store = kept("again.toml", BETTER)
    (claim,) = claims("claims.toml")
    found = verdict(claim, store, full=True)
    assert (found.state, found.missing, found.comparisons[0].again) == ("open", 0, None)
    assert verdict(claim, store).state == "holds"


def test_at_full_size_suites_without_one_keep_their_second_stage():
    kept("suite.toml", OPEN)
    store = kept("again.toml", BETTER)
    (claim,) = claims("claims.toml")
    assert verdict(claim, store, full=True).state == "holds"


def test_the_second_stage_contradicts_at_a_level_for_all_comparisons(folder):
    both = SUITE.replace("TD3 =", 'SAC = { agent = "sac" }\nTD3 =')
    (folder / "suite.toml").write_text(both)
    (folder / "again.toml").write_text(both.replace("seeds = 4", "seeds = 5\nfirst_seed = 4"))
    (folder / "claims.toml").write_text(CLAIMS.replace('["BC"]', '["BC", "SAC"]'))
    kept("suite.toml", OPEN | {"SAC": OPEN["BC"]})
    for one in said(kept("again.toml", WORSE | {"SAC": WORSE["BC"]})).comparisons:
        assert one.again is not None
        ours, theirs = ({"hopper": np.array(WORSE[name])} for name in ("TD3", "BC"))
        assert one.again.strict == paired(ours, theirs, 1 - 0.05 / 2 / 2)


@pytest.mark.parametrize(("sign", "state"), [(1, "holds"), (-1, "contradicted")])
def test_numbers_of_very_different_sizes_are_compared_by_their_logarithms(folder, sign, state):
    """One value of five is a thousand times the others: Student's interval of means is open."""
    heavy = sign * np.array([1e3, 2e3, 5e3, 3e3, 4e6])
    one = CLAIMS.replace('than = ["BC"]', f"than = {sign * 9.0}")
    (folder / "claims.toml").write_text(one)
    kept("suite.toml", {"TD3": [*heavy[1:]]})
    store = kept("again.toml", {"TD3": [*heavy]})
    assert said(store).state == "open"
    (folder / "claims.toml").write_text(one.replace('"again.toml" }', '"again.toml", log = true }'))
    assert said(store).state == state
    (found,) = said(store).comparisons
    assert found.again is not None
    assert found.again.gain.value == pytest.approx(sign * (np.log10(1 + abs(heavy)).mean() - 1.0))  # log10(1 + 9) = 1


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("again", "first_seed = 4", "first_seed = 3", "again.toml has seeds of suite.toml; its first_seed must be 4 or more"),
        ("again", "steps = 100", "steps = 200", "steps of again.toml and of suite.toml differ"),
        ("again", "evaluations = 1", "evaluations = 1\nepisodes = 7", "episodes of again.toml and of suite.toml differ"),
        ("again", 'BC = { agent = "bc" }', "", "unknown method of again.toml 'BC'"),
        ("again", 'BC = { agent = "bc" }', 'BC = { agent = "bc", fields = { lr = 0.1 } }', "BC is not the same in again.toml"),
        ("again", "hopper-medium-v2", "walker2d-medium-v2", "task, problem or case of again.toml 'hopper-medium-v2'"),
        ("again", "first_seed = 4", "first_seed = -1", "first_seed must be a whole number from 0 to 1,000,000, got -1"),
        ("again", "first_seed = 4", "first_seed = true", "first_seed must be a whole number from 0 to 1,000,000, got True"),
        ("again", "seeds = 5", "seeds = 1", "again.toml must have two seeds or more, and no section [full]"),
        ("again", 'TD3 = { agent = "td3" }', 'TD3 = { agent = "td3" }\n[full]\nsteps = 200', "no section [full]"),
        ("claims", 'again = { suite = "again.toml" }', 'margin = -5.0, again = { suite = "again.toml", log = true }',
         "the margin -5 would be of logarithms there; leave log or the margin out"),
        ("claims", "again = { ", "again = { margin = 1, ", "unknown key 'margin'"),
        ("claims", '{ suite = "again.toml" }', "{ log = true }", "suite is missing"),
        ("claims", '{ suite = "again.toml" }', "{ suite = 3 }", "suite must be text, got 3"),
        ("claims", '{ suite = "again.toml" }', '"again.toml"', "again must be a table with a suite, got 'again.toml'"),
        ("claims", '"again.toml" }', '"../again.toml" }', "suite"),
    ],
)  # fmt: skip
def test_wrong_second_stages_are_refused_in_one_line(folder, file, old, new, message):
    path = folder / f"{file}.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UserError) as raised:
        claims("claims.toml")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
