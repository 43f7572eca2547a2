"""How far off-policy Q-learning's own estimates are above what its policy gets, by the amount of an expert's data."""

from collections.abc import Sequence

import numpy as np

from deadreckon.bench.checked import number
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import Suite
from deadreckon.stats.interval import PERCENT
from deadreckon.stats.means import student_interval

SUITES = ["expert-1k", "expert-1k-again", "expert-10k", "expert-10k-again", "expert-100k"]
METHOD = "SAC-off"


def overestimated(suites: Sequence[Suite], store: Store) -> str:
    """A table of how far estimates are above discounted returns, a row a suite, in Markdown.

    Estimates are the critics' values at the starts of the last evaluation's episodes, whose discounted return is what the
    policy got. They are of different powers of ten, so their median stands there, and the lowest and the highest.

    Args:
        suites: of which those of `SUITES` count, at their own size.
        store: the results.
    """
    rows = {row["cell"]: row for row in store.results().to_pylist()}
    by_name = {suite.name: suite for suite in suites}
    lines = [f"| {METHOD} in | rows of the log | seeds | discounted return | overestimate |", "|---|" + "---:|" * 4]
    for suite in (by_name[name] for name in SUITES if name in by_name):
        cells = [cell for job in plan(suite) if job.method == METHOD for cell in job.cells]
        found = [rows[cell] for cell in cells if cell in rows]
        head = f"| `{suite.name}.toml` | {suite.rows:,} | {len(found)} of {len(cells)} |"
        if not found:
            lines.append(f"{head} - | - |")
            continue
        got, above = (np.array([number(row, name) for row in found]) for name in ("discounted_return", "overestimate"))
        told = f"{np.median(above):,.0f} ({above.min():,.0f} to {above.max():,.0f})"
        lines.append(f"{head} {student_interval(got):.0f} | {told} |")
    note = f"Discounted return: mean over seeds with Student's {PERCENT} interval; overestimate: median (lowest to highest)."
    return "\n".join([*lines, "", note, ""])
