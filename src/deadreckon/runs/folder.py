"""The run folder: the paths of its files, each of which is written completely or not at all.

    run.json            the settings (agent, data, task, seeds, steps) and versions
    status.json         updates done, failures, whether it is finished
    metrics/N.parquet   one immutable part per chunk, N updates done: step, seed, one column per metric
    checkpoints/N.npz   the newest states, see `training.checkpoint`
    policies/N-seedS.npz   the policies that were evaluated after N updates; policies/seedS.npz is the last
    episodes.npz        `episode_ids` of the training episodes (taught) and of others (held); of an online run, whose own
                        episodes are among them, once it has finished
    log.npz             segments of the log, for figures
    evaluations/N.parquet  one row per episode; evaluations/trajectories.npz of the last policies
    replay/seedS.bin    online: every environment step, see `online.exploration`; the newest checkpoint says how many count

Runs that share a program, because they differ in float settings alone, have folders like this one side by side, and a common
folder of checkpoints beside them.
"""

import contextlib
import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from deadreckon.agents import AGENTS, agent_class, plugins
from deadreckon.errors import UserError, reading
from deadreckon.files import alone, replacing, write_json
from deadreckon.foreign.archive import read_arrays
from deadreckon.foreign.door import refuse_link, refuse_links
from deadreckon.foreign.parquet import read_parquet
from deadreckon.interrupts import resumable
from deadreckon.runs.records import read_run
from deadreckon.temporaries import clear
from deadreckon.training.field_names import with_field_names
from deadreckon.versions import differences

_WHAT = "a run's folder"
TRACKED = "wandb"  # folder of Weights & Biases within a run's, in which it puts a link to its own log


@dataclass(frozen=True)
class Folder:
    """Paths and files of one run."""

    path: Path

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Lets one process at a time write here; another is refused with a `BusyError`. An interrupted run can be resumed."""
        place = Path(os.path.realpath(self.path))  # the same by whatever links and spellings it is reached
        if not place.name:
            raise UserError(f"{self.path} is the root of all folders; choose another --out")
        with alone(place.with_name(f"{place.name}.run"), what=str(self.path)), resumable(self.config):
            refuse_links(self.path, _WHAT, TRACKED)  # by links, files outside of the folder could be written or removed
            yield

    @property
    def config(self) -> Path:
        """Path of the settings."""
        return self.path / "run.json"

    @property
    def status(self) -> Path:
        """Path of the progress."""
        return self.path / "status.json"

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.path / "checkpoints"

    def policy(self, seed: int, step: int | None = None) -> Path:
        """Path of the policy of a seed, after `step` updates or at the end."""
        return self.path / "policies" / (f"seed{seed}.npz" if step is None else f"{step:010d}-seed{seed}.npz")

    def policy_steps(self) -> list[int]:
        """Updates after which policies were stored, ascending."""
        names = (re.match(r"(\d+)-seed", p.name) for p in (self.path / "policies").glob("*-seed*.npz"))
        return sorted({int(m[1]) for m in names if m})

    def has_policies(self) -> bool:
        """Whether the folder holds a run that has the last policy of every seed."""
        return self.config.exists() and all(self.policy(seed).exists() for seed in self.read_config()["seeds"])

    @property
    def log(self) -> Path:
        """Path of the segments of the log, for figures."""
        return self.path / "log.npz"

    def note_episodes(self, taught: np.ndarray, held: np.ndarray, *, anew: bool = False) -> None:
        """Writes the ids of the training episodes, (learning,) uint64, and of others, (held,), unless ids are written already;
        with `anew` also if these differ."""
        before = self.episodes("taught")
        if before is None or (anew and not np.array_equal(before, taught)):
            with replacing(self._episodes) as temporary, open(temporary, "wb") as file:
                np.savez(file, taught=taught, held=held)

    @property
    def _episodes(self) -> Path:
        return self.path / "episodes.npz"

    def episodes(self, which: str) -> np.ndarray | None:
        """The ids that `note_episodes` wrote, `taught` or `held`; None if there are none yet, as before an online run's end.

        Raises:
            UserError: the file is damaged.
        """
        if not (path := self._episodes).exists():
            return None
        found = read_arrays(path, "a note of episodes").get(which)
        if found is None or found.dtype != np.uint64 or found.ndim != 1:
            raise UserError(f"{path}: {which} must be a list of ids of episodes; the file is damaged or of another kind")
        return found

    def replay(self, seed: int) -> Path:
        """Path of the environment steps of a seed of an online run."""
        return self.path / "replay" / f"seed{seed}.bin"

    @property
    def trajectories(self) -> Path:
        """Path of the observations of the last policies' first episodes."""
        return self.path / "evaluations" / "trajectories.npz"

    def part(self, kind: str, step: int) -> Path:
        """Path of the table of `kind` ("metrics" or "evaluations") written after `step` updates."""
        return self.path / kind / f"{step:010d}.parquet"

    def write_part(self, kind: str, step: int, columns: dict[str, Any]) -> None:
        """Writes one immutable part; writing it again after an interruption gives the same."""
        refuse_link(self.path / kind, _WHAT)
        with replacing(self.part(kind, step)) as temporary:
            pq.write_table(pa.table(columns), temporary)

    def table(self, kind: str) -> pa.Table:
        """All parts of a kind as one table, in order of steps; empty if there are none."""
        parts = sorted((self.path / kind).glob("*.parquet"))
        read = [_part(each, kind) for each in parts]
        with reading(self.path / kind, "tables of a run"):
            return pa.concat_tables(read, promote_options="default") if read else pa.table({})

    def drop_after(self, step: int) -> None:
        """Removes what an interrupted run wrote after its last checkpoint, and temporary files of processes that have ended.

        Raises:
            UserError: a file or a link that is not the run's.
        """
        refuse_links(self.path, _WHAT, TRACKED)
        for kind in ("metrics", "evaluations"):
            for path in (self.path / kind).glob("*.parquet"):
                if not re.fullmatch("[0-9]+", path.stem):
                    raise UserError(f"{path}: files of {kind} are named after a number of updates; remove this file")
                if int(path.stem) > step:
                    path.unlink()
        for folder in (self.path, *self.path.glob("*/")):
            clear(folder)

    def read_config(self) -> Any:
        """The configuration in run.json, with hyperparameters under the current names of their fields."""
        config = read_run(self.config)
        if (kind := _agent_of(config)) is None:
            return config
        return config | {"agent": {**config["agent"], "fields": with_field_names(kind, config["agent"]["fields"])}}

    def is_free(self) -> bool:
        """Whether there is nothing here, or only what a process that was killed while it wrote its first file leaves."""
        return not self.path.exists() or (self.path.is_dir() and all(p.suffix == ".tmp" for p in self.path.iterdir()))

    def period(self, resume: bool) -> int | None:
        """Updates between the evaluations of the run that is resumed, its default; None for a new run."""
        before = self.read_config() if resume and self.config.exists() else {}
        return before.get("evaluation", {}).get("every")

    def check(self, config: dict[str, Any], *, resume: bool) -> list[str]:
        """Checks whether a run may begin here, or be resumed with these settings, which may be more updates of the same.

        Returns:
            Differences that do not forbid a resume: versions and threads, one line each.

        Raises:
            UserError: the folder holds a run already, another run, or something else.
        """
        if not self.config.exists():
            if not self.is_free():
                raise UserError(f"{self.path} exists and is not a run; choose another --out")
            return []
        if not resume:
            raise UserError(f"{self.path} holds a run already; --resume continues it, or choose another --out")
        before = self.read_config()
        asked = _at_length(config, before)
        kept = ("together", "agent", "online", "demonstrations", "start", "log", "data", "task", "task_fields", "seeds",
                "task_registered", "steps", "evaluation", "history", "encoder", "shift")  # fmt: skip
        if different := differences(before, asked, kept):
            do = "choose another --out" if asked is config else _remedy(before, different)
            raise UserError(f"{self.path} holds another run: {different[0]}; {do}")
        if "revisions" not in before:  # older than their record: random streams have changed since
            why = "was started by code of other revisions, which trains differently"
            raise UserError(f"{self.path} {why}; start again with another --out")
        if different := differences(before, asked, ("revisions",)):
            raise UserError(f"{self.path} was started by code that trains differently: {different[0]}; choose another --out")
        return [
            f"{text}: the last bits of the numbers may differ from those of an unbroken run"
            for text in differences(before, config, ("versions",))
        ]

    def begin(self, config: dict[str, Any]) -> None:
        """Writes run.json, where there is none yet."""
        if not self.config.exists():
            write_json(self.config, config)

    def shorten(self, steps: int) -> None:
        """Records that the run has ended with fewer updates than were requested."""
        write_json(self.config, read_run(self.config) | {"steps": steps})

    def lengthen(self, config: dict[str, Any]) -> None:
        """Records that more updates are requested than the run has had; called once it is certain that it can be resumed."""
        before = read_run(self.config)
        if before["steps"] < config["steps"]:
            write_json(self.status, {"step": before["steps"], "steps": config["steps"], "finished": False})
            for number in config["seeds"]:
                self.policy(number).unlink(missing_ok=True)  # with it, the run is no longer finished
            if "online" in config:  # it will have more episodes of its own
                self._episodes.unlink(missing_ok=True)
            write_json(self.config, before | {name: config[name] for name in ("steps", "evaluation")})


def _at_length(config: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """The requested settings with the number of updates of an earlier run, if that had fewer; otherwise unchanged.

    Periods of evaluations beyond the end of the earlier run are equivalent, and its period is used.
    """
    steps = before.get("steps", 0)
    if steps >= config["steps"]:
        return config
    asked, old, new = config | {"steps": steps}, (before.get("evaluation") or {}).get("every"), config["evaluation"]["every"]
    return asked | {"evaluation": config["evaluation"] | {"every": old}} if old and min(old, new) >= steps else asked


def _agent_of(config: dict[str, Any]) -> type[Any] | None:
    """The class of a run's agent; None if it is not imported, because a folder must not choose code that is executed."""
    name = config["agent"]["name"]
    module, colon, _ = ("", "", "") if name in AGENTS else str(plugins().get(name, name)).partition(":")
    return agent_class(name) if name in AGENTS or (colon and module in sys.modules) else None


def _remedy(before: dict[str, Any], different: Sequence[str]) -> str:
    """Advice for the error if these settings differ from those of a run that is to be trained for longer."""
    names, fields = [text.partition(" was ")[0] for text in different], before["agent"]["fields"]
    kept = [each for each in getattr(_agent_of(before), "by_length", ()) if f"agent.fields.{each}" in names]
    if len(kept) < len(names):
        return "choose another --out"
    options = " ".join(f"--agent.{each.replace('_', '-')} {fields[each]}" for each in kept)
    return f"it follows from the run's length; {options} keeps it, or choose another --out"


def _part(path: Path, kind: str) -> pa.Table:
    """One part of a table: columns of numbers with different names, among them the step.

    Raises:
        UserError: the file is damaged or of another kind.
    """
    found = read_parquet(path, "a table of a run")
    names = found.column_names
    kinds = pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean
    numbers = all(any(test(each) for test in kinds) for each in found.schema.types)
    if len(set(names)) < len(names) or not {"step", "seed"} <= set(names) or not numbers:
        raise UserError(f"{path}: {kind} are columns of numbers with names of their own, among them step and seed; "
                        "the file is damaged or of another kind")  # fmt: skip
    return found


def policy_seed(name: str, seeds: Sequence[int], failures: Sequence[Any], seed: int | None) -> int:
    """The seed of a run whose policy is used: the requested one, or else the first that has not failed.

    Args:
        name: of the run, for errors.
        seeds: its seeds.
        failures: of each, None if it has not failed.
        seed: the requested one, or None.

    Raises:
        UserError: the run has no such seed, or all have failed.
    """
    if seed is not None and seed not in seeds:
        raise UserError(f"{name} has no policy of seed {seed}; its seeds are {', '.join(map(str, seeds))}")
    healthy = [each for each, failure in zip(seeds, failures) if failure is None]
    if seed is None and not healthy:
        raise UserError(f"all seeds of {name} have failed; name one to use its last policy from before the failure")
    return healthy[0] if seed is None else seed
