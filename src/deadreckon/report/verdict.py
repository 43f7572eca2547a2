"""What the numbers say: which agent, whether to deploy it, and why, in sentences that numbers on the page back."""

import math
from dataclasses import dataclass, field

from deadreckon.report.entries import Page
from deadreckon.report.rows import Difference, Row, log_row, rows, versus
from deadreckon.report.text import brackets, number, percent, score, words
from deadreckon.tasks.mazes import Maze


@dataclass(frozen=True)
class Verdict:
    """The decision card.

    Attributes:
        headline: one sentence.
        deploy: None if nothing was judged, or if nothing learned from a log.
        reason: what the decision rests on.
        best: the row with the highest mean at the last evaluation.
        log: the policy that made its log.
        cloning: the best behaviour cloning row.
        versus_log: best minus log.
        versus_cloning: best minus cloning.
        beaten: what the agents did to cloning, in words, and why.
        caveats: what this does not show.
    """

    headline: str
    deploy: bool | None
    reason: str
    best: Row | None = None
    log: Row | None = None
    cloning: Row | None = None
    versus_log: Difference | None = None
    versus_cloning: Difference | None = None
    beaten: list[str] = field(default_factory=list)
    caveats: list[str] = field(default_factory=list)


def verdict(page: Page) -> Verdict:
    """Judges the runs of a page. What learned in the simulator is no candidate beside what learned from a log."""
    judged = [r for r in rows(page) if r.entry is not None and r.worth is not None and math.isfinite(r.worth.mean)]
    beside = [r for r in judged if r.online]
    judged = [r for r in judged if not r.online] or beside
    if not judged and page.online:
        return Verdict("No decision: these policies were not judged.", None, "No evaluation is finished yet.")
    if not judged:
        missing = "No simulator was named for this log" if page.task_name is None else "No evaluation is finished yet"
        return Verdict(
            "No decision: these policies were not judged.",
            None,
            f"{missing}. The page shows how training went and how far each policy moved away from the log"
            + (", and what the log alone says of them." if page.estimates else "; `deadreckon ope` judges from the log alone."),
            caveats=["A falling loss does not show that a policy is good."],
        )
    best = judged[0]
    assert best.entry is not None
    log = log_row(page, best.entry)
    cloning = next((r for r in judged if r.baseline), None)
    over_log = versus(best, log, page.task) if log else None
    over_cloning = versus(best, cloning, page.task) if cloning and cloning is not best else None
    deploy, reason = _decide(best, log, over_log)
    unit = "score" if best.score else "return"
    level = f"{unit} {score(best.worth.mean if best.worth else None)}"
    if deploy and over_log:
        gain = over_log.worth
        headline = (
            f"Deploy {best.label}: {level}, {score(gain.mean)} above the logged behaviour "
            f"(95 % lower bound {score(gain.low, signed=True)})."
        )
    else:
        standing = "is best with" if len(judged) > 1 else "has"
        headline = f"{'No decision' if deploy is None else 'Do not deploy'}: {best.label} {standing} {level}, but {reason}."
    return Verdict(
        headline, deploy, reason, best, log, cloning, over_log, over_cloning,
        [] if best.online else _beaten(page, judged, cloning, log), _caveats(page, judged, best, [] if best.online else beside),
    )  # fmt: skip


def _decide(best: Row, log: Row | None, over_log: Difference | None) -> tuple[bool | None, str]:
    assert best.entry is not None
    failed = best.entry.failed
    no = None if best.online else False
    if not best.entry.status.get("finished"):
        return no, f"the run of {best.label} is not finished"
    if failed:
        seed, metric, step = failed[0]
        return no, (
            f"{len(failed)} of {len(best.entry.seeds)} lanes of {best.label} failed (seed {seed}: {metric} was not finite at "
            f"update {step:,}), so training it again may fail too"
        )
    if best.online:
        return None, "it learned by acting in the simulator, so there is no logged behaviour that it has to beat"
    if over_log is None or log is None or log.worth is None:
        return False, "what the logged behaviour itself is worth is not known, so there is nothing to be better than"
    gap = over_log.worth
    if gap.low > 0:
        return True, (
            f"the lower end of its gain over the logged behaviour, {score(gap.low, signed=True)}, is above zero, and none of "
            "its lanes failed"
        )
    if gap.high < 0:
        return False, f"it is worse than the logged behaviour by {score(-gap.mean)} [{score(-gap.high)}, {score(-gap.low)}]"
    return False, f"its gain over the logged behaviour may be chance: the 95 % interval {brackets(gap)} holds zero"


def _beaten(page: Page, judged: list[Row], cloning: Row | None, log: Row | None) -> list[str]:
    if cloning is None:
        return ["No behaviour cloning run is on this page, so it cannot say what learning values adds to imitation."]
    gaps = [(r, versus(r, cloning, page.task)) for r in judged if not r.baseline]
    better = [(r, gap) for r, gap in gaps if gap and gap.worth.low > 0]
    others = [r.label for r, gap in gaps if not gap or gap.worth.low <= 0]
    if not gaps:
        return ["Only behaviour cloning is on this page: there is nothing to compare it with."]
    if not better:
        return [f"No agent clearly beats {cloning.label}: every 95 % interval of the difference reaches to zero or below."]
    listed = words([f"{r.label} by {score(gap.worth.mean)} {brackets(gap.worth)}" for r, gap in better])
    said = f"Clearly better than behaviour cloning ({cloning.label}): {listed}."
    if others:
        said += f" Not clearly better: {words(others)}."
    return [said, *_why(page, better[0][0], cloning, log), *_misled(judged)]


def _why(page: Page, best: Row, cloning: Row, log: Row | None) -> list[str]:
    assert best.entry is not None
    out = []
    directed = not isinstance(page.task, Maze) or "undirected data" not in page.task.properties
    undirected = not directed and bool(best.entry.config["data"].get("provenance", {}).get("recipe"))
    level = f" (the logged behaviour is worth {score(log.worth.mean)})" if log and log.worth else ""
    if undirected:
        out.append(
            f"The log goes to goals of its own, most of them not the task's, so much of it leads elsewhere{level}. Cloning "
            f"repeats the average of all goals and is worth {score(cloning.worth.mean if cloning.worth else None)}."
        )
    if best.mmd is not None and cloning.mmd is not None:
        far = "further from" if best.mmd > cloning.mmd else "no further from"
        said = f"{best.label}'s actions are {far} the logged ones than the clone's (MMD {number(best.mmd)} against "
        said += f"{number(cloning.mmd)})"
        if best.outside is not None:
            said += f", with {percent(best.outside)} of them outside the log's range"
        if best.mmd > cloning.mmd:
            said += ": it departs from the log where its values see more reward"
            said += (
                ", as joining pieces of logged paths into one to the goal needs (see its trajectories)" if undirected else ""
            )
        out.append(said + ".")
    if best.over is not None:
        calm = abs(best.over) <= max(0.5 * abs(best.truth or 0), 1.0)
        said = f"Its critic promised {number(best.value)} at the starts and {number(best.truth)} came (discounted)"
        out.append(said + (": close enough to guide it." if calm else ": take its values for an order, not for amounts."))
    return out


def _misled(judged: list[Row]) -> list[str]:
    exploded = [r for r in judged if r.over is not None and r.over > max(2 * abs(r.truth or 0), 10.0)]
    if not exploded:
        return []
    listed = words([f"{r.label} promised {number(r.value)} where {number(r.truth)} came" for r in exploded])
    return [f"{listed}: values of actions that the log never shows are guesses, and a policy that maximises them follows the "
            "largest mistake (thesis 4.1)."]  # fmt: skip


def _caveats(page: Page, judged: list[Row], best: Row, beside: list[Row]) -> list[str]:
    alone = "the next section shows one" if page.estimates else "`deadreckon ope` makes one"
    out = [f"This judgement ran the policies in the simulator. A real system has only an estimate from the log: {alone}."]
    if best.online:
        out = ["It was judged in the simulator that it learned in: nothing here shows how it fares where a system differs."]
    if beside:
        out.append(
            f"{words([r.label for r in beside])} learned by acting in the simulator: shown to compare with, not to choose from."
        )
    if len(judged) > 1:
        out.append(
            f"{best.label} was chosen as the best of {len(judged)} on the episodes that also measure it, which flatters it a "
            "little; a fresh evaluation settles that."
        )
    seeds = len(best.per_seed)
    if seeds == 1:
        out.append("One seed: nothing here shows how much of the result is the luck of one training.")
    elif seeds < 5:
        out.append(f"With {seeds} seeds the interval knows little of the spread between trainings.")
    return out
