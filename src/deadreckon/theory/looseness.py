"""How loose the bounds of chapter 5 are, on random worlds and where the sharper ones are met, and what that does to k*."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Array

from deadreckon.theory import branching, solve
from deadreckon.theory.monotonic import improve
from deadreckon.theory.tabular import Worlds, garnets, policies


def near(first: np.ndarray, second: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The first of each pair moved towards the second, a little or far."""
    share = rng.uniform(0.0, 1.0, len(first)) ** rng.choice([1, 4], len(first))
    share = share.reshape(-1, *[1] * (first.ndim - 1))
    return (1 - share) * first + share * second


class Sample(NamedTuple):
    """Random worlds, models of them that err, old policies and new ones near them, and discounts, n of each."""

    worlds: Worlds
    model: np.ndarray
    old: np.ndarray
    new: np.ndarray
    discount: np.ndarray


def sample(count: int, rng: np.random.Generator) -> Sample:
    """Draws them."""
    worlds = garnets(count, rng)
    model = near(worlds.transitions, garnets(count, rng).transitions, rng)
    old = policies(count, rng)
    return Sample(worlds, model, old, near(old, policies(count, rng), rng), rng.uniform(0.05, 0.95, count))


@dataclass(frozen=True)
class Measured:
    """What is true of each.

    Attributes:
        value: J of the new policy.
        estimated: what the model says of it.
        branched: (n, k + 1) J_branch by length.
        under_old, under_new: the model's error under either policy, in the world.
        policy: eps_pi.
        r_max: greatest |reward|.
    """

    value: np.ndarray
    estimated: np.ndarray
    branched: np.ndarray
    under_old: np.ndarray
    under_new: np.ndarray
    policy: np.ndarray
    r_max: np.ndarray


def _exact(transitions, model, rewards, initial, old, new, discount, length, steps) -> tuple[Array, ...]:
    begun = solve.occupancy(transitions, initial, old, discount)
    branched = branching.branched_occupancies(model, initial, new, begun, length, discount)
    value = initial @ solve.values(transitions, rewards, new, discount)
    estimated = initial @ solve.values(model, rewards, new, discount)
    under_old, under_new = (branching.expected_error(transitions, model, initial, policy, steps) for policy in (old, new))
    return value, estimated, (branched * rewards).sum((1, 2)) / (1.0 - discount), under_old, under_new


def measure(drawn: Sample, length: int = 10, steps: int = 250) -> Measured:
    """Solves them exactly, with rollouts of up to `length` steps."""
    worlds = drawn.worlds
    run = solve.exactly(partial(_exact, length=length, steps=steps), over=(0,) * 7)
    value, estimated, branched, under_old, under_new = run(
        worlds.transitions, drawn.model, worlds.rewards, worlds.initial, drawn.old, drawn.new, drawn.discount
    )
    apart, r_max = branching.policy_divergence(drawn.old, drawn.new), np.abs(worlds.rewards).max((1, 2))
    return Measured(value, estimated, branched, under_old, under_new, apart, r_max)


K = 4  # length of the rollouts in the picture
EDGES = np.linspace(0.05, 0.95, 10)  # of the groups of discounts


@dataclass(frozen=True)
class Looseness:
    """How much of a bound is used: |gap| / bound, since a model that underestimates a return errs as much.

    Attributes:
        discount: (g,) middles of groups.
        used: bound's name to (g, 3) median, 90th percentile and greatest of the group.
        violations: bound's name to how many of the random worlds break it, on either side.
        count: of random worlds.
    """

    discount: np.ndarray
    used: dict[str, np.ndarray]
    violations: dict[str, int]
    count: int


def looseness(count: int = 4000, seed: int = 0) -> Looseness:
    """Theorems 5.2.1 to 5.2.3 and their sharper forms on random worlds."""
    drawn = sample(count, np.random.default_rng(seed))
    m, discount = measure(drawn, K), drawn.discount
    errors = {"old": (m.under_old, m.policy, discount, m.r_max), "new": (m.under_new, m.policy, discount, m.r_max)}
    # Both sides: the proofs bound the distance of the two returns, and half of random models underestimate.
    gaps = {"full": np.abs(m.estimated - m.value), "branched": np.abs(m.branched[:, K] - m.value)}
    bounds = {
        "Theorem 5.2.1": (gaps["full"], branching.full_bound(*errors["old"])),
        "5.2.1, sharper": (gaps["full"], branching.sharp_full_bound(*errors["old"])),
        "Theorem 5.2.2": (gaps["branched"], branching.branched_bound(K, *errors["old"])),
        "5.2.2, sharper": (gaps["branched"], branching.sharp_branched_bound(K, *errors["old"])),
        "Theorem 5.2.3": (gaps["branched"], branching.generalising_bound(K, *errors["new"])),
        "5.2.3, sharper": (gaps["branched"], branching.sharp_generalising_bound(K, *errors["new"])),
    }
    group = np.digitize(discount, EDGES[1:-1])
    used, violations = {}, {}
    for name, (gap, bound) in bounds.items():
        share = np.where(bound > 1e-9, gap / np.maximum(bound, 1e-9), 0.0)
        parts = [share[group == g] for g in range(len(EDGES) - 1)]
        used[name] = np.array([[np.median(part), np.percentile(part, 90), part.max()] for part in parts])
        violations[name] = int((gap > bound + 1e-8).sum())
    return Looseness((EDGES[1:] + EDGES[:-1]) / 2, used, violations, count)


@dataclass(frozen=True)
class Lengths:
    """Gap and bounds by rollout length, in the world that meets the sharper bounds; `under` the old or the new policy.

    Attributes:
        k: lengths.
        exact: J_branch - J.
        printed: Theorem 5.2.2 or 5.2.3.
        sharp: its sharper form.
    """

    k: np.ndarray
    exact: np.ndarray
    printed: np.ndarray
    sharp: np.ndarray


def lengths(model: float = 2e-3, policy: float = 4e-3, discount: float = 0.9, most: int = 20, *, under: str = "old") -> Lengths:
    """One of the two."""
    world, old, wrong, new = branching.tight(model, policy, under=under)
    error = branching.model_error(world, wrong, old if under == "old" else new)
    k, value = np.arange(most + 1), world.value(new, discount)
    joint = [branching.branched_occupancy(world, old, wrong, new, int(i), discount) for i in k]
    exact = np.array([(each * world.rewards).sum() / (1.0 - discount) - value for each in joint])
    printed, sharp = {
        "old": (branching.branched_bound, branching.sharp_branched_bound),
        "new": (branching.generalising_bound, branching.sharp_generalising_bound),
    }[under]
    return Lengths(k, exact, printed(k, error, policy, discount), sharp(k, error, policy, discount))


def best_lengths() -> tuple[np.ndarray, dict[float, np.ndarray]]:
    """k* of Theorem 5.2.3 by eps_m' / eps_pi, on which alone it depends, for three discounts."""
    ratio, half = np.linspace(0.02, 1.1, 60), 0.5
    return ratio, {g: np.array([branching.best_length(half * r, half, g) for r in ratio]) for g in (0.9, 0.95, 0.99)}


def courses(worlds: int = 12, discount: float = 0.3, epochs: int = 6, rows: int = 100, seed: int = 0) -> dict[str, np.ndarray]:
    """Algorithm 2 with three penalties: (worlds, epochs + 1) shares of the way from the first policy's return to the best."""
    drawn = garnets(worlds, np.random.default_rng(seed), states=5, actions=3)
    penalties = {"no penalty": None, "printed C": branching.full_bound, "sharper C": branching.sharp_full_bound}
    found = {}
    for name, penalty in penalties.items():
        rows_of = []
        for i in range(worlds):
            world = drawn.world(i)
            got = improve(world, discount, penalty, epochs=epochs, rows=rows, keep=penalty is not None, seed=i).returns
            best = float(world.initial @ world.optimal(discount).max(1))
            rows_of.append((got - got[0]) / (best - got[0]))
        found[name] = np.array(rows_of)
    return found
