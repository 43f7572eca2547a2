"""The card: what `ope.select` decided from the log alone. There is no other verdict on a page."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deadreckon.errors import UserError
from deadreckon.ope.estimates import LOGGED
from deadreckon.report import forest
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, tag
from deadreckon.report.parts import coloured, figure, note, tile
from deadreckon.report.text import number, percent
from deadreckon.runs.decision_record import has_changed, is_from
from deadreckon.runs.offline import checked, grounds
from deadreckon.stats.interval import Interval, fixed, level_in_words


def headline(told: dict[str, Any]) -> str:
    """The decision in one sentence."""
    choice = told["choice"]
    return f"Deploy {choice['name']}: {choice['reason']}." if choice["deploy"] else f"Do not deploy: {choice['reason']}."


def unjudged(page: Page) -> str:
    """Why there is neither a decision nor a comparison, in one sentence."""
    if page.task_name is not None:
        return "No evaluation is finished yet."
    return (
        "Not evaluated yet: no simulator was named for this log. The page shows how training went and how far each policy "
        "moved away from the log; `deadreckon ope --select` decides from the log alone."
    )


def places(page: Page) -> list[Path]:
    """Folders of the runs on a page, and of the cross-fits that these may be in."""
    return [place for e in page.entries for folder, _ in e.folders for place in (folder.path, folder.path.parent)]


def as_it_is(page: Page, told: dict[str, Any], estimates: Path | str) -> tuple[dict[str, Any] | None, str | None]:
    """What of estimates still holds for the policies on a page, and where that is nothing, why, in one sentence.

    A decision on a policy that was trained further is no decision on what is there now. Another policy that has changed is
    warned of: the decision stands, but its estimates are not of what the page shows.

    Args:
        page: with the runs.
        told: the estimates, as `runs.offline.read_estimates` gives them.
        estimates: the folder or file that they are from.

    Raises:
        UserError: they decide on a policy of other runs.
    """
    path = Path(estimates)
    of = {each["name"]: each for each in told["policies"]}[told["choice"]["name"]]
    if not any(is_from(of, place) for place in places(page)):
        file = f" ({of['file']})" if of.get("file") else ""
        raise UserError(f"{estimates} decides on {of['run']}{file}, which is not among these runs; name its folder too")
    record = path if path.is_dir() else path.parent
    changed = [
        each["name"] for each in told["policies"]
        if any(is_from(each, folder) and has_changed(each, record, folder) for folder in places(page))
    ]  # fmt: skip
    choice = told["choice"]
    if choice["name"] in changed:
        why = f"The policy {choice['name']} has changed since its evaluation"
        return None, f"{why}, so the decision on it is not shown; `deadreckon ope --select` evaluates it as it is now."
    lines = [f"{name} has changed since its evaluation: its estimates are of the earlier policy" for name in changed]
    return told | {"choice": choice | {"warnings": [*choice["warnings"], *lines]}}, None


def card(page: Page) -> Markup | None:
    """What was decided, on what evidence, what speaks against it, and how it turned out where that could be checked."""
    told = page.estimates
    if told is None:
        return None
    choice, kind = told["choice"], "yes" if told["choice"]["deploy"] else "no"
    names = [each["name"] for each in told["policies"]]
    chosen = names.index(choice["name"])
    candidate = choice["name"] if choice["deploy"] else f"best candidate: {choice['name']}"
    head = tag(
        "p",
        tag("strong", "DEPLOY" if choice["deploy"] else "DO NOT DEPLOY", class_=f"stamp {kind}"),
        tag("span", candidate, class_="which" if choice["deploy"] else "which lesser"),
    )
    facts = [*grounds(told), ("support", _support(told, chosen)), *_costs(told, chosen)]
    if choice["deploy"] and (file := told["policies"][chosen].get("file")):
        how = "" if told["estimand"].get("greedy") else ", with sampled actions, as it was evaluated"
        facts.append(("its file", f"{file}{how}"))
    listed = tag("dl", [(tag("dt", name), tag("dd", text)) for name, text in facts], class_="grounds")
    because = tag("p", f"{choice['reason']}.", class_="because")
    left = tag("div", head, because, tag("div", _tiles(told, chosen), class_="tiles"), listed)
    after = tag(
        "div", tag("h3", "Checked afterwards in the simulator" if told["truth"] else "Not checked"),
        tag("p", _check(told, chosen)), class_="check",
    )  # fmt: skip
    return tag(
        "div", tag("div", left, _gains(page, told), class_="split top"),
        tag("div", _against(told, chosen), after, class_="split lower"),
        class_=f"card {kind}",
    )  # fmt: skip


def brief(choice: Mapping[str, Any], gain: Markup | None = None) -> Markup:
    """The card where nothing but the choice itself is known: with its reason, its gain, and what was found."""
    words, kind = ("Deploy", "yes") if choice["deploy"] else ("Do not deploy", "no")
    which = tag("span", choice["name"], class_="which" if choice["deploy"] else "which lesser") if choice["name"] else None
    more = [tag("li", line) for line in (*choice["evidence"], *choice["warnings"])]
    return tag(
        "div",
        tag("p", tag("strong", words, class_=f"stamp {kind}"), which),
        tag("p", f"{choice['reason']}.", class_="because"),
        tag("div", gain, class_="tiles") if gain else None,
        tag("ul", more, class_="caveats") if more else None,
        class_=f"card {kind}",
    )


def _tiles(told: dict[str, Any], chosen: int) -> list[Markup]:
    choice, judged = told["choice"], told["judged"]
    level = f"{level_in_words(choice['level'])} for all policies at once"
    missing = told["support"]["missing"][chosen]
    held = tag(
        "div", tag("small", "held-out episodes" if judged["fresh"] else "episodes, not held out"),
        tag("b", f"{judged['episodes']:,}"), tag("span", f"of {judged['of']:,}"), class_="tile",
    )  # fmt: skip
    covered = tag(
        "div", tag("small", "its actions without support"), tag("b", percent(missing)), tag("span", "in the log"), class_="tile"
    )
    gain = Interval(*choice["gain"])
    return [tile("estimated gain over the behaviour policy", gain, True, level, number), held, covered]


def _support(told: dict[str, Any], chosen: int) -> str:
    missing, ratio = told["support"]["missing"][chosen], told["support"]["ratio"][chosen]
    said = "not known" if missing is None else f"{percent(missing)} of its actions have no support in the log"
    return said if ratio is None else f"{said}; its weights average {fixed(ratio, 2)} per step (1 with full support)"


def _costs(told: dict[str, Any], chosen: int) -> list[tuple[str, str]]:
    """The totals of the log's costs."""
    lines = []
    for each in told["choice"].get("costs", ()):
        (value, low, high), logged = each["ends"][chosen], each["ends"][-1]
        limit = "" if each["limit"] is None else f", limit {number(each['limit'])}"
        between = f"{number(value)} [{number(low)}, {number(high)}]{limit}"
        lines.append((each["column"], f"{between}; behaviour policy {number(logged[0])}"))
    return lines


def _against(told: dict[str, Any], chosen: int) -> Markup:
    """What other estimators say, warnings, and the objections to the other policies, folded away where they are many."""
    choice, names = told["choice"], [each["name"] for each in told["policies"]]
    others = [(name, own) for i, (name, own) in enumerate(zip(names, choice["objections"])) if i != chosen and own]
    said = {f"{name}: {'; '.join(own)}" for name, own in others}
    lines = [*choice["evidence"], *(line for line in choice["warnings"] if line not in said)]
    lines = [*choice["objections"][chosen], *lines]
    items = tag("p", "None were found.")
    if lines:
        items = tag("ul", [tag("li", line) for line in lines], class_="caveats")
    more = None
    if others:
        rest = tag("ul", [tag("li", tag("b", name), f": {'; '.join(own)}") for name, own in others], class_="caveats")
        more = tag("details", tag("summary", f"Objections to other policies ({len(others)} of {len(names) - 1})"), rest)
    unseen = note("A log cannot show whether an unrecorded variable influenced the logged actions (confounding).")
    return tag("div", tag("h3", "Objections, warnings and other estimates"), items, more, unseen)


def _check(told: dict[str, Any], chosen: int) -> str:
    said = checked(told)
    said = f"{said[:1].upper()}{said[1:]}."
    if told["truth"] is None:
        return said
    first = told["results"][0]
    value, low, high = (number(first[end][chosen]) for end in ("value", "low", "high"))
    return f"{said} From the log it was estimated at {value} [{low}, {high}]."


def _gains(page: Page, told: dict[str, Any]) -> Markup | None:
    """Every policy's gain with its simultaneous interval."""
    first = told["results"][0]
    marks = []
    each_of = zip(told["policies"], coloured(page, told), first["gain"], told["choice"]["objections"])
    for each, (_, slot), gain, own in each_of:
        spread = Interval(*gain)
        if math.isfinite(spread.value):
            marks.append(forest.Mark(each["name"], slot, spread, hollow=bool(own)))
    if not marks:
        return None
    marks.sort(key=lambda mark: (mark.name != told["choice"]["name"], mark.hollow, -mark.spread.value))
    level = level_in_words(told["choice"]["level"])
    hollow = "; hollow: with objections" if any(mark.hollow for mark in marks) else ""
    drawn = forest.forest(marks, f"estimated gain over the behaviour policy, {level} for all at once", [(LOGGED, 0.0)])
    return figure(drawn, f"Estimated gain over the behaviour policy ({first['method']}, {level} for all at once{hollow})")
