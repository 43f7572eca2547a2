"""The page of proposals: what it says of a table with an effect and of pure noise, and that it fits a phone."""

import html
import re

import numpy as np
import pytest
from test_browser import PHONE

from deadreckon.mbo import designer
from deadreckon.mbo.designer import Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.fitted import Fitted
from deadreckon.mbo.nn_distance import nn_distance
from deadreckon.report.design import write_design
from deadreckon.report.effects import _ticks_of_log

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
        "cannot be told from none", "Around proposal", "Dashed or hollow", "Nearest rows",
    ):  # fmt: skip
        assert part in said, part
    assert "no better than chance" not in said
    assert "<oil" not in text  # levels are escaped
    assert text.count("<figure>") == 2 + 7 + 6  # of the fixed rate there is an average and no cut


def test_of_noise_nothing_is_praised(tmp_path):
    data = table("noise")
    made = designer("gp", rounds=2).propose(data, 6)
    assert not made.quality.skilled
    _, said = page(data, made, tmp_path)
    assert "The model ranks unseen designs no better than chance" in said
    assert "None of the proposals is preferred" in said
    assert "What it shows of the effects of variables cannot be told from none either" in said
    assert not re.search(r"Proposal \d|Around proposal|is the highest\b", said)


def test_without_a_model_there_is_no_choice_and_no_effect(tmp_path):
    data = table("noise")
    made = designer("random").propose(data, 4)
    _, said = page(data, made, tmp_path)
    assert "Random has no model of cost, so nothing says which proposal to prefer" in said
    assert "was not measured" in said
    assert "What each variable does" not in said


def test_an_order_and_predictions_without_deviation_are_told_as_such(tmp_path):
    data = table("noise")
    nan, x = np.full(3, np.nan), data.x[:3] + np.float32(0.0)
    order = Fitted(lambda x: (x[:, 3], None), is_order=True)
    _, said = page(data, Proposals("RaM", x, nan, nan, 0, fitted=order), tmp_path)
    assert "learns an order and predicts no scores" in said
    assert "Upright: the order by the model" in said
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
    assert "2 of 3 proposals (67%) lie more than 3 usual distances" in said
    assert re.search(r"Of 3 proposals, in 3 b is at its upper end \([\d.]+\) of what is allowed", said)
    assert "1 of 3 proposals have a value beyond the data" in said
    assert "a and b (correlation 1.00)" in said


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
