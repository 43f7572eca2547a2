"""AntMorphology and DKittyMorphology: bodies for a gait that knows them, scored in MuJoCo (thesis 6.5).

A design is four legs (`tasks/morphology.py`); its score is the return of 100 steps from a start without noise, with one gait
for all designs. In a gait every joint swings about a middle of its own, in shares of the range that the design gives it, so
that what is done depends on the design; an ant's motors, which know torques alone, follow it through springs. It was found
once, on bodies drawn around the default, and is shipped.

The 25,009 scored designs are our own, not Design-Bench's: what CMA-ES tried out, from the default design on, in several runs,
rounded to 256 values a number. `tools/morphologies.py` finds the gaits and runs CMA-ES again.
"""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.problem import Problem, hidden
from deadreckon.mbo.variables import Variable
from deadreckon.tasks.morphology import ANT, KITTY, LEGS, Morphology

STEPS = 255  # of a number's range: designs of the data are whole multiples of a step
_JOINTS = 3 * LEGS
_BLOCK = 256  # robots side by side
_DAMPING = 0.1  # of an ant's springs, in seconds: shares of their stiffness
_ROBOTS = {task.name: task for task in (ANT, KITTY)}


class Gait(NamedTuple):
    """How the joints swing; each array (n, 12) or (n, 1), a row a robot.

    Attributes:
        middle, swing: in half ranges of the joint.
        phase: in half turns.
        frequency: of all joints, in Hz.
        stiffness: of an ant's springs, in shares of the greatest torque a radian.
    """

    middle: np.ndarray
    swing: np.ndarray
    phase: np.ndarray
    frequency: np.ndarray
    stiffness: np.ndarray

    @classmethod
    def of(cls, numbers: np.ndarray) -> "Gait":
        """From (n, 38) numbers that may be searched freely: the last two are logarithms."""
        parts = np.split(np.atleast_2d(numbers), [_JOINTS, 2 * _JOINTS, 3 * _JOINTS, 3 * _JOINTS + 1], 1)
        middle, swing, phase, frequency, stiffness = parts
        return cls(middle, swing, phase, np.exp(frequency), np.exp(stiffness))

    def actions(self, task: Morphology, designs: np.ndarray, seen: np.ndarray, time: float) -> np.ndarray:
        """(n, 12) actions of robots of these designs, from what is seen of them at a time in s."""
        wanted = self.middle + self.swing * np.sin(2 * np.pi * self.frequency * time + np.pi * self.phase)
        wanted = np.clip(wanted, -1.0, 1.0)
        if task is not ANT:  # its motors go to positions, in shares of the range already
            return np.broadcast_to(wanted, (len(designs), _JOINTS))
        legs = designs.reshape(-1, LEGS, len(task.numbers))[:, :, 6:12].reshape(-1, _JOINTS, 2)
        angle = np.deg2rad(legs[..., 0] + wanted * legs[..., 1])
        position, velocity = seen[:, 5:17], seen[:, 23:35]  # behind height and rotation, and the torso's velocities
        return np.clip(self.stiffness * (angle - position - _DAMPING * velocity), -1.0, 1.0)


def returns(task: Morphology, x: np.ndarray, gait: Gait, *, threads: int | None = None) -> np.ndarray:
    """(n,) returns of bodies.

    Args:
        task: the robot.
        x: (n, size) designs, in 32 bits.
        gait: one for all, or one each.
        threads: None: one per core.
    """
    total = np.zeros(len(x))
    for at in range(0, len(x), _BLOCK):
        part = np.asarray(x[at : at + _BLOCK], np.float32)
        own = Gait(*(numbers if len(numbers) == 1 else numbers[at : at + _BLOCK] for numbers in gait))
        simulator = task.simulate([0] * len(part), threads, part)
        seen, alive, step = simulator.reset(), np.ones(len(part), bool), 0
        while alive.any():
            actions = own.actions(task, part, seen, step * task.timestep)
            seen, rewards, terminals, timeouts = simulator.step(actions)
            total[at : at + len(part)] += rewards
            alive &= ~(terminals | timeouts)
            step += 1
    return total


def stored(task: Morphology) -> Path:
    """Where the package keeps a robot's gait and data."""
    return Path(__file__).parent / f"{task.name.replace('-', '_')}.npz"


@lru_cache
def gait_of(task: Morphology) -> Gait:
    """The gait that is shipped."""
    with np.load(stored(task)) as data:
        return Gait.of(data["gait"])


def designs_of(task: Morphology, steps: np.ndarray) -> np.ndarray:
    """(n, size) float32 designs of whole steps in 0 .. 255 from each number's lower bound."""
    low, high = task.bounds
    return (low + (high - low) * (np.asarray(steps, np.float64) / STEPS)).astype(np.float32)


def morphology(name: str, *, shown: float = 40.0) -> Problem:
    """25,009 bodies with their returns, of which the worse part is shown; scored in MuJoCo.

    Args:
        name: `ant-morphology` or `dkitty-morphology`.
        shown: percentile of the returns up to which bodies are shown.
    """
    task = _ROBOTS[name]
    with np.load(stored(task)) as data:
        x, y = designs_of(task, data["steps"]), data["scores"].astype(np.float64)
    low, high = (bound.astype(np.float32) for bound in task.bounds)
    names = [f"leg{leg}_{number}" for leg in range(LEGS) for number in task.numbers]
    variables = tuple(Variable(n, "continuous", float(a), float(b)) for n, a, b in zip(names, low, high))
    about = f"exact: MuJoCo, one episode of {task.horizon} steps, one gait for all designs in shares of their joints' ranges"
    full = Designs(x, y, variables, name, "return")
    return hidden(name, full, lambda designs: returns(task, designs, gait_of(task)), about, most=shown)
