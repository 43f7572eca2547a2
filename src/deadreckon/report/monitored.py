"""The page about a policy in use: what was found, the realised value over time, and every column against its log."""

from pathlib import Path

import numpy as np

from deadreckon.report import charts
from deadreckon.report.charts import Series
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.page import document, save_page
from deadreckon.report.parts import breakable, figure, heads_of, note, scroll
from deadreckon.report.text import number, percent
from deadreckon.runs.monitor import Monitored, others_of, since
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
    text = document(f"Monitoring {found.name}", lead(found), facts(found), sections(found), note(_sentence(found.compared)))
    return save_page(text, out)


def lead(found: Monitored) -> str:
    """What is an alarm, in one sentence."""
    names = dict.fromkeys(f"{each.about} {each.name}" for each in found.findings if each.alarm)
    if not names:
        lost = [each.what.name for each in found.columns if each.untested]
        drift = f" Not tested: {', '.join(lost)}." if lost else ""
        drift = f" Drift was {found.untested}." if found.untested else drift
        unknown = isinstance(found.value, str) or found.value.estimated is None
        why = found.value.removeprefix("not compared: ") if isinstance(found.value, str) else "no estimate is known"
        value = f" The value was not compared: {why}." if unknown else ""
        return f"No alarm.{drift}{value}"
    return f"{len(names)} finding{'' if len(names) == 1 else 's'}: {', '.join(names)}."


def facts(found: Monitored) -> list[tuple[str, str]]:
    """What was compared, as names and values."""
    return [
        ("policy", found.name), ("new log", found.log), ("rows", f"{found.rows:,}"),
        ("finished episodes", f"{found.episodes:,}"),
        ("reference", found.reference), ("false alarms", f"at most {percent(found.alpha)}, over all looks"),
    ]  # fmt: skip


def sections(found: Monitored) -> list[tuple[str, str, Markup]]:
    """The parts of the page: an anchor, a heading and what is below it."""
    return [
        ("findings", "Findings", _findings(found)),
        ("value", "Realised value", _value(found)),
        ("columns", "Observations and actions", _columns(found)),
        ("outside", "Outside the log", _outside(found)),
    ]


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
    late = sequence.counts >= sequence.counts[-1] / 20  # the band of the first few episodes would leave the rest no room
    x, y, lower, upper = (each[late] for each in (sequence.counts, sequence.means, sequence.low, sequence.high))
    lines = [Series("realised", 0, x.astype(float), y, lower, upper)]
    least = None if value.estimated is None else value.estimated.low
    references = [("", least)] if least is not None and np.isfinite(least) else []
    chart = charts.lines(
        lines, title="realised value", unit="mean return per episode so far", size=(480, 300), references=references,
        across="number of finished episodes",
    )  # fmt: skip
    low, high = value.range
    told = (
        f"The band is a {level_in_words(1 - found.alpha)} confidence sequence: it covers the mean at all numbers of episodes "
        f"at once, however often one looks. It rests on returns between {number(low)} and {number(high)} ({value.source}). "
        f"{_sentence(str(value.estimand))}"
    )
    if value.length > 1:
        told += f" It is of means of {value.length:,} successive episodes, as returns depend on those of the episodes before."
    lost = f" {value.beyond:,} returns lie outside this range, so that the band is open on that side." if value.beyond else ""
    drawn = figure(chart, "Mean return of the new log's episodes, after each of them")
    line = "lower end of the estimate" if references else None
    keys = charts.keys([("realised mean, with its confidence sequence", 0)], line)
    return join(keys, tag("div", drawn, class_="charts two"), note(told, lost))


def _columns(found: Monitored) -> Markup:
    rows = []
    for each in sorted(found.columns, key=lambda each: (each.found is None, -each.distance)):
        what, share = each.what, each.what.kind == "category"
        shown = percent if share else number
        level = f"share of {each.level}" if share else "mean"
        drift = since(each.found) if each.found else "not tested" if each.untested else ""
        cells = [tag("td", text, class_="text") for text in (drift, level)]
        cells += [tag("td", shown(each.before)), tag("td", shown(each.now))]
        cells += [tag("td", "" if share else number(each.shift, signed=True)), tag("td", f"{each.distance:.3f}")]
        gone = f"{percent(each.missing[0])} \N{RIGHTWARDS ARROW} {percent(each.missing[1])}" if any(each.missing) else ""
        cells += [tag("td", gone), tag("td", others_of(each), class_="text")]
        rows.append(tag("tr", tag("th", breakable(what.name), tag("small", what.about), scope="row"), cells))
    heads = ["column", "drift", "of", "reference", "new log", "shift (SD)", "distance", "missing", "new levels"]
    told = (
        "The shift is the change of the mean in standard deviations (SD) of the reference. The distance of numbers is the "
        "largest difference of the distribution functions, which are the shares of rows up to a value (Kolmogorov-Smirnov); of "
        "a category it is the share of rows that would need another level for equal shares (total variation distance). It is 0 "
        "where both logs agree and 1 where they have nothing in common; whether values are missing is compared too. Drift is "
        "tested by exchanging whole episodes between the logs, or parts of successive ones, corrected for the number of "
        "columns and of looks."
    )
    return join(scroll(tag("table", heads_of(heads), tag("tbody", rows), class_="listed")), note(told))


def _outside(found: Monitored) -> Markup:
    share = tag("p", f"{found.outside.share:.1%} of the rows of the new log have a value outside the range of the reference.")
    if not found.outside.columns:
        return share
    rows = []
    for name, how, count, guilty in found.outside.columns:
        cells = [tag("td", how, class_="text"), tag("td", f"{count:,}"), tag("td", "yes" if guilty else "")]
        rows.append(tag("tr", tag("th", breakable(name), scope="row"), cells))
    heads = heads_of(["column", "side", "rows", "more than chance allows"])
    return join(share, scroll(tag("table", heads, tag("tbody", rows))))
