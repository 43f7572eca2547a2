"""The page in a real browser: no errors, sorting, themes, legends, and no sideways scrolling on a phone."""

import html

from run_folders import told

from deadreckon.files import write_json
from deadreckon.report import write

CHECK = """<script>
const found = {};
const cell = (row, column) => document.querySelectorAll("#score-table tbody tr")[row].cells[column].dataset.value;
const head = document.querySelectorAll("#score-table thead th");
const column = (i) => [...document.querySelectorAll("#score-table tbody tr")].map((row) => row.cells[i].dataset.value);
head[2].querySelector("button").click(); found.down = column(2); found.sort = head[2].getAttribute("aria-sort");
head[2].querySelector("button").click(); found.up = column(2);
head[5].querySelector("button").click(); found.missing = column(5);
head[0].querySelector("button").click(); found.names = column(0);
const back = () => getComputedStyle(document.body).backgroundColor;
found.light = back(); document.getElementById("theme").click(); found.dark = back();
document.getElementById("theme").click(); found.again = back();
document.querySelector('[data-toggle="1"]').click();
found.hidden = [...document.querySelectorAll('[data-agent="1"]')].every((part) => getComputedStyle(part).display === "none");
found.others = document.querySelectorAll('[data-agent="0"].gone').length;
const chart = document.querySelector(".wide svg"), box = chart.getBoundingClientRect();
chart.dispatchEvent(new PointerEvent("pointermove", { clientX: box.left + box.width / 2, clientY: box.top + 20 }));
found.tip = document.getElementById("tip").innerText;
found.requests = performance.getEntriesByType("resource").map((entry) => entry.name).filter((name) => !/^data:/.test(name));
found.errors = errors;
document.body.append(Object.assign(document.createElement("pre"), { id: "found", textContent: JSON.stringify(found) }));
</script>"""
PHONE = """<!doctype html><body style="margin:0"><iframe style="width:390px;height:800px;border:0" srcdoc="%s"></iframe><script>
const frame = document.querySelector("iframe");
frame.addEventListener("load", () => {
  const page = frame.contentDocument, root = page.documentElement;
  page.querySelectorAll("details").forEach((part) => { part.open = true; });
  const shown = { inside: frame.contentWindow.innerWidth, width: root.scrollWidth, body: page.body.scrollWidth };
  frame.contentWindow.dispatchEvent(new Event("resize"));
  const tables = [...page.querySelectorAll(".scroll")];
  const hint = (box) => getComputedStyle(box.parentElement.querySelector(".hint")).display !== "none";
  shown.silent = tables.filter((box) => box.scrollWidth > box.clientWidth + 8 && !hint(box)).length;
  shown.wide = tables.filter((box) => box.scrollWidth > box.clientWidth + 8).length;
  document.body.append(Object.assign(document.createElement("pre"), { id: "found", textContent: JSON.stringify(shown) }));
});
</script>"""


def test_page_works_in_a_browser(runs, tmp_path, browse):
    found, console = browse(write(runs, tmp_path / "page.html"), CHECK)
    assert found["errors"] == []
    assert console == []
    assert found["requests"] == []
    values = [float(v) for v in found["down"]]
    assert values == sorted(values, reverse=True)
    assert len(values) == 4
    assert found["sort"] == "descending"
    assert found["up"] == found["down"][::-1]
    assert found["missing"][-2:] == ["", ""]  # the log and cloning promise nothing: last, whatever the order
    assert found["names"] == ["BC", "behaviour policy", "TD3", "TD3+BC"]
    assert found["light"] == found["again"] != found["dark"]
    assert found["hidden"]
    assert found["others"] == 0
    assert "updates" in found["tip"]
    assert "BC" in found["tip"]
    assert "TD3+BC" not in found["tip"]


def test_page_fits_a_phone(runs, tmp_path, browse):
    gains = {f"{path.name} seed 0": (12.0, 6.0, 18.0) for path in runs}
    write_json(tmp_path / "estimates.json", told(gains))
    text = write(runs, tmp_path / "page.html", estimates=tmp_path).read_text()
    page = tmp_path / "phone.html"
    page.write_text(PHONE % html.escape(text))
    found, _ = browse(page, "")
    assert found["inside"] == 390
    assert found["width"] <= 390
    assert found["body"] <= 390
    assert found["wide"] >= 2  # tables that go on beyond the edge
    assert found["silent"] == 0  # each of them says so
