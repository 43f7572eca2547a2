"""Learning curves as an SVG file for documents."""

import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.report import picture
from deadreckon.report.axes import Axis
from deadreckon.report.charts import Series, lines


def test_a_panel_a_group_and_a_colour_a_name(runs, tmp_path):
    path = picture(
        tmp_path / "curves.svg", {"left": runs, "right": runs[:1]}, names={"bc": "cloning"}, references={"left": {"log": 25.0}}
    )
    root = ET.parse(path).getroot()
    text = path.read_text()
    for said in ("left", "right", "cloning", "good", "wild", ">log<"):
        assert said in text
    space = "{http://www.w3.org/2000/svg}"
    assert len(root.findall(f"{space}svg")) == 2
    assert "data-hover" not in text
    # Behaviour cloning has the first colour in both panels.
    assert text.count('data-agent="0"') == 2


def test_letters_do_not_depend_on_the_locale(runs, tmp_path, monkeypatch):
    """Where the system's encoding is another one, minus signs and names are written in UTF-8 as everywhere."""
    monkeypatch.setattr(io, "text_encoding", lambda encoding, level=2: encoding or "latin-1")
    path = picture(tmp_path / "curves.svg", {"−": runs[:1]}, names={"bc": "naïve"})
    text = path.read_bytes().decode("utf-8")
    assert ">−<" in text
    assert ">naïve<" in text


def test_a_logarithmic_axis_and_refusals(runs, tmp_path):
    promised = picture(tmp_path / "q.svg", {"wild": runs[2:]}, quantity="estimated_value", symlog=True).read_text()
    assert "symmetric log scale" in promised
    with pytest.raises(UserError, match="none of the runs has a column 'speed'"):
        picture(tmp_path / "q.svg", {"all": runs}, quantity="speed")
    with pytest.raises(UserError, match="nothing to draw"):
        picture(tmp_path / "q.svg", {})


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [(100, 112, ["100", "102.5", "105", "107.5", "110"]), (100, 102, ["100", "100.5", "101", "101.5", "102"]),
     (50, 51.2, ["50", "50.25", "50.5", "50.75", "51"]), (0, 1, ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
     (100_000, 100_012, ["100k", "100.0025k", "100.005k", "100.0075k", "100.01k"]), (0, 1e-6, None)],
)  # fmt: skip
def test_ticks_are_told_apart(low, high, labels):
    axis = Axis(low, high, 0, 100)
    told = [axis.label(tick) for tick in axis.ticks]
    assert len(set(told)) == len(told)
    assert labels is None or told == labels
    numbers = [float(text.replace("\N{MINUS SIGN}", "-").replace("k", "")) * (1e3 if "k" in text else 1.0) for text in told]
    np.testing.assert_allclose(numbers, axis.ticks, rtol=1e-9)


def test_a_band_with_an_infinite_end_goes_to_the_edge_of_the_chart():
    x, y = np.arange(1.0, 4.0), np.ones(3)

    def shape(low, high):
        drawn = str(lines([Series("a", 0, x, y, low, high)], title="t", unit="u"))
        return re.findall(r'<path d="([^"]*)" class="band"', drawn)

    (whole,) = shape(np.array([0.0, 0.0, 0.0]), np.array([2.0, np.inf, np.inf]))
    assert whole.count("L") == 5
    (edge,) = shape(np.array([0.0, np.nan, -np.inf]), np.array([2.0, 1.0, np.inf]))
    assert edge.count("L") == 1  # what is not known, or infinite on both sides, is not drawn
