"""The Gym-MuJoCo suite: Gymnasium's v5 bodies and rewards, with the observation layout of v2 that D4RL and DOPE logged.

What differs from the MuJoCo 1.5 and 2.0 of the original logs is written down in the docs (`tasks/gym.md`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from deadreckon.data import stands
from deadreckon.data.spec import Box
from deadreckon.data.terminations import Fallen
from deadreckon.tasks import copies
from deadreckon.tasks.copies import MujocoCopies
from deadreckon.tasks.task import Reference, Task
from deadreckon.versions import installed

SPEED_LIMIT = 10.0  # of observed velocities, where they are clipped


@dataclass(frozen=True)
class GymMujoco(Task):
    """A Gym-MuJoCo task. Observations are positions without those along the ground, then velocities, then `padding` zeros.

    Attributes:
        xml: the body, among Gymnasium's assets.
        frame_skip: physics steps an environment step.
        ground: leading positions that are not observed: 1 in the plane, 2 in space.
        forward_reward: of a unit of speed along x.
        control_cost: of a squared action.
        healthy: (n, positions + velocities) states to (n,) bool, as numpy or JAX arrays; an unhealthy state is terminal. None:
            none is.
        healthy_reward: a step that ends in a healthy state.
        start_noise: half-width of the uniform noise on the first positions.
        gaussian: whether the first velocities' noise is Gaussian, of that deviation, or uniform like the positions'.
        clipped: whether observed velocities are clipped to +-10.
        progress: whose way along x is rewarded: the first position, the torso, or the centre of mass; the last two as of the
            last physics step's beginning, as in Gymnasium.
        inner: whether the bodies' inertias and velocities and the joints' motor forces are observed behind the velocities.
        padding: zeros at the end. The contact forces of v2 (84) were zero under the MuJoCo 2.0 of the original logs, and
            cost nothing.
    """

    revision: ClassVar[int] = 1

    xml: str = ""
    frame_skip: int = 1
    ground: int = 1
    forward_reward: float = 1.0
    control_cost: float = 1e-3
    healthy: Callable[[np.ndarray], np.ndarray] | None = None
    healthy_reward: float = 1.0
    start_noise: float = 5e-3
    gaussian: bool = False
    clipped: bool = True
    progress: Literal["position", "torso", "mass"] = "position"
    inner: bool = False
    padding: int = 0

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "GymSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return GymSimulator(self, seeds, threads)

    @property
    def versions(self) -> dict[str, str]:
        """See `Task.versions`: of the package that the body is from."""
        return installed("gymnasium")

    @property
    def ends(self) -> Fallen:
        """See `Task.ends`."""
        return Fallen(self.healthy, self.ground, self.padding)


class GymSimulator(MujocoCopies[GymMujoco]):
    """Copies of one environment; see `MujocoCopies`.

    Copy `i` does what Gymnasium's environment does after `reset(seed=seeds[i])`, episode after episode, to the last bit
    of the positions and velocities.
    """

    def __init__(self, task: GymMujoco, seeds: Sequence[int], threads: int | None = None):
        super().__init__(task, load_model(task.xml), seeds, threads, frame_skip=task.frame_skip)
        model, number = self._model, len(seeds)
        self._progress = np.zeros(number)  # along x, as the reward sees it
        self._before = np.zeros(number)  # the same, a step ago
        self._weights = np.array(model.body_mass) / model.body_mass.sum()
        inner = 16 * model.nbody + model.nv if task.inner else 0  # inertia 10 and velocity 6 a body, force 1 a joint
        self._inner = np.zeros((number, inner))

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {**super().state(), "progress": self._progress.copy(), "inner": self._inner.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        super().restore(state)
        self._progress[:], self._inner[:] = state["progress"], state["inner"]

    def _draw(self, generator: np.random.Generator) -> np.ndarray:
        """(positions + velocities,) of a new episode, drawn as Gymnasium draws them."""
        noise, model = self.task.start_noise, self._model
        position = self._first + generator.uniform(-noise, noise, model.nq)
        if self.task.gaussian:
            return np.concatenate([position, noise * generator.standard_normal(model.nv)])
        return np.concatenate([position, generator.uniform(-noise, noise, model.nv)])

    def _advance(self, running: np.ndarray, actions: np.ndarray) -> None:
        self._before[:] = self._progress
        super()._advance(running, actions)

    def _outcome(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        task, state = self.task, self._moving
        healthy = np.ones(len(state), bool) if task.healthy is None else task.healthy(state)
        costs = task.control_cost * np.square(actions, dtype=np.float64).sum(1)
        alive = task.healthy_reward * healthy if task.healthy is not None else 0.0
        return task.forward_reward * (self._progress - self._before) / self._dt + alive - costs, ~healthy

    def _measure(self, data: Any, copy: int) -> None:
        """Keeps what the state does not hold."""
        whose = self.task.progress
        if whose == "position":
            self._progress[copy] = data.qpos[0]
        else:
            self._progress[copy] = data.xpos[1, 0] if whose == "torso" else self._weights @ data.xipos[:, 0]
        if self.task.inner:
            self._inner[copy] = np.concatenate([data.cinert.ravel(), data.cvel.ravel(), data.qfrc_actuator])

    def _observe(self, which: Any) -> np.ndarray:
        task, positions = self.task, self._model.nq
        seen = self._moving[which]
        velocities = seen[:, positions:]
        if task.clipped:
            velocities = np.clip(velocities, -SPEED_LIMIT, SPEED_LIMIT)
        out = np.zeros((len(seen), *task.observation_shape), np.float32)
        out[:, : positions - task.ground] = seen[:, task.ground : positions]
        end = seen.shape[1] - task.ground
        out[:, positions - task.ground : end] = velocities
        out[:, end : end + self._inner.shape[1]] = self._inner[which]
        return out


def load_model(xml: str) -> Any:
    """The compiled MuJoCo model of one of Gymnasium's bodies, shared by all who step it (they never write to it)."""
    return copies.load_model("gymnasium", f"envs/mujoco/assets/{xml}")


# ---- the tasks --------------------------------------------------------------------------------------------------------


def _make(name: str, size: int, actions: int, gym_id: str, split: str, summary: str, **fields: Any) -> GymMujoco:
    published = Reference(*_PUBLISHED[name], "D4RL") if name in _PUBLISHED else None
    bound = {"humanoid": 0.4, "inverted-pendulum": 3.0}.get(name, 1.0)
    return GymMujoco(
        name=name, domain="gym", horizon=1000, observation_shape=(size,), gym_id=gym_id, split=split, summary=summary,
        action_space=Box((-bound,) * actions, (bound,) * actions), reference=published or _MEASURED[name], published=published,
        properties=("suboptimal data", "narrow data", "high-dimensional") if published else (),
        source="Brockman et al. 2016, Todorov et al. 2012", **fields,
    )  # fmt: skip


# D4RL's returns of uniform actions and of its SAC experts. They define the scores here too: ours would make scores that no
# published table could stand beside.
_PUBLISHED = {
    "hopper": (-20.272305, 3234.3),
    "halfcheetah": (-280.178953, 12135.0),
    "walker2d": (1.629008, 4592.3),
    "ant": (-325.6, 3879.7),
}

# D4RL has neither. Standing for the whole horizon earns 5 and 1 a step; what uniform actions earn is measured, see
# `python -m deadreckon.collect.references`.
_MEASURED = {
    "humanoid": Reference(117.3715, 5000.0, "uniform actions on this simulator; standing for 1,000 steps"),
    "inverted-pendulum": Reference(4.98, 1000.0, "uniform actions on this simulator; standing for 1,000 steps"),
}

TASKS = (
    _make("inverted-pendulum", 4, 1, "InvertedPendulum-v5", "training", "balance a pole on a cart", xml="inverted_pendulum.xml",
          frame_skip=2, ground=0, forward_reward=0.0, control_cost=0.0, healthy=stands.pendulum, start_noise=1e-2,
          clipped=False),
    _make("hopper", 11, 3, "Hopper-v5", "evaluation", "hop forward on one leg", xml="hopper.xml", frame_skip=4,
          healthy=stands.hopper),
    _make("halfcheetah", 17, 6, "HalfCheetah-v5", "training", "run forward on two legs; nothing ends an episode early",
          xml="half_cheetah.xml", frame_skip=5, control_cost=0.1, start_noise=0.1, gaussian=True, clipped=False),
    _make("walker2d", 17, 6, "Walker2d-v5", "training", "walk forward on two legs", xml="walker2d_v5.xml", frame_skip=4,
          healthy=stands.walker),
    _make("ant", 111, 8, "deadreckon/Ant-v5", "evaluation", "run forward on four legs; 84 observations are zeros",
          xml="ant.xml", frame_skip=5, ground=2, control_cost=0.5, healthy=stands.ant, start_noise=0.1, gaussian=True,
          clipped=False, progress="torso", padding=84),
    _make("humanoid", 376, 17, "deadreckon/Humanoid-v5", "evaluation", "run forward on two legs, with two arms; 84 zeros",
          xml="humanoid.xml", frame_skip=5, ground=2, forward_reward=1.25, control_cost=0.1, healthy=stands.humanoid,
          healthy_reward=5.0, start_noise=1e-2, clipped=False, progress="mass", inner=True, padding=84),
)  # fmt: skip
