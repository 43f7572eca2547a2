"""What a policy does, as a tree, and which columns it acts on; where `deadreckon explain` has been asked."""

from pathlib import Path

from deadreckon.files import content_digest, read_json
from deadreckon.report import forest
from deadreckon.report.entries import Page
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import breakable, figure, note
from deadreckon.runs.explain import NAME, Explained
from deadreckon.runs.explained_tree import Node
from deadreckon.runs.records import CROSS_FIT
from deadreckon.stats.interval import PERCENT, Interval

SHOWN = 12  # columns


def section(page: Page) -> Markup | None:
    """One part for each run of which it is known."""
    folders = [folder.path for entry in page.entries for folder, _ in entry.folders]
    crossed = [folder.parent for folder in folders if (folder.parent / CROSS_FIT).exists()]
    files = [folder / NAME for folder in dict.fromkeys([*crossed, *folders])]
    parts = [_of(file) for file in files if file.exists()]
    return join(*parts) if parts else None


def _of(file: Path) -> Markup:
    """The part of one file, if the policy that it explains is still there."""
    found = Explained.from_json(read_json(file, Explained))
    there = [policy for pattern in ("policies/*.npz", "*.npz", "refit/policies/*.npz") for policy in file.parent.glob(pattern)]
    if found.digest is None or found.digest in map(content_digest, there):
        return part(found)
    again = f"The policy has changed since it was explained; `deadreckon explain {file.parent}` explains it as it is now."
    return join(tag("h3", found.name), note(again))


def part(found: Explained) -> Markup:
    """The tree, how well it imitates the policy, and the columns that matter."""
    told = f"{found.headline[:1].upper()}{found.headline[1:]}."
    tree = None
    if found.tree is not None:
        share = "Shares are of the rows to which the tree was fitted; its fidelity was measured on others."
        tree = join(drawing(found.tree, f"what {found.name} does"), note(share))
    marks = [forest.Mark(each.column, 0, Interval(each.change, each.low, each.high)) for each in found.columns[:SHOWN]]
    if found.discrete:
        unit = f"share of fresh rows that get another action, {PERCENT}"
    else:
        unit = f"root mean square change of the actions in their standard deviations, {PERCENT}"
    more = len(found.columns) - len(marks)
    rest = f" {more:,} more columns are not drawn." if more > 0 else ""
    how = "Each column's values were permuted between fresh rows; columns with the same information can hide each other."
    columns = None
    if marks:
        drawn = figure(forest.forest(marks, unit), f"Columns that the policy acts on: {unit}")
        columns = tag("div", drawn, class_="charts two")
    return join(tag("h3", found.name), tag("p", told), tree, columns, note(how, rest))


def drawing(root: Node, title: str) -> Markup:
    """A tree as nested lists: a question, what follows if it is answered yes or no, and at the ends what is done.

    Lists and no picture, because their texts wrap: on a narrow page a drawing of several levels cannot be read.
    """
    return tag("div", _branch(root), class_="tree s0", role="group", aria_label=title)


def _branch(node: Node) -> Markup:
    if node.yes is None or node.no is None:
        share = f"{node.share:.0%} of rows"
        bar = tag("span", class_="share", style=f"width: {60 * node.share:.1f}px", aria_hidden="true")
        return join(tag("b", breakable(node.text)), " ", tag("small", bar, share))
    ends = [
        tag("li", tag("span", answer, class_="answer"), " ", _branch(end))
        for answer, end in (("yes", node.yes), ("no", node.no))
    ]  # fmt: skip
    return join(breakable(f"{node.text}?"), tag("ul", ends))
