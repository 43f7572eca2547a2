"""What the repository declares as evidence can be read, and its pages say what the ledger says."""

import hashlib
import re
import tomllib
from math import nan
from pathlib import Path

import numpy as np
import pytest

from deadreckon.bench import claims as declared
from deadreckon.bench.claims import Claim, Comparison, Verdict
from deadreckon.bench.claims_file import claims
from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan, plan_all
from deadreckon.bench.suite import queue, read
from deadreckon.errors import UserError
from deadreckon.stats.interval import Interval
from evidence import bear, improved, pages, records
from tests.results import keep

ROOT = Path(__file__).resolve().parent.parent / "evidence"
MOST = 30e6  # bytes of the ledger


def test_pages_are_what_the_ledger_says(monkeypatch, capsys):
    monkeypatch.chdir(ROOT.parent)
    assert pages.main(["--check"]) == 0, capsys.readouterr().out


# What `benchmarks/report.py` measured, and tables of decisions, which tests/test_decisions.py compares with the kept results.
MEASURED = re.compile(r"<!-- [a-z0-9-]+: python [^\n]+ -->\n.*?<!-- end -->", re.S)
OTHERS = {"PENDING", "index", "published"}  # no results, and those of others


@pytest.mark.parametrize("page", sorted({path.stem for path in pages.PAGES.glob("*.md")} - OTHERS))
def test_no_table_of_results_is_written_by_hand(page):
    outside = MEASURED.sub("", pages.BLOCK.sub("", (pages.PAGES / f"{page}.md").read_text()))
    assert [line for line in outside.splitlines() if line.lstrip().startswith("|")] == []


def test_every_record_is_on_a_page():
    shown = re.findall(r"<!-- record ([\w.-]+) -->", "".join(path.read_text() for path in pages.PAGES.glob("*.md")))
    assert sorted(shown) == sorted(path.stem for path in records.FOLDER.glob("*.csv"))


def test_every_figure_is_generated_or_listed_with_its_digest():
    blocks = [match[0] for path in pages.PAGES.glob("*.md") for match in pages.BLOCK.finditer(path.read_text())]
    made = {name for block in blocks for name in re.findall(r"!\[[^]]*\]\(([\w.-]+)\)", block)}
    listed = tomllib.loads((records.FOLDER / "figures.toml").read_text())
    assert {path.name for path in pages.PAGES.iterdir() if path.suffix != ".md"} == made | listed.keys()
    assert made.isdisjoint(listed)
    text = "".join(path.read_text() for path in ROOT.parent.glob("docs/**/*.md"))
    for name, told in listed.items():
        assert told["sha256"] == hashlib.sha256((pages.PAGES / name).read_bytes()).hexdigest(), name
        assert told.keys() == {"command", "of", "sha256"}
        assert f"{name})" in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "there is no record one.csv in records"),
        ("agent,score\nBC,1\n", "one.csv does not begin with the lines '# command: ...' and '# of: ...'"),
        ("# command: run\n# of: a day\nagent,score\nBC\n", "one.csv: row 1 has 1 cells, the header 2"),
        ("# command: run\n# of: a day\nagent,score\n", "one.csv is no table: it has no rows"),
        ("# command: run\n# of: a day\n", "one.csv is no table: "),
        ('# command: run\n# of: a day\nagent\n"BC" 1\n', "one.csv is no table: "),
    ],
)
def test_records_that_cannot_be_shown_are_refused(text, message, tmp_path, monkeypatch):
    monkeypatch.setattr(records, "FOLDER", tmp_path / "records")
    records.FOLDER.mkdir()
    if text is not None:
        (records.FOLDER / "one.csv").write_text(text)
    with pytest.raises(UserError, match=re.escape(message)):
        pages.made("<!-- record one -->\n<!-- end -->\n", {})


def test_a_record_is_shown_with_what_printed_it(tmp_path, monkeypatch):
    monkeypatch.setattr(records, "FOLDER", tmp_path)
    (tmp_path / "one.csv").write_text('# command: run it\n# of: a day\nagent,score,by seed\nBC,-1.5 ± 2,"1, 2"\nthe log,,\n')
    shown = """<!-- record one -->

`run it`

| agent | score | by seed |
|---|---:|---:|
| BC | -1.5 ± 2 | 1, 2 |
| the log |  |  |

- a day; kept in `evidence/records/one.csv`

<!-- end -->
"""
    assert pages.made("<!-- record one -->\n<!-- end -->\n", {}) == shown


def test_all_suites_are_in_the_queue_and_can_be_planned(monkeypatch):
    monkeypatch.chdir(ROOT.parent)
    suites = queue(ROOT / "queue.toml")
    assert {suite.name for suite in suites} == {path.stem for path in ROOT.glob("*.toml")} - {"queue", "claims"}
    assert plan_all(suites)
    assert plan_all(queue(ROOT / "queue.toml", full=True))
    store_of(suites, ROOT)  # one ledger


def test_every_suite_with_results_is_on_a_page(monkeypatch):
    monkeypatch.chdir(ROOT.parent)
    suites = queue(ROOT / "queue.toml")
    done = set(store_of(suites, ROOT).results()["cell"].to_pylist())
    found = {suite.name for suite in suites for job in plan(suite) if not done.isdisjoint(job.cells)}
    text = "".join(path.read_text() for path in pages.PAGES.glob("*.md"))
    shown = {name for match in re.finditer(pages.OPENING, text) for name in (match[2] or "").split()}
    assert sorted(f"{name}.toml" for name in found if f"{name}.toml" not in shown) == []


def test_claims_rest_on_suites_of_the_queue():
    names = {suite.name for suite in queue(ROOT / "queue.toml")}
    for claim in claims(ROOT / "claims.toml"):
        assert claim.tests or claim.note
        assert {path.stem for test in claim.tests for path in test.suites} <= names


def test_the_ledger_is_small():
    assert sum(path.stat().st_size for path in (ROOT / "ledger").rglob("*.json")) < MOST


@pytest.mark.slow  # the pages themselves are compared above
def test_a_changed_number_in_a_page_is_noticed(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(ROOT.parent)
    (tmp_path / "results").mkdir()
    text = (pages.PAGES / "claims.md").read_text()
    (tmp_path / "results" / "claims.md").write_text(text.replace("| C1 |", "| C1, which holds |"))
    monkeypatch.setattr(pages, "PAGES", tmp_path / "results")
    monkeypatch.setattr(pages, "HERE", ROOT)
    assert pages.main(["--check"]) == 1
    assert "claims.md is not what the ledger says: run python -m evidence.pages" in capsys.readouterr().out
    assert pages.main([]) == 0
    assert (tmp_path / "results" / "claims.md").read_text() == text


def test_a_claim_that_is_contradicted_says_so_before_all_scores_are_there():
    test = declared.Test(ROOT / "gym.toml", "BC", ("TD3",), ("hopper-medium-v2",))
    low, nothing = Interval(-5.0, -6.0, -4.0), Interval(nan, nan, nan)
    there, missing, undefined = (
        Comparison(test, "TD3", test.on, gain, gain, frozenset("abcdef"), *map(frozenset, lacks), 0.95)
        for gain, lacks in ((low, ("", "")), (nothing, ("ab", "")), (nothing, ("", "a")))
    )
    claim = Claim("C", "says", "place", (test,))
    assert pages._reads(Verdict(claim, (there, missing))) == "**contradicted**"
    assert pages._reads(Verdict(claim, (missing,))) == "open: 4 of 6 scores"
    assert pages._reads(Verdict(claim, (undefined,))) == "**open**: all scores are there, 1 of them not finite"


def test_every_log_of_the_agents_that_improve_has_a_mean_or_is_left_out_by_name():
    """A log without a mean is passed over in silence, and with it all that the suites find there."""
    used = {(on, suite.rows) for suite in queue(ROOT / "queue.toml") if suite.name in improved.SUITES for on in suite.on}
    assert {on for on, rows in used if (on, rows) not in improved.BEHAVIOUR} == improved.LEFT_OUT


def test_what_is_missing_of_bears_constraint_is_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = 'kind = "learn"', 'ledger = "ledger"', "seeds = 2", "steps = 100", "evaluations = 1", 'logs = ["hopper-medium-v2"]'
    methods = "[methods]", 'a = { agent = "bear" }', 'b = { agent = "bear", fields = { threshold = 0.2 } }'
    (tmp_path / "suite.toml").write_text("\n".join([*lines, *methods]))
    suite = read("suite.toml")
    store = store_of([suite], tmp_path)
    nothing = "No result yet.\nWithout a result yet: 4 of 4 cells, among them all of a; b."
    assert bear.constraint(suite, store).strip() == nothing
    [first] = [job for job in plan(suite) if job.method == "a"]
    keep(store, first, [30.0, 50.0], mmd=[0.1, 0.1], multiplier=[20.0, 20.0])
    text = bear.constraint(suite, store)
    assert "| a | 2 | 40.0 (30.0 to 50.0) | 0.100 (0.100 to 0.100) | 20 (20 to 20) |" in text
    assert "Without a result yet: 2 of 4 cells, among them all of b." in text


def test_a_curve_has_students_interval_over_seeds_and_one_seed_none():
    two = pages._curve("a", 9, [[(10, 1.0), (20, 3.0)], [(10, 2.0)]])  # the second diverged after 10 updates
    assert (two.slot, two.dashed) == (1, True)
    np.testing.assert_array_equal(two.x, [10, 20])
    np.testing.assert_allclose(two.y, [1.5, 2.5])
    half = 12.706 * 0.5  # t of one degree of freedom, and s / sqrt(n), which is the same at both steps
    np.testing.assert_allclose(two.low, [1.5 - half, 2.5 - half], atol=1e-3)
    np.testing.assert_allclose(two.high, [1.5 + half, 2.5 + half], atol=1e-3)
    one = pages._curve("a", 0, [[(10, 1.0)]])
    assert np.isnan([*one.low, *one.high]).all()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("gym.toml medium.toml", "medium has not the logs of gym with its seeds, steps, episodes and rows"),
        ("medium-again.toml gym-more.toml", "gym-more has not the logs of medium-again with"),
        ("medium.toml gym.toml", "gym has methods of the suites before it: BC, TD3"),
    ],
)
def test_suites_that_cannot_stand_beside_each_other_are_refused(names, message, monkeypatch):
    monkeypatch.chdir(ROOT.parent)
    with pytest.raises(UserError, match=re.escape(message)):
        pages.made(f"<!-- curves {names} -->\n<!-- end -->\n", {})


def test_a_ranking_is_of_the_methods_of_all_its_suites_on_the_logs_of_the_first(tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "HERE", tmp_path)
    head = 'kind = "learn"\nledger = "ledger"\nseeds = 2\nsteps = 100\nevaluations = 1\n'
    logs = 'logs = ["hopper-medium-v2"{}]\n[methods]\n'
    (tmp_path / "ranked-first.toml").write_text(head + logs.format("") + 'a = { agent = "bc" }\nb = { agent = "td3" }\n')
    more = head + logs.format(', "walker2d-medium-v2"') + 'c = { agent = "iql" }\n'
    (tmp_path / "ranked-second.toml").write_text(more)
    suites = [read(tmp_path / f"ranked-{name}.toml") for name in ("first", "second")]
    store = store_of(suites, tmp_path)
    for method, scores in {"a": [10.0, 20.0], "b": [5.0], "c": [30.0, 40.0]}.items():
        [job] = [job for job in plan_all(suites) if (job.method, job.on) == (method, "hopper-medium-v2")]
        keep(store, job, scores)
    text = pages.ranking("ranked-first.toml ranked-second.toml", files := {})
    assert text.splitlines()[2:4] == ["| c | 35.0 [30.0, 40.0] | 1.00 [1.00, 1.00] |", "| a | 15.0 [10.0, 20.0] |  |"]
    assert "left out: b." in text
    assert list(files) == ["ranked-first-profiles.svg"]


def test_a_block_that_does_not_end_is_refused():
    """Else what lies between it and the end of the next block would go."""
    page = "<!-- pending -->\n<!-- end -->\n<!-- table a.toml -->\n\ntext\n\n<!-- pending -->\n<!-- end -->\n"
    with pytest.raises(UserError, match="^<!-- table a.toml --> has no <!-- end --> before"):
        pages.made(page, {})
