"""Experience of agents with a learned model: real steps, and an ensemble that is fitted to them repeatedly."""

import zlib
from collections.abc import Iterator
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from deadreckon.agents.model_based import OnlineModelBasedAgent
from deadreckon.dynamics import Report
from deadreckon.dynamics.ensemble import FEWEST
from deadreckon.errors import DivergedError, UserError
from deadreckon.online.exploration import Exploration
from deadreckon.online.rows import unpacked
from deadreckon.training.learner import unstack


class ModelLearning(Exploration):
    """Fits the ensembles in the agents' states every `model_train_freq` real steps, to all real rows, from the last fit on.

    Raises:
        UserError: as `Exploration`; too few random steps for a fit; `model_train_freq` that is no multiple of `block`; or the
            name of another task.
    """

    revision: ClassVar[int] = 1
    _sums = False

    def _begin(self, agent: OnlineModelBasedAgent) -> None:
        block = self.settings.block
        if self.settings.explore < FEWEST:
            raise UserError(
                f"explore, the number of random environment steps that the model is first fitted to, must be {FEWEST} or more, "
                f"got {self.settings.explore}"
            )
        if agent.model_train_freq % block:
            raise UserError(
                f"model_train_freq, the number of environment steps between two fits of the model, must be a multiple of block "
                f"({block} environment steps between two blocks of updates), got {agent.model_train_freq}"
            )
        if agent.termination == self.task.name and agent.over != self.task.ends:
            raise UserError(f"{self.task.name} is the name of another task; register this one under a name of its own")
        self._turns = agent.model_train_freq // block  # blocks between fits
        self.metrics = {name: np.full(len(self.seeds), np.nan) for name in ("model_error", "model_epochs")}

    def extend(self, learner: Any, states: Any, roots: Key[Array, "lanes"], step: int) -> tuple[Any, dict[str, Array]]:
        """See `Experience`; a model that is due is fitted before the policies act, because some of them plan with it."""
        self._collect(learner, states, roots, self.settings.explore)
        turn, rest = self.turn(step)
        if rest == 0:
            states = self._fitted(learner, states, turn)
        return super().extend(learner, states, roots, step)

    def _fitted(self, learner: Any, states: Any, turn: int) -> Any:
        """The states with their ensembles fitted to all real rows."""
        ensembles, reports = [], []
        for lane, (agent, state) in enumerate(self._apart(learner, states)):
            real, start = unpacked(self.real(lane), self.columns), state.model if turn else None
            try:
                ensemble, report = agent.trainer.fit(agent.model, self.spec, real, self._mixed(lane, turn), start)
            except DivergedError:  # NaN in its state marks the lane as failed; the others continue
                ensemble = jax.tree.map(lambda leaf: leaf if leaf.dtype == jnp.int32 else leaf * jnp.nan, state.model)
                report = Report(0, np.full(agent.members, np.nan), np.nan, 0)
            ensembles.append(ensemble)
            reports.append(report)
        self.metrics["model_error"] = np.array([report.elite_error for report in reports])
        self.metrics["model_epochs"] = np.array([float(report.epochs) for report in reports])
        return states._replace(model=jax.tree.map(lambda *leaves: jnp.stack(leaves), *ensembles))

    def _apart(self, learner: Any, states: Any) -> Iterator[tuple[Any, Any]]:
        """The agent and the state of each lane."""
        return zip(unstack(learner, len(self.seeds)), unstack(states, len(self.seeds)))

    def turn(self, step: int) -> tuple[int, int]:
        """Number of the fit of the model that the block of updates from `step` on uses, and of the blocks since that fit."""
        return divmod(step // self.block, self._turns)

    def known(self, turn: int) -> int:
        """Number of real steps that a fit of the model was trained on."""
        return self.settings.explore + turn * self._turns * self.settings.block

    def real(self, lane: int) -> Float[np.ndarray, "n w"]:
        """All real rows of a lane, as learners get them."""
        return np.asarray(self.replay.buffer[lane, : self.environment_steps])

    def _mixed(self, lane: int, turn: int) -> int:
        """A seed for each fit of the model of a lane."""
        return zlib.crc32(f"{self.seeds[lane]} {turn}".encode())

    def state(self) -> dict[str, Any]:
        """See `Experience`; also the metrics of the last fit."""
        return {**super().state(), "metrics": self.metrics}

    def restore(self, state: dict[str, Any]) -> None:
        """See `Experience`."""
        super().restore(state)
        self.metrics = {name: np.asarray(value) for name, value in state["metrics"].items()}
