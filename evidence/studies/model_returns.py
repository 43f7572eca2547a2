"""Figure 5.4: what an MBPO run's model says of its policies, and how long it foretells a sequence of actions.

    deadreckon train --agent mbpo --online --task hopper --steps 30000 --out runs/mbpo/hopper/mbpo
    python evidence/studies/model_returns.py --run runs/mbpo/hopper/mbpo --picture docs/results/model-returns.svg

Policies that the run kept act in the simulator and in the run's last model, drawing their actions in both, from the same
kind of first observation. Then actions of a real episode are done again in the model, many times over: its draws are the fan.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.agents.mbpo import MBPO
from deadreckon.agents.model_based import OnlineModelBasedAgent
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.collect.rollouts import played
from deadreckon.data.dataset import Dataset
from deadreckon.data.step import Step
from deadreckon.dynamics import Ensemble, transition
from deadreckon.errors import UserError
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.report import charts
from deadreckon.report.picture import PANEL, sheet
from deadreckon.runs.folder import Folder
from deadreckon.runs.online import reopened, train_online, turns_of
from deadreckon.training.learner import lane_of

REAL, MODEL = range(2)  # colours
BAND = 5, 95  # percentiles of returns that bands and tables show
FAR = 0.5  # ranges of what really happened, beyond which predictions are cut in the picture
DEVIATION = 16, 84  # of predictions: a deviation to both sides where they are normal, and readable where some run away


@dataclass
class Options:
    """Figure 5.4: model against real returns, and the fan of a model's predictions."""

    run: str = "runs/mbpo/hopper/mbpo"  # folder of an online run with a model
    seed: int = 0  # of the run
    policies: int = 8  # of those kept, evenly spread, the last one among them
    rows: int = 10_000  # real steps of each policy
    episodes: int = 1000  # made up for each policy, and repetitions of the sequence of actions
    horizon: int = 1000  # steps of a made-up episode, at most
    sequence: int = 450  # actions that are done again
    shown: tuple[int, ...] = (0, 4)  # observations in the picture
    names: tuple[str, ...] = ("height of the torso", "joint of the foot")  # of these
    units: tuple[str, ...] = ("m", "rad")  # of these
    picture: str | None = None  # SVG file


@eqx.filter_jit
def made_up(
    agent: OnlineModelBasedAgent, ensemble: Ensemble, policy: EnvPolicy, starts: Float[Array, "n o"], key: PRNGKeyArray,
    horizon: int,
) -> Float[Array, "t n"]:
    """Returns so far of episodes in the model."""
    n = len(starts)

    def ahead(carry: Any, t: Array) -> tuple[Any, Array]:
        observation, running, total = carry
        k_act, k_next = jax.random.split(jax.random.fold_in(key, t))
        seen = Step(policy.view.observe(observation), jnp.zeros(n), jnp.zeros(n, bool))
        action = policy.inner.act(seen, policy.start(n), k_act, greedy=False)[0]
        reward, following, over, lost = transition(agent.model, ensemble, agent.over, observation, action, k_next)
        total += jnp.where(running & ~lost, reward, 0.0)
        running &= ~(over | lost)
        return (jnp.where(running[:, None], following, observation), running, total), total

    begun = starts, jnp.ones(n, bool), jnp.zeros(n)
    return jax.lax.scan(ahead, begun, jnp.arange(horizon))[1]


@eqx.filter_jit
def fan(
    agent: OnlineModelBasedAgent, ensemble: Ensemble, start: Float[Array, "o"], actions: Float[Array, "t a"], n: int,
    key: PRNGKeyArray,
) -> Float[Array, "t n o"]:
    """Observations that follow the same actions, without an end; one that is not finite stays where it was."""

    def ahead(observation: Array, at: Any) -> tuple[Array, Array]:
        action, t = at
        repeated = jnp.broadcast_to(action, (n, len(action)))
        _, following, _, _ = transition(agent.model, ensemble, agent.over, observation, repeated, jax.random.fold_in(key, t))
        following = jnp.where(jnp.isfinite(following).all(-1, keepdims=True), following, observation)
        return following, following

    begun = jnp.broadcast_to(start, (n, len(start)))
    return jax.lax.scan(ahead, begun, (actions, jnp.arange(len(actions))))[1]


def whole(log: Dataset) -> Dataset:
    """A log without a last episode that was cut off where its rows were full."""
    cut = log.episodes > 1 and log.lengths[-1] < log.lengths[:-1].max() and not log.terminals[-1]
    return log.select(np.arange(log.episodes - cut))


def so_far(log: Dataset, horizon: int) -> Float[np.ndarray, "t n"]:
    """Returns so far of a log's episodes, which stay where these end."""
    rewards = np.zeros((horizon, log.episodes))
    for i, (start, length) in enumerate(zip(log.starts, log.lengths)):
        rewards[: min(length, horizon), i] = log.rewards[start : start + min(length, horizon)]
    return rewards.cumsum(0)


def banded(name: str, slot: int, x: np.ndarray, values: np.ndarray, percentiles: tuple[int, int]) -> charts.Series:
    """The mean of (n, repetitions) values and a band of percentiles."""
    low, high = np.nanpercentile(values, percentiles, axis=1)
    return charts.Series(name, slot, x, np.nanmean(values, 1), low, high)


class Found(NamedTuple):
    """What a run's policies reach, each as (steps, episodes) returns so far."""

    agent: OnlineModelBasedAgent
    ensemble: Ensemble
    folder: Folder
    kept: list[int]  # updates after which the policies were kept
    steps: np.ndarray  # of the environment, after which they were
    logs: list[Dataset]  # what they did
    real: list[np.ndarray]
    dreamed: list[np.ndarray]


def measured(options: Options) -> Found:
    """Policies of a run in the simulator and in the run's last model."""
    job, folder = reopened(options.run), Folder(Path(options.run))
    if options.seed not in job.seeds:
        raise UserError(f"{options.run} has the seeds {list(job.seeds)}, not {options.seed}")
    lane = list(job.seeds).index(options.seed)
    agent, experience = job.learners[lane], job.source.experience
    if not isinstance(agent, OnlineModelBasedAgent):
        raise UserError(f"{options.run} is a run of {type(agent).__name__}, which has no model")
    ensemble, task = lane_of(job.states, lane).model, experience.task
    kept = [step for step in folder.policy_steps() if step <= job.step]
    asked = [kept[i] for i in np.unique(np.linspace(0, len(kept) - 1, options.policies).astype(int))]

    key, real, dreamed = jax.random.key(options.seed), [], []
    logs = [whole(played(task, store.load(folder.policy(options.seed, step)), options.rows, 3000 + step)) for step in asked]
    first = np.concatenate([np.asarray(log.observations)[log.starts] for log in logs])
    starts = jnp.asarray(np.random.default_rng(options.seed).choice(first, options.episodes), jnp.float32)
    for i, (step, log) in enumerate(zip(asked, logs)):
        policy = store.load(folder.policy(options.seed, step))
        real.append(so_far(log, options.horizon))
        dreamed.append(np.asarray(made_up(agent, ensemble, policy, starts, jax.random.fold_in(key, i), options.horizon)))
    steps = np.array([experience.settings.steps(step) for step in asked])
    return Found(agent, ensemble, folder, asked, steps, logs, real, dreamed)


def agreement(
    case: str, *, seed: int, steps: int, updates_per_step: float, every: int = 1_000, **fields: Any
) -> dict[str, float]:
    """Whether a model foretells the returns of policies that learned from it, which were kept after the initial random steps.

    Args:
        case: task to learn in by MBPO.
        seed: of the run.
        steps: in the simulator.
        updates_per_step: of the policy.
        every: steps between policies that are judged.
        **fields: of MBPO; those of Table B.1 where absent.

    Returns:
        correlation: of mean returns in the last model with those in the simulator, over a policy for each `every` steps.
        ratio: median over these of the return in the model divided by that in the simulator.
    """
    settings = turns_of(MBPO, case, False, updates_per_step=updates_per_step)
    with tempfile.TemporaryDirectory() as folder:
        plan: dict[str, Any] = {"evaluate_every": every, "episodes": 1, "settings": settings}
        run = train_online(MBPO(**fields), case, steps=steps, seed=seed, out=folder, **plan)
        found = measured(Options(run=str(run.path), seed=seed, policies=1 + steps // every, rows=5_000, episodes=500))
    learned = found.steps > settings.explore
    real, dreamed = (np.array([each[-1].mean() for each in part])[learned] for part in (found.real, found.dreamed))
    return {"correlation": float(np.corrcoef(real, dreamed)[0, 1]), "ratio": float(np.median(dreamed / real))}


def main(options: Options) -> None:
    """Measures, prints and draws."""
    cache_compiled_programs()
    agent, ensemble, folder, asked, steps, logs, real, dreamed = measured(options)
    key = jax.random.key(options.seed)
    print("| environment steps | real return (episodes) | return in the model, 5 % to 95 % |\n|---:|---:|---:|")
    for at, lived, thought in zip(steps, real, dreamed):
        low, high = np.percentile(thought[-1], BAND)
        lived_mean, count, thought_mean = lived[-1].mean(), lived.shape[1], thought[-1].mean()
        print(f"| {at:,} | {lived_mean:,.0f} ({count}) | {thought_mean:,.0f} ({low:,.0f} to {high:,.0f}) |")
    means = np.array([[lived[-1].mean(), thought[-1].mean()] for lived, thought in zip(real, dreamed)])
    ratio = np.median(means[1:, 1] / means[1:, 0])
    print(f"\ncorrelation over the policies: {np.corrcoef(means.T)[0, 1]:.2f}")
    print(f"the model's return over the real one: {ratio:.2f} (median, without the untrained policy)")

    last, view = logs[-1], store.load(folder.policy(options.seed, asked[-1])).view
    longest = int(np.argmax(last.lengths))
    begin = int(last.starts[longest])
    rows = slice(begin, begin + min(int(last.lengths[longest]), options.sequence))
    seen, truth = np.asarray(last.observations[rows]), np.asarray(last.next_observations[rows])
    actions = jnp.asarray(view.to_unit(np.asarray(last.actions[rows])))
    again = np.asarray(fan(agent, ensemble, jnp.asarray(seen[0]), actions, options.episodes, jax.random.fold_in(key, 10_000)))
    deviation = np.concatenate([np.asarray(log.observations) for log in logs[1:] or logs]).std(0)
    off = np.abs(np.median(again, 1) - truth) / deviation
    wide = (np.percentile(again, DEVIATION[1], axis=1) - np.percentile(again, DEVIATION[0], axis=1)) / 2 / deviation
    print("\n| steps of the sequence | median prediction off by | half the fan's width (in deviations of each observation) |")
    print("|---:|---:|---:|")
    for t in (1, 5, 10, 25, 50, 100, 200, 450):
        if t <= len(truth):
            print(f"| {t} | {off[t - 1].mean():.2g} | {wide[t - 1].mean():.2g} |")

    if options.picture:
        across = np.arange(1, len(truth) + 1)
        panels = {}
        for which, name, unit in zip(options.shown, options.names, options.units):
            low, high = truth[:, which].min(), truth[:, which].max()
            near = np.clip(again[:, :, which], low - FAR * (high - low), high + FAR * (high - low))
            lines = [banded("model", MODEL, across, near, DEVIATION),
                     charts.Series("simulator", REAL, across, truth[:, which])]  # fmt: skip
            panels[name] = charts.lines(lines, title=name, unit=unit, size=PANEL, across="steps of the same actions")
        every = np.arange(0, options.horizon, max(1, options.horizon // charts.POINTS))
        found = [(dreamed[-1], "model", MODEL), (real[-1], "simulator", REAL)]
        lines = [banded(name, slot, every + 1, values[every], BAND) for values, name, slot in found]
        panels["return so far of the last policy"] = charts.lines(
            lines, title="return so far", unit="return so far", size=PANEL, across="steps of an episode"
        )
        lines = [banded(name, slot, steps, np.stack([np.resize(v[-1], options.episodes) for v in found]), BAND)
                 for found, name, slot in ((dreamed, "model", MODEL), (real, "simulator", REAL))]  # fmt: skip
        panels["return of policies along the run"] = charts.lines(
            lines, title="return", unit="return", size=PANEL, across="environment steps"
        )
        print(sheet(options.picture, panels, ["simulator", "model"]))


if __name__ == "__main__":
    main(tyro.cli(Options))
