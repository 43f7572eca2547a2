"""Inputs that the other inputs predict: they may be measured during a run, as a pH is, and cannot be set as proposed.

Each input is predicted in left-out rows from all others, by `over_time.left_out`. A consequence that is an input explains the
score better than the settings that cause it, and proposals then have values of it that these settings do not give.
"""

import shlex
from typing import TYPE_CHECKING

import numpy as np

from deadreckon.mbo.doubts import relations, said_in, unsaid_sums
from deadreckon.mbo.over_time import left_out, sampled
from deadreckon.mbo.variables import measured

if TYPE_CHECKING:
    from deadreckon.mbo.designs import Designs

LEAST, MOST = 30, 200  # fewest rows for a test, and most that are tested
INPUTS = 30  # most inputs: with more, something predicts each
EXPLAINED = 0.8  # share of an input's variance that others explain in left-out rows


def about_driven_inputs(data: "Designs") -> list[str]:
    """A message on numbers among the inputs that the others predict, with a share above `EXPLAINED`."""
    if len(data) < LEAST or not 1 < len(data.variables) <= INPUTS or len(np.unique(data.units)) < LEAST:
        return []
    x = data.x.astype(np.float64)
    known = {i for group, _ in unsaid_sums(data.variables, x, data.rules) for i in group} | said_in(data.rules)
    known |= {i for group in relations(data.variables, measured(data.variables, x), known) for i in group}
    numeric = [int(i) for i in data.coordinates.numeric if np.ptp(data.x[:, i]) > 0]
    columns = [i for i in numeric if i not in known and not data.variables[i].leveled]
    (_, z, units), owners = sampled(data, MOST, "driven inputs"), data.coordinates.place_owners
    found = []
    for i in columns:
        own = z[:, owners == i]
        left = float(np.square(left_out([z[:, owners != i]], own, units)).mean() / np.square(own).mean())
        if left < 1.0 - EXPLAINED:
            found.append((left, data.variables[i].name))
    if not found:
        return []
    (left, name), *_ = pairs = sorted(found)
    share, remedy = f"R2 {1.0 - left:.2f}", f"(--ignore {shlex.quote(name)})"
    if len(pairs) == 1:
        text = f"column {name} is predicted by the other inputs ({share} in rows left out): if it is measured and not set, "
        text += f"leave it out {remedy}; if it is set"
    else:
        names = ", ".join(other for _, other in pairs)
        text = f"columns {names} are predicted by the other inputs ({share} of {name} in rows left out): leave out what is "
        text += f"measured and not set {remedy}; if all are set"
    return [f"{text}, effects of inputs that vary together are hardly known"]
