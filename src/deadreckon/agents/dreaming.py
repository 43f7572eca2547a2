"""What offline agents with a learned model share: an ensemble fitted to the log, and rollouts in it by turns with updates.

Before the first update an ensemble is fitted to the log (`dynamics.Trainer`); then, and every `refresh` updates, rollouts of
the present policy branch off from logged states. A batch is a share of logged rows and a share of made-up ones, and the updates
are SAC's. The agents differ in how they keep from believing the model too much.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from deadreckon.agents.modelled import Modelled
from deadreckon.agents.sac import SAC, State
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.dynamics import Branch, Ensemble, branches, packed
from deadreckon.errors import DivergedError, UserError
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, static


class Dream(NamedTuple):
    """The model, made-up rows (slots, n, width) and how often rollouts have been made: `model` of SAC's state."""

    ensemble: Ensemble
    rows: Array
    turns: Array


class Dreaming(Modelled, SAC):
    """SAC on logged and made-up rows."""

    actor_lr: NonNegative = 1e-4  # learning rate of the actor
    temperature_lr: NonNegative = 1e-4  # learning rate of the log-temperature
    refresh: CountOrZero = static(1000)  # updates between rollouts
    length: Count = static(5)  # steps of a rollout
    rollouts: Count = static(50_000)  # begun each time
    keep: Count = static(5)  # times whose rollouts are learned from
    logged_rows: CountOrZero = static(13)  # of a batch are logged, 5 % of 256; the others are made up
    model_rows: Count | None = static(None)  # rows of the log that the model is fitted to, drawn at random; None: all

    def resolve(self, spec, steps):
        """Checks what belongs together."""
        if self.logged_rows >= self.batch_size:
            name = f"{type(self).__name__}.logged_rows"
            raise UserError(f"{name} must be fewer than a batch has, {self.batch_size}, got {self.logged_rows}")
        return super().resolve(spec, steps)

    def init(self, spec, key):
        """SAC's state, and room for what will be made up."""
        k_sac, k_model = jax.random.split(key)
        width = 2 * spec.observation_size + spec.action_size + 2
        rows = jnp.zeros((self.keep, self.rollouts * self.length, width), jnp.float32)
        return super().init(spec, k_sac)._replace(model=Dream(self.unfitted(spec, k_model), rows, jnp.int32(0)))

    def prepare(self, state, rows, key, fit):
        """Fits the model where that has not been done, and makes rollouts."""
        ensemble, slots, turns = state.model
        seed, turn = int(jax.random.bits(key, dtype=jnp.uint32)), int(turns)
        rng = np.random.default_rng([seed, 6])
        if turn == 0:
            drawn = rows.count if self.model_rows is None else min(self.model_rows, rows.count)
            columns = rows.take(np.sort(rng.permutation(rows.count)[:drawn]))
            ensemble, _ = self.trainer.fit(self.model, rows.spec, columns, seed)
        starts = rows.take(rng.integers(rows.count, size=self.rollouts))["observation"]
        found = branches(self.model, ensemble, self.policy(state), jnp.asarray(starts), self.length, key, self.over)
        made = packed(self.doubted(ensemble, found, rows))
        if not len(made):
            raise DivergedError("model: none of its rollouts has finite numbers; a lower model_lr may help")
        # Rollouts that ended early are made up for by others.
        made = made[np.resize(rng.permutation(len(made)), slots.shape[1])]
        return state._replace(model=Dream(ensemble, slots.at[turn % self.keep].set(made), jnp.int32(turn + 1)))

    def doubted(self, ensemble: Ensemble, found: list[Branch], rows: TransitionSource) -> list[Branch]:
        """What is learned of the steps of rollouts; as they are unless an agent says otherwise."""
        return found

    def update(self, state, batch, *, step, key):
        """SAC's update on logged rows and made-up ones."""
        k_rows, k_sac = jax.random.split(key)
        return super().update(state, self.mixed(state, batch, k_rows), step=step, key=k_sac)

    def mixed(self, state: State, batch: Batch, key: Array) -> Batch:
        """A batch whose first `logged_rows` rows are logged, and the others made up."""
        slots, n, width = state.model.rows.shape
        known = jnp.minimum(state.model.turns, slots) * n
        index = jax.random.randint(key, (self.batch_size - self.logged_rows,), 0, jnp.maximum(known, 1))
        drawn = state.model.rows.reshape(slots * n, width)[index]
        o, a = batch.observation.shape[-1], batch.action.shape[-1]
        observation, action, reward, following, terminal = jnp.split(drawn, np.cumsum([o, a, 1, o]), 1)
        made = observation, action, reward[:, 0], following, terminal[:, 0]
        names = "observation", "action", "reward", "next_observation", "terminal"
        logged = (getattr(batch, name)[: self.logged_rows] for name in names)
        return batch._replace(**{name: jnp.concatenate(both) for name, *both in zip(names, logged, made)})
