"""Runs an attempt in a separate process, and follows its messages, its time limit and its end."""

import contextlib
import json
import os
import queue
import site
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import deadreckon
from deadreckon.progress import Watcher
from deadreckon.runs.clock import Clock

COMMAND = (sys.executable, "-P", "-m", "deadreckon.runs.attempt")  # -P: no modules from the current folder


@dataclass
class Found:
    """The messages of the process.

    Attributes:
        state: the latest value of each item.
        late: it was ended because the time was over.
        refused: the error about invalid input.
        unfinished: the reason why there is nothing to evaluate.
        fault: an unexpected error, or how the process ended.
    """

    state: dict[str, Any]
    late: bool = False
    refused: str | None = None
    unfinished: str | None = None
    fault: str | None = None


def followed(
    job: dict[str, Any], clock: Clock, tell: Callable[[str], None], watch: Watcher
) -> Found:
    """Runs a job (`attempt.Job.as_json`) in a process until it is done or the time is over.

    `tell` gets lines to print, and `watch` what is being done, the steps done and the steps in all.
    """
    found, done = Found({}), False
    lines: queue.Queue[str | None] = queue.Queue()
    process = subprocess.Popen(
        COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8",
        env=_environment(),
        start_new_session=True,  # an interruption from the keyboard reaches this process alone, which ends the other
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(json.dumps(job) + "\n")
            process.stdin.flush()
        while True:
            try:
                left = clock.left()  # checked before every line, as lines may never end
                line = lines.get(timeout=left) if left > 0 else None
            except queue.Empty:
                continue
            if left <= 0:
                found.late = True
                break
            if line is None:
                break
            for what, value in _message(line).items():
                if what == "line":
                    tell(value)
                elif what == "watch":
                    name, step, steps = value
                    for each in found.state.get("candidates", []):
                        if each["name"] == name and each["state"] == "learning":
                            each["updates"] = step
                    watch(name, step, steps)
                elif what == "state":
                    found.state |= value
                elif what == "done":
                    done = True
                else:
                    setattr(found, what, value)
        if not (done or found.late or found.refused or found.unfinished or found.fault):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(clock.left(), 0.1))
            found.fault = f"the process that did the work ended unexpectedly (exit code {process.poll()})"
    finally:
        process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        with contextlib.suppress(OSError):
            process.stdin.close()
    return found


def _environment() -> dict[str, str]:
    """The environment of the process, in which this copy of the package is imported, even if it is not installed."""
    root = str(Path(deadreckon.__file__).parent.parent)
    if root in (*site.getsitepackages(), site.getusersitepackages()):
        return dict(os.environ)
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}


def _read(stream: IO[str], lines: "queue.Queue[str | None]") -> None:
    with contextlib.suppress(ValueError, OSError):
        for line in stream:
            lines.put(line)
    lines.put(None)


def _message(line: str) -> dict[str, Any]:
    """The message in a line of the process; {} if the line is incomplete, as after a kill."""
    try:
        told = json.loads(line)
    except json.JSONDecodeError:
        return {}
    known = ("line", "watch", "state", "done", "refused", "unfinished", "fault")
    return {key: value for key, value in told.items() if key in known} if isinstance(told, dict) else {}
