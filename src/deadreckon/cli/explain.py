"""`deadreckon explain`: what a policy does, as a small tree, and which columns it acts on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from deadreckon.cli.parse import RUN, parse, with_policy_seed


@dataclass
class Explain:
    """Fit a small decision tree to a policy, report its fidelity on other rows of the log, and name the columns that matter.

    Without LOG the result is kept in the run's folder, and `deadreckon report` draws it.
    """

    run: RUN
    log: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")] = None
    """log on whose rows the policy is explained; None: the one that it was trained on"""
    policy_seed: int | None = None  # seed of the run whose policy is explained; None: the first that has not failed


def explain(args: Sequence[str]) -> None:
    """Prints the tree and the columns."""
    options = parse(Explain, with_policy_seed(args), "explain")
    from deadreckon.runs.explain import explain as asked

    print(asked(options.run, options.log, seed=options.policy_seed))
