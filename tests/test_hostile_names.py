"""Names from outside are never paths: whatever things are called, nothing beside the folder of the output comes or changes."""

import contextlib
import dataclasses
import pickle
import re
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv, parquet

import deadreckon as dr
from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.suite import read as read_suite
from deadreckon.cli import bench as bench_command
from deadreckon.data import catalogue
from deadreckon.data.formats.io import _writer, convert, read
from deadreckon.data.formats.minari_ids import checked_id
from deadreckon.data.schema import Column, Schema, toml_value
from deadreckon.errors import UserError
from deadreckon.files import write_json
from tests.hostile import FEW, NAMES, PLAIN, Hub, HubClient, Wandb, place, told  # noqa: F401 - a fixture
from tests.report.run_folders import write_run

ROWS = 12
COLUMNS = {
    "observations": np.zeros((ROWS, 2), np.float32), "actions": np.zeros((ROWS, 1), np.float32),
    "rewards": np.ones(ROWS, np.float32), "timeouts": np.arange(ROWS) % 4 == 3,
}  # fmt: skip
ENDINGS = ("", ".hdf5", ".npz", ".parquet", ".csv")  # of logs that are written


SAID: list[str] = []  # why names were refused, in the test that runs


@contextlib.contextmanager
def refused():
    """In one line is how a name may end; nothing else may be raised."""
    try:
        yield
    except UserError as error:
        SAID.append(str(error))


def log(name: str = "log", **extra: Any) -> dr.Dataset:
    return dr.Dataset.from_arrays(**COLUMNS, name=name, **extra)


# ---- writers: each gets a hostile name and where it may write; what it refuses, it refuses by a UserError ----------------


def columns_of_a_log(name, work):
    for target in (*(f"out/log{ending}" for ending in ENDINGS), "minari:mine/log-v0"):
        with refused():
            _writer(target)(log(**{name: np.arange(float(ROWS))}), target, False)


def columns_of_a_strangers_file(name, work):
    columns = {**COLUMNS, name: np.arange(ROWS)}
    table = {"observation": np.arange(12.0), "action": np.arange(12.0), "reward": np.ones(12), name: np.arange(12)}
    evil = Path("evil")
    with evil.with_suffix(".npz").open("wb") as file:
        np.savez(file, **{key: columns[key] for key in columns if key not in ("", "\ud800")})
    evil.with_suffix(".pkl").write_bytes(pickle.dumps(columns))
    if name.isprintable():
        parquet.write_table(pa.table(table), evil.with_suffix(".parquet"))
    if "\ud800" not in name:
        csv.write_csv(pa.table(table), evil.with_suffix(".csv"))
    for source in list(work.glob("evil.*")):
        for ending in ENDINGS:
            with refused():
                convert(source, f"out/{source.suffix[1:]}{ending}")


def headers_of_logs(name, work):
    for ending in (".npz", ".hdf5", ".parquet", ""):
        with refused():
            _writer(f"out/log{ending}")(log(name), f"out/log{ending}", False)
            found = read(f"out/log{ending}")
            assert found.name == name
            for target in ("", ".npz"):
                convert(f"out/log{ending}", f"out/again{ending[1:]}{target}")


def names_of_data_sets(name, work):
    for given in (name, f"{name}@dr1", f"minari:{name}", f"minari:{name}-v0", f"{name}/log-v0", f"maze2d-umaze-v1@{name}"):
        for use in (catalogue.load, catalogue.cached_path, dr.collect_log):
            with refused():
                use(given)
        with refused():
            _writer("minari:x-v0")(log(), given if given.startswith("minari:") else f"minari:{given}", True)


def names_of_tables_and_problems(name, work):
    from deadreckon.data.samples import get_sample
    from deadreckon.mbo.problems.download import get
    from deadreckon.policies.library import about

    for use in (get_sample, get, about, lambda given: get_sample("open-bandit-random-all", out=f"gone/{given}")):
        with refused():
            use(name)


def schemas(name, work):
    schema = Schema((Column(name, "reward", doubt=name, reason=f"called {name}"),))
    with refused():
        schema.save("out/schema.toml", about=name)
        assert [column.name for column in Schema.load("out/schema.toml").columns] == [name]
    with refused():
        found = Schema((), {"path": name}).file_beside("out/schema.toml")
        assert found.resolve().is_relative_to((work / "out").resolve())


def designs(name, work):
    from deadreckon.mbo import designer
    from deadreckon.mbo.designs import Designs
    from deadreckon.mbo.nn_distance import nn_distance
    from deadreckon.report.design import write_design

    table = {name: np.arange(12.0), "b": [name, "b", "c"] * 4, "y": np.arange(12.0)}
    with refused():
        data = Designs.from_frame(table, "y", name=name)
        made = designer("random").propose(data, 4, seed=0, out="out/fits")
        data.write("out/proposals.csv", made.x)
        write_design(data, made, nn_distance(data, made.x), "out/report.html")


def designers_and_problems(name, work):
    from deadreckon.mbo import designer, problem
    from deadreckon.mbo.protocol import evaluate_designers

    found = problem("branin", rows=20)
    with refused():
        evaluate_designers(dataclasses.replace(found, name=name), [(name, designer("best"))], 2, seeds=[0], out="out")


SUITE = """kind = "study"
seeds = 1
{ledger}
cases = [{case}, "other"]
[methods]
{method} = {{ agent = "tests.test_hostile_names:counted" }}
[metrics]
value = {{ words = "a value" }}
"""


def counted(case, *, seed):
    return {"value": 1.0}


def suites(name, work):
    text = toml_value(name) if "\ud800" not in name else '"x"'
    for ledger in ("", 'ledger = "ledger"', f"ledger = {text}"):
        Path("suite.toml").write_text(SUITE.format(ledger=ledger, case=text, method=text), encoding="utf-8")
        with refused():
            suite = read_suite("suite.toml")
            suite = dataclasses.replace(suite, name=name.encode(errors="replace").decode())
            store, jobs = store_of([suite], Path("out")), plan(suite)
            for job in jobs:
                store.fail(job, name, name)
                row = {
                    "seed": 0,
                    "score": 1.0,
                    "raw": 1.0,
                    "steps": 0,
                    "seconds": 1.0,
                    "failure": "",
                    "more": '{"value": 1.0}',
                    "versions": "{}",
                }
                store.keep(job, JobResult([row], []), run=name.encode(errors="replace").decode())
            bench_command._page(suite, jobs, store)


def pages(name, work):
    for folder, given in (("a", {"agent": name, "name": "plain"}), ("b", {"agent": "bc", "name": name})):
        with refused():
            run = write_run(work / "out" / folder, task=None, **given)
            dr.report.write([run], "out/report.html", title=name)


def trackers(name, work):
    from deadreckon.runs.folder import Folder
    from deadreckon.runs.trackers.feed import Tracking
    from deadreckon.runs.trackers.tensorboard import TensorBoard
    from deadreckon.runs.trackers.wandb_runs import WandB

    run = write_run(work / "out" / "run", "bc", task=None, seeds=1, name=name)
    for known in ({}, {"id": name}, {"id": 3}):
        if known:
            write_json(run / "track.json", known)
        tracking = Tracking(Folder(run), [TensorBoard(), WandB()])
        with refused():
            tracking.start()
        tracking.finish([])


def repositories(name, work):
    for repo in (name, f"datasets/{name}", f"me/{name}"):
        with refused():
            dr.from_hub(repo)
        with refused():
            dr.from_hub("me/mine", revision=name)


def the_hubs_answers(name, work):
    """What a repository says of itself: its commit, and the files that it lists."""
    for kind, commit, listed in (
        ("policy", name, "policy.npz"),
        *((kind, "c0ffee", name) for kind in ("log", "run", "policy")),
    ):
        with mock.patch.multiple(Hub, kind=kind, commit=commit, listed=listed), refused():
            dr.from_hub("datasets/me/mine")


WRITERS = [
    columns_of_a_log, columns_of_a_strangers_file, headers_of_logs, names_of_data_sets, names_of_tables_and_problems, schemas,
    designs, designers_and_problems, suites, pages, trackers, repositories, the_hubs_answers,
]  # fmt: skip


# What writers that ask for a thing of that name say whatever the name: here is nothing that is called so.
ANYHOW = {
    names_of_data_sets: "no file |unknown (recipe|version) |is no Minari id|no Minari data set |not the name of a log",
    names_of_tables_and_problems: "unknown (table|problem) |there are no policies of |there is no folder gone",
    trackers: "id must be a text, got 3",
    repositories: "cannot be read as a policy file",
    the_hubs_answers: "cannot be read as a policy file|which a (log|run|policy) does not have",
}

CASES = [(write, name) for write in WRITERS for name in (*NAMES, PLAIN)]
# All names and all writers are among the fast ones, with what is worst for each; the rest of the product is slow.
QUICK = {case for i, case in enumerate(CASES) if case[1] in (*FEW, PLAIN) or i % len(WRITERS) == 0}


@pytest.mark.parametrize(
    ("write", "name"),
    [
        pytest.param(*case, id=f"{case[0].__name__}-{told(case[1])}", marks=() if case in QUICK else pytest.mark.slow)
        for case in CASES
    ],
)
def test_no_name_leads_out_of_the_folder(write, name, place, monkeypatch):  # noqa: F811
    monkeypatch.setitem(sys.modules, "huggingface_hub", HubClient("huggingface_hub"))
    monkeypatch.setitem(sys.modules, "wandb", Wandb("wandb"))
    SAID.clear()
    with place.attacked(refused=name != PLAIN):
        write(place.name(name), place.work)
    if name == PLAIN:
        assert [text for text in SAID if write not in ANYHOW or not re.search(ANYHOW[write], text)] == []
        assert place.written() or write is names_of_tables_and_problems


def test_every_name_and_at_least_a_hundred_attacks_are_tried_fast():
    assert len(QUICK) > 100
    assert {name for _, name in QUICK} == {*NAMES, PLAIN}


def test_names_of_logs_are_files_of_their_folder(place):  # noqa: F811
    taken = []
    for name in (*NAMES, PLAIN):
        with refused():
            found = catalogue.cached_path(place.name(name))
            assert found.parent == place.work / "home" / "data"
            assert found.name == f"{name}.hdf5"
            taken.append(name)
    assert taken == [".hidden", *(name for name in NAMES[NAMES.index("-rf") :] if "/" not in name), PLAIN]
    for name in ("con/log-v0", f"{'x' * 300}/log-v0", "mine//log-v0"):
        with pytest.raises(UserError, match="is no Minari id"):
            checked_id(name)
    assert checked_id("mine/far/log-v0") == "mine/far/log-v0"


def test_the_name_of_a_suites_file_is_one_that_its_results_can_hold(place):  # noqa: F811
    text = SUITE.format(ledger="", case='"a"', method='"b"')
    for name in ("half\udcff.toml", "\x1b[2J.toml", "dot..toml"):
        Path(name).write_text(text)
        with pytest.raises(UserError, match="so no file can be called that"):
            read_suite(name)


def test_a_row_of_results_names_a_run_of_its_own_folder(tmp_path):
    store = Store(tmp_path)
    assert store.run_of({"job": "bc-hopper"}) == tmp_path / "runs" / "bc-hopper"
    assert store.run_of({"job": "bc-3_logs/bc-hopper"}) == tmp_path / "runs" / "bc-3_logs" / "bc-hopper"
    for job in ("../../elsewhere", "bc/../../elsewhere", "/etc", ""):
        with pytest.raises(UserError, match="so no file can be called that"):
            store.run_of({"job": job})


def test_a_trackers_id_deletes_no_other_runs(place, monkeypatch):  # noqa: F811
    """W&B's offline runs of the id are written anew: an id that is a pattern, or a path, would take others along."""
    from deadreckon.runs.folder import Folder
    from deadreckon.runs.trackers.feed import Tracking
    from deadreckon.runs.trackers.wandb_runs import WandB

    monkeypatch.setitem(sys.modules, "wandb", Wandb("wandb"))
    run = write_run(place.work / "out" / "run", "bc", task=None, seeds=1)
    kept = [run / "wandb" / "offline-run-1-other-seed0", place.root / "one" / "two" / "x-seed0"]
    for folder in kept:
        folder.mkdir(parents=True)
    (run / "wandb" / "offline-run-1-..").mkdir()  # through which a path would lead
    for bad in ("*", "*/../../../../../x", "[a-z]*"):
        write_json(run / "track.json", {"id": bad})
        tracking = Tracking(Folder(run), [WandB()])
        with refused():
            tracking.start()
        tracking.finish([])
        assert all(folder.exists() for folder in kept)
