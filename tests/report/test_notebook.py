"""What objects show of themselves in notebooks: whole HTML without scripts, names escaped, styles for the cell alone."""

import dataclasses
import html.parser
import re

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.mbo.baselines import BestOfData
from deadreckon.mbo.designer import Proposals
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.select import Choice
from deadreckon.report import notebook
from deadreckon.runs.compared import Compared, Outside, What
from deadreckon.runs.explain import Explained, Matters
from deadreckon.runs.explained_tree import Node
from deadreckon.runs.monitor import Finding, Monitored
from deadreckon.runs.offline import Judged

EVIL = "<img src=x onerror=alert(1)>"


class Checked(html.parser.HTMLParser):
    """Refuses what would run or be loaded, and elements that are not closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words = [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert tag not in ("script", "img", "link", "iframe", "button"), tag
        assert not [name for name, value in attrs if name.startswith("on") or "://" in (value or "")]
        if tag not in ("br", "hr", "meta", "input", "wbr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.words.append(data)


def words(thing):
    return " ".join(Checked(thing._repr_html_()).words)


def estimates(names=("a", LOGGED)):
    value = np.arange(len(names), dtype=float)
    return Estimates("fqe", names, value, value - 1, value + 1, Estimand(0.9), ess=value + 10, warnings=(f"{EVIL} again",))


def choice(deploy=True):
    return Choice("bear", deploy, 1.5, 0.5, 2.5, "its gain is above zero", ("dr: 1.2",), ("few episodes",))


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    frame = {"age": rng.uniform(18, 80, 60), EVIL: rng.normal(size=60), "offer": rng.choice(["mail", "none"], 60)}
    return dr.Dataset.from_frame(frame | {"paid": rng.normal(size=60)}, name=EVIL, action="offer", reward="paid")


def test_a_log_shows_its_columns_and_returns(log):
    told = words(log)
    assert "60" in told
    assert "age" in told
    assert EVIL in told  # as text
    assert log._repr_html_().count("<svg") == 1  # returns; all episodes have one step


def test_a_large_log_is_not_counted(log, monkeypatch):
    monkeypatch.setattr(notebook, "LARGE", 50)
    assert "deadreckon data info" in words(log)
    assert "<svg" not in log._repr_html_()


def test_a_run_shows_curves_and_failed_seeds(log, tmp_path):
    run = dr.agents.BC(hidden=(16, 16), batch_size=32).fit(log, steps=20, seeds=2, out=tmp_path / "r")
    shown = run._repr_html_()
    assert "BC" in words(run)
    assert "updates 20" in re.sub(r"\s+", " ", words(run))
    assert shown.count("<svg") >= 2
    broken = dr.load_run(run.path)
    (run.path / "run.json").unlink()
    assert broken._repr_html_() is None  # the text is shown


def test_estimates_and_choices_show_intervals():
    told = words(estimates())
    assert "fqe" in told
    assert "[−1" in told
    assert f"{EVIL} again" in told
    for deploy, stamp in ((True, "Deploy"), (False, "Do not deploy")):
        told = words(choice(deploy))
        assert stamp in told
        assert all(each in told for each in ("bear", "its gain is above zero", "few episodes", "dr: 1.2"))


def test_what_judge_gives_shows_the_card_of_the_page():
    found = choice()
    results = {
        "policies": [{"name": "bear", "run": "bear", "seed": 0, "file": None}], "truth": None, "log": EVIL,
        "estimand": {"words": "return", "greedy": True}, "support": {"missing": [0.1], "ratio": [1.0]},
        "judged": {"words": "held out", "episodes": 5, "of": 10, "fresh": True, "cluster": None},
        "looks": {"number": 1, "policies": 1, "counted": True},
        "results": [{"method": "fqe", "gain": [[1.5, 0.5, 2.5]], "value": [1.0, 0.0], "low": [0.0, 0.0], "high": [2.0, 0.0]}],
        "choice": vars(found) | {"gain": [1.5, 0.5, 2.5], "objections": [[]]},
    }  # fmt: skip
    told = words(Judged([estimates()], found, results))
    assert "DEPLOY" in told
    assert "held-out episodes" in told
    unjudged = results | {"results": [], "choice": results["choice"] | {"deploy": False, "gain": [None, None, None]}}
    assert "Do not deploy" in words(Judged([], found, unjudged))


def test_an_explanation_shows_its_tree_and_columns():
    tree = Node("age <= 50 years", 1.0, Node(EVIL, 0.25), Node("mail", 0.75))
    columns = (Matters("blood_pressure", 0.5, 0.4, 0.6),)
    told = words(Explained("bc seed 0", EVIL, True, 90, 1, 0.95, 0.9, 0.99, 0.6, True, tree, columns))
    assert all(each in told for each in ("age <= 50 years?", EVIL, "75% of rows", "takes the policy's action in 95.0%"))


def test_what_monitoring_found_is_shown_with_missing_cells_and_new_levels():
    what = What("observation", EVIL, "category", (0, 1), ("a", "b"))
    column = Compared(what, 0.25, np.nan, 0.5, 0.25, "a", (0.1, 0.3), (EVIL,), (40, 20))
    findings = (Finding("observation", EVIL, True, "drift"),)
    outside = Outside(0.5, ((EVIL, "a level that the log does not have", 3, True),))
    told = "compared: all rows", "", 0.05, (column,), outside, "not compared: x", findings
    found = Monitored("bc", "log", "new", 80, 40, *told)
    told = words(found)
    assert "Alarm: " in told
    assert f"1 finding: observation {EVIL}." in told
    assert "found after 40 new episodes, in the last 20 of them" in told
    assert "10.0\N{NO-BREAK SPACE}% \N{RIGHTWARDS ARROW} 30.0" in told
    assert repr(EVIL) in told


def test_proposals_show_the_best_first():
    made = Proposals("coms", np.arange(8.0).reshape(4, 2), np.array([1.0, 4.0, 2.0, 3.0]), np.zeros(4), 0)
    rows = re.findall(r'<th scope="row">(\d)</th>', made._repr_html_())
    assert rows == ["1", "3", "2", "0"]
    nothing = Proposals("coms", np.zeros((1, 2)), np.full(1, np.nan), np.full(1, np.nan), 0)
    assert "<svg" not in nothing._repr_html_()


def test_proposals_for_a_target_to_be_made_small_have_its_sign():
    """The model's scores are turned around, as those of the data are."""
    rng = np.random.default_rng(0)
    table = {"heat": rng.uniform(size=30), "cost": rng.uniform(10.0, 14.0, 30)}
    data = dr.Designs.from_frame(table, target="cost", minimise=True)
    made = BestOfData().propose(data, n=3)
    told = made._repr_html_()
    assert made.predicted.max() < 0.0
    shown = [float(value) for value in re.findall(r"</th><td><b>([^<]*)</b>", told)]
    assert shown == sorted(round(cost, 1) for cost in table["cost"])[:3]
    assert "those with the lowest measured scores first" in told
    assert "predict" not in told
    assert "those with the lowest predictions first" in dataclasses.replace(made, measured=False)._repr_html_()
    assert not re.search(">[-\N{MINUS SIGN}][0-9]", told)  # in table and histogram


def test_designs_show_the_best_first_in_their_own_names():
    cost = [3.0, 1.0, 2.0, 5.0, 4.0, 9.0, 8.0, 7.0, 6.0, 10.0]
    table = {"heat": np.arange(10.0), "metal": ["iron", EVIL] * 5, "cost": cost}
    data = dr.Designs.from_frame(table, target="cost", minimise=True)
    shown = re.findall(r'<th scope="row">(\d)</th>', data._repr_html_())
    assert [int(row) for row in shown] == np.argsort(cost).tolist()
    assert EVIL in words(data)
    table = {"heat": np.arange(12.0), "metal": ["iron", EVIL] * 6, "cost": [None, None, *cost]}
    planned = dr.Designs.from_frame(table, target="cost")
    shown = re.findall(r'<th scope="row">(\d+)</th>', planned._repr_html_())
    assert [int(row) - 2 for row in shown] == np.argsort(cost)[::-1].tolist()  # rows of the table, also without a score
    assert repr(data) == f"Designs({data.name}: 10 designs, 2 variables, least cost sought)"


def test_the_style_stays_inside_of_the_cell(log):
    style = re.search(r"<style>(.*?)</style>", log._repr_html_(), re.S)[1]
    assert style.startswith(".deadreckon {")
    assert style.count("{") == style.count("}")
    assert ":root" not in style
    assert not re.search(r"(?m)^\s*(html|body)\b", style)
    depth = 0
    for character in style.rstrip()[:-1]:  # the outermost block ends at the end
        depth += {"{": 1, "}": -1}.get(character, 0)
        assert depth > 0 or character not in "}", "a rule stands outside"
