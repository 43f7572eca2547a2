"""The page of a recommendation: the decision with everything behind it, or, quickly, the decision alone."""

import functools
from pathlib import Path

from deadreckon.errors import UserError
from deadreckon.report import decision, page
from deadreckon.report.markup import Markup, tag
from deadreckon.report.parts import note
from deadreckon.runs import recommend as recommending
from deadreckon.runs.decision_record import ESTIMATES, read_results
from deadreckon.runs.durations import in_words

PAGE = "report.html"


def write(out: Path | str, quick: bool = False) -> Path:
    """Writes the page of a folder that `recommend` has filled.

    Args:
        out: the folder.
        quick: the card alone, in well below a second. Where no policy was judged there is nothing else to show.

    Raises:
        UserError: it holds no recommendation, or cannot be written.
    """
    out = Path(out)
    told = read_results(out / ESTIMATES)
    if "recommend" not in told:
        raise UserError(f"{out / ESTIMATES} is not from `recommend`")
    learned = [out / each["name"] for each in told["recommend"]["candidates"] if each["state"] == "learned"]
    if learned and told["results"] and not quick:
        return page.write(learned, out / PAGE, estimates=out)
    choice, tried = told["choice"], told["recommend"]
    words = "Deploy" if choice["deploy"] else "Do not deploy"
    facts = [("log", told["log"]), ("budget", in_words(tried["budget"])), ("took", in_words(tried["seconds"]))]
    if tried["rows"] is not None:
        facts.append(("rows", f"{tried['rows']:,}"))
    sections = [("decision", "Decision", decision.brief(told["choice"])), ("tried", "What was tried", _tried(told))]
    text = page.document(f"Offline policies for {told['log']}", f"{words}: {choice['reason']}.", facts, sections)
    return page.save_page(text, out / PAGE)


def _tried(told: dict) -> Markup | None:
    """How far each candidate came."""
    candidates = told["recommend"]["candidates"]
    if not candidates:
        return note("Nothing was tried.")
    heads = [tag("th", head, scope="col") for head in ("candidate", "updates", "planned", "state at the end", "why")]
    rows = [
        tag("tr", tag("th", each["name"], scope="row"), tag("td", f"{each['updates']:,}"), tag("td", f"{each['planned']:,}"),
            tag("td", recommending.STATES.get(each["state"], each["state"])), tag("td", each["why"]))
        for each in candidates
    ]  # fmt: skip
    return tag("table", tag("thead", tag("tr", heads)), tag("tbody", rows))


recommend = functools.update_wrapper(functools.partial(recommending.recommend, page=write), recommending.recommend)
