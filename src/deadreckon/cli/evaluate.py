"""`deadreckon evaluate`: policies of runs, or policy files, in a simulator."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from deadreckon.cli.parse import parse
from deadreckon.errors import UserError


@dataclass
class Evaluate:
    """Run policies in a simulator and print returns, scores and confidence intervals."""

    policies: Annotated[tuple[str, ...], tyro.conf.Positional]
    """run or cross-fit folders, policy files (.npz; DOPE's .pkl), or a task with policies"""
    task: str | None = None
    """simulator to evaluate in: a task, a Gymnasium id or module:Class; None: that of the run"""
    episodes: int = 100  # number of episodes per policy
    seed: int = 0  # random seed of starts and sampled actions
    sample: bool = False  # whether to sample actions instead of taking the deterministic (greedy) ones
    out: str | None = None  # Parquet file to write as well, with one row per episode


def evaluate(args: Sequence[str]) -> None:
    """Evaluates and prints."""
    options = parse(Evaluate, args, "evaluate")
    if options.out is not None and not options.out.endswith(".parquet"):
        raise UserError(f"--out writes a Parquet file, so its name must end with .parquet, got {options.out}")
    if not options.policies:
        raise UserError("missing a run folder or a policy file")

    from deadreckon.runs.evaluate import evaluate as run_evaluation
    from deadreckon.runs.gather import gather
    from deadreckon.tasks.registry import of_run
    from deadreckon.tasks.registry import task as find_task

    given = gather(options.policies)
    names, found = [each.name for each in given], sorted({each.task for each in given if each.task})
    if options.task is None and (unnamed := [each.run for each in given if each.unnamed]):
        raise UserError(f"missing --task: {unnamed[0]} was trained in a task that its name does not find")
    if options.task is None and len(found) > 1:
        raise UserError(f"the runs are of several tasks ({', '.join(found)}); evaluate those of one, or name one with --task")
    if options.task is None and not found:
        raise UserError("missing --task: the policies do not say where they belong")
    task = find_task(options.task) if options.task else of_run(found[0])
    policies = [each.acting for each in given]
    result = run_evaluation(
        policies, task, episodes=options.episodes, seed=options.seed, greedy=not options.sample, names=names
    )
    print(result)
    if options.out is not None:
        import numpy as np
        import pyarrow as pa
        import pyarrow.parquet as pq

        from deadreckon.files import replacing

        columns = {
            "policy": np.repeat(names, options.episodes), "episode": np.tile(np.arange(options.episodes), len(names)),
            "return": result.returns.ravel(), "length": result.lengths.ravel(),
        }  # fmt: skip
        if (scores := result.scores) is not None:
            columns["score"] = scores.ravel()
        with replacing(options.out) as temporary:
            pq.write_table(pa.table(columns), temporary)
