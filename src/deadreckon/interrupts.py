"""SIGINT and SIGTERM: work ends where it can be resumed, and a message says from which files.

Commands listen (`cli/main.py`, and the processes that `bench` begins). A program that imports the package keeps its own
handlers, and Ctrl-C raises `KeyboardInterrupt` there as ever; nothing is lost by it beyond the chunk in flight.
"""

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_AGAIN = 1.0  # seconds: two signals within them are one, which a terminal and a program between may both pass on

_arrived: tuple[int, float] | None = None  # number and time of the first signal
_held = 0  # chunks whose checkpoint is not yet on disk
_kept: list[Path] = []  # files and folders from which the current work can be resumed
_last: Callable[[int], Any] = print


class Interrupted(KeyboardInterrupt):
    """A signal that ends the command; `number` is the signal's."""

    def __init__(self, number: int):
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextlib.contextmanager
def listening(last: Callable[[int], Any], numbers: tuple[int, ...] = SIGNALS) -> Iterator[None]:
    """A signal raises `Interrupted`, at once or when the chunk in flight is on disk (`holding`); a second ends the process.

    A signal that the process was begun to ignore, as SIGINT by a shell in the background, stays ignored.

    Args:
        last: called with the number of a second signal before the process ends.
        numbers: of the signals.
    """
    global _arrived, _last, _held
    if threading.current_thread() is not threading.main_thread():  # which alone may set handlers
        yield
        return
    _arrived, _last, _held = None, last, 0
    _kept.clear()
    before = {number: signal.getsignal(number) for number in numbers}
    shown = sys.unraisablehook
    sys.unraisablehook = lambda lost: _again(lost) if isinstance(lost.exc_value, Interrupted) else shown(lost)
    heard = [number for number, handler in before.items() if handler != signal.SIG_IGN]
    for number in heard:
        signal.signal(number, _hear)
    try:
        yield
    finally:
        sys.unraisablehook = shown
        for number in heard:
            signal.signal(number, before[number])
        _arrived = None  # a program that goes on, such as a notebook's, has no signal waiting


def _hear(number: int, frame: Any) -> None:
    global _arrived
    now = time.monotonic()
    if _arrived is None:
        _arrived = number, now
        if not _held:
            raise Interrupted(number)
    elif now - _arrived[1] > _AGAIN:
        _last(number)
        os._exit(128 + number)  # threads need not be waited for: what is on disk is whole at every moment


def _again(lost: Any) -> None:
    """The signal came in a callback of the garbage collector or the like, whose errors Python drops: it is sent once more."""
    global _arrived
    _arrived = None
    threading.Timer(0.02, os.kill, (os.getpid(), lost.exc_value.number)).start()


def arrived() -> int | None:
    """The number of the signal that has come, if any has."""
    return None if _arrived is None else _arrived[0]


@contextlib.contextmanager
def holding() -> Iterator[None]:
    """A signal waits for the end of the body, which writes what the work is resumed from; if it fails, for the next one.

    Raises:
        Interrupted: at the end, a signal has come; at the beginning, one came that something on its way has swallowed.
    """
    global _held
    if not _held:
        _raise_arrived()
    _held += 1
    try:
        yield
    except BaseException:
        _held -= 1
        raise
    _held -= 1
    if not _held:
        _raise_arrived()


def _raise_arrived() -> None:
    if _arrived is not None:
        raise Interrupted(_arrived[0])


@contextlib.contextmanager
def resumable(*paths: Path) -> Iterator[None]:
    """If the body is interrupted, a message says that the same command resumes from these files or folders.

    Args:
        paths: one that is there when the signal comes is enough.
    """
    before = len(_kept)
    _kept.extend(paths)
    try:
        yield
    except KeyboardInterrupt:  # whoever tells of it asks `goes_on`
        raise
    except BaseException:
        del _kept[before:]
        raise
    del _kept[before:]


def goes_on() -> bool:
    """Whether the work that was interrupted has left something from which the same command goes on."""
    return any(path.exists() for path in _kept)
