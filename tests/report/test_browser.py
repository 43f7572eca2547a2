"""The page in a real browser: no errors, sorting, themes, legends, and no sideways scrolling on a phone."""

import html
import json
import re
import shutil
import subprocess

import pytest

from deadreckon.report import write

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")

LISTEN = "<script>window.errors = []; addEventListener('error', (e) => errors.push(String(e.message)));</script>"
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
  document.body.append(Object.assign(document.createElement("pre"), { id: "found", textContent: JSON.stringify(shown) }));
});
</script>"""


@pytest.fixture(scope="module")
def browse(tmp_path_factory):
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        pytest.skip("no Chromium on this machine")

    def run(page):
        profile = tmp_path_factory.mktemp("profile")
        done = subprocess.run(
            [browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
             "--disable-component-update", "--disable-sync", f"--user-data-dir={profile}", "--window-size=1280,1600",
             "--enable-logging=stderr", "--virtual-time-budget=4000", "--dump-dom", page.as_uri()],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        found = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.S)
        if found is None:
            pytest.fail(f"the page's script did not end: {done.stderr[-2000:]}")
        return json.loads(html.unescape(found[1])), [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return run


def test_page_works_in_a_browser(runs, tmp_path, browse):
    text = write(runs, tmp_path / "page.html").read_text()
    page = tmp_path / "checked.html"
    page.write_text(text.replace("<style>", LISTEN + "<style>", 1).replace("</body>", CHECK + "</body>"))
    found, console = browse(page)
    assert found["errors"] == []
    assert console == []
    assert found["requests"] == []
    values = [float(v) for v in found["down"]]
    assert values == sorted(values, reverse=True)
    assert len(values) == 4
    assert found["sort"] == "descending"
    assert found["up"] == found["down"][::-1]
    assert found["missing"][-2:] == ["", ""]  # the log and cloning promise nothing: last, whatever the order
    assert found["names"] == ["BC", "behaviour (log)", "TD3", "TD3+BC"]
    assert found["light"] == found["again"] != found["dark"]
    assert found["hidden"]
    assert found["others"] == 0
    assert "updates" in found["tip"]
    assert "BC" in found["tip"]
    assert "TD3+BC" not in found["tip"]


def test_page_fits_a_phone(runs, tmp_path, browse):
    text = write(runs, tmp_path / "page.html").read_text()
    page = tmp_path / "phone.html"
    page.write_text(PHONE % html.escape(text))
    found, _ = browse(page)
    assert found["inside"] == 390
    assert found["width"] <= 390
    assert found["body"] <= 390
