"""Model-based value expansion (Feinberg et al. 2018) on top of SAC: targets after H steps in a model (thesis 5.4).

From a real transition, which is t = -1, the current policy continues for H steps in the model, and every step's Q is fitted to
what
comes after it:

    1/(H+1) sum_{t=-1}^{H-1} ( Q(s_t, a_t) - [ sum_{k=t}^{H-1} discount^(k-t) r_k + discount^(H-t) V'(s_H) ] )^2

The thesis prints discount^H and 1/H. With H = 0 it is SAC. As in SAC, values hold the entropy bonus of the actions to come.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from deadreckon.agents.agent import bellman_loss
from deadreckon.agents.model_based import ModelBasedSAC
from deadreckon.dynamics import transition
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import CountOrZero, static


class Expansion(NamedTuple):
    """Steps t = -1 .. H-1 of every row of a batch, the real one first, and their targets; weight 0 after an end."""

    observation: Float[Array, "t b o"]
    action: Float[Array, "t b a"]
    target: Float[Array, "t b"]
    weight: Float[Array, "t b"]


class MVE(ModelBasedSAC):
    """SAC whose critics learn from H-step targets in an ensemble."""

    revision: ClassVar[int] = 2

    horizon: CountOrZero = static(1)  # rollout horizon H in steps of the model; 0 is SAC

    def target(self, state, batch, key):
        """The batch's `Expansion`."""
        observations, actions = [batch.observation], [batch.action]
        rewards, goes_on, bonuses = [batch.reward], [1.0 - batch.terminal], []
        skipped = [jnp.zeros_like(batch.reward)]
        observation = batch.next_observation
        k_rollout, k_value = keys(key, "rollout", "value")
        for t in range(self.horizon):
            k_act, k_next = keys(jax.random.fold_in(k_rollout, t), "act", "next")
            action, bonus = self.act(state, observation, jax.random.normal(k_act, batch.action.shape))
            reward, following, over, lost = transition(self.model, state.model, self.over, observation, action, k_next)
            observations.append(observation)
            actions.append(action)
            # A step with NaN or infinite numbers does not count: the row stays where it was.
            skipped.append(1.0 * lost)
            rewards.append(jnp.where(lost, 0.0, reward))
            goes_on.append(1.0 - (over & ~lost))
            bonuses.append(bonus)
            observation = jnp.where(lost[:, None], observation, following)
        value = self.value(state, observation, jax.random.normal(k_value, batch.action.shape))
        targets = []
        for t in reversed(range(self.horizon + 1)):
            targets.append(rewards[t] + self.discount * goes_on[t] * value)
            value = jnp.where(skipped[t] > 0, value, targets[-1] + (bonuses[t - 1] if t else 0.0))
        weight = jnp.cumprod(jnp.stack([jnp.ones_like(batch.reward), *goes_on[:-1]]), 0) * (1.0 - jnp.stack(skipped))
        return Expansion(jnp.stack(observations), jnp.stack(actions), jnp.stack(targets[::-1]), weight)

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors of all critics at every step that there is, real or not."""
        steps = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), target)
        rows = batch._replace(observation=steps.observation, action=steps.action)
        return bellman_loss(critics, rows, steps.target, steps.weight / steps.weight.mean())
