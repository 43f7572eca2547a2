"""Designs of your own: alloys that have been tried and what they cost, and which to try next.

    python examples/own_design.py

Two designers propose from the table alone; nothing can be tried in between. Page of the documentation: Design from data alone.
"""

from pathlib import Path

import numpy as np

import deadreckon as dr


def tried(rows: int, seed: int = 0) -> dict[str, np.ndarray]:
    """The table, which yours replaces (`dr.Designs.from_csv`): numbers, whole numbers and categories, and a score."""
    rng = np.random.default_rng(seed)
    heat, layers = rng.uniform(0, 120, rows), rng.integers(1, 6, rows)
    metal = rng.choice(["copper", "iron", "zinc"], rows)
    cost = 0.01 * (heat - 70) ** 2 + 3.0 * np.abs(layers - 4) + np.where(metal == "zinc", 0.0, 8.0) + rng.normal(0, 1, rows)
    return {"heat": heat, "layers": layers, "metal": metal, "cost": cost}


def main(rows: int = 300, steps: int = 1_000, n: int = 8, out: str = "runs/own-design.csv") -> None:
    """Proposes and writes."""
    data = dr.Designs.from_frame(tried(rows), target="cost", minimise=True, bounds={"heat": (0, 120)})
    print(f"the best of {len(data)}: {data.shown(data.y).min():.1f}")
    for designer in (dr.mbo.Forward(members=5, hidden=(64, 64), steps=steps), dr.mbo.COMs(hidden=(64, 64), steps=steps)):
        made = designer.propose(data, n=n, seed=0)
        print(f"{designer.label}: the first of {n} is {next(zip(*data.decode(made.x).values()))}")
        spread = f", give or take {made.predicted_std[0]:.1f}" if np.isfinite(made.predicted_std[0]) else ""  # COMs gives none
        print(f"    predicted to cost {data.shown(made.predicted)[0]:.1f}{spread}")
        file = Path(out).with_stem(f"{Path(out).stem}-{type(designer).__name__.lower()}")
        print(f"    written to {data.write(file, made.x, {'predicted': data.shown(made.predicted)})}")


if __name__ == "__main__":
    main()
