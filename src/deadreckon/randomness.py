"""Random keys and generators, told apart by what they are for.

One seed serves many purposes: networks are drawn from it, then batches, then noise. Each purpose has a name, and its key is
the first key folded with a number that follows from the name alone, so that a purpose which is added or taken away leaves the
draws of all others as they were. What is counted (a step, a member) is folded into a key that has its purpose already.

`jax.random.split` is for things that are alike (members of an ensemble, rows, blocks), on a key with a purpose of its own. A
key that is split is not folded too: `fold_in(key, i)` and `split(key, n)[i]` are the same key.
"""

import functools
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from deadreckon.errors import UserError

if TYPE_CHECKING:
    from jaxtyping import PRNGKeyArray

# Purposes that had these numbers before they had names. Collected logs that are trainings (medium-replay of SAC, the clones of
# Adroit) and the policies of the package follow from them bit for bit, so they stay. A purpose that is new is not put here.
NUMBERS = {
    "init": 0, "rows": 1, "update": 2, "prepare": 3, "initial_states": 4, "act": 5,  # of a run's seed
    "actor": 0, "critics": 1,  # of the key of an agent's `init`
    "target": 0, "actor_loss": 1,  # of the key of an agent's `update`
}  # fmt: skip


def check_seed(seed: int) -> None:
    """Refuses seeds out of range.

    Raises:
        UserError: it is negative or too large.
    """
    if not 0 <= seed < 2**32:
        raise UserError(f"seed must be 0 .. 2^32 - 1, got {seed}")


def number(purpose: str) -> int:
    """What stands for a purpose, 0 .. 2^32 - 1: the CRC-32 of its name, but for those of `NUMBERS`."""
    return NUMBERS.get(purpose, zlib.crc32(purpose.encode()))


def keys(key: "PRNGKeyArray", *purposes: str) -> tuple["PRNGKeyArray", ...]:
    """One key for each purpose, in their order.

    Args:
        key: that is used for nothing else.
        purposes: names; a key does not depend on the other names.

    Raises:
        ValueError: two purposes have the same name, or the same number.
    """
    import jax

    numbers = [number(purpose) for purpose in purposes]
    if len(set(numbers)) < len(numbers):
        raise ValueError(f"purposes of a key must differ, and so must their numbers, got {', '.join(purposes)}")
    # All at once, which compiles faster than one after the other.
    return tuple(jax.vmap(jax.random.fold_in, (None, 0))(key, np.array(numbers, np.uint32)))


def key_for(key: "PRNGKeyArray", purpose: str, *counters: Any) -> "PRNGKeyArray":
    """The key for one purpose, and of what is counted within it.

    Args:
        key: that is used for nothing else.
        purpose: name.
        counters: whole numbers, such as the step; of one purpose always equally many.
    """
    import jax

    return functools.reduce(jax.random.fold_in, counters, jax.random.fold_in(key, np.uint32(number(purpose))))


def sequence(seed: int, purpose: str, *counters: int) -> np.random.SeedSequence:
    """The counterpart of `key_for` on the host.

    Args:
        seed: random seed, 0 .. 2^32 - 1.
        purpose: name.
        counters: whole numbers, such as the turn; of one purpose always equally many.
    """
    return np.random.SeedSequence([seed, number(purpose), *counters])


def generator(seed: int, purpose: str, *counters: int) -> np.random.Generator:
    """A generator for one purpose; see `sequence`."""
    return np.random.default_rng(sequence(seed, purpose, *counters))
