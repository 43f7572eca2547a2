"""What a policy does, drawn as a tree, and which columns it acts on; where `deadreckon explain` has been asked."""

from deadreckon.files import read_json
from deadreckon.report import forest
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import figure, note, scroll
from deadreckon.runs.explain import NAME, Explained
from deadreckon.runs.explained_tree import Node
from deadreckon.stats.interval import PERCENT, Interval

SHOWN = 12  # columns
COLUMN, ROW, TOP = 220, 36, 12  # width of a question, height of an action, and room above, in pixels
LETTERS, ENDING = 22, 9  # of a text, and of those at its end, where its number is; its tooltip has it all


def section(page: Page) -> Markup | None:
    """One part for each run of which it is known."""
    files = [folder.path / NAME for entry in page.entries for folder, _ in entry.folders]
    parts = [_part(Explained.from_json(read_json(file, Explained))) for file in files if file.exists()]
    return join(*parts) if parts else None


def _part(found: Explained) -> Markup:
    told = f"{found.headline[:1].upper()}{found.headline[1:]}."
    tree = None
    if found.tree is not None:
        share = "Shares are of the rows to which the tree was fitted; how well it does was measured on others."
        tree = join(scroll(drawing(found.tree, f"what {found.name} does")), note(share))
    marks = [forest.Mark(each.column, 0, Interval(each.change, each.low, each.high)) for each in found.columns[:SHOWN]]
    if found.discrete:
        unit = f"share of fresh rows that get another action, {PERCENT}"
    else:
        unit = f"root mean square change of the actions in their standard deviations, {PERCENT}"
    more = len(found.columns) - len(marks)
    rest = f" {more:,} more columns are not drawn." if more > 0 else ""
    how = "Each column's values were exchanged between fresh rows; columns that say the same can hide each other in this."
    columns = None
    if marks:
        drawn = figure(forest.forest(marks, unit), f"Columns that the policy acts on: {unit}")
        columns = tag("div", drawn, class_="charts two")
    return join(tag("h3", found.name), tag("p", told), tree, columns, note(how, rest))


def drawing(root: Node, title: str) -> Markup:
    """A tree from left to right: questions, and at the ends what is done."""
    parts: list[Markup] = [tag("title", title)]
    leaves, deepest = 0, 0

    def draw(node: Node, depth: int) -> float:
        """Draws a node and what follows it; gives its height."""
        nonlocal leaves, deepest
        deepest = max(deepest, depth)
        x = 8 + depth * COLUMN
        if node.yes is None or node.no is None:
            y = TOP + ROW * (leaves + 0.5)
            leaves += 1
            parts.append(_text(node.text, x, y, "label"))
            parts.append(tag("text", f"{node.share:.0%} of rows", x=x, y=f"{y + 17:.1f}", class_="tick"))
            return y
        ends = draw(node.yes, depth + 1), draw(node.no, depth + 1)
        y = sum(ends) / 2
        for answer, end in zip(("yes", "no"), ends):
            a, b = x + COLUMN - 46, x + COLUMN - 6
            parts.append(tag("path", d=f"M{a} {y:.1f}L{b} {end:.1f}", class_="reference"))
            parts.append(tag("text", answer, x=b - 2, y=f"{end + (-6 if end < y else 14):.1f}", class_="tick end"))
        parts.append(_text(f"{node.text}?", x, y, "name"))
        return y

    draw(root, 0)
    width, height = 8 + (deepest + 1) * COLUMN, TOP + ROW * leaves + 12
    return tag(
        "svg", tag("g", parts, class_="s0"), viewBox=f"0 0 {width} {height}", width=width, height=height, role="img",
        aria_label=title, class_="chart tree",
    )  # fmt: skip


def _text(text: str, x: float, y: float, kind: str) -> Markup:
    short = text if len(text) <= LETTERS else f"{text[: LETTERS - ENDING - 1]}\N{HORIZONTAL ELLIPSIS}{text[-ENDING:]}"
    return tag("text", tag("title", text), short, x=x, y=f"{y + 4:.1f}", class_=kind)
