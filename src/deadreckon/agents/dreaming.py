"""What offline agents with a learned model share: an ensemble fitted to the log, and rollouts in it by turns with updates.

Before the first update an ensemble is fitted to the log (`dynamics.Trainer`); then, and every `refresh` updates, rollouts of
the present policy branch off from logged states. A batch is a share of logged rows and a share of made-up ones, and the updates
are SAC's. The agents differ in how they keep from believing the model too much.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from deadreckon.agents import sac
from deadreckon.agents.sac import SAC
from deadreckon.data.batch import Batch, Rows
from deadreckon.dynamics import Branch, Ensemble, Gaussian, Trainer, branches, packed
from deadreckon.dynamics.ensemble import check_sizes
from deadreckon.dynamics.rollout import Ends
from deadreckon.errors import DivergedError, UserError
from deadreckon.tasks.registry import of_log
from deadreckon.training.learner import static


class State(NamedTuple):
    """SAC's state, the model, made-up rows (slots, n, width) and how often rollouts have been made."""

    sac: sac.State
    ensemble: Ensemble
    rows: Array
    turns: Array


class Dreaming(SAC):
    """SAC on logged and made-up rows."""

    actor_lr: float = 1e-4  # learning rate of the actor
    temperature_lr: float = 1e-4  # learning rate of the log-temperature
    refresh: int = static(1000)  # updates between rollouts
    length: int = static(5)  # steps of a rollout
    rollouts: int = static(50_000)  # begun each time
    keep: int = static(5)  # times whose rollouts are learned from
    logged_rows: int = static(13)  # of a batch are logged, 5 % of 256; the others are made up
    members: int = static(7)  # networks of the model
    elites: int = static(5)  # of them are believed
    model_hidden: tuple[int, ...] = static((200, 200, 200, 200))  # width of each hidden layer of the model
    model_lr: float = 1e-3  # learning rate of the model
    model_decay: tuple[float, ...] = static((2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4))  # of half the squared weights, layer by layer
    model_rows: int | None = static(None)  # rows of the log that the model is fitted to, drawn at random; None: all
    model_epochs: int = static(1000)  # of its fit, at most
    ends: Literal["known", "learned"] = static("known")  # where a known log's task tells when episodes end; else it is learned

    def resolve(self, spec, steps):
        """Checks what belongs together."""
        if self.logged_rows >= self.batch_size:
            name = f"{type(self).__name__}.logged_rows"
            raise UserError(f"{name} must be fewer than a batch has, {self.batch_size}, got {self.logged_rows}")
        check_sizes(type(self).__name__, self.members, self.elites, self.model_hidden, self.model_decay)
        return super().resolve(spec, steps)

    @property
    def model(self) -> Gaussian:
        """What the ensemble consists of."""
        return Gaussian(self.members, self.model_hidden, self.model_lr, 0.0, layer_decay=self.model_decay)

    @property
    def _made_up(self) -> int:
        """Rollouts each time, as many for each elite."""
        return -(-self.rollouts // self.elites) * self.elites

    def init(self, spec, key):
        """SAC's state, and room for what will be made up."""
        k_sac, k_model = jax.random.split(key)
        unfitted = Ensemble.unfitted(self.model, spec, self.elites, k_model)
        width = 2 * spec.observation_size + spec.action_size + 2
        rows = jnp.zeros((self.keep, self._made_up * self.length, width), jnp.float32)
        return State(super().init(spec, k_sac), unfitted, rows, jnp.int32(0))

    def prepare(self, state, rows, key, fit):
        """Fits the model where that has not been done, and makes rollouts."""
        seed, turn = int(jax.random.bits(key, dtype=jnp.uint32)), int(state.turns)
        rng = np.random.default_rng([seed, 6])
        ensemble = state.ensemble
        if turn == 0:
            drawn = rows.count if self.model_rows is None else min(self.model_rows, rows.count)
            columns = rows.take(np.sort(rng.permutation(rows.count)[:drawn]))
            trainer = Trainer(elites=self.elites, most_epochs=self.model_epochs)
            ensemble, _ = trainer.fit(self.model, rows.spec, columns, seed)
        starts = rows.take(rng.integers(rows.count, size=self._made_up))["observation"]
        policy, known = SAC.policy(self, state.sac), _ends(rows.log.name) if self.ends == "known" else None
        found = branches(self.model, ensemble, policy, jnp.asarray(starts), self.length, key, known)
        made = packed(self.doubted(ensemble, found, rows))
        if not len(made):
            raise DivergedError("model: none of its rollouts has finite numbers; a lower model_lr may help")
        # Rollouts that ended early are made up for by others.
        made = made[np.resize(rng.permutation(len(made)), state.rows.shape[1])]
        return state._replace(ensemble=ensemble, rows=state.rows.at[turn % self.keep].set(made), turns=jnp.int32(turn + 1))

    def doubted(self, ensemble: Ensemble, found: list[Branch], rows: Rows) -> list[Branch]:
        """What is learned of the steps of rollouts; as they are unless an agent says otherwise."""
        return found

    def update(self, state, batch, *, step, key):
        """SAC's update on logged rows and made-up ones."""
        k_rows, k_sac = jax.random.split(key)
        mixed = self.mixed(state, batch, k_rows)
        new, metrics = super().update(state.sac, mixed, step=step, key=k_sac)
        return state._replace(sac=new), metrics

    def mixed(self, state: State, batch: Batch, key: Array) -> Batch:
        """A batch whose first `logged_rows` rows are logged, and the others made up."""
        slots, n, width = state.rows.shape
        known = jnp.minimum(state.turns, slots) * n
        index = jax.random.randint(key, (self.batch_size - self.logged_rows,), 0, jnp.maximum(known, 1))
        drawn = state.rows.reshape(slots * n, width)[index]
        o, a = batch.observation.shape[-1], batch.action.shape[-1]
        observation, action, reward, following, terminal = jnp.split(drawn, np.cumsum([o, a, 1, o]), 1)
        made = observation, action, reward[:, 0], following, terminal[:, 0]
        names = "observation", "action", "reward", "next_observation", "terminal"
        logged = (getattr(batch, name)[: self.logged_rows] for name in names)
        return batch._replace(**{name: jnp.concatenate(both) for name, *both in zip(names, logged, made)})

    def policy(self, state):
        """SAC's."""
        return super().policy(state.sac)

    def q_value(self, state, observation, action):
        """SAC's."""
        return super().q_value(state.sac, observation, action)


def _ends(log: str) -> Ends | None:
    """Of a known log's task, where observations tell; None leaves it to the model."""
    task = of_log(log)
    return None if task is None else task.ends
