"""Lines that tell what happens to programs of suites, and the results at the end of a command."""

import os
import sys


def outcome(text: object) -> None:
    """Prints the result of a command whose exit code tells it too: the code is the same if the reader has gone (`| head`)."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Lines:
    """Tells what happens: a line when a program begins, and one when it ends or fails.

    Args:
        total: programs that are to be done.
    """

    def __init__(self, total: int):
        self.total, self.done = total, 0
        self._left = 0  # that failed, or that another command is at
        self._running: set[str] = set()  # not those that an executor only keeps until there is room

    def __call__(self, event) -> None:
        """Tells an event."""
        if event.what == "progress":
            return
        if event.what == "begun":
            self._running.add(event.program.name)
            waiting = self.total - self.done - self._left - len(self._running)
            # `tune --sampler` counts settings, each of which may be several programs: there the number is not known.
            print(f"running: {event.program}{f'; {waiting} waiting' if waiting >= 0 else ''}", flush=True)
            return
        self._running.discard(event.program.name)
        if event.what == "done":
            self.done += 1
            seconds = event.payload[0].rows[0]["seconds"]
            print(f"{self.done} of {self.total}: {event.program}, {seconds:,.0f} s", flush=True)
        elif event.what == "failed":
            self._left += 1
            print(f"FAILED: {event.program}: {event.payload[0]}", flush=True)
        elif event.what == "skipped":
            self.done += 1
            print(f"{self.done} of {self.total}: {event.program}, done by another command", flush=True)
        elif event.what == "elsewhere":
            self._left += 1
            print(f"{event.program}: skipped, since another command is running it", flush=True)
        elif event.what == "split":
            parts = event.program.parts
            self.total += len(parts) - 1
            what = "settings" if len(event.program.jobs) > 1 else "seeds"
            print(f"{event.program}: {event.payload}; its {what} continue one by one", flush=True)
        elif event.what == "died":
            print(f"{event.program}: its process ended ({event.payload}); it is started again and continues", flush=True)
