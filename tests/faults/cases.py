"""One function for each fault: what is done to a command, and whether it has kept its promises."""

import os
import random
import re
import shlex
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults import inputs
from tests.faults.commands import Command, computed, digests, finished, leftovers, progress, repeated
from tests.faults.process import Running, apart, at_operation, begin, run

MOST = 10  # kills of one case before the command may end
LONG = 900.0  # seconds within which an undisturbed command ends on a busy machine


@dataclass
class Place:
    """Where a case happens, and what an undisturbed command gives.

    Attributes:
        folder: of the case, made anew.
        inputs: of `inputs.make`.
        whole: command's name -> digests of its results.
        seconds: command's name -> time that it took, undisturbed, when that was last seen.
        mounts: whether file systems may be mounted.
    """

    folder: Path
    inputs: Path
    whole: dict[str, dict[str, str]]
    seconds: dict[str, float]
    mounts: bool

    def clean(self) -> Path:
        """The folder, as every case finds it; beside it a home of its own, where looks at held-out episodes are counted."""
        home = self.folder.with_name(f"{self.folder.name}.home")
        for folder in (home, self.folder):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        os.environ["DEADRECKON_HOME"] = str(home)
        self.fill()
        return self.folder

    def fill(self) -> None:
        """What suites need in the folder that they are run in: files, and a link to the log, as they name no other folder."""
        for name, text in inputs.SUITE_FILES.items():
            (self.folder / name).write_text(text)
        (self.folder / "log.npz").symlink_to(self.inputs / "log.npz")

    @property
    def out(self) -> Path:
        """Of the command."""
        return self.folder / "out"


@dataclass
class Outcome:
    """What came of a case: what was done and seen in words, what was broken, and how many processes were killed."""

    words: str
    broken: list[str] = field(default_factory=list)
    kills: int = 0


Case = Callable[[Place, Command, random.Random], Outcome | None]  # None: not possible here, or not of this command


def clean_end(running: Running) -> list[str]:
    """What a command must never say."""
    text = "\n".join([*running.lines(), *running.lines("out")])
    found = [name for name in ("Traceback", "internal error", "Exception ignored") if name in text]
    return [f"{found[0]}: {running.lines()[-1][:200]}"] if found else []


def whole(place: Place, command: Command, running: Running, but: tuple[str, ...] = ()) -> list[str]:
    """What is wrong with a command that should have ended well, with the results of an undisturbed one."""
    broken, last = clean_end(running), (running.lines() or ["-"])[-1]
    there = running.code == 2 and re.search("exists already|is there already", last)  # killed when all was done
    if running.code != 0 and not there:
        return [*broken, f"exit {running.code}: {last[:300]}"]
    if left := [path for path in leftovers(place.folder) if not there or not path.endswith(".lock")]:
        broken.append(f"left behind: {', '.join(left[:3])}")
    now, then = apart(digests, place.folder, command.others), place.whole[command.name]
    if different := sorted(name for name in now.keys() | then.keys() if now.get(name) != then.get(name) and name not in but):
        broken.append(f"other results: {', '.join(different[:3])}")
    return broken


def refused(running: Running, words: str, codes: tuple[int, ...] = (2,)) -> list[str]:
    """What is wrong with a command that should have ended with one line."""
    broken = clean_end(running)
    errors = [line for line in running.lines() if re.match(r"deadreckon: (?!warning)", line)]
    if running.code not in codes:
        broken.append(f"exit {running.code} instead of {codes[0]}: {(running.lines() or ['-'])[-1][:200]}")
    elif running.code == 1 and (failed := [line for line in running.lines("out") if line.startswith("FAILED: ")]):
        if unsaid := [line for line in failed if not re.search(words, line)]:  # `bench` tells each program that failed
            broken.append(f"not a line about it: {unsaid[0][:300]}")
    elif len(errors) != 1 or not re.search(words, errors[0]):
        broken.append(f"not one line about it: {' | '.join(running.lines()[-3:])[:300]}")
    return broken


def killed(place: Place, command: Command, rng: random.Random) -> Outcome:
    """SIGKILL at random times, and at random changes of the file system, until it ends; now and then of a child alone."""
    place.clean()
    words, broken, kills, operations = command.words(place.inputs), [], 0, 0
    while True:
        done, far = finished(command, place.out), progress(command, place.out)
        before = len(computed(command, place.folder))
        last = kills == MOST or (kills > 0 and not command.goes_on)
        precise = rng.random() < 0.5
        hook = at_operation(int(300 ** rng.random()), lambda: os.kill(os.getpid(), signal.SIGKILL))
        began = time.monotonic()
        running = begin(words, place.folder, hook if precise and not last else lambda: None)
        wait = LONG if last or precise else rng.uniform(0.0, place.seconds[command.name])
        if running.wait(wait) is None:
            children = running.survivors()
            if children and rng.random() < 0.3:  # the command goes on, and begins another one in its place
                os.kill(rng.choice(children), signal.SIGKILL)
                kills += 1
                running.wait(LONG)
            else:
                running.kill(whole=rng.random() < 0.3)
                running.wait()
        if not running.gone():
            broken.append("its children lived on for 120 s")
        if running.code == -signal.SIGKILL:
            kills, operations = kills + 1, operations + precise
        broken += _kept(command, place.out, done, far)
        if again := repeated(command, place.folder, done, before):
            broken.append(f"computed again: {', '.join(again[:3])}")
        if running.code != -signal.SIGKILL:
            break
    cells = computed(command, place.folder)
    if (again := len(cells) - len(set(cells))) > kills:  # what the one process was at, or had not delivered, when it was killed
        broken.append(f"{again} cells computed again after {kills} kills")
    if not command.goes_on and kills:
        told = running.code == 1 and "DO NOT DEPLOY: the process that did the work ended" in "\n".join(running.lines("out"))
        broken += clean_end(running) if told or not running.code else refused(running, "exists already")
    else:
        broken += whole(place, command, running) if command.goes_on else clean_end(running)
        if not kills:
            place.seconds[command.name] = time.monotonic() - began
    return Outcome(f"{kills} kills, {operations} of them at a change of the file system", broken, kills)


def _kept(command: Command, out: Path, done: dict[str, tuple[int, int]], far: dict[str, int]) -> list[str]:
    """What of the finished has been lost or done again."""
    now, there = {path: (Path(path).stat().st_ino, Path(path).stat().st_mtime_ns) for path in done if Path(path).exists()}, None
    there = progress(command, out)
    lost = [path for path in done if path not in now]
    again = [path for path in now if now[path] != done[path]]
    fallen = [path for path, step in far.items() if path in there and there[path] < step]
    found = (("lost", lost), ("done again", again), ("fell back", fallen))
    return [f"{what}: {', '.join(paths[:3])}" for what, paths in found if paths]


def interrupted(place: Place, command: Command, rng: random.Random) -> Outcome:
    """SIGINT or SIGTERM at a random time; then what the command says that goes on."""
    place.clean()
    number = rng.choice((signal.SIGINT, signal.SIGTERM))
    words = [word for word in command.words(place.inputs) if word != "--resume"]
    running, far = begin(words, place.folder), {}
    if running.wait(rng.uniform(0.05, place.seconds[command.name])) is None:
        far = progress(command, place.out)
        running.kill(number)
        if running.wait(120.0) is None:
            running.kill(whole=True)
            return Outcome("", [f"lived on for 120 s after {number.name}"])
    if not running.gone():
        return Outcome("", ["its children lived on for 120 s"])
    if running.code == 0:
        return Outcome("ended before", whole(place, command, running) if command.goes_on else [])
    broken = refused(running, "interrupted; ", (128 + number,)) + _kept(command, place.out, {}, far)
    if broken:
        return Outcome("", broken)
    line = next(line for line in running.lines() if line.startswith("deadreckon: interrupted"))
    if not command.goes_on:
        return Outcome("said that it cannot be resumed", [] if "cannot be resumed" in line else [line])
    goes_on = re.fullmatch(r"deadreckon: interrupted; to continue: deadreckon (.*)", line)
    if not goes_on and line != "deadreckon: interrupted; the same command starts again":
        return Outcome("", [f"said: {line}"])
    again = run(shlex.split(goes_on[1]) if goes_on else words, place.folder, LONG)
    how = "announced that it continues, and continued" if goes_on else "announced a restart, and restarted"
    return Outcome(how, whole(place, command, again))


def at_once(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """The same command twice at the same time."""
    place.clean()
    if not command.goes_on:
        return None
    second = Place(place.folder, place.inputs, place.whole, place.seconds, place.mounts)
    words = command.words(place.inputs)
    first = begin(words, place.folder)
    other = place.folder.with_name(f"{place.folder.name}.second")
    other.unlink(missing_ok=True)
    other.symlink_to(place.folder)
    time.sleep(rng.uniform(0.0, 0.5 * place.seconds[command.name]))
    later = _in_link(words, other)
    first.wait(LONG)
    later.wait(LONG)
    broken = clean_end(first) + clean_end(later)
    codes = sorted((first.code, later.code))
    if codes[0] != 0 or codes[1] not in (0, 1, 2):
        broken.append(f"exits {codes}: {(first.lines() or ['-'])[-1][:200]} | {(later.lines() or ['-'])[-1][:200]}")
    one_told = 2 in codes
    if one_told:
        broken += refused(first if first.code == 2 else later, "another process|already|being done")
    again = run(words, place.folder, LONG) if codes[1] else first
    if (again.code == 2 and "is there already" in again.lines()[-1]) or "exists already" in "".join(again.lines()[-1:]):
        again = first if first.code == 0 else later  # what was to be made is made
    broken += whole(second, command, again)
    other.unlink()
    return Outcome("one was refused in one line" if one_told else "both succeeded", broken)


def _in_link(words: list[str], link: Path) -> Running:
    """A command in the same folder whose lines go elsewhere."""
    running = begin(words, link.resolve(), lambda: _elsewhere(link))
    running.folder = link
    return running


def _elsewhere(link: Path) -> None:
    for number, name in ((1, "out"), (2, "err")):
        handle = os.open(link.with_name(f"{link.name}.{name}"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        os.dup2(handle, number)


def clock(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """Python's clock goes back by an hour while the command runs."""
    if not command.goes_on:
        return None
    place.clean()

    def back() -> None:
        real, begun, after = time.time, time.monotonic(), rng.uniform(0.0, place.seconds[command.name])
        time.time = lambda: real() - 3600.0 * (time.monotonic() - begun > after)
        time.time_ns = lambda: int(time.time() * 1e9)

    return Outcome("same results", whole(place, command, run(command.words(place.inputs), place.folder, LONG, back)))


def changed(place: Place, command: Command, rng: random.Random) -> Outcome | None:
    """A file of the folder is deleted, cut or overwritten while the command runs, or after it was killed."""
    if not command.goes_on:
        return None
    place.clean()
    words = command.words(place.inputs)
    running = begin(words, place.folder)
    running.wait(rng.uniform(0.3, 1.0) * place.seconds[command.name])
    if rng.random() < 0.5:
        running.kill(whole=True)
        running.wait()
        running.gone()
    files = [path for path in place.out.rglob("*") if path.is_file() and not path.name.endswith((".lock", ".tmp"))]
    if not files:
        running.wait(LONG)
        return None
    victim, how = rng.choice(sorted(files)), rng.choice(("deleted", "cut", "overwritten"))
    name = str(victim.relative_to(place.folder))
    _spoil(victim, how, rng)
    running.wait(LONG)
    told = [] if running.code in (0, -9) else refused(running, ".", (1, 2))
    again = run(words, place.folder, LONG)
    if again.code == 0:
        broken = told + whole(place, command, again, but=(name,))
        return Outcome("same results, but for the file itself where it is read by nobody", broken)
    if again.code == 2 and re.search("exists already|is there already", again.lines()[-1]):
        return Outcome("reported in one line that the file exists", told + clean_end(again))
    told += refused(again, ".", (1, 2))
    return Outcome("reported in one line that the file is damaged", told)


def _spoil(victim: Path, how: str, rng: random.Random) -> None:
    try:
        size = victim.stat().st_size
        if how == "deleted":
            victim.unlink()
        elif how == "cut":
            os.truncate(victim, rng.randrange(max(size, 1)))
        else:
            with open(victim, "r+b") as file:
                file.seek(rng.randrange(max(size, 1)))
                file.write(rng.randbytes(64))
    except FileNotFoundError:  # the command was faster
        pass
