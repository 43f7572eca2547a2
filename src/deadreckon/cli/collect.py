"""`deadreckon data collect`: known logs again, and logs of what a policy does in any simulator."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deadreckon.cli.progress import Bar
from deadreckon.errors import UserError


@dataclass
class Collect:
    """Collect a known log again on this machine, or with --task what a policy does in a simulator."""

    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")] = None
    """name of the log, such as maze2d-umaze-v1; None with --task"""
    task: str | None = None  # simulator to collect in: a task, a Gymnasium id such as gymnasium:CartPole-v1, or module:Class
    policy: Annotated[str, tyro.conf.arg(metavar="random|POLICY")] = "random"
    """policy that acts in the task: uniform actions (random), a run folder or a policy file"""
    steps: int | None = None  # number of rows; None: the full log, or 10,000 in a task
    seed: int = 0  # random seed of the collection
    out: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """file to write (.hdf5); None: the cache, where `deadreckon train --data NAME` finds it; with --task a file of its name"""
    threads: int | None = None  # threads of the simulator; None: one per core. The log does not depend on it
    force: bool = False  # whether to replace an existing file


def collect(options: Collect) -> None:
    """Collects, and prints where the log lies."""
    # Simulators and the small policies that act in them run on the processor: a GPU is left to programs that train.
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from deadreckon.collect import collect as collect_log
    from deadreckon.collect import recipe
    from deadreckon.collect.recipes import default_path

    if options.out is not None and Path(options.out).suffix.lower() not in (".hdf5", ".h5"):
        made = Path(options.out).with_suffix(".hdf5") if Path(options.out).name else "LOG.hdf5"
        how = f"`--out {made}`, then `deadreckon data convert {made} {options.out}`"
        raise UserError(f"--out {options.out}: logs are collected into .hdf5 files; {how}")
    if (options.name is None) == (options.task is None):
        raise UserError("name either a known log (see `deadreckon data list`) or --task TASK, in which a policy acts")
    if options.task is not None:
        return _in_task(options)
    assert options.name is not None
    if options.policy != "random":
        raise UserError(f"--policy {options.policy} is for --task TASK; {options.name} has its own behaviour policy")
    found = recipe(options.name)
    steps = options.steps if options.steps is not None else found.steps
    if options.out is None and not options.force and (path := default_path(found, options.steps, options.seed)).exists():
        print(f"! {path.name} is there already; --force collects it again", file=sys.stderr)
        print(path)
        return
    with Bar(f"collecting {options.name}", steps, "steps") as bar:
        path = collect_log(
            options.name, steps=options.steps, seed=options.seed, out=options.out, threads=options.threads,
            force=options.force, progress=bar,
        )  # fmt: skip
    print(path)


def _in_task(options: Collect) -> None:
    from deadreckon.collect.in_task import RANDOM, collect_in_task
    from deadreckon.runs.gather import gather

    policy, by = options.policy, None
    if policy != RANDOM:
        found = gather([policy])
        if len(found) > 1:
            files = ", ".join(str(each.file) for each in found if each.file is not None)
            raise UserError(f"{policy} has {len(found)} policies; one makes a log{f': name one of {files}' if files else ''}")
        policy, by = found[0].acting, found[0].name
    steps = 10_000 if options.steps is None else options.steps
    with Bar(f"collecting in {options.task}", steps, "steps") as bar:
        path = collect_in_task(
            options.task, policy, steps=steps, seed=options.seed, out=options.out, by=by, threads=options.threads,
            force=options.force, progress=bar,
        )  # fmt: skip
    print(path)
