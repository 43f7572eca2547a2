"""Requests per second that `deadreckon serve` answers on one core, each one row of twelve columns by name.

    python benchmarks/serve.py

The service, of a policy of two layers of 256 units (`table_policy.py`), runs on the first core of this process, the client on
the others: 32 connections that send the next request when they have the answer to the last one. Requests per second are the
median and the quartiles of slices of a second. Where other work shares the core, they are fewer than the requests per second of
processor time, which the service is charged. Exit code 1: fewer than 1,000 requests per second by the clock, in the median.
"""

import argparse
import asyncio
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import table_policy

from deadreckon.bench.idle import measuring

CONNECTIONS, PROMISED = 32, 1_000


class Client(asyncio.Protocol):
    """One connection; sends request after request and notes when answers came and how long they took."""

    def __init__(self, requests: list[bytes], answers: list[tuple[float, float]]):
        self.requests, self.answers, self.sent, self.count, self.rest = requests, answers, 0.0, 0, b""

    def connection_made(self, transport):
        self.transport = transport
        self.send()

    def send(self):
        self.sent = time.perf_counter()
        self.transport.write(self.requests[self.count % len(self.requests)])
        self.count += 1

    def data_received(self, data):
        self.rest += data
        head, mark, body = self.rest.partition(b"\r\n\r\n")
        length = re.search(rb"content-length: (\d+)", head)
        if not mark or length is None or len(body) < int(length[1]):
            return
        if not head.startswith(b"HTTP/1.1 200"):
            raise SystemExit(f"the service answered {self.rest!r}")
        self.rest = b""
        now = time.perf_counter()
        self.answers.append((now, now - self.sent))
        self.send()


async def asked(port: int, bodies: list[bytes], seconds: float) -> list[tuple[float, float]]:
    """Times of the answers, and how long they took."""
    head = "POST /predict HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: {}\r\n\r\n"
    requests = [head.format(len(body)).encode() + body for body in bodies]
    answers: list[tuple[float, float]] = []
    loop = asyncio.get_running_loop()
    for i in range(CONNECTIONS):
        own = requests[i:] + requests[:i]
        await loop.create_connection(lambda own=own: Client(own, answers), "127.0.0.1", port)
    await asyncio.sleep(seconds)
    return answers


def processor_seconds(process: int) -> float:
    """User and system time that a process has been charged."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=20, help="how long requests are sent, after two that do not count")
    seconds = parser.parse_args().seconds
    cores = sorted(os.sched_getaffinity(0))
    rows = json.loads(table_policy.table(1_000, seed=1).drop(columns=["offer", "paid"]).to_json(orient="records"))
    with tempfile.TemporaryDirectory() as folder:
        file = table_policy.saved(Path(folder) / "policy.npz")
        command = [sys.executable, "-m", "deadreckon.cli.main", "serve", str(file), "--port", "0"]
        os.sched_setaffinity(0, {cores[0]})  # which the service inherits
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as service:
            assert service.stdout is not None
            port = int(re.search(r":(\d+)/predict", service.stdout.readline())[1])
            os.sched_setaffinity(0, set(cores[1:]) or set(cores))
            before = processor_seconds(service.pid)
            answers = asyncio.run(asked(port, [json.dumps(row).encode() for row in rows], seconds + 2))
            charged = processor_seconds(service.pid) - before
            service.terminate()
    begin = answers[0][0] + 2
    slices = [sum(begin + i <= when < begin + i + 1 for when, _ in answers) for i in range(seconds - 1)]
    took = [1e3 * each for when, each in answers if when >= begin]
    low, middle, high = statistics.quantiles(slices, n=4)
    percentiles = statistics.quantiles(took, n=100)
    print(f"- {middle:,.0f} [{low:,.0f}, {high:,.0f}] requests per second, of {CONNECTIONS} connections in {seconds} seconds")
    print(f"- {len(answers) / charged:,.0f} requests per second of processor time")
    print(f"- answers after {percentiles[49]:.1f} ms (median), {percentiles[98]:.1f} ms (99 %)")
    return 0 if middle >= PROMISED else 1


if __name__ == "__main__":
    with measuring():
        sys.exit(main())
