"""What a grid search over NEMO's rates finds on superconductors where the judge is looked at (section 6.6, appendix C.1).

The thesis has its settings from "a grid search across different settings of alpha_theta, alpha_x, and tau", and does not say
by what they were chosen. Here they are chosen by the scores themselves, separately for each form of boosting that may have been
the judge, and so is the iteration at which the search ends; the chosen ones are then run again with another seed.
"""

from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from deadreckon.data.batch import Batch
from deadreckon.mbo.design_source import DesignSource
from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.nemo import NEMO, State, Training
from deadreckon.mbo.problems.problem import Problem
from deadreckon.mbo.problems.superconductor import superconductor
from deadreckon.mbo.registry import sized
from deadreckon.progress import unwatched
from deadreckon.randomness import keys
from evidence.studies.superconductor_judges import Judge, judges

RATES, STEPS, TAUS = (0.05, 0.005, 0.0005), (0.1, 0.01, 0.001), (0.05, 0.005)  # alpha_theta, alpha_x, tau
PRETRAIN_LR = 0.005  # shared by all; at 0.05 models of this width may lose all units
FRESH = 1000  # added to the seed of what is run again

Setting = tuple[float, float, float, float]  # alpha_theta, alpha_x, tau, weight of a claim


def searched(
    case: str, *, seed: int, updates: int = 300, every: int = 50, pretrain: int = 1000, bins: int = 40
) -> dict[str, float]:  # fmt: skip
    """Best and median of 128 designs with the settings that each judge likes best, on the seed it was shown and on another.

    Args:
        case: percentile of the temperatures up to which materials are shown.
        seed: of NEMO.
        updates: of models and designs by turns, after `pretrain` of the models.
        every: how many updates lie between looks of the judges.
        bins: of the score, and models.

    Returns:
        shown: the greatest temperature that was shown, in K; and by judge (no ending for the benchmark's boosting; `_half`,
        `_shallow` and `_histogram` as in `superconductor_judges.designs`):
        seen, median_seen: of the designs with the highest best one over all settings and iterations, by the judge.
        best, median: of the same settings at the same iteration, run with another seed.
        rate, step, tau, weight, after: these settings and this iteration.
    """
    problem = superconductor("superconductor-boosting", shown=float(case), oracle="boosting", bounded=False)
    by: dict[str, Judge] = {"": problem.oracle, **judges()}
    setting = DesignInput(problem.visible, 128, [seed], None, unwatched)
    weights = 128 / len(problem.visible), 1.0
    nemo = sized("nemo", problem.name, "cpu", max_travel=1000.0, lr=PRETRAIN_LR, bins=bins, pretrain=pretrain)
    assert isinstance(nemo, NEMO)
    learner = nemo.training(setting)
    grid: list[Setting] = list(product(RATES, STEPS, TAUS, weights))
    first = _looks(problem, learner, seed, grid, updates, every)
    scores = {name: np.array([[_scores(judge, x) for x in looks] for looks in first]) for name, judge in by.items()}
    chosen = {name: np.unravel_index(found[..., 0].argmax(), found.shape[:2]) for name, found in scores.items()}
    again = _looks(problem, learner, seed + FRESH, [grid[at] for at, _ in chosen.values()], updates, every)
    out = {"shown": float(problem.visible.y.max())}
    for (name, (at, look)), looks in zip(chosen.items(), again):
        best, median = _scores(by[name], looks[look])
        out |= {f"seen{name}": scores[name][at, look, 0], f"median_seen{name}": scores[name][at, look, 1]}
        out |= {f"best{name}": best, f"median{name}": median}
        values = (*grid[at], float(every * (look + 1)))
        out |= {f"{key}{name}": value for key, value in zip(("rate", "step", "tau", "weight", "after"), values)}
    return {key: float(value) for key, value in out.items()}


def _scores(judge: Judge, x: np.ndarray) -> tuple[float, float]:
    """The best and the median design; those that diverged are the worst."""
    found = np.asarray(judge(np.nan_to_num(x).astype(np.float32)), np.float64)
    scores = np.where(np.isfinite(x).all(1), found, -np.inf)
    return float(scores.max()), float(np.median(scores))


def _looks(
    problem: Problem, learner: Training, seed: int, grid: list[Setting], updates: int, every: int
) -> list[list[np.ndarray]]:  # fmt: skip
    """Designs after every so many updates, of each setting; all go on from the same pretrained models."""
    data, (init, draws) = problem.visible, keys(jax.random.key(seed), "init", "search of settings")
    source = DesignSource(data, learner.needs(data.coordinates))
    x, y = jnp.asarray(source.columns["x"]), jnp.asarray(source.columns["y"])
    pretrain = learner.settings.pretrain
    begun = _trained(learner, learner.init(data.coordinates, init), x, y, draws, jnp.int32(0), pretrain)
    out = []
    for rate, step, tau, weight in grid:
        changed, state, found = eqx.tree_at(_searched, learner, tuple(map(jnp.float32, (rate, step, tau, weight)))), begun, []
        for after in range(0, updates, every):
            state = _trained(changed, state, x, y, draws, jnp.int32(pretrain + after), every)
            found.append(data.coordinates.decode(np.asarray(state.search.x)))
        out.append(found)
    return out


def _searched(learner: Training) -> tuple[Any, ...]:
    """The settings that the grid is of."""
    settings = learner.settings
    return settings.search_lr, settings.design_lr, settings.tau, settings.label_weight


@eqx.filter_jit
def _trained(learner: Training, state: State, x: Array, y: Array, key: Array, first: Array, count: int) -> State:
    """The state after `count` updates, numbered from `first`."""

    def update(state: State, step: Array) -> tuple[State, None]:
        rows, own = jax.random.split(jax.random.fold_in(key, step))
        index = jax.random.randint(rows, (learner.settings.batch_size,), 0, len(x))
        return learner.update(state, Batch(extra={"x": x[index], "y": y[index]}), step=step, key=own)[0], None

    return jax.lax.scan(update, state, first + jnp.arange(count))[0]
