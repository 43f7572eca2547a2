"""HopperController: the weights of a neural network that makes a hopper hop, scored in MuJoCo (thesis 6.5).

A design is 5,126 numbers, as in Design-Bench: weights and biases of an 11-64-64-3 network with tanh between its layers, and
three logarithms of deviations, which a deterministic controller does not use. Its score is the return of one episode of at most
1,000 steps from a start that never changes.

The 3,200 scored designs are our own, not Design-Bench's: controllers that evolution strategies (Salimans et al. 2017) tried out
on their way up, in several runs. What they tried follows from a seed and from the scores, and the scores come with the package:
so all designs are there in a moment, without simulation. `python -m deadreckon.mbo.problems.hopper_controller FILE` measures
the scores again.
"""

import sys
from importlib.resources import files
from io import BytesIO
from pathlib import Path

import numpy as np

from deadreckon.errors import UserError
from deadreckon.files import replacing
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.problems.problem import Problem
from deadreckon.mbo.variables import Variable
from deadreckon.tasks import registry

LAYERS = ((11, 64), (64, 64), (64, 3))
UNUSED = 3  # logarithms of deviations
SIZE = sum(i * o + o for i, o in LAYERS) + UNUSED
START = 0  # seed of the one start
DESIGNS = 3200
# Of evolution: runs, iterations, pairs of mirrored perturbations an iteration, their deviation, Adam's rate and decays.
RUNS, ITERATIONS, PAIRS, DEVIATION, RATE, DECAYS = 8, 25, 64, 0.05, 0.02, (0.9, 0.99)
_SCORES = "hopper_controller.npz"
_PROBE = slice(None, None, 400), slice(None, None, 640)  # of the designs: what is stored to see that they are the same again


def returns(x: np.ndarray, *, threads: int | None = None) -> np.ndarray:
    """(n,) returns of controllers (n, 5126), all from the same start, side by side.

    Args:
        x: controllers, in 32 bits.
        threads: None: one per core.
    """
    layers = list(_layers(np.asarray(x, np.float32)))
    simulator = registry.task("hopper").simulate([START] * len(x), threads)
    seen, total, alive = simulator.reset(), np.zeros(len(x)), np.ones(len(x), bool)
    while alive.any():
        running = np.flatnonzero(alive)
        hidden = seen[running, None]
        for k, (weight, bias) in enumerate(layers):
            hidden = (np.tanh(hidden) if k else hidden) @ weight[running] + bias[running, None]
        actions = np.zeros((len(x), LAYERS[-1][1]), np.float32)
        actions[running] = np.clip(hidden[:, 0], -1.0, 1.0)
        seen, rewards, terminals, timeouts = simulator.step(actions)
        total += rewards
        alive &= ~(terminals | timeouts)
    return total


def _layers(x: np.ndarray):
    at = 0
    for i, o in LAYERS:
        yield x[:, at : at + i * o].reshape(-1, i, o), x[:, at + i * o : at + i * o + o]
        at += i * o + o


class Evolution:
    """One run of evolution strategies: what it tries out follows from its seed and the scores that it is told."""

    def __init__(self, seed: int):
        self._rng = np.random.default_rng(seed)
        parts = []
        for k, (i, o) in enumerate(LAYERS):
            small = 0.1 if k == len(LAYERS) - 1 else 1.0  # it begins with small actions
            parts += [small / np.sqrt(i) * self._rng.uniform(-1, 1, i * o), np.zeros(o)]
        self._mean = np.concatenate([*parts, np.zeros(UNUSED)])
        self._adam = np.zeros((2, SIZE))
        self._told = 0

    def ask(self) -> np.ndarray:
        """(2 pairs, 5126) controllers around the mean, the second half mirrors the first."""
        self._noise = self._rng.standard_normal((PAIRS, SIZE))
        self._noise[:, -UNUSED:] = 0.0
        spread = DEVIATION * self._noise
        return np.concatenate([self._mean + spread, self._mean - spread]).astype(np.float32)

    def tell(self, scores: np.ndarray) -> None:
        """Moves the mean up the estimated gradient of the scores' ranks."""
        ranks = np.argsort(np.argsort(scores, kind="stable"), kind="stable") / (2 * PAIRS - 1) - 0.5
        # Sums in a fixed order: BLAS adds in an order of its own on each machine.
        gradient = np.einsum("p,pd->d", ranks[:PAIRS] - ranks[PAIRS:], self._noise) / (2 * PAIRS * DEVIATION)
        self._told += 1
        for k, (decay, value) in enumerate(zip(DECAYS, (gradient, np.square(gradient)))):
            self._adam[k] = decay * self._adam[k] + (1 - decay) * value
        first, second = (m / (1 - decay**self._told) for m, decay in zip(self._adam, DECAYS))
        self._mean = self._mean + RATE * first / (np.sqrt(second) + 1e-8)


def _designs(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What evolution tried out and we show, and which of all scores these have."""
    kept = np.zeros(scores.size, bool)
    kept[np.random.default_rng(0).choice(scores.size, DESIGNS, replace=False)] = True
    x = []
    for seed, (run, wanted) in enumerate(zip(scores, kept.reshape(scores.shape))):
        evolution = Evolution(seed)
        for told, which in zip(run, wanted):
            x.append(evolution.ask()[which])
            evolution.tell(told)
    return np.concatenate(x), kept


def hopper_controller() -> Problem:
    """3,200 controllers with their returns, all shown; scored in MuJoCo.

    Raises:
        UserError: numpy's generator draws other numbers than it did.
    """
    with np.load(BytesIO(files("deadreckon.mbo.problems").joinpath(_SCORES).read_bytes())) as stored:
        scores, probe = stored["scores"].astype(np.float64), stored["probe"]  # (runs, iterations, 2 pairs), and some of x
    x, kept = _designs(scores)
    if not np.allclose(x[_PROBE], probe, rtol=1e-4, atol=1e-6):
        raise UserError(f"hopper-controller: numpy {np.__version__} draws other numbers than its designs were made of")
    y = scores.reshape(-1)[kept]
    variables = tuple(Variable(f"w{i}") for i in range(SIZE))
    full = Designs(x, y, variables, "hopper-controller", "return")
    about = "exact: MuJoCo, one episode from a fixed start"
    return Problem("hopper-controller", full, float(y.min()), float(y.max()), returns, about)


def measure(out: Path | str) -> None:
    """Runs evolution and writes the scores that the package ships; minutes."""
    scores = np.zeros((RUNS, ITERATIONS, 2 * PAIRS), np.float32)
    for seed in range(RUNS):
        evolution = Evolution(seed)
        for i in range(ITERATIONS):
            scores[seed, i] = returns(evolution.ask())
            evolution.tell(scores[seed, i].astype(np.float64))
        print(f"run {seed}: {scores[seed, -1].mean():.0f} on average, {scores[seed].max():.0f} at best", flush=True)
    with replacing(out) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, scores=scores, probe=_designs(scores.astype(np.float64))[0][_PROBE])


if __name__ == "__main__":
    measure(sys.argv[1])
