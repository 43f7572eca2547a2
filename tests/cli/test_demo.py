"""The demo, small: from nothing to a page with one verdict, and again from what is there."""

import re

import pytest

from deadreckon.cli.main import main


@pytest.mark.slow
def test_the_demo_ends_in_one_decision(tmp_path, capsys, home):
    small = ["demo", "--out", str(tmp_path / "demo"), "--days", "300", "--steps", "200", "--seeds", "1"]
    assert main(small) == 0
    out = capsys.readouterr().out
    assert "60 held-out episodes of 300" in out
    assert len(re.findall(r"^(?:DEPLOY|DO NOT DEPLOY)", out, re.M)) == 1
    page = (tmp_path / "demo" / "report.html").read_text()
    assert len(re.findall('class="stamp (?:yes|no)"', page)) == 1
    assert main(small) == 0
    assert capsys.readouterr().out.split("report:")[0] == out.split("report:")[0]
