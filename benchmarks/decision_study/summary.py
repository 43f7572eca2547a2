"""Tables of what rules did, in Markdown."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

Z = 1.96
COLUMNS = (
    "rule", "logs", "deploys", "deploys what is not better", "… at most", "not better, of what it deploys", "… at most",
    "mean gain", "of the oracle's gain", "all intervals hold", "… at least", "infinite", "width / oracle's",
)  # fmt: skip


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if count == 0:
        return 0.0, 1.0
    share, square = hits / count, Z * Z / count
    middle, half = share + square / 2, Z * math.sqrt(share * (1 - share) / count + square / (4 * count))
    return (middle - half) / (1 + square), (middle + half) / (1 + square)


def described(trials: Sequence[dict[str, Any]], rule: str) -> list[str] | None:
    """A row of the table; None where the rule has said nothing."""
    trials = [trial for trial in trials if rule in trial["rules"]]
    if not trials:
        return None
    said = [trial["rules"][rule] for trial in trials]
    got = [0.0 if one["choice"] is None else trial["gains"][one["choice"]] for one, trial in zip(said, trials)]
    deploys = sum(one["choice"] is not None for one in said)
    bad = sum(one["choice"] is not None and gain <= 0.0 for one, gain in zip(said, got))
    best = [trial["rules"].get("oracle", {"choice": None})["choice"] for trial in trials]
    most = sum(0.0 if one is None else trial["gains"][one] for one, trial in zip(best, trials))
    cells = [rule, str(len(trials)), _share(deploys, len(trials)), _share(bad, len(trials)),
             f"{100 * wilson(bad, len(trials))[1]:.1f} %", _share(bad, deploys),
             f"{100 * wilson(bad, deploys)[1]:.1f} %" if deploys else "–", f"{np.mean(got):+.3g}",
             f"{100 * sum(got) / most:.0f} %" if most > 0 else "–"]  # fmt: skip
    if rule.startswith("argmax"):
        return [*cells, "–", "–", "–", "–"]
    ends = [_ends(one) for one in said]
    holds = sum(
        bool(((low <= np.array(t["gains"]) + 1e-9) & (np.array(t["gains"]) - 1e-9 <= high)).all())
        for (low, high), t in zip(ends, trials)
    )
    endless = np.concatenate([np.isinf(low) | np.isinf(high) for low, high in ends])
    ratios = []
    for (low, high), trial in zip(ends, trials):
        if "oracle" in trial["rules"]:
            a, b = _ends(trial["rules"]["oracle"])
            with np.errstate(all="ignore"):
                ratio = (high - low) / (b - a)
            ratios.append(ratio[np.isfinite(ratio)])
    widths = np.concatenate(ratios) if ratios else np.zeros(0)
    return [*cells, _share(holds, len(trials)), f"{100 * wilson(holds, len(trials))[0]:.1f} %", f"{100 * endless.mean():.0f} %",
            f"{np.median(widths):.2f}" if len(widths) else "–"]  # fmt: skip


def _ends(one: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    low = np.array([-np.inf if x is None else x for x in one["low"]])
    return low, np.array([np.inf if x is None else x for x in one["high"]])


def _share(hits: int, count: int) -> str:
    return f"{100 * hits / count:.1f} %" if count else "–"


def tables(trials: Sequence[dict[str, Any]], rules: Sequence[str], better: dict[str, str]) -> str:
    """A table a family, and one of all of them; the mean gain is left to the families, whose rewards differ."""
    names = list(dict.fromkeys(trial["family"] for trial in trials))
    parts = []
    for name in [*names, "all families"]:
        own = [trial for trial in trials if name in ("all families", trial["family"])]
        some = sum(max(trial["gains"]) > 0 for trial in own)
        head = f"### {name}\n\n{len(own)} logs, {some} of them with a candidate that is better."
        if name in better:
            head += f" A better one is there {better[name]}; in a quarter of the logs it is taken away."
        rows = [row for rule in rules if (row := described(own, rule))]
        if name == "all families":
            rows = [[*row[:7], "–", "–", *row[9:]] for row in rows]
        lines = ["| " + " | ".join(row) + " |" for row in (COLUMNS, ["---"] * len(COLUMNS), *rows)]
        parts.append(head + "\n\n" + "\n".join(lines))
    return "\n\n".join(parts)
