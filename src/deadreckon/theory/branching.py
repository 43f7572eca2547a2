"""What short model rollouts cost: the bounds of chapter 5 and appendix B, and exact branched rollouts to hold them against.

A k-branched rollout starts at states that the old policy comes to in the true world and takes k steps of the new policy in the
model. All bounds are on J(pi) - J_branch(pi) from below, in units of a return: a promise of the model minus the bound is kept.
Errors are total variations: `model` of the next state, under the policy that is said; `policy` between the two policies at the
worst state. `r_max` is the greatest |reward|. Rewards are known: where the model learns these too, and their error counts in
`model`, 2 r_max model / (1 - discount) comes to every bound.
"""

import math

import numpy as np

from deadreckon.errors import UserError
from deadreckon.theory.tabular import MDP


def full_bound(model: float, policy: float, discount: float, r_max: float = 1.0) -> float:
    """C(eps_m, eps_pi) of Theorem 5.2.1, for rollouts in the model alone; `model` under the old policy."""
    _check(discount, model, policy)
    left = 1.0 - discount
    return 2.0 * discount * r_max * (model + 2.0 * policy) / left**2 + 4.0 * r_max * policy / left


def branched_bound(k: int, model: float, policy: float, discount: float, r_max: float = 1.0) -> float:
    """Theorem 5.2.2: `model` is measured under the old policy, so that the new one's shift is added to it."""
    _check(discount, model, policy)
    left = 1.0 - discount
    inside = discount ** (k + 1) * policy / left**2 + (discount**k + 2.0) * policy / left + k * (model + 2.0 * policy) / left
    return 2.0 * r_max * inside


def generalising_bound(k: int, model: float, policy: float, discount: float, r_max: float = 1.0) -> float:
    """Theorem 5.2.3: `model` is measured where the rollouts of the new policy go, not under the old one."""
    _check(discount, model, policy)
    left = 1.0 - discount
    return 2.0 * r_max * (discount ** (k + 1) * policy / left**2 + discount**k * policy / left + k * model / left)


def averaged_bound(k: int, model: float, policy: float, discount: float, r_max: float = 1.0, *, shifted: bool = True) -> float:
    """Corollaries B.1.2.1 and B.1.3.1, for rollouts whose states all count, as MBPO's do.

    Args:
        k, model, policy, discount, r_max: as above.
        shifted: `model` is measured under the new policy (B.1.2.1); else under the old one (B.1.3.1).
    """
    _check(discount, model, policy)
    left = 1.0 - discount
    inside = discount * policy / ((k + 1) * left**2) + policy / ((k + 1) * left)
    # B.1.2.1 prints (k + 2) / 2, which holds as well; its own proof gives k / 2.
    inside += k / 2.0 * model if shifted else k / 2.0 * (model + 2.0 * policy) + 2.0 * policy
    return 2.0 * r_max / left * inside


def best_length(model: float, policy: float, discount: float) -> float:
    """k* of 5.2.3: the rollout length of the least bound, max(0, ceil(log(eps_m' / eps_pi) / log(discount))).

    The bracket is policy discount^k / (1 - discount)^2 + k model / (1 - discount), and one step more changes it by
    (model - discount^k policy) / (1 - discount): so k* > 0 if and only if the model's error is below the policy's. Without
    model error it is endless.
    """
    _check(discount, model, policy)
    if model >= policy:
        return 0
    if model == 0.0:
        return math.inf
    if discount == 0.0:
        return 1
    return max(1, math.ceil(math.log(model / policy) / math.log(discount) - 1e-9))


def branched_occupancy(
    world: MDP, old: np.ndarray, model: MDP, new: np.ndarray, k: int, discount: float, *, averaged: bool = False
) -> np.ndarray:
    """(states, actions) occupancy of k-branched rollouts, which sums to one where no episode ends (Definitions B.1.1-2).

    Args:
        world, old: before the branch.
        model, new: after it; the first step takes the old policy's last action.
        k: steps after the branch.
        discount: per step.
        averaged: over all lengths 0 .. k, the states on the way included.
    """
    _check(discount)

    def advance(joint: np.ndarray) -> np.ndarray:
        return np.einsum("sa,sau->u", joint, model.transitions)[:, None] * new

    branched = world.occupancy(old, discount)  # of length 0
    begun = (1.0 - discount) * world.initial[:, None] * new  # rollouts that start with the episode itself
    total = branched
    for _ in range(k):
        branched = begun + discount * advance(branched)
        total = total + branched
    return total / (k + 1) if averaged else branched


def policy_divergence(old: np.ndarray, new: np.ndarray) -> float:
    """eps_pi: the total variation between two (states, actions) policies at the worst state."""
    return float(np.abs(old - new).sum(1).max() / 2.0)


def model_error(world: MDP, model: MDP, policy: np.ndarray | None = None, steps: int = 1000) -> float:
    """eps_m: the greatest expected total variation of the next state at any of the first `steps` steps of a policy.

    Without a policy, that of the worst state and action, which no policy exceeds.
    """
    # What a row lacks to one is the end, a state like others.
    ended = world.transitions.sum(-1) - model.transitions.sum(-1)
    error = (np.abs(world.transitions - model.transitions).sum(-1) + np.abs(ended)) / 2.0
    if policy is None:
        return float(error.max())
    flow = np.einsum("sau,sa->su", world.transitions, policy)
    now, worst = world.initial, 0.0
    for _ in range(steps):
        worst = max(worst, float(now @ (policy * error).sum(1)))
        now = now @ flow
    return worst


def _check(discount: float, *errors: float) -> None:
    if not 0.0 <= discount < 1.0:
        raise UserError(f"discount must be 0 .. 1 without 1, got {discount}")
    if any(not 0.0 <= error <= 1.0 for error in errors):
        raise UserError(f"errors are total variations, 0 .. 1, got {' and '.join(f'{error:g}' for error in errors)}")
