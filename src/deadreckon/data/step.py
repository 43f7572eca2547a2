"""What a policy sees before it acts."""

from typing import Any, NamedTuple


class Step(NamedTuple):
    """What a policy sees of `n` environments: observations (n, *shape), last rewards (n,), whether an episode begins (n,)."""

    observation: Any
    reward: Any
    first: Any
