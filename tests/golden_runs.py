"""Short runs of every method, and the pieces of the protocol, whose numbers `golden.py` compares with those of before.

They are a few updates long, so that rounding has no time to grow. Of the parameters there is the norm of each array's change,
of metrics the values; both sorted, so that names and the order of fields do not matter.
"""

import dataclasses
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import numpy as np

from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.model_based import ModelBasedAgent
from deadreckon.agents.offline_mbrl import OfflineMBRL
from deadreckon.bench import identity
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Discrete, Spec
from deadreckon.mbo import DESIGNERS, PROBLEMS, designer, problem
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.variables import Variable
from deadreckon.online import Online
from deadreckon.online.experience import experience_of
from deadreckon.ope import ESTIMATORS, OPEInput, behavior, estimator
from deadreckon.policies import EnvPolicy
from deadreckon.policies.kinds import create_actor, stochastic
from deadreckon.runs.evaluate import evaluate
from deadreckon.stats import betting, bootstrap, crossed, inference, interval, means, scores
from deadreckon.tasks import task
from deadreckon.theory import garnet
from deadreckon.training.fit import Fit
from tests.agents import tiny
from tests.agents.worlds import swinging
from tests.ope.test_case import linear, lqr
from tests.ope.worlds import as_policy, tables

Numbers = dict[str, list[float]]


class Run(NamedTuple):
    """A short run.

    Attributes:
        numbers: computes them.
        revisions: of the code that decides them, by what they are of.
        raised: the revision that is raised where they change.
    """

    numbers: Callable[[], Numbers]
    revisions: dict[str, Any]
    raised: str


def first_lane(states: Any) -> Any:
    """What the first seed has."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], states)


def sorted_changes(before: Any, after: Any) -> list[float]:
    """The norm of each array's change, without those that rest and whole numbers."""
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    pairs = [(a, b) for a, b in ((np.asarray(a), np.asarray(b)) for a, b in pairs) if np.issubdtype(a.dtype, np.floating)]
    return sorted(norm for a, b in pairs if (norm := float(np.linalg.norm((b - a).ravel().astype(np.float64)))) > 0)


def agent(name: str) -> Numbers:
    """Two updates at the beginning of a run and two at its end, where warm starts are over; then what the policy does.

    The program is that of the conformance tests, and the numbers are of its first lane.
    """
    made = tiny.small(name)
    job = Fit([made, made], tiny.rows_of(made), [0, 1], tiny.STEPS, chunk=2)
    before, walk = first_lane(job.states), job.chunks()
    first = next(walk)
    job.step = tiny.STEPS - 2
    last = next(walk)
    assert last.step == tiny.STEPS
    assert last.failures == (None, None)
    after = first_lane(last.states)
    policy = EnvPolicy.of(made.policy(after), job.rows.view)
    return {
        "begin": sorted(float(value[0]) for value in first.metrics.values()),
        "end": sorted(float(value[0]) for value in last.metrics.values()),
        "parameters": sorted_changes(before, after),
        "actions": policy(np.linspace(-1, 1, 9, dtype=np.float32)[:, None]).ravel().tolist(),
    }


# Large steps, so that a few updates are seen in the estimates.
FITTED = {"steps": 6, "members": 2, "hidden": (8,), "batch_size": 64, "lr": 0.01, "tau": 0.5, "ema_rate": 0.5, "folds": 2,
          "target_update_period": 2, "atoms": 11, "episodes": 4, "inner_updates": 2, "fourier_features": 16,
          "n_bootstrap": 50}  # fmt: skip
TRAINED = ("fqe", "fqe-d", "dr", "plain-dr", "magic", "dice", "dual-dice", "gen-dice", "vpm", "mb-ff", "mb-ar")


@cache
def case(trained: bool, propensities: bool = True) -> OPEInput:
    """For what is trained continuous actions; for what is solved few states. Propensities are in the log, or to be learned."""
    if trained:
        log, policies = lqr(-0.5, 0.5, 40, 10), [linear(-0.5, 0.5), linear(-1.0, 0.3)]
        if propensities:
            told = policies[0].log_prob(log.observations, log.actions)
            log = dataclasses.replace(log, extras={"behavior_log_probs": told.astype(np.float32)})
    else:
        world = garnet(states=4, actions=2, ending=0.3, noise=0.3)
        probs = [*tables(world, 1, 0.2), *tables(world, 1, 0.7, seed=1)]
        log, policies = world.log(probs[0], 200, 20, np.random.default_rng(3)), [as_policy(each) for each in probs]
    return OPEInput(log, policies, discount=0.9, logged=not trained)


def of_estimates(found: Any) -> Numbers:
    """Values and the ends of their intervals."""
    return {"value": found.value.tolist(), "low": found.low.tolist(), "high": found.high.tolist()}


def ope(name: str) -> Numbers:
    return of_estimates(estimator(name, **FITTED).on(case(name in TRAINED)))


def learned(name: str) -> Numbers:
    """Where the log has no propensities: by a fitted model of the behaviour policy, whose ratios are cut."""
    # Batches so large that each has rows of early stopping: those without any say nothing of when to stop.
    fields = {**FITTED, "log_ratio_range": (-2.0, 2.0), "batch_size": 256}
    return of_estimates(estimator(name, **fields).on(case(True, propensities=False)))


def continuous(name: str) -> Numbers:
    """Of what is solved, in random features."""
    return of_estimates(estimator(name, **FITTED).on(case(True)))


NETS = {"hidden": (8,), "batch_size": 16, "lr": 0.01}
CLIMB = {"ascent_steps": 5, "design_lr": 0.05}
ROUNDS = {**NETS, "latent_size": 2, "members": 2, "steps": 4, "rounds": 2, "updates": 2, "samples": 40}
DESIGNS: dict[str, dict[str, Any]] = {
    "nemo": {**NETS, "bins": 5, "pretrain": 3, "steps": 3, "design_lr": 0.05},
    "nemo-adversarial": {**NETS, "bins": 5, "pretrain": 3, "steps": 3, "design_lr": 0.05},
    "coms": {**NETS, **CLIMB, "steps": 4}, "ram": {**CLIMB, "hidden": (8,), "lr": 0.01, "list_size": 16, "steps": 4},
    **{name: {**NETS, **CLIMB, "steps": 4} for name in ("forward", "ensemble", "ensemble-min")},
    "cbas": ROUNDS, "autofocus": ROUNDS, "gp-bo": {"max_rows": 40, "ascent_steps": 3},
    "ddom": {**NETS, "steps": 4, "sampling_steps": 5},
    "mins": {**NETS, "latent_size": 2, "steps": 4, "critic_updates": 2, "forward_hidden": (8,), "forward_steps": 4,
             "forward_lr": 0.01, "ascent_steps": 3},
    "best": {}, "jitter": {}, "random": {}, "gp": {"rounds": 5, "folds": 2},
    "auto": {"hidden": (8,), "steps": 4, "networks_from": 50},
}  # fmt: skip


@cache
def designs() -> Designs:
    """A slope in two numbers and a level."""
    rng = np.random.default_rng(0)
    x = np.stack([rng.uniform(-2, 2, 100), rng.uniform(0, 5, 100), rng.integers(0, 3, 100)], 1)
    y = x[:, 0] + 0.5 * x[:, 1] + x[:, 2]
    return Designs.from_arrays(x, y, [Variable("a", low=-50, high=50), Variable("b", low=-50, high=50),
                                      Variable("c", "categorical", levels=tuple("xyz"))])  # fmt: skip


def design(name: str) -> Numbers:
    """Eight designs, and what is believed of them."""
    found = designer(name, **DESIGNS[name]).propose(designs(), 8, seed=3, distinct=False)
    believed = {"predicted": found.predicted.tolist()} if found.predicts else {}
    # Later ones of the default's batch are nearly tied: which of them are taken differs between makes of processors.
    x = found.x[:2] if name == "auto" else found.x
    return {f"variable {i}": column.tolist() for i, column in enumerate(x.T)} | believed


PENDULUM = task("inverted-pendulum")
ONLINE = Online(copies=2, explore=20, updates_per_step=0.25, block=8)
MODEL = {"model_hidden": (8,), "model_weight_decay": (), "members": 2, "elites": 2, "model_epochs": 1, "model_train_freq": 8}
OF_THEIR_OWN = {
    "cal_ql": {"critic_hidden": (8,), "samples": 2}, "rlpd": {"critics": 3, "policy_freq": 2},
    "mbpo": {"rollouts_per_step": 2, "retain_steps": 16}, "slbo": {"rollouts": 2, "rollout_length": 4},
    "pets": {"horizon": 2, "population": 6, "cem_elites": 2, "cem_iterations": 1, "particles": 2},
}  # fmt: skip


def online(name: str, beside: bool = False) -> Numbers:
    """Two blocks of acting and learning, alone or beside a log."""
    kind, updates = agent_class(name), 4
    sizes = {} if name == "pets" else {"hidden": (8,), "batch_size": 16}
    sizes |= MODEL if issubclass(kind, ModelBasedAgent) else {}
    log = swinging() if beside else None
    spec = Spec.empty(PENDULUM.observation_shape, PENDULUM.action_space, PENDULUM.name) if log is None else log.spec
    made = kind(**sizes | OF_THEIR_OWN.get(name, {})).resolve(spec, updates)
    options = {} if log is None else {"log": log}
    experience = experience_of(made, beside)(PENDULUM, made, [3], updates, ONLINE, threads=1, **options)
    job = Fit([made], experience, [3], updates, 2)
    before, seen = job.states, list(job.chunks())
    assert seen[-1].failures == (None,)
    rows = np.asarray(experience.replay.buffer[0, : experience.environment_steps])
    return {
        "metrics": sorted(float(value[0]) for value in seen[-1].metrics.values()),
        "parameters": sorted_changes(before, job.states),
        "rows": np.abs(rows).mean(0).tolist(),
    }


TASKS = ("maze2d-umaze-dense", "antmaze-umaze", "hopper", "door", "kitchen-complete", "flow-ring", "battery")


def simulated(name: str) -> Numbers:
    """Forty steps of two copies, whose actions are given."""
    where = task(name)
    simulator = where.simulate([3, 4], threads=1)
    seen, rewards = [simulator.reset()], []
    for t in range(40):
        if isinstance(where.action_space, Discrete):
            actions = np.array([t, t // 2]) % where.action_space.n
        else:
            low, high = np.asarray(where.action_space.low), np.asarray(where.action_space.high)
            wave = np.sin(0.3 * t + np.arange(2)[:, None] + np.arange(len(low)))
            actions = low + (0.5 + 0.4 * wave) * (high - low)
        observations, reward, terminal, timeout = simulator.step(actions)
        seen.append(observations)
        rewards.append(reward)
        if (terminal | timeout).any():
            break
    return {"rewards": np.sum(rewards, 0).tolist(), "steps": [float(len(rewards))],
            "observations": [float(np.linalg.norm(x)) for x in (seen[0], seen[-1])]}  # fmt: skip


def evaluation(name: str) -> Numbers:
    """Episodes of two networks that have learned nothing."""
    where = task(name)
    spec = Spec.empty(where.observation_shape, where.action_space, where.name)
    nets = [create_actor(spec, (8,), jax.random.key(i)) for i in range(2)]
    policies = [EnvPolicy.of(stochastic(net), Normalizer.of(spec)) for net in nets]
    found = evaluate(policies, where, episodes=3, seed=5, greedy=False, discount=0.9)
    return {"returns": found.returns.ravel().tolist(), "discounted": found.discounted.ravel().tolist(),
            "score": [found.score(0).value, found.score(0).low, found.score(0).high]}  # fmt: skip


def intervals() -> Numbers:
    """Of fixed numbers."""
    rng = np.random.default_rng(0)
    x, influence = rng.gamma(2.0, size=(6, 30)), rng.standard_normal((40, 3)) ** 3
    influence, value = influence - influence.mean(0), np.array([1.0, 2.0, 3.0])
    by_task = {"one": x[0], "two": 2 * x[1]}
    flat = lambda *parts: [float(each) for part in parts for each in np.ravel(np.asarray(part, float))]  # noqa: E731
    ends = lambda found: (found.value, found.low, found.high)  # noqa: E731
    return {
        "means": flat(means.student(x[0]), means.hoeffding(x[0], 0, 20), means.empirical_bernstein(x[0], 0, 20)),
        "bootstrap": flat(bootstrap.percentile_interval(x.ravel(), 20.0), bootstrap.ensemble_interval(x)),
        "crossed": flat(ends(crossed.mean_interval(x)), ends(crossed.paired(x[:3], x[3:]))),
        "inference": flat(inference.intervals(value, influence), inference.gains(value, influence, 0)),
        "betting": flat(betting.lower(x)),
        "scores": flat(scores.iqm(by_task), ends(scores.interval(by_task, scores.iqm))),
    }


def judged(name: str) -> Numbers:
    """What a problem's judge says of the first designs that it shows."""
    found = problem(name)
    return {"scores": found.score(found.visible.x[:4]).true.tolist(), "shown": [found.visible.y.mean(), found.low, found.high]}


# ---- all of them, with the revisions that their numbers are of ------------------------------------------------------------


def place(made: Any) -> str:
    """Where the revision of a class stands."""
    kind = made if isinstance(made, type) else type(made)
    return f"`revision` of {kind.__name__} in src/{kind.__module__.replace('.', '/')}.py"


def method(numbers: Callable[[str], Numbers], name: str, made: Any, **more: Any) -> Run:
    """The run of a method."""
    revisions = {"method": identity.revisions(made), **identity.of_learning(), **more}
    return Run(partial(numbers, name), revisions, f"{place(made)}, or of what it shares with others")


OFFLINE = [name for name in AGENTS if agent_class(name).offline]
RUNS: dict[str, Run] = {}
for each in OFFLINE:
    RUNS[f"agents/{each}"] = method(agent, each, agent_class(each))
for each in AGENTS:
    kind = agent_class(each)
    if kind.online and not issubclass(kind, OfflineMBRL):
        acting = identity.revisions(experience_of(kind()))
        RUNS[f"online/{each}"] = method(online, each, kind, acting=acting, task=identity.revisions(PENDULUM))
INTERVALS = {"intervals": interval.REVISION}
for each in ("cal_ql", "td3_bc"):
    acting = identity.revisions(experience_of(agent_class(each)(), beside=True))
    task_of = identity.revisions(PENDULUM)
    RUNS[f"fine-tuning/{each}"] = method(partial(online, beside=True), each, agent_class(each), acting=acting, task=task_of)
for each in ESTIMATORS:
    RUNS[f"ope/{each}"] = method(ope, each, estimator(each), **INTERVALS)
RUNS["ope/is, learned"] = method(learned, "is", estimator("is"), **INTERVALS, propensities=behavior.REVISION)
RUNS["ope/fqe-linear, continuous"] = method(continuous, "fqe-linear", estimator("fqe-linear"), **INTERVALS)
for each in DESIGNERS:
    RUNS[f"mbo/{each}"] = method(design, each, designer(each))
for each in ("ackley", "branin", "hartmann6", "rastrigin", "rosenbrock", "nk"):
    known = {"problem": PROBLEMS[each].revision}
    RUNS[f"problems/{each}"] = Run(partial(judged, each), known, "its revision in src/deadreckon/mbo/problems/registry.py")
for each in TASKS:
    RUNS[f"tasks/{each}"] = Run(partial(simulated, each), {"task": identity.revisions(task(each))}, place(task(each)))
for each in ("inverted-pendulum", "battery"):
    known = identity.of_evaluation(task(each))
    RUNS[f"evaluation/{each}"] = Run(partial(evaluation, each), known, "REVISION in src/deadreckon/runs/evaluate.py")
RUNS["stats/intervals"] = Run(intervals, INTERVALS, "REVISION in src/deadreckon/stats/interval.py")
