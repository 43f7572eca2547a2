"""Progress of long work: a bar with rate and time left on a terminal, a plain line now and then elsewhere."""

import functools
import sys
import time
from types import TracebackType
from typing import Any, Self, TextIO, cast

from deadreckon.names import Terminal, shown

PLAIN_EVERY = 15.0  # seconds between plain lines


class Bar:
    """Shows `done` of `total`; use it as a context manager and call it.

    Args:
        label: what is going on.
        total: how much there is to do; None where that is not known before the first call, or ever.
        unit: of the rate; `bytes` are shown in MB.
    """

    def __init__(self, label: str, total: int | None, unit: str):
        self.label, self.total, self.unit = shown(label), total, unit
        self.begun = self.told = time.monotonic()
        self.first: int | None = None
        self.ended = False  # whether the last line has been told
        self.bar: Any = None
        self.note = ""

    def __enter__(self) -> Self:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            # Texts as they are: what stands in brackets in a name is no style.
            text = functools.partial(TextColumn, markup=False)
            columns = (text("{task.description}"), BarColumn(), text("{task.percentage:>3.0f} %"), text("{task.fields[rate]}"),
                       TimeRemainingColumn(), text("{task.fields[note]}"))  # fmt: skip
            stream = sys.stderr.stream if isinstance(sys.stderr, Terminal) else sys.stderr  # the bar steers the terminal itself
            self.bar = Progress(*columns, console=Console(file=stream), transient=True)
            self.bar.start()  # what is printed meanwhile goes through it, above the bar
            sys.stdout, sys.stderr = cast(TextIO, Terminal(sys.stdout)), cast(TextIO, Terminal(sys.stderr))
            self.task = self.bar.add_task(self.label, total=self.total, rate="", note="")
        return self

    def __call__(self, done: int, total: int | None = None, note: str = "") -> None:
        """Tells how far it is; `note` is shown behind."""
        if self.first is None:
            self.first, self.begun = done, time.monotonic()  # the first call comes after start-up and compilation
        now = time.monotonic()
        elapsed = now - self.begun
        rate = (done - self.first) / elapsed if elapsed > 0 else 0.0
        total = total or self.total
        text = f"{self._amount(rate)}{'' if self.unit == 'bytes' else f' {self.unit}'}/s" if rate else ""
        if self.bar is not None:
            self.bar.update(self.task, completed=done, total=total, rate=text, note=shown(note))
        elif now - self.told > PLAIN_EVERY or (total is not None and done >= total and not self.ended):
            self.told, self.ended = now, total is not None and done >= total
            left = f", {(total - done) / rate:,.0f} s left" if rate and total is not None and done < total else ""
            of = "" if total is None else f" of {self._amount(total)}"
            line = f"{self.label}: {self._amount(done)}{of}" + (f", {text}{left}" if text else "")
            print(f"{line}{'  ' + note if note else ''}", file=sys.stderr, flush=True)

    def _amount(self, number: float) -> str:
        return f"{number / 1e6:,.1f} MB" if self.unit == "bytes" else f"{number:,.0f}"

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self.bar is not None:
            self.bar.stop()


class Watch:
    """A bar for each thing that is done, one after the other; use it as a context manager and call it."""

    def __init__(self):
        self.what: tuple[str, int | None] = "", 0
        self.bar: Bar | None = None

    def __enter__(self) -> Self:
        return self

    def __call__(self, what: str, step: int, steps: int | None, unit: str = "updates") -> None:
        """Tells how far `what` is."""
        if (what, steps) != self.what or self.bar is None:
            self._end()
            self.what, self.bar = (what, steps), Bar(what, steps, unit).__enter__()
        self.bar(step)

    def _end(self) -> None:
        if self.bar is not None:
            self.bar.__exit__(None, None, None)
        self.bar = None

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._end()
