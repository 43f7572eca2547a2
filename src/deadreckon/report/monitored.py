"""The page about a policy in use: what was found, the realised value over time, and every column against its log."""

from pathlib import Path

import numpy as np

from deadreckon.files import replacing
from deadreckon.report import charts
from deadreckon.report.charts import Series
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document
from deadreckon.report.parts import figure, heads_of, note, scroll
from deadreckon.report.text import number, percent
from deadreckon.runs.monitor import Monitored
from deadreckon.runs.realised import Realised
from deadreckon.stats.interval import level_in_words


def write_monitored(found: Monitored, out: Path | str) -> Path:
    """Writes one self-contained HTML page about what `runs.monitor.monitor` found.

    Args:
        found: what it gave.
        out: the page; an old one is replaced.

    Raises:
        UserError: the page cannot be written.
    """
    alarms = [each for each in found.findings if each.alarm]
    lead = "Nothing was found."
    if alarms:
        names = dict.fromkeys(f"{each.about} {each.name}" for each in alarms)
        lead = f"{len(names)} finding{'' if len(names) == 1 else 's'}: {', '.join(names)}."
    facts = [
        ("policy", found.name), ("new log", found.log), ("rows", f"{found.rows:,}"),
        ("finished episodes", f"{found.episodes:,}"),
        ("reference", found.reference), ("false alarms", f"at most {percent(found.alpha)}, over all looks"),
    ]  # fmt: skip
    sections = [
        ("findings", "Findings", _findings(found)),
        ("value", "Realised value", _value(found)),
        ("columns", "Observations and actions", _columns(found)),
        ("outside", "Outside the log", _outside(found)),
    ]
    text = document(f"Monitoring {found.name}", lead, facts, sections, note(_sentence(found.compared)))
    with replacing(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(out)


def _findings(found: Monitored) -> Markup:
    marked = [(tag("b", "Alarm: ") if each.alarm else None, each) for each in found.findings]
    return tag("ul", [tag("li", mark, f"{each.about} {each.name}: {each.text}") for mark, each in marked], class_="caveats")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _value(found: Monitored) -> Markup:
    value = found.value
    if not isinstance(value, Realised):
        return tag("p", _sentence(value))
    sequence = value.sequence
    lines = [Series("realised", 0, sequence.counts.astype(float), sequence.means, sequence.low, sequence.high)]
    least = None if value.estimated is None else value.estimated.low
    references = [("lower end of the estimate", least)] if least is not None and np.isfinite(least) else []
    chart = charts.lines(
        lines, title="realised value", unit="mean return of episodes", size=(480, 300), references=references,
        across="finished episodes",
    )  # fmt: skip
    low, high = value.range
    told = (
        f"The band holds at all looks together with {level_in_words(1 - found.alpha)}; it rests on returns between "
        f"{number(low)} and {number(high)} ({value.source}). {_sentence(str(value.estimand))}"
    )
    lost = f" {value.beyond:,} returns lie outside this range, so that the band is open on that side." if value.beyond else ""
    drawn = figure(chart, "Mean return of the new log's episodes so far")
    return join(tag("div", drawn, class_="charts two"), note(told, lost))


def _columns(found: Monitored) -> Markup:
    rows = []
    for each in sorted(found.columns, key=lambda each: (each.found is None, -each.distance)):
        what, share = each.what, each.what.kind == "category"
        shown = percent if share else number
        level = f"share of {each.level}" if share else "mean"
        drift = "" if each.found is None else f"yes, since {each.found[0]:,} episodes"
        cells = [tag("td", text, class_="text") for text in (what.about, drift, level)]
        cells += [tag("td", shown(each.before)), tag("td", shown(each.now))]
        cells += [tag("td", "" if share else number(each.shift, signed=True)), tag("td", f"{each.distance:.3f}")]
        rows.append(tag("tr", tag("th", what.name, scope="row"), cells))
    heads = ["column", "role", "drift", "of", "reference", "new log", "shift (SD)", "distance"]
    told = (
        "The distance is the largest difference between the shares of rows at most some value (Kolmogorov-Smirnov), or of a "
        "category the total variation: 0 where both logs agree, 1 where they have nothing in common. Drift is tested by "
        "exchanging whole episodes, corrected for the number of columns and of looks."
    )
    return join(scroll(tag("table", heads_of(heads), tag("tbody", rows), class_="listed")), note(told))


def _outside(found: Monitored) -> Markup:
    share = tag("p", f"{found.outside.share:.1%} of the rows of the new log have a value outside the range of the reference.")
    if not found.outside.columns:
        return share
    rows = []
    for name, how, count, guilty in found.outside.columns:
        cells = [tag("td", how, class_="text"), tag("td", f"{count:,}"), tag("td", "yes" if guilty else "")]
        rows.append(tag("tr", tag("th", name, scope="row"), cells))
    heads = heads_of(["column", "side", "rows", "more than chance allows"])
    return join(share, scroll(tag("table", heads, tag("tbody", rows))))
