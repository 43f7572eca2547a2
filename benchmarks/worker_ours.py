"""Worker that times our updates. Started by speed.py with our Python; argument: the file that holds `make_ours`."""

import importlib.util
import sys
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import protocol


def load(path: str) -> Callable[[str, dict[str, Any]], Callable[[int], int]]:
    if not Path(path).is_file():
        raise protocol.BenchError(f"--ours {path}: no such file")
    spec = importlib.util.spec_from_file_location("benchmark_ours", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not hasattr(module, "make_ours"):
        raise protocol.BenchError(f"--ours {path}: defines no make_ours(agent_name, options)")
    return module.make_ours


def build(options: dict[str, Any]) -> tuple[Callable[[int], int], dict[str, Any]]:
    run = load(sys.argv[1])(options["case"], options)
    facts = {"flops": getattr(run, "flops", None), "settings": getattr(run, "settings", "")}
    return run, facts


@partial(jax.jit, static_argnums=0)
def chain(count: int, x: jax.Array, weights: jax.Array) -> jax.Array:
    return jax.lax.fori_loop(0, count, lambda _, x: jnp.matmul(x, weights), x)


def matmul(request: dict[str, Any]) -> dict[str, Any]:
    """FLOP/s of XLA's float32 product of (rows, n) with (n, n), for each [rows, n]."""
    rates = []
    for rows, n in request["shapes"]:
        flops = 2 * rows * n * n
        count = max(1, round(2e10 / flops))  # products a call, so that dispatch does not show in small ones
        # Scaled so that the norm stays: a product repeated in a chain must neither overflow nor reach denormals.
        weights = jax.random.normal(jax.random.key(0), (n, n)) / n**0.5
        x = jax.random.normal(jax.random.key(1), (rows, n))
        call = partial(chain, count, x, weights)
        rates.append(protocol.product_rate(lambda call=call: call().block_until_ready(), count * flops, request["seconds"]))
    return {"rates": rates}


def versions(_: dict[str, Any]) -> dict[str, Any]:
    found = {}
    for name in ("deadreckon", "jax", "jaxlib", "numpy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return {"versions": found}


if __name__ == "__main__":
    case = protocol.Case(build)
    protocol.serve({"build": case.build, "run": case.run, "matmul": matmul, "versions": versions})
