"""Figure 5.1: how a model's error grows with the distance of a policy from the one whose data it learned from.

    python evidence/studies/model_shift.py --picture model-shift.svg

A model is fitted to more or less data of one policy of the library, and judged, without being fitted again, on what policies
do that lie on the way to the next snapshot of the same training: their networks are mixtures of both. Distance is the mean KL
divergence from the first policy, where the other one comes; the error is the squared error of the elites' means, in variances
of what is predicted in the first policy's data, where a model that always says the mean has an error of 1.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from deadreckon.cli.main import cache_compiled_programs
from deadreckon.collect.rollouts import played
from deadreckon.data.dataset import Dataset
from deadreckon.dynamics import Gaussian, Trainer
from deadreckon.dynamics.ensemble import rows_of
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.policies import library
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.report import charts
from deadreckon.report.picture import PANEL, sheet
from deadreckon.tasks import task as find_task


@dataclass
class Options:
    """Figure 5.1: a model's error against the policy's distance from the data."""

    task: str = "hopper"  # simulator, of which there are policies
    policy: str = "medium"  # whose data the model learns from
    shares: tuple[float, ...] = (0.0, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)  # of the later policy in what is judged
    near: int = 4  # so many of the first shares give the slope at no distance
    rows: tuple[int, ...] = (2_500, 10_000, 40_000)  # of data to learn from
    collected: int = 40_000  # rows of data at least, of which the models learn from the first
    judged: int = 10_000  # rows of each policy to judge with
    seeds: int = 3  # of data and models
    epochs: int = 100  # of a fit, at most
    picture: str | None = None  # SVG file


def towards(first: EnvPolicy, later: EnvPolicy, share: float) -> Any:
    """The first policy with its network moved a share of the way to the later one's."""
    inner = jax.tree.map(lambda a, b: a + share * (b - a), first.inner, later.inner)
    return dataclasses.replace(first, inner=inner)


def columns_of(log: Dataset) -> dict[str, np.ndarray]:
    """As a model learns from them."""
    return {
        "observation": np.asarray(log.observations), "action": np.asarray(log.actions), "reward": np.asarray(log.rewards),
        "next_observation": log.next_observations, "terminal": np.asarray(log.terminals),
    }  # fmt: skip


def error_of(model: Gaussian, ensemble: Any, columns: dict[str, np.ndarray], variance: np.ndarray) -> float:
    """Mean squared error of the elites' means, in `variance`s."""
    inputs, target, _ = rows_of(columns)
    dealt = jnp.broadcast_to(ensemble.standardise(jnp.asarray(inputs)), (len(ensemble.elites), *inputs.shape))
    mean, _ = model.sample(ensemble.best(), dealt, None)
    return float((jnp.square(mean - target) / variance).mean())


def error(case: str, *, seed: int, rows: int) -> dict[str, float]:
    """A model's error near its data and further away; data, what is judged on and the model are drawn with the seed.

    Args:
        case: `TASK POLICY`, whose data the model learns from.
        seed: of data and model; with the same seed fewer rows are the first of more.
        rows: of data to learn from.

    Returns:
        own: squared error on new data of the same policy, in variances of what is predicted.
        far: the same on data of the later policy.
        slope: rise of the error per nat of KL divergence at no divergence.
        rise: the same over all policies, by least squares.
    """
    task, policy = case.split()
    options = Options(task=task, policy=policy, rows=(rows,))
    apart, [errors] = measured(options, seed)
    near = slice(0, options.near)
    slope, rise = (float(np.polyfit(apart[part], errors[part], 1)[0]) for part in (near, slice(None)))
    return {"own": errors[0], "far": errors[-1], "slope": slope, "rise": rise}


def measured(options: Options, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Divergences (shares,) and errors (rows, shares)."""
    own = library.snapshot(options.task, options.policy)
    later = [s for s in library.evaluated(options.task) if s.updates > own.updates]
    if not later:
        raise UserError(f"{options.policy} is the last policy of {options.task}; name an earlier one")
    first, second = own.policy(), later[0].policy()
    task = find_task(options.task)
    data = played(task, first, max(options.collected, *options.rows), 1000 + seed)
    policies = [towards(first, second, share) for share in options.shares]
    logs = [played(task, policy, options.judged, 2000 + 100 * seed + i) for i, policy in enumerate(policies)]
    apart = []
    for policy, log in zip(policies, logs):
        seen = first.view.observe(np.asarray(log.observations))
        heads = (dist.gaussian_head(each.inner.net(seen)) for each in (policy, first))
        apart.append(float(dist.kl(*heads).mean()))
    errors = []
    model = Gaussian(7, layer_decay=(2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4), as_mbpo=True)
    trainer = Trainer(most_epochs=options.epochs)
    known, judged = columns_of(data), [columns_of(log) for log in logs]
    variance = rows_of(known)[1].var(0)
    for rows in options.rows:
        ensemble, _ = trainer.fit(model, data.spec, {name: column[:rows] for name, column in known.items()}, seed)
        errors.append([error_of(model, ensemble, columns, variance) for columns in judged])
    return np.array(apart), np.array(errors)


def main(options: Options) -> None:
    """Measures, prints and draws."""
    cache_compiled_programs()
    found = []
    for seed in range(options.seeds):
        found.append(measured(options, seed))
        print(f"{seed + 1} of {options.seeds} seeds done", flush=True)
    apart, errors = (np.stack(part) for part in zip(*found))  # (seeds, shares), (seeds, rows, shares)
    heads = " | ".join(f"{kl:.3f}" for kl in apart.mean(0))
    print(f"\n| rows | error at a KL of {heads} | slope at 0 (range over seeds) |")
    print("|---:|" + "---:|" * (len(options.shares) + 1))
    for k, rows in enumerate(options.rows):
        near = slice(0, options.near)
        slopes = [np.polyfit(a[near], e[k, near], 1)[0] for a, e in zip(apart, errors)]
        cells = " | ".join(f"{mean:.4f}" for mean in errors[:, k].mean(0))
        print(f"| {rows:,} | {cells} | {np.mean(slopes):.3f} ({min(slopes):.3f} to {max(slopes):.3f}) |")
    if options.picture:
        names = [f"{rows:,} rows" for rows in options.rows]
        lines = [charts.Series.over_seeds(name, k, apart.mean(0), errors[:, k].T) for k, name in enumerate(names)]
        across = "KL from the data's policy"
        chart = charts.lines(lines, title="model error", unit="error of the model", size=PANEL, across=across)
        print(sheet(options.picture, {f"{options.task}, data of {options.policy}": chart}, names))


if __name__ == "__main__":
    main(tyro.cli(Options))
