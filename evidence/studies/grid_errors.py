"""How far errors travel in Q-learning on a grid, by the set of policies that a backup may choose from (thesis Figure 4.2)."""

import numpy as np

from deadreckon.theory.propagation import Grid, grid, propagate

ITERATIONS = 80  # after which errors are read off
THRESHOLDS = 24  # that are tried where the threshold is chosen, evenly apart and all above 0, which is no constraint
APART = 1_000_000  # what seeds of the errors by which it is chosen are apart from those that it is judged by


def chosen(on: Grid, seed: int) -> float:
    """The threshold whose support loses least, in the mean over draws of errors that it is not judged by."""
    tried = np.linspace(0.0, on.behavior.max(1).min(), THRESHOLDS + 1)[1:]
    returns = [propagate(on, float(each), (ITERATIONS,), seed=APART + seed).returns["support"] for each in tried]
    return float(tried[int(np.argmax(returns))])


def errors(case: str, *, seed: int, policies: str) -> dict[str, float]:
    """Errors and loss under one set of policies; behaviour, data and errors are drawn anew with each seed.

    Args:
        case: `epsilon=NUMBER`, the threshold of the support set, or `chosen`, the best one of the grid.
        seed: of everything.
        policies: `unconstrained`, `support` or `behaviour`.

    Returns:
        error: mean of |Q_k - Q*| over states, actions and draws.
        loss: what the last iterate's greedy policy earns less than the best one.
    """
    on = grid(seed=seed)
    if case != "chosen":
        epsilon = float(case.removeprefix("epsilon="))
    else:
        epsilon = chosen(on, seed) if policies == "support" else 0.0  # the others have none
    found = propagate(on, epsilon, (ITERATIONS,), seed=seed)
    return {"error": float(found.errors[policies].mean()), "loss": found.best - found.returns[policies]}
