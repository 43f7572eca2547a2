"""A table of your own: who was shown which of three offers, how likely that was, and what they paid.

    python examples/own_table.py

It becomes a log, a policy is trained on four fifths of its rows, and the other rows decide whether to deploy it.
Page of the documentation: My own logs.
"""

import sys

import numpy as np

import deadreckon as dr
from deadreckon.runs.offline import judge


def visits(rows: int, seed: int = 0) -> dict[str, np.ndarray]:
    """The table, which yours replaces: any mapping of columns, a pandas, polars or pyarrow table, or a file."""
    rng = np.random.default_rng(seed)
    age, returning = rng.uniform(18, 80, rows), rng.integers(0, 2, rows)
    offer = rng.choice(["none", "discount", "delivery"], rows, p=[0.5, 0.25, 0.25])
    liked = np.where(age < 40, offer == "discount", offer == "delivery")
    return {
        "age": age, "returning": returning, "offer": offer,
        "likelihood": np.where(offer == "none", 0.5, 0.25),  # of the offer that was shown, by whoever showed it
        "paid": rng.gamma(2.0, 5.0, rows) * (1.0 + 0.5 * liked),
    }  # fmt: skip


def main(rows: int = 20_000, steps: int = 5_000, out: str = "runs/own-table") -> None:
    """Trains a policy and decides whether to deploy it."""
    # Columns that are not named are what decisions may depend on. Each row is an episode, since no column states otherwise.
    log = dr.Dataset.from_frame(visits(rows), name="visits", action="offer", reward="paid", propensity="likelihood")
    run = dr.train(dr.agents.IQL(hidden=(64, 64)), log, steps=steps, out=out)
    print(judge([run.path], log, out=f"{out}-ope").choice)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
