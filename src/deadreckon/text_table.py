"""Tables as plain text."""

from collections.abc import Sequence


def table(rows: Sequence[Sequence[str]], right: Sequence[int] = (), *, sparse: bool = False, rule: bool = True) -> str:
    """Columns of text, as wide as their longest cells.

    Args:
        rows: cells; the first row is the heading.
        right: columns that are right-aligned.
        sparse: whether columns that are empty (or "-") below the heading are left out.
        rule: whether a line is drawn below the heading.
    """
    filled = [i for i in range(len(rows[0])) if not sparse or any(row[i] not in ("", "-") for row in rows[1:])]
    widths = {i: max(len(row[i]) for row in rows) for i in filled}
    lines = []
    for row in rows:
        cells = (row[i].rjust(width) if i in right else row[i].ljust(width) for i, width in widths.items())
        lines.append("  ".join(cells).rstrip())
    if rule:
        lines.insert(1, "  ".join("-" * width for width in widths.values()))
    return "\n".join(lines)
