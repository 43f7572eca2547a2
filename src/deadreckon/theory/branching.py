"""What short model rollouts cost: the bounds of chapter 5 and appendix B, and exact branched rollouts to hold them against.

A k-branched rollout starts at states that the old policy comes to in the true world and takes k steps of the new policy in the
model. All bounds are on J(pi) - J_branch(pi) from below, in units of a return: a promise of the model minus the bound is kept.
Errors are total variations: `model` of the next state, at the worst step, in expectation under the policy that is said;
`policy` between the two policies at the worst state. `r_max` is the greatest |reward|. All may be arrays. Appendix B prints
KL divergences in B.2.2 to B.2.4: with these the lemmas fail, since a small KL leaves a total variation of its root.

Rewards are known: where the model learns these too, and their error counts in `model`, `learned_rewards` comes to a bound.

**Sharper forms.** Take the world under the old policy, the world under the new one and the model under the new one, and draw
them together: the same action as long as the policies allow it, the same next state as long as the dynamics do. The second and
the third differ only after the first action in which the policies differed, of probability `policy` a step, or the first wrong
step of the model. They are the *same* policy, so its distance from the old one is paid once, where the printed proofs of 5.2.1
and 5.2.2 pay it twice, and never for the last action (in 5.2.3 the only slack is min(t, k) <= k). That gives
t (model + policy) for the total variation at time t, and `sharp_*` below, which `tight` meets with equality to first order in
the errors.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.errors import UserError
from deadreckon.theory import solve
from deadreckon.theory.tabular import MDP

STEPS = 1000  # of an episode at which a model's error is looked for

# ---- bounds as printed, where they hold -------------------------------------------------------------------------------


def return_bound(model: Any, policy: Any, discount: Any, r_max: Any = 1.0) -> Any:
    """|J_1 - J_2| of two worlds with two policies (Lemma B.2.3); `model` under the first policy in the first world."""
    _check(discount, model, policy)
    left = 1.0 - discount
    return 2.0 * r_max * (discount * (model + policy) / left**2 + policy / left)


def branched_return_bound(
    k: Any, before: tuple[Any, Any], after: tuple[Any, Any], discount: Any, r_max: Any = 1.0, *, averaged: bool = False
) -> Any:
    """|J_1 - J_2| of two k-branched rollouts (Lemma B.2.4).

    Args:
        k: steps after the branch.
        before: (model, policy) errors before the branch, under the first rollout.
        after: those after it.
        discount: as above.
        r_max: as above.
        averaged: over all lengths 0 .. k.
    """
    _check(discount, *before, *after)
    left, reached, acted = 1.0 - discount, sum(before), sum(after)
    if averaged:
        inside = k / 2.0 * acted + (discount * reached / left**2 + before[1] / left) / (k + 1) + after[1]
        return 2.0 * r_max / left * inside
    fade = discount**k
    return 2.0 * r_max * (discount * fade * reached / left**2 + (k * acted + fade * before[1] + after[1]) / left)


def full_bound(model: Any, policy: Any, discount: Any, r_max: Any = 1.0) -> Any:
    """C(eps_m, eps_pi) of Theorem 5.2.1, for rollouts in the model alone; `model` under the old policy."""
    _check(discount, model, policy)
    left = 1.0 - discount
    return 2.0 * discount * r_max * (model + 2.0 * policy) / left**2 + 4.0 * r_max * policy / left


def branched_bound(k: Any, model: Any, policy: Any, discount: Any, r_max: Any = 1.0) -> Any:
    """Theorem 5.2.2: `model` is measured under the old policy, so that the new one's shift is added to it.

    The proof's third reference must be the old policy in the *true* world (it prints the model), under which `model` is
    measured.
    """
    _check(discount, model, policy)
    left = 1.0 - discount
    inside = discount ** (k + 1) * policy / left**2 + (discount**k + 2.0) * policy / left + k * (model + 2.0 * policy) / left
    return 2.0 * r_max * inside


def generalising_bound(k: Any, model: Any, policy: Any, discount: Any, r_max: Any = 1.0) -> Any:
    """Theorem 5.2.3: `model` is measured under the new policy in the true world.

    5.2 prints the expectation over the old one's states, with which it fails: a model that is wrong only where the new policy
    goes has no error at all there. B.1.2's own reference, the old policy before the branch and the new one after it, would need
    the error under that mixture. With rollouts of the new policy throughout, in the true world first and in the model after the
    branch, the statement follows: those differ from J(pi) in the model alone, and from J_branch in what acted before.
    """
    _check(discount, model, policy)
    left = 1.0 - discount
    return 2.0 * r_max * (discount ** (k + 1) * policy / left**2 + discount**k * policy / left + k * model / left)


def averaged_bound(k: Any, model: Any, policy: Any, discount: Any, r_max: Any = 1.0, *, shifted: bool = True) -> Any:
    """Corollaries B.1.2.1 and B.1.3.1, for rollouts whose states all count, as MBPO's do.

    Args:
        k: as above.
        model: as above; see `shifted`.
        policy: as above.
        discount: as above.
        r_max: as above.
        shifted: `model` is measured under the new policy (B.1.2.1); else under the old one (B.1.3.1).
    """
    _check(discount, model, policy)
    left = 1.0 - discount
    inside = discount * policy / ((k + 1) * left**2) + policy / ((k + 1) * left)
    # B.1.2.1 prints (k + 2) / 2, which holds as well; its own proof gives k / 2.
    inside = inside + (k / 2.0 * model if shifted else k / 2.0 * (model + 2.0 * policy) + 2.0 * policy)
    return 2.0 * r_max / left * inside


def learned_rewards(model: Any, discount: Any, r_max: Any = 1.0, policy: Any = 0.0) -> Any:
    """What comes to a bound if `model` is the error of next state and reward together, as in 5.2: 2 r_max model a step.

    The sharper forms with `model` under the old policy (`sharp_full_bound`, `sharp_branched_bound`) do not pay for the last
    action, whose reward may be wrong too: for these give `policy`, and it is 2 r_max (model + policy) a step.
    """
    _check(discount, model, policy)
    return 2.0 * r_max * (model + policy) / (1.0 - discount)


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


# ---- sharper bounds ---------------------------------------------------------------------------------------------------


def sharp_full_bound(model: Any, policy: Any, discount: Any, r_max: Any = 1.0) -> Any:
    """2 r_max discount (model + policy) / (1 - discount)^2 for Theorem 5.2.1; without model error discount / 2 of it."""
    _check(discount, model, policy)
    return 2.0 * r_max * discount * (model + policy) / (1.0 - discount) ** 2


def sharp_branched_bound(k: Any, model: Any, policy: Any, discount: Any, r_max: Any = 1.0) -> Any:
    """In place of Theorem 5.2.2, `model` under the old policy: least at k = 1 if discount model < policy.

    At time t >= k >= 1 every action but the last may differ, and k model steps may be wrong: t policy + k model. Without a
    branch the last action is the old policy's too: (t + 1) policy. So one step pays for itself, a second one never; as
    printed, none.
    """
    _check(discount, model, policy)
    left, k = 1.0 - discount, np.asarray(k)
    inside = discount * policy + discount * (1.0 - np.power(discount, k)) * model
    return 2.0 * r_max / left**2 * np.where(k == 0, policy, inside)


def sharp_generalising_bound(k: Any, model: Any, policy: Any, discount: Any, r_max: Any = 1.0) -> Any:
    """In place of Theorem 5.2.3, `model` under the new policy: falls in k for ever if discount model < policy, else rises.

    At time t >= k the total variation is at most (t - k + 1) policy + k model, before it t model, and sum_t discount^t min(t,
    k) is discount (1 - discount^k) / (1 - discount)^2, where the thesis has k / (1 - discount), which grows without end: from
    there comes a best length k* in between.
    """
    _check(discount, model, policy)
    fade = np.power(discount, np.asarray(k))
    return 2.0 * r_max * (fade * policy + discount * (1.0 - fade) * model) / (1.0 - discount) ** 2


# ---- exact rollouts ---------------------------------------------------------------------------------------------------


def branched_occupancies(
    flow: Float[Array, "s a t"], initial: Float[Array, "s"], new: Float[Array, "s a"], begun: Float[Array, "s a"], k: int,
    discount: Any,
) -> Float[Array, "k s a"]:  # fmt: skip
    """Occupancies of branched rollouts of 0 .. k steps (Definition B.1.1).

    Args:
        flow: of the model.
        initial: first states.
        new: the policy after the branch.
        begun: occupancy of the old policy in the true world, whose last action the first step of a branch takes.
        k: steps.
        discount: per step.
    """

    def advance(joint: Array, _: None) -> tuple[Array, Array]:
        # Rollouts that are longer than the episode is old start with it.
        states = (1.0 - discount) * initial + discount * jnp.einsum("sa,sat->t", joint, flow)
        return states[:, None] * new, states[:, None] * new

    return jnp.concatenate([begun[None], jax.lax.scan(advance, begun, None, length=k)[1]])


_branched = solve.exactly(branched_occupancies, static=("k",))


def branched_occupancy(
    world: MDP, old: np.ndarray, model: MDP, new: np.ndarray, k: int, discount: float, *, averaged: bool = False
) -> np.ndarray:
    """(states, actions) occupancy of k-branched rollouts, which sums to one where no episode ends (Definitions B.1.1-2).

    Args:
        world: before the branch.
        old: the policy there.
        model: the world after it.
        new: the policy there; the first step takes the old policy's last action.
        k: steps after the branch.
        discount: per step.
        averaged: over all lengths 0 .. k, the states on the way included.
    """
    _check(discount)
    each = _branched(model.transitions, world.initial, new, world.occupancy(old, discount), k=k, discount=discount)
    return each.mean(0) if averaged else each[-1]


def policy_divergence(old: np.ndarray, new: np.ndarray) -> Any:
    """eps_pi: the total variation between two (states, actions) policies, or many of them, at the worst state."""
    return np.abs(old - new).sum(-1).max(-1) / 2.0


def divergences(transitions: Float[Array, "s a t"], model: Float[Array, "s a t"]) -> Float[Array, "s a"]:
    """Total variation of the next state; what a row lacks to one is the end, a state like others."""
    ended = transitions.sum(-1) - model.sum(-1)
    return (jnp.abs(transitions - model).sum(-1) + jnp.abs(ended)) / 2.0


def expected_error(
    transitions: Array, model: Array, initial: Array, policy: Float[Array, "s a"], steps: int = STEPS
) -> Float[Array, ""]:
    """max_t E_{s_t, a_t ~ policy, in the true world} of the divergence, over the first `steps` steps."""
    at = (policy * divergences(transitions, model)).sum(1)
    return (solve.marginals(transitions, initial, policy, steps) @ at).max()


_divergences = solve.exactly(divergences)
_expected_error = solve.exactly(expected_error, static=("steps",))


def model_error(world: MDP, model: MDP, policy: np.ndarray | None = None) -> float:
    """eps_m: the greatest expected total variation of the next state at any of the first `STEPS` steps of a policy.

    Without a policy, that of the worst state and action, which no policy exceeds.
    """
    if policy is None:
        return float(_divergences(world.transitions, model.transitions).max())
    return float(_expected_error(world.transitions, model.transitions, world.initial, policy, steps=STEPS))


def tight(model: float, policy: float, *, under: str = "old") -> tuple[MDP, np.ndarray, MDP, np.ndarray]:
    """World, old policy, model and new policy that meet the sharp bounds, to first order in the errors.

    A good state that pays 1 and a bad one that pays -1 for ever. The old policy always takes action 0, which leaves the good
    state with probability `model`; the model does not know. The new policy takes action 1 with probability `policy`; it pays -1
    and leads to the bad state. `under` says which policy the error is measured under: under the "old" one the model may be
    wrong about action 1 altogether, under the "new" one it is right about it.
    """
    flow = np.zeros((2, 2, 2))
    flow[0, 0], flow[0, 1], flow[1, :, 1] = [1.0 - model, model], [0.0, 1.0], 1.0
    wrong = flow.copy()
    wrong[0, 0] = [1.0, 0.0]
    if under == "old":
        wrong[0, 1] = [1.0, 0.0]
    rewards, first = np.array([[1.0, -1.0], [-1.0, -1.0]]), np.array([1.0, 0.0])
    acts = np.tile([1.0 - policy, policy], (2, 1))
    return MDP(flow, rewards, first), np.tile([1.0, 0.0], (2, 1)), MDP(wrong, rewards, first), acts


def _check(discount: Any, *errors: Any) -> None:
    if not np.all((np.asarray(discount) >= 0.0) & (np.asarray(discount) < 1.0)):
        raise UserError(f"discount must be in [0, 1), got {discount}")
    if not all(np.all((np.asarray(error) >= 0.0) & (np.asarray(error) <= 1.0 + 1e-9)) for error in errors):
        raise UserError(f"errors are total variations, 0 .. 1, got {' and '.join(str(error) for error in errors)}")
