"""The sections that are pictures."""

from collections.abc import Sequence

import numpy as np

from deadreckon.report import charts, maze, spacetime
from deadreckon.report.entries import Entry, Page
from deadreckon.report.forest import SLOTS
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import figure, legend, note, unit_of
from deadreckon.report.rows import Row, behavior, to_score
from deadreckon.stats.interval import PERCENT, Interval
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.mazes import Maze

EXPLODED = 20.0  # estimates this many times beyond every return are shown on a logarithmic axis
DISTANCES = (("mmd_to_data", "MMD to the log", 1.0), ("outside_range", "% of actions outside the log's range", 100.0))
SHOWN = 8  # episodes in a maze picture
KEYS = ("step", "seed", "environment_steps")  # columns of the metrics that are none
METRICS = {
    "actor_loss": "what the actor minimises",
    "critic_loss": "squared Bellman error on batches",
    "q": "mean estimated value on batches",
    "mmd": "sampled MMD to its model of the log",
    "behavior_nll": "negative log-likelihood of logged actions",
}


def learning(page: Page) -> Markup | None:
    """Worth against updates or environment steps."""
    unit = unit_of(page)
    series = [_series(page, e, unit) for e in page.entries if unit in e.evaluations]
    if not series:
        return None
    logs = {e.config["data"]["fingerprint"]: e for e in page.entries}.values()
    worths = [worth for e in logs if (returns := behavior(e)) and (worth := _worth(page, returns))]
    references = [("behaviour policy", worth.value) for worth in worths]
    references += [("expert", 100.0)] if unit == "score" else []
    options = {"title": f"{unit} against {page.across}", "unit": unit, "references": references, "across": page.across}
    both = [
        charts.lines(series, size=size, labels=wide, **options) for wide, size in ((True, (1040, 400)), (False, (480, 360)))
    ]
    return join(
        legend(page),
        figure(both[0], class_="wide"),
        figure(both[1], class_="narrow"),
        note(f"Mean {unit} over the episodes of each evaluation; line: mean over seeds, band: lowest to highest seed. "
              "All evaluations use the same starts. Click a name to hide an agent in every chart."),
    )  # fmt: skip


def _series(page: Page, e: Entry, name: str, factor: float = 1.0) -> charts.Series:
    x, y = e.curve(name, page.online)
    return charts.Series.over_seeds(e.label, page.slot(e), x, y * factor)


def _worth(page: Page, returns: Interval) -> Interval | None:
    return to_score(page.task, returns) if unit_of(page) == "score" else returns


def values(page: Page) -> Markup | None:
    """Estimated against realised return, a panel per agent (thesis, Figures 4.1 and A.2)."""
    shown = [e for e in page.entries if "estimated_value" in e.evaluations and "discounted_return" in e.evaluations]
    if not shown:
        return None
    figures = []
    for e in shown:
        estimated, realised = (e.curve(name, page.online) for name in ("estimated_value", "discounted_return"))
        known = np.abs(estimated[1][np.isfinite(estimated[1])])
        true = np.abs(realised[1][np.isfinite(realised[1])])
        far = bool(len(known)) and known.max() > EXPLODED * max(1.0, true.max() if len(true) else 1.0)
        series = [
            charts.Series.over_seeds("estimated", page.slot(e), *estimated),
            charts.Series.over_seeds("realised", page.slot(e), *realised, dashed=True),
        ]
        title = f"{e.label}: estimated and realised return"
        chart = charts.lines(series, title=title, unit="discounted return", symlog=far, size=(320, 240), across=page.across)
        figures.append(figure(chart, e.label, data_agent=page.slot(e)))
    without = [e.label for e in page.entries if e not in shown]
    learned = "Online, the critic soon sees the rewards of the actions it prefers. "
    if not page.online:
        learned = "A critic trained on a log does not see the rewards of actions that the log lacks. "
    bonus = "SAC's value includes its entropy bonus, the return does not. " if any(e.agent == "sac" for e in shown) else ""
    return join(
        tag(
            "p",
            learned,
            "Where the solid line (",
            tag("b", "estimated"),
            ": the critic's value at the start) runs above the dashed one (",
            tag("b", "realised"),
            ": Monte-Carlo discounted return of the same starts), it overestimates (thesis, Figures 4.1 and A.2).",
        ),
        tag("div", figures, class_="charts"),
        note(
            "Bands: lowest to highest seed. An episode stops at the horizon, the critic's value does not: a policy that "
            f"collects reward to the end has an estimate slightly above what an episode can realise. {bonus}"
            "Axes differ between panels." + (f" No critic: {', '.join(without)}." if without else "")
        ),
    )


def distance(page: Page, rows: Sequence[Row]) -> Markup | None:
    """How far policies moved away from the log."""
    figures, inside = [], ""
    # What the MMD of a copy of each log's policy stays below; means of equal numbers differ in their last bits.
    copies = sorted({round(r.copy, 4) for r in rows if r.copy is not None})
    for name, unit, factor in DISTANCES:
        series = []
        for e in page.entries:
            if name in e.evaluations:
                series.append(_series(page, e, name, factor))
        if name == "outside_range" and series and not any(np.nanmax(s.y, initial=0.0) for s in series):
            inside = "No agent took an action outside the log's range at any evaluation. "
        elif series:
            title = f"{unit} against {page.across}"
            lines = [(f"{PERCENT} limit of a copy", value) for value in copies] if name == "mmd_to_data" else []
            figures.append(figure(charts.lines(series, title=title, unit=unit, across=page.across, references=lines)))
    if not figures:
        return None
    told = f" Horizontal line: a copy of the log's policy stays below it in {PERCENT} of samples." if copies else ""
    return join(
        legend(page),
        tag("div", figures, class_="charts two"),
        note(
            inside + "How far each policy's actions moved from the logged ones at the same states. Imitation stays near zero; "
            "an agent that improves on the log has to leave it somewhat; for one that leaves it far, no data supports its "
            f"values.{told}"
        ),
    )


def training(page: Page) -> Markup | None:
    """Whatever else was measured, folded away."""
    names = list(dict.fromkeys(n for e in page.entries for n in e.metrics if n not in KEYS))
    figures = []
    for name in names:
        with_it = [e for e in page.entries if name in e.metrics]
        series = [_series(page, e, name) for e in with_it]
        values = np.concatenate([np.abs(s.y[np.isfinite(s.y)]) for s in series])
        far = len(values) > 0 and values.max() > EXPLODED and values.max() > 50 * max(float(np.median(values)), 1e-9)
        title, unit = f"{name} against {page.across}", METRICS.get(name, "")
        chart = charts.lines(series, title=title, unit=unit, symlog=bool(far), size=(320, 220), across=page.across)
        figures.append(figure(chart, name))
    if not figures:
        return None
    open_ = "open" if page.task_name is None else None
    return tag(
        "details",
        tag("summary", f"Losses and other metrics ({len(figures)} charts)"),
        legend(page),
        tag("div", figures, class_="charts"),
        note("Means over the updates of a chunk; bands: lowest to highest seed."),
        open=open_,
    )


def trajectories(page: Page) -> Markup | None:
    """Trajectories of the log and of the agents (thesis D.7) in a maze or on a road; None where there is neither."""
    task = page.task
    if isinstance(task, Flow):
        return _roads(page, task)
    if not isinstance(task, Maze):
        return None
    figures = []
    stretches = next((e.segments for e in page.entries if e.segments is not None), None)
    if stretches is not None:
        slots = [i % SLOTS for i in range(len(stretches))]
        drawn = maze.picture(task, list(stretches), slots, "stretches of the log", False)
        figures.append(figure(drawn, "the log"))
    for e in page.entries:
        ways = e.trajectories
        if ways is None or not len(ways):
            continue
        ways = list(ways[0][:SHOWN])
        drawn = maze.picture(task, ways, [page.slot(e)] * len(ways), f"{e.label}: {len(ways)} episodes", True)
        figures.append(figure(drawn, e.label, data_agent=page.slot(e)))
    if not figures:
        return None
    of_log = ""
    if stretches is not None:
        of_log = (
            " The log's has stretches of consecutive rows, spread evenly over it; there colours tell stretches apart and mean "
            "nothing else."
        )
    return join(
        tag("div", figures, class_="mazes"),
        note(
            "From above, as the layout is written. Star: goal, or the middle of where an episode's lies; shaded: where a step "
            "can be rewarded. An agent's panel has the first episodes of the last evaluation (first seed), ring: start, dot: "
            f"end.{of_log}"
        ),
    )


def _roads(page: Page, task: Flow) -> Markup | None:
    figures = []
    for e in page.entries:
        if e.trajectories is not None and len(e.trajectories):
            title = f"{e.label}: where the cars are against time"
            drawn = spacetime.spacetime(e.trajectories[0, 0], task.seconds, task.learners, title)
            figures.append(figure(drawn, e.label, data_agent=page.slot(e)))
    if not figures:
        return None
    return join(
        tag("div", figures, class_="charts two"),
        note(
            "The first episode of the last evaluation (first seed): position along the road against time, one line per car, "
            "coloured by speed; thin lines in the colour of the headings are learners. Waves of stopping and going are bands "
            "that run backwards."
        ),
    )
