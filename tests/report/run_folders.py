"""Run folders written by hand: everything a report reads, and no training."""

import json
from pathlib import Path

import numpy as np

from deadreckon.agents import AGENTS, agent_class
from deadreckon.files import write_json
from deadreckon.report.entries import Page
from deadreckon.report.rows import rows
from deadreckon.report.simulated import Comparison, compare
from deadreckon.runs.folder import Folder
from deadreckon.tasks import registry

TASK = "maze2d-umaze"
OBJECTION = "its weights rest on 1.4 episodes, 10 are needed"


def write_run(
    path: Path,
    agent: str = "bc",
    level: float = 50.0,
    *,
    task: str | None = TASK,
    seeds: int = 2,
    episodes: int = 6,
    failures: dict[int, tuple[str, int]] | None = None,
    promised: float | None = None,
    metrics: dict[str, float] | None = None,
    name: str = "maze2d-umaze-v1@dr1",
    behavior: float | None = 25.0,
    finished: bool = True,
    paths: bool = False,
    seed: int = 0,
    first: int = 0,
    online: dict[str, float] | None = None,
    copy: float | None = None,
) -> Path:
    """A run whose returns lie around `level` after 200 updates; failed lanes have NaN metrics from their step on.

    Its seeds begin with `first`; `failures` are of lanes.
    With `online` (copies, explore, updates_per_step, block) it learned in the simulator and has no log. `copy` is what the MMD
    of a copy of the log's policy stays below; of runs from before this was measured it is None.
    """
    rng = np.random.default_rng([seed, len(agent)])
    folder, lanes = Folder(path), list(range(first, first + seeds))
    failures = {first + lane: failure for lane, failure in (failures or {}).items()}
    known = None
    if task and behavior is not None:
        known = {"mean": behavior, "low": behavior - 2, "high": behavior + 2, "how": "mean logged reward per step"}
    fields = {"discount": 0.99, "hidden": [64, 64]}
    if agent in AGENTS:
        default = agent_class(agent)()
        plain = json.loads(json.dumps(vars(default), default=str))
        fields = plain | {"hidden": [64, 64]}
    config = {
        "agent": {"name": agent, "fields": fields},
        "data": {"name": name, "fingerprint": "abc123", "rows": 1000, "episodes": 10, "usable": 1000,
                 "warnings": ["3 of 1000 rows have actions out of bounds"], "behavior": known,
                 "provenance": {"source": "collected", "recipe": "maze2d-umaze-v1", "seed": 0,
                                "versions": {"mujoco": "3.11.0"}, "path": "/logs/some log.hdf5"}},
        "task": task, "seeds": lanes, "steps": 200, "evaluation": {"every": 100, "episodes": episodes},
        "versions": {"deadreckon": "0.1.0", "jax": "0.10.2", "lanes": seeds},
    }  # fmt: skip
    if online:
        config |= {"online": online, "data": {"name": f"{task}, online", "fingerprint": f"online:{task}"}}
    write_json(folder.config, config)
    failed = [list(failures[lane]) if lane in failures else None for lane in lanes]
    write_json(path / "status.json", {"step": 200, "steps": 200, "finished": finished, "failures": failed})
    for step in (50, 100, 150, 200):
        bad = np.array([lane in failures and step >= failures[lane][1] for lane in lanes])
        columns = {m: np.where(bad, np.nan, v * np.exp(-step / 100)) for m, v in (metrics or {"loss": 2.0}).items()}
        if online:
            columns["environment_steps"] = np.full(seeds, 2 * step)
        folder.write_part("metrics", step, {"step": np.full(seeds, step), "seed": np.array(lanes), **columns})
    for step in (100, 200):
        count = episodes if task else 1
        columns = {"step": np.full(seeds * count, step), "seed": np.repeat(lanes, count),
                   "episode": np.tile(np.arange(count), seeds), "mmd_to_data": np.full(seeds * count, 0.05 * len(agent)),
                   "outside_range": np.repeat([0.1 * lane for lane in range(seeds)], count)}  # fmt: skip
        if copy is not None:
            columns["mmd_of_copy"] = np.full(seeds * count, copy)
        if online:
            columns = {key: column for key, column in columns.items() if key in ("step", "seed", "episode")}
        if task:
            start = np.random.default_rng(7).normal(0, 20, episodes)  # the same starts for every run
            returns = level * step / 200 + start - start.mean() + rng.normal(0, 3, (seeds, episodes))
            score = registry.task(task).reference.normalise(returns) if task in registry.names() else returns
            columns |= {"return": returns.ravel(), "score": np.asarray(score).ravel(), "length": np.full(seeds * count, 300),
                        "discounted_return": 0.3 * returns.ravel()}  # fmt: skip
            if promised is not None:
                columns["estimated_value"] = np.full(seeds * count, promised * step / 200)
        folder.write_part("evaluations", step, columns)
    if paths:
        walk = np.cumsum(rng.normal(0, 0.004, (seeds, 8, 300, 4)), 2) + np.array([1.0, 2.0, 0, 0])
        np.savez_compressed(folder.trajectories, trajectories=walk.astype(np.float32))
        np.savez_compressed(folder.log, segments=walk[0].astype(np.float32))
    return path


def told(gains: dict[str, tuple[float, float, float]], deploy: bool = True, *, checked: bool = True, **changes) -> dict:
    """What `judge` tells of policies "RUN seed K" with these gains over a behaviour policy of 50, the first of them chosen.

    The second, where there is one, has an objection.
    """
    names = list(gains)
    values = [50 + gain for gain, _, _ in gains.values()] + [50.0]
    objections = [[OBJECTION] if i == 1 else [] for i in range(len(names))]
    gain, low, high = gains[names[0]]
    result = {
        "method": "DRL", "title": "drl (DRL)", "corrected": True, "value": values, "low": [v - 5 for v in values],
        "high": [v + 5 for v in values], "gain": [list(each) for each in gains.values()], "seconds": 1.0, "warnings": [],
        "effective": [90.0] * len(values), "diagnostics": {},
    }  # fmt: skip
    truth = {"task": TASK, "episodes": 100, "mean": [v + 1 for v in values[:-1]], "error": [1.0] * len(names)}
    return {
        "log": "maze2d-umaze-v1@dr1", "seed": 0, "truth": truth if checked else None, "results": [result],
        "estimand": {"discount": 0.99, "horizon": 300, "greedy": False, "words":
                     "expected discounted return (discount 0.99) of the first 300 steps of an episode; sampled actions"},
        "policies": [{"name": name, "run": name.split()[0], "seed": int(name[-1])} for name in names],
        "judged": {"words": "133 held-out episodes of 667", "episodes": 133, "of": 667, "fresh": True, "units": 100,
                   "cluster": None, "clusters": 133},
        "looks": {"number": 2, "policies": 7, "alpha": 0.0125, "counted": True},
        "support": {"missing": [0.04] * len(names), "ratio": [0.99] * len(names), "degenerate": [False] * len(names)},
        "choice": {"name": names[0], "deploy": deploy, "gain": [gain, low, high], "level": 0.9875,
                   "reason": f"{gain:+.2f} [{low:+.2f}, {high:+.2f}] against the behaviour policy by DRL",
                   "evidence": ["DR-linear: +9.00 [+1.00, +17.00], ranks it first, too"],
                   "warnings": [f"{names[1]}: {OBJECTION}"] if len(names) > 1 else [], "objections": objections},
    } | changes  # fmt: skip


def compared(page: Page) -> Comparison | None:
    """What the simulator says of a page's runs."""
    return compare(page, rows(page))
