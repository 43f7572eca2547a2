"""Suites of one's own functions: what they may return, and tables, queues and pages of them."""

import csv
import io
import json
import math

import numpy as np
import pytest

from deadreckon.bench.jobs import programs
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import read
from deadreckon.bench.tables import tables
from deadreckon.bench.work import perform
from deadreckon.cli.bench import _page
from deadreckon.cli.main import main
from deadreckon.errors import UserError
from deadreckon.imports import trust

STUDY = '''kind = "study"
seeds = 2
cases = ["a"]
[methods]
A = {{ agent = "tests.bench.test_studies:{}" }}
[metrics]
error = {{ words = "mean error", higher = false }}
[full]
seeds = 3
'''

RETURNED = {
    "nothing": None, "listed": [1.0], "text": {"error": "0.5"}, "array": {"error": np.zeros(2)}, "number": {3: 0.5},
}  # fmt: skip


def gives(name):
    return lambda case, *, seed: RETURNED[name]


nothing, listed, text, array, number = map(gives, RETURNED)


def right(case, *, seed):
    return {"error": np.float32(seed), "more": True}


def endless(case, *, seed):
    return {"error": math.inf if seed else 1.0}


@pytest.fixture
def suite(tmp_path):
    """A function that writes a study of one of the functions above."""
    trust("tests.bench.test_studies")

    def write(name, file="study.toml", **changes):
        said = STUDY.format(name)
        for old, new in changes.items():
            said = said.replace(old, new)
        (tmp_path / file).write_text(said)
        return tmp_path / file

    return write


def done(path, store):
    jobs = plan(read(path))
    for program in programs(jobs):
        for job, result in zip(program.jobs, perform(program, store.folder(program))):
            store.keep(job, result)
    return jobs


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nothing", "nothing must return numbers by name, such as {'error': 0.5}, got None"),
        ("listed", r"listed must return numbers by name, such as {'error': 0.5}, got \[1.0\]"),
        ("text", "text must return numbers by name; 'error' is '0.5'"),
        ("array", r"array must return numbers by name; 'error' is array\(\[0., 0.\]\)"),
        ("number", "number must return numbers by name; 3 is 0.5"),
    ],
)
def test_what_is_no_dictionary_of_numbers_is_refused_by_name(suite, tmp_path, name, said):
    with pytest.raises(UserError, match=said):
        done(suite(name), Store(tmp_path / "out"))


def test_a_metric_that_no_method_returns_is_refused_once_there_are_results(suite, tmp_path):
    store = Store(tmp_path / "out")
    path = suite("right", error="eror")
    assert np.isnan(tables(read(path), plan(read(path)), store)[0].cells["A"]["a"].scores).all()  # nothing is known yet
    jobs = done(path, store)
    with pytest.raises(UserError, match="study: no method returns unknown metric 'eror': did you mean error"):
        tables(read(path), jobs, store)


def test_numbers_of_numpy_and_truth_values_are_numbers(suite, tmp_path, capsys):
    path, store = suite("right"), Store(tmp_path / "out")
    [found] = tables(read(path), done(path, store), store)
    assert list(found.cells["A"]["a"].scores) == [0.0, 1.0]
    assert main(["bench", "show", str(path), "--out", str(store.path), "--trust", "tests.bench.test_studies"]) == 0
    assert "mean error, less is better" in capsys.readouterr().out  # of a single table, too


def test_rows_name_the_processor_which_is_no_part_of_a_cell(suite, tmp_path, monkeypatch):
    path, rows = suite("right"), []
    for model in ("first", "second"):
        monkeypatch.setattr("deadreckon.bench.work.cpu_model", lambda model=model: model)
        store = Store(tmp_path / model)
        [shown] = tables(read(path), done(path, store), store)
        assert any(line.startswith("made with ") and line.endswith(f", cpu {model}") for line in shown.notes)
        rows.append(store.results().to_pylist())
    assert [json.loads(row["versions"])["cpu"] for own in rows for row in own] == ["first", "first", "second", "second"]
    assert [row["cell"] for row in rows[0]] == [row["cell"] for row in rows[1]]


def test_a_queue_is_one_table_of_csv(suite, tmp_path, capsys):
    out = Store(tmp_path / "out")
    for name, file in (("right", "one.toml"), ("endless", "two.toml")):
        done(suite(name, file), out)
    (tmp_path / "queue.toml").write_text('suites = ["one.toml", "two.toml"]\n')
    words = ["bench", "show", str(tmp_path / "queue.toml"), "--out", str(out.path), "--trust", "tests.bench.test_studies"]
    assert main([*words, "--format", "csv"]) == 0
    one, two = csv.DictReader(io.StringIO(capsys.readouterr().out))
    assert (one["suite"], one["metric"], float(one["mean"])) == ("one", "error", 0.5)
    assert (two["suite"], two["mean"], two["failed"]) == ("two", "", "1")  # a mean with an infinity is none
    assert main(words) == 0
    assert "\none\n" in capsys.readouterr().out  # a suite that does not say what it is about


@pytest.mark.slow
def test_pages_of_the_full_size_leave_those_of_the_other(suite, tmp_path):
    path = suite("right")
    words = ["bench", str(path), "--out", str(tmp_path / "out"), "--trust", "tests.bench.test_studies", "--workers", "1"]
    assert main(words) == 0
    before = (tmp_path / "out" / "reports" / "study.html").read_bytes()
    assert main([*words, "--full"]) == 0
    assert (tmp_path / "out" / "reports" / "study.html").read_bytes() == before
    assert (tmp_path / "out" / "reports" / "study-full.html").exists()


def test_the_full_size_has_a_page_of_its_own(suite, tmp_path):
    of, store = read(suite("right")), Store(tmp_path / "out")
    assert [_page(of, plan(of), store, full).name for full in (False, True)] == ["study.html", "study-full.html"]


def test_what_cannot_be_planned_is_told_with_suite_and_method(tmp_path):
    (tmp_path / "mine.toml").write_text('logs = ["hopper-medium-v2"]\n[methods]\nfirst = { agent = "bcc" }\n')
    with pytest.raises(UserError, match="mine, method 'first' on hopper-medium-v2: unknown agent 'bcc'"):
        plan(read(tmp_path / "mine.toml"))
    (tmp_path / "mine.toml").rename(tmp_path / "unknown.toml")
    with pytest.raises(UserError, match="unknown, method 'first' on hopper-medium-v2: unknown agent 'bcc'"):
        plan(read(tmp_path / "unknown.toml"))
