"""The page about a log: what was read, what should be known of it, and pictures of its columns, returns and actions."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.info import Info
from deadreckon.data.spec import Box
from deadreckon.data.told import LEVELS, Told, action_names, columns_of, observation_names
from deadreckon.report import bars, charts, film, forest
from deadreckon.report.charts import Series
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document, save_page
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number

ROWS = 20_000  # that are drawn
_FIGURES = 60  # columns that have a picture
_LISTED = 400  # columns in the table
_LINES = forest.SLOTS  # actions, or dimensions of them, in one chart
_PIECES = 40  # points along a time axis


def write_log(log: Dataset, out: Path | str, info: Info, warnings: Sequence[str]) -> Path:
    """Writes one self-contained HTML page about a log.

    Args:
        log: to be shown; of a long one, rows at regular distances are drawn.
        out: the page; an old one is replaced.
        info: what `data.info.describe` gave.
        warnings: what should be known, one line each.

    Raises:
        UserError: the page cannot be written.
    """
    rows = np.unique(np.linspace(0, len(log) - 1, min(len(log), ROWS)).astype(int))
    columns = columns_of(log)
    sampled = f"Charts of rows show {len(rows):,} of {info.rows:,} rows, at regular distances." if len(rows) < len(log) else ""
    sections: list[tuple[str, str, Markup | None]] = [
        ("warnings", "Warnings", tag("ul", [tag("li", line) for line in warnings], class_="caveats") if warnings else None),
        ("films", "Images", film.strips(log)),
        ("columns", "Columns", columns_table(columns)),
        ("values", "Values of the columns", _pictures(log, columns, rows)),
        ("returns", "Returns and lengths of episodes", _returns(log)),
        ("actions", "Actions over time", _over_time(log, rows)),
        ("coverage", "Coverage", _coverage(log, rows)),
    ]
    told = f"{len(warnings)} warning{'' if len(warnings) == 1 else 's'}." if warnings else "No warnings."
    lead = f"{info.rows:,} rows in {info.episodes:,} episodes. {told}"
    text = document(f"The log {log.name}", lead, _facts(info), sections, note(sampled) if sampled else None)
    return save_page(text, out)


def _facts(info: Info) -> list[tuple[str, str]]:
    shape = "x".join(map(str, info.observation_shape))
    return [
        ("source", info.source), ("fingerprint", info.fingerprint), ("rows", f"{info.rows:,}"),
        ("episodes", f"{info.episodes:,}"), ("steps per episode", f"{info.lengths[0]:g} to {info.lengths[-1]:g}"),
        ("ends", f"{info.terminal_share:.1%} terminal, {info.timeout_share:.1%} timeout"),
        ("without a next observation or terminal", f"{info.dropped:,} rows"),
        ("observation", f"{shape} {info.observation_dtype}"),
        ("actions", info.action), ("mean return", number(info.mean_return)), ("mean reward", number(info.reward_mean)),
    ]  # fmt: skip


def columns_table(columns: Sequence[Told], most: int = _LISTED) -> Markup:
    """A row for each column of a log, `most` of them."""
    rows = []
    for each in columns[:most]:
        missing = "not counted" if each.missing is None else f"{each.missing:,}"
        cells = [tag("td", text, class_="text") for text in (each.role, each.kind, each.holds)]
        cells += [tag("td", missing), tag("td", each.becomes, class_="text")]
        rows.append(tag("tr", tag("th", each.name, scope="row"), cells))
    head = heads_of(["column", "role", "kind", "levels or range", "missing cells", "becomes"])
    more = len(columns) - len(rows)
    table = scroll(tag("table", head, tag("tbody", rows), class_="listed"))
    return join(table, note(f"{more:,} more are not listed.") if more > 0 else None)


def _pictures(log: Dataset, columns: Sequence[Told], rows: np.ndarray) -> Markup:
    """A chart of each column that the log holds."""
    drawn = [picture for each in columns if (picture := _picture(log, each, rows)) is not None]
    remarks = []
    if len(log.spec.observation_shape) > 1:
        remarks.append("Values of images are not drawn; see the film strips above.")
    if len(drawn) > _FIGURES:
        remarks.append(f"The first {_FIGURES} of {len(drawn):,} columns are drawn.")
    if any(each.role in ("ignore", "time", "episode", "not in the schema") for each in columns):
        remarks.append("Columns that are left out, or only order the rows, are not drawn.")
    return join(tag("div", drawn[:_FIGURES], class_="charts"), note(" ".join(remarks)) if remarks else None)


def _picture(log: Dataset, column: Told, rows: np.ndarray) -> Markup | None:
    chart = _chart(log, column, rows)
    if chart is None:
        return None
    missing = "" if not column.missing else f"{column.missing:,} missing"
    about = ", ".join(filter(None, (column.role, column.kind, column.holds, missing)))
    return figure(join(chart, note(about)), column.name)


def _chart(log: Dataset, column: Told, rows: np.ndarray) -> Markup | None:
    title = f"values of {column.name}"
    if column.role == "observation" and column.dimensions:
        flat = np.asarray(log.observations[rows]).reshape(len(rows), -1)[:, list(column.dimensions)]
        names = [observation_names(log)[i] for i in column.dimensions]
        if column.kind == "category":
            known = [name.removeprefix(f"{column.name}=").replace(f"{column.name}_missing", "missing") for name in names]
            return bars.shares(known, flat.sum(0), title)
        seen = flat[:, -1] == 0 if len(names) > 1 else np.ones(len(rows), bool)  # what was filled up is no value
        return bars.histogram(flat[seen, 0], title)
    if column.role == "action":
        acted = np.asarray(log.actions[rows]).reshape(len(rows), -1)[:, column.dimensions[0]]
        if isinstance(log.action_space, Box):
            return bars.histogram(acted, title)
        names = action_names(log)
        return bars.shares(names, np.bincount(acted.astype(int), minlength=len(names)), title)
    if column.role == "reward":
        return bars.histogram(np.asarray(log.rewards[rows]), title)
    kept = log.extras.get(column.name)
    if kept is None or kept.ndim > 1 or column.kind == "category":
        return None
    return bars.histogram(np.asarray(kept[rows]), title)


def _returns(log: Dataset) -> Markup:
    parts = [figure(bars.histogram(log.returns(), "returns of episodes", "episodes"), "Returns (undiscounted sum of rewards)")]
    parts.append(figure(bars.histogram(log.lengths, "lengths of episodes", "episodes"), "Steps per episode"))
    return join(tag("div", parts, class_="charts"), note("One count per episode, over the whole log."))


def _over_time(log: Dataset, rows: np.ndarray) -> Markup:
    """What is done at which step of an episode, and in which part of the log."""
    names, unit = action_names(log), "share of rows"
    acted = np.asarray(log.actions[rows])
    if isinstance(log.action_space, Box):
        values, unit = acted.astype(np.float64), "mean action"
        chosen = list(range(min(values.shape[1], _LINES)))
    else:
        count = np.bincount(acted.astype(int), minlength=len(names))
        chosen = sorted(np.argsort(-count, kind="stable")[:_LINES].tolist())
        values = (acted[:, None] == np.arange(len(names))).astype(np.float64)
    step = rows - log.starts[log.episode_of[rows]]
    series = []
    for at in (step, rows):
        edges = np.unique(np.linspace(0, at.max() + 1, min(_PIECES, int(at.max()) + 1) + 1).astype(int))
        piece = np.searchsorted(edges, at, side="right") - 1
        used, place = np.unique(piece, return_inverse=True)
        means = [np.bincount(place, values[:, k]) / np.bincount(place) for k in chosen]
        middle = edges[used].astype(float)
        series.append([Series(names[k], i, middle, mean) for i, (k, mean) in enumerate(zip(chosen, means))])
    parts = [charts.keys([(names[k], i) for i, k in enumerate(chosen)])]
    drawn = []
    if len(series[0][0].x) > 1:
        chart = charts.lines(series[0], title="actions within an episode", unit=unit, across="step of the episode")
        drawn.append(figure(chart, "Within an episode"))
    drawn.append(figure(charts.lines(series[1], title="actions over the log", unit=unit, across="row"), "Over the log"))
    left = len(names) - len(chosen)
    remarks = [f"{left:,} more actions are not drawn."] if left else []
    remarks += ["All episodes have one step, so that there is no time within them."] if len(drawn) == 1 else []
    return join(*parts, tag("div", drawn, class_="charts two"), note(" ".join(remarks)) if remarks else None)


def _coverage(log: Dataset, rows: np.ndarray) -> Markup:
    """How much of each action's range is used, and where observations lie."""
    names = action_names(log)
    if isinstance(log.action_space, Box):
        heads, body = ["action", "5 % to 95 % of the rows", "share of the bounds between them"], []
        for i, name in enumerate(names[:_LISTED]):
            low, high = np.quantile(np.asarray(log.actions[rows, i], np.float64), (0.05, 0.95))
            share = (high - low) / (log.action_space.high[i] - log.action_space.low[i])
            cells = (f"{number(float(low))} to {number(float(high))}", f"{share:.0%}")
            body.append(tag("tr", tag("th", name, scope="row"), [tag("td", cell) for cell in cells]))
        acted = scroll(tag("table", heads_of(heads), tag("tbody", body)))
    else:
        counts = np.bincount(np.asarray(log.actions).astype(int), minlength=len(names))
        used = f"{int((counts > 0).sum()):,} of {len(names):,} actions occur in the log"
        rarest = int(np.argmin(np.where(counts > 0, counts, counts.max() + 1)))
        acted = tag("p", f"{used}; the rarest of these is {names[rarest]}, in {counts[rarest]:,} of {len(log):,} rows.")
    return join(acted, tag("h3", "Where observations lie"), _plane(log, rows))


def _plane(log: Dataset, rows: np.ndarray) -> Markup:
    """The first two principal components of the standardised observations."""
    if len(log.spec.observation_shape) > 1:
        return note("Images have too many numbers for that; see the film strips above.")
    flat = np.asarray(log.observations[rows], np.float64).reshape(len(rows), -1)
    flat, names = flat[:, flat.std(0) > 0], [n for n, s in zip(observation_names(log), flat.std(0)) if s > 0]
    if flat.shape[1] < 2:
        return note("Fewer than two dimensions of the observation vary; see the values of the columns.")
    scaled = (flat - flat.mean(0)) / flat.std(0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled / len(scaled))
    values, vectors = values[::-1], vectors[:, ::-1]
    share = values[:2] / values.sum()
    made = []
    for k, order in enumerate(("first", "second")):
        most = np.argsort(-np.abs(vectors[:, k]), kind="stable")[: LEVELS // 2]
        made.append(f"the {order} most by {', '.join(names[i] for i in most)}")
    at = scaled @ vectors[:, :2]
    chart = bars.density(at[:, 0], at[:, 1], f"first component ({share[0]:.0%})", f"second component ({share[1]:.0%})")
    told = f"The two principal components explain {share.sum():.0%} of the variance of the standardised observations: "
    return join(tag("div", figure(chart), class_="charts two"), note(told, "; ".join(made), ". Darker cells hold more rows."))
