"""A few seconds of fuzzing, what has failed once, and whether the fuzzer sees failures at all."""

import json
import os
import time
import zlib
from pathlib import Path

import pytest

from deadreckon.errors import UserError
from tests.fuzz import engine
from tests.fuzz.__main__ import table
from tests.fuzz.engine import Bench, Watch, Worker, attempt
from tests.fuzz.targets import TARGETS

QUICK = [name for name, target in TARGETS.items() if not target.trained]
INPUTS = 80  # of a format, and fewer of those whose readers are slow: about a third of a second each
FEWER = {"xlsx": 5, "parts": 15, "duckdb": 15, "hdf5": 20, "minari": 20, "arrow": 25, "folder": 25, "parquet": 30, "csv": 40,
         "csv.gz": 40}  # fmt: skip
CORPUS = Path(__file__).parent / "corpus"
KEPT = sorted(path for path in CORPUS.glob("*/*.json") if path.parent.name in QUICK)  # `make fuzz` begins with the others


@pytest.fixture(scope="module")
def watch(tmp_path_factory):
    """One for all tests, as hooks stay."""
    return Watch(tmp_path_factory.getbasetemp())


@pytest.fixture(scope="module")
def benches(tmp_path_factory):
    made = {}
    return lambda name: made.setdefault(name, Bench(name, Path("none"), tmp_path_factory.mktemp("fuzz")))


@pytest.mark.parametrize("name", QUICK)
def test_damaged_files_are_refused_in_one_line(name, benches, watch):
    """The same inputs on every machine."""
    bench = benches(name)
    for number in range(FEWER.get(name, INPUTS)):
        kind, failure = bench.run(number, watch)
        assert kind != "failed", f"input {number} of {name}: {failure.what}\n{failure.told}"


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_what_has_failed_once_is_refused_now(path, benches, watch):
    kept = json.loads(path.read_text())
    bench = benches(path.parent.name)
    which, files = bench.input(kept["number"])
    if "content" in kept:
        files = {kept["file"]: bytes.fromhex(kept["content"])}
    bench.lay(which, files)
    kind, what, told = attempt(lambda: bench.target.read(bench.place), watch)
    bench.mend(which, files)
    assert kind != "failed", f"{what}\n{told}"


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    """Files that hang a library cost a second, not twenty."""
    monkeypatch.setenv("DEADRECKON_MAX_SECONDS", "1")


def _raise(error):
    raise error


@pytest.mark.parametrize(
    ("does", "what"),
    [
        (lambda folder: _raise(KeyError("x")), "KeyError"),
        (lambda folder: _raise(UserError("")), "a message that is not one line"),
        (lambda folder: (folder.parent.parent / "stray").write_text("x"), "outside: writes"),
        (lambda folder: os.system("true"), "outside: os.system"),
        (lambda folder: (folder.parent / "never").unlink(missing_ok=True), "outside: os.remove"),
    ],
)
def test_failures_are_seen(does, what, tmp_path):
    folder = tmp_path / "inside"
    folder.mkdir()
    watch = Watch(folder)
    kind, found, _ = attempt(lambda: does(folder), watch)
    assert kind == "failed"
    assert found.startswith(what)


def test_inputs_follow_from_their_numbers(benches):
    for name in ("csv", "npz", "pickle", "looks", "suite"):
        bench = benches(name)
        assert bench.input(7) == bench.input(7)
        assert len({zlib.crc32(repr(bench.input(number)).encode()) for number in range(20)}) > 10


def test_a_worker_that_hangs_or_dies_costs_one_input(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "HANGS", 0.5)
    worker = Worker(tmp_path, tmp_path / "beat")

    class Process:
        returncode, pid = None, 0
        stdout = property(lambda self: self)

        def read(self):
            return None

        def kill(self):
            self.returncode = -9

        wait = kill

        def poll(self):
            return self.returncode

    worker.process, worker.block, worker.text = Process(), ("csv", 10, 5), ""
    worker.beat.write_bytes(engine._AT.pack(12, time.time() - 1.0))
    answer = worker.poll()
    assert answer["failed"][0]["what"].startswith("hang")
    assert answer["failed"][0]["number"] == 12
    assert answer["again"] == ("csv", 10, 2)
    assert answer["rest"] == ("csv", 13, 2)


def test_the_page_shows_what_the_file_of_results_counts():
    root = Path(__file__).resolve().parents[2]
    assert table(json.loads((root / "evidence" / "fuzz.json").read_text())) in (root / "docs" / "reliability.md").read_text()
