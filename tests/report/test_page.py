"""The page as text: whole, self-contained, and safe whatever names it shows."""

import dataclasses
import html
import json
import re

import numpy as np
import pandas as pd
import pytest
from run_folders import TASK, write_run

import deadreckon as dr
from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.report import axes, maze, spacetime, table, write
from deadreckon.report.entries import read
from deadreckon.report.page import render
from deadreckon.report.provenance import command, schema_file
from deadreckon.report.rows import rows
from deadreckon.report.text import number, score
from deadreckon.runs.folder import Folder
from deadreckon.tasks import registry

SECTIONS = ["simulator", "scores", "learning", "values", "distance", "training", "mazes", "provenance"]
HELD = {"held": 2, "learning": 8}  # episodes


def test_page_is_whole_and_loads_nothing(runs, tmp_path):
    out = write(runs, tmp_path / "new" / "page.html")
    text = out.read_text()
    assert re.findall(r'<section id="(\w+)"', text) == SECTIONS
    assert not re.findall(r"""(?:src|href|action|poster|data)\s*=\s*["']?(?:https?:)?//""", text)
    assert not re.search(r"@import|url\(", text)
    assert "$" not in re.sub(r"<script>.*?</script>", "", text, flags=re.S)  # no unfilled place in the template
    assert len(text) < 500_000
    assert [p.name for p in out.parent.iterdir()] == ["page.html"]
    for label in ("BC", "TD3+BC", "TD3", "behaviour policy"):
        assert f">{label}<" in text
    for r in rows(read(runs)):
        assert score(r.score.value) in text
    assert "not the same data or simulator" in text
    assert "88.2" in text
    assert "1 of 2" in text
    assert "critic_loss at 150" in text
    assert "3 of 1000 rows have actions out of bounds" in text


def test_hostile_names_are_shown_and_never_run(tmp_path):
    evil = "<script>alert(1)</script>\"'&$x"
    path = write_run(tmp_path / "x", evil, 60.0, name=evil, task=evil, metrics={evil: 1.0}, failures={0: (evil, 100)})
    text = render(read([path]), title=evil)
    assert text.count("<script>") == 1
    assert "&lt;script&gt;alert(1)" in text


def test_a_chart_in_percent_shows_percent(tmp_path):
    """Of two seeds one acts outside the range at every tenth action, the other never."""
    text = render(read([write_run(tmp_path / "run")]))
    chart = re.search(r'<svg[^>]*aria-label="% of actions outside[^>]*data-hover="([^"]*)"', text)
    (series,) = json.loads(html.unescape(chart[1]))
    assert [point[2:] for point in series["p"]] == [["100", "5.00"], ["200", "5.00"]]


@pytest.mark.parametrize(
    ("copy", "said"),
    [
        (None, "BEAR's actions are further from the logged ones than the clone's (MMD 0.200 against 0.100)"),
        (0.15, "are further from the logged ones than the clone's (MMD 0.200 against 0.100; a copy stays below 0.150 in"),
        (0.25, "are not measurably further from the logged ones than the clone's (MMD 0.200 against 0.100; a copy stays below"),
    ],
)
def test_a_distance_that_a_copy_has_too_is_not_called_one(tmp_path, copy, said):
    sizes = (("bc", 30.0, 1), ("bear", 90.0, 3))
    paths = [write_run(tmp_path / agent, agent, level, copy=copy, seeds=seeds) for agent, level, seeds in sizes]
    text = html.unescape(render(read(paths)))
    assert said in text
    assert ("it departs from the log" in text) == (copy != 0.25)
    assert text.count(">95 % limit of a copy<") == (copy is not None)


def test_without_a_task(tmp_path):
    paths = [write_run(tmp_path / agent, agent, task=None) for agent in ("bc", "bear")]
    text = render(read(paths))
    assert re.findall(r'<section id="(\w+)"', text) == ["scores", "distance", "training", "provenance"]
    assert "Not evaluated yet: no simulator was named" in text
    shown = table(paths)
    assert "BEAR" in shown
    heads = shown.splitlines()[0].split()
    for column in ("score", "return", "estimated", "realised"):  # which nothing is known for
        assert column not in heads
        assert f">{column}</button>" not in text
    assert "MMD" in heads
    assert "\N{EM DASH}" not in text.split('id="score-table"')[1].split("</table>")[0]


def test_bad_numbers_are_gaps(tmp_path):
    path = write_run(tmp_path / "bad", "td3", 20.0, promised=np.nan, failures={0: ("loss", 0), 1: ("loss", 0)})
    text = render(read([path]))
    assert "2 of 2" in text
    assert not re.search(r"\b(nan|inf|None)\b", re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.S))
    assert "nothing finite to draw" in text
    infinite = write_run(tmp_path / "inf", "td3", 20.0, promised=np.inf, metrics={"loss": np.inf})
    assert "Infinity" not in render(read([infinite]))


def test_a_run_that_has_only_begun(tmp_path):
    path = write_run(tmp_path / "young", "td3", finished=False)
    for part in (path / "evaluations").iterdir():
        part.unlink()
    text = render(read([path]))
    assert "No evaluation is finished yet" in text
    assert "not finished" in text


def test_labels_tell_runs_of_one_agent_apart(tmp_path):
    page = read([write_run(tmp_path / "small", "bear"), write_run(tmp_path / "large", "bear"), str(tmp_path / "small")])
    assert [e.label for e in page.entries] == ["BEAR (small)", "BEAR (large)"]


def test_runs_that_differ_in_their_seeds_alone_are_one(tmp_path):
    paths = [write_run(tmp_path / name, "bear", 40.0 + 20 * i, seed=i, first=first, paths=True, failures=failures)
             for i, (name, first, failures) in enumerate([("a", 0, None), ("b", 2, {1: ("loss", 150)})])]  # fmt: skip
    [entry] = read(paths).entries
    assert (entry.label, entry.seeds) == ("BEAR", [0, 1, 2, 3])
    assert entry.failed == [(3, "loss", 150)]
    alone = [read([path]).entries[0] for path in paths]
    for name in ("return", "score"):
        assert np.array_equal(entry.last(name), np.concatenate([each.last(name) for each in alone]))
    assert np.array_equal(entry.curve("loss")[1], np.concatenate([each.curve("loss")[1] for each in alone], 1), equal_nan=True)
    assert len(entry.trajectories) == 4
    first, second = command(entry).split("\n")
    assert "--seeds 2 --seed 2" in second
    assert first.endswith(str(paths[0]))
    again = write_run(tmp_path / "again", "bear", seed=5, first=3)  # has seed 3 too
    assert [each.label for each in read([*paths, again]).entries] == ["BEAR (a)", "BEAR (b)", "BEAR (again)"]


@pytest.mark.parametrize("kind", ["nothing", "no run", "other task", "broken", "empty"])
def test_refusals_are_one_line(tmp_path, kind):
    good = write_run(tmp_path / "good", "bc")
    other = write_run(tmp_path / "other", "bc", task=None)
    broken, empty = write_run(tmp_path / "broken", "bc"), write_run(tmp_path / "empty", "bc")
    Folder(broken).part("metrics", 50).write_bytes(b"PAR1 not")
    for part in empty.rglob("*.parquet"):
        part.unlink()
    given, said = {
        "nothing": ([], "at least one"),
        "no run": ([tmp_path / "nowhere"], "no run.json"),
        "other task": ([good, other], "without a task"),
        "broken": ([broken], "broken"),
        "empty": ([empty], "no metrics yet"),
    }[kind]
    with pytest.raises(UserError, match=said) as caught:
        write(given, tmp_path / "page.html")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "page.html").exists()


def test_command_to_reproduce(runs):
    text = command(read(runs).entries[1])
    assert text == (
        f"deadreckon train --agent td3_bc --data '/logs/some log.hdf5' --task {TASK} --steps 200 --seeds 2 "
        f"--evaluate-every 100 --episodes 6 --agent.hidden 64 64 --out {runs[1]}"
    )


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({"history": 3}, "--history 3"),
        ({"encoder": "drq", "shift": 2}, "--encoder drq --shift 2"),
        ({"holdout": {"share": 0.3, "by": "time", "seed": 0, **HELD}}, "--holdout 0.3 --holdout-by time"),
        ({"holdout": {"share": 0.2, "by": "random", "seed": 0, **HELD}}, "--holdout 0.2 --holdout-by random"),
        ({"holdout": {"share": 0.2, "by": "random", "seed": 0, **HELD}, "task": None}, ""),
        ({"holdout": {"share": 0.2, "by": "user", "seed": 0, **HELD}, "task": None}, "--holdout 0.2 --holdout-by user"),
        ({"holdout": {"share": 0.2, "fold": 1, "folds": 5, "by": "random", "seed": 0, **HELD}, "task": None}, "--cross-fit 5"),
        ({"task": None}, "--holdout 0"),
    ],
)  # fmt: skip
def test_command_says_what_is_not_the_default(changes, options, tmp_path):
    path = write_run(tmp_path / "run", "bc")
    folder = Folder(path)
    config = folder.read_config()
    config["data"] |= {"holdout": changes.pop("holdout", None)}
    write_json(folder.config, config | changes)
    text = command(read([path]).entries[0])
    before, after = text.split(" --episodes 6")
    assert after.split(" --agent.")[0].split(" --out ")[0].strip() == options


@pytest.mark.parametrize("of", ["table", "fold", "converted", "frame"])
def test_command_reads_a_table_as_the_run_did(of, tmp_path):
    rows = {"x": [1.0, None, 3.0] * 20, "id": list(range(60)), "dose": [10, 20, 40] * 20, "gain": [0.0, 1.0] * 30}
    pd.DataFrame(rows | {"who": np.arange(60) // 4}).to_csv(tmp_path / "log.csv", index=False)
    log = dr.read(tmp_path / "log.csv", action="dose", reward="gain", ignore="id", group="who")
    known = dataclasses.asdict(log.provenance)
    known["extra"] = dict(known["extra"]) | ({"horizon": 3} if of == "converted" else {})
    known["path"] = {"converted": str(tmp_path / "log.parquet"), "frame": None}.get(of, known["path"])
    folder = Folder(write_run(tmp_path / "runs" / "cross" / "fold1", "bc", task=None))
    config = folder.read_config()
    held = {"share": 0.2, "by": "who", "seed": 0, **HELD} | ({"fold": 1, "folds": 5} if of == "fold" else {})
    config["data"] |= {"provenance": json.loads(json.dumps(known, default=str)), "name": "log", "holdout": held}
    write_json(folder.config, config)
    [entry] = read([folder.path]).entries
    text, page = command(entry), render(read([folder.path]))
    where = {"converted": tmp_path / "log.parquet", "frame": "log"}.get(of, tmp_path / "log-schema.toml")
    cut = "--horizon 3 " if of == "converted" else ""
    assert text.startswith(f"deadreckon train --agent bc --data {where} {cut}--steps 200 ")
    assert "--holdout" not in text  # by groups, as where nobody says otherwise
    assert ("--cross-fit 5" in text) == (of == "fold")
    assert text.endswith(f"--out {folder.path.parent if of == 'fold' else folder.path}")
    assert ("The table was a data frame" in page) == (of == "frame")
    assert ("log-schema.toml, to be put beside the table" in page) == (of in ("table", "fold"))
    if of == "table":
        file, columns = schema_file(entry)
        file.write_text(columns)
        assert dr.read(file).fingerprint == log.fingerprint


@pytest.mark.parametrize("name", ["maze2d-umaze", "maze2d-medium", "maze2d-large"])
def test_maze_free_cells_are_drawn_free(name):
    task = registry.task(name)
    svg = maze.picture(task, [task.cells - 0.2], [0], "t", True)
    blocks = np.array(re.findall(r"M([-\d.]+) ([-\d.]+)h60", svg), float)
    drawn = re.search(r'd="([^"]*)" class="way', svg)[1]
    points = np.array(re.findall(r"[ML]([-\d.]+) ([-\d.]+)", drawn), float)
    assert len(points) == len(task.cells)
    assert len(blocks) == len(task.walls())
    for px, py in points:  # the middle of a free cell is half a cell away from every block
        gap = np.maximum(np.abs(px - blocks[:, 0] - 30), np.abs(py - blocks[:, 1] - 30)).min()
        assert gap == pytest.approx(60, abs=0.2)


def test_paths_break_at_resets_and_ends():
    task = registry.task(TASK)
    path = np.array([[1.0, 1.0], [1.1, 1.0], [3.0, 3.0], [3.1, 3.0], [np.nan, np.nan]])
    drawn = re.search(r'd="([^"]*)" class="way', maze.picture(task, [path], [0], "t", True))[1]
    assert (drawn.count("M"), drawn.count("L")) == (2, 2)


def test_axes_have_round_ticks():
    assert axes._nice(0.0, 100.0, 6) == [0, 20, 40, 60, 80, 100]
    assert axes._nice(-0.013, 0.021, 6) == [-0.01, 0.0, 0.01, 0.02]
    assert axes._decades(-5.0, 3e7)[-1] == 1e6
    assert number(1234567.0) == "1.23e6"
    assert number(-0.25) == "\N{MINUS SIGN}0.250"
    assert number(None) == "\N{EM DASH}"


def test_space_time_diagram():
    """Two cars on a ring of 100 m: one at 1 m/s that comes round once, one that stands and leaves after half of the time."""
    place = np.full((60, 2, 2), np.nan)
    place[:, 0, 0], place[:, 0, 1] = (50.0 + np.arange(60)) % 100.0, 1.0
    place[:30, 1] = [99.0, 0.0]
    drawn = spacetime.spacetime(place, 1.0, [0], "two cars")
    paths = {name: d for d, name in re.findall(r'<path d="([^"h]+)" class="car (\w+)"', drawn)}  # an h is in the legend's
    assert set(paths) == {"own", "speed0", "speed1"}
    assert paths["own"] == paths["speed1"]
    assert paths["own"].count("M") == 2  # broken where it comes round
    assert paths["own"].count("L") == 58
    assert len({y for _, y in re.findall(r"[ML]([\d.]+) ([\d.]+)", paths["speed0"])}) == 1
    assert paths["speed0"].count("L") == 29
    assert "nothing" in spacetime.spacetime(np.full((3, 1, 2), np.nan), 1.0, [], "none")


@pytest.mark.parametrize("name", ["maze2d-medium", "antmaze-medium-play"])
def test_visits_are_counted_where_they_were(name):
    task = registry.task(name)
    middles = task.middles(task.cells)
    found = maze.visits(task, np.concatenate([middles, middles[:3], (task.walls()[:2, :2] + task.walls()[:2, 2:]) / 2]))
    assert found.shape == (8 * maze.BINS, 8 * maze.BINS)
    assert found.sum() == len(task.cells) + 3  # none in walls
    squares = np.argwhere(found) // maze.BINS
    np.testing.assert_array_equal(squares, task.cells)
    np.testing.assert_array_equal(found[found > 0], [2, 2, 2, *[1] * (len(task.cells) - 3)])
    drawn = maze.density(task, found, "t")
    assert drawn.count("v10h-10Z") == len(task.cells)


def test_an_ant_maze_is_drawn_as_its_layout_is_written():
    task = registry.task("antmaze-umaze")
    svg = maze.picture(task, [np.array([[0.0, 0.0], [8.0, 0.0]])], [0], "t", True)
    start = re.search(r'cx="([\d.]+)" cy="([\d.]+)" r="5.5"', svg).groups()
    finish = re.search(r'cx="([\d.]+)" cy="([\d.]+)" r="3.5"', svg).groups()
    # From the top left free cell two cells to the right.
    assert [float(x) for x in start] == [48.0, 48.0]
    assert [float(x) for x in finish] == [168.0, 48.0]


@pytest.mark.parametrize(("log", "again"), [("maze2d-umaze-v1@dr1", True), ("walker-stand-full-replay-v0@dr1", False)])
def test_a_log_without_an_original_is_not_called_collected_again(log, again, tmp_path):
    text = write([write_run(tmp_path / "run", name=log)], tmp_path / "page.html").read_text()
    assert (f"{log}</code>: collected again by this package" in text) is again
    assert (f"{log}</code>: collected by this package; there is no original." in text) is not again


def test_the_page_says_what_the_policy_sees_and_what_was_held_out(tmp_path):
    folder = Folder(write_run(tmp_path / "run", "bc"))
    config = folder.read_config() | {"encoder": "drq", "shift": 2}
    config["data"]["holdout"] = {"share": 0.25, "by": "user", "seed": 3, "held": 1200, "learning": 3600}
    write_json(folder.config, config)
    text = write([folder.path], tmp_path / "page.html").read_text()
    assert "<dd>encoder drq, random shifts of up to 2 pixels during training</dd>" in text
    assert "<dd>1,200 episodes, 0.25 of all, by user, seed 3</dd>" in text
