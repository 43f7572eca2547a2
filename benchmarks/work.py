"""Work of one update of every agent that learns from a log: `python benchmarks/work.py [AGENT ...]`, for `bench/rates.toml`.

Millions of floating-point operations, as XLA counts them in the program before it is compiled: of the agent's own defaults, on
observations of 17 and actions of 6 numbers. What an agent fits before its first update is not in them.
"""


import sys

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.agents import AGENTS, agent_class
from deadreckon.data.batch import TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.training.learner import lift
from deadreckon.training.program import advance, begin
from deadreckon.training.sources import source_of


def work(name: str, log: Dataset) -> float:
    """Millions of operations of an update."""
    agent = agent_class(name)().resolve(log.spec, 100_000)
    rows, roots = TransitionSource(log, agent.needs(log.spec)), jnp.stack([jax.random.key(0)])
    source = source_of(rows, roots, 1, False)
    learner = lift([agent])
    with source:
        data = source.data  # type: ignore[attr-defined]
        states = begin(learner, log.spec, roots)
        bounds = jnp.int32(0), jnp.int32(1), jnp.int32(rows.count)
        lowered = advance.lower(learner, source.plan, states, data, source.initial, roots, *bounds)
    return lowered.lowered.cost_analysis()["flops"] / 1e6


def main() -> None:
    rng = np.random.default_rng(0)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(2000, 17)), actions=rng.uniform(-1, 1, (2000, 6)), rewards=rng.normal(size=2000),
        terminals=np.zeros(2000), timeouts=np.arange(2000) % 500 == 499,
    )  # fmt: skip
    for name in sys.argv[1:] or sorted(AGENTS):
        if agent_class(name).offline:
            try:
                print(f"{name} = {work(name, log):,.0f}".replace(",", "_"), flush=True)
            except UserError as error:  # of agents of discrete actions alone
                print(f"# {name}: {error}", flush=True)


if __name__ == "__main__":
    main()
