"""One verdict on a page, and charts that one wide interval does not flatten."""

import dataclasses
import json
import re

import numpy as np
import pytest
from run_folders import OBJECTION, told, write_run

from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.report import charts, forest, headline, write
from deadreckon.report.entries import read
from deadreckon.report.page import render
from deadreckon.report.parts import coloured
from deadreckon.runs.decision_record import saved_at
from deadreckon.stats.interval import Interval

GAINS = {"good seed 0": (12.0, 6.0, 18.0), "wild seed 0": (30.0, 9.0, 51.0), "bc seed 0": (1.0, -4.0, 6.0)}


def shown(text):
    """What a reader sees."""
    return " ".join(re.sub(r"<[^>]*>", " ", re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.S)).split())


def page_of(runs, estimates):
    return render(dataclasses.replace(read(runs), estimates=estimates))


@pytest.mark.parametrize("deploy", [True, False])
def test_a_page_has_one_verdict_that_of_the_log_alone(runs, deploy):
    """In the simulator another policy is best; that is told beneath, and no second stamp."""
    text = page_of(runs, told(GAINS, deploy))
    stamps = re.findall(r'class="stamp (yes|no)">([^<]*)<', text)
    assert stamps == [("yes", "DEPLOY") if deploy else ("no", "DO NOT DEPLOY")]
    assert re.findall(r'<section id="(\w+)"', text)[:3] == ["decision", "estimates", "simulator"]
    seen = shown(text)
    assert seen.count("DEPLOY") == 1
    for said in (
        "good seed 0", "133", "of 667", "sampled actions", "98.8 % for all policies at once",
        "look 2 at these episodes or some of them, 7 policies so far", "4.0 % of its actions have no support",
        "ranks it first, too", "Objections to other policies (1 of 2)", OBJECTION, "Checked afterwards in the simulator",
        "Checked in the simulator", "Best in the simulator",
    ):  # fmt: skip
        assert said in seen, said
    lead = re.search(r'class="lead">([^<]*)<', text)[1]
    assert lead.startswith("Deploy good seed 0: +12.00" if deploy else "Do not deploy: +12.00")
    for word in ("promised", "delivered", "lanes", "best guess", "draws", "log's own policy"):
        assert word not in seen


def test_a_log_of_ones_own_is_decided_and_nothing_says_that_it_was_not(tmp_path):
    runs = [write_run(tmp_path / agent, agent, task=None) for agent in ("bc", "good")]
    text = page_of(runs, told({"good seed 0": (12.0, 6.0, 18.0)}, checked=False))
    seen = shown(text)
    assert "not judged" not in seen.lower()
    assert "Not checked in a simulator (--task names one)" in seen
    assert 'id="simulator"' not in text
    assert "estimate against true value" not in seen


def test_the_terminal_says_what_the_page_says(runs, tmp_path):
    write_json(tmp_path / "estimates.json", told(GAINS, deploy=False))
    assert headline(runs, tmp_path).startswith("Do not deploy: +12.00")
    assert headline(runs, tmp_path) in write(runs, tmp_path / "page.html", estimates=tmp_path).read_text()


def test_policies_with_objections_are_hollow_in_the_gains(runs):
    text = page_of(runs, told(GAINS))
    drawn = text.split("Estimated gain over the behaviour policy (DRL")[1].split("</svg>")[0]
    rows = re.findall(r'<g class="([^"]*)"><title>([^:]*):', drawn)
    assert [(name, "hollow" in kind) for kind, name in rows] == [
        ("good seed 0", False), ("bc seed 0", False), ("wild seed 0", True),
    ]  # fmt: skip


def test_an_interval_without_ends_says_so(runs):
    """Also where JSON, which has no infinity of its own, has been in between."""
    gains = GAINS | {"wild seed 0": (30.0, -np.inf, np.inf)}
    for estimates in (told(gains), json.loads(json.dumps(told(gains)))):
        text = page_of(runs, estimates)
        assert "[\N{MINUS SIGN}\N{INFINITY}, \N{INFINITY}]" in shown(text)
        assert "nan" not in shown(text).lower().split()


def whiskers(svg):
    """Left and right end of each whisker, and where arrows are."""
    ends = re.findall(r'x1="([\d.]+)" x2="([\d.]+)" y1="[\d.]+" y2="[\d.]+" class="whisker"', svg)
    arrows = re.findall(r'translate\(([\d.]+) [\d.]+\) rotate\((-?\d+)\)" class="arrow"', svg)
    return [(float(a), float(b)) for a, b in ends], [(float(x), int(turn)) for x, turn in arrows]


def test_one_wide_interval_does_not_flatten_the_others():
    sure = [forest.Mark(f"m{i}", i, Interval(i, i - 2.0, i + 2.0), (i - 1.0, i + 1.0)) for i in range(5)]
    wide = forest.Mark("two seeds", 5, Interval(3.0, -314.0, 341.0))
    ends, arrows = whiskers(forest.forest([*sure, wide], "score"))
    lengths = [right - left for left, right in ends]
    assert min(lengths[:5]) > 60  # of the 322 there are; 2 if nothing were cut
    assert len(arrows) == 2
    assert [turn for _, turn in arrows] == [180, 0]
    assert arrows[0][0] == ends[5][0]
    assert arrows[1][0] == ends[5][1]
    assert forest.forest(sure, "score").count('class="seed"') == 10
    # Where all are as wide, none is cut; what is endless always is.
    alike = [forest.Mark(f"m{i}", i, Interval(i, i - 300.0, i + 300.0)) for i in range(5)]
    assert whiskers(forest.forest(alike, "score"))[1] == []
    endless = forest.Mark("nothing known", 5, Interval(3.0, -np.inf, np.inf))
    assert len(whiskers(forest.forest([*sure, endless], "score"))[1]) == 2


def test_whiskers_of_the_scatter_are_cut_with_an_arrow():
    points = [(f"p{i}", i, float(i), 0.1, float(i), i - 1.0, i + 1.0) for i in range(5)]
    assert "arrow" not in charts.scatter(points, "true value", "estimate")
    drawn = charts.scatter([*points, ("wild", 5, 2.0, 0.1, 3.0, -900.0, 900.0)], "true value", "estimate")
    assert drawn.count('class="arrow"') == 2
    assert 'class="reference"' in drawn


def test_estimates_of_other_runs_are_refused(runs, tmp_path):
    """A verdict on what is not on the page would be taken for one on what is."""
    estimates = told({"other seed 0": (12.0, 6.0, 18.0)}, True)
    write_json(tmp_path / "ope" / "estimates.json", estimates)
    with pytest.raises(UserError, match="decides on other, which is not among these runs; name its folder too"):
        write(runs, tmp_path / "page.html", estimates=tmp_path / "ope")
    with pytest.raises(UserError, match="decides on other, which is not among these runs; name its folder too"):
        headline(runs, tmp_path / "ope")


def test_runs_of_one_name_are_told_apart_by_their_files(tmp_path):
    """Estimates of another month's run would be a verdict on this one, and both would have one colour."""
    for month in ("jan", "feb"):
        write_run(tmp_path / month / "good", "bc", seed=ord(month[0]))
        (tmp_path / month / "good" / "policy.npz").touch()
    estimates = told({"good seed 0": (12.0, 6.0, 18.0), "good seed 1": (1.0, -4.0, 6.0)})
    for each, month in zip(estimates["policies"], ("jan", "feb")):
        each["file"] = str(tmp_path / month / "good" / "policy.npz")
    write_json(tmp_path / "ope" / "estimates.json", estimates)
    with pytest.raises(UserError, match=r"decides on good \(.*jan.*\), which is not among these runs"):
        write([tmp_path / "feb" / "good"], tmp_path / "page.html", estimates=tmp_path / "ope")
    write([tmp_path / "jan" / "good"], tmp_path / "page.html", estimates=tmp_path / "ope")
    page = read([tmp_path / "feb" / "good", tmp_path / "jan" / "good"])
    assert [slot for _, slot in coloured(page, estimates)] == [page.slot(page.entries[1]), page.slot(page.entries[0])]


def test_a_policy_that_was_trained_further_is_not_deployed_by_what_was_judged(tmp_path):
    """The page shows the scores of what is there now, for which the decision was not made."""
    runs = [write_run(tmp_path / name, "bc", task=None) for name in ("good", "other")]
    estimates = told({"good seed 0": (12.0, 6.0, 18.0), "other seed 0": (1.0, -4.0, 6.0)}, checked=False)
    for each, run in zip(estimates["policies"], runs):
        (run / "policy.npz").write_bytes(b"PK judged")
        each |= saved_at(run / "policy.npz", tmp_path / "ope")
    write_json(tmp_path / "ope" / "estimates.json", estimates)
    page = lambda: shown(write(runs, tmp_path / "page.html", estimates=tmp_path / "ope").read_text())  # noqa: E731
    assert "DEPLOY" in page()
    assert "has changed since" not in page()
    assert headline(runs, tmp_path / "ope").startswith("Deploy good seed 0: ")
    (runs[1] / "policy.npz").write_bytes(b"PK more updates")
    assert "DEPLOY good seed 0" in page()
    assert "other seed 0 has changed since its evaluation: its estimates are of the earlier policy" in page()
    (runs[0] / "policy.npz").write_bytes(b"PK more updates")
    assert "DEPLOY" not in page()
    assert "From the log alone" not in page()
    assert page().count("The policy good seed 0 has changed since its evaluation, so the decision on it is not shown;") == 1
    assert headline(runs, tmp_path / "ope").startswith("The policy good seed 0 has changed since its evaluation")


def test_a_standard_error_is_called_one_where_intervals_are_near(runs):
    seen = shown(page_of(runs, told(GAINS)))
    assert "63.0 standard error 1.00" in seen
    assert "in the charts with 95 % intervals" in seen
    assert "\N{PLUS-MINUS SIGN}" not in seen.split("From the log alone")[2].split("Checked in the simulator")[0]


def test_a_cross_fit_shows_the_runs_of_its_folds(tmp_path):
    for fold in range(2):
        write_run(tmp_path / "cf" / f"fold{fold}", "bc", 10.0 * fold)
    write_json(tmp_path / "cf" / "crossfit.json", {})
    assert [folder.path.name for e in read(tmp_path / "cf").entries for folder, _ in e.folders] == ["fold0", "fold1"]
