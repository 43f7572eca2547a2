"""Reads damaged files of every format, for hours: `make fuzz`.

    python -m tests.fuzz --inputs 100000           # so many more, shared among the formats
    python -m tests.fuzz --for 2h                  # or for so long
    python -m tests.fuzz --only hdf5 pickle        # these formats alone
    python -m tests.fuzz --again                   # only those that have failed, by today's code: which are fixed?
    python -m tests.fuzz --report                  # what all runs so far have found
    python -m tests.fuzz --results evidence/fuzz.json   # counts are kept in this file, which can be committed

Inputs follow from their numbers, and what is done is kept in `.cache/fuzz` or in the file of results, so that a run goes on
where the last one ended.
The first three inputs of every kind of failure are kept in `tests/fuzz/corpus`, which the tests read.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from deadreckon.files import replacing
from deadreckon.runs.durations import seconds_of
from tests.fuzz import records
from tests.fuzz.engine import Block, Worker
from tests.fuzz.targets import TARGETS

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(__file__).parent / "corpus"
BLOCK = 200  # inputs that a worker is given at once


def main() -> int:
    """The command; 1 where there were failures."""
    parser = argparse.ArgumentParser(description="Reads damaged files of every format.")
    parser.add_argument("--inputs", type=int, default=None, help="how many, over all formats; default 20,000")
    parser.add_argument("--for", dest="time", type=seconds_of, default=None, help="for how long at most, such as 90s or 2h")
    parser.add_argument("--only", nargs="*", default=None, choices=sorted(TARGETS), help="formats; default all")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--folder", type=Path, default=ROOT / ".cache" / "fuzz", help="where what is done is kept")
    parser.add_argument("--results", type=Path, default=None, help="the file that counts what is done; default in the folder")
    parser.add_argument("--no-corpus", action="store_true", help="keeps failures in the folder alone")
    parser.add_argument("--again", action="store_true", help="reads those inputs again that have failed, and no others")
    parser.add_argument("--report", action="store_true", help="shows what was found so far, and reads nothing")
    asked = parser.parse_args()
    os.nice(19)
    asked.folder.mkdir(parents=True, exist_ok=True)
    path = asked.results or asked.folder / "state.json"
    state: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    if asked.again:
        _again(asked.folder, path, state)
    elif not asked.report:
        most = asked.inputs or (10**12 if asked.time else 20_000)
        corpus = asked.folder / "corpus" if asked.no_corpus else CORPUS
        _fuzz(asked.only or list(TARGETS), most, asked.time or 1e12, asked.workers, asked.folder, path, state, corpus)
    return _report(state)


def _fuzz(
    names: list[str], most: int, seconds: float, workers: int, folder: Path, path: Path, state: dict[str, Any], corpus: Path
) -> None:
    trained = folder / "trained"
    if any(TARGETS[name].trained for name in names):
        records.trained(trained)
    for name in names:
        state.setdefault(name, {"next": 0, "read": 0, "refused": 0, "failed": 0, "kinds": {}, "seconds": 0.0})
    until, given, shown = time.time() + seconds, 0, time.time()
    pool = [Worker(trained, folder / f"beat{i}") for i in range(workers)]
    waiting: list[Block] = [(name, int(path.stem), 1) for name in names for path in sorted(CORPUS.glob(f"{name}/*.json"))]
    kept = set(waiting)  # which are read in every run, and counted only where they fail
    spent = dict.fromkeys(names, 0.0)  # seconds so far over their share: slow formats get fewer inputs, not more time
    try:
        while True:
            for worker in pool:
                if worker.block is not None and (answer := worker.poll()) is not None:
                    waiting += _noted(state, worker, answer, corpus, counted=worker.asked not in kept)
                    _save(path, state)
                if worker.block is None and (waiting or (given < most and time.time() < until)):
                    if waiting:
                        block = waiting.pop()
                    else:
                        name = min(names, key=lambda each: spent[each])
                        count = min(BLOCK, most - given)
                        block = name, state[name]["next"], count
                        state[name]["next"] += count
                        rate = (state[name]["next"] - count) / max(state[name]["seconds"], 1.0)  # an estimate until it is back
                        spent[name] += count / max(rate, 20.0) / TARGETS[name].share
                        given += count
                    worker.send(*block)
            if all(worker.block is None for worker in pool):
                break
            if time.time() - shown > 60:
                shown = time.time()
                done = sum(state[name][kind] for name in names for kind in ("read", "refused", "failed"))
                print(f"{done:,} inputs", flush=True)
            time.sleep(0.01)
    finally:
        for worker in pool:
            worker.close()


def _again(folder: Path, path: Path, state: dict[str, Any]) -> None:
    """Reads inputs that have failed once more; those that are read or refused now count as that, and as fixed."""
    worker = Worker(folder / "trained", folder / "beat-again")
    try:
        for name, own in state.items():
            for what, numbers in list(own["kinds"].items()):
                for number in list(numbers):
                    worker.send(name, number, 1)
                    while (answer := worker.poll()) is None:
                        time.sleep(0.01)
                    counts = answer["counts"]
                    if not counts["failed"]:
                        numbers.remove(number)
                        own["failed"] -= 1
                        own["fixed"] = own.get("fixed", 0) + 1
                        own["read"] += counts["read"]
                        own["refused"] += counts["refused"]
                if not numbers:
                    del own["kinds"][what]
    finally:
        worker.close()
    _save(path, state)


def _save(path: Path, state: dict[str, Any]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(state, indent=1) + "\n")


def _noted(state: dict[str, Any], worker: Worker, answer: dict[str, Any], corpus: Path, counted: bool) -> list[Block]:
    """Counts an answer, keeps its failures, and gives what of its block is still to be done."""
    own = state[worker.name]
    own["seconds"] += time.time() - worker.began
    for kind, count in answer["counts"].items():
        own[kind] += count if counted or kind == "failed" else 0
    for each in answer["failed"]:
        kinds = own["kinds"].setdefault(each["what"], [])
        kinds.append(each["number"])
        if len(kinds) <= 3:
            keep(corpus, worker.name, each)
            print(f"{worker.name} {each['number']}: {each['what']}", flush=True)
    return [block for block in (answer.get("again"), answer.get("rest")) if block and block[2] > 0]


def keep(corpus: Path, name: str, failure: dict[str, Any]) -> None:
    """Puts a failed input into the corpus: its number and, because fuzzers change, its content where that is small."""
    path = corpus / name / f"{failure['number']}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({key: value for key, value in failure.items() if key != "told"}, indent=1) + "\n")
    if "told" in failure:
        traces = path.parent / "told"
        traces.mkdir(exist_ok=True)
        (traces / f"{failure['number']}.txt").write_text(failure["told"])


def _report(state: dict[str, Any]) -> int:
    print(table(state))
    for name, own in state.items():
        for what, numbers in sorted(own["kinds"].items(), key=lambda each: -len(each[1])):
            print(f"  {name}: {len(numbers)} x {what}, such as input {numbers[0]}")
    return 1 if any(own["failed"] for own in state.values()) else 0


def table(state: dict[str, Any]) -> str:
    """Counts by format, in Markdown, as docs/reliability.md has them."""
    kinds = ("read", "refused", "failed", "fixed")
    lines = [f"| {'format':<12} | {'inputs':>10} | " + " | ".join(f"{each:>9}" for each in kinds) + " |", "|---|" + "---:|" * 5]
    total = {kind: sum(own.get(kind, 0) for own in state.values()) for kind in kinds}
    for name, own in [*state.items(), ("all", total)]:
        count = own["read"] + own["refused"] + own["failed"]
        lines.append(f"| {name:<12} | {count:>10,} | " + " | ".join(f"{own.get(kind, 0):>9,}" for kind in kinds) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
