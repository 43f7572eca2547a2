"""Figure 6.3: what quantised NML and a bootstrapped ensemble believe inside and outside of the data, measured and drawn.

    python evidence/studies/nml_sine.py --picture docs/results/nemo-sine.svg

Points of sin(x) with a gap, in 32 bins. NML at a query fits 32 networks, each to the data and the claim that the query
falls into its bin; the ensemble is 32 networks of the same shape on redrawn data. All queries' networks are one program.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from deadreckon.cli.main import cache_compiled_programs
from deadreckon.data.batch import redrawn
from deadreckon.files import replacing
from deadreckon.mbo.nml import Net, nll, quantise
from deadreckon.nets.mlp import ensemble
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.report.markup import Markup, tag

SEEN = (-4.0, -1.0), (1.5, 3.0)  # where there is data
SPAN = -8.0, 8.0  # of the queries


@dataclass
class Options:
    """Figure 6.3: what quantised NML and a bootstrapped ensemble believe inside and outside of the data."""

    points: int = 200  # of the data
    queries: int = 48  # where both are asked
    bins: int = 32  # of the score, networks a query, members of the ensemble
    hidden: tuple[int, ...] = (16, 16)  # width of each hidden layer
    steps: int = 300  # updates of every network
    lr: float = 0.01  # learning rate
    seeds: int = 3  # of data and networks
    picture: str | None = None  # SVG file, of the first seed


@partial(jax.jit, static_argnames=("bins", "hidden", "steps"))
def fit(x, label, weight, key, lr, *, bins: int, hidden: tuple[int, ...], steps: int):
    """Networks (n,) each on its rows (n, r, 1), labels and weights (n, r), by full-batch Adam."""
    nets = ensemble(lambda k: Net.create(1, hidden, bins, False, k), len(x), key)

    def update(_, carry):
        nets, opt = carry
        loss = lambda nets: (jax.vmap(nll)(nets, x, label) * weight).sum(1).sum()  # noqa: E731
        return apply_gradients(nets, jax.grad(loss)(nets), opt, lr)

    return jax.lax.fori_loop(0, steps, update, (nets, init_opt(nets)))[0]


def beliefs(options: Options, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Data x and bins, queries, and both methods' probabilities (queries, bins)."""
    rng = np.random.default_rng(seed)
    low, high = np.array(SEEN)[rng.integers(0, len(SEEN), options.points)].T
    x = rng.uniform(low, high)
    bins, label = options.bins, np.asarray(quantise(jnp.asarray((np.sin(x) + 1) / 2), options.bins))
    queries = np.linspace(*SPAN, options.queries)
    shape = {"bins": bins, "hidden": options.hidden, "steps": options.steps}
    key = jax.random.key(seed)

    # Every query and every claim: the data, and the query with the claimed bin, equally weighted.
    asked, claim = (grid.ravel() for grid in np.meshgrid(queries, np.arange(bins), indexing="ij"))
    count = len(asked)
    rows = np.concatenate([np.tile(x, (count, 1)), asked[:, None]], 1)[..., None] / 4.0  # networks like small numbers
    labels = np.concatenate([np.tile(label, (count, 1)), claim[:, None]], 1)
    even = np.full(labels.shape, 1 / labels.shape[1])
    nets = fit(*map(jnp.asarray, (rows, labels, even)), key, options.lr, **shape)
    own = jax.vmap(lambda net, q: net.log_probs(q[None, None])[0])(nets, jnp.asarray(asked / 4.0))
    own = np.exp(np.asarray(own)[np.arange(count), claim]).reshape(len(queries), bins)
    nml = own / own.sum(1, keepdims=True)

    weight = redrawn(len(x), bins, seed).T / len(x)
    each = np.tile(x, (bins, 1))[..., None] / 4.0, np.tile(label, (bins, 1)), weight
    nets = fit(*map(jnp.asarray, each), jax.random.fold_in(key, 1), options.lr, **shape)
    boot = jax.vmap(lambda net: net.log_probs(jnp.asarray(queries[:, None] / 4.0)))(nets)
    return x, label, queries, nml, np.exp(np.asarray(boot)).mean(0)


def diffuse(case: str, *, seed: int, method: str) -> dict[str, float]:
    """How diffuse a method's beliefs are, and how surprised it is by the truth; data and networks are drawn with the seed.

    Args:
        case: `inside` or `outside` of the data.
        seed: of data and networks.
        method: `nml` or `ensemble`.

    Returns:
        entropy: mean over queries, nats.
        surprise: mean of -log p(truth), nats.
    """
    _, _, queries, *beliefs_of = beliefs(Options(), seed)
    return measures(queries, beliefs_of[("nml", "ensemble").index(method)], case == "inside")


def measures(queries: np.ndarray, probs: np.ndarray, inside: bool) -> dict[str, float]:
    """Mean entropy, and mean surprise at the truth, of the queries inside or outside of the data."""
    bins = probs.shape[1]
    truth = np.asarray(quantise(jnp.asarray((np.sin(queries) + 1) / 2), bins))
    where = np.any([(queries >= low) & (queries <= high) for low, high in SEEN], 0) == inside
    surprise = -np.log(np.maximum(probs[np.arange(len(queries)), truth], 1e-12))
    return {"entropy": float(entropy(probs)[where].mean()), "surprise": float(surprise[where].mean())}


def entropy(probs: np.ndarray) -> np.ndarray:
    """In nats, of each row."""
    return -(probs * np.log(np.maximum(probs, 1e-12))).sum(-1)


def main(options: Options) -> None:
    """Prints mean entropies and what the truth is given inside and outside of the data, and draws the first seed."""
    cache_compiled_programs()
    rows = []
    for seed in range(options.seeds):
        found = beliefs(options, seed)
        for name, probs in (("NML", found[3]), ("ensemble", found[4])):
            parts = [measures(found[2], probs, inside) for inside in (True, False)]
            rows.append((name, *parts[0].values(), *parts[1].values()))
        if seed == 0 and options.picture:
            draw(options, *found)
    print(f"entropy: {np.log(options.bins):.2f} at most; means over {options.seeds} seeds (range over seeds)\n")
    print("| | entropy inside | surprise at the truth inside | entropy outside | surprise at the truth outside |")
    print("|---|---:|---:|---:|---:|")
    for name in ("NML", "ensemble"):
        own = np.array([row[1:] for row in rows if row[0] == name])
        cells = [f"{m:.2f} ({a:.2f} to {b:.2f})" for m, a, b in zip(own.mean(0), own.min(0), own.max(0))]
        print(f"| {name} | " + " | ".join(cells) + " |")


def draw(options: Options, x, label, queries, nml, boot) -> None:
    """Both methods' probabilities as shades, with the data and the truth."""
    width, height, left, top = 430, 260, 46, 34
    panels: list[Markup] = []
    for k, (title, probs) in enumerate((("quantised NML", nml), ("bootstrapped ensemble", boot))):
        at = left + k * (width + left)
        w, h = width / len(queries), height / options.bins
        across = lambda v, at=at: at + (np.asarray(v) - SPAN[0]) / (SPAN[1] - SPAN[0]) * width  # noqa: E731
        up = lambda b: top + height * (1 - (np.asarray(b) + 0.5) / options.bins)  # noqa: E731
        panels.append(tag("text", title, x=at, y=top - 12, class_="title"))
        panels.append(tag("rect", x=at, y=top, width=width, height=height, class_="frame"))
        for i, row in enumerate(probs):
            for b, p in enumerate(row):
                shade = float(np.sqrt(p))  # faint ones are to be seen
                if shade > 0.03:
                    place = {"x": f"{at + i * w:.1f}", "y": f"{top + height - (b + 1) * h:.1f}"}
                    panels.append(tag("rect", **place, width=f"{w:.2f}", height=f"{h:.2f}", class_="p", opacity=f"{shade:.2f}"))
        fine = np.linspace(*SPAN, 200)
        y = top + height * (1 - (np.sin(fine) + 1) / 2)
        line = "M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in zip(across(fine), y))
        panels.append(tag("path", d=line, class_="truth"))
        panels += [tag("circle", cx=f"{across(v):.1f}", cy=f"{up(b):.1f}", r=3, class_="dot") for v, b in zip(x, label)]
        ticks = [-8, -4, 0, 4, 8]
        panels += [tag("text", str(t), x=f"{across(t):.1f}", y=top + height + 18, class_="tick") for t in ticks]
    style = (
        "text { font: 13px system-ui, sans-serif; fill: #1d2329 } .title { font-weight: 600 } .tick { text-anchor: middle }"
        " .frame { fill: #fff; stroke: #dcdfe2 } .p { fill: #0072b2 } .dot { fill: #c85200 }"
        " .truth { fill: none; stroke: #1d2329; stroke-dasharray: 3 3 }"
    )
    size = left + 2 * (width + left), top + height + 34
    ground = tag("rect", width="100%", height="100%", fill="#fff")
    box = f"0 0 {size[0]} {size[1]}"
    whole = tag("svg", tag("style", style), ground, panels, xmlns="http://www.w3.org/2000/svg", viewBox=box, width=size[0])
    with replacing(options.picture or "") as temporary:
        temporary.write_text(str(whole), encoding="utf-8")
    print(options.picture)


if __name__ == "__main__":
    main(tyro.cli(Options))
