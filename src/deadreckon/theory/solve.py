"""Exact solutions of finite worlds: pure JAX functions of one world's arrays, which `exactly` runs for one world or thousands.

Rows of `transitions` (s, a, s) may lack to one: the rest is the probability of the end. `rewards` (s, a) are means, `initial`
(s,) and a policy (s, a) are probabilities.
"""

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

BETTER = 1e-11  # an action is better than the present one by more than this, relative to the values: rounding is less


def exactly(function: Callable, *, over: Sequence[int | None] | None = None, static: Sequence[str] = ()) -> Callable[..., Any]:
    """A compiled function in double precision, numpy in and numpy out.

    JAX computes in single precision unless told otherwise, which bounds that hold with equality do not survive.

    Args:
        function: of arrays, pure.
        over: for each argument the axis of many worlds, or None for one that all share; None: a single world.
        static: names of arguments that are part of the program.
    """
    compiled = jax.jit(function if over is None else jax.vmap(function, in_axes=tuple(over)), static_argnames=tuple(static))

    @wraps(function)
    def run(*arguments: Any, **named: Any) -> Any:
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, compiled(*arguments, **named))

    return run


def linear(flow: Float[Array, "s s"], right: Float[Array, "s"]) -> Float[Array, "s"]:
    """The x with (I - flow) x = right, by elimination without pivots.

    None are needed: where rows or columns of `flow` are not negative and sum to less than one, I - flow is diagonally dominant,
    and stays so. Of LAPACK's batched solver two calls in one program may wait for each other for ever on few cores.
    """
    count = len(right)

    def eliminate(i: Array, rows: Float[Array, "s n"]) -> Float[Array, "s n"]:
        pivot = rows[i] / rows[i, i]
        return (rows - rows[:, i, None] * pivot).at[i].set(pivot)

    rows = jnp.concatenate([jnp.eye(count, dtype=right.dtype) - flow, right[:, None]], 1)
    return jax.lax.fori_loop(0, count, eliminate, rows)[:, -1]


def moves(transitions: Float[Array, "s a t"], policy: Float[Array, "s a"]) -> Float[Array, "s t"]:
    """P^pi: from state to state, under a policy."""
    return jnp.einsum("sat,sa->st", transitions, policy)


def values(
    transitions: Float[Array, "s a t"], rewards: Float[Array, "s a"], policy: Float[Array, "s a"], discount: Any
) -> Float[Array, "s"]:
    """V^pi = (I - discount P^pi)^-1 r^pi."""
    return linear(discount * moves(transitions, policy), (policy * rewards).sum(1))


def ahead(
    transitions: Float[Array, "s a t"], rewards: Float[Array, "s a"], after: Float[Array, "t"], discount: Any
) -> Float[Array, "s a"]:
    """r + discount E[after(s')]: a backup of values of states, with the discount that the thesis's chapter 2 leaves out."""
    return rewards + discount * transitions @ after


def action_values(
    transitions: Float[Array, "s a t"], rewards: Float[Array, "s a"], policy: Float[Array, "s a"], discount: Any
) -> Float[Array, "s a"]:
    """Q^pi."""
    return ahead(transitions, rewards, values(transitions, rewards, policy, discount), discount)


def occupancy(
    transitions: Float[Array, "s a t"], initial: Float[Array, "s"], policy: Float[Array, "s a"], discount: Any
) -> Float[Array, "s a"]:
    """(1 - discount) sum_t discount^t P(s_t, a_t); it sums to one where no episode ends."""
    return linear(discount * moves(transitions, policy).T, (1.0 - discount) * initial)[:, None] * policy


def policy_iteration(transitions: Float[Array, "s a t"], rewards: Float[Array, "s a"], discount: Any) -> Float[Array, "s a"]:
    """Q*, to rounding: each policy is solved exactly, and the next one is greedy where that is better."""

    def solved(policy: Int[Array, "s"]) -> Array:
        return action_values(transitions, rewards, jax.nn.one_hot(policy, rewards.shape[1], dtype=rewards.dtype), discount)

    def improve(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        policy, q, _ = carry
        own = jnp.take_along_axis(q, policy[:, None], 1)[:, 0]
        better = q.max(1) > own + BETTER * (1.0 + jnp.abs(own))  # equal actions would be exchanged without end
        policy = jnp.where(better, q.argmax(1), policy)
        return policy, solved(policy), better.any()

    first = rewards.argmax(1)
    return jax.lax.while_loop(lambda carry: carry[2], improve, (first, solved(first), jnp.asarray(True)))[1]


def marginals(
    transitions: Float[Array, "s a t"], initial: Float[Array, "s"], policy: Float[Array, "s a"], steps: int
) -> Float[Array, "n s"]:
    """P(s_t) for t = 0 .. steps - 1."""
    flow = moves(transitions, policy)
    return jax.lax.scan(lambda now, _: (now @ flow, now), initial, None, length=steps)[1]


def visits(
    transitions: Float[Array, "s a t"], initial: Float[Array, "s"], policy: Float[Array, "s a"], steps: Any
) -> Float[Array, "s a"]:
    """Expected number of visits in the first `steps` steps."""
    flow = moves(transitions, policy)
    step = lambda _, carry: (carry[0] @ flow, carry[1] + carry[0])  # noqa: E731
    return jax.lax.fori_loop(0, steps, step, (initial, jnp.zeros_like(initial)))[1][:, None] * policy
