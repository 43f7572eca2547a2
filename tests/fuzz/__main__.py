"""Reads damaged files of every format, for hours: `make fuzz`.

    python -m tests.fuzz --inputs 100000           # so many more, shared among the formats
    python -m tests.fuzz --seconds 3600            # or for so long
    python -m tests.fuzz --only hdf5 pickle        # these formats alone
    python -m tests.fuzz --report                  # what all runs so far have found

Inputs follow from their numbers, and what is done is kept in `.cache/fuzz`, so that a run goes on where the last one ended.
The first three inputs of every kind of failure are kept in `tests/fuzz/corpus`, which the tests read.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from tests.fuzz import seeds
from tests.fuzz.engine import Worker
from tests.fuzz.targets import TARGETS

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(__file__).parent / "corpus"
BLOCK = 200  # inputs that a worker is given at once


def main() -> int:
    """The command; 1 where there were failures."""
    parser = argparse.ArgumentParser(description="Reads damaged files of every format.")
    parser.add_argument("--inputs", type=int, default=None, help="how many, over all formats; default 20,000")
    parser.add_argument("--seconds", type=float, default=None, help="for how long at most")
    parser.add_argument("--only", nargs="*", default=None, choices=sorted(TARGETS), help="formats; default all")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--folder", type=Path, default=ROOT / ".cache" / "fuzz", help="where what is done is kept")
    parser.add_argument("--no-corpus", action="store_true", help="keeps failures in the folder alone")
    parser.add_argument("--report", action="store_true", help="shows what was found so far, and reads nothing")
    asked = parser.parse_args()
    os.nice(19)
    asked.folder.mkdir(parents=True, exist_ok=True)
    path = asked.folder / "state.json"
    state: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    if not asked.report:
        most = asked.inputs or (10**12 if asked.seconds else 20_000)
        corpus = asked.folder / "corpus" if asked.no_corpus else CORPUS
        _fuzz(asked.only or list(TARGETS), most, asked.seconds or 1e12, asked.workers, asked.folder, state, corpus)
    return _report(state)


def _fuzz(
    names: list[str], most: int, seconds: float, workers: int, folder: Path, state: dict[str, Any], corpus: Path
) -> None:
    trained = folder / "trained"
    if any(TARGETS[name].trained for name in names):
        seeds.trained(trained)
    for name in names:
        state.setdefault(name, {"next": 0, "read": 0, "refused": 0, "failed": 0, "kinds": {}, "seconds": 0.0})
    until, given, shown = time.time() + seconds, 0, time.time()
    pool = [Worker(trained, folder / f"beat{i}") for i in range(workers)]
    waiting: list[tuple[str, int, int]] = []
    spent = dict.fromkeys(names, 0.0)  # seconds so far over their share: slow formats get fewer inputs, not more time
    try:
        while True:
            for worker in pool:
                if worker.block is not None and (answer := worker.poll()) is not None:
                    waiting += _noted(state, worker, answer, corpus, trained)
                    (folder / "state.new").write_text(json.dumps(state))
                    (folder / "state.new").replace(folder / "state.json")
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
                    worker.began = time.time()  # type: ignore[attr-defined]
                    worker.of = block[0]  # type: ignore[attr-defined]
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


def _noted(state: dict[str, Any], worker: Any, answer: dict[str, Any], corpus: Path, trained: Path) -> list[tuple[str, int, int]]:
    """Counts an answer, keeps its failures, and gives what of its block is still to be done."""
    own = state[worker.of]
    own["seconds"] += time.time() - worker.began
    for kind, count in answer["counts"].items():
        own[kind] += count
    for each in answer["failed"]:
        kinds = own["kinds"].setdefault(each["what"], [])
        kinds.append(each["number"])
        if len(kinds) <= 3:
            keep(corpus, worker.of, each)
            print(f"{worker.of} {each['number']}: {each['what']}", flush=True)
    return [tuple(block) for block in (answer.get("again"), answer.get("rest")) if block and block[2] > 0]


def keep(corpus: Path, name: str, failure: dict[str, Any]) -> None:
    """Puts a failed input into the corpus: its number, and where it is known its content, which outlives changes of the fuzzer."""
    path = corpus / name / f"{failure['number']}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({key: value for key, value in failure.items() if key != "told"}, indent=1) + "\n")
    if "told" in failure:
        traces = path.parent / "told"
        traces.mkdir(exist_ok=True)
        (traces / f"{failure['number']}.txt").write_text(failure["told"])


def _report(state: dict[str, Any]) -> int:
    print(f"{'format':<12} {'inputs':>10} {'read':>10} {'refused':>10} {'failed':>8} {'a second':>9}")
    total = dict.fromkeys(("read", "refused", "failed"), 0)
    for name, own in state.items():
        count = sum(own[kind] for kind in total)
        total = {kind: total[kind] + own[kind] for kind in total}
        rate = count / max(own["seconds"], 1e-9)
        print(f"{name:<12} {count:>10,} {own['read']:>10,} {own['refused']:>10,} {own['failed']:>8,} {rate:>9,.0f}")
    print(f"{'all':<12} {sum(total.values()):>10,} " + " ".join(f"{each:>10,}" for each in total.values()))
    for name, own in state.items():
        for what, numbers in sorted(own["kinds"].items(), key=lambda each: -len(each[1])):
            print(f"  {name}: {len(numbers)} x {what}, such as input {numbers[0]}")
    return 1 if total["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
