"""How far errors travel in Q-learning on a grid, by the set of policies that a backup may choose from (thesis Figure 4.2)."""

from deadreckon.theory.propagation import grid, propagate

ITERATIONS = 80  # after which errors are read off


def errors(case: str, *, seed: int, policies: str) -> dict[str, float]:
    """Errors and loss under one set of policies; behaviour, data and errors are drawn anew with each seed.

    Args:
        case: `epsilon=NUMBER`, the threshold of the support set.
        seed: of everything.
        policies: `unconstrained`, `support` or `behaviour`.

    Returns:
        error: mean of |Q_k - Q*| over states, actions and draws.
        loss: what the last iterate's greedy policy earns less than the best one.
    """
    found = propagate(grid(seed=seed), float(case.removeprefix("epsilon=")), (ITERATIONS,), seed=seed)
    return {"error": float(found.errors[policies].mean()), "loss": found.best - found.returns[policies]}
