"""Bounds for short rollouts in a model: thesis chapter 5."""

from pathlib import Path

import numpy as np

from deadreckon.report import charts
from deadreckon.report.picture import PANEL, sheet
from deadreckon.report.theory.drawing import Made, columns, lines
from deadreckon.theory import looseness


def bounds(out: Path, seed: int = 0) -> Made:
    """What the bounds of chapter 5 leave unused, k*, and Algorithm 2."""
    found = looseness.looseness(seed=seed)
    names = ["as printed", "sharper", "exact", *(f"k*, γ = {g}" for g in (0.9, 0.95, 0.99))]
    panels, rows = {}, {"discount": found.discount}
    for number in ("5.2.1", "5.2.2", "5.2.3"):
        most = {"as printed": found.used[f"Theorem {number}"][:, 2], "sharper": found.used[f"{number}, sharper"][:, 2]}
        panels[f"{number}: most that is used of the bound"] = lines(found.discount, most, names, "gap / bound", "discount")
    for name, used in found.used.items():
        rows |= {f"{name}, {what}": used[:, i] for i, what in enumerate(("median", "90th percentile", "greatest"))}
    files = [columns(out / "loose.csv", rows)]
    ratio, best = looseness.best_lengths()
    drawn = {f"k*, γ = {g}": k for g, k in best.items()}
    panels["length of the least bound 5.2.3"] = lines(ratio, drawn, names, "k*", "model error / policy error")
    files.append(columns(out / "length.csv", {"ratio": ratio} | drawn))
    for under, number in (("old", "5.2.2"), ("new", "5.2.3")):
        tight = looseness.lengths(under=under)
        drawn = {"as printed": tight.printed, "sharper": tight.sharp, "exact": tight.exact}
        panels[f"{number} where it is met, by length"] = lines(tight.k, drawn, names, "overestimate", "rollout length k")
        files.append(columns(out / f"tight-{under}.csv", vars(tight)))
    files.insert(0, sheet(out / "bounds.svg", panels, names))
    courses = looseness.courses(seed=seed)
    turns = np.arange(len(next(iter(courses.values())).T))
    means = {name: each.mean(0) for name, each in courses.items()}
    chart = charts.lines(
        [charts.Series.over_seeds(name, i, turns.astype(float), each.T) for i, (name, each) in enumerate(courses.items())],
        title="Algorithm 2", unit="share of the way to the best return", across="turns", size=PANEL, ticks=7,
    )  # fmt: skip
    files.append(sheet(out / "algorithm-2.svg", {"Algorithm 2": chart}, [*courses]))
    files.append(columns(out / "algorithm-2.csv", {"turn": turns} | means))
    said = [f"{name}: {found.violations[name]} violations in {found.count:,} random worlds" for name in found.violations]
    said += [f"Algorithm 2, {name}: {each[-1]:.0%} of the way" for name, each in means.items()]
    return files, said
