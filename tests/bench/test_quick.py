"""`deadreckon bench quick`, as a newcomer runs it, and its page in a real browser."""

import pytest

from deadreckon.cli.main import main

# Every table is sorted by every column, every chart is hovered over, every legend entry is pressed, the theme is changed.
CHECK = """<script>
const found = { sorted: [], tips: [], hidden: [] };
for (const table of document.querySelectorAll("table")) {
  for (const head of table.querySelectorAll("thead th")) {
    const button = head.querySelector("button");
    if (!button) continue;
    button.click(); found.sorted.push(head.getAttribute("aria-sort"));
  }
}
const back = () => getComputedStyle(document.body).backgroundColor;
found.light = back(); document.getElementById("theme").click(); found.dark = back();
document.getElementById("theme").click(); found.again = back();
for (const chart of document.querySelectorAll(".wide svg")) {
  const box = chart.getBoundingClientRect();
  const middle = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 };
  chart.dispatchEvent(new PointerEvent("pointermove", middle));
  found.tips.push(document.getElementById("tip").innerText);
}
for (const button of document.querySelectorAll("[data-toggle]")) {
  button.click();
  const parts = [...document.querySelectorAll(`[data-agent="${button.dataset.toggle}"]`)];
  found.hidden.push(parts.length > 0 && parts.every((part) => getComputedStyle(part).display === "none"));
  button.click();
}
found.rows = [...document.querySelectorAll("#score-table tbody tr")].map((row) => row.cells[0].innerText);
found.requests = performance.getEntriesByType("resource").map((entry) => entry.name).filter((name) => !/^data:/.test(name));
found.errors = errors;
document.body.append(Object.assign(document.createElement("pre"), { id: "found", textContent: JSON.stringify(found) }));
</script>"""


@pytest.mark.slow
@pytest.mark.timeout(1800)  # five minutes on two idle cores
def test_quick_runs_through_and_every_element_of_its_page_works(tmp_path, capsys, browse):
    out = tmp_path / "bench"
    assert main(["bench", "quick", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "12 cells, 0 of them done" in told
    assert "without a result yet" not in told
    found, console = browse(out / "reports" / "quick-maze2d-umaze-v1.html", CHECK)
    assert found["errors"] == console == found["requests"] == []
    assert {"BC", "TD3+BC", "IQL", "BEAR"} <= {row.split("\n")[0] for row in found["rows"]}
    assert len(found["rows"]) == 5  # and the log
    assert len(found["sorted"]) >= 5
    assert set(found["sorted"]) <= {"ascending", "descending"}
    assert found["light"] == found["again"] != found["dark"]
    assert found["tips"]  # the learning curves, all agents in one
    assert all(found["tips"])
    assert len(found["hidden"]) >= 4
    assert all(found["hidden"])
    capsys.readouterr()
    assert main(["bench", "quick", "--out", str(out)]) == 0  # nothing is left to do
    assert "12 cells, 12 of them done" in capsys.readouterr().out
