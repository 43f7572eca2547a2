"""The commands that are disturbed, at sizes that take seconds, and what of their results must be the same afterwards."""

import hashlib
import json
import re
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

VOLATILE = {"seconds", "finished", "took", "told"}  # times of the clock, in JSON and in columns
TINY = ["--agent.hidden", "16", "16", "--agent.batch-size", "32"]


@dataclass(frozen=True)
class Command:
    """A command of the study.

    Attributes:
        name: in tables.
        argv: after `deadreckon`; `{inputs}` is the folder of `inputs.make`. It is the command that goes on, too.
        kept: patterns of files in `out` that are written once and never again.
        steps: pattern of checkpoints whose greatest number must never fall.
        weight: share of the kills.
        others: patterns of results whose bytes are not compared, since they hold times.
        goes_on: whether the same command goes on.
        computed: file in the command's folder with a line whenever a cell of `inputs.STUDY` is computed; `kept` are its cells.
    """

    name: str
    argv: tuple[str, ...]
    kept: tuple[str, ...] = ()
    steps: str | None = None
    weight: float = 1.0
    others: tuple[str, ...] = ("*.html", "*.seconds")
    goes_on: bool = True
    computed: str = ""

    def words(self, inputs: Path) -> list[str]:
        """The command's words."""
        return [word.replace("{inputs}", str(inputs)) for word in self.argv]


def _words(*given: Any) -> tuple[str, ...]:
    return tuple(word for part in given for word in (part if isinstance(part, list) else str(part).split()))


ROWS = "--episode episode --action dose --reward gain"
RUN = {"kept": ("evaluations/*.parquet",), "steps": "checkpoints/*.npz"}
COMMANDS = (
    Command(
        "train", _words("train --agent td3_bc", TINY, f"--data {{inputs}}/rows.csv {ROWS} --out out --steps 200"
                        " --chunk 10 --evaluate-every 50 --resume"), weight=2.0, **RUN,
    ),
    Command(
        "train, cross-fit", _words("train --agent bc", TINY, f"--data {{inputs}}/rows.csv {ROWS} --out out --steps 60"
                                   " --chunk 10 --evaluate-every 30 --cross-fit 2 --resume"), weight=0.7,
        kept=("fold*/evaluations/*.parquet",), steps="fold*/checkpoints/*.npz",
    ),
    Command(
        "train --online", _words("train --online --agent sac", TINY, "--task hopper --out out --steps 600 --copies 4"
                                 " --explore 100 --updates-per-step 0.25 --block 20 --evaluate-every 300 --episodes 1"
                                 " --chunk 20 --resume"), weight=2.0, **RUN,
    ),
    Command(
        "train --online, MBPO", _words("train --online --agent mbpo", TINY, "--task hopper --out out --steps 160 --explore 60"
                                       " --copies 2 --block 20 --evaluate-every 80 --episodes 1 --chunk 20 --resume"
                                       " --agent.model-hidden 16 --agent.members 3 --agent.elites 2 --agent.model-epochs 3"
                                       " --agent.model-train-freq 40 --agent.model-weight-decay 0 0"), weight=1.0, **RUN,
    ),
    Command("data collect", _words("data collect --task maze2d-umaze --steps 30000 --out out/log.hdf5"), weight=1.5),
    Command("data collect, recipe", _words("data collect maze2d-umaze-v1 --steps 20000 --out out/log.hdf5"), weight=0.5),
    Command("data convert", _words(f"data convert {{inputs}}/rows.csv out/log {ROWS}"), weight=0.5),
    Command(
        "ope", _words(f"ope --data {{inputs}}/rows.csv {ROWS} --policies {{inputs}}/policy --estimators fqe"
                      " --steps 60 --hidden 8 --members 2 --batch-size 32 --discount 0.9 --out out --select"),
        weight=1.5, steps="fits*/*/*.npz",
    ),
    Command(
        "design", _words("design {inputs}/designs.csv --target score --method ensemble --n 4 --out out --method.hidden 8"
                         " --method.steps 100 --method.ascent-steps 20"), weight=1.0, steps="fits/*/*.npz",
    ),
    Command("design bench", _words("design bench --problems branin,nk --methods best,random --n 8 --seeds 2 --out out"),
            weight=0.5, kept=("*/*.json",)),
    Command(
        "tune", _words("tune --agent bc --data {inputs}/log.npz --values lr=0.001,0.003 --steps 40 --seeds 1 --workers 1"
                       " --fixed hidden=[8] batch_size=16 --estimators fqe --fit.steps 60 --fit.hidden 8 --fit.batch-size 32"
                       " --discount 0.9 --out out"), weight=0.4, kept=("results/*.parquet",),
    ),
    Command("bench, local", _words("bench small.toml --workers 2 --out out"), weight=0.4,
            kept=("results/*.parquet",)),
    Command("bench, Ray", _words("bench small.toml --executor ray --out out"), weight=0.2,
            kept=("results/*.parquet",)),
    Command("bench, evidence queue", _words("bench queue.toml --workers 1 --out out --trust studies_of_tests"), weight=0.8,
            kept=("../ledger/study/*/*.json",), others=("*.html", "*.seconds", "done.txt"), computed="done.txt"),
    Command("recommend", _words(f"recommend {{inputs}}/rows.csv --budget 15s {ROWS} --out out"), weight=0.2, goes_on=False),
)  # fmt: skip


def digests(folder: Path, others: Sequence[str] = ()) -> dict[str, str]:
    """Path -> digest of every file of results in and below a folder, without what depends on the clock.

    Args:
        folder: that a command has worked in.
        others: patterns of files of which only the names count.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_file() and not any(part.startswith(".") for part in Path(name).parts):
            found[name] = "" if any(path.match(each) for each in others) else digest(path)
    return found


def digest(path: Path) -> str:
    """Of what a file says; of one that cannot be read, since a case has damaged it, of its bytes."""
    try:
        content = _content(path)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        content = path.read_bytes()
    return hashlib.blake2b(content, digest_size=8).hexdigest()


def _content(path: Path) -> bytes:
    if path.suffix == ".json":
        return json.dumps(_timeless(json.loads(path.read_text())), sort_keys=True).encode()
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        table = table.drop_columns([name for name in table.column_names if name in VOLATILE])
        return json.dumps(_timeless(table.to_pydict()), sort_keys=True, default=str).encode()
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            parts = [(name, arrays[name]) for name in sorted(arrays.files)]
        return b"".join(f"{name} {each.dtype} {each.shape}".encode() + each.tobytes() for name, each in parts)
    return path.read_bytes()


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(each) for key, each in value.items() if key not in VOLATILE}
    return [_timeless(each) for each in value] if isinstance(value, list) else value


def finished(command: Command, out: Path) -> dict[str, tuple[int, int]]:
    """What must not be written again: path -> inode and time of the files that are finished for good."""
    newest = {path.parent.parent: step for path, step in checkpoint_steps(command, out)} if command.steps else {}
    found = {}
    for pattern in command.kept:
        for path in out.glob(pattern):
            # Of a run what is beyond its newest checkpoint is done again.
            if "checkpoints" not in (command.steps or "") or int(path.stem) <= newest.get(path.parent.parent, -1):
                found[str(path)] = (path.stat().st_ino, path.stat().st_mtime_ns)
    return found


def computed(command: Command, folder: Path) -> list[str]:
    """The cells that the command has computed in a folder so far, as often as it has."""
    path = folder / command.computed
    return path.read_text().splitlines() if command.computed and path.exists() else []


def repeated(command: Command, folder: Path, done: Iterable[str], before: int) -> list[str]:
    """Cells that were computed though they were finished.

    Args:
        command: that has run.
        folder: that it has run in.
        done: files of cells that were finished before.
        before: how many lines of `computed` there were then.
    """
    now = computed(command, folder)[before:]
    cells = [json.loads(Path(path).read_text()) for path in done] if command.computed else []
    names = {f"{cell['on']} {cell['settings']['size']} {cell['seed']}" for cell in cells}
    return sorted(names & set(now))


def progress(command: Command, out: Path) -> dict[str, int]:
    """How far each fit is, by its newest checkpoint, and a collection by its rows: folder -> number that must not fall."""
    found = {str(path.parent): step for path, step in checkpoint_steps(command, out)} if command.steps else {}
    for state in out.glob(".*.part/state.json"):
        found[str(state)] = json.loads(state.read_text())["rows"]
    return found


def checkpoint_steps(command: Command, out: Path) -> list[tuple[Path, int]]:
    assert command.steps is not None
    named = [(path, re.fullmatch(r"\d+", path.stem)) for path in out.glob(command.steps)]
    return sorted(((path, int(match[0])) for path, match in named if match), key=lambda each: each[1])


def leftovers(folder: Path) -> list[str]:
    """Temporary files, locks and parts in and below a folder, of which a command that has ended well leaves none."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob(".*"))
