"""The page of proposals: what it says of a table with an effect and of pure noise, and that it fits a phone."""

import dataclasses
import html
import re

import numpy as np
import pytest
from test_browser import PHONE

from deadreckon.cli.design import _told
from deadreckon.cli.design_front import told
from deadreckon.mbo import designer
from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import allowed, best_permitted, permitted
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.front import Front, targets_of
from deadreckon.mbo.nn_distance import neighbours, nn_distance
from deadreckon.mbo.proposal_table import about, about_front
from deadreckon.mbo.validation import judged
from deadreckon.report.axes import Axis
from deadreckon.report.design import write_design
from deadreckon.report.design_asked import broken_rule
from deadreckon.report.design_doubts import TOGETHER, _of_correlation
from deadreckon.report.design_edges import at_ends, at_rules, shown_value
from deadreckon.report.design_front import write_front
from deadreckon.report.effects import _ticks_of_log
from deadreckon.report.text import number

SOLVENTS = ["water", "<oil & co>", "acetonitrile"]


def table(kind, rows=40, seed=0):
    """A mixture, a temperature, a rate on a log scale and a solvent; the score is of these or noise."""
    rng = np.random.default_rng(seed)
    part = rng.dirichlet([2, 2, 2], rows).round(2)
    part[:, 2] = (1 - part[:, 0] - part[:, 1]).round(2)
    frame = {
        "A": part[:, 0],
        "B": part[:, 1],
        "C": part[:, 2],
        "temp": rng.uniform(20, 90, rows).round(),
        "idle": rng.normal(size=rows),
    }
    frame |= {"rate": 10 ** rng.uniform(-2, 1, rows), "solvent": [SOLVENTS[i % 3] for i in range(rows)]}
    noise = rng.normal(size=rows)
    if kind == "noise":
        return Designs.from_frame(frame | {"cost": noise}, "cost")
    score = (frame["temp"] - 60) ** 2 / 100 + 10 * (frame["A"] - 0.5) ** 2 + np.arange(rows) % 3 + 0.1 * noise
    rules = {"mixtures": [["A", "B", "C"]], "logs": ["rate"], "bounds": {"temp": (20, 120)}, "fixed": ["rate = 1"]}
    rules |= {"forbidden": ["solvent = acetonitrile & temp > 10"]}
    return Designs.from_frame(frame | {"cost": score}, "cost", minimise=True, **rules)


def page(data, made, tmp_path):
    text = write_design(data, made, nn_distance(data, made.x), tmp_path / "page.html").read_text()
    return text, re.sub(r"\s+", " ", html.unescape(re.sub(r"<(style|script).*?</\1>|<[^>]+>", "", text, flags=re.S)))


@pytest.fixture(scope="module")
def skilled():
    data = table("signal")
    return data, designer("gp", rounds=4).propose(data, 6)


def test_a_page_says_what_to_try_and_what_is_not_known(skilled, tmp_path):
    data, made = skilled
    text, said = page(data, made, tmp_path)
    upper = data.shown(made.predicted) + 1.959964 * made.predicted_std
    assert f"Proposal {int(upper.argmin())}" in said
    assert "the upper end of its 95 % interval" in said
    assert "is the lowest" in said
    row = int(data.y.argmax())
    assert f"row {row}" in said
    for part in (
        "What the model does not know", "rank correlation of 1.00 (1 is", "Half of its predictions of unseen rows",
        "This is what the fitted model says, not what is true", "make room for one another", "idle",
        "cannot be distinguished from zero", "Around proposal", "Dashed or hollow", "Nearest rows",
    ):  # fmt: skip
        assert part in said, part
    assert "cannot be distinguished from chance" not in said
    assert "<oil" not in text  # levels are escaped
    assert text.count("<figure>") == 2 + 7 + 6  # of the fixed rate there is an average and no cut


def test_errors_are_of_rows_that_no_calibration_has_seen(skilled, tmp_path):
    data, made = skilled
    y = np.random.default_rng(0).normal(size=24)
    quality = judged(y, y + np.random.default_rng(1).normal(size=24), np.ones(24), np.arange(24) % 3, "m")
    held = quality.fold == 1
    others = judged(y[~held], quality.predicted[~held], quality.std[~held], quality.fold[~held], "m")
    assert quality.skilled
    assert others.skilled
    np.testing.assert_allclose(quality.crosswise[0][held], others.calibration(quality.predicted[held], quality.std[held])[0])
    error, seen = (np.median(np.abs(y - each[0])) for each in (quality.crosswise, quality.corrected))
    assert f"miss by more than {number(error)};" in page(data, dataclasses.replace(made, quality=quality), tmp_path)[1]
    assert number(seen) != number(error)


def test_proposals_that_are_nearly_the_same_are_told(skilled, tmp_path):
    data, made = skilled
    x = made.x[[0] * 6]
    x[:, 4] += np.float32(0.001) * np.arange(6, dtype=np.float32)
    y = np.random.default_rng(0).normal(size=24)
    for predicted, cost in ((y, ", at some cost in predictions."), (-y, ".")):  # where the order is chance, nothing is lost
        quality = judged(y, predicted, np.ones(24), np.arange(24) % 3, "m")
        said = page(data, dataclasses.replace(made, x=x, quality=quality), tmp_path)[1]
        assert f"a least distance between them (--apart 1) spreads them{cost}" in said


def test_of_noise_nothing_is_praised(tmp_path):
    data = table("noise")
    made = designer("gp", rounds=2).propose(data, 6)
    assert not made.quality.skilled
    _, said = page(data, made, tmp_path)
    assert "The model's order of unseen designs cannot be distinguished from chance" in said
    assert "None of the proposals is preferred" in said
    assert "the effects of variables cannot be distinguished from zero either" in said
    assert said.count("changes the average by") == said.count("; not distinguishable from no effect") == len(data.variables)
    assert "The best predicted score" not in said
    assert not re.search(r"Proposal \d|Around proposal|is the highest\b", said)


def test_of_a_model_that_was_not_tested_neither_effects_nor_intervals_are_known(tmp_path):
    """Of ten rows the process is not tested: of noise it told effects from none, and gave an interval for the one to try."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (10, 2)).round(3)
    data = Designs.from_frame({"a": x[:, 0], "b": x[:, 1], "y": 4 * x[:, 0] + 0.01 * rng.normal(size=10)}, "y")
    made = designer("gp", rounds=2).propose(data, 4)
    assert made.quality is None
    _, said = page(data, made, tmp_path)
    one = said[said.index("Proposal ") : said.index("Rule: ")]
    assert f"Proposal {made.predicted.argmax()}" in one
    assert "it has the highest prediction, which was not tested on unseen rows and may be worthless" in one
    assert "interval" not in one
    assert "Whether effects of variables differ from none is not known either, because predictions were not tested" in said
    assert "its predictions may be worthless. It is not known whether effects differ from none." in said
    for unfounded in ("distinguish", "interval of this average", "\N{PLUS-MINUS SIGN}"):
        assert unfounded not in said
    assert "interval, by the model, not calibrated. A flat curve" in said
    lines = about(data, made)
    assert lines["value"][lines["what"].index("predicted_low, predicted_high")].endswith("by the model, not calibrated")
    tested = dataclasses.replace(made, quality=skill(True, 10))
    assert "not calibrated" not in "".join(map(str, about(data, tested)["value"]))


def test_without_a_model_there_is_no_choice_and_no_effect(tmp_path):
    data = table("noise")
    made = designer("random").propose(data, 4)
    _, said = page(data, made, tmp_path)
    assert "Random has no model of cost, so no proposal can be preferred" in said
    assert "was not measured" in said
    assert "What each variable does" not in said


def test_an_order_and_predictions_without_deviation_are_told_as_such(tmp_path):
    data = table("noise")
    nan, x = np.full(3, np.nan), data.x[:3] + np.float32(0.0)
    order = Fitted(lambda x: (x[:, 3], None), is_order=True)
    _, said = page(data, Proposals("RaM", x, nan, nan, 0, fitted=order), tmp_path)
    assert "learns an order and predicts no scores" in said
    assert "Vertical axis: the order by the model" in said
    assert "Whether effects of variables differ from none is not known" in said
    value = Fitted(lambda x: (x[:, 3], None))
    _, said = page(data, Proposals("COMs", x, x[:, 3].astype(float), nan, 0, fitted=value), tmp_path)
    assert "it has the highest prediction; COMs gives no standard deviation" in said
    assert "is above the best score of the data" in said


def test_what_lies_at_an_end_far_away_or_together_is_told(tmp_path):
    rng = np.random.default_rng(0)
    a = rng.uniform(0, 1, 30)
    frame = {"a": a, "b": 3 * a + 0.01 * rng.normal(size=30), "c": rng.uniform(0, 1, 30), "y": a}
    data = Designs.from_frame(frame, "y", bounds={"c": (0, 9)})
    high = float(data.variables[1].high)
    x = np.array([[0.5, high, 9.0], [0.5, high, 0.5], [0.4, high, 0.5]], np.float32)
    made = Proposals("m", x, np.array([1.0, 2.0, 3.0]), np.ones(3), 0, fitted=Fitted(lambda x: (x[:, 1], None)))
    _, said = page(data, made, tmp_path)
    assert "2 of 3 proposals (67%) lie more than 3 typical distances" in said
    assert re.search(r"Of 3 proposals, in 3 b is at its upper end \([\d.]+\) of what is allowed", said)
    assert "1 of 3 proposals have a value beyond the data" in said
    assert "a and b (correlation 1.00)" in said


def test_the_page_says_what_was_asked_and_which_rules_bind(tmp_path):
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 1, (2, 24)).round(3)
    a[:3], b[:3] = 0.9, 0.8  # replicates of one design, the best, which breaks a rule
    frame = {"a": a, "b": b, "temp": 40 + 10 * (np.arange(24) % 4), "kind": ["x", "y"] * 12, "y": a + b}
    frame["kind"][:3] = ["x"] * 3
    frame["temp"][:3], frame["temp"][4] = 50, 36  # whose next multiple of 10 is 40
    frame["y"][:3] += [0.1, 0.0, -0.1]
    rules = {"constraints": ["a + b <= 1.2"], "forbidden": ["kind = x & temp > 60"], "fixed": ["kind = x"], "apart": 0.5}
    with pytest.warns(UserWarning, match="3 rows are replicates of 1 design and are pooled"):
        data = Designs.from_frame(frame, "y", steps={"temp": 10}, **rules)
    x = np.array([[0.5, 0.7, 60, 0], [0.6, 0.6, 60, 0], [0.2, 0.3, 50, 0]], np.float32)
    _, said = page(data, Proposals("m", x, np.ones(3), np.ones(3), 0, fitted=Fitted(lambda x: (x[:, 0], None))), tmp_path)
    for part in (
        "3 proposals: y is to be made large.", "Always: a + b <= 1.2.", "Never: kind = x & temp > 60.", "fixed: x",
        "At least 0.5 typical distances from each other.", "40 to 70, in steps of 10",
        "Training data: 24 rows, 22 different designs",
        "3 rows are replicates of 1 design and are pooled; the standard deviation of y between replicates is 0.1.",
        "The best of the data, row 0 (mean of 3), breaks a rule that proposals satisfy: always a + b <= 1.2.",
        "row 0 (mean of 3), breaks a rule",
        'Of 3 proposals, 2 stand at the edge of the rule "always a + b <= 1.2" and 2 stand at the edge of the rule '
        '"never kind = x & temp > 60": better values may lie beyond.',
    ):  # fmt: skip
        assert part in said, part


def test_scores_that_were_measured_are_not_called_predictions(tmp_path):
    data = table("noise")
    made = designer("best").propose(data, 3)
    _, said = page(data, made, tmp_path)
    score = f"{float(data.shown(made.predicted.max())):.4g}"
    assert _told(data, made)[1].startswith(f"BestOfData: 3 proposals, best measured cost {score} (")
    lines = dict(zip(*about(data, made).values()))
    assert lines["predicted"] == "the measured score"
    assert not any("predicted_" in line for line in lines)
    assert f"The best measured score of the proposals is {number(float(score))}." in said
    assert "BestOfData predicts no scores." in said
    assert "best predicted" not in said
    assert "Below a prediction" not in said
    random = designer("random").propose(data, 3)
    assert _told(data, random)[1].startswith("Random: 3 proposals (")
    assert dict(zip(*about(data, random).values()))["predicted"] == "empty: the method has no model of the score"
    assert "The best predicted score" not in page(data, random, tmp_path)[1]


def test_a_score_for_which_designs_are_made_is_not_called_measured(tmp_path):
    """That of a diffusion model is neither measured nor predicted by a model."""
    data = table("noise")
    asked = np.full(3, data.y.max())
    made = dataclasses.replace(designer("random").propose(data, 3), method="DDOM", predicted=asked, requested=True)
    assert _told(data, made)[1].startswith("DDOM: 3 proposals, best requested cost ")
    assert dict(zip(*about(data, made).values()))["predicted"].startswith("the score for which the method makes its designs")
    text, said = page(data, made, tmp_path)
    assert "measured score" not in said
    assert "DDOM predicts no scores." not in said
    assert "The best requested score is" in said
    assert "predict" not in said.replace("no model that predicts scores", "").replace("no model predicts which", "")
    assert ">Requested scores and distances to the data<" in text
    assert 'aria-label="cost, requested against typical distances to the data"' in text
    assert "no model predicts which score they have. A typical distance is" in said
    assert "Whiskers" not in said


def test_a_gain_is_one_over_predictions_for_measured_designs_and_not_over_a_lucky_measurement(tmp_path):
    a = np.arange(20) / 20
    frame = {"a": a, "b": np.arange(20) % 7, "y": np.where(np.arange(20) == 3, 5.0, a)}
    x = np.array([[0.97, 3.0], [0.4, 3.0]], np.float32)
    for sign, above in ((1.0, "above"), (-1.0, "below")):
        data = Designs.from_frame(frame | {"y": sign * frame["y"]}, "y", minimise=sign < 0)
        made = Proposals("m", x, np.array([1.0, 0.5]), np.array([0.1, 0.1]), 0, fitted=Fitted(lambda x: (x[:, 0], None)))
        made = dataclasses.replace(made, minimise=sign < 0)
        _, said = page(data, made, tmp_path)
        shown = "0.950" if sign > 0 else "\N{MINUS SIGN}0.950"
        assert f"The prediction is 0.050 {above} the best one for a measured design (row 19, {shown})." in said
        assert f"It is not {above} the best score of the data" in said
        assert f"the best prediction for a measured design is {shown}" in said
        assert _told(data, made)[1].endswith(f"best predicted y {sign:g} (for a measured design {0.95 * sign:g}) (0 s)")
        less = dataclasses.replace(made, predicted=np.array([0.9, 0.5]))
        _, said = page(data, less, tmp_path)
        assert f"not {above} that for row 19, {shown}, so no gain over the measured designs is predicted." in said


def test_a_gain_is_one_over_rows_that_satisfy_the_rules(tmp_path):
    a = np.arange(20) / 20
    data = Designs.from_frame({"a": a, "b": np.arange(20) % 7, "y": a}, "y", constraints=["a <= 0.5"], fixed=["b = 3"])
    x = np.array([[0.5, 3.0], [0.4, 3.0]], np.float32)
    fitted = Fitted(lambda x: (x[:, 0], None))
    made = Proposals("m", x, np.array([0.6, 0.55]), np.array([0.1, 0.1]), 0, quality=skill(True, 20), fitted=fitted)
    _, said = page(data, made, tmp_path)
    assert "The best of the data has y 0.950, within the rules 0.500." in said  # row 10, where b is 3
    assert "above the best score of rows that satisfy the rules, 0.500, but the interval reaches below it" in said
    assert re.search(r"best within the rules\s*0.500\s*row 10", said)
    assert _told(data, made)[0] == "frame: 20 designs, 2 variables (a, b); best y 0.95, within the rules 0.5"
    nothing = Designs.from_frame({"a": a, "b": np.arange(20) % 7, "y": a}, "y", fixed=["a = 0.5", "b = 2"])
    assert permitted(nothing).all()  # where no row satisfies them, all are what is known


def test_a_mixture_of_rounded_parts_is_one():
    """Two decimals of thirds sum to 0.99: it is the best of the mixtures, and no row that breaks their rule."""
    rng = np.random.default_rng(0)
    parts = rng.dirichlet(np.ones(3), 20).round(2)
    parts[:3] = (0.33, 0.33, 0.33), (0.5, 0.2, 0.25), (0.2, 0.3, 0.5)
    y = np.r_[10.0, 11.0, 9.0, rng.uniform(0, 8, 17)]
    data = Designs.from_frame({**dict(zip("abc", parts.T)), "y": y}, "y", mixtures=[["a", "b", "c"]])
    assert best_permitted(data) == 0
    assert broken_rule(data, 0) is None
    assert broken_rule(data, 1) == "always a + b + c = 1"  # the sum is 0.95
    assert not permitted(data)[1]
    assert not allowed(data, data.x[:1])[0]  # proposals are exact


def test_rules_that_do_not_bind_are_not_told():
    frame = {"a": np.linspace(0, 1, 12), "n": np.arange(12), "kind": ["x", "y"] * 6, "y": np.arange(12.0)}
    rules = {"constraints": ["a + n <= 9"], "forbidden": ["kind = x & n >= 5"]}
    data = Designs.from_frame(frame, "y", **rules)
    rows = lambda *each: np.array(each, np.float32)  # noqa: E731
    assert at_rules(data, rows([0.5, 8, 0])) == []
    assert at_rules(data, rows([0.5, 4, 1])) == []  # the other kind is not kept out
    assert at_rules(data, rows([0.5, 4, 0])) == ['1 stand at the edge of the rule "never kind = x & n >= 5"']
    assert at_rules(data, rows([1, 8, 1])) == ['1 stand at the edge of the rule "always a + n <= 9"']
    assert broken_rule(data, 8) == "never kind = x & n >= 5"
    assert broken_rule(data, 4) is None


def test_the_edge_of_a_rule_is_where_no_step_of_what_is_free_fits():
    rng = np.random.default_rng(0)
    frame = {"a": rng.uniform(size=20), "t": 5.0 * (np.arange(20) % 9), "dose": [10, 20, 50, 100] * 5, "y": rng.normal(size=20)}
    said = {"kinds": {"dose": "ordinal"}, "steps": {"t": 5}}
    read = lambda rule, **more: Designs.from_frame(frame, "y", constraints=[rule], **said, **more)  # noqa: E731
    rows = lambda *each: np.array(each, np.float32)  # noqa: E731
    data = read("a + t <= 32", fixed=["a = 0.3"])
    assert at_rules(data, rows([0.3, 30, 0])) == ['1 stand at the edge of the rule "always a + t <= 32"']
    assert at_rules(data, rows([0.3, 25, 0])) == []
    assert at_rules(read("a + t <= 32"), rows([0.3, 30, 0])) == []  # a may still grow
    data = read("t + dose <= 90", fixed=["t = 5"])
    assert at_rules(data, rows([0, 5, 2])) == ['1 stand at the edge of the rule "always t + dose <= 90"']  # 100 is next
    assert at_rules(data, rows([0, 5, 1])) == []
    assert at_rules(read("t + dose <= 900", fixed=["t = 5"]), rows([0, 5, 3])) == []  # it is held by the greatest dose
    assert at_rules(read("dose - a >= 15", fixed=["a = 0"], bounds={"a": (0, 1)}), rows([0, 5, 1])) != []  # 10 would be too low


def test_ends_on_a_log_scale_are_told_by_its_decades(tmp_path):
    rng = np.random.default_rng(0)
    rate = np.r_[1e-6, 1.0, 10 ** rng.uniform(-6, 0, 28)]
    frame = {"rate": rate, "b": rng.uniform(size=30), "y": rng.normal(size=30)}
    data = Designs.from_frame(frame, "y", logs=["rate"], bounds={"rate": (1e-9, 1)}, forbidden=["rate < 0.0001 & b > 0.5"])
    rows = lambda *rates: np.array([[each, 0.7] for each in rates], np.float32)  # noqa: E731
    assert at_ends(data, rows(2e-9, 8e-6, 1e-5), set()) == []
    assert at_ends(data, rows(1e-9, 1e-9, 1e-2), set()) == ["in 2 rate is at its lower end (1e\N{MINUS SIGN}9)"]
    assert at_ends(data, rows(1, 0.5, 1), set()) == ["in 2 rate is at its upper end (1)"]
    assert at_rules(data, rows(5e-4, 3e-4)) == []
    assert at_rules(data, rows(1e-4, 1.0001e-4)) == ['2 stand at the edge of the rule "never rate < 0.0001 & b > 0.5"']
    made = Proposals("m", rows(1e-8, 3e-6), np.ones(2), np.ones(2), 0)
    assert "1 of 2 proposals have a value beyond the data" in page(data, made, tmp_path)[1]


def test_settings_are_shown_as_they_are_set(tmp_path):
    """A score has three or four figures; what is typed into a machine has all of its own."""
    rng = np.random.default_rng(0)
    frame = {"flow": np.r_[152300.0, 250750.0, rng.uniform(1.6e5, 2.5e5, 18).round(-1)], "n": 123450 + np.arange(20) ** 2}
    frame |= {"temp": np.r_[72.25, rng.uniform(20, 90, 19).round(2)], "kind": ["x", "y"] * 10, "y": rng.normal(size=20)}
    data = Designs.from_frame(frame, "y", steps={"temp": 0.25})
    fitted = Fitted(lambda x: (x[:, 2], np.ones(len(x))))
    made = Proposals("m", data.x[:1].repeat(3, 0), np.full(3, 152311.0), np.ones(3), 0, fitted=fitted)
    text, said = page(data, made, tmp_path)
    for name, value in (("flow", "152300"), ("n", "123450"), ("temp", "72.25"), ("kind", "x")):
        assert re.search(rf"<dt>{name}</dt><dd>{value}</dd>", text)
        assert f"<td>{value}</td>" in text
        assert f"here {value}" in text
    assert "152300 to 250750" in said
    assert "at its lower end (152300)" in said
    assert "1.52e5" in said  # the prediction
    assert [shown_value(each) for each in (1.5e-6, 16777217, -3, True, "a-b", 2.5e10)] == [
        "1.5e\N{MINUS SIGN}6", "16777217", "\N{MINUS SIGN}3", "True", "a-b", "2.5e10",
    ]  # fmt: skip


def skill(skilled, rows):
    """What was found of a model out of fold."""
    observed = np.arange(float(rows))
    predicted = observed if skilled else np.tile([0.0, 1.0], rows // 2)
    return judged(observed, predicted, np.ones(rows), np.arange(rows) % 5, "GP")


def two_targets(skilled):
    """A front of two targets, of which the first model always has skill."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 1, (2, 30)).round(3)
    frame = {"a": a, "b": b, "gain": a, "Cost / EUR": a * b}
    data = targets_of(lambda target, **more: Designs.from_frame(frame, target, **more), ["gain", "Cost / EUR"], ["Cost / EUR"])
    x = np.array([[0.9, 0.1], [0.7, 0.05]], np.float32)
    made = tuple(
        Proposals("GP", x, np.array([0.8, 0.7]) * sign, np.array([0.1, 0.2]), 0, quality=skill(known, 30), mean_std=np.ones(2))
        for sign, known in ((1, True), (-1, skilled))
    )
    return Front(tuple(data), made, np.array([0.1, -0.9]), 34.6, 14.2)


def front_page(front, tmp_path):
    text = write_front(front, tmp_path / "front.html").read_text()
    return text, re.sub(r"\s+", " ", html.unescape(re.sub(r"<(style|script).*?</\1>|<[^>]+>", " ", text, flags=re.S)))


def test_the_page_of_several_targets_says_what_that_of_one_does(tmp_path):
    front = two_targets(True)
    text, said = front_page(front, tmp_path)
    assert "measured from gain 0.100, Cost / EUR 0.900: the area of outcomes, better than this point" in said
    assert "The proposals are expected to add 14.2." in said
    near = int(front.data[0].numbered(neighbours(front.data[0], front.made[0].x, 1)[1][0])[0])
    for part in (
        "What the models do not know The model of gain Rows that it had not seen (30 rows)", "The model of Cost / EUR",
        "The proposals", "What was asked", "gain is to be made large and Cost / EUR is to be made small",
        "0.800 0.604 to 0.996 0.800 0.604 to 0.996", f"{near}: ", "nearest rows", "Triangles: the other designs of the data",
    ):  # fmt: skip
        assert part in said, part
    assert re.search(r'<div class="charts two"><figure>', text)


def test_a_gain_is_said_to_be_too_high_where_a_model_explains_little(tmp_path):
    front = two_targets(True)
    assert "too high" not in front_page(front, tmp_path)[1]
    made = dataclasses.replace(front.made[1], quality=dataclasses.replace(front.made[1].quality, r2=0.43))
    noisy = dataclasses.replace(front, made=(front.made[0], made))
    told = "expected gain is too high where noise is large (R2 out of fold: Cost / EUR 0.43)"
    assert f"The proposals are expected to add 14.2. The {told}." in front_page(noisy, tmp_path)[1]
    assert f"the {told}" in about_front(noisy)["value"]


def test_variables_on_log_scales_that_vary_together_are_told():
    """By their logarithms, as the models see them: the numbers themselves are correlated by 0.87 and -0.28."""
    rng = np.random.default_rng(0)
    a = 10 ** rng.uniform(-2, 2, 40)
    for b, size in ((a**3, "1.00"), (1 / a, "\N{MINUS SIGN}1.00")):
        frame = {"still": np.ones(40), "kind": ["x", "y"] * 20, "a": a, "c": rng.uniform(size=40), "b": b}
        assert abs(np.corrcoef(a, b)[0, 1]) < TOGETHER
        [said] = _of_correlation(Designs.from_frame(frame | {"y": rng.normal(size=40)}, "y", logs=["a", "b"]))
        assert said.endswith(f": a and b (correlation {size}).")


def test_where_a_model_has_no_skill_no_gain_is_stated(tmp_path):
    front = two_targets(False)
    text, said = front_page(front, tmp_path)
    lead = re.search(r'<p class="lead">(.*?)</p>', text)[1]
    order = "the model's order of unseen rows cannot be distinguished from chance".replace("'", "&#x27;")
    assert lead.startswith(f"Of Cost / EUR, {order}. Proposals may be worthless for Cost / EUR")
    assert "their expected gain is not known" in lead
    assert "14.2" not in said
    assert about_front(front)["value"][about_front(front)["what"].index("expected to be added")] == "not known"
    assert "what the 2 proposals add to it is not known" in told(front)[1]


def test_where_a_model_was_not_tested_no_gain_is_stated(tmp_path):
    """As of ten rows, of noise too."""
    front = two_targets(True)
    untested = dataclasses.replace(front, made=(front.made[0], dataclasses.replace(front.made[1], quality=None)))
    assert untested.unskilled == ["Cost / EUR"]
    text, said = front_page(untested, tmp_path)
    lead = re.search(r'<p class="lead">(.*?)</p>', text)[1]
    assert lead.startswith("Of Cost / EUR, it was not tested how well the model predicts unseen rows. Proposals may be")
    assert "their expected gain is not known" in lead
    assert "14.2" not in said
    assert about_front(untested)["value"][about_front(untested)["what"].index("expected to be added")] == "not known"
    assert "what the 2 proposals add to it is not known" in told(untested)[1]


def test_an_axis_has_two_ticks_at_least():
    assert Axis(2.0, 98.0, 0, 1, most=4).ticks == [25, 50, 75]
    rng = np.random.default_rng(0)
    for low, span in zip(rng.normal(size=300), 10 ** rng.uniform(-3, 3, 300)):
        for most in (3, 4, 5, 6):
            assert 2 <= len(Axis(low, low + span, 0, 1, most=most).ticks) <= most + 2
    assert len(Axis(-0.3, 0.4, 0, 1, symlog=True).ticks) > 1
    assert _ticks_of_log(np.array([1.5, 4.9])) == [1.5, 4.9]


def test_ticks_of_a_log_axis():
    assert _ticks_of_log(np.array([0.02, 20.0])) == pytest.approx([0.1, 1, 10])
    assert _ticks_of_log(np.array([2.0, 9.0])) == pytest.approx([2, 5])
    assert len(_ticks_of_log(np.array([1e-9, 1e9]))) <= 5


def test_the_page_fits_a_phone(skilled, tmp_path, browse):
    text, _ = page(*skilled, tmp_path)
    phone = tmp_path / "phone.html"
    phone.write_text(PHONE % html.escape(text))
    found, console = browse(phone, "")
    assert found["inside"] == 390
    assert found["width"] <= 390
    assert found["silent"] == 0
    assert console == []
