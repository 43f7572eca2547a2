"""How errors travel through backups on a grid, and what a support threshold trades (thesis 4.2, Figure 4.2).

From the top left corner a goal in the bottom left one is to be reached; the data comes from somebody who mostly goes to the
bottom right. Its size makes the Bellman error: δ(s, a) = scale / sqrt(1 + n(s, a)), n being the expected number of rows.
Errors stay the same from iteration to iteration, as those of a fit to fixed data do, and are drawn uniformly within ±δ, many
times over.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.theory import constrained, solve
from deadreckon.theory.tabular import MDP, gridworld, softmax

SCALE = 2.0  # of the error of a pair that the data lacks
LIKES = 0.6, 0.25  # how undecided the behaviour is, and how moody, in steps


@dataclass(frozen=True)
class Grid:
    """The task and its data.

    Attributes:
        world: the grid, states row by row from the top left; actions up, right, down, left.
        width, height: of the grid.
        goal: state.
        behavior: (s, a) who made the data.
        discount: per step.
        data: (s, a) distribution of the data.
        delta: (s, a) bound of the Bellman error.
    """

    world: MDP
    width: int
    height: int
    goal: int
    behavior: np.ndarray
    discount: float
    data: np.ndarray
    delta: np.ndarray


def grid(width: int = 8, height: int = 8, discount: float = 0.9, rows: int = 2000, seed: int = 0) -> Grid:
    """The task of Figure 4.2, with `rows` of data. Who has reached the goal stays there."""
    goal = (height - 1) * width
    open_ended = gridworld(width, height, slip=0.05, goal=goal)
    transitions = open_ended.transitions.copy()
    transitions[goal] = np.eye(width * height)[goal]
    world = MDP(transitions, open_ended.rewards, open_ended.initial)
    # Whoever wants to the other corner likes actions by the way that is left; a little chance, so that no two states are alike.
    way = gridworld(width, height, slip=0.0).optimal(discount)
    likes = np.log(np.maximum(way, 1e-12)) / -np.log(discount)  # minus the steps that are left
    likes = likes + LIKES[1] * np.random.default_rng(seed).standard_normal(likes.shape)
    behavior = softmax(likes, LIKES[0])
    data = world.occupancy(behavior, discount)
    return Grid(world, width, height, goal, behavior, discount, data, SCALE / np.sqrt(1.0 + rows * data))


def _run(transitions, rewards, choices, discount, errors, steps: int):
    """(e, steps, s, a) iterates from zero and (e, s) values of the last one's greedy policy, by draw of errors (e, s, a)."""

    def one(error):
        many = jnp.broadcast_to(error, (steps, *error.shape))
        q = constrained.iterates(transitions, rewards, choices, discount, many, jnp.zeros_like(rewards))
        return q, solve.values(transitions, rewards, constrained.greedy(q[-1], choices), discount)

    return jax.vmap(one)(errors)


_runs = solve.exactly(_run, static=("steps",))


@dataclass(frozen=True)
class Propagation:
    """Errors |Q_k - Q*| for each set of policies.

    Attributes:
        on: the task.
        epsilon: threshold of the support set.
        allowed: (s, a) its support.
        shown: iterations k.
        errors: set name to (k, s, a) means over draws.
        returns: set name to the mean return of the last iterate's greedy policy.
        best: the optimal return.
    """

    on: Grid
    epsilon: float
    allowed: np.ndarray
    shown: tuple[int, ...]
    errors: dict[str, np.ndarray]
    returns: dict[str, float]
    best: float


def propagate(
    on: Grid, epsilon: float = 0.3, shown: tuple[int, ...] = (1, 3, 10, 80), draws: int = 100, seed: int = 0
) -> Propagation:
    """Figure 4.2: unconstrained, support-constrained and behaviour-policy backups under the same errors."""
    world = on.world
    star = world.optimal(on.discount)
    noise = np.random.default_rng(seed).uniform(-1.0, 1.0, (draws, *star.shape)) * on.delta
    sets = {
        "unconstrained": constrained.everything(*star.shape),
        "support": constrained.support(on.behavior, epsilon),
        "behaviour": on.behavior[None],
    }
    errors, returns = {}, {}
    for name, choices in sets.items():
        q, own = _runs(world.transitions, world.rewards, choices, on.discount, noise, steps=max(shown))
        errors[name] = np.abs(q[:, np.array(shown) - 1] - star).mean(0)
        returns[name] = float((own @ world.initial).mean())
    best = float(world.initial @ star.max(1))
    return Propagation(on, epsilon, on.behavior >= epsilon, shown, errors, returns, best)


@dataclass(frozen=True)
class Tradeoff:
    """The theorems along the threshold: an entry a threshold.

    Attributes:
        epsilon: thresholds.
        pairs: share of state-action pairs in the support.
        coefficient, printed_coefficient: C~ and C as printed.
        support_bound, printed_support_bound: of the latter, by Theorem 4.2.2.
        gap, printed_gap: α_V and α.
        error: E_μ[max E_π δ].
        bound, printed_bound: of the loss, by Theorem 4.2.1.
        loss: mean over draws of E_ρ0 |V^{π_k} - V*|.
        worst: the greatest of them.
    """

    epsilon: np.ndarray
    pairs: np.ndarray
    coefficient: np.ndarray
    printed_coefficient: np.ndarray
    support_bound: np.ndarray
    printed_support_bound: np.ndarray
    gap: np.ndarray
    printed_gap: np.ndarray
    error: np.ndarray
    bound: np.ndarray
    printed_bound: np.ndarray
    loss: np.ndarray
    worst: np.ndarray


def tradeoff(on: Grid, thresholds: int = 24, draws: int = 100, steps: int = 100, seed: int = 0) -> Tradeoff:
    """α and C along ε, with the bounds that they give and the loss that there is."""
    world, discount = on.world, on.discount
    arguments = world.transitions, world.rewards
    noise = np.random.default_rng(seed).uniform(-1.0, 1.0, (draws, *world.rewards.shape)) * on.delta
    star = float(world.initial @ world.optimal(discount).max(1))
    data = on.data.sum(1)
    shift = solve.exactly(constrained.concentrability)
    sum_up, sum_up_printed = (solve.exactly(f) for f in (constrained.coefficient, constrained.printed_coefficient))
    gaps = [solve.exactly(f) for f in (constrained.suboptimality, constrained.printed_suboptimality)]
    come, worst_error = solve.exactly(constrained.reachable), solve.exactly(constrained.worst_error)
    own = float(sum_up_printed(shift(world.transitions, world.initial, on.behavior[None], data), discount))
    rows = []
    for epsilon in np.linspace(0.0, on.behavior.max(1).min(), thresholds):
        choices = constrained.support(on.behavior, epsilon)
        c = shift(world.transitions, world.initial, choices, data)
        wide, printed = (float(f(c, discount)) for f in (sum_up, sum_up_printed))
        least = float(data[come(world.transitions, world.initial, choices)].min())
        gap, printed_gap = (float(f(*arguments, choices, discount)) for f in gaps)
        error = float(worst_error(on.delta, choices, data))
        lost = star - _runs(*arguments, choices, discount, noise, steps=steps)[1] @ world.initial
        rows.append((
            epsilon, (on.behavior >= epsilon).mean(), wide, printed, constrained.support_bound(own, least, epsilon, discount),
            constrained.printed_support_bound(own, least, epsilon, discount), gap, printed_gap, error,
            constrained.loss_bound(wide, error, gap, discount),
            constrained.printed_loss_bound(printed, error, printed_gap, discount),
            lost.mean(), lost.max(),
        ))  # fmt: skip
    return Tradeoff(*np.array(rows).T)
