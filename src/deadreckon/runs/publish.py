"""Makes the behaviour policies that come with the package from online runs, and measures what they are worth.

`python -m deadreckon.runs.publish RUN --medium STEP --expert STEP` writes `policies/library/TASK.json` and `TASK/*.npz`. What
has been measured is kept as it goes: after a kill, the same command goes on.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.collect.online import Online, replay_log
from deadreckon.data.dataset import Provenance
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.policies import library, store
from deadreckon.policies.library import Returns
from deadreckon.policies.policy import BlackBoxPolicy
from deadreckon.runs.evaluate import Evaluation, evaluate
from deadreckon.runs.folder import Folder
from deadreckon.tasks.registry import task as find_task

DISCOUNT = 0.995  # DOPE's


@dataclass
class Publish:
    """Ship the policies of an online run, with their true returns."""

    run: str  # folder of an online run with one seed
    medium: int  # updates after which the policy was medium
    expert: int  # updates after which it was best
    updates: int | None = None  # of the run, over which the snapshots are spread; None: all
    episodes: int = 1000  # a policy, each with drawn and with mean actions
    error: float = 0.666  # standard error of the discounted return below which measuring stops (thesis 8.2)
    most: int = 1000  # episodes at most, whatever the error
    out: str = str(library.ROOT)  # folder of the library
    seed: int = 1_000_000  # of the episodes; training evaluates on others


def publish(options: Publish, watch: Callable[[str], None] = lambda line: None) -> Path:
    """Writes the policies and measures them.

    Returns:
        The JSON file about them.

    Raises:
        UserError: no online run of one seed, or no policy was kept after those updates.
    """
    folder = Folder(Path(options.run))
    config = read_json(folder.config)
    if "online" not in config or len(config["seeds"]) != 1:
        raise UserError(f"{options.run}: an online run of one seed is needed")
    seed, total, task = config["seeds"][0], options.updates or config["steps"], config["task"]
    spaced = [round(i * total / (library.SNAPSHOTS - 1)) for i in range(library.SNAPSHOTS)]
    wanted = {f"snapshot-{i:02d}": step for i, step in enumerate(spaced)}
    wanted |= {"medium": options.medium, "expert": options.expert}
    kept = folder.policy_steps()
    if missing := [step for step in wanted.values() if step not in kept]:
        raise UserError(f"{options.run}: no policy was kept after {missing[0]} updates; those kept are {kept}")
    steps = Online(**config["online"]).steps

    out = Path(options.out)
    path = out / f"{task}.json"
    about = read_json(path) if path.exists() else {}
    run = {"agent": config["agent"]["fields"], "online": config["online"], "seed": seed, "updates": total,
           "environment_steps": steps(total), "versions": config["versions"]}  # fmt: skip
    if about.get("run") != run:
        about = {"task": task, "run": run, "policies": {}}
    about["medium_replay"] = _replay(folder, seed, task, config["online"]["copies"], steps(options.medium))
    if about.get("uniform", {"episodes": 0})["episodes"] < options.episodes:
        about["uniform"] = dataclasses.asdict(_measure(_uniform(task), task, False, options))
        write_json(path, about)
        watch(f"{task} uniform: {about['uniform']['mean']:.1f} +- {about['uniform']['error']:.1f}")
    about["policies"] = {n: each for n, each in about["policies"].items() if each["updates"] == wanted.get(n)}
    for name, step in wanted.items():
        file = out / task / f"{name}.npz"
        entry = about["policies"].setdefault(name, {"updates": step, "environment_steps": steps(step)})
        if "greedy" not in entry or not file.exists():
            # What is measured is what is shipped: the policy as it is read back from float16.
            meta = {"task": task, "name": name, "updates": step, "agent": config["agent"]["name"]}
            store.save(file, store.load(folder.policy(seed, step)), meta, half=True)
        # The expert is often the last snapshot: measured once.
        done = (n for n, each in about["policies"].items() if n != name and each["updates"] == step and "greedy" in each)
        twin = next(done, None)
        for mode in ("sampled", "greedy"):
            if mode in entry and entry[mode]["episodes"] >= options.episodes:
                continue
            if twin is not None:
                entry[mode] = about["policies"][twin][mode]
            else:
                entry[mode] = dataclasses.asdict(_measure(store.load(file), task, mode == "greedy", options))
            write_json(path, about)
            watch(f"{task} {name} {mode}: {entry[mode]['mean']:.1f} +- {entry[mode]['error']:.1f}")
    order = ("task", "run", "medium_replay", "uniform", "policies")
    about["policies"] = {name: about["policies"][name] for name in wanted}
    write_json(path, {key: about[key] for key in order})
    return path


def _uniform(task: str) -> BlackBoxPolicy:
    space = find_task(task).action_space
    assert isinstance(space, Box)
    return BlackBoxPolicy(lambda seen, rng: rng.uniform(space.low, space.high, (len(seen), space.size)))


def _replay(folder: Folder, seed: int, task: str, copies: int, steps: int) -> dict[str, Any]:
    """Length and mean return of the log that the run's first `steps` environment steps make."""
    log = replay_log(folder.replay(seed), find_task(task), copies, steps, name=task, provenance=Provenance())
    return {"environment_steps": steps, "episodes": log.episodes, "mean": float(log.returns().mean())}


def _measure(policy: Any, task: str, greedy: bool, options: Publish) -> Returns:
    """Episodes in batches until the error bar of the discounted return is small, or there are `most`."""
    results: list[Evaluation] = []
    while True:
        seed = options.seed + len(results)
        results.append(
            evaluate(policy, find_task(task), episodes=options.episodes, seed=seed, greedy=greedy, discount=DISCOUNT)
        )
        returns, discounted, lengths = (
            np.concatenate([getattr(r, name)[0] for r in results]) for name in ("returns", "discounted", "lengths")
        )
        count = len(returns)
        error, discounted_error = (float(x.std(ddof=1) / np.sqrt(count)) for x in (returns, discounted))
        if discounted_error < options.error or count + options.episodes > options.most:
            mean, worth = float(returns.mean()), float(discounted.mean())
            return Returns(count, mean, error, worth, discounted_error, DISCOUNT, float(lengths.mean()))


if __name__ == "__main__":
    import tyro

    print(publish(tyro.cli(Publish), watch=print))
