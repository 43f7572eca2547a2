"""Normalised maximum likelihood: thesis chapter 6."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.report.markup import Markup, tag
from deadreckon.report.picture import sheet
from deadreckon.report.theory.drawing import Made, columns, drawing, lines, shades
from deadreckon.theory import cnml, piecewise

QUERY = 5.0  # where labels are claimed in Figure 6.1
CLAIMS = 7  # labels whose best curves are drawn there


def _frame(
    x: int, y: int, wide: int, high: int, title: str, ticks: Sequence[float], across: Callable[[float], float]
) -> list[Markup]:
    word = lambda t: f"{t:g}".replace("-", "\N{MINUS SIGN}")  # noqa: E731
    return [
        tag("text", title, x=x, y=y - 12, class_="title"), tag("rect", x=x, y=y, width=wide, height=high, class_="ground"),
        *(tag("text", word(t), x=f"{across(t):.1f}", y=y + high + 17, class_="soft mid") for t in ticks),
    ]  # fmt: skip


def _dots(found: piecewise.Beliefs, across: Callable[[float], float], up: Callable[[Any], Any]) -> list[Markup]:
    """The data."""
    places = zip(found.x, found.label)
    return [tag("circle", cx=f"{across(x):.1f}", cy=f"{up(y):.1f}", r=2.4, class_="dot") for x, y in places]


def draw_beliefs(path: Path, found: piecewise.Beliefs) -> Path:
    """Figure 6.3: three methods' probabilities as shades, with the data and the truth."""
    wide, high, top, left = 390, 260, 40, 26
    levels, count = found.curves.levels, len(found.queries)
    parts = []
    methods = {"NML": found.nml, "bootstrapped best curves": found.bootstrap, "Bayes, all curves alike": found.bayes}
    for j, (title, probs) in enumerate(methods.items()):
        x = left + j * (wide + left)
        w, h = wide / count, high / levels
        across = lambda v, x=x, w=w: x + (v - found.queries[0]) / (found.queries[-1] - found.queries[0]) * (wide - w) + w / 2  # noqa: E731
        up = lambda level: top + high * (1 - (np.asarray(level) + 0.5) / levels)  # noqa: E731
        parts += _frame(x, top, wide, high, title, (-8, -4, 0, 4, 8), across)
        place = lambda i, b, x=x, w=w, h=h: f"M{x + i * w:.1f} {top + high - (b + 1) * h:.1f}h{w:.2f}v{h:.2f}h{-w:.2f}Z"  # noqa: E731
        parts += shades(np.sqrt(probs), place, 1.0)
        line = "M" + "L".join(f"{across(v):.1f} {up(t):.1f}" for v, t in zip(found.queries, found.truth))
        parts.append(tag("path", d=line, class_="dots"))
        parts += _dots(found, across, up)
    return drawing(path, (left + 3 * (wide + left), top + high + 30), parts)


def draw_claims(path: Path, found: piecewise.Beliefs) -> Path:
    """Figure 6.1: data and query; the best curve for every claimed label; what p_NML makes of them."""
    wide, high, top, left = 330, 260, 40, 26
    curves = found.curves
    scores, levels = curves.scores(found.x, found.label), curves.levels
    known = curves.experts(scores, QUERY)
    parts = []

    def frame(j: int, title: str) -> Callable[[float], float]:
        x = left + j * (wide + left)
        across = lambda v: x + (v - curves.knots[0]) / (curves.knots[-1] - curves.knots[0]) * wide  # noqa: E731
        parts.extend(_frame(x, top, wide, high, title, (-8, -4, 0, 4, 8), across))
        parts.extend(_dots(found, across, up))
        parts.append(tag("line", x1=f"{across(QUERY):.1f}", x2=f"{across(QUERY):.1f}", y1=top, y2=top + high, class_="query"))
        return across

    up = lambda level: top + high * (1 - (np.asarray(level) + 0.5) / levels)  # noqa: E731
    frame(0, "data, and a query")
    across = frame(1, "the best curve for each claim")
    for slot, claim in enumerate(np.linspace(0, levels - 1, CLAIMS).astype(int)):
        path_of = curves.best(curves.scores(np.append(found.x, QUERY), np.append(found.label, claim)))
        d = "M" + "L".join(f"{across(v):.1f} {up(y):.1f}" for v, y in zip(curves.knots, path_of))
        parts.append(tag("g", tag("path", d=d, class_="way", style="stroke-width: 1.6"), class_=f"s{slot}"))
    x = left + 2 * (wide + left)
    probs = cnml.p_nml(known)
    parts += _frame(x, top, wide, high, f"p(y | x = {QUERY:g}) under NML", (), lambda v: v)
    thick = high / levels
    reach = 0.95 * wide * probs / probs.max()
    bars = (f"M{x} {up(y) - 0.4 * thick:.1f}h{r:.1f}v{0.8 * thick:.1f}H{x}Z" for y, r in enumerate(reach))
    parts.append(tag("path", d="".join(bars), class_="shade"))
    said = f"longest bar {probs.max():.3f}; Γ = {float(cnml.minimax_regret(known)):.2f}"
    parts.append(tag("text", said, x=x, y=top + high + 17, class_="soft"))
    return drawing(path, (left + 3 * (wide + left), top + high + 30), parts)


def nml(out: Path, seed: int = 0) -> Made:
    """Figures 6.1 and 6.3 in exact arithmetic, the bounds of 6.4, and Jeffreys' prior."""
    found = piecewise.sine(seed=seed)
    files = [draw_claims(out / "claims.svg", found), draw_beliefs(out / "beliefs.svg", found)]
    g = np.arange(found.curves.levels) / (found.curves.levels - 1)
    regret = {
        "functional regret": cnml.functional_regret(found.nml, found.known, g).max(1),
        "as printed": cnml.printed_bound(found.known, g),
        "corrected": cnml.bound(found.known, g),
        "sharper": cnml.sharp_bound(found.known, g),
    }
    n = np.arange(1, 101)
    names = [*regret, "Jeffreys, half ones", "Jeffreys, no ones", "NML"]
    whole = {
        "Jeffreys, half ones": np.array([cnml.jeffreys_regret(int(i))[i // 2] for i in n]),
        "Jeffreys, no ones": np.array([cnml.jeffreys_regret(int(i))[0] for i in n]),
        "NML": np.array([cnml.sequence_regret(int(i)) for i in n]),
    }
    panels = {
        "Theorem 6.4.1 along the queries": lines(found.queries, regret, names, "of a score in 0 .. 1", "query x"),
        "regret of sequences of coins": lines(n, whole, names, "nats", "length"),
    }
    files.append(sheet(out / "regret.svg", panels, names))
    files.append(columns(out / "regret.csv", {"x": found.queries} | regret))
    files.append(columns(out / "coins.csv", {"n": n} | whole))
    for name in ("nml", "bootstrap", "bayes"):
        labels = {f"label_{y}": p for y, p in enumerate(getattr(found, name).T)}
        files.append(columns(out / f"{name}.csv", {"x": found.queries} | labels))
    entropy = lambda p: float(-(p * np.log(np.maximum(p, 1e-300))).sum(1).mean())  # noqa: E731
    inside = np.any([(found.queries >= a) & (found.queries <= b) for a, b in piecewise.SEEN], 0)
    truth = np.rint(found.truth).astype(int)
    most = np.log(found.curves.levels)
    said = [f"{found.curves.count:.1e} curves; mean entropy of the label, of at most {most:.2f}, and surprise at the truth:"]
    for name, p in (("NML", found.nml), ("bootstrap", found.bootstrap), ("Bayes", found.bayes)):
        surprise = -np.log(p[np.arange(len(p)), truth])
        said.append(
            f"  {name}: inside the data {entropy(p[inside]):.2f} and {surprise[inside].mean():.2f}, "
            f"outside {entropy(p[~inside]):.2f} and {surprise[~inside].mean():.2f}"
        )
    above = int((regret["functional regret"] > regret["as printed"] + 1e-9).sum())
    said.append(f"functional regret above the printed bound at {above} of {len(found.queries)} queries")
    return files, said
