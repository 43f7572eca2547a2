"""Two small worlds on learning from data: a projection that makes Q-iteration diverge (2.1), and stitching (Figure 7.1)."""

from dataclasses import dataclass

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from deadreckon.theory.tabular import MDP


def projection(features: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n, n) Π_μ: the weighted least-squares projection on the span of features (n, d) (2.1)."""
    return features @ np.linalg.pinv(features.T @ (weight[:, None] * features)) @ (features * weight[:, None]).T


def fitted_iterates(
    world: MDP, features: np.ndarray, weight: np.ndarray, discount: float, first: np.ndarray, steps: int
) -> np.ndarray:
    """(steps + 1, s, a) of Q <- Π_μ T Q.

    Args:
        world: finite.
        features: (s a, d) of the approximations.
        weight: (s, a) distribution μ of the data.
        discount: per step.
        first: (s, a).
        steps: iterations.
    """
    project, q = projection(features, weight.reshape(-1)), [first]
    for _ in range(steps):
        target = world.rewards + discount * world.transitions @ q[-1].max(1)
        q.append((project @ target.reshape(-1)).reshape(target.shape))
    return np.array(q)


def doubling() -> tuple[MDP, np.ndarray]:
    """Two states that both lead to the second, no rewards, and one feature: 1 and 2 (Tsitsiklis and Van Roy 1996).

    Q = w (1, 2) is exact for w = 0. The targets of both states are 2 γ w; their projection multiplies w by
    2 γ (μ_1 + 2 μ_2) / (μ_1 + 4 μ_2): γ where the data is that of the world itself, all in state 2, and up to 2 γ the more of
    it is in state 1. T contracts in the maximum norm, Π_μ does not expand that
    of μ, and together they need not contract in any.
    """
    transitions = np.zeros((2, 1, 2))
    transitions[:, 0, 1] = 1.0
    return MDP(transitions, np.zeros((2, 1)), np.array([0.5, 0.5])), np.array([[1.0], [2.0]])


def growth(share: np.ndarray, discount: float) -> np.ndarray:
    """The factor of w in `doubling` with a share of the data in state 1: above one it diverges."""
    return 2.0 * discount * (share + 2.0 * (1.0 - share)) / (share + 4.0 * (1.0 - share))


@dataclass(frozen=True)
class Stitching:
    """Trajectories from A to B and from B to C, and what can be made of them.

    Attributes:
        width: of the grid, states row by row.
        ways: the logged states, a trajectory each.
        stitched: states of the policy found by Q-iteration on the log, from A.
        start, meeting, end: A, B and C.
        values: name to the value at A, of which more is better.
    """

    width: int
    ways: list[list[int]]
    stitched: list[int]
    start: int
    meeting: int
    end: int
    values: dict[str, float]


_MOVES = {"u": (0, -1, 0), "r": (1, 0, 1), "d": (0, 1, 2), "l": (-1, 0, 3)}  # to dx, dy, action


def stitching() -> Stitching:
    """Figure 7.1 on a grid: one trajectory comes from A through B, another goes through B to C, which alone pays.

    No trajectory leads from A to C: whoever looks at whole trajectories that begin at A finds nothing there. Backups on the log
    do, without an action that the log lacks.
    """
    size, discount = 7, 0.9
    cell = lambda x, y: x + size * y  # noqa: E731
    half = size // 2
    walks = [((0, size - 1), "r" * half + "u" * half + "u" * half), ((0, 0), "d" * half + "r" * half + "r" * half)]
    ways, rows = [], []
    end = cell(size - 1, half)
    for (x, y), word in walks:
        way = [cell(x, y)]
        for letter in word:
            dx, dy, action = _MOVES[letter]
            x, y = x + dx, y + dy
            way.append(cell(x, y))
            rows.append((way[-2], action, float(way[-1] == end), way[-1] == end, len(way) == len(word) + 1, way[-1]))
        ways.append(way)
    now, action, reward, over, last, after = (np.array(column) for column in zip(*rows))
    one_hot = np.eye(size * size, dtype=np.float32)
    log = Dataset.from_arrays(
        observations=one_hot[now], actions=action, rewards=reward, terminals=over, timeouts=last & ~over,
        final_observations=one_hot[after[last]], action_space=Discrete(4), name="stitching",
    )  # fmt: skip
    seen = MDP.of(log)
    q = seen.optimal(discount)
    start, state, path = ways[0][0], ways[0][0], []
    while state not in path:
        path.append(state)
        state = int(seen.transitions[state, q[state].argmax()].argmax()) if seen.transitions[state].any() else state
    counts = np.zeros((size * size, 4))
    np.add.at(counts, (now, action), 1.0)
    clone = np.where(counts.sum(1, keepdims=True) > 0, counts / np.maximum(counts.sum(1, keepdims=True), 1), 0.25)
    values = {
        "returns of trajectories from A": float(sum(discount**t * r for t, r in enumerate(reward[: len(walks[0][1])]))),
        "behaviour cloning": float((clone * seen.q(clone, discount))[start].sum()),
        "Q-iteration on the log": float(q[start].max()),
    }
    return Stitching(size, ways, [*path, end], start, cell(half, half), end, values)
