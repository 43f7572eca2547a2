"""Experience that is simulated in a model: whole episodes of SLBO's policy, each used once."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PRNGKeyArray

from deadreckon.agents.slbo import SLBO
from deadreckon.data.step import Step
from deadreckon.dynamics import transition
from deadreckon.online.model_learning import ModelLearning
from deadreckon.online.on_policy import digested, learned_fields, observing
from deadreckon.randomness import generator, key_for, keys

STARTS = 256  # real initial states of simulated episodes, drawn again at every fit of the model
FAR = 100.0  # standard deviations from the mean of real observations at which simulated episodes are cut off


class ModelRollouts(ModelLearning):
    """Real steps, a model fitted to them, and the policy's latest steps in that model, as processed by `PPO.digest`."""

    revision: ClassVar[int] = 1
    _as_it_is = False

    def _begin(self, agent: Any) -> None:
        super()._begin(agent)
        self.agent: SLBO = agent
        self.fields = learned_fields(agent, self.columns)
        self._starts, self._turn = jnp.zeros((0, 0, 0)), -1

    @property
    def count(self) -> int:
        """See `Experience`."""
        return self.agent.rollouts * self.agent.rollout_length

    def extend(self, learner: Any, states: Any, roots: Key[Array, "l"], step: int) -> tuple[Any, dict[str, Array]]:
        """See `Experience`; real observations enter the standardisation as soon as they are collected."""
        self._collect(learner, states, roots, self.settings.explore)
        if self.environment_steps == self.settings.explore:
            states = observing(learner, states, self.last(self.settings.explore)["observation"])
        states, _ = super().extend(learner, states, roots, step)
        states = observing(learner, states, self.last(self.settings.block)["observation"])
        turn, _ = self.turn(step)
        if turn != self._turn:
            self._starts, self._turn = jnp.asarray(np.stack([self._begun(lane, turn) for lane in range(len(self.seeds))])), turn
        rows = _lived(learner, states, self._starts, roots, jnp.int32(step), self.agent.rollouts, self.agent.rollout_length)
        return digested(tuple(self.fields), learner, states, rows)

    def _begun(self, lane: int, turn: int) -> Float[np.ndarray, "n o"]:
        """Initial states of real episodes, drawn from those before the model was fitted."""
        steps = self.known(turn)
        rows = self.real(lane)[:steps]
        over = (rows[: steps - self.copies, -2:] > 0).any(1)  # terminal or timeout; a copy's next row is a start
        first = np.concatenate([np.arange(self.copies), np.flatnonzero(over) + self.copies])
        rng = generator(self.seeds[lane], "rollouts", turn)
        return rows[rng.choice(first, STARTS), : self.spec.observation_size]


@eqx.filter_jit
def _lived(
    learner: Any, states: Any, starts: Float[Array, "l s o"], roots: Key[Array, "l"], step: Array, rollouts: int, length: int
) -> dict[str, Array]:
    """Steps (lanes, length, rollouts, ...) of the policies in their models."""

    def one(agent: SLBO, state: Any, starts: Array, root: PRNGKeyArray) -> dict[str, Array]:
        policy, model, size = agent.policy(state), state.model, starts.shape[-1]
        k_first, k_steps = keys(key_for(root, "rollouts", step), "first", "steps")
        some = lambda k: starts[jax.random.randint(k, (rollouts,), 0, len(starts))]  # noqa: E731

        def ahead(seen: Array, t: Array) -> tuple[Array, dict[str, Array]]:
            k_act, k_next, k_new = keys(jax.random.fold_in(k_steps, t), "act", "next", "first")
            here = Step(seen, jnp.zeros(rollouts), jnp.zeros(rollouts, bool))
            action = policy.act(here, policy.start(rollouts), k_act, greedy=False)[0]
            reward, following, over, lost = transition(agent.model, model, agent.over, seen, action, k_next)
            # A step that is too far off keeps its state and has no reward, and the episode is cut off there.
            lost |= (jnp.abs(following - model.mean[:size]) > FAR * model.std[:size]).any(-1)
            following = jnp.where(lost[:, None], seen, following)
            row = {"observation": seen, "action": action, "reward": jnp.where(lost, 0.0, reward), "next_observation": following,
                   "terminal": 1.0 * (over & ~lost), "timeout": 1.0 * lost}  # fmt: skip
            return jnp.where((over | lost)[:, None], some(k_new), following), row

        return jax.lax.scan(ahead, some(k_first), jnp.arange(length))[1]

    return jax.vmap(one)(learner, states, starts, roots)
