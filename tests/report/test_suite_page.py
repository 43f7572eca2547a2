"""A suite's page has its means per domain, its tables and the thesis's numbers, and works in a browser."""

import dataclasses

import numpy as np
import pytest

from deadreckon.bench.suite import read
from deadreckon.bench.tables import METRICS, Cell, Table
from deadreckon.report.suite import groups, write_suite

CHECK = """<script>
const back = () => getComputedStyle(document.body).backgroundColor, found = { light: back() };
document.getElementById("theme").click(); found.dark = back();
found.bars = document.querySelectorAll("svg rect.bar").length;
found.ticks = document.querySelectorAll("svg line.other").length;
found.links = [...document.querySelectorAll("#pages a")].map((link) => link.getAttribute("href"));
found.wide = document.documentElement.scrollWidth <= innerWidth; found.errors = errors;
document.body.append(Object.assign(document.createElement("pre"), { id: "found", textContent: JSON.stringify(found) }));
</script>"""


@pytest.fixture
def gym():
    """The suite d4rl-gym with scores by hand: the k-th method has 10 k on every log, and the last is not done."""
    suite = read("d4rl-gym")
    suite = dataclasses.replace(suite, methods=suite.methods[:4])
    names = [method.name for method in suite.methods]
    cells = {name: {on: Cell(10.0 * k + np.array([-1.0, 0.0, 1.0]), 0, 0, k == 2) for on in suite.on}
             for k, name in enumerate(names)}  # fmt: skip
    cells[names[3]][suite.on[0]] = Cell(np.zeros(0), 3, 0)
    printed = {on: {"thesis": {names[1]: 12.5}, "CORL": {names[2]: 62.5}} for on in suite.on}
    return Table(suite, METRICS["learn"][0], cells, printed, {}, ("a note",))


def test_the_page_shows_means_per_domain_tables_and_notes(gym, tmp_path, browse):
    path = write_suite([gym], tmp_path / "suite.html", [tmp_path / "one.html"])
    text = path.read_text()
    count = len(gym.suite.on)
    assert groups(gym) == {"gym": list(gym.suite.on)}
    assert f"gym: mean of {count}" in text
    assert f"on {count} of {count}: {gym.suite.methods[2].name}." in text
    assert text.count("thesis 12.5") == text.count("CORL 62.5") == count
    assert "3 missing" in text
    assert "a note" in text
    assert "nan" not in text
    found, console = browse(path, CHECK)
    assert found["errors"] == console == []
    assert found["light"] != found["dark"]
    assert found["bars"] == 3  # the mean of a method that is not done would be of the easy logs
    assert found["ticks"] == 1
    assert found["links"] == ["one.html"]
    assert found["wide"]


def test_design_problems_stand_by_themselves():
    suite = read("nemo")
    table = Table(suite, METRICS["design"][0], {}, {}, {}, ())
    assert groups(table) == {on: [on] for on in suite.on}
