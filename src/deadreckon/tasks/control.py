"""Nine tasks of dm_control's suite: those of DOPE's half on RL Unplugged (thesis 8.4; Tassa et al. 2018).

Bodies, starts, observations and rewards are the package's own code, called copy by copy (extra `control`); physics and random
numbers are those that its environments would have. Observations are its entries in its order, flat. Episodes only time out.
"""

import importlib
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.errors import UserError, extra
from deadreckon.imports import environment_variable
from deadreckon.tasks.copies import MujocoCopies, bindings
from deadreckon.tasks.task import Reference, Task
from deadreckon.versions import installed

HORIZON = 1_000


@dataclass(frozen=True)
class Control(Task):
    """A task of dm_control's suite.

    Attributes:
        suite: its domain and its name there.
        moved: (array of the model, name of the body, site or geom) of what an episode puts elsewhere.
    """

    revision: ClassVar[int] = 1

    suite: tuple[str, str] = ("", "")
    moved: tuple[tuple[str, str], ...] = ()

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "ControlSimulator":
        """One copy of the environment for each seed, on one thread if None; see `Task.simulate`.

        Raises:
            UserError: dm_control is not installed.
        """
        # Much of a step is Python, so that threads wait for each other: two make half to 1.3 times as many steps a second.
        return ControlSimulator(self, seeds, 1 if threads is None else threads)

    @property
    def versions(self) -> dict[str, str]:
        """See `Task.versions`."""
        return installed("dm_control")

    def check_installed(self) -> None:
        """Does nothing where dm_control is installed.

        Raises:
            UserError: dm_control is not installed.
        """
        if importlib.util.find_spec("dm_control") is None:
            raise UserError(
                f"{self.name} needs dm_control, which is not installed: {extra('control')}, with Python 3.11 or "
                "3.12 (for 3.13 there is no wheel of labmaze, which dm_control depends on)"
            )

    def environment(self) -> Any:
        """The package's own environment, such as `dm_control.suite.load` gives.

        Raises:
            UserError: dm_control is not installed.
        """
        self.check_installed()
        return _suite().load(*self.suite)


class ControlSimulator(MujocoCopies[Control]):
    """Copies of one environment; see `MujocoCopies`.

    Copy `i` does what dm_control's environment does whose task has the random numbers `RandomState(seeds[i])`, episode after
    episode, to the last bit. Touch is a physics step old, as there.
    """

    def __init__(self, task: Control, seeds: Sequence[int], threads: int | None = None):
        self._drawn = task.environment()  # in which episodes are drawn, and the copies of the first thread are measured
        self._of: dict[int, Any] = {}  # an environment of each thread's data: what measures it
        model, steps = self._drawn.physics.model, self._drawn.control_timestep() / self._drawn.physics.timestep()
        self._rows = [(field, model.name2id(name, field.partition("_")[0])) for field, name in task.moved]
        super().__init__(task, model.ptr, seeds, threads, frame_skip=round(steps))
        for i in range(len(self._data)):
            own = task.environment() if i else self._drawn
            with own.physics.reset_context():
                own.task.initialize_episode(own.physics)  # which sets some constants of the model, too
            self._models[i], self._data[i] = own.physics.model.ptr, own.physics.data.ptr
            self._of[id(self._data[i])] = own
        copies = len(seeds)
        self._layout = np.zeros((copies, sum(getattr(model, field)[row].size for field, row in self._rows)))
        self._seen = np.zeros((copies, *task.observation_shape), np.float32)
        self._paid = np.zeros(copies)

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`."""
        return {**super().state(), "layout": self._layout.copy(), "seen": self._seen.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`."""
        super().restore(state)
        self._layout[:], self._seen[:] = state["layout"], state["seen"]

    @staticmethod
    def _generator(seed: int) -> np.random.RandomState:
        # dm_control's own kind, which takes 32 bits; larger seeds are spread over its state.
        return np.random.RandomState(seed if seed < 2**32 else np.random.MT19937(seed))

    def _draw(self, generator: np.random.RandomState) -> np.ndarray:
        """(state + layout + observation,) of a new episode."""
        physics, task = self._drawn.physics, self._drawn.task
        task._random = generator  # it is the only way to give a task other random numbers
        with physics.reset_context():
            task.initialize_episode(physics)
        state = np.zeros(self._state.shape[1])
        self._mujoco.mj_getState(physics.model.ptr, physics.data.ptr, state, self._parts)
        layout = [np.ravel(getattr(physics.model, field)[row]) for field, row in self._rows]
        return np.concatenate([state, *layout, _flat(task.get_observation(physics))])

    def _start(self, which: Any, starts: Any) -> np.ndarray:
        # Where an episode begins, motors are off while forces are computed: the state that was drawn is taken as it is.
        ends = np.cumsum([self._state.shape[1], self._layout.shape[1]])
        for i, start in zip(which, starts):
            self._state[i], self._layout[i], self._seen[i] = np.split(start, ends)
        self._age[which] = 0
        self._alive[which] = True
        return self._observe(which)

    def _settle(self, model: Any, copy: int) -> None:
        at = 0
        for field, row in self._rows:
            part = getattr(model, field)[row]
            part[:] = self._layout[copy, at : at + part.size]
            at += part.size

    def _measure(self, data: Any, copy: int) -> None:
        own = self._of[id(data)]
        self._mujoco.mj_step1(own.physics.model.ptr, data)  # dm_control measures where the state is
        self._seen[copy] = _flat(own.task.get_observation(own.physics))
        self._paid[copy] = own.task.get_reward(own.physics)

    def _observe(self, which: Any) -> np.ndarray:
        return self._seen[which].copy()

    def _outcome(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._paid, np.zeros(len(actions), bool)

    def _camera(self) -> Any:
        return 0


def _flat(observation: Any) -> np.ndarray:
    """What dm_control observes as (size,)."""
    return np.concatenate([np.ravel(part) for part in observation.values()])


@lru_cache
def _suite() -> Any:
    """The module `dm_control.suite`, without its own rendering, which would open OpenGL: pictures are drawn by `mujoco`."""
    bindings()  # looks for an OpenGL where the variable says, and only once
    with environment_variable("MUJOCO_GL", "disable"):
        return importlib.import_module("dm_control.suite")


# ---- the tasks ----------------------------------------------------------------------------------------------------------

# What uniform actions earn is measured, see `python -m deadreckon.collect.references`. A step pays 1 at most.
_UNIFORM = {
    "cartpole-swingup": 30.2425,
    "cheetah-run": 4.0459,
    "finger-turn-hard": 83.51,
    "fish-swim": 77.3035,
    "humanoid-run": 0.7783,
    "manipulator-insert-ball": 47.399,
    "manipulator-insert-peg": 40.6817,
    "walker-stand": 130.7953,
    "walker-walk": 32.2342,
}


def _make(domain: str, kind: str, size: int, actions: int, summary: str, *moved: tuple[str, str]) -> Control:
    name = f"{domain}-{kind.replace('_', '-')}"
    title = "".join(part.title() for part in name.split("-"))
    hard = () if domain == "cartpole" else ("high-dimensional", "long horizon")  # Table 8.1
    return Control(
        name=name, domain="control", horizon=HORIZON, observation_shape=(size,), summary=summary, suite=(domain, kind),
        action_space=Box((-1.0,) * actions, (1.0,) * actions), gym_id=f"deadreckon/{title}-v0", moved=moved,
        reference=Reference(_UNIFORM[name], float(HORIZON), "uniform actions on this simulator; a reward of 1 in every step"),
        split="evaluation", source="Tassa et al. 2018",
        properties=(*hard, "temporally extended") if domain == "manipulator" else hard,
    )  # fmt: skip


def _receptacle(target: str, holder: str) -> tuple[tuple[str, str], ...]:
    return tuple((field, name) for name in (holder, target) for field in ("body_pos", "body_quat"))


TASKS = (
    _make("cartpole", "swingup", 5, 1, "swing up a pole on a cart and balance it"),
    _make("cheetah", "run", 17, 6, "run forward on two legs, at 10 m/s or more"),
    _make("finger", "turn_hard", 12, 2, "turn a body on a hinge until its tip lies on a small target", ("site_pos", "target")),
    _make("fish", "swim", 24, 5, "swim to a target in open water", ("geom_pos", "target")),
    _make("humanoid", "run", 67, 21, "run on two legs, with two arms, at 10 m/s or more"),
    _make("manipulator", "insert_ball", 44, 5, "put a ball into a basket with an arm and a hand in the plane",
          *_receptacle("target_ball", "cup")),
    _make("manipulator", "insert_peg", 44, 5, "put a peg into a slot with an arm and a hand in the plane",
          *_receptacle("target_peg", "slot")),
    _make("walker", "stand", 24, 6, "stand upright on two legs"),
    _make("walker", "walk", 24, 6, "walk forward on two legs at 1 m/s or more"),
)  # fmt: skip
