"""How tests walk through a simulator."""

import numpy as np


def walk(simulator, actions):
    """Steps, and resets what is over: all that came out, one list of arrays."""
    out = []
    for action in actions:
        *step, terminals, timeouts = simulator.step(action)
        out += [*step, terminals, timeouts]
        over = np.flatnonzero(terminals | timeouts)
        if len(over):
            out.append(simulator.reset(over))
    return out
