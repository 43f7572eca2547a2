"""Branched rollouts: a few steps of a policy in a learned model, from states that were really seen (thesis 5.3)."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from deadreckon.data.step import Step
from deadreckon.dynamics.ensemble import Ensemble
from deadreckon.dynamics.model import Model
from deadreckon.randomness import keys

# Whether episodes end (n,) where these are observed (n, o): a task's `ends`.
Ends = Callable[[Array], Array]
BLOCK = 5000  # rows at a time on a CPU: what the networks make of them stays in its caches, and sorting them is quicker


class Branch(NamedTuple):
    """One step of every rollout.

    Attributes:
        observation, action, reward, next_observation, terminal: (n, ...) transitions.
        running: (n,) whether the rollout had not ended before, and the model gave numbers; else the row means nothing.
    """

    observation: Float[Array, "n o"]
    action: Float[Array, "n a"]
    reward: Float[Array, "n"]
    next_observation: Float[Array, "n o"]
    terminal: Bool[Array, "n"]
    running: Bool[Array, "n"]


def branches(
    model: Model, ensemble: Ensemble, policy: Any, starts: Float[Array, "n o"], length: int, key: PRNGKeyArray,
    ends: Ends | None = None,
) -> list[Branch]:  # fmt: skip
    """Rollouts of `length` steps from `starts`, every step of every rollout by an elite of its own.

    Args:
        model: what is learned.
        ensemble: what has been learned of what happens next.
        policy: what is done, in the coordinates of the model.
        starts: observations, dealt out to the elites anew at every step.
        length: steps.
        key: random key.
        ends: where episodes end; None asks the model.
    """
    found, observation, running = [], starts, jnp.ones(len(starts), bool)
    for t in range(length):
        branch = _step(model, ensemble, policy, ends, observation, running, jax.random.fold_in(key, t))
        found.append(branch)
        observation, running = branch.next_observation, branch.running & ~branch.terminal
    return found


def packed(found: Sequence[Branch]) -> Float[np.ndarray, "n w"]:
    """The steps that mean something, as rows of observation, action, reward, next observation and terminal."""
    return np.concatenate([
        np.concatenate([np.asarray(part, np.float32).reshape(len(branch.reward), -1) for part in branch[:5]], 1)[
            np.asarray(branch.running)
        ]
        for branch in found
    ])  # fmt: skip


@eqx.filter_jit
def _step(
    model: Model, ensemble: Ensemble, policy: Any, ends: Ends | None, observation: Array, running: Array, key: PRNGKeyArray
) -> Branch:
    n = len(observation)
    blocks = max(1, -(-n // BLOCK)) if jax.default_backend() == "cpu" else 1
    # Blocks are of one size; where they do not divide the rows, the first rows are done once more.
    rows = jax.tree.map(lambda x: jnp.resize(x, (blocks, -(-n // blocks), *x.shape[1:])), (observation, running))
    found = jax.lax.map(lambda part: _one(model, ensemble, policy, ends, *part), (*rows, jax.random.split(key, blocks)))
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:n], found)


def _one(
    model: Model, ensemble: Ensemble, policy: Any, ends: Ends | None, observation: Array, running: Array, key: PRNGKeyArray
) -> Branch:
    k_act, k_next = keys(key, "act", "next")
    n = len(observation)
    nothing = Step(observation, jnp.zeros(n), jnp.zeros(n, bool))
    action = policy.act(nothing, policy.start(n), k_act, greedy=False)[0]
    reward, following, over, lost = transition(model, ensemble, ends, observation, action, k_next)
    return Branch(observation, action, reward, following, over | lost, running & ~lost)


def transition(
    model: Model, ensemble: Ensemble, ends: Ends | None, observation: Float[Array, "n o"], action: Float[Array, "n a"],
    key: PRNGKeyArray,
) -> tuple[Float[Array, "n"], Float[Array, "n o"], Bool[Array, "n"], Bool[Array, "n"]]:  # fmt: skip
    """One transition per row from one elite: reward, next observation, whether the episode ends, whether it diverged."""
    k_order, k_draw, k_end, k_elites = keys(key, "order", "next", "end", "elites")
    n, elites = len(observation), len(ensemble.elites)
    # Rows are dealt to the elites in equal shares: a draw for each row would have every elite do all rows. Where they do
    # not divide, the first are done once more, for the last elites, of which a part is not used: these are others each time.
    share = -(-n // elites)
    params = ensemble.best(jax.random.permutation(k_elites, elites) if n % elites else None)
    order = jax.random.permutation(k_order, n)
    inputs = ensemble.standardise(jnp.concatenate([observation, action], -1))
    dealt = inputs[jnp.resize(order, (elites * share,))].reshape(elites, share, -1)
    drawn, logit = model.sample(params, dealt, k_draw)
    back = jnp.argsort(order)
    drawn, logit = drawn.reshape(elites * share, -1)[back], logit.reshape(-1)[back]
    following = observation + drawn[:, :-1]
    return drawn[:, -1], following, ended(ends, following, logit, k_end), ~jnp.isfinite(drawn).all(-1)


def ended(
    ends: Ends | None, following: Float[Array, "*b o"], logit: Float[Array, "*b"], key: PRNGKeyArray
) -> Bool[Array, "*b"]:
    """Whether episodes end where these are observed: as `ends` knows, or drawn from what the model says."""
    if ends is None:
        return jax.random.bernoulli(key, jax.nn.sigmoid(logit))
    return ends(following.reshape(-1, following.shape[-1])).reshape(logit.shape)
