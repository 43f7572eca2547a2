"""Learning curves as an SVG file for documents."""

import xml.etree.ElementTree as ET

import pytest

from deadreckon.errors import UserError
from deadreckon.report import picture


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


def test_a_logarithmic_axis_and_refusals(runs, tmp_path):
    promised = picture(tmp_path / "q.svg", {"wild": runs[2:]}, quantity="estimated_value", symlog=True).read_text()
    assert "symmetric log scale" in promised
    with pytest.raises(UserError, match="none of the runs has a column 'speed'"):
        picture(tmp_path / "q.svg", {"all": runs}, quantity="speed")
    with pytest.raises(UserError, match="nothing to draw"):
        picture(tmp_path / "q.svg", {})
