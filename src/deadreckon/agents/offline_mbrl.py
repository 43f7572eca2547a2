"""What offline agents with a learned model share: an ensemble fitted to the log, and rollouts in it by turns with updates.

Before the first update an ensemble is fitted to the log (`dynamics.Trainer`); then, and every `refresh` updates, rollouts of
the present policy branch off from logged states. A batch is a share of logged rows and a share of made-up ones, and the updates
are SAC's. The agents differ in how they keep from believing the model too much.
"""

import math
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from deadreckon.agents.model_based import ModelBasedAgent
from deadreckon.agents.sac import SAC, State
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.dynamics import Branch, Ensemble, branches, packed
from deadreckon.dynamics.ensemble import FEWEST
from deadreckon.errors import DivergedError, UserError
from deadreckon.nets.optim import cosine_decay
from deadreckon.randomness import generator, keys
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, static


class ModelBuffer(NamedTuple):
    """The model, made-up rows (slots, n, width) and how often rollouts have been made: `model` of SAC's state."""

    ensemble: Ensemble
    rows: Array
    turns: Array


class OfflineMBRL(ModelBasedAgent, SAC):
    """SAC on logged and made-up rows."""

    revision: ClassVar[int] = 2
    supports_discrete: ClassVar[bool] = False
    largest_temperature: ClassVar[float] = math.inf
    online: ClassVar[bool] = False
    by_length: ClassVar[tuple[str, ...]] = ("actor_decay_steps",)
    other_names: ClassVar[dict[str, str]] = {
        "length": "rollout_length", "rollouts": "rollout_batch_size", "keep": "retain_rounds",
        "logged_rows": "real_batch_size",
    }  # fmt: skip

    actor_lr: NonNegative = 1e-4  # learning rate of the actor
    actor_decay_steps: NonNegative | None = None
    """updates over which the learning rate of the actor falls to 0 along a cosine; None: the whole run, 0: it stays"""
    temperature_lr: NonNegative = 1e-4  # learning rate of the logarithm of the entropy temperature
    refresh: CountOrZero = static(1000)  # updates between rounds of model rollouts
    rollout_length: Count = static(5)  # steps of a model rollout
    rollout_batch_size: Count = static(50_000)  # rollouts per round
    retain_rounds: Count = static(5)  # rounds whose rollouts are kept
    real_batch_size: CountOrZero = static(12)
    """logged transitions in a batch (12 of 256 are 5 %, as in OfflineRL-Kit); the others come from the model"""
    model_rows: Count | None = static(None)  # transitions drawn from the log to fit the model; None: all

    def resolve(self, spec, steps):
        """Checks what belongs together."""
        agent = super().resolve(spec, steps)
        if self.real_batch_size >= self.batch_size:
            name = f"{type(self).__name__}.real_batch_size"
            raise UserError(f"{name} must be fewer than a batch has, {self.batch_size}, got {self.real_batch_size}")
        rows = spec.rows if self.model_rows is None else min(self.model_rows, spec.rows)
        if spec.rows and rows < FEWEST:
            what = f"the model of {type(self).__name__} needs {FEWEST} or more transitions"
            asked = "" if self.model_rows is None else f", and model_rows is {self.model_rows}"
            raise UserError(f"{what}; {spec.name} has {spec.rows}{asked}")
        return agent if self.actor_decay_steps is not None else agent.replace(actor_decay_steps=float(steps))

    def actor_rate(self, step: Array) -> Any:
        """Learning rate of the actor at an update, along a cosine (OfflineRL-Kit)."""
        return cosine_decay(self.actor_lr, step, self.actor_decay_steps)

    def update_temperature(self, state, log_prob):
        """SAC's, with the agent's largest temperature at most."""
        state = super().update_temperature(state, log_prob)
        return state._replace(log_temperature=jnp.minimum(state.log_temperature, math.log(self.largest_temperature)))

    def init(self, spec, key):
        """SAC's state, and room for what will be made up."""
        k_sac, k_model = keys(key, "sac", "model")
        width = 2 * spec.observation_size + spec.action_size + 2
        rows = jnp.zeros((self.retain_rounds, self.rollout_batch_size * self.rollout_length, width), jnp.float32)
        return super().init(spec, k_sac)._replace(model=ModelBuffer(self.unfitted(spec, k_model), rows, jnp.int32(0)))

    def prepare(self, state, rows, key, fit):
        """Fits the model where that has not been done, and makes rollouts."""
        ensemble, slots, turns = state.model
        k_seed, k_rollouts = keys(key, "seed", "rollouts")
        seed, turn = int(jax.random.bits(k_seed, dtype=jnp.uint32)), int(turns)
        rng = generator(seed, "rollouts")
        if turn == 0:
            drawn = rows.count if self.model_rows is None else min(self.model_rows, rows.count)
            columns = rows.take(np.sort(rng.permutation(rows.count)[:drawn]))
            ensemble, _ = self.trainer.fit(self.model, rows.spec, columns, seed)
        starts = rows.take(rng.integers(rows.count, size=self.rollout_batch_size))["observation"]
        policy, length = self.policy(state), self.rollout_length
        found = branches(self.model, ensemble, policy, jnp.asarray(starts), length, k_rollouts, self.over)
        made = packed(self.penalised(ensemble, found, rows))
        if not len(made):
            raise DivergedError("model: none of its rollouts has finite numbers; a lower model_lr may help")
        # Rollouts that ended early are made up for by others.
        made = made[np.resize(rng.permutation(len(made)), slots.shape[1])]
        return state._replace(model=ModelBuffer(ensemble, slots.at[turn % self.retain_rounds].set(made), jnp.int32(turn + 1)))

    def penalised(self, ensemble: Ensemble, found: list[Branch], rows: TransitionSource) -> list[Branch]:
        """What is learned of the steps of rollouts; as they are unless an agent says otherwise."""
        return found

    def update(self, state, batch, *, step, key):
        """SAC's update on logged rows and made-up ones."""
        k_rows, k_sac = keys(key, "mixed", "sac")
        return super().update(state, self.mixed(state, batch, k_rows), step=step, key=k_sac)

    def mixed(self, state: State, batch: Batch, key: Array) -> Batch:
        """A batch whose first `real_batch_size` rows are logged, and the others made up."""
        slots, n, width = state.model.rows.shape
        known = jnp.minimum(state.model.turns, slots) * n
        index = jax.random.randint(key, (self.batch_size - self.real_batch_size,), 0, jnp.maximum(known, 1))
        drawn = state.model.rows.reshape(slots * n, width)[index]
        o, a = batch.observation.shape[-1], batch.action.shape[-1]
        observation, action, reward, following, terminal = jnp.split(drawn, np.cumsum([o, a, 1, o]), 1)
        made = observation, action, reward[:, 0], following, terminal[:, 0]
        names = "observation", "action", "reward", "next_observation", "terminal"
        logged = (getattr(batch, name)[: self.real_batch_size] for name in names)
        both: dict[str, Any] = {name: jnp.concatenate(parts) for name, *parts in zip(names, logged, made)}
        return batch._replace(**both)
