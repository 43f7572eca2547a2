"""What is fuzzed: for each format its sound files, how they are damaged, and all that the package does with such a file."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.errors import UserError
from tests.fuzz import mutate, records, seeds
from tests.fuzz.hdf5 import hdf5
from tests.fuzz.mutate import Mutation
from tests.fuzz.pickles import pickled
from tests.fuzz.seeds import Files
from tests.fuzz.tables import parquet


class Target(NamedTuple):
    """A format.

    Attributes:
        sound: its sound files; takes the folder of what was trained, where `trained` is true.
        read: reads what lies in a folder.
        damage: by the ending of a file's name, "" for the rest; files whose ending is not here are left as they are.
        share: of the time of a run, relative to those of the others.
        trained: whether its sound files come from a training.
    """

    sound: Callable[[Path], list[Files]]
    read: Callable[[Path], Any]
    damage: dict[str, Mutation]
    share: float = 1.0
    trained: bool = False


def _log(name: str) -> Callable[[Path], Any]:
    from deadreckon.data.formats.io import read

    return lambda folder: read(folder / name)


def _converted(name: str) -> Callable[[Path], Any]:
    from deadreckon.data.formats.io import convert

    return lambda folder: convert(folder / name, folder / "converted", force=True)


def _policy(folder: Path) -> None:
    from deadreckon.policies import store
    from deadreckon.runs.player import predictor

    path = folder / "policy.npz"
    store.load_all(path)
    found = predictor(path)
    try:
        found.player(np.zeros((2, 3), np.float32), first=True)
    except ValueError as error:  # of numpy's player, which knows no `UserError`: a sound policy of other observations
        raise (UserError(str(error)) if re.match(r"an observation has \d+ numbers", str(error)) else error) from error


def _published(folder: Path) -> None:
    from deadreckon.policies.resolve import policy_of_file

    policy_of_file(folder / "policy.pkl")


def _network(folder: Path) -> None:
    from deadreckon.policies.dapg import load_dapg

    load_dapg(folder / "policy.pkl")


def _checkpoint(folder: Path) -> None:
    from deadreckon.training.checkpoint import load_arrays

    load_arrays(folder / "run" / "checkpoints" / "0000000004.npz")


def _run(folder: Path) -> None:
    from deadreckon.report.entries import read
    from deadreckon.report.page import render
    from deadreckon.runs.folder import Folder
    from deadreckon.runs.player import chosen
    from deadreckon.runs.run import load

    page, run = read([folder / "run"]), Folder(folder / "run")
    render(page)
    run.episodes("taught")
    run.check(run.read_config() | {"steps": 9}, resume=True)
    chosen(folder / "run")
    found = load(folder / "run")
    repr(found), found.metrics


def _cross(folder: Path) -> None:
    from deadreckon.runs.crossfit import load_cross_fit
    from deadreckon.runs.player import chosen

    load_cross_fit(folder / "cross")
    chosen(folder / "cross")


def _estimates(folder: Path) -> None:
    from deadreckon.report import decision, estimates
    from deadreckon.report.entries import Page, read
    from deadreckon.runs import offline
    from deadreckon.runs.player import chosen

    told = offline.read_estimates(folder / "ope")
    offline.grounds(told), offline.supports(told), offline.checked(told)
    page = Page(read([folder / "run"]).entries, told)
    estimates.section(page), decision.card(page), decision.headline(told)
    chosen(folder / "ope")


def _explained(folder: Path) -> None:
    from deadreckon.report.entries import read
    from deadreckon.report.explained import section

    section(read([folder / "run"]))


def _ledger(folder: Path) -> None:
    from deadreckon.bench import ledger

    ledger._read.cache_clear()
    ledger._results.cache_clear()
    store = ledger.Ledger(folder, folder / "cells")
    store.results(), store.curves()


def _looks(folder: Path) -> None:
    from deadreckon.runs.looks import _read

    _read(folder / "look.json")


def _recommended(folder: Path) -> None:
    from deadreckon.report.recommended import write

    write(folder, quick=True)


def _suite(folder: Path) -> None:
    from deadreckon.bench.suite import queue

    queue(folder / "suite.toml"), queue(folder / "suite.toml", full=True)


def _claims(folder: Path) -> None:
    from deadreckon.bench.claims_file import claims

    claims(folder / "claims.toml")


def _schema(folder: Path) -> None:
    from deadreckon.data.formats.io import read

    read(folder / "schema.toml")


def _design(folder: Path) -> None:
    from deadreckon.mbo.design_schema import DesignSchema

    DesignSchema.load(folder / "design.toml").options()


def _roads(folder: Path) -> None:
    from deadreckon.tasks.opendrive import read_xodr, write_xodr

    network = read_xodr(folder / "map.xodr")
    write_xodr(network, folder / "again.xodr")
    assert read_xodr(folder / "again.xodr") == network


_ARCHIVE = mutate.archive(mutate.of_member)
_XML = mutate.archive(lambda name: mutate.havoc)
_RUN = {"run.json": mutate.json_text, "status.json": mutate.json_text, "0000000004.parquet": parquet,
        "episodes.npz": _ARCHIVE, "/seed0.npz": _ARCHIVE}  # fmt: skip


def _only(*keep: str) -> Callable[[Path], list[Files]]:
    """Of what was trained, the files whose path begins with one of these."""
    return lambda folder: [{k: v for k, v in seeds.of_folder(folder).items() if k.startswith(keep)}]


def _with_explanation(folder: Path) -> list[Files]:
    return [{**files, **records.explained()} for files in _only("run/")(folder)]


def _made_policies(folder: Path) -> list[Files]:
    return records.policies()


TARGETS: dict[str, Target] = {
    "csv": Target(lambda _: seeds.tables("csv"), _log("log.csv"), {"": mutate.table_text}, 2.0),
    "csv.gz": Target(lambda _: seeds.tables("csv.gz"), _log("log.csv.gz"), {"": mutate.gzipped(mutate.table_text)}),
    "parquet": Target(lambda _: seeds.tables("parquet"), _log("log.parquet"), {"": parquet}),
    "arrow": Target(lambda _: seeds.tables("arrow"), _converted("log.arrow"), {"": mutate.havoc}),
    "parts": Target(lambda _: seeds.tables("parquet")[:1], _converted("log.parquet"), {"": parquet}),
    "xlsx": Target(lambda _: seeds.tables("xlsx"), _log("log.xlsx"), {"": _XML}),
    "sqlite": Target(lambda _: seeds.tables("sqlite"), _log("log.sqlite"), {"": mutate.havoc}),
    "duckdb": Target(lambda _: seeds.tables("duckdb"), _log("log.duckdb"), {"": mutate.havoc}),
    "npz": Target(lambda _: seeds.logs("npz"), _log("log.npz"), {"": _ARCHIVE}, 2.0),
    "hdf5": Target(lambda _: seeds.hdf5(), _log("log.hdf5"), {"": hdf5}, 2.0),
    "minari": Target(lambda _: seeds.minari(), _log("log"), {".json": mutate.json_text, ".hdf5": hdf5}),
    "folder": Target(lambda _: seeds.logs("folder"), _log("log"), {".json": mutate.json_text, ".npy": mutate.npy}),
    "pickle": Target(lambda _: seeds.pickles(), _log("log.pkl"), {"": pickled}, 2.0),
    "json": Target(lambda _: seeds.tables("jsonl"), _log("log.jsonl"), {"": mutate.json_lines}),
    "rllib": Target(lambda _: seeds.rllib(), _log("log.json"), {"": mutate.json_lines}),
    "vw": Target(lambda _: seeds.vw(), _log("log.vw"), {"": mutate.havoc}),
    "policy": Target(_made_policies, _policy, {"": _ARCHIVE}),
    "dope": Target(lambda _: seeds.published(), _published, {"": pickled}),
    "dapg": Target(lambda _: seeds.network(), _network, {"": pickled}),
    "suite": Target(lambda _: records.texts("suite"), _suite, {"": mutate.toml_text}),
    "claims": Target(lambda _: records.texts("claims"), _claims, {".toml": mutate.toml_text}),
    "schema": Target(lambda _: records.texts("schema"), _schema, {".toml": mutate.toml_text}),
    "design": Target(lambda _: records.texts("design"), _design, {"": mutate.toml_text}),
    "looks": Target(lambda _: records.looks(), _looks, {"": mutate.json_text}),
    "ledger": Target(lambda _: records.cells(), _ledger, {"": mutate.json_text}),
    "recommended": Target(lambda _: records.recommended(), _recommended, {"": mutate.json_text}),
    "roads": Target(lambda _: records.roads(), _roads, {"": mutate.table_text}),
    "checkpoint": Target(_only("run/checkpoints"), _checkpoint, {"0004.npz": _ARCHIVE}, trained=True),
    "run": Target(_only("run/"), _run, _RUN, trained=True),
    "crossfit": Target(_only("cross/"), _cross, {"crossfit.json": mutate.json_text}, trained=True),
    "estimates": Target(_only("ope/estimates", "run/"), _estimates, {"estimates.json": mutate.json_text}, trained=True),
    "explained": Target(_with_explanation, _explained, {"explain.json": mutate.json_text}, trained=True),
}  # fmt: skip


def damaged(target: Target, files: Files, rng: np.random.Generator) -> Files:
    """The file of a sound set that is damaged, and how it is then: {path: content}."""
    found = [(name, ending) for name in files for ending in target.damage if name.endswith(ending)]
    name, ending = mutate.pick(rng, found)
    return {name: target.damage[ending](files[name], rng)}
