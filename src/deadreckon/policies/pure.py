"""Policies as pure functions of arrays, which other runtimes can hold: greedy actions without keys and without a carry."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from deadreckon.data.history import history_size
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.policies.candidates import GreedyActions
from deadreckon.policies.deployed import EnvPolicy, History, Mixture, Seeing
from deadreckon.policies.kinds import Categorical
from deadreckon.policies.planner import Planner
from deadreckon.policies.sequence import DecisionTransformerPolicy

MEMBER = "member"
# Kinds that no format but the package's own can hold, and why.
REFUSED = {
    Planner: "plan by random draws in a learned model at every step",
    DecisionTransformerPolicy: "keep returns, observations and actions of earlier steps",
}


class Pure(NamedTuple):
    """A policy's greedy actions as a function of arrays.

    Attributes:
        call: gets (n, *shape) float32 observations and, of a mixture, (n,) int32 numbers of the members that act; gives
            actions, (n, size) float32 in the environment's bounds or (n,) int32 of discrete ones, and behind them, of a policy
            that chooses by probabilities, these (n, actions).
        inputs: their names: "observation", and of a mixture "member".
        outputs: their names: "action", and where there are some "probabilities".
        members: of a mixture; 1 of others.
        history: observations that one input holds, as `data.history` has them; 1: none of earlier steps.
    """

    call: Callable[..., tuple[Array, ...]]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    members: int
    history: int


def pure(policy: EnvPolicy) -> Pure:
    """A policy of an agent as a pure function.

    Raises:
        UserError: the policy needs more than its observations: one line that says what.
    """
    inner = policy.inner
    for kind, why in REFUSED.items():
        if isinstance(inner, kind):
            raise UserError(f"policies of the kind {kind.__name__} {why}: they cannot be exported; use them with the package")
    if isinstance(inner, History):
        return pure(inner.member)._replace(history=inner.steps)
    if isinstance(inner, Seeing):
        behind = pure(inner.member)
        return behind._replace(call=lambda pictures: behind.call(inner.encoder(pictures)))
    if isinstance(inner, Mixture):
        parts = [pure(member) for member in inner.members]
        if any(part.members > 1 for part in parts):
            raise UserError("a mixture of mixtures cannot be exported; export its members")

        def mixed(observation: Array, member: Array) -> tuple[Array, ...]:
            every = [part.call(observation) for part in parts]
            found = []
            for outputs in zip(*every):
                chosen = outputs[0]
                for i, output in enumerate(outputs[1:], 1):
                    is_it = (member == i).reshape(-1, *[1] * (output.ndim - 1))
                    chosen = jnp.where(is_it, output, chosen)
                found.append(chosen)
            return tuple(found)

        return Pure(mixed, ("observation", MEMBER), parts[0].outputs, len(parts), max(part.history for part in parts))
    chances = isinstance(inner, Categorical)

    def call(observation: Array) -> tuple[Array, ...]:
        n = observation.shape[0]
        if isinstance(inner, Categorical | GreedyActions):
            seen = policy.view.observe(observation)
            scores = inner.net(seen) if isinstance(inner, Categorical) else inner.values(seen)
            action = scores.argmax(-1).astype(jnp.int32)
            return (action, jax.nn.softmax(scores)) if chances else (action,)
        step = Step(observation, jnp.zeros(n), jnp.ones(n, bool))
        return (policy.act(step, (), jax.random.key(0), greedy=True)[0],)

    return Pure(call, ("observation",), ("action", "probabilities") if chances else ("action",), 1, 1)


def input_size(policy: EnvPolicy, size: int) -> int:
    """Numbers in one observation as `pure` takes it, of a policy whose world shows `size` numbers at a step."""
    inner = policy.inner
    if isinstance(inner, Mixture):
        return max(input_size(member, size) for member in inner.members)
    return history_size(inner.observation_size, inner.action_size, inner.steps) if isinstance(inner, History) else size
