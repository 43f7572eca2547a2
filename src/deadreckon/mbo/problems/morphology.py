"""AntMorphology and DKittyMorphology: bodies for a controller that knows them, judged in MuJoCo (thesis 6.5).

A design is four legs (`tasks/morphology.py`); its score is the return of 100 steps from a start without noise, under one
controller for all designs: a policy that sees the design, trained once on bodies drawn around the default, and shipped.

The 25,009 scored designs are our own, not Design-Bench's: what CMA-ES tried out, from the default design on, in several runs,
rounded to 256 values a number. `examples/morphologies.py` trains the controller and runs CMA-ES again.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from deadreckon.data.designs import Designs, Variable
from deadreckon.mbo.problems.problem import Problem, hidden
from deadreckon.policies import portable
from deadreckon.tasks.morphology import ANT, KITTY, LEGS, Morphology

STEPS = 255  # of a number's range: designs of the data are whole multiples of a step
_BLOCK = 256  # robots side by side
_ROBOTS = {task.name: task for task in (ANT, KITTY)}


def stored(task: Morphology, what: str) -> Path:
    """Where the package keeps a robot's `data` or `controller`."""
    return Path(__file__).parent / f"{task.name.replace('-', '_')}_{what}.npz"


def designs_of(task: Morphology, steps: np.ndarray) -> np.ndarray:
    """(n, size) float32 designs of whole steps in 0 .. 255 from each number's lower bound."""
    low, high = task.bounds
    return (low + (high - low) * (np.asarray(steps, np.float64) / STEPS)).astype(np.float32)


@lru_cache
def _controller(path: Path) -> portable.NumpyPolicy:
    return portable.load(path)


def returns(task: Morphology, x: np.ndarray, *, threads: int | None = None) -> np.ndarray:
    """(n,) returns of bodies (n, size) under the shipped controller.

    Args:
        task: the robot.
        x: designs, in 32 bits.
        threads: None: one a core.
    """
    act = _controller(stored(task, "controller"))
    total = np.zeros(len(x))
    for at in range(0, len(x), _BLOCK):
        part = np.asarray(x[at : at + _BLOCK], np.float32)
        simulator = task.simulate([0] * len(part), threads, part)
        seen, alive = simulator.reset(), np.ones(len(part), bool)
        while alive.any():
            seen, rewards, terminals, timeouts = simulator.step(np.asarray(act(seen)))
            total[at : at + len(part)] += rewards
            alive &= ~(terminals | timeouts)
    return total


def morphology(name: str, *, shown: float = 40.0) -> Problem:
    """25,009 bodies with their returns, of which the worse part is shown; MuJoCo judges.

    Args:
        name: `ant-morphology` or `dkitty-morphology`.
        shown: percentile of the returns up to which bodies are shown.
    """
    task = _ROBOTS[name]
    with np.load(stored(task, "data")) as data:
        x, y = designs_of(task, data["steps"]), data["scores"].astype(np.float64)
    low, high = (bound.astype(np.float32) for bound in task.bounds)
    names = [f"leg{leg}_{number}" for leg in range(LEGS) for number in task.numbers]
    variables = tuple(Variable(n, "continuous", float(a), float(b)) for n, a, b in zip(names, low, high))
    about = f"exact: MuJoCo, one episode of {task.horizon} steps under a controller that knows the design"
    full = Designs(x, y, variables, name, "return")
    return hidden(name, full, lambda designs: returns(task, designs), about, most=shown)
