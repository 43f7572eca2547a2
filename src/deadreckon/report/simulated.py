"""What the simulator says of the runs: which is best there, by how much, and why. It compares and decides nothing.

Whether to deploy a policy is decided from the log alone, by `ope.select`. Where there is a simulator too, this checks it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from deadreckon.report import forest
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, tag
from deadreckon.report.parts import coded, figure, note, tile, unit_of
from deadreckon.report.rows import Difference, Row, log_row, versus
from deadreckon.report.text import brackets, number, percent, score, words
from deadreckon.stats.interval import ALPHA, PERCENT, Interval
from deadreckon.tasks.mazes import Maze


@dataclass(frozen=True)
class Comparison:
    """What a simulator says.

    Attributes:
        standing: whether it is the best of several, in words.
        headline: one sentence.
        best: the row with the highest mean at the last evaluation.
        log: the behaviour policy of its log.
        cloning: the best behaviour cloning row.
        versus_log: best minus behaviour policy.
        versus_cloning: best minus cloning.
        compared: how many differences are looked at; the intervals hold for all of them at once (Bonferroni).
        beaten: what the agents did to cloning, in words, and why.
        caveats: what this does not show.
    """

    standing: str
    headline: str
    best: Row
    log: Row | None = None
    cloning: Row | None = None
    versus_log: Difference | None = None
    versus_cloning: Difference | None = None
    compared: int = 0
    beaten: list[str] = field(default_factory=list)
    caveats: list[str] = field(default_factory=list)


def compare(page: Page, rows: Sequence[Row]) -> Comparison | None:
    """Compares the runs of a page, which has these rows; None where no evaluation is finished.

    What learned in the simulator is no candidate beside what learned from a log.
    """
    judged = [r for r in rows if r.entry is not None and r.worth is not None and math.isfinite(r.worth.value)]
    beside = [r for r in judged if r.online]
    judged = [r for r in judged if not r.online] or beside
    if not judged:
        return None
    best = judged[0]
    assert best.entry is not None
    logs = [log_row(page, r.entry) for r in judged if r.entry is not None]
    log = logs[0]
    cloning = next((r for r in judged if r.baseline), None)
    compared = sum(own is not None for own in logs) + (sum(not r.baseline for r in judged) if cloning else 0)
    miss = ALPHA / max(compared, 1)  # one of the page's differences may miss so often
    over_log = versus(best, log, miss) if log else None
    over_cloning = versus(best, cloning, miss) if cloning and cloning is not best else None
    level = f"{'score' if best.score else 'return'} {score(best.worth)}"
    standing = "Best in the simulator" if len(judged) > 1 else "In the simulator"
    headline = f"{standing}: {best.label}, {level}"
    if over_log:
        gain = over_log.worth
        side = "above" if gain.value >= 0 else "below"
        size = Interval(gain.value, gain.low, gain.high) if gain.value >= 0 else Interval(-gain.value, -gain.high, -gain.low)
        headline += f", {score(size)} {brackets(size)} {side} the behaviour policy"
        headline += "" if gain.low > 0 or gain.high < 0 else ", which may be chance"
    return Comparison(
        standing, f"{headline}.", best, log, cloning, over_log, over_cloning, compared,
        [] if best.online else _beaten(page, judged, cloning, log, miss), _caveats(judged, best, [] if best.online else beside),
    )  # fmt: skip


def section(page: Page, rows: Sequence[Row], found: Comparison | None) -> Markup | None:
    """Which run is best, by how much, why, and what that does not show."""
    if found is None:
        return None
    best = found.best
    tiles = [tile(f"{unit_of(page)}, {best.label}", best.worth, False)]
    if found.versus_log:
        tiles.append(_gap("above the behaviour policy", found.versus_log))
    if found.versus_cloning and found.cloning:
        tiles.append(_gap(f"above {found.cloning.label}, paired", found.versus_cloning))
    head = tag("p", tag("strong", found.standing, class_="stamp"), tag("span", best.label, class_="which"))
    said = tag("p", found.headline, class_="because") if page.estimates else None  # else it stands at the top of the page
    text = [head, said, tag("div", tiles, class_="tiles")]
    lines = [tag("p", line) for line in found.beaten]
    why = tag("div", tag("h3", "What beats imitation, and why"), lines, class_="why") if lines else None
    many = found.compared > 1
    how = note(
        "Means over seeds and episodes of the last evaluation, with deterministic (greedy) actions, each with its own "
        f"{PERCENT} interval, in which both seeds and episodes count as chance. Differences are paired where episodes start "
        "alike"
        + (f"; their intervals hold for all {found.compared} comparisons of this page at once (Bonferroni). " if many else ". ")
        + (f"The behaviour policy's value is the {_how(page)}; its own uncertainty is in the difference." if found.log else "")
    )
    items = tag("ul", [tag("li", coded(line)) for line in found.caveats], class_="caveats")
    lower = tag("div", why, tag("div", tag("h3", "What this does not show"), items), class_="split lower" if why else "lower")
    return tag("div", tag("div", tag("div", text), _forest(page, rows), class_="split"), lower, how, class_="card")


def _how(page: Page) -> str:
    known = [str(e.behavior["how"]) for e in page.entries if e.behavior and e.behavior.get("how")]
    return known[0] if known else "return found in the log"


def _gap(name: str, gap: Difference) -> Markup:
    r = gap.returns
    beside = f"return {score(r, signed=True)} {brackets(r, signed=True)}" if gap.score else None
    return tile(name, gap.worth, True, beside)


def _forest(page: Page, rows: Sequence[Row]) -> Markup | None:
    unit = unit_of(page)
    marks = []
    for r in rows:
        spread = r.score if unit == "score" else r.returns
        if spread and math.isfinite(spread.value):
            marks.append(forest.Mark(r.label, page.slot(r.entry) if r.entry else None, spread, r.per_seed))
    if not marks:
        return None
    dots = any(len(mark.dots) > 1 for mark in marks)
    drawn = forest.forest(marks, f"{unit}: mean and {PERCENT} interval", [("expert", 100.0)] if unit == "score" else [])
    return figure(drawn, f"{unit}: mean and {PERCENT} interval{'; small dots: seeds' if dots else ''}")


def _beaten(page: Page, judged: list[Row], cloning: Row | None, log: Row | None, miss: float) -> list[str]:
    if cloning is None:
        return ["No behaviour cloning run is on this page, so it cannot show what learning values adds to imitation."]
    gaps = [(r, versus(r, cloning, miss)) for r in judged if not r.baseline]
    better = [(r, gap) for r, gap in gaps if gap and gap.worth.low > 0]
    others = [r.label for r, gap in gaps if not gap or gap.worth.low <= 0]
    if not gaps:
        return ["Only behaviour cloning is on this page: there is nothing to compare it with."]
    if not better:
        return [f"No agent clearly beats {cloning.label}: every interval of the difference reaches to zero or below."]
    listed = words([f"{r.label} by {score(gap.worth)} {brackets(gap.worth)}" for r, gap in better])
    said = f"Clearly better than behaviour cloning ({cloning.label}): {listed}."
    if others:
        said += f" Not clearly better: {words(others)}."
    return [said, *_why(page, better[0][0], cloning, log), *_misled(judged)]


def _why(page: Page, best: Row, cloning: Row, log: Row | None) -> list[str]:
    assert best.entry is not None
    out = []
    directed = not isinstance(page.task, Maze) or "undirected data" not in page.task.properties
    undirected = not directed and bool((best.entry.config["data"].get("provenance") or {}).get("recipe"))
    level = f" (value of the behaviour policy: {score(log.worth)})" if log and log.worth else ""
    if undirected:
        out.append(
            f"The log has goals of its own, most of which are not the task's, so much of it leads elsewhere{level}. Cloning "
            f"repeats the average of all goals and has the value {score(cloning.worth)}."
        )
    if best.mmd is not None and cloning.mmd is not None:
        further, copy = best.mmd > max(cloning.mmd, best.copy or 0.0), best.copy
        hidden = cloning.mmd < best.mmd and not further
        far = "further from" if further else "not measurably further from" if hidden else "no further from"
        said = f"{best.label}'s actions are {far} the logged ones than the clone's (MMD {number(best.mmd)} against "
        said += number(cloning.mmd)
        said += ")" if copy is None else f"; a copy stays below {number(copy)} in {PERCENT} of samples)"
        if best.outside is not None:
            said += f", with {percent(best.outside)} of them outside the log's range"
        if further:
            said += ": it departs from the log where its values see more reward"
            said += (
                ", as joining pieces of logged paths into one to the goal needs (see its trajectories)" if undirected else ""
            )
        out.append(said + ".")
    if best.over is not None:
        calm = abs(best.over) <= max(0.5 * abs(best.truth or 0), 1.0)
        said = f"Its critic estimated {number(best.value)} at the starts; {number(best.truth)} was realised (discounted)"
        wrong = ": its values can at most rank actions, they are not amounts of reward."
        out.append(said + (": close enough to guide it." if calm else wrong))
    return out


def _misled(judged: list[Row]) -> list[str]:
    exploded = [r for r in judged if r.over is not None and r.over > max(2 * abs(r.truth or 0), 10.0)]
    if not exploded:
        return []
    listed = words([f"{r.label}'s critic estimated {number(r.value)} where {number(r.truth)} was realised" for r in exploded])
    return [f"{listed}: values of actions that the log never shows are guesses, and a policy that maximises them follows the "
            "largest mistake (thesis 4.1)."]  # fmt: skip


def _caveats(judged: list[Row], best: Row, beside: list[Row]) -> list[str]:
    assert best.entry is not None
    out = []
    if not best.entry.status.get("finished"):
        out.append(f"The run of {best.label} is not finished.")
    if failed := best.entry.failed:
        seed, metric, step = failed[0]
        out.append(
            f"{len(failed)} of {len(best.entry.seeds)} seeds of {best.label} failed (seed {seed}: {metric} was not finite at "
            f"update {step:,}), so training it again may fail too."
        )
    if best.online:
        out.append("It was evaluated in its training simulator: nothing here shows how it performs in a system that differs.")
    else:
        out.append(
            "This ran the policies in the simulator. A real system has only its log: whether to deploy is decided from the log "
            "alone (`deadreckon ope --select`)."
        )
    if beside:
        out.append(f"Trained in the simulator and shown for comparison only: {words([r.label for r in beside])}.")
    if len(judged) > 1:
        out.append(f"{best.label}'s own mean is that of the best of {len(judged)}, so it is slightly too high on average.")
    seeds = len(best.per_seed)
    if alone := [r.label for r in judged if len(r.per_seed) == 1]:
        out.append(
            f"One seed of {words(alone)}: differences are those of these policies, and training again may give others. Nothing "
            "here shows how much of the result is due to chance in one training run."
        )
    if 1 < seeds < 5:
        out.append(f"With {seeds} seeds the interval is unreliable: so few runs say little about their spread.")
    return out
