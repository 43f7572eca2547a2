"""Run folders as a report sees them: columns of numbers, read without loading a policy."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.agents import AGENTS
from deadreckon.errors import UserError
from deadreckon.foreign.archive import read_arrays
from deadreckon.online import Online
from deadreckon.report.forest import SLOTS
from deadreckon.runs.folder import Folder
from deadreckon.runs.records import CROSS_FIT, checked_array, checked_rows, read_status
from deadreckon.runs.run import Run
from deadreckon.tasks import registry
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.task import Task

# How agents are written, where that is not the name of their class.
NAMES = {
    "td3_bc": "TD3+BC", "cal_ql": "Cal-QL", "bear_is": "IS-BEAR", "sac_n": "SAC-N", "kl_control": "KL-control",
    "decision_transformer": "Decision Transformer",
}  # fmt: skip
Columns = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Entry:
    """One run: a folder, or several that differ in their seeds alone.

    Attributes:
        label: unique on the page.
        folders: where its files lie, and the seeds of each.
        config: its run.json, with all seeds.
        status: its status.json, of several what holds for all of them.
        metrics: step, seed and one column a metric.
        evaluations: one row per episode (one per seed, if nothing was simulated).
    """

    label: str
    folders: tuple[tuple[Folder, list[int]], ...]
    config: dict[str, Any]
    status: dict[str, Any]
    metrics: Columns
    evaluations: Columns

    @property
    def folder(self) -> Folder:
        """The first one."""
        return self.folders[0][0]

    @property
    def agent(self) -> str:
        """The agent's registered name."""
        return self.config["agent"]["name"]

    @property
    def online(self) -> Online | None:
        """How acting and learning took turns; None of a run that learned from a log."""
        found = self.config.get("online")
        return None if found is None else Online(**found)

    def environment_steps(self, updates: int | None) -> int | None:
        """Steps that a seed had acted after so many updates; None of a run that learned from a log."""
        return None if self.online is None or updates is None else self.online.steps(updates)

    @property
    def seeds(self) -> list[int]:
        """One a lane."""
        return self.config["seeds"]

    @property
    def discount(self) -> float:
        """Of the agent's values."""
        return float(self.config["agent"]["fields"].get("discount") or 0.99)

    @property
    def behavior(self) -> dict[str, Any] | None:
        """What the behaviour policy returned over one horizon, where that is known."""
        return self.config["data"].get("behavior")

    @property
    def failed(self) -> list[tuple[int, str, int]]:
        """Seed, metric and step of each lane that diverged."""
        found = zip(self.seeds, self.status.get("failures") or [])
        return [(seed, failure[0], failure[1]) for seed, failure in found if failure]

    @property
    def last_step(self) -> int | None:
        """Updates before the last evaluation."""
        steps = self.evaluations.get("step")
        return None if steps is None or not len(steps) else int(steps.max())

    def at(self, name: str, step: int | None) -> np.ndarray | None:
        """(seeds, episodes) of an evaluation's column after `step` updates, in order of seeds and episodes."""
        table = self.evaluations
        if step is None or name not in table:
            return None
        found = []
        for seed in self.seeds:
            rows = np.flatnonzero((table["step"] == step) & (table["seed"] == seed))
            found.append(table[name][rows[np.argsort(table["episode"][rows], kind="stable")]])
        lengths = {len(values) for values in found if len(values)}
        return np.stack([values for values in found if len(values)]) if len(lengths) == 1 else None

    def last(self, name: str) -> np.ndarray | None:
        """(seeds, episodes) of the last evaluation."""
        return self.at(name, self.last_step)

    def curve(self, name: str, environment: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Steps, and (steps, seeds) values of a column of the evaluations (mean over episodes) or else of the metrics.

        Steps are updates, or `environment` steps of a run that learned online.
        """
        table = self.evaluations if name in self.evaluations else self.metrics
        if name not in table:
            return np.zeros(0), np.zeros((0, len(self.seeds)))
        steps = np.unique(table["step"])
        sums, counts = np.zeros((2, len(steps), len(self.seeds)))
        where = np.searchsorted(steps, table["step"])
        for lane, seed in enumerate(self.seeds):
            mine = table["seed"] == seed
            np.add.at(sums[:, lane], where[mine], table[name][mine])
            np.add.at(counts[:, lane], where[mine], 1)
        values = np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
        shown = [self.environment_steps(int(step)) for step in steps] if environment else steps
        return np.asarray(shown, float), values

    @cached_property
    def segments(self) -> np.ndarray | None:
        """(stretches, steps, dimensions) of the log, if they were kept."""
        return _array(self.folder.log, "segments", ("stretches", "steps", "dimensions"))

    @cached_property
    def trajectories(self) -> np.ndarray | None:
        """(seeds, episodes, steps, dimensions) of the last policies, if they were recorded; in traffic (..., cars, numbers)."""
        name = self.config["task"]
        of_cars = name in registry.names() and isinstance(registry.task(name), Flow)
        shape = ("seeds", "episodes", "steps", *(("cars", "numbers") if of_cars else ("dimensions",)))
        found = [_array(folder.trajectories, "trajectories", shape) for folder, _ in self.folders]
        shapes = {None if each is None else each.shape[1:] for each in found}
        # pyrefly: ignore[no-matching-overload] - none of them is None then
        return np.concatenate(found) if None not in shapes and len(shapes) == 1 else None


@dataclass(frozen=True)
class Page:
    """The runs of one report, all of one task (or all without), and what their policies were estimated at from the log."""

    entries: tuple[Entry, ...]
    estimates: dict[str, Any] | None = None

    @property
    def task_name(self) -> str | None:
        """What the runs were judged in."""
        return self.entries[0].config["task"]

    @property
    def task(self) -> Task | None:
        """The task itself, unless it is a private one that is not registered here, or that its name does not find."""
        found = self.task_name in registry.names() and "task_fields" not in self.entries[0].config
        return registry.task(self.task_name) if found else None

    @property
    def online(self) -> bool:
        """Whether all runs learned in the simulator and none from a log."""
        return all(e.online for e in self.entries)

    @property
    def across(self) -> str:
        """What curves are drawn against."""
        return "environment steps" if self.online else "updates"

    def slot(self, entry: Entry) -> int:
        """Which colour an entry has."""
        return self.entries.index(entry) % SLOTS


def read(runs: Sequence[Path | str | Run]) -> Page:
    """Reads run folders, each once however often it is named. Those that differ in their seeds alone are one run.

    Raises:
        UserError: nothing to show, a path that is not a run, or runs of different tasks.
    """
    runs = [runs] if isinstance(runs, (str, Path, Run)) else list(runs)
    paths = list(dict.fromkeys(run.path if isinstance(run, Run) else Path(run) for run in runs))
    if not paths:
        raise UserError("nothing to report: name at least one run folder")
    # Of a cross-fit the runs of its folds are shown.
    paths = [run for path in paths for run in (sorted(path.glob("fold*")) if (path / CROSS_FIT).exists() else [path])]
    raw = [(path, _config(path)) for path in paths]
    # Not by `task_registered`, which runs on logs do not note.
    tasks = {(config["task"], json.dumps(config.get("task_fields"), sort_keys=True)): (path, config)
             for path, config in reversed(raw)}  # fmt: skip
    if len(tasks) > 1:
        said = ", ".join(f"{path} is {_task_of(config)}" for path, config in tasks.values())
        raise UserError(f"a report shows runs of one task: {said}; write one report for each")
    groups: dict[str, list[tuple[Path, dict[str, Any]]]] = {}
    for path, config in raw:
        groups.setdefault(_but_for_seeds(config), []).append((path, config))
    alike = [part for group in groups.values() for part in _of_different_seeds(group)]
    entries = [_entry(group, label) for group, label in zip(alike, _labels([group[0] for group in alike]))]
    if not any(e.metrics or e.evaluations for e in entries):
        raise UserError(f"nothing to report: {', '.join(map(str, paths))} has no metrics yet")
    return Page(tuple(entries))


def _task_of(config: dict[str, Any]) -> str:
    other = " with other fields" if "task_fields" in config else ""
    return "without a task" if config["task"] is None else f"{config['task']}{other}"


def _config(path: Path) -> dict[str, Any]:
    config = Folder(path).config
    if not config.exists():
        estimates = (Path(path) / "estimates.json").exists()
        does = ", but estimates: name the runs, with --estimates before this folder" if estimates else ""
        raise UserError(f"{path} holds no run (no run.json){does}")
    return Folder(path).read_config()


def _written(agent: str) -> str:
    known = AGENTS.get(agent)
    return NAMES.get(agent) or (known[1] if known else agent.rpartition(":")[2])


def _way(config: dict[str, Any]) -> str:
    return "" if "online" not in config else " fine-tuned" if "start" in config else " online"


def _labels(raw: list[tuple[Path, dict[str, Any]]]) -> list[str]:
    names = [_written(c["agent"]["name"]) + _way(c) for _, c in raw]
    labels = [name if names.count(name) == 1 else f"{name} ({path.name})" for name, (path, _) in zip(names, raw)]
    return [label if labels.count(label) == 1 else f"{label} #{i + 1}" for i, label in enumerate(labels)]


def _but_for_seeds(config: dict[str, Any]) -> str:
    versions = {name: value for name, value in config.get("versions", {}).items() if name != "lanes"}
    # Which runs shared a program says no more of what was asked for than the number of lanes.
    return json.dumps(config | {"seeds": None, "versions": versions, "together": None}, sort_keys=True)


def _of_different_seeds(group: list[tuple[Path, dict[str, Any]]]) -> list[list[tuple[Path, dict[str, Any]]]]:
    """The runs together, or each for itself where a seed is in two of them."""
    seeds = [seed for _, config in group for seed in config["seeds"]]
    return [group] if len(set(seeds)) == len(seeds) else [[one] for one in group]


def _entry(group: list[tuple[Path, dict[str, Any]]], label: str) -> Entry:
    folders = tuple((Folder(path), config["seeds"]) for path, config in group)
    config = group[0][1] | {"seeds": [seed for _, config in group for seed in config["seeds"]]}
    paths = [folder.status for folder, _ in folders]
    found = [
        read_status(path, len(config["seeds"])) if path.exists() else {"step": 0, "finished": False}
        for path, (_, config) in zip(paths, group)
    ]
    failures = [f for each, (_, seeds) in zip(found, folders) for f in each.get("failures") or [None] * len(seeds)]
    status = {
        "step": min(each.get("step", 0) for each in found), "failures": failures,
        "finished": all(each.get("finished") for each in found),
    }  # fmt: skip
    tables = [_columns([folder for folder, _ in folders], kind) for kind in ("metrics", "evaluations")]
    return Entry(label, folders, config, status, *tables)


def _columns(folders: Sequence[Folder], kind: str) -> Columns:
    tables = []
    for folder in folders:
        tables.append(checked_rows(folder.path / kind, kind, folder.table(kind)))
    table = pa.concat_tables([table for table in tables if len(table)] or tables[:1], promote_options="permissive")
    return {name: table[name].to_numpy() for name in table.column_names}


def _array(path: Path, name: str, shape: tuple[str, ...]) -> np.ndarray | None:
    """An array of at least two numbers of a thing, which are its place; None where it was not kept."""
    if not path.exists() or (found := read_arrays(path, "arrays of a run").get(name)) is None:
        return None
    return checked_array(path, name, found, shape, 2)
