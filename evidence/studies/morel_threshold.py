"""How much of a log MOReL's threshold calls unknown: where the behaviour itself is halted, no better policy can be learned.

    python evidence/studies/morel_threshold.py         (some minutes; collects 200,000 steps of hopper-medium first)

A model is fitted to 20,000 rows of the log, and the largest disagreement of its networks taken from 10,000, as MOReL does. Of
the log's steps it prints which share lies beyond a multiple of that, and which share of its episodes has such a step.
"""

import jax
import jax.numpy as jnp
import numpy as np

import deadreckon as dr
from deadreckon.agents.morel import ROWS, MOReL, disagreement, units
from deadreckon.collect.recipes import collect
from deadreckon.data.batch import TransitionSource
from deadreckon.dynamics import Ensemble

STEPS, FITTED = 200_000, 20_000
MULTIPLES = 0.05, 0.1, 0.2, 1 / 3, 0.5, 1.0


def main() -> None:
    """Prints the table."""
    log = dr.read(collect("hopper-medium-v2", steps=STEPS))
    agent = MOReL(model_rows=FITTED).resolve(log.spec, 1)
    rows = TransitionSource(log, agent.needs(log.spec))
    ensemble: Ensemble = fitted(agent, rows)
    known = rows.take(np.linspace(0, rows.count - 1, ROWS).astype(int))
    scale = units(known)

    def beyond(columns: dict[str, np.ndarray]) -> np.ndarray:
        given = jnp.asarray(columns["observation"]), jnp.asarray(columns["action"])
        return np.asarray(disagreement(agent.model, ensemble, scale, *given))

    largest = beyond(known).max()
    every = np.concatenate([beyond(rows.take(part)) for part in np.array_split(np.arange(rows.count), 20)])
    assert rows.count == len(log), "a log with rows that cannot be learned from needs their numbers"
    episode = np.repeat(np.arange(log.episodes), log.lengths)
    print("| multiple of the largest disagreement | steps beyond it | episodes with such a step |\n|---:|---:|---:|")
    for multiple in MULTIPLES:
        lost = every > multiple * largest
        print(f"| {multiple:.2f} | {lost.mean():.3%} | {len(np.unique(episode[lost])) / log.episodes:.0%} |")


def fitted(agent: MOReL, rows: TransitionSource) -> Ensemble:
    """The ensemble that MOReL fits to a log."""
    columns = rows.take(np.sort(np.random.default_rng(0).permutation(rows.count)[:FITTED]))
    return agent.trainer.fit(agent.model, rows.spec, columns, 0)[0]


if __name__ == "__main__":
    jax.config.update("jax_platforms", "cpu")
    main()
