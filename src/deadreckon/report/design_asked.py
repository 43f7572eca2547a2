"""What was asked of proposals: targets, what variables may be, rules, and the data that they rest on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import allowed
from deadreckon.mbo.program import ends_of
from deadreckon.mbo.rules import Rules, at_value, written
from deadreckon.mbo.variables import Variable
from deadreckon.report.design_edges import data_value, shown_value
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import breakable, heads_of, scroll
from deadreckon.report.text import words

OPEN = 12  # variables up to which their table is not folded away
LEVELS = 8  # of a variable that are named


def asked(data: Sequence[Designs], count: int) -> Markup:
    """Targets, rules, what is known of the rows, and a table of what each variable may be.

    Args:
        data: the same designs, with the scores of one target each.
        count: of proposals.
    """
    first = data[0]
    sought = words([f"{each.target} is to be made {'small' if each.minimise else 'large'}" for each in data])
    lines = [f"{count:,} proposals: {sought}.", *_rules(first), f"Training data: {learned_from(first)}."]
    lines += [f"{each.pooling}." for each in data if each.pooling]
    lines += [f"Of the table: {line}." for line in dict.fromkeys(line for each in data for line in each.noticed)]
    for each in data:
        best = int(each.y.argmax())
        if (rule := broken_rule(each, best)) is not None:
            of = f" in {each.target}" if len(data) > 1 else ""
            lines.append(f"The best of the data{of}, {row_name(each, best)}, breaks a rule that proposals satisfy: {rule}.")
    fixed = dict(first.rules.fixed)
    rows = [
        tag("tr", tag("th", breakable(v.name), scope="row"), tag("td", v.kind), tag("td", _may_be(v, fixed.get(i))))
        for i, v in enumerate(first.variables)
    ]
    table = scroll(tag("table", heads_of(["variable", "kind", "in proposals"]), tag("tbody", rows), class_="listed"))
    if len(rows) > OPEN:
        table = tag("details", tag("summary", f"{len(rows):,} variables"), table)
    return join(tag("ul", [tag("li", line) for line in lines], class_="plain"), table)


def learned_from(data: Designs) -> str:
    """How many rows and designs there are; that is not the same where designs were measured again."""
    rows = len(data) if data.replicates is None else int(data.replicates.sum())
    different = len(np.unique(data.x, axis=0))
    counts = f"{rows:,} designs" if rows == different else f"{rows:,} rows, {different:,} different designs"
    return f"{counts}, {len(data.variables):,} variables"


def row_name(data: Designs, i: int) -> str:
    """A row of the table, as messages call it; how many measurements it is the mean of, where these are several."""
    count = 1 if data.replicates is None else int(data.replicates[i])
    return f"row {int(data.numbered(np.array([i]))[0]):,}" + (f" (mean of {count})" if count > 1 else "")


def broken_rule(data: Designs, i: int) -> str | None:
    """A rule of the proposals that a row of the data breaks by more than rounding errors; None: it breaks none."""
    x = data.x[i : i + 1]
    for column, value in data.rules.fixed:
        v = data.variables[column]
        if not at_value(x[0, column], value):
            return f"{v.name} = {data_value(v, value)}"
    for each in data.rules.linear:
        if not allowed(replace(data, rules=Rules(linear=(each,))), x, rounded=True)[0]:
            return f"always {each.text}"
    for each in data.rules.forbidden:
        if not allowed(replace(data, rules=Rules(forbidden=(each,))), x)[0]:
            return f"never {each.text}"
    return Rules().broken(data.variables, written(data.variables, x)[0])  # steps alone


def _rules(data: Designs) -> list[str]:
    rules = data.rules
    lines = [f"Always: {each.text}." for each in rules.linear] + [f"Never: {each.text}." for each in rules.forbidden]
    if rules.max_distance is not None:
        lines.append(f"At most {rules.max_distance:g} typical distances from the nearest scored row.")
    if rules.apart is not None:
        lines.append(f"At least {rules.apart:g} typical distances from each other.")
    return lines


def _may_be(v: Variable, fixed: float | None) -> Markup | str:
    """The values of a variable that may be proposed."""
    if fixed is not None:
        return tag("b", f"fixed: {shown_value(data_value(v, fixed))}")
    if v.leveled:
        more = f" and {len(v.levels) - LEVELS:,} more" if len(v.levels) > LEVELS else ""
        return f"{', '.join(map(str, v.levels[:LEVELS]))}{more}"
    ends, step = ends_of(v), "" if v.step is None else f", in steps of {shown_value(v.step)}"
    within = "without two bounds"
    if np.isfinite(ends).all():
        within = " to ".join(shown_value(data_value(v, end)) for end in ends)
    return f"{within}{step}{', on a log scale' if v.log else ''}"
