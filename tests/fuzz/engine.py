"""Damaged files by number: what becomes of each, by a process that may hang or die.

An input is a format and a number, from which it follows; a block of them goes to a worker. What is no `UserError` in one line
is a failure: another exception, a hang, a crash, code that was run, a file outside the worker's folder.
"""

import contextlib
import json
import mmap
import os
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.fuzz.mutate import havoc

Block = tuple[str, int, int]  # a format, the first number, how many
HANGS = 30.0  # seconds, for one input
_SMALL = 5_000  # bytes of a damaged file that is kept
_AT = struct.Struct("<qd")  # number of the input at work, and since when
CODE = ("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.startfile", "pty.spawn", "ctypes.dlopen", "socket.connect",
        "socket.bind", "shutil.rmtree", "os.remove", "os.rename", "os.symlink", "os.link", "os.chmod", "os.mkdir")  # fmt: skip


class Failure(NamedTuple):
    """An input that was not refused as it should be.

    Attributes:
        what: the exception with its place, or what else happened; alike for inputs that fail alike.
        number: of the input.
        file: that was damaged, below the folder that is read.
        content: of that file.
        told: the whole error.
    """

    what: str
    number: int
    file: str
    content: bytes
    told: str


class Watch:
    """What is done outside a folder while an input is read, told by Python's audit hooks. Hooks cannot be taken off."""

    def __init__(self, folder: Path):
        self.inside, self.on, self.seen = str(folder.resolve()), False, []  # type: tuple[str, bool, list[str]]  # fmt: skip
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple) -> None:
        if not self.on:
            return
        if event == "open":
            path, mode, flags = arguments
            writes = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            if writes and isinstance(path, str | bytes) and not self._inside(os.fsdecode(path)):
                self.seen.append(f"writes {os.fsdecode(path)}")
        elif event == "subprocess.Popen":
            if arguments[0] != sys.executable:
                self.seen.append(f"runs {arguments[0]}")
        elif event in CODE and not ((path := _path(arguments)) and self._inside(path)):
            self.seen.append(f"{event} {arguments!r:.100}")

    def _inside(self, path: str) -> bool:
        place = os.path.realpath(path)
        return place.startswith(self.inside) or "/deadreckon-" in place or place.startswith("/dev/null")


def _path(arguments: tuple) -> str | None:
    """The path that an event is about; where it is relative to an open folder, as `shutil.rmtree` has it, in that folder."""
    if not arguments or not isinstance(arguments[0], str | bytes | os.PathLike):
        return None
    folder = arguments[-1] if len(arguments) > 1 and isinstance(arguments[-1], int) and arguments[-1] >= 0 else None
    path = os.fsdecode(arguments[0])
    return path if folder is None else os.path.join(os.readlink(f"/proc/self/fd/{folder}"), path)


def attempt(read: Callable[[], Any], watch: Watch | None = None) -> tuple[str, str, str]:
    """`read`, `refused` or `failed`, in the last case with what, and the whole error; of a refusal with its message."""
    from deadreckon.errors import UserError

    kind, what, told = "read", "", ""
    if watch is not None:
        watch.seen.clear()
        watch.on = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read()
    except UserError as error:
        kind, told = "refused", str(error)
        if "\n" in told or not told.strip() or "\x1b" in told or len(told) > 2000:
            kind, what = "failed", "a message that is not one line"
        told = told if kind == "refused" else repr(told)[:3000]
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # noqa: BLE001 - a panic of a library in Rust is no Exception
        kind, what, told = "failed", _where(error), "".join(traceback.format_exception(error))[-6000:]
    if watch is not None:
        watch.on = False
        if watch.seen:
            kind, what, told = "failed", f"outside: {watch.seen[0]}", "; ".join(watch.seen[:5])
    return kind, what, told


def _where(error: BaseException) -> str:
    """The kind of an exception and the last place in the package that it came through."""
    frames = [each for each in traceback.extract_tb(error.__traceback__) if f"{os.sep}deadreckon{os.sep}" in each.filename]
    place = frames[-1] if frames else None
    where = "" if place is None else f" at {place.filename.rpartition('deadreckon' + os.sep)[2]} {place.name}: {place.line}"
    return f"{type(error).__name__}{where}"


class Bench:
    """A format with its sound files in a folder, in which one input after the other is laid and read."""

    def __init__(self, name: str, trained: Path, place: Path):
        from tests.fuzz.targets import TARGETS

        self.name, self.target, self.place = name, TARGETS[name], place / name
        self.sets = self.target.sound(trained)
        self.laid: int | None = None
        for which in range(len(self.sets)):  # which also loads the libraries that readers wait with
            self.lay(which, {})
            attempt(lambda: self.target.read(self.place))

    def input(self, number: int) -> tuple[int, dict[str, bytes]]:
        """The sound set that an input comes from, and what is damaged of it."""
        from tests.fuzz.targets import damaged

        rng = np.random.default_rng([zlib.crc32(self.name.encode()), number])
        which = int(rng.integers(len(self.sets)))
        try:
            return which, damaged(self.target, self.sets[which], rng)
        except (ValueError, TypeError, KeyError, OSError, OverflowError, RecursionError, MemoryError):  # cannot be written
            name, *_ = self.sets[which]
            return which, {name: havoc(self.sets[which][name], rng)}

    def lay(self, which: int, files: dict[str, bytes]) -> None:
        """Puts a damaged set into the folder."""
        if self.laid != which:
            for name, content in self.sets[which].items():
                self._put(name, content)
            self.laid = which
        for name, content in files.items():
            self._put(name, content)

    def mend(self, which: int, files: dict[str, bytes]) -> None:
        """Puts the sound files back, where others of their set stay."""
        for name in files if len(self.sets[which]) > 1 else ():
            self._put(name, self.sets[which][name])

    def _put(self, name: str, content: bytes) -> None:
        path = self.place / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)

    def run(self, number: int, watch: Watch | None) -> tuple[str, Failure | None]:
        """Reads one input."""
        which, files = self.input(number)
        self.lay(which, files)
        kind, what, told = attempt(lambda: self.target.read(self.place), watch)
        self.mend(which, files)
        if kind != "failed":
            return kind, None
        (file, content), *_ = files.items()
        return kind, Failure(what, number, file, content, told)


def work(trained: Path, beat: Path) -> None:
    """A worker: takes blocks `[format, first, count]` as lines of JSON, and answers each with counts and failures."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    with (
        tempfile.TemporaryDirectory(prefix="fuzz-") as place,
        open(beat, "r+b") as file,
        mmap.mmap(file.fileno(), _AT.size) as at,
    ):
        os.environ |= {"DEADRECKON_HOME": f"{place}/home", "MINARI_DATASETS_PATH": f"{place}/minari"}
        tempfile.tempdir = place
        os.chdir(place)
        benches: dict[str, Bench] = {}
        watch = Watch(Path(place))
        for line in sys.stdin:
            name, first, count = json.loads(line)
            bench = benches[name] = benches.get(name) or Bench(name, trained, Path(place))
            bench.laid = None
            counts, failed = {"read": 0, "refused": 0, "failed": 0}, []
            for number in range(first, first + count):
                at[:] = _AT.pack(number, time.time())
                kind, failure = bench.run(number, watch)
                counts[kind] += 1
                if failure is not None:
                    told = {"what": failure.what, "number": number, "file": failure.file, "told": failure.told}
                    failed.append(told | ({"content": failure.content.hex()} if len(failure.content) < _SMALL else {}))
            at[:] = _AT.pack(-1, time.time())
            answers.write(json.dumps({"counts": counts, "failed": failed}) + "\n")
            answers.flush()


class Worker:
    """A worker's process, which is begun anew where an input has hung or killed it."""

    def __init__(self, trained: Path, beat: Path):
        self.trained, self.beat = trained, beat
        self.beat.write_bytes(_AT.pack(-1, time.time()))
        self.process: subprocess.Popen | None = None
        self.block: Block | None = None  # at work
        self.asked: Block | None = None  # the last one
        self.name, self.began = "", 0.0  # the format of the last block, and when that was given
        self.number, self.delayed = -1, 0.0  # the input at work, and how long its process had waited for a core before

    def send(self, name: str, first: int, count: int) -> None:
        """Gives it a block."""
        if self.process is None:
            self.beat.write_bytes(_AT.pack(-1, time.time()))
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.fuzz.engine", str(self.trained), str(self.beat)], text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            assert self.process.stdout is not None
            os.set_blocking(self.process.stdout.fileno(), False)
            self.text = ""
        self.block = self.asked = name, first, count
        self.name, self.began = name, time.time()
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(self.block) + "\n")
        self.process.stdin.flush()

    def poll(self) -> dict[str, Any] | None:
        """The answer to the block; where it hung or died, what is known, and the rest of the block under `rest`."""
        process, block = self.process, self.block
        assert process is not None
        assert block is not None
        assert process.stdout is not None
        name, first, count = block
        with contextlib.suppress(TypeError):  # nothing there
            self.text += process.stdout.read() or ""
        if self.text.endswith("\n"):
            found, self.text, self.block = json.loads(self.text), "", None
            return found
        number, since = _AT.unpack(self.beat.read_bytes())
        died = process.poll() is not None
        if number != self.number:
            self.number, self.delayed = number, _delay(process.pid)
        if not died and (number < 0 or time.time() - since - (_delay(process.pid) - self.delayed) < HANGS):
            return None
        process.kill()
        process.wait()
        self.process, self.block = None, None
        number = first if number < 0 else number
        what = f"crash: exit {process.returncode}" if died else f"hang: over {HANGS:.0f} s"
        done = number - first
        return {
            "counts": {"read": 0, "refused": 0, "failed": 1}, "failed": [{"what": what, "number": number, "file": ""}],
            "again": (name, first, done) if done else None, "rest": (name, number + 1, count - done - 1),
        }  # fmt: skip

    def close(self) -> None:
        """Ends it."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


def _delay(pid: int) -> float:
    """Seconds that a process and those that it has begun have waited for a core, where the system tells: that is no hang."""
    waited = 0.0
    with contextlib.suppress(OSError, ValueError, IndexError):
        waited += int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            waited += _delay(int(child))
    return waited


if __name__ == "__main__":
    work(Path(sys.argv[1]), Path(sys.argv[2]))
