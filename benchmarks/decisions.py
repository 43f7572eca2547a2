"""Whether a decision card can be trusted: `python benchmarks/decisions.py`, then `... --table`.

Logs of many kinds whose truth is known (`decision_study`), policies learned from four fifths of each, and rules that choose
one of them or none. A trial is a family and a seed, and one small file, so what is there is not done again. Seeds of the
development split are 0, 1, ..., those of the confirmatory one 1,000,000, ..., and those of a second and a third one, for what
has changed after that, 2,000,000, ... and 3,000,000, ...; nothing is tuned on the last three.

The runner of `deadreckon bench` is not used: its jobs are cells of a suite (an agent, a log, a number of updates), and its
results count for one version of the package alone, while a log here, its policies and the old rules stay what they are when
the new rule changes.
"""

import argparse
import json
import lzma
import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
ONE_THREAD = {
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".cache" / "jax"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
}  # fmt: skip


LOGS = 100  # trials of a worker process, whose compiled programs take about 30 MB for each
MAPS = 40_000  # pieces of memory that compiled programs may take before they are forgotten; a process may have 65,530


def forget() -> None:
    """In a worker: gives compiled programs back before there are too many."""
    import jax

    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MAPS:
        jax.clear_caches()


def one(family: str, seed: int, rules: list[str], path: str) -> float:
    """In a worker: a trial, and how long it took."""
    from decision_study.trial import trial

    forget()
    began = time.perf_counter()
    trial(family, seed, rules, Path(path))
    return time.perf_counter() - began


def place(out: Path, family: str, seed: int) -> Path:
    """Where a trial's file lies."""
    return out / family / f"{seed}.json"


def unpack(record: Path, out: Path) -> None:
    """Writes the trials of a record that `out` lacks."""
    from deadreckon.files import write_json

    if record.exists():
        with lzma.open(record, "rt") as lines:
            for line in lines:
                trial = json.loads(line)
                if not (path := place(out, trial["family"], trial["seed"])).exists():
                    write_json(path, trial)


def pack(record: Path, trials: Sequence[dict[str, Any]]) -> None:
    """Writes trials as lines of JSON, compressed, with six digits: what a table needs, small enough to be kept for good."""
    from deadreckon.files import replacing

    short = lambda x: float(f"{x:.6g}") if isinstance(x, float) else x  # noqa: E731
    lines = [json.dumps(rounded(trial, short)) + "\n" for trial in trials]
    with replacing(record) as partial, lzma.open(partial, "wt") as file:
        file.writelines(lines)


def rounded(value: Any, by: Callable[[Any], Any]) -> Any:
    """`by` of all leaves of nested lists and dicts."""
    if isinstance(value, dict):
        return {name: rounded(each, by) for name, each in value.items()}
    return [rounded(each, by) for each in value] if isinstance(value, list) else by(value)


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--families", nargs="*", default=None, help="families of logs; all by default")
    add("--trials", type=int, default=100, help="logs of each family")
    splits = ["development", "confirmatory", "second", "third"]
    add("--split", choices=splits, default="development", help="which seeds, and which families")
    add("--rules", nargs="*", help="rules that decide; all but `stationary` by default; what a file has is not done again")
    add("--redo", nargs="*", default=[], help="rules that are done again because they have changed")
    add("--workers", type=int, default=2, help="processes")
    add("--out", type=Path, default=Path("runs/decisions"), help="folder of the results, a file for each log")
    add("--record", type=Path, help="compressed file of results: read before anything else, and written at the end")
    add("--table", action="store_true", help="print the tables of what is there, and do nothing else")
    return parser.parse_args()


def work(options: argparse.Namespace, families: list[str], rules: list[str]) -> int:
    """All trials that are not there yet; returns how many went wrong."""
    from decision_study.trial import seeds

    from deadreckon.files import read_json, write_json

    todo = [(family, seed) for seed in seeds(options.split, options.trials) for family in families]
    # Family by family, so that what is compiled for one log serves the next.
    todo.sort(key=lambda pair: families.index(pair[0]))
    for family, seed in todo:
        if options.redo and (path := place(options.out, family, seed)).exists():
            known = read_json(path)
            if set(options.redo) & set(known["rules"]):
                known["rules"] = {rule: said for rule, said in known["rules"].items() if rule not in options.redo}
                write_json(path, known)
    began, done, wrong, seconds = time.perf_counter(), 0, 0, 0.0
    # New processes for each part: those of one pool keep all that they have compiled.
    size = LOGS * options.workers
    for part in (todo[i : i + size] for i in range(0, len(todo), size)):
        with ProcessPoolExecutor(options.workers, get_context("spawn"), initializer=os.nice, initargs=(10,)) as pool:
            waiting = {pool.submit(one, f, s, rules, str(place(options.out, f, s))): (f, s) for f, s in part}
            for each in as_completed(waiting):
                done += 1
                try:
                    seconds += each.result()
                except Exception as error:  # noqa: BLE001 - the others go on, and this one is tried again by the next command
                    wrong += 1
                    print(f"\n{waiting[each]}: {type(error).__name__}: {error}", file=sys.stderr)
                left = (time.perf_counter() - began) / done * (len(todo) - done) / 60
                words = f"\r{done:,} of {len(todo):,} logs, {seconds / done:.2f} s each, {left:.0f} min to go, {wrong} failed"
                print(words, end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return wrong


def main() -> int:
    os.environ |= ONE_THREAD  # before anything starts threads; the workers inherit it
    options = parse()
    from decision_study import FAMILIES
    from decision_study.rules import RULES
    from decision_study.summary import tables
    from decision_study.trial import FIRST

    from deadreckon.files import read_json

    confirm, first = options.split != "development", FIRST[options.split]
    families = options.families or [name for name, family in FAMILIES.items() if confirm or family.split == "development"]
    for name in families:
        if name not in FAMILIES or (FAMILIES[name].split == "confirmatory" and not confirm):
            print(f"error: no {options.split} family {name!r}; there are {', '.join(FAMILIES)}", file=sys.stderr)
            return 2
    rules = options.rules or [rule for rule in RULES if rule != "stationary"]  # which differs in few families
    if options.record is not None:
        unpack(options.record, options.out)
    wrong = 0 if options.table else work(options, families, rules)
    every = sorted(options.out.glob("*/*.json"), key=lambda path: (list(FAMILIES).index(path.parent.name), int(path.stem)))
    trials = [read_json(path) for path in every if first <= int(path.stem) < first + FIRST["confirmatory"]]
    if options.record is not None and trials and not options.table:
        pack(options.record, trials)
    if not options.table:
        return 1 if wrong else 0
    if not (trials := [trial for trial in trials if trial["family"] in families]):
        print(f"error: no {options.split} trials in {options.out}", file=sys.stderr)
        return 2
    print(tables(trials, rules, {name: family.better for name, family in FAMILIES.items()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
