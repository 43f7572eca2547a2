"""Experience that is mostly made up: MBPO's rollouts in a model of what has really been seen (thesis 5.3, Algorithm 3)."""

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.mbpo import MBPO
from deadreckon.collect.online import Exploration, Online
from deadreckon.dynamics import Ensemble, Gaussian, Trainer, branches, packed
from deadreckon.dynamics.ensemble import room
from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.tasks.task import Task

EPOCH = 1000  # real steps, in which rollout lengths are counted
_DREAM = 6  # purpose of randomness, beside those of `training.fit`


class Imagination(Exploration):
    """Real steps, an ensemble fitted to them, and the rollouts that agents learn from.

    A made-up row is observation, action in [-1, 1], reward, next observation, terminal. What batches are drawn from are the
    rollouts of the last `keep` real steps, and as many real rows, drawn with replacement when rollouts are made, as their share
    asks for.

    Args:
        task, agent, seeds, updates, settings, paths, threads: see `Exploration`.

    Raises:
        UserError: a task that cannot be learned online, or turns that do not fit each other.
    """

    def __init__(
        self,
        task: Task,
        agent: MBPO,
        seeds: Sequence[int],
        updates: int,
        settings: Online,
        paths: Sequence[Path] = (),
        threads: int | None = None,
    ):
        super().__init__(task, agent, seeds, updates, settings, paths, threads)
        self.agent = agent
        assert agent.model_hidden is not None  # resolved
        assert agent.keep is not None
        every = agent.model_every
        if every % settings.block or agent.keep % every:
            wanted = f"a multiple of block ({settings.block}), and keep ({agent.keep}) of it"
            raise UserError(f"model_every ({every}) must be {wanted}")
        if not 0.0 <= agent.real < 1.0:
            raise UserError(f"real must be 0 .. 1 without 1, got {agent.real:g}")
        self.seeds, self.paths = list(seeds), list(paths)
        self.model = Gaussian(agent.members, agent.model_hidden, agent.model_lr, 0.0, layer_decay=agent.model_decay)
        self.trainer = Trainer(elites=agent.elites, patience=agent.model_patience, most_epochs=agent.model_epochs)
        self.ensembles = [Ensemble.unfitted(self.model, self.spec, agent.elites, jax.random.key(seed)) for seed in self.seeds]
        if agent.ends == "known" and task.ends is None:
            raise UserError(f"{task.name}: its observations do not tell when an episode ends; ask for ends='learned'")
        self._ends = task.ends if agent.ends == "known" else None
        self._width = 2 * self.spec.observation_size + self.spec.action_size + 2  # numbers in a row that is learned from
        self._turns = every // settings.block  # blocks between fits
        self._kept = agent.keep // every  # batches of rollouts
        self._batches: dict[int, np.ndarray] = {}  # by turn, (lanes, rows, width)
        self._waiting: list[int] = []  # turns that are not on disk yet
        self._needed = 0  # the first turn that the checkpoint before the next one needs
        self._buffer = jnp.zeros((len(seeds), 0, 0))
        self._count = 0
        self.metrics = {name: np.full(len(seeds), np.nan) for name in ("model_error", "model_epochs", "rollout_length")}

    @property
    def count(self) -> int:
        """Rows a lane to learn from."""
        return self._count

    @property
    def real_steps(self) -> int:
        """Steps really taken, in every lane."""
        return self.replay.count

    def extend(self, learner: Any, states: Any, roots: PRNGKeyArray, step: int) -> dict[str, Array]:
        """See `Experience`; now and then it fits the model anew and makes rollouts."""
        super().extend(learner, states, roots, step)
        turn, rest = divmod(step // self.block, self._turns)
        if rest == 0:
            self._dream(learner, states, turn)
        return {"packed": self._buffer}

    def _dream(self, learner: Any, states: Any, turn: int) -> None:
        length = self.agent.rollout_length((self.real_steps - self.settings.explore) / EPOCH)
        found, reports = [], []
        for lane, seed in enumerate(self.seeds):
            own = lambda tree, lane=lane: jax.tree.map(lambda leaf: leaf[lane], tree)  # noqa: E731
            rng = self._rng(lane, turn)
            real = np.asarray(self.replay.buffer[lane, : self.real_steps])
            start, mixed = self.ensembles[lane] if turn else None, _mixed(seed, turn)
            self.ensembles[lane], report = self.trainer.fit(self.model, self.spec, self._columns(real), mixed, start)
            reports.append(report)
            n = self.agent.rollouts * self.agent.model_every
            n = -(-n // self.agent.elites) * self.agent.elites
            starts = jnp.asarray(real[rng.integers(len(real), size=n), : self.spec.observation_size])
            policy = own(learner).policy(own(states))
            key = jax.random.fold_in(jax.random.key(mixed), _DREAM)
            rows = packed(branches(self.model, self.ensembles[lane], policy, starts, length, key, self._ends))
            if not len(rows):  # a lane whose numbers went bad, which it is told after its updates
                rows = real[:, : self._width]
            # Lanes have equally many rows; those of rollouts that ended early are made up for by others.
            found.append(rows[np.resize(rng.permutation(len(rows)), n * length)])
        self._batches[turn] = np.stack(found)
        self._waiting.append(turn)
        self._forget(turn)
        self._refill(turn)
        self.metrics = {
            "model_error": np.array([np.sort(report.error)[: self.agent.elites].mean() for report in reports]),
            "model_epochs": np.array([float(report.epochs) for report in reports]),
            "rollout_length": np.full(len(reports), float(length)),
        }

    def _forget(self, turn: int) -> None:
        self._batches = {t: rows for t, rows in self._batches.items() if t > turn - self._kept}

    def _refill(self, turn: int) -> None:
        """Puts what is learned from onto the device, for the turn that was the last."""
        made_up = np.concatenate([self._batches[t] for t in sorted(self._batches)], 1)
        share, steps = self.agent.real, self.settings.explore + (turn * self._turns + 1) * self.settings.block
        more = round(made_up.shape[1] * share / (1.0 - share))
        real = []
        for lane in range(len(self.seeds)):
            rows = np.random.default_rng([self.seeds[lane], _DREAM, turn, 1]).integers(steps, size=more)
            real.append(np.asarray(self.replay.buffer[lane, :steps, : self._width])[rows])
        rows = np.concatenate([made_up, np.stack(real)], 1)
        self._count = rows.shape[1]
        # With room for growth, so that few programs serve all lengths of rollouts.
        self._buffer = jnp.asarray(np.pad(rows, ((0, 0), (0, room(self._count) - self._count), (0, 0))))

    def _rng(self, lane: int, turn: int) -> np.random.Generator:
        return np.random.default_rng([self.seeds[lane], _DREAM, turn, 0])

    def _columns(self, real: Float[np.ndarray, "n w"]) -> dict[str, np.ndarray]:
        o, a = self.spec.observation_size, self.spec.action_size
        edges = np.cumsum([0, o, a, 1, o, 1])
        names = "observation", "action", "reward", "next_observation", "terminal"
        return {name: real[:, start:end] for name, start, end in zip(names, edges, edges[1:])}

    # ---- checkpoints ------------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """See `Experience`; a batch of rollouts is a file, kept as long as a checkpoint may ask for it."""
        super().flush()
        if not self.paths:
            return
        for turn in self._waiting:
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

    def state(self) -> dict[str, Any]:
        """See `Experience`: also the ensembles, and what is told of them until the next fit."""
        return {**super().state(), "ensembles": self.ensembles, "metrics": self.metrics}

    def restore(self, state: dict[str, Any]) -> None:
        """See `Experience`.

        Raises:
            UserError: rollouts that a checkpoint counts on are not there.
        """
        super().restore(state)
        self.ensembles = jax.device_put(state["ensembles"])
        self.metrics = {name: np.asarray(value) for name, value in state["metrics"].items()}
        blocks = (self.real_steps - self.settings.explore) // self.settings.block
        self._batches, self._waiting = {}, []
        if blocks < 1:
            return
        turn = (blocks - 1) // self._turns
        self._needed = max(0, turn - self._kept + 1)
        for t in range(self._needed, turn + 1):
            self._batches[t] = np.stack([_read(self._file(path, t)) for path in self.paths])
        self._refill(turn)


def _mixed(seed: int, turn: int) -> int:
    """A seed for every turn of a seed."""
    return zlib.crc32(f"{seed} {turn}".encode())


def _read(path: Path) -> np.ndarray:
    try:
        return np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise UserError(f"cannot read the rollouts in {path}: {error}") from error
