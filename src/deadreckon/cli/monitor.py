"""`deadreckon monitor`: a new log against the one that a policy learned from, and its realised value against the estimate."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from deadreckon.cli.lines import outcome
from deadreckon.cli.parse import RUN, parse, with_policy_seed
from deadreckon.errors import as_one_line


@dataclass
class Monitor:
    """Compare a new log with the one that a policy was trained on, and its realised value with the estimate.

    Exit code 0: no alarm; 1: drift, values outside the log, or a value below the estimate; 2: bad input; 70: it failed.
    """

    run: RUN
    log: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]  # new log, in the order of time
    html: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None  # HTML page to write; an old one is replaced
    reference: Annotated[str | None, tyro.conf.arg(metavar="LOG")] = None
    """log to compare with, such as the policy's first weeks; None: the log that the policy was trained on"""
    made_by: Literal["policy", "reference"] | None = None
    """origin of the new log: the run's policy, or the same as the reference's; None: policy, or reference with --reference"""
    estimates: Annotated[str | None, tyro.conf.arg(metavar="FOLDER")] = None
    """folder of `deadreckon ope --out` or `recommend`; None: found in the run's folder or beside it"""
    return_range: tuple[float, float] | None = None
    """least and greatest return of an episode; None: the reference's range, widened if it has more than ten returns"""
    policy_seed: int | None = None  # seed of the run whose policy is monitored; None: the first that has not failed
    greedy: bool | None = None  # whether the policy acts deterministically (greedily) in use; None: as estimated, else yes
    alpha: float = 0.05  # probability of a false alarm, over all looks together


def monitor(args: Sequence[str]) -> int:
    """Prints one line per finding; gives the exit code."""
    options = parse(Monitor, with_policy_seed(args), "monitor")
    from deadreckon.runs.monitor import monitor as compare

    if options.html is not None:
        from deadreckon.report.page import check_page

        check_page(options.html, "--html")
    found = compare(
        options.run, options.log, reference=options.reference, made_by=options.made_by, estimates=options.estimates,
        return_range=options.return_range, seed=options.policy_seed, greedy=options.greedy, alpha=options.alpha,
    )  # fmt: skip
    outcome(found)  # before the page, which a full disk or a kill may prevent
    if options.html is not None:
        from deadreckon.report.monitored import write_monitored

        try:
            write_monitored(found, options.html)
            outcome(f"page: {options.html}")
        except Exception as error:
            if not found.alarm:
                raise
            print(f"deadreckon: {as_one_line(error)}", file=sys.stderr)  # and the exit code is that of the alarm
    return 1 if found.alarm else 0
