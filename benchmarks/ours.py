"""The one place where the speed harness meets our API."""

from collections.abc import Callable
from typing import Any

import protocol


def make_ours(agent_name: str, options: dict[str, Any]) -> Callable[[int], int]:
    """A callable `run(n_updates)` that makes at least so many updates, blocks until they are done and says how many.

    `agent_name` is a key of `protocol.CASES` and `options` comes from `protocol.options`: batch, width, behaviour
    ("gaussian", "vae" or None), behaviour_width, mmd_samples, target_samples, threads, seed; the log is
    `protocol.synthetic_log(options)`. Compilation may happen here or in the first call, which is not timed. Whole
    chunks are fine. The callable may have two attributes: `flops`, matrix-product operations of one update of the
    program (`flops.of_program` counts them), and `settings`, a line for the report.
    """
    raise protocol.BenchError(f"benchmarks/ours.py: make_ours is not wired to deadreckon.training yet ({agent_name})")
