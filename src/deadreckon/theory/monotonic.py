"""Algorithm 2 on finite worlds: collect, fit a model, maximise its promise MINUS C(eps_m, eps_pi); the minus is not printed.

The penalty depends on a policy only through eps_pi, its total variation from the old one at the worst state. So for each
of 101 radii the best policy within it is found exactly: it solves a constrained decision problem (a ball around the old policy
in every state, in which the best policy moves mass from the worst actions to the best).

**With the printed C nothing ever moves.** Lemma B.2.3, inside the model, bounds what a policy eps_pi away can gain there by
2 r_max eps_pi (discount / (1 - discount)² + 1 / (1 - discount)); C(eps_m, eps_pi) grows by twice that. Any other policy
scores less than the old one, in every world. The sharper C grows by 2 r_max eps_pi discount / (1 - discount)² only, and
leaves room: most of it where the discount is small.

**The maximum alone is no promise of improvement**: the new policy is worth at least its score, but the old one may be worth
up to 2 C(eps_m, 0) more than its own. `keep` takes the new policy only if its score is above the old one's measured return.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from deadreckon.theory import solve
from deadreckon.theory.branching import model_error, policy_divergence
from deadreckon.theory.tabular import MDP

LEFT = 1e-10  # of the first values after so many sweeps of value iteration within a ball
RADII = np.linspace(0.0, 1.0, 101)


def within(q: Float[Array, "s a"], old: Float[Array, "s a"], radius: Any) -> Float[Array, "s a"]:
    """The policy with the largest E_π q in every state among those within a total variation of `radius` of the old one."""
    order = q.argsort(1)
    mass = jnp.take_along_axis(old, order, 1)
    before = mass.cumsum(1) - mass  # of worse actions
    left = mass - jnp.clip(radius - before, 0.0, mass)
    left = left.at[:, -1].set(mass[:, -1])
    left = left.at[:, -1].add(1.0 - left.sum(1))
    return jnp.take_along_axis(left, order.argsort(1), 1)


def best_within(transitions: Array, rewards: Array, old: Array, radius: Any, discount: Any) -> Float[Array, "s a"]:
    """The best of them in a world."""

    def sweep(_: Any, after: Array) -> Array:
        q = solve.ahead(transitions, rewards, after, discount)
        return (within(q, old, radius) * q).sum(1)

    sweeps = jnp.ceil(jnp.log(LEFT) / jnp.log(jnp.clip(discount, 1e-3, 1.0 - 1e-6))).astype(int)
    after = jax.lax.fori_loop(0, sweeps, sweep, jnp.zeros(len(rewards), rewards.dtype))
    return within(solve.ahead(transitions, rewards, after, discount), old, radius)


def _candidates(transitions, rewards, initial, old, radii, discount):
    """(n, s, a) best policies by radius, and what the world promises of them (n,)."""

    def one(radius):
        policy = best_within(transitions, rewards, old, radius, discount)
        return policy, initial @ solve.values(transitions, rewards, policy, discount)

    return jax.vmap(one)(radii)


_best = solve.exactly(_candidates)


@dataclass(frozen=True)
class Course:
    """What happened.

    Attributes:
        returns: (epochs + 1,) true returns of the policies, the first one included.
        distances: (epochs,) eps_pi of each step.
        errors: (epochs,) eps_m, under the policy that collected, in the true world.
        scores: (epochs,) what was maximised.
    """

    returns: np.ndarray
    distances: np.ndarray
    errors: np.ndarray
    scores: np.ndarray


def improve(
    world: MDP, discount: float, penalty: Callable[[Any, Any, float, float], Any] | None, *, epochs: int = 8, rows: int = 200,
    keep: bool = False, seed: int = 0,
) -> Course:  # fmt: skip
    """Algorithm 2 from the even policy.

    Args:
        world: without an end.
        discount: per step.
        penalty: C(eps_m, eps_pi, discount, r_max), such as `branching.full_bound`; None: none.
        epochs: turns of collecting and improving.
        rows: transitions collected a turn, from the policy's occupancy. The model is their maximum likelihood; where there are
            none it says that nothing moves. Rewards are known.
        keep: take a policy only if its score is above the old one's return.
        seed: of what is collected.
    """
    rng, r_max = np.random.default_rng(seed), float(np.abs(world.rewards).max())
    policy = np.full(world.rewards.shape, 1.0 / world.actions)
    counts = np.zeros(world.transitions.shape)
    returns, distances, errors, scores = [world.value(policy, discount)], [], [], []
    for _ in range(epochs):
        joint = world.occupancy(policy, discount)[:, :, None] * world.transitions
        counts += rng.multinomial(rows, (joint / joint.sum()).reshape(-1)).reshape(counts.shape)
        seen = counts.sum(2, keepdims=True)
        stay = np.broadcast_to(np.eye(world.states)[:, None], counts.shape)
        model = MDP(np.where(seen > 0, counts / np.maximum(seen, 1), stay), world.rewards, world.initial)
        error = min(model_error(world, model, policy), 1.0)
        found, estimated = _best(model.transitions, world.rewards, world.initial, policy, RADII, discount)
        far = np.minimum(policy_divergence(policy[None], found), 1.0)
        score = estimated if penalty is None else estimated - penalty(error, far, discount, r_max)
        which = int(score.argmax())
        if not keep or score[which] > returns[-1]:
            distances.append(float(far[which]))
            policy = found[which]
        else:
            distances.append(0.0)
        errors.append(error)
        scores.append(float(score[which]))
        returns.append(world.value(policy, discount))
    return Course(*map(np.array, (returns, distances, errors, scores)))
