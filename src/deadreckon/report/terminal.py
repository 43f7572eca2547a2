"""The score table for a terminal: the same rows as on the page."""

from collections.abc import Callable, Sequence
from pathlib import Path

from deadreckon import text_table
from deadreckon.report import decision
from deadreckon.report.entries import read
from deadreckon.report.rows import Row, rows
from deadreckon.report.simulated import compare
from deadreckon.report.text import NONE, brackets, count, number, percent, score
from deadreckon.runs.offline import read_estimates
from deadreckon.runs.run import Run
from deadreckon.stats.interval import PERCENT, Interval


def _with_interval(value: Interval | None) -> str:
    return f"{score(value)} {brackets(value)}" if value else number(None)


COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("seeds", lambda r: count(len(r.entry.seeds) if r.entry else None)),
    (f"score [{PERCENT}]", lambda r: _with_interval(r.score)),
    (f"return [{PERCENT}]", lambda r: _with_interval(r.returns)),
    ("estimated", lambda r: number(r.value)),
    ("realised", lambda r: number(r.truth)),
    ("MMD", lambda r: number(r.mmd)),
    ("outside", lambda r: percent(r.outside)),
    ("steps", lambda r: count(r.acted)),
    ("updates", lambda r: count(r.updates)),
    ("failed", lambda r: count(len(r.entry.failed) if r.entry else None)),
)


def table(runs: Sequence[Path | str | Run]) -> str:
    """One line per policy: the behaviour policy, then the runs, best first.

    Estimated is the critic's value at the start of the judged episodes, realised the discounted return that followed. Columns
    that nothing is known for are left out.

    Raises:
        UserError: nothing to show, a path that is not a run, or runs of different tasks.
    """
    page = read(runs)
    found = rows(page)
    columns = [column for column in COLUMNS if any(column[1](r) != NONE for r in found)]
    lines = [("agent", *(name for name, _ in columns))]
    lines += [(r.label, *(cell(r) for _, cell in columns)) for r in found]
    plain = str.maketrans({"\N{MINUS SIGN}": "-", "\N{EM DASH}": "-", "\N{NO-BREAK SPACE}": " "})
    return text_table.table(lines, right=range(1, len(lines[0]))).translate(plain)


def headline(runs: Sequence[Path | str | Run], estimates: Path | str | None = None) -> str:
    """What the page says first: the decision where there are estimates from the log, else what the simulator says.

    Args:
        runs: run folders.
        estimates: folder that `runs.offline.judge` wrote to.

    Raises:
        UserError: nothing to show, a path that is not a run, runs of different tasks, or estimates of other runs.
    """
    page = read(runs)
    if estimates is not None:
        told, changed = decision.as_it_is(page, read_estimates(estimates), estimates)
        return str(changed) if told is None else decision.headline(told)
    found = compare(page, rows(page))
    return (decision.unjudged(page) if found is None else found.headline).replace("\N{MINUS SIGN}", "-")
