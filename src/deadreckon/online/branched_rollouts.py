"""Experience that is mostly simulated: MBPO's branched rollouts in a model of the real steps (thesis 5.3, Algorithm 3)."""

from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, PRNGKeyArray

from deadreckon.agents.mbpo import MBPO
from deadreckon.dynamics import branches, packed
from deadreckon.dynamics.ensemble import room
from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.foreign.archive import read_array
from deadreckon.online.model_learning import ModelLearning
from deadreckon.randomness import generator, key_for

EPOCH = 1000  # real steps of an epoch, the unit of the schedule of rollout lengths
SPARE = 10  # most rows that are simulated at a time, as a multiple of those that are kept of a fit; half of it is enough


class BranchedRollouts(ModelLearning):
    """Real steps, an ensemble fitted to them, and the rollouts that agents are trained on.

    A simulated row is observation, action in [-1, 1], reward, next observation, terminal. Batches are drawn from the rollouts
    of the last `retain_steps` real steps and from real rows, which are drawn with replacement when rollouts are made and are
    the share `real_ratio` of all.

    Raises:
        UserError: as `ModelLearning`, or if `retain_steps` or `model_buffer_size` do not fit `model_train_freq`.
    """

    revision: ClassVar[int] = 1

    def _begin(self, agent: Any) -> None:
        super()._begin(agent)
        self.agent: MBPO = agent
        assert agent.retain_steps is not None  # resolved
        if agent.retain_steps % agent.model_train_freq:
            every = agent.model_train_freq
            raise UserError(f"retain_steps ({agent.retain_steps}) must be a multiple of model_train_freq ({every})")
        self._width = 2 * self.spec.observation_size + self.spec.action_size + 2  # numbers in a training row
        self._kept = agent.retain_steps // agent.model_train_freq  # batches of rollouts
        self._share = agent.model_buffer_size // self._kept  # rows of each, at most
        if self._share < 1:
            size = agent.model_buffer_size
            raise UserError(f"model_buffer_size ({size}) must hold a row of each of the {self._kept} fits that are kept")
        self._batches: dict[int, np.ndarray] = {}  # by turn, (lanes, rows, width)
        self._waiting: list[int] = []  # turns that are not on disk yet
        self._needed = 0  # the first turn that the checkpoint before the next one needs
        self._buffer = jnp.zeros((len(self.seeds), 0, 0))
        self._count = 0
        self.metrics["rollout_length"] = np.full(len(self.seeds), np.nan)

    @property
    def count(self) -> int:
        """See `Experience`."""
        return self._count

    def extend(self, learner: Any, states: Any, roots: Key[Array, "lanes"], step: int) -> tuple[Any, dict[str, Array]]:
        """See `Experience`; new steps are used for training and as starts of rollouts from the next fit of the model on."""
        states, _ = super().extend(learner, states, roots, step)
        return states, {"packed": self._buffer}

    def _fitted(self, learner: Any, states: Any, turn: int) -> Any:
        """Also simulates rollouts in the ensembles."""
        states = super()._fitted(learner, states, turn)
        length = self.agent.rollout_length_at((self.environment_steps - self.settings.explore) // EPOCH)
        found = []
        for lane, (agent, state) in enumerate(self._apart(learner, states)):
            rng = generator(self.seeds[lane], "rollouts", turn)
            real, n = self.real(lane), agent.rollouts_per_step * agent.model_train_freq
            starts = jnp.asarray(real[rng.integers(len(real), size=n), : self.spec.observation_size])
            key = key_for(jax.random.key(self._mixed(lane, turn)), "rollouts")
            rows = self._made_up(agent, state, starts, length, key)
            if not len(rows):  # a lane that diverged, which is marked as failed after its updates
                rows = real[:, : self._width]
            # Lanes have the same number of rows: if rollouts ended early, rows are repeated.
            found.append(rows[np.resize(rng.permutation(len(rows)), min(n * length, self._share))])
        self._batches[turn] = np.stack(found)
        self._waiting.append(turn)
        self._batches = {t: rows for t, rows in self._batches.items() if t > turn - self._kept}
        self._refill(turn)
        self.metrics["rollout_length"] = np.full(len(self.seeds), float(length))
        return states

    def _made_up(self, agent: MBPO, state: Any, starts: Array, length: int, key: PRNGKeyArray) -> np.ndarray:
        """Rows of rollouts. Few rows of long ones would be kept, so these are simulated in portions until there are enough."""
        halvings = 0  # a portion is the starts halved so many times, so that few compiled programs serve all lengths
        while (len(starts) >> halvings) > 1 and (len(starts) >> halvings) * length > SPARE * self._share:
            halvings += 1
        portion, found, count = len(starts) >> halvings, [], 0
        for i in range(1 << halvings):
            some = starts[i * portion : (i + 1) * portion]
            now = jax.random.fold_in(key, i)
            rows = packed(branches(agent.model, state.model, agent.policy(state), some, length, now, agent.over))
            found.append(rows)
            count += len(rows)
            if count >= SPARE * self._share // 2:
                break
        return np.concatenate(found)

    def _refill(self, turn: int) -> None:
        """Puts the training rows for the last fit of the model onto the device."""
        self._buffer = jnp.zeros((len(self.seeds), 0, 0))  # frees the memory of the previous rows first
        kept = [self._batches[t] for t in sorted(self._batches)]
        made_up, share, steps = sum(rows.shape[1] for rows in kept), self.agent.real_ratio, self.known(turn)
        more = round(made_up * share / (1.0 - share))
        self._count = made_up + more
        # With room for growth, so that few compiled programs serve all lengths of rollouts.
        rows = np.zeros((len(self.seeds), room(self._count), self._width), np.float32)
        np.concatenate(kept, 1, out=rows[:, :made_up])
        for lane, seed in enumerate(self.seeds):
            drawn = generator(seed, "real rows", turn).integers(steps, size=more)
            rows[lane, made_up : self._count] = np.asarray(self.replay.buffer[lane, :steps, : self._width])[drawn]
        self._buffer = jnp.asarray(rows)

    # ---- checkpoints ------------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """See `Experience`; a batch of rollouts is a file, which is kept as long as a checkpoint may need it."""
        super().flush()
        if not self.paths:
            return
        for turn in (turn for turn in self._waiting if turn in self._batches):  # others are no longer used
            for lane, path in enumerate(self.paths):
                with replacing(self._file(path, turn)) as temporary, open(temporary, "wb") as file:
                    np.save(file, self._batches[turn][lane], allow_pickle=False)
        self._waiting = []
        needed = min(self._batches, default=0)
        for path in self.paths:
            for old in path.parent.glob(f"{path.stem}-made-up-*.npy"):
                if int(old.stem.rpartition("-")[2]) < self._needed:
                    old.unlink()
        self._needed = needed

    @staticmethod
    def _file(path: Path, turn: int) -> Path:
        return path.with_name(f"{path.stem}-made-up-{turn:06d}.npy")

    def restore(self, state: dict[str, Any]) -> None:
        """See `Experience`.

        Raises:
            UserError: files of rollouts that the checkpoint needs are missing or damaged.
        """
        super().restore(state)
        blocks = (self.environment_steps - self.settings.explore) // self.settings.block
        self._batches, self._waiting = {}, []
        if blocks < 1:
            return
        turn = (blocks - 1) // self._turns
        self._needed = max(0, turn - self._kept + 1)
        for t in range(self._needed, turn + 1):
            self._batches[t] = np.stack([read_array(self._file(path, t)) for path in self.paths])
        self._refill(turn)
