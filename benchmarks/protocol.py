"""What the driver and its two workers share: the cases, the synthetic log and JSON lines over pipes.

Both Pythons import this file (ours and the peer's), so it needs nothing but the standard library and numpy.
"""

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

# Case -> (d3rlpy algorithm, behaviour model of ours, its hidden width; None: the width of the other networks).
# d3rlpy's BEAR knows only the VAE, so BEAR with the Gaussian model stands beside that too.
CASES: dict[str, tuple[str, str | None, int | None]] = {
    "bc": ("bc", None, None),
    "td3_bc": ("td3_bc", None, None),
    "sac": ("sac", None, None),
    "bear-gaussian": ("bear", "gaussian", None),
    "bear-vae": ("bear", "vae", None),
    "bear-vae-750": ("bear", "vae", 750),  # the width of the published code's VAE
    "iql": ("iql", None, None),
    "awac": ("awac", None, None),
    "rebrac": ("rebrac", None, None),
    "rebrac-1024": ("rebrac", None, None),  # with the batch that its authors and d3rlpy take
    "cql": ("cql", None, None),
    "bcq": ("bcq", "vae", None),
    "fqe-11": ("fqe", None, None),  # fitted Q evaluation of 11 policies: an update is one of each policy's critic
    "nemo-40": ("nemo", None, None),  # an update of 40 models and 128 designs; the peer is a loop over models in PyTorch
}
POLICIES = 11  # of the case fqe-11, a DOPE task's
# Of the case nemo-40, as in the thesis for Superconductor; `bins` are also the models, `size` is that of a design.
NEMO = {"bins": 40, "designs": 128, "size": 81, "batch": 128, "width": 256}


class BenchError(Exception):
    """Something the person at the terminal can put right: shown as one line."""


def options(case: str, *, batch: int, width: int, threads: int, rows: int = 100_000, seed: int = 0) -> dict[str, Any]:
    """Everything that decides the work of one update; both workers build from this."""
    if case not in CASES:
        raise BenchError(f"unknown case {case!r}: choose from {', '.join(CASES)}")
    peer, behaviour, behaviour_width = CASES[case]
    if peer == "nemo":
        batch, width = NEMO["batch"], NEMO["width"]
    if case == "rebrac-1024":
        batch = 1024
    return {
        "case": case,
        "peer": peer,
        "behaviour": behaviour,
        "behaviour_width": behaviour_width or width,
        "batch": batch,
        "width": width,
        "observation": 17,
        "action": 6,
        "mmd_samples": 4,
        "target_samples": 10,  # actions that BEAR's and BCQ's targets take the best of
        "cql_samples": 10,  # actions of each of three kinds
        "threads": threads,
        "rows": rows,
        "seed": seed,
    }


def synthetic_log(opts: dict[str, Any]) -> dict[str, Any]:
    """Columns of a log in episodes of 1,000 steps. Only its shape matters for speed, so it is noise."""
    import numpy as np

    rng = np.random.default_rng(opts["seed"])
    rows = opts["rows"]
    timeouts = np.zeros(rows, bool)
    timeouts[999::1000] = timeouts[-1] = True
    return {
        "observations": rng.standard_normal((rows, opts["observation"]), dtype=np.float32),
        "actions": np.tanh(rng.standard_normal((rows, opts["action"]), dtype=np.float32)),
        "rewards": rng.standard_normal(rows, dtype=np.float32),
        "terminals": np.zeros(rows, bool),
        "timeouts": timeouts,
    }


def synthetic_designs(opts: dict[str, Any]) -> tuple[Any, Any]:
    """Designs (rows, size) and scores; noise, too."""
    import numpy as np

    rng = np.random.default_rng(opts["seed"])
    return rng.standard_normal((opts["rows"], NEMO["size"]), dtype=np.float32), rng.uniform(size=opts["rows"])


def told(report: Callable[[], int]) -> int:
    """A report's exit code; what the person at the terminal can put right is said in one line, with code 2."""
    try:
        return report()
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def product_rate(multiply: Callable[[], Any], flops: float, seconds: float) -> float:
    """FLOP/s of a blocking call: the median of calls made for `seconds`."""
    multiply()
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < 5 or time.perf_counter() < end:
        start = time.perf_counter()
        multiply()
        times.append(time.perf_counter() - start)
    return flops / sorted(times)[len(times) // 2]


# ---- worker side ----------------------------------------------------------------------------------------------------


def serve(handlers: dict[str, Callable[[dict[str, Any]], dict[str, Any]]]) -> None:
    """Answers one JSON line for each JSON line read, until end of file. `op` names the handler."""
    # Libraries print (d3rlpy logs to stdout): answers keep a private copy of it, everything else goes to stderr.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = {"ok": True, **handlers[request["op"]](request)}
        except BenchError as error:
            answer = {"ok": False, "error": str(error)}
        except Exception as error:  # noqa: BLE001 - whatever went wrong belongs to the driver; the traceback to the log
            traceback.print_exc()
            answer = {"ok": False, "error": f"{type(error).__name__}: {error}".splitlines()[0]}
        print(json.dumps(answer), file=answers, flush=True)


class Case:
    """The case a worker holds, with the two handlers that both workers share."""

    def __init__(self, build: Callable[[dict[str, Any]], tuple[Callable[[int], int], dict[str, Any]]]):
        self._build = build
        self._run: Callable[[int], int] | None = None

    def build(self, request: dict[str, Any]) -> dict[str, Any]:
        self._run = None  # frees the case before, so that two logs are never held
        start = time.perf_counter()
        self._run, facts = self._build(request["options"])
        return {"seconds": time.perf_counter() - start, **facts}

    def run(self, request: dict[str, Any]) -> dict[str, Any]:
        if self._run is None:
            raise BenchError("`run` before `build`")
        start = time.perf_counter()
        made = self._run(request["updates"])
        return {"seconds": time.perf_counter() - start, "updates": made}


# ---- driver side ----------------------------------------------------------------------------------------------------


class Worker:
    """A worker process that stays alive between slices, idle in a read while the other one is timed."""

    def __init__(self, name: str, command: list[str], environment: dict[str, str], timeout: float):
        self.name = name
        self._timeout = timeout
        self._log = tempfile.NamedTemporaryFile("w+", prefix=f"deadreckon-{name}-", suffix=".log")  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, env=environment
            )
        except OSError as error:
            raise BenchError(f"{name}: cannot start {command[0]}: {error.strerror}") from None

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, op: str, **arguments: Any) -> dict[str, Any]:
        process = self._process
        assert process.stdin
        assert process.stdout
        try:
            process.stdin.write((json.dumps({"op": op, **arguments}) + "\n").encode())
            process.stdin.flush()
        except BrokenPipeError:
            raise BenchError(self._death()) from None
        ready, _, _ = select.select([process.stdout], [], [], self._timeout)
        if not ready:
            raise BenchError(f"{self.name}: no answer to `{op}` in {self._timeout:.0f} s (--timeout)")
        line = process.stdout.readline()
        if not line:
            raise BenchError(self._death())
        answer = json.loads(line)
        if not answer.pop("ok"):
            raise BenchError(f"{self.name}: {answer['error']}")
        return answer

    def _death(self) -> str:
        code = self._process.wait()
        lines = [line for line in Path(self._log.name).read_text(errors="replace").splitlines() if line.strip()]
        return f"{self.name}: the worker ended with code {code}: {lines[-1].strip() if lines else 'it said nothing'}"

    def close(self) -> None:
        if self._process.stdin:
            with contextlib.suppress(BrokenPipeError):  # it is gone already
                self._process.stdin.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._log.close()
