"""Makes the package's policies from runs, and measures their values.

`python -m deadreckon.runs.publish --run RUN --medium STEP --expert STEP` writes `policies/library/TASK.json` and `TASK/*.npz`.
Without these two options it ships only the eleven snapshots, for tasks whose logs have other behaviour policies. Measurements
are saved as they are made: after an interruption, the same command continues.
"""

import dataclasses
import itertools
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.provenance import Provenance
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.names import safe_name
from deadreckon.online import Online, replay_log
from deadreckon.policies import library, store
from deadreckon.policies.library import Returns
from deadreckon.runs.folder import Folder
from deadreckon.runs.measuring import Measuring, measured_enough
from deadreckon.tasks.registry import task as find_task


@dataclass(kw_only=True)
class Shipping(Measuring):
    """Settings for measuring policies, and the folder in which they are shipped."""

    out: str = str(library.ROOT)  # folder of the library


@dataclass
class Publish(Shipping):
    """Ship the policies of a run, with their true returns."""

    run: str  # folder of a run with seed 0 alone, online or on a log
    medium: int | None = None  # updates after which the policy was medium; None: ship none, and make no medium-replay
    expert: int | None = None  # updates after which it was best; None: ship none
    updates: int | None = None  # of the run, over which the snapshots are spread; None: all


class Kept(NamedTuple):
    """A policy of a run.

    Attributes:
        file: its path.
        updates: number of updates after which it was stored.
        environment_steps: number of environment steps after which it was stored.
        agent: name of its agent.
        key: identifies its measurements.
    """

    file: Path
    updates: int
    environment_steps: int
    agent: str
    key: str


def publish(options: Publish, watch: Callable[[str], None] = lambda line: None) -> Path:
    """Writes the policies of one run and measures them.

    Returns:
        The JSON file about them.

    Raises:
        UserError: seeds other than 0 alone, `medium` for a run on a log, or no policy that was stored after these updates.
    """
    folder = Folder(Path(options.run))
    config = folder.read_config()
    # The recipe of medium-replay assumes that the policies come from the run with seed 0.
    if config["seeds"] != [0]:
        raise UserError(f"{options.run}: a run of seed 0 alone is needed")
    online = config.get("online")
    if online is None and options.medium is not None:
        raise UserError(f"{options.run} was trained on a log: it has no medium-replay, leave medium out")
    total, task = options.updates or config["steps"], safe_name(str(config["task"]), f"{options.run}: task")
    # Runs on a log do not store their initial policy.
    parts = library.SNAPSHOTS - 1 if online else library.SNAPSHOTS
    spaced = [round((i + (online is None)) * total / parts) for i in range(library.SNAPSHOTS)]
    wanted = {f"snapshot-{i:02d}": step for i, step in enumerate(spaced)}
    chosen = {"medium": options.medium, "expert": options.expert}
    wanted |= {name: step for name, step in chosen.items() if step is not None}
    _check_kept(folder, options.run, wanted.values())
    if 0 in (options.medium, options.expert):
        raise UserError("medium and expert are updates after which a policy was kept, above 0")
    steps = Online(**online).steps if online else lambda updates: 0
    run = {"agent": config["agent"]["fields"], "online": online, "seed": 0, "updates": total,
           "environment_steps": steps(total), "versions": config["versions"]}  # fmt: skip
    run |= {} if online else {"data": {key: config["data"][key] for key in ("name", "fingerprint")}}
    run |= {key: config[key] for key in ("demonstrations",) if key in config}
    agent = config["agent"]["name"]
    made: dict[str, Any] = {"task": task, "agent": agent, "run": run}
    if online and options.medium is not None:
        made["medium_replay"] = _replay(folder, task, online["copies"], steps(options.medium))
    # Medium and expert may be snapshots too, which are measured once.
    kept = {name: Kept(folder.policy(0, step), step, steps(step), agent, str(step)) for name, step in wanted.items()}
    return _ship(task, made, kept, ("sampled", "greedy"), options, watch, folder.episodes("taught"))


def publish_runs(
    runs: Mapping[str, Path], steps: Sequence[int], options: Shipping, watch: Callable[[str], None] = lambda line: None
) -> Path:
    """Writes policies of several runs on one log and measures them, with sampled actions.

    Args:
        runs: folders by the names of their policies; all seeds of each are shipped.
        steps: updates after which policies were stored.
        options: of measuring.
        watch: called with a line for each measurement.

    Returns:
        The JSON file about them.

    Raises:
        UserError: no policy was stored after these updates, or the runs are on several logs, have different held-out episodes,
            or are online.
    """
    folders = {name: Folder(Path(path)) for name, path in runs.items()}
    configs = {name: folder.read_config() for name, folder in folders.items()}
    logs = {(c["task"], c["data"]["name"], c["data"]["fingerprint"]) for c in configs.values()}
    if len(logs) != 1:
        raise UserError(f"runs on one log are needed, these are on {len(logs)}: {', '.join(sorted(log[1] for log in logs))}")
    [(called, log, fingerprint)] = logs
    for name, folder in folders.items():
        _check_kept(folder, str(runs[name]), steps)
    for name, config in configs.items():
        if config.get("online"):
            raise UserError(f"{runs[name]} was trained online; runs on a log are needed")
    task = safe_name(str(called), f"{next(iter(runs.values()))}: task")
    facts = "agent", "seeds", "steps", "versions"
    run = {
        "data": {"name": log, "fingerprint": fingerprint, "holdout": next(iter(configs.values()))["data"].get("holdout")},
        "runs": {name: {fact: config[fact] for fact in facts} for name, config in configs.items()},
    }  # fmt: skip
    kept = {}
    for (name, config), step in itertools.product(configs.items(), steps):
        for seed in config["seeds"]:
            key = f"{name}-{seed}-{step}"
            kept[key] = Kept(folders[name].policy(seed, step), step, 0, config["agent"]["name"], key)
    if len({tuple(sorted(_taught(each.file))) for each in kept.values()}) > 1:
        raise UserError("the runs have different training episodes of their log; train them with the same holdout")
    return _ship(task, {"task": task, "run": run}, kept, ("sampled",), options, watch)


def _taught(file: Path) -> list[int]:
    ids = store.load_all(file).taught
    return [] if ids is None else ids.tolist()


def _check_kept(folder: Folder, run: str, steps: Iterable[int]) -> None:
    kept = folder.policy_steps()
    if missing := [step for step in steps if step not in kept]:
        raise UserError(f"{run}: no policy was kept after {missing[0]} updates; those kept are {kept}")


def _ship(
    task: str, made: dict[str, Any], kept: Mapping[str, Kept], modes: Sequence[str], options: Shipping,
    watch: Callable[[str], None], taught: np.ndarray | None = None,
) -> Path:  # fmt: skip
    """Writes policies by name, and their returns in each mode; `made` is the part of the JSON file about their runs, and
    `taught` the ids of the training episodes, for policies whose files have none."""
    # The existing library stays complete until the new one is.
    out, work = Path(options.out), Path(options.out) / f".{task}.part"
    state, published = work / "about.json", out / f"{task}.json"
    about = read_json(state if state.exists() else published, dict) if state.exists() or published.exists() else {}
    run = made["run"]
    measured: dict[str, dict[str, Any]] = about.get("measured") or _measured(about, kept)
    if about.get("run", run) != run:
        measured = {}

    wanted: dict[tuple[str, str], Path | None] = {("uniform", "sampled"): None}
    for name, each in kept.items():
        # The policy is measured as it is shipped: as it is read back from float16.
        meta = {"task": task, "name": name, "updates": each.updates, "agent": each.agent}
        saved = store.load_all(each.file)
        ids = {"taught": taught if saved.taught is None else saved.taught, "held": saved.held}
        store.save(work / f"{name}.npz", saved.policy, meta, half=True, **ids)
        wanted |= {(each.key, mode): work / f"{name}.npz" for mode in modes}

    def keep(key: str, mode: str, returns: Returns) -> None:
        measured.setdefault(key, {})[mode] = dataclasses.asdict(returns)
        write_json(state, {"run": run, "measured": measured})
        watch(f"{task} {key} {mode}: {returns.mean:.1f} +- {returns.error:.1f}")

    known = {(key, mode): Returns(**found) for key, modes_of in measured.items() for mode, found in modes_of.items()}
    worth = measured_enough(task, wanted, known, options, keep)
    uniform = dataclasses.asdict(worth["uniform", "sampled"])
    policies = {
        name: {"updates": each.updates, "environment_steps": each.environment_steps}
        | {mode: dataclasses.asdict(worth[each.key, mode]) for mode in modes}
        for name, each in kept.items()
    }
    (out / task).mkdir(parents=True, exist_ok=True)
    for name in policies:
        (work / f"{name}.npz").replace(out / task / f"{name}.npz")
    write_json(published, made | {"uniform": uniform, "policies": policies})
    shutil.rmtree(work)
    return published


def _measured(about: dict[str, Any], kept: Mapping[str, Kept]) -> dict[str, dict[str, Any]]:
    """Measurements in a published library, by the keys of the policies."""
    keys = {each.key for each in kept.values()}
    found = {
        name if name in keys else str(each["updates"]): {mode: each[mode] for mode in ("sampled", "greedy") if mode in each}
        for name, each in about.get("policies", {}).items()
    }
    return found | ({"uniform": {"sampled": about["uniform"]}} if "uniform" in about else {})


def _replay(folder: Folder, task: str, copies: int, steps: int) -> dict[str, Any]:
    """Length and mean return of the log of the run's first `steps` environment steps."""
    log = replay_log(folder.replay(0), find_task(task), copies, steps, name=task, provenance=Provenance())
    return {"environment_steps": steps, "episodes": log.episodes, "mean": float(log.returns().mean())}


if __name__ == "__main__":
    import tyro

    print(publish(tyro.cli(Publish), watch=print))
