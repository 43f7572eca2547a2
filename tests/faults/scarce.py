"""Faults of what is around a command: a full or read-only disk, little memory, another version, no home, the C locale."""

import contextlib
import json
import os
import pwd
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.faults import cases
from tests.faults.cases import LONG, Outcome, Place, clean_end, refused, whole
from tests.faults.commands import Command
from tests.faults.process import Running, begin, memory, mount, run, unmount

DISK = 64 << 20  # bytes of the small file system
GROUPS = Path("/sys/fs/cgroup/memory")  # version 1; with version 2 the fault by addresses is left
CONTINUED = "reported in one line; the same command then continued"


@contextlib.contextmanager
def small_disk(place: Place) -> Iterator[Path]:
    """The folder of a case on a file system of its own."""
    place.clean()
    mount("tmpfs", "none", place.folder, data=f"size={DISK}")
    try:
        place.fill()
        yield place.folder
    finally:
        unmount(place.folder)


def _used(folder: Path) -> int:
    state = os.statvfs(folder)
    return (state.f_blocks - state.f_bfree) * state.f_frsize


def disk_full(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """The disk has room for a random part of what the command writes; then it has room for all."""
    if not place.mounts or not command.goes_on:
        return None
    words = command.words(place.inputs)
    with small_disk(place) as folder:
        need = rng.uniform(0.0, 1.5) * sum(_sizes(place, command))
        ballast = folder / ".ballast"
        with open(ballast, "wb") as file:
            os.posix_fallocate(file.fileno(), 0, max(DISK - _used(folder) - int(need), 4096))
        first = run(words, folder, LONG)
        told = [] if first.code == 0 else refused(first, "No space left on device|the disk may be full|failed|left", (2, 1))
        ballast.unlink()
        if first.code == 0:
            return Outcome("the limit was not reached", whole(place, command, first))
        return Outcome(CONTINUED, told + whole(place, command, run(words, folder, LONG)))


def _sizes(place: Place, command: Command) -> list[int]:
    """Bytes of what an undisturbed command leaves, in whole pages."""
    place_of = place.folder.with_name(f"whole-{command.name.replace(' ', '-')}")
    return [-(-path.stat().st_size // 4096) * 4096 for path in place_of.rglob("*") if path.is_file()]


def read_only(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """The folder is read-only, before the command begins or after it was killed; then it is not."""
    if not place.mounts or not command.goes_on:
        return None
    words = command.words(place.inputs)
    with small_disk(place) as folder:
        if rng.random() < 0.5:
            running = begin(words, folder)
            running.wait(rng.uniform(0.0, 1.0) * place.seconds[command.name])
            running.kill(whole=True)
            running.wait()
            if not running.gone() or running.code == 0:
                return Outcome("ended before", whole(place, command, running) if running.code == 0 else ["children lived on"])
        mount("tmpfs", "none", folder, 0x20 | 0x1, f"size={DISK}")
        told = refused(run(words, folder, LONG), "Read-only file system|failed|left", (2, 1))
        mount("tmpfs", "none", folder, 0x20, f"size={DISK}")
        return Outcome(CONTINUED, told + whole(place, command, run(words, folder, LONG)))


def memory_group(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """The system gives the command and its children too little memory, and kills where it runs out; then it gives more."""
    own = next((line.split(":")[2] for line in Path("/proc/self/cgroup").read_text().splitlines() if ":memory:" in line), None)
    if own is None or not command.goes_on:
        return None
    group = GROUPS / own.strip("/") / f"faults-{os.getpid()}"
    try:
        group.mkdir(exist_ok=True)
        (group / "memory.limit_in_bytes").write_text(str(int(rng.uniform(8, 250)) << 20))
        (group / "memory.failcnt").write_text("0")
    except OSError:
        return None
    place.clean()
    words = command.words(place.inputs)
    first = run(words, place.folder, LONG, lambda: (group / "cgroup.procs").write_text(str(os.getpid())) and None)
    gone = first.gone()
    with contextlib.suppress(OSError):
        group.rmdir()
    if first.code == 0:
        return Outcome("the limit was not reached", whole(place, command, first))
    broken = clean_end(first) + ([] if gone else ["children lived on"])
    how = "killed by the system" if first.code == -9 else f"ended with {first.code} in one line"
    if first.code not in (-9, 1, 2, 70):
        broken.append(f"exit {first.code}: {(first.lines() or ['-'])[-1][:200]}")
    return Outcome(f"{how}; the same command then continued", broken + whole(place, command, run(words, place.folder, LONG)))


def memory_addresses(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """Allocations fail; then they do not."""
    if not command.goes_on:
        return None
    place.clean()
    words, now = command.words(place.inputs), int(Path("/proc/self/statm").read_text().split()[0]) * 4096
    first = run(words, place.folder, LONG, memory(now + (int(rng.uniform(16, 1500)) << 20)))
    first.gone()
    if first.code == 0:
        return Outcome("the limit was not reached", whole(place, command, first))
    told = refused(first, ".", (1, 2, 70)) if first.code in (1, 2, 70) else []
    how = "reported in one line" if first.code in (1, 2, 70) else "ended by a library in C++"
    again = whole(place, command, run(words, place.folder, LONG))
    return Outcome(f"{how}; the same command then continued", told + again)


def version(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """The run was begun by another version: of JAX, which is told, or of the training loop, which is refused."""
    if "checkpoints" not in (command.steps or "") or "fold" in (command.steps or ""):
        return None
    place.clean()
    words = command.words(place.inputs)
    running = begin(words, place.folder)
    while running.wait(0.01) is None and len(list(place.out.glob("checkpoints/*.npz"))) < 2:
        pass
    running.kill()
    running.wait()
    config = json.loads((place.out / "run.json").read_text())
    if rng.random() < 0.5:
        config["versions"] |= {"jax": "0.1.0"}
        (place.out / "run.json").write_text(json.dumps(config))
        again = run(words, place.folder, LONG)
        told = any("warning: jax" in line or "last bits" in line for line in again.lines())
        broken = whole(place, command, again, but=("out/run.json",)) + ([] if told else ["it was not told"])
        return Outcome("the other version of JAX was reported, and the run continued", broken)
    config["revisions"] = {name: -1 for name in config["revisions"]}
    (place.out / "run.json").write_text(json.dumps(config))
    again = run(words, place.folder, LONG)
    return Outcome("other revisions were refused in one line", refused(again, "code that trains differently"))


def homeless(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """A user whom the system does not know, without a home folder, as containers have."""
    place.clean()

    def unknown(user: int) -> None:
        raise KeyError(f"uid not found: {user}")

    def become() -> None:
        pwd.getpwuid = unknown
        for name in ("HOME", "DEADRECKON_HOME", "XDG_CACHE_HOME", "USER", "LOGNAME"):
            os.environ.pop(name, None)

    done = run(command.words(place.inputs), place.folder, LONG, become)
    if done.code == 2 and "set DEADRECKON_HOME" in done.lines()[-1]:  # looks at held-out episodes are counted there
        told = refused(done, "this user has no home folder")
        again = run(command.words(place.inputs), place.folder, LONG)
        return Outcome("named in one line the variable to set", told + whole(place, command, again))
    if not command.goes_on:
        return Outcome("succeeded", clean_end(done) + ([] if done.code == 0 else [f"exit {done.code}"]))
    return Outcome("same results", [each for each in whole(place, command, done) if not each.startswith("left behind: ~")])


def c_locale(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """The C locale, and a folder whose name it cannot spell."""
    if not command.goes_on or "queue" in command.name:
        return None
    place.clean()
    given = command.words(place.inputs)
    words = ["l\u00e4ufe" + word[3:] if word == "out" or word.startswith("out/") else word for word in given]
    environment = os.environ | {"LC_ALL": "C", "LANG": "C"}
    with open(place.folder.with_name(f"{place.folder.name}.out"), "wb") as out, \
            open(place.folder.with_name(f"{place.folder.name}.err"), "wb") as err:  # fmt: skip
        call = [sys.executable, "-m", "deadreckon.cli.main", *words]
        process = subprocess.run(call, cwd=place.folder, env=environment, stdout=out, stderr=err, timeout=LONG)
    done = Running(0, place.folder, process.returncode)
    folder = place.folder / "l\u00e4ufe"
    if folder.exists():
        folder.rename(place.out)
    # Estimates of a search name the folders of its policies.
    return Outcome("same results", whole(place, command, done, but=("out/estimates/estimates.json",)))


FAULTS: dict[str, cases.Case] = {
    "SIGINT or SIGTERM": cases.interrupted,
    "disk full": disk_full,
    "read-only folder": read_only,
    "memory limit (cgroup)": memory_group,
    "memory limit (addresses)": memory_addresses,
    "clock goes back": cases.clock,
    "two at once": cases.at_once,
    "files deleted, cut, overwritten": cases.changed,
    "another version": version,
    "no home, unknown user": homeless,
    "C locale": c_locale,
}
