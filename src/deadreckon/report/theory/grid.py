"""Errors that travel on a grid, and stitching: thesis chapters 2, 4 and 7."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deadreckon.report import forest
from deadreckon.report.markup import Markup, tag
from deadreckon.report.picture import sheet
from deadreckon.report.theory.drawing import SHADES, Made, columns, drawing, lines, shades
from deadreckon.theory import fitted, propagation

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
            tag("rect", x=x, y=y, width=wide, height=high, class_="ground"), *shades(values, place, top_value),
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
    return drawing(path, (left + len(found.shown) * step + 8, legend[1] + 26), parts)


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
            out.append(tag("g", tag("path", d=d, class_="way"), forest.marker(slot, *middle(way[-1])), class_=f"s{slot}"))
        for word, s in (("A", found.start), ("B", found.meeting), ("C", found.end)):
            px, py = middle(s)
            out.append(tag("text", word, x=px + 9, y=py - 6, class_="title"))
        return out

    values = [
        tag("text", f"{name}: {v:.2f}", x=2 * wide + 90, y=top + 22 * (i + 1), class_="word")
        for i, (name, v) in enumerate(found.values.items())
    ]
    head = tag("text", "value at A", x=2 * wide + 90, y=top - 14, class_="title")
    return drawing(
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
        "what the set leaves out": lines(
            trade.epsilon, {"corrected": trade.gap, "as printed": trade.printed_gap}, names, "α", across
        ),
        "how far it leads from the data": lines(
            trade.epsilon, {"corrected": trade.coefficient, "as printed": trade.printed_coefficient}, names, "C", across
        ),
        "Theorem 4.2.1": lines(
            trade.epsilon, {"corrected": trade.bound, "as printed": trade.printed_bound}, names, "bound", across, symlog=True
        ),
        "what is lost": lines(trade.epsilon, {"measured, mean over errors": trade.loss}, names, "loss of return", across),
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
        "one feature, Q-iteration": lines(steps, iterates, names, "weight w", "iterations", symlog=True),
        "factor of w per iteration": lines(
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
    said.append(f"Q-iteration under a projection: grows {growth[50]:.2f} times per iteration, data half in either state")
    said.append("stitching, value at A: " + ", ".join(f"{name} {value:.2f}" for name, value in stitched.values.items()))
    return files, said
