"""The page about a log: what it says, that names are escaped, and that it works in a browser."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

from deadreckon.cli.data import data
from deadreckon.data.dataset import Dataset
from deadreckon.data.info import describe, warnings_for
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError
from deadreckon.report import bars
from deadreckon.report.log import write_log

CHECK = """<script>
const found = { errors, charts: document.querySelectorAll("svg.chart").length, scripts: document.scripts.length,
  injected: document.querySelectorAll("b.evil").length,
  requests: performance.getEntriesByType("resource").map((entry) => entry.name).filter((name) => !/^data:/.test(name)) };
const frame = document.createElement("iframe");
frame.style.width = "390px";
frame.srcdoc = "<!doctype html>" + document.documentElement.outerHTML.replace(/<script>[^]*?<\\/script>/g, "");
frame.addEventListener("load", () => {
  const root = frame.contentDocument.documentElement;
  found.phone = [root.scrollWidth, frame.contentWindow.innerWidth];
  document.body.append(Object.assign(document.createElement("pre"), { id: "found", textContent: JSON.stringify(found) }));
});
document.body.append(frame);
</script>"""
EVIL = "<b class=evil>x</b>"


def page(log, tmp_path, warnings=()):
    info = describe(log)
    return write_log(log, tmp_path / "log.html", info, (*warnings_for(log, info), *warnings))


def table(rows=60):
    rng = np.random.default_rng(0)
    cold = np.where(np.arange(rows) % 10 == 0, np.nan, rng.normal(size=rows))
    return Dataset.from_frame(
        {"day": np.repeat(np.arange(rows // 10), 10), EVIL: rng.normal(size=rows), "cold": cold,
         "site": np.where(np.arange(rows) % 3, "<i>here", "there"), "act": np.where(np.arange(rows) % 4, "a&b", "c"),
         "gone": [None] * rows, "reward": rng.normal(size=rows)},
        action="act", reward="reward", episode="day",
    )  # fmt: skip


def test_every_column_stands_on_the_page(tmp_path):
    text = page(table(), tmp_path, ["a warning of <column>"]).read_text()
    assert EVIL not in text
    assert "<i>here" not in text
    for words in ("&lt;b class=evil&gt;", "a warning of &lt;column&gt;", "left out: empty", "one 0/1 number per level",
                  "6 missing", "Within an episode", "2 of 2 actions occur in the log"):  # fmt: skip
        assert words in text, words
    bars = re.findall(r"<title>([^<]*): (\d+) rows</title>", text)
    assert ("a&amp;b", "45") in bars
    assert ("there", "20") in bars
    # Cells that were filled up with the mean are no values: 54 of the 60 are.
    drawn = text[text.index("<figcaption>cold</figcaption>") :].split("</figure>")[0]
    assert sum(int(count) for count in re.findall(r": (\d+) rows</title>", drawn)) == 54


def test_what_is_no_page_is_not_replaced(tmp_path):
    log = table()
    (tmp_path / "table.csv").write_text("a,b")
    with pytest.raises(UserError, match=r"table.csv: the page is HTML, and its name must end in .html"):
        write_log(log, tmp_path / "table.csv", describe(log), [])
    assert (tmp_path / "table.csv").read_text() == "a,b"


@pytest.mark.slow
def test_the_page_in_a_browser(tmp_path, browse):
    found, console = browse(page(table(), tmp_path), CHECK)
    assert found["errors"] == []
    assert found["injected"] == 0
    assert found["requests"] == []
    assert found["charts"] >= 9
    assert found["phone"][0] <= found["phone"][1]
    assert not console


@pytest.mark.parametrize("values", [
    np.linspace(-1.0, 1.0, 40) * 1.6e308, 1.7e18 + 256.0 * np.arange(15), 1.0 + np.spacing(1.0) * np.arange(20),
    np.full(3, np.nan), np.array([np.inf, 1.0]), np.zeros(0), np.array([5e-324, 0.0]),
])  # fmt: skip
def test_any_numbers_have_a_histogram(values):
    drawn = str(bars.histogram(values, "values"))
    counts = [int(count) for count in re.findall(r": (\d+) rows</title>", drawn)]
    assert sum(counts) == np.isfinite(values).sum()
    assert "nan" not in drawn


def test_bars_of_different_numbers_have_different_names():
    drawn = str(bars.histogram(1_000_000 + np.arange(3) / 8, "values"))
    assert re.findall(r"<title>([^<]*): 1 rows</title>", drawn) == ["1000000", "1000000.125", "1000000.25"]


@pytest.mark.parametrize("kind", ["continuous", "bandit", "images", "one dimension", "long"])
def test_all_kinds_of_logs(kind, tmp_path):
    rng = np.random.default_rng(0)
    rows = 30_000 if kind == "long" else 40
    shape = {"images": (8, 8, 3), "one dimension": (1,)}.get(kind, (3,))
    seen = rng.integers(0, 255, (rows, *shape)).astype(np.uint8) if kind == "images" else rng.normal(size=(rows, *shape))
    discrete = kind in ("bandit", "images")
    log = Dataset.from_arrays(
        observations=seen, rewards=rng.normal(size=rows),
        actions=rng.integers(0, 20, rows) if discrete else rng.normal(size=(rows, 2)),
        terminals=np.ones(rows, bool) if kind == "bandit" else None,
        action_space=Discrete(20) if discrete else Box((-5, -5), (5, 5)),
    )  # fmt: skip
    text = page(log, tmp_path).read_text()
    assert ("Images have too many numbers for that" in text) == (kind == "images")
    assert ("no time within them" in text) == (kind == "bandit")
    assert ("20,000 of 30,000 rows" in text) == (kind == "long")
    assert ("Fewer than two dimensions" in text) == (kind == "one dimension")
    assert ("12 more actions are not drawn" in text) == discrete


def test_the_command(tmp_path, capsys):
    path, made = tmp_path / "x.csv", tmp_path / "x.html"
    path.write_text("x,act,reward\n" + "".join(f"{i % 7},{i % 3},{i * i % 11}\n" for i in range(40)))
    data(["info", str(path), "--action", "act", "--reward", "reward", "--html", str(made)])
    shown = capsys.readouterr().out
    assert shown.splitlines()[-1] == str(made)
    assert "levels or range" in shown
    assert made.read_text().startswith("<!")
    with pytest.raises(UserError, match=r"--html x.pdf: .* must end in .html"):
        data(["info", str(path), "--action", "act", "--reward", "reward", "--html", "x.pdf"])


def test_the_command_tells_leaks(tmp_path, capsys):
    rng = np.random.default_rng(0)
    path = tmp_path / "x.csv"
    rewards = rng.normal(size=60)
    path.write_text(
        "x,bill,act,reward\n" + "".join(f"{rng.normal():.4f},{r:.4f},{i % 3},{r:.4f}\n" for i, r in enumerate(rewards))
    )
    for command in ("info", "describe"):
        data([command, str(path), "--action", "act", "--reward", "reward"])
        out, error = capsys.readouterr()
        assert "column bill may be the reward by another name: equal to it" in out + error, command


def test_pictures_are_shown_as_film_strips(tmp_path):
    rows, rng = 60, np.random.default_rng(0)
    pictures = rng.integers(0, 256, (rows, 16, 20, 6)).astype(np.uint8)
    log = Dataset.from_arrays(
        observations=pictures, actions=rng.uniform(size=(rows, 1)), rewards=np.repeat([1.0, 3.0, 2.0], 20),
        timeouts=np.arange(rows) % 20 == 19,
    )  # fmt: skip
    text = page(log, tmp_path).read_text()
    assert re.findall(r"<figcaption>Episode (\d), ([^<]*)</figcaption>", text) == [
        ("2", "the highest return: 60.0 in 20 steps"), ("3", "the median return: 40.0 in 20 steps"),
        ("1", "the lowest return: 20.0 in 20 steps"),
    ]  # fmt: skip
    best = re.findall(r'src="data:image/png;base64,([^"]*)"', text)[0]
    strip = np.asarray(Image.open(io.BytesIO(base64.b64decode(best))))
    assert strip.shape == (16, 10 * 21 - 1, 3)
    np.testing.assert_array_equal(strip[:, :20], pictures[20, ..., 3:])  # the newest frame of the episode's first step
    np.testing.assert_array_equal(strip[:, -20:], pictures[39, ..., 3:])
    assert not re.search("that never change|scales differ", text)
