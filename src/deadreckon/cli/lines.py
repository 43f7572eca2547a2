"""Lines that tell what happens to programs of suites."""


class Lines:
    """Tells what happens: a line a job that begins, ends or fails."""

    def __init__(self, total: int):
        self.total, self.done = total, 0

    def __call__(self, event) -> None:
        """Tells an event."""
        if event.what == "done":
            self.done += 1
            seconds = event.payload[0].rows[0]["seconds"]
            print(f"{self.done} of {self.total}: {event.program}, {seconds:,.0f} s", flush=True)
        elif event.what == "failed":
            print(f"FAILED: {event.program}: {event.payload[0]}", flush=True)
        elif event.what == "skipped":
            self.done += 1
            print(f"{self.done} of {self.total}: {event.program}, done by another command", flush=True)
        elif event.what == "elsewhere":
            print(f"{event.program}: another command is at it, and it is left to that one", flush=True)
        elif event.what == "split":
            self.total += len(event.program.jobs) - 1
            print(f"{event.program}: {event.payload}; its settings go on one by one", flush=True)
        elif event.what == "died":
            print(f"{event.program}: its process ended ({event.payload}); it is begun again where it was", flush=True)
