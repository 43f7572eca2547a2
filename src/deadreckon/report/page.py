"""The page: sections in the order in which a reader needs them."""

import dataclasses
import datetime
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from deadreckon.data.entries import has_original
from deadreckon.errors import UserError
from deadreckon.files import write_text
from deadreckon.report import curves, decision, explained, provenance, simulated
from deadreckon.report import estimates as estimated
from deadreckon.report.entries import Page, read
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import coded, note
from deadreckon.report.rows import rows
from deadreckon.report.scores import scores
from deadreckon.runs.offline import read_estimates
from deadreckon.runs.run import Run

OWN = ": collected by this package; there is no original."
AGAIN = ": collected again by this package, after the original's recipe, on today's simulator; not the original file."


def check_page(out: Path | str, option: str = "") -> None:
    """Refuses a page whose name is that of something else, which it would replace.

    Args:
        out: the page.
        option: that named it, for the error.

    Raises:
        UserError: it does not end in .html or .htm.
    """
    if Path(out).suffix.lower() not in (".html", ".htm"):
        raise UserError(f"{option} {out}: the page is HTML, and its name must end in .html".lstrip())


def save_page(text: str, out: Path | str) -> Path:
    """Writes a page; an old one is replaced.

    Raises:
        UserError: its name is that of something else (`check_page`), or it cannot be written.
    """
    check_page(out)
    return write_text(out, text)


def write(
    runs: Sequence[Path | str | Run], out: Path | str, *, title: str | None = None, estimates: Path | str | None = None
) -> Path:
    """Writes one self-contained HTML page about run folders of one task.

    Args:
        runs: run folders, finished or not.
        out: the page; an old one is replaced.
        title: heading; None makes one from the task or log.
        estimates: what the policies were estimated at from the log: the folder that `runs.offline.judge` wrote to.

    Raises:
        UserError: nothing to show, a path that is not a run, runs of different tasks, or an output that cannot be written.
    """
    check_page(out)
    told = None if estimates is None else read_estimates(estimates)
    page, lead = read(runs), None
    if told is not None and estimates is not None:
        told, lead = decision.as_it_is(page, told, estimates)
    return save_page(render(dataclasses.replace(page, estimates=told), title, lead), out)


def render(page: Page, title: str | None = None, lead: str | None = None) -> str:
    """The page as text; it begins with `lead`, or what there is to say in one sentence."""
    shown, told = rows(page), page.estimates
    found = simulated.compare(page, shown)
    if lead is None and told is not None:
        lead = decision.headline(told)
    elif lead is None:
        lead = decision.unjudged(page) if found is None else found.headline
    logs = list(dict.fromkeys(e.config["data"]["name"] for e in page.entries if not e.online))
    kind = "Policies trained online in" if page.online else "Offline policies for"
    title = title or f"{kind} {page.task_name or ', '.join(logs)}"
    checked = "Checked in" if told and told["truth"] else "In"
    sections = [
        ("decision", "Decision", decision.card(page)),
        ("estimates", "From the log alone", estimated.section(page)),
        ("simulator", f"{checked} the simulator", simulated.section(page, shown, found)),
        ("scores", "Scores" if found else "Runs", scores(page, shown)),
        ("learning", "Learning curves", curves.learning(page)),
        ("values", "Estimated and realised return", curves.values(page)),
        ("explained", "What the policy does", explained.section(page)),
        ("distance", "Distance to the log", curves.distance(page, shown)),
        ("training", "Training", curves.training(page)),
        ("mazes", "Trajectories", curves.trajectories(page)),
        ("provenance", "Provenance", provenance.section(page)),
    ]
    return document(title, lead, _facts(page, logs), sections, _collected(logs))


def _collected(logs: Sequence[str]) -> Markup | None:
    """Which logs are this package's: collected after a benchmark's recipes, or by its own."""
    ours = [name for name in logs if "@dr" in name]
    parts = ([name for name in ours if has_original(name.partition("@")[0]) == known] for known in (True, False))
    lines = [note(tag("code", ", ".join(names)), words) for names, words in zip(parts, (AGAIN, OWN)) if names]
    return join(*lines) if lines else None


def document(
    title: str,
    lead: str,
    facts: Sequence[tuple[str, Any]],
    sections: Sequence[tuple[str, str, Markup | None]],
    remark: Markup | None = None,
) -> str:
    """A self-contained page.

    Args:
        title: heading.
        lead: what there is to say in one sentence.
        facts: name and value of what belongs at the top; the date is added.
        sections: id, heading and content; those without content are left out.
        remark: below the facts.
    """
    shown = [(name, heading, body) for name, heading, body in sections if body]
    links = tag("nav", [tag("a", heading, href=f"#{name}") for name, heading, _ in shown], aria_label="sections")
    facts = [*facts, ("date", datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M"))]
    header = tag(
        "header",
        tag("div", tag("h1", title), tag("button", "theme", type="button", id="theme", title="light or dark"), class_="top"),
        tag("p", coded(lead), class_="lead"),
        tag("dl", [tag("div", tag("dt", name), tag("dd", value)) for name, value in facts], class_="facts"),
        remark,
        links,
    )
    body = join(
        header,
        tag("main", [tag("section", tag("h2", heading), body, id=name) for name, heading, body in shown]),
        tag("footer", "Made by deadreckon; the file holds everything it shows and loads nothing."),
    )
    parts = {"title": tag("title", title), "body": body, "css": asset("page.css"), "js": asset("page.js")}
    return Template(asset("page.html")).substitute(parts)


def asset(name: str) -> str:
    """The text of a file that pages are made of."""
    return resources.files("deadreckon.report").joinpath("assets", name).read_text(encoding="utf-8")


def _facts(page: Page, logs: list[str]) -> list[tuple[str, Any]]:
    facts: list[tuple[str, Any]] = [("task", page.task_name or "none: not simulated")]
    if logs:
        facts.append(("log", ", ".join(logs)))
        rows = dict.fromkeys(f"{e.config['data'].get('rows', 0):,}" for e in page.entries if not e.online)
        facts.append(("rows", ", ".join(rows)))
    acted = dict.fromkeys(f"{e.environment_steps(e.status.get('step', 0)):,}" for e in page.entries if e.online)
    if acted:
        facts.append(("environment steps per seed", ", ".join(acted)))
    return facts
