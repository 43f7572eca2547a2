"""`deadreckon serve` as a process: it answers, goes on under requests that nobody should send, and ends when it is asked to."""

import contextlib
import json
import re
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.runs.train import train

GOOD = {"x": 0.5, "mode": "day"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    rng = np.random.default_rng(0)
    frame = {"x": rng.normal(size=40), "mode": ["day", "night"] * 20, "action": rng.choice(["a", "b"], 40)}
    agent = dr.agents.BC(hidden=(8,), batch_size=8)
    log = dr.Dataset.from_frame({**frame, "reward": np.zeros(40)})
    return train(agent, log, out=tmp_path_factory.mktemp("run") / "run", steps=3, task=False)


@contextlib.contextmanager
def served(run, tmp_path, *words):
    """The port of a service, and the file of what it says; it must end well when it is interrupted."""
    command = [sys.executable, "-m", "deadreckon.cli.main", "serve", str(run.path), "--port", "0", *words]
    pipe = subprocess.PIPE
    with open(tmp_path / "err", "w+") as err, subprocess.Popen(command, stdout=pipe, stderr=err, text=True) as process:
        try:
            line = process.stdout.readline()
            found = re.fullmatch(r"seed 0 of .*: http://127.0.0.1:(\d+)/predict, described at http://127.0.0.1:\1/docs\n", line)
            assert found, line + (tmp_path / "err").read_text()
            yield int(found[1]), process
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0
        finally:
            process.kill()


def exchanged(port, request):
    """All that is answered on a connection of its own until it is closed."""
    parts = []
    reset = contextlib.suppress(BrokenPipeError, ConnectionResetError)
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line, reset:
        line.sendall(request)
        with contextlib.suppress(OSError):  # it was closed at the other end already
            line.shutdown(socket.SHUT_WR)
        while part := line.recv(65_536):
            parts.append(part)
    return b"".join(parts)


def post(body, length=None):
    length = len(body) if length is None else length
    head = f"POST /predict HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n"
    return head.encode() + body


def answer(port, value):
    head, _, body = exchanged(port, post(json.dumps(value).encode())).partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(body)


@pytest.mark.slow
def test_a_service_answers_and_ends(run, tmp_path):
    with served(run, tmp_path, "--max-body", "5000") as (port, _):
        assert answer(port, GOOD) == (200, {"action": {"action": run.predict(GOOD)}})
        assert answer(port, [GOOD] * 500) == (413, {"error": "the body is larger than 5,000 bytes"})
        assert b"deadreckon policy" in exchanged(port, b"GET /docs HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n")
        assert main(["serve", str(run.path), "--port", str(port)]) == 2  # which is taken
    assert (tmp_path / "err").read_text() == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "nowhere is no file or folder; give a run folder"),
        (["RUN", "--policy-seed", "5"], "has no policy of seed 5; its seeds are 0"),
        (["RUN", "--max-rows", "0"], "--max-rows must be at least 1, got 0"),
        (["RUN", "--port", "70000"], "cannot listen on 127.0.0.1, port 70000"),
        (["RUN", "--host", "256.0.0.1"], "cannot listen on 256.0.0.1, port 8000"),
    ],
)
def test_what_cannot_be_served(run, capsys, monkeypatch, words, said):
    def found(host, *asked, find=socket.getaddrinfo, **options):
        if host == "256.0.0.1":  # nobody is asked for it
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return find(host, *asked, **options)

    monkeypatch.setattr(socket, "getaddrinfo", found)
    assert main(["serve", *(str(run.path) if word == "RUN" else word for word in words)]) == 2
    assert said in capsys.readouterr().err


def malformed(rng, kind):
    """A request that should not be sent, of one of a few kinds."""
    some = rng.integers(0, 256, int(rng.integers(0, 300)), np.uint8).tobytes()
    good = json.dumps(GOOD).encode()
    cut = good[: int(rng.integers(0, len(good)))]
    at = int(rng.integers(0, len(good)))
    value = [None, [], {}, "a", 1e308, -1, True, 10**30][int(rng.integers(8))]
    return {
        "bytes": lambda: some, "bytes as a body": lambda: post(some), "cut": lambda: post(cut),
        "promised more": lambda: post(cut, len(good)), "flipped": lambda: post(good[:at] + some[:1] + good[at + 1 :]),
        "deep": lambda: post(b'{"x":' * 20_000), "large": lambda: post(b"[" + b"1," * 600_000 + b"1]"),
        "said to be large": lambda: post(b"", 10**12),
        "other values": lambda: post(json.dumps({"x": value, "mode": some.decode("latin-1")}).encode()),
        "no method": lambda: b"BREW /predict HTTP/1.1\r\n\r\n",
        "no path": lambda: b"GET /../../etc/passwd HTTP/1.1\r\nhost: x\r\n\r\n",
        "many heads": lambda: b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 3_000 + b"\r\n",
        "a long head": lambda: b"GET / HTTP/1.1\r\na: " + b"x" * 100_000 + b"\r\n\r\n",
    }[kind]()  # fmt: skip


KINDS = ("bytes", "bytes as a body", "cut", "promised more", "flipped", "deep", "large", "said to be large", "other values",
         "no method", "no path", "many heads", "a long head")  # fmt: skip


@pytest.mark.slow
def test_a_service_outlives_ten_thousand_malformed_requests(run, tmp_path):
    rng = np.random.default_rng(0)
    with served(run, tmp_path) as (port, process):
        for count in range(10_000):
            kind = "large" if count % 500 == 0 else KINDS[count % len(KINDS)]
            kind = "bytes" if kind == "large" and count % 500 else kind  # a megabyte each
            said = exchanged(port, malformed(rng, kind))
            assert b"Traceback" not in said
            assert not said or re.match(rb"HTTP/1.1 (200|307|4\d\d) ", said), said
            if count % 1_000 == 0:
                assert answer(port, GOOD) == (200, {"action": {"action": run.predict(GOOD)}})
        assert answer(port, GOOD) == (200, {"action": {"action": run.predict(GOOD)}})
        with open(f"/proc/{process.pid}/status") as status:
            memory = int(re.search(r"VmRSS:\s+(\d+) kB", status.read())[1])
        assert memory < 500_000
    assert "Traceback" not in (tmp_path / "err").read_text()
