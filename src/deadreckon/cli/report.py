"""`deadreckon report`: one page from run folders."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from deadreckon.cli.parse import parse
from deadreckon.errors import UserError


@dataclass
class Report:
    """Write a self-contained HTML page about runs, and with --estimates about the decision between their policies."""

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")]  # run folders of one task
    out: str = "report.html"  # HTML file to write
    title: str | None = None  # heading of the page
    estimates: str | None = None  # folder of `deadreckon ope --select --out`, to show the off-policy estimates and the decision


def report(args: Sequence[str]) -> None:
    """Writes the page and prints its path."""
    options = parse(Report, args, "report")
    if not options.runs:
        raise UserError("missing a run folder")
    from deadreckon.report import write

    print(write(options.runs, options.out, title=options.title, estimates=options.estimates))
