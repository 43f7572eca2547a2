"""`deadreckon theory`: the arguments of the thesis as pictures, with the numbers behind them as CSV files beside."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.files import replacing
from deadreckon.report import charts
from deadreckon.report.markup import Markup, tag
from deadreckon.report.picture import PANEL, sheet, style
from deadreckon.theory import cnml, discrepancy, fitted, looseness, piecewise, propagation

Made = tuple[list[Path], list[str]]  # files, and what to say
SHADES = 9  # of a picture; more are not told apart


def columns(path: Path, values: Mapping[str, np.ndarray]) -> Path:
    """A CSV file of equally long columns."""
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(values)
        rows = zip(*(np.asarray(column).tolist() for column in values.values()))
        writer.writerows([f"{v:.8g}" if isinstance(v, float) else v for v in row] for row in rows)
    return path


def _lines(x: np.ndarray, named: Mapping[str, np.ndarray], names: Sequence[str], unit: str, across: str, **more) -> Markup:
    """Lines whose colours are their places in `names`."""
    series = [charts.Series(name, names.index(name), np.asarray(x, float), np.asarray(y, float)) for name, y in named.items()]
    return charts.lines(series, title=f"{unit} against {across}", unit=unit, across=across, size=PANEL, ticks=7, **more)


def _drawing(path: Path, size: tuple[int, int], *parts: Markup | list[Markup]) -> Path:
    """An SVG file that needs nothing else, in the charts' colours."""
    rules = (
        ".shade { fill: var(--c1) } .ground { fill: var(--floor); stroke: var(--line) }"
        " .way { fill: none; stroke-width: 3; stroke: var(--c) } .thin { fill: none; stroke: var(--ink); stroke-width: 1.4 }"
        " .dots { fill: none; stroke: var(--ink); stroke-dasharray: 3 3 } .dot { fill: var(--c0) }"
        " .cell { fill: none; stroke: var(--grid) }"
        " .word { font-size: 13px; fill: var(--ink) } .soft { font-size: 12px; fill: var(--soft) } .mid { text-anchor: middle }"
        " .query { stroke: var(--no); stroke-width: 1.5 }"
    )
    whole = tag(
        "svg", tag("style", style(), Markup(rules)), tag("rect", width="100%", height="100%", class_="back"), *parts,
        xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {size[0]} {size[1]}", width=size[0], height=size[1],
    )  # fmt: skip
    with replacing(path) as temporary:
        temporary.write_text(re.sub(r' data-hover="[^"]*"', "", whole), encoding="utf-8")
    return path


def _shades(values: np.ndarray, shape_of: Callable[..., str], most: float) -> list[Markup]:
    """One path a shade for all places whose value falls into it."""
    level = np.clip(np.rint(SHADES * values / most), 0, SHADES).astype(int)
    return [
        tag("path", d="".join(shape_of(*at) for at in np.argwhere(level == k)), class_="shade", opacity=f"{k / SHADES:.2f}")
        for k in range(1, SHADES + 1)
        if (level == k).any()
    ]


# ---- chapters 2, 4 and 7 ----------------------------------------------------------------------------------------------

_CORNERS = {0: ((0, 0), (1, 0)), 1: ((1, 0), (1, 1)), 2: ((1, 1), (0, 1)), 3: ((0, 1), (0, 0))}  # of an action's triangle


def _triangle(x: int, y: int, size: int, action: int) -> str:
    (ax, ay), (bx, by) = _CORNERS[action]
    ends = f"{x + ax * size} {y + ay * size}L{x + bx * size} {y + by * size}"
    return f"M{ends}L{x + size // 2} {y + size // 2}Z"


def draw_propagation(path: Path, found: propagation.Propagation) -> Path:
    """Figure 4.2: task and support, and |Q_k - Q*| of every action for three sets of policies; dark is wrong."""
    on, size = found.on, 20
    wide, high = on.width * size, on.height * size
    step, left, top = wide + 22, 260, 46
    most = max(float(e.max()) for e in found.errors.values())
    state = np.arange(on.width * on.height)

    def panel(x: int, y: int, values: np.ndarray, top_value: float) -> list[Markup]:
        place = lambda s, a: _triangle(x + int(s) % on.width * size, y + int(s) // on.width * size, size, int(a))  # noqa: E731
        grid = "".join(f"M{x + i * size} {y}v{high}" for i in range(on.width + 1)) + "".join(
            f"M{x} {y + i * size}h{wide}" for i in range(on.height + 1)
        )
        return [
            tag("rect", x=x, y=y, width=wide, height=high, class_="ground"), *_shades(values, place, top_value),
            tag("path", d=grid, class_="cell"),
        ]  # fmt: skip

    def letters(x: int, y: int) -> list[Markup]:
        at = lambda s, word: tag(  # noqa: E731
            "text", word, x=x + (s % on.width + 0.5) * size, y=y + (s // on.width + 0.72) * size, class_="word mid"
        )
        return [at(0, "S"), at(on.goal, "G")]

    arrows = []
    for s in state:
        x, y = 20 + (s % on.width + 0.5) * size, top + (s // on.width + 0.5) * size
        for a, (dx, dy) in enumerate(((0, -1), (1, 0), (0, 1), (-1, 0))):
            reach = 13 * on.behavior[s, a]
            arrows.append(f"M{x:.1f} {y:.1f}l{dx * reach:.1f} {dy * reach:.1f}")
    parts = [
        tag("text", "the data's policy", x=20, y=top - 12, class_="title"),
        *panel(20, top, np.zeros_like(on.behavior), 1.0), tag("path", d="".join(arrows), class_="thin"),
        tag("text", f"support at ε = {found.epsilon:g}", x=20, y=top + high + 38, class_="title"),
        *panel(20, top + high + 50, found.allowed.astype(float), 1.0), *letters(20, top + high + 50),
    ]  # fmt: skip
    words = {"unconstrained": "all policies", "support": "support set", "behaviour": "data's policy"}
    for j, k in enumerate(found.shown):
        parts.append(tag("text", f"k = {k}", x=left + j * step, y=top - 12, class_="title"))
    for i, (name, errors) in enumerate(found.errors.items()):
        y = top + i * (high + 50)
        for j, each in enumerate(errors):
            parts += panel(left + j * step, y, each, most)
        said = f"{words[name]}: return {found.returns[name]:.2f} of {found.best:.2f}"
        parts.append(tag("text", said, x=left, y=y + high + 19, class_="word"))
    legend = left, top + 3 * (high + 50) + 4
    parts.append(tag("text", "|Qₖ − Q*|   0", x=left, y=legend[1] + 11, class_="soft"))
    for k in range(SHADES + 1):
        box = {"x": left + 88 + 22 * k, "y": legend[1], "width": 22, "height": 13}
        parts.append(tag("rect", **box, class_="shade", opacity=f"{k / SHADES:.2f}"))
    parts.append(tag("text", f"{most:.1f}", x=left + 96 + 22 * (SHADES + 1), y=legend[1] + 11, class_="soft"))
    return _drawing(path, (left + len(found.shown) * step + 8, legend[1] + 26), parts)


def draw_stitching(path: Path, found: fitted.Stitching) -> Path:
    """Figure 7.1."""
    size, top = 30, 40
    wide = found.width * size

    def panel(x: int, title: str, ways: Sequence[Sequence[int]], slots: Sequence[int]) -> list[Markup]:
        middle = lambda s: (x + (s % found.width + 0.5) * size, top + (s // found.width + 0.5) * size)  # noqa: E731
        out = [
            tag("text", title, x=x, y=top - 14, class_="title"),
            tag("rect", x=x, y=top, width=wide, height=wide, class_="ground"),
        ]
        for way, slot in zip(ways, slots):
            d = "M" + "L".join("{:.0f} {:.0f}".format(*middle(s)) for s in way)
            out.append(tag("g", tag("path", d=d, class_="way"), charts.marker(slot, *middle(way[-1])), class_=f"s{slot}"))
        for word, s in (("A", found.start), ("B", found.meeting), ("C", found.end)):
            px, py = middle(s)
            out.append(tag("text", word, x=px + 9, y=py - 6, class_="title"))
        return out

    values = [
        tag("text", f"{name}: {v:.2f}", x=2 * wide + 90, y=top + 22 * (i + 1), class_="word")
        for i, (name, v) in enumerate(found.values.items())
    ]
    head = tag("text", "value at A", x=2 * wide + 90, y=top - 14, class_="title")
    return _drawing(
        path, (2 * wide + 370, wide + top + 16), panel(20, "the log: two trajectories", found.ways, (0, 1)),
        panel(wide + 55, "Q-iteration on the log", [found.stitched], (2,)), head, values,
    )  # fmt: skip


def gridworld(out: Path, seed: int = 0) -> Made:
    """Chapter 4 on a grid, the diverging projection of chapter 2 and the stitching of chapter 7."""
    on = propagation.grid(seed=seed)
    found, trade = propagation.propagate(on, seed=seed), propagation.tradeoff(on, seed=seed)
    state, action = (each.ravel() for each in np.indices(on.behavior.shape))
    errors = {f"{name}_k{k}": e.ravel() for name, each in found.errors.items() for k, e in zip(found.shown, each)}
    pairs = {"state": state, "action": action}
    pairs |= {"behavior": on.behavior.ravel(), "data": on.data.ravel(), "delta": on.delta.ravel()}
    files = [
        draw_propagation(out / "propagation.svg", found),
        columns(out / "propagation.csv", pairs | {"allowed": found.allowed.ravel().astype(int)} | errors),
        columns(out / "tradeoff.csv", vars(trade)),
    ]
    names = ["corrected", "as printed", "measured, mean over errors"]
    across = "threshold ε"
    panels = {
        "what the set leaves out": _lines(
            trade.epsilon, {"corrected": trade.gap, "as printed": trade.printed_gap}, names, "α", across
        ),
        "how far it leads from the data": _lines(
            trade.epsilon, {"corrected": trade.coefficient, "as printed": trade.printed_coefficient}, names, "C", across
        ),
        "Theorem 4.2.1": _lines(
            trade.epsilon, {"corrected": trade.bound, "as printed": trade.printed_bound}, names, "bound", across, symlog=True
        ),
        "what is lost": _lines(trade.epsilon, {"measured, mean over errors": trade.loss}, names, "loss of return", across),
    }
    files.append(sheet(out / "tradeoff.svg", panels, names))
    discount, share = 0.9, np.linspace(0.0, 1.0, 101)
    world, features = fitted.doubling()
    first = features.reshape(2, 1)
    runs = {f"{p:.0%} of the data in state 1": np.array([1 - p, p])[::-1, None] for p in (0.0, 0.5, 0.9)}
    steps = np.arange(31)
    iterates = {name: fitted.fitted_iterates(world, features, mu, discount, first, 30)[:, 0, 0] for name, mu in runs.items()}
    growth = fitted.growth(share, discount)
    names = [*runs, "growth"]
    panels = {
        "one feature, Q-iteration": _lines(steps, iterates, names, "weight w", "iterations", symlog=True),
        "factor of w an iteration": _lines(
            share, {"growth": growth}, names, "factor", "share of the data in state 1", references=[("diverges above", 1.0)]
        ),
    }
    files += [sheet(out / "projection.svg", panels, names), columns(out / "projection.csv", {"share": share, "factor": growth})]
    stitched = fitted.stitching()
    files.append(draw_stitching(out / "stitching.svg", stitched))
    returns = ", ".join(f"{name} {value:.2f}" for name, value in found.returns.items())
    said = [f"return of the last iterate's greedy policy, of {found.best:.2f}: {returns}"]
    best = int(trade.loss.argmin())
    said.append(
        f"loss of return along ε: {trade.loss[0]:.2f} at 0, {trade.loss[best]:.2f} at {trade.epsilon[best]:.2f}, "
        f"{trade.loss[-1]:.2f} at {trade.epsilon[-1]:.2f}"
    )
    said.append(f"Q-iteration under a projection: grows {growth[50]:.2f} times an iteration, data half in either state")
    said.append("stitching, value at A: " + ", ".join(f"{name} {value:.2f}" for name, value in stitched.values.items()))
    return files, said


# ---- appendix A.3 -----------------------------------------------------------------------------------------------------


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
        panels[f"best mean allowed, {n} draws"] = _lines(epsilon, means, [*kernels], "mean action", across, references=edge)
        panels[f"actions outside the support, {n} draws"] = _lines(epsilon, outside, [*kernels], "probability", across)
        for name, a in swept.items():
            rows |= {f"{name}, n {n}: {what}": getattr(a, what) for what in ("value", "spread", "outside")}
            said.append(f"{n} draws, {name}: the behaviour policy's own MMD is {a.own:.3f}")
    files += [sheet(out / "threshold.svg", panels, [*kernels]), columns(out / "threshold.csv", rows)]
    said.append(f"chance that 9 draws from 81 points are different: {discrepancy.unseen_chance(9):.4f} (A.3 says above 0.6321)")
    return files, said


# ---- chapter 5 --------------------------------------------------------------------------------------------------------


def bounds(out: Path, seed: int = 0) -> Made:
    """What the bounds of chapter 5 leave unused, k*, and Algorithm 2."""
    found = looseness.looseness(seed=seed)
    names = ["as printed", "sharper", "exact", *(f"k*, γ = {g}" for g in (0.9, 0.95, 0.99))]
    panels, rows = {}, {"discount": found.discount}
    for number in ("5.2.1", "5.2.2", "5.2.3"):
        most = {"as printed": found.used[f"Theorem {number}"][:, 2], "sharper": found.used[f"{number}, sharper"][:, 2]}
        panels[f"{number}: most that is used of the bound"] = _lines(found.discount, most, names, "gap / bound", "discount")
    for name, used in found.used.items():
        rows |= {f"{name}, {what}": used[:, i] for i, what in enumerate(("median", "90th percentile", "greatest"))}
    files = [columns(out / "loose.csv", rows)]
    ratio, best = looseness.best_lengths()
    drawn = {f"k*, γ = {g}": k for g, k in best.items()}
    panels["length of the least bound 5.2.3"] = _lines(ratio, drawn, names, "k*", "model error / policy error")
    files.append(columns(out / "length.csv", {"ratio": ratio} | drawn))
    for under, number in (("old", "5.2.2"), ("new", "5.2.3")):
        tight = looseness.lengths(under=under)
        drawn = {"as printed": tight.printed, "sharper": tight.sharp, "exact": tight.exact}
        panels[f"{number} where it is met, by length"] = _lines(tight.k, drawn, names, "promised too much", "rollout length k")
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


# ---- chapter 6 --------------------------------------------------------------------------------------------------------


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
        parts += _shades(np.sqrt(probs), place, 1.0)
        line = "M" + "L".join(f"{across(v):.1f} {up(t):.1f}" for v, t in zip(found.queries, found.truth))
        parts.append(tag("path", d=line, class_="dots"))
        parts += _dots(found, across, up)
    return _drawing(path, (left + 3 * (wide + left), top + high + 30), parts)


def draw_claims(path: Path, found: piecewise.Beliefs, query: float = 5.0, shown: int = 7) -> Path:
    """Figure 6.1: data and query; the best curve for every claimed label; what p_NML makes of them."""
    wide, high, top, left = 330, 260, 40, 26
    curves = found.curves
    scores, levels = curves.scores(found.x, found.label), curves.levels
    known = curves.experts(scores, query)
    parts = []

    def frame(j: int, title: str) -> Callable[[float], float]:
        x = left + j * (wide + left)
        across = lambda v: x + (v - curves.knots[0]) / (curves.knots[-1] - curves.knots[0]) * wide  # noqa: E731
        parts.extend(_frame(x, top, wide, high, title, (-8, -4, 0, 4, 8), across))
        parts.extend(_dots(found, across, up))
        parts.append(tag("line", x1=f"{across(query):.1f}", x2=f"{across(query):.1f}", y1=top, y2=top + high, class_="query"))
        return across

    up = lambda level: top + high * (1 - (np.asarray(level) + 0.5) / levels)  # noqa: E731
    frame(0, "data, and a query")
    across = frame(1, "the best curve for each claim")
    for slot, claim in enumerate(np.linspace(0, levels - 1, shown).astype(int)):
        path_of = curves.best(curves.scores(np.append(found.x, query), np.append(found.label, claim)))
        d = "M" + "L".join(f"{across(v):.1f} {up(y):.1f}" for v, y in zip(curves.knots, path_of))
        parts.append(tag("g", tag("path", d=d, class_="way", style="stroke-width: 1.6"), class_=f"s{slot}"))
    x = left + 2 * (wide + left)
    probs = cnml.p_nml(known)
    parts += _frame(x, top, wide, high, f"p(y | x = {query:g}) under NML", (), lambda v: v)
    thick = high / levels
    reach = 0.95 * wide * probs / probs.max()
    bars = (f"M{x} {up(y) - 0.4 * thick:.1f}h{r:.1f}v{0.8 * thick:.1f}H{x}Z" for y, r in enumerate(reach))
    parts.append(tag("path", d="".join(bars), class_="shade"))
    said = f"longest bar {probs.max():.3f}; Γ = {float(cnml.minimax_regret(known)):.2f}"
    parts.append(tag("text", said, x=x, y=top + high + 17, class_="soft"))
    return _drawing(path, (left + 3 * (wide + left), top + high + 30), parts)


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
        "Theorem 6.4.1 along the queries": _lines(found.queries, regret, names, "of a score in 0 .. 1", "query x"),
        "regret of sequences of coins": _lines(n, whole, names, "nats", "length"),
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


EXPERIMENTS: dict[str, tuple[Callable[[Path, int], Made], str]] = {
    "gridworld": (gridworld, "error propagation and the support threshold (Figure 4.2), a diverging projection, stitching"),
    "mmd": (mmd, "what sampled MMD can tell apart (Figure A.1), and what a threshold allows"),
    "bounds": (bounds, "Theorems 5.2.1 to 5.2.3, how loose they are, rollout lengths, Algorithm 2"),
    "cnml": (nml, "normalised maximum likelihood in exact arithmetic (Figures 6.1 and 6.3), regret and its bounds"),
}
