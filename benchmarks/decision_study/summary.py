"""Tables of what rules did, in Markdown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Z = 1.96
TWINS = ("missing", "missing-unknown", "supported", "supported-unknown")
LATEST = ("reversing",)  # families whose truth is that of the latest third, and intervals those of the mean over the log
LEARNED = ("bc", "iql", "cql", "awac", "td3_bc")
WHAT = {
    "new": "the package", "old-train": "531dcab's rule, training rows", "old-held": "531dcab's rule, held-out rows",
    "old-level": "… at the package's level", "old-fqe": "… by FQE alone", "oracle": "oracle", "argmax-fqe": "argmax of FQE",
    "argmax-wis": "argmax of WIS", "stationary": "the package, stationary",
}  # fmt: skip
UPPER, LOWER = "… upper bound (95 %)", "… lower bound (95 %)"
BAD, SHARE, WIDTH = "… a policy that is not better", "share of the oracle's gain", "width relative to the oracle's"
INTERVALS = ("all intervals cover", LOWER, "… where any is finite", "infinite intervals", WIDTH)
RULE = (
    "rule", "deploys", BAD, UPPER, "not better, among deployed", UPPER, "mean gain",
    SHARE, *INTERVALS,
)  # fmt: skip
OVERVIEW = (
    "family", "logs", "cross-fitted", "deploys", BAD, UPPER, "not better, among deployed",
    "mean gain", "531dcab's rule, held-out rows", "difference ± error", SHARE, *INTERVALS,
)  # fmt: skip


@dataclass(frozen=True)
class Facts:
    """What a rule did on some logs.

    Attributes:
        logs: how many.
        deploys, bad, holds: on how many it deploys, deploys what is not better, and has intervals that all hold.
        crossed: on how many it judges cross-fitted policies, by all episodes.
        some, some_hold: on how many one of its intervals has ends, and of these they all hold.
        gains: (logs,) true gain of what it deploys; 0: nothing.
        oracle: sum of the oracle's.
        endless: share of the intervals without an end.
        width: median width of the others, over the oracle's.
    """

    logs: int
    deploys: int
    bad: int
    holds: int
    crossed: int
    some: int
    some_hold: int
    gains: np.ndarray
    oracle: float
    endless: float
    width: float

    @classmethod
    def of(cls, trials: Sequence[dict[str, Any]], rule: str) -> "Facts | None":
        """None where the rule has said nothing."""
        trials = [trial for trial in trials if rule in trial["rules"]]
        if not trials:
            return None
        said = [trial["rules"][rule] for trial in trials]
        true = [np.array(one.get("true", trial["gains"])) for one, trial in zip(said, trials)]
        got = np.array([0.0 if one["choice"] is None else float(own[one["choice"]]) for one, own in zip(said, true)])
        chosen = np.array([one["choice"] is not None for one in said])
        best = [trial["rules"].get("oracle", {"choice": None})["choice"] for trial in trials]
        ends = [_ends(one) for one in said]
        holds = [bool(((low <= own + 1e-9) & (own - 1e-9 <= high)).all()) for (low, high), own in zip(ends, true)]
        some = [bool((np.isfinite(low) & np.isfinite(high)).any()) for low, high in ends]
        ratios = []
        for one, (low, high), trial in zip(said, ends, trials):
            if "oracle" in trial["rules"] and "true" not in one:  # of the same policies and episodes
                a, b = _ends(trial["rules"]["oracle"])
                with np.errstate(all="ignore"):
                    ratio = (high - low) / (b - a)
                ratios.append(ratio[np.isfinite(ratio)])
        widths = np.concatenate(ratios) if ratios else np.zeros(0)
        return cls(
            len(trials), int(chosen.sum()), int((chosen & (got <= 0.0)).sum()), sum(holds),
            sum("true" in one for one in said), sum(some), sum(a and b for a, b in zip(some, holds)), got,
            sum(0.0 if one is None else trial["gains"][one] for one, trial in zip(best, trials)),
            float(np.concatenate([np.isinf(low) | np.isinf(high) for low, high in ends]).mean()),
            float(np.median(widths)) if len(widths) else math.nan,
        )  # fmt: skip

    def cells(self, intervals: bool) -> dict[str, str]:
        """In words, by column."""
        found = {
            "logs": str(self.logs), "cross-fitted": _share(self.crossed, self.logs), "deploys": _share(self.deploys, self.logs),
            BAD: _share(self.bad, self.logs), UPPER: _most(self.bad, self.logs),
            "not better, among deployed": _share(self.bad, self.deploys), "mean gain": f"{self.gains.mean():+.3g}",
            SHARE: f"{100 * self.gains.sum() / self.oracle:.0f} %" if self.oracle > 0 else "–",
        }  # fmt: skip
        if intervals:
            found |= {
                "all intervals cover": _share(self.holds, self.logs),
                LOWER: f"{100 * wilson(self.holds, self.logs)[0]:.1f} %",
                "… where any is finite": _share(self.some_hold, self.some), "infinite intervals": f"{100 * self.endless:.0f} %",
                WIDTH: "–" if math.isnan(self.width) else f"{self.width:.2f}",
            }  # fmt: skip
        return found


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if count == 0:
        return 0.0, 1.0
    share, square = hits / count, Z * Z / count
    middle, half = share + square / 2, Z * math.sqrt(share * (1 - share) / count + square / (4 * count))
    return (middle - half) / (1 + square), (middle + half) / (1 + square)


def tables(trials: Sequence[dict[str, Any]], rules: Sequence[str], better: dict[str, str]) -> str:
    """The new rule in all families; then a table a family, with all rules; gains of different families are not averaged."""
    names = list(dict.fromkeys(trial["family"] for trial in trials))
    by_name = {name: [trial for trial in trials if trial["family"] == name] for name in names}
    rows = [_overview(name, own) for name, own in by_name.items()]
    rows.append(_overview("all families", trials))
    for gain in ("mean gain", "531dcab's rule, held-out rows", "difference ± error", SHARE, WIDTH):
        rows[-1][OVERVIEW.index(gain)] = "–"
    parts = [_markdown(OVERVIEW, rows)]
    for name, own in by_name.items():
        some = sum(max(trial["gains"]) > 0 for trial in own)
        head = f"### {name}\n\n{len(own)} logs, {some} of them with a candidate that is better."
        if name in better:
            head += f" Better candidates: {better[name]}"
            head += "." if better[name].startswith("none") else "; in a quarter of the logs they are removed."
        rows = []
        for rule in rules:
            if facts := Facts.of(own, rule):
                covers = not rule.startswith("argmax") and (name not in LATEST or rule == "oracle")
                cells = facts.cells(covers) | {"rule": WHAT[rule]}
                row = [cells.get(column, "–") for column in RULE]
                second = len(RULE) - 1 - RULE[::-1].index(UPPER)  # of what it deploys
                row[second] = _most(facts.bad, facts.deploys)
                rows.append(row)
        parts.append(head + "\n\n" + _markdown(RULE, rows) + (_told(own) if name in TWINS else ""))
    said = [(rule, trial["rules"][rule]) for trial in trials for rule in rules if rule in trial["rules"]]
    codes = {rule: sorted({one.get("code", "none") for other, one in said if other == rule}) for rule in rules}
    told = "; ".join(f"{WHAT[rule]} {', '.join(found)}" for rule, found in codes.items() if found)
    parts.append(f"Digests of the code that decided: {told}.")
    return "\n\n".join(parts)


def _overview(name: str, trials: Sequence[dict[str, Any]]) -> list[str]:
    facts, old = Facts.of(trials, "new"), Facts.of(trials, "old-held")
    covers = not any(trial["family"] in LATEST for trial in trials)
    cells = {"family": name} | ({} if facts is None else facts.cells(covers))
    if facts is not None and old is not None and facts.logs == old.logs:
        less = facts.gains - old.gains
        cells["531dcab's rule, held-out rows"] = f"{old.gains.mean():+.3g}"
        if len(less) > 1:
            cells["difference ± error"] = f"{less.mean():+.2g} ± {less.std(ddof=1) / math.sqrt(len(less)):.1g}"
    return [cells.get(column, "–") for column in OVERVIEW]


def _markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in (columns, ["---"] * len(columns), *rows))


def _ends(one: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    low = np.array([-np.inf if x is None else x for x in one["low"]])
    return low, np.array([np.inf if x is None else x for x in one["high"]])


def _share(hits: int, count: int) -> str:
    return f"{100 * hits / count:.1f} %" if count else "–"


def _most(hits: int, count: int) -> str:
    return f"{100 * wilson(hits, count)[1]:.1f} %" if count else "–"


def _told(trials: Sequence[dict[str, Any]]) -> str:
    """What the new rule says of support, in a sentence: of the candidates that were made by hand, which take actions that the
    log has or lacks."""
    hits = count = deploys = 0
    for trial in trials:
        one = trial["rules"].get("new", {})
        hand = [i for i, name in enumerate(trial["policies"]) if name not in LEARNED]
        if len(one.get("told", [])) != len(trial["policies"]) or not hand:
            continue
        count += 1
        told = [one["told"][i] for i in hand]
        hits += any(told) if trial["supported"] else all(told)
        deploys += one["choice"] in hand
    if not count:
        return ""
    if trials[0]["supported"]:
        return (
            f"\n\nFor hand-made candidates the package reports missing support, wrongly, in {hits} of {count} logs "
            f"({_share(hits, count)})."
        )
    return (
        f"\n\nThe package reports missing support for all hand-made candidates in {hits} of {count} logs "
        f"({_share(hits, count)}) and deploys one of them in {deploys}."
    )
