"""`deadreckon theory`: what there is, a mistake told in a line, and (slowly) every picture with its numbers."""

import csv
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from deadreckon.cli.main import main
from deadreckon.report import theory
from deadreckon.report.theory import drawing, grid, normalised


def test_it_lists_what_there_is(capsys):
    assert main(["theory"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("gridworld", "mmd", "bounds", "cnml"))


def test_an_unknown_name(capsys):
    assert main(["theory", "gridwold"]) == 2
    assert "unknown theory 'gridwold': did you mean gridworld?" in capsys.readouterr().err


def test_numbers_in_columns(tmp_path):
    drawing.columns(tmp_path / "a.csv", {"k": np.arange(3), "x": np.array([0.1, np.nan, 1e-9])})
    with open(tmp_path / "a.csv") as file:
        assert [*csv.reader(file)] == [["k", "x"], ["0", "0.1"], ["1", "nan"], ["2", "1e-09"]]


def test_pictures_of_small_worlds(tmp_path):
    """Well-formed, and with the shades that the numbers say."""
    from deadreckon.theory import fitted, piecewise, propagation

    found = propagation.propagate(propagation.grid(3, 3, rows=100), 0.2, shown=(1, 5), draws=4)
    seen = piecewise.sine(points=12, queries=9, members=2)
    paths = [
        grid.draw_propagation(tmp_path / "p.svg", found), grid.draw_stitching(tmp_path / "s.svg", fitted.stitching()),
        normalised.draw_beliefs(tmp_path / "b.svg", seen), normalised.draw_claims(tmp_path / "c.svg", seen),
    ]  # fmt: skip
    roots = [ET.parse(path).getroot() for path in paths]
    assert all(root.tag.endswith("svg") for root in roots)
    texts = ["".join(root.itertext()) for root in roots]
    assert f"return {found.returns['support']:.2f} of {found.best:.2f}" in texts[0]
    assert "Q-iteration on the log: 0.43" in texts[1]
    shades = [e for e in roots[0].iter() if e.get("class") == "shade" and e.tag.endswith("path")]
    support = next(e for e in shades if e.get("opacity") == "1.00")
    assert support.get("d", "").count("M") == found.allowed.sum()


@pytest.mark.slow
@pytest.mark.parametrize("name", theory.EXPERIMENTS)
def test_every_experiment(name, tmp_path, capsys):
    out = tmp_path / name
    assert main(["theory", name, "--out", str(out)]) == 0
    written = [line for line in capsys.readouterr().out.splitlines() if line.startswith(str(out))]
    assert sorted(written) == sorted(str(path) for path in out.iterdir())
    for path in out.glob("*.svg"):
        ET.parse(path)
    for path in out.glob("*.csv"):
        with open(path) as file:
            rows = [*csv.reader(file)]
        assert len({len(row) for row in rows}) == 1
        assert len(rows) > 2
