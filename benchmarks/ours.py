"""The one place where the speed harness meets our API."""

from collections.abc import Callable
from typing import Any

import flops
import jax
import jax.numpy as jnp
import numpy as np
import protocol

from deadreckon.agents import agent_class
from deadreckon.data.batch import Batch, Rows
from deadreckon.data.dataset import Dataset
from deadreckon.training.fit import Fit

CHUNK = 100  # updates between two looks from outside; a run makes whole chunks


def make_ours(agent_name: str, options: dict[str, Any]) -> Callable[[int], int]:
    """A callable `run(n_updates)` that makes at least so many updates, blocks until they are done and says how many.

    It walks the chunks that `deadreckon train` walks, with the log on the device, metrics and the check for bad numbers.
    """
    if agent_name not in protocol.CASES:
        raise protocol.BenchError(f"unknown agent {agent_name!r}: choose from {', '.join(protocol.CASES)}")
    log = Dataset.from_arrays(**protocol.synthetic_log(options))
    fields: dict[str, Any] = {"hidden": (options["width"],) * 2, "batch_size": options["batch"]}
    if options["behaviour"]:
        fields |= {
            "behavior": options["behaviour"], "behavior_hidden": (options["behaviour_width"],) * 2, "warm_start": 0,
            "policy_samples": options["mmd_samples"], "behavior_samples": options["mmd_samples"],
            "target_samples": options["target_samples"],
        }  # fmt: skip
    agent = agent_class(agent_name.split("-")[0])(**fields).resolve(log.spec, 10**9)
    rows = Rows(log, agent.needs(log.spec))
    walk = Fit([agent], rows, [options["seed"]], 10**9, chunk=CHUNK).chunks()

    def run(n_updates: int) -> int:
        done = 0
        while done < n_updates:
            jax.block_until_ready(next(walk).states)
            done += CHUNK
        return done

    batch = Batch(**{name: jnp.asarray(v) for name, v in rows.take(np.arange(options["batch"])).items()})
    state = agent.init(log.spec, jax.random.key(0))
    update = lambda s, b: agent.update(s, b, step=jnp.int32(0), key=jax.random.key(0))  # noqa: E731
    run.flops = flops.of_program(update, state, batch)  # type: ignore[attr-defined]
    run.settings = ", ".join(f"{k} {v}" for k, v in fields.items())  # type: ignore[attr-defined]
    return run
