"""Policies that act on the last steps of an episode are evaluated on a log of histories, as memoryless policies."""

from collections.abc import Sequence
from typing import Any

from deadreckon.data.dataset import Dataset
from deadreckon.data.history import history_size, stacked
from deadreckon.errors import UserError
from deadreckon.policies.deployed import EnvPolicy, History, history_of


def with_histories(log: Dataset, policies: Sequence[Any]) -> tuple[Dataset, list[slice] | None]:
    """The log on which policies are evaluated, with histories of the greatest length that any of them needs.

    Args:
        log: as it was recorded.
        policies: of any kind.

    Returns:
        The log, and for each policy the slice at the end of an observation that it acts on; None: all of it.

    Raises:
        UserError: the log has no histories, or they have other sizes or bounds than those that a policy was trained on.
    """
    # Other policies with a memory, such as mixtures, are refused by `tables.Actor`.
    found = [p.inner if isinstance(p, EnvPolicy) and isinstance(p.inner, History) else None for p in policies]
    own = [inner for inner in found if inner is not None]
    if not own:
        return log, None
    spec = log.spec
    for inner in own:
        given = inner.observation_size, inner.action_size, inner.member.low is None
        if given != (spec.observation_size, spec.action_size, spec.discrete):
            raise UserError(
                f"a policy acts on histories of observations of {given[0]} numbers and actions of size {given[1]}, "
                f"{log.name} has {spec.observation_size} and {spec.action_size}"
            )
        if _bounds(inner) != _bounds(own[0]):
            raise UserError("policies with histories have different bounds of actions; evaluate them one by one")
    steps = [history_of(p) if inner is not None else 1 for p, inner in zip(policies, found)]
    sizes = [history_size(spec.observation_size, spec.action_size, k) for k in steps]
    return stacked(log, max(steps), own[0].member.view), [slice(max(sizes) - size, max(sizes)) for size in sizes]


def _bounds(policy: History) -> tuple[float, ...]:
    """Bounds by which the actions in its histories are scaled; empty for discrete ones."""
    low, high = policy.member.low, policy.member.high
    return () if low is None or high is None else (*map(float, low), *map(float, high))
