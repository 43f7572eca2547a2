"""The sampled maximum mean discrepancy: thesis appendix A.4."""

from pathlib import Path

import numpy as np

from deadreckon.report import charts
from deadreckon.report.picture import PANEL, sheet
from deadreckon.report.theory.drawing import Made, columns, lines
from deadreckon.theory import discrepancy


def mmd(out: Path, seed: int = 0) -> Made:
    """Figure A.1, and BEAR's threshold swept."""
    curves = discrepancy.figure(seed=seed)
    names = ["P and itself, sampled", "uniform and P, sampled", "P and itself, exact", "uniform and P, exact"]
    panels, rows = {}, {}
    for c in curves:
        known = f"preferred below n = {c.crossing:.0f}" if c.crossing >= 1 else "never preferred"
        series = [
            charts.Series(names[0], 0, c.n.astype(float), *c.self_drawn.T),
            charts.Series(names[1], 1, c.n.astype(float), *c.uniform_drawn.T),
            charts.Series(names[2], 2, c.n.astype(float), c.self_expected, dashed=True),
            charts.Series(names[3], 3, c.n.astype(float), c.uniform_expected, dashed=True),
        ]  # fmt: skip
        title = f"uniform over ±{c.alpha:g} std: {known}"
        panels[title] = charts.lines(series, title=title, unit="MMD", across="draws of each side", size=PANEL, ticks=7)
        rows |= {
            f"self_{c.alpha:g}": c.self_drawn[:, 0], f"uniform_{c.alpha:g}": c.uniform_drawn[:, 0],
            f"uniform_expected_{c.alpha:g}": c.uniform_expected,
        }  # fmt: skip
    files = [sheet(out / "mmd.svg", panels, names)]
    files.append(columns(out / "mmd.csv", {"n": curves[0].n, "self_expected": curves[0].self_expected} | rows))
    epsilon = np.linspace(0.0, 0.6, 61)
    kernels = {
        "Gaussian, variance 20": discrepancy.gaussian(20.0), "Gaussian, standard deviation 20": discrepancy.gaussian(400.0),
        "Laplacian, 20": discrepancy.laplacian(20.0),
    }  # fmt: skip
    panels, rows, said = {}, {"epsilon": epsilon}, []
    for n in (4, 100):
        swept = {name: discrepancy.allowed(kernel, n, epsilon) for name, kernel in kernels.items()}
        across = "threshold ε"
        means, outside = ({name: getattr(a, what) for name, a in swept.items()} for what in ("value", "outside"))
        edge = [("edge of the support", discrepancy.EDGE)]
        panels[f"best mean allowed, {n} draws"] = lines(epsilon, means, [*kernels], "mean action", across, references=edge)
        panels[f"actions outside the support, {n} draws"] = lines(epsilon, outside, [*kernels], "probability", across)
        for name, a in swept.items():
            rows |= {f"{name}, n {n}: {what}": getattr(a, what) for what in ("value", "spread", "outside")}
            said.append(f"{n} draws, {name}: the behaviour policy's MMD is {a.own:.3f}")
    files += [sheet(out / "threshold.svg", panels, [*kernels]), columns(out / "threshold.csv", rows)]
    said.append(f"chance that 9 draws from 81 points are different: {discrepancy.unseen_chance(9):.4f} (A.3 says above 0.6321)")
    return files, said
