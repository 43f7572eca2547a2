"""Why MBPO's policy does not hold on Hopper: what acts, what the critics say, and where the model errs.

A run of MBPO reaches a policy that hops to the end of an episode, and loses it again. What may be at fault is measured on one
run: returns of the mean actions that are evaluated beside those of drawn actions, from which the agent learned; what the
critics promise beside what comes of it; how far the target networks are behind; and the model's error in the last steps before
a fall beside its error elsewhere, on the data of the run's last policies, which the model has not seen.
"""

import tempfile
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from deadreckon.agents.mbpo import MBPO
from deadreckon.data.dataset import Dataset
from deadreckon.nets.mlp import minimum, q_values
from deadreckon.runs.online import reopened, train_online, turns_of
from deadreckon.training.learner import lane_of
from evidence.studies.model_returns import Options, measured, so_far
from evidence.studies.model_shift import columns_of, error_of

LATE = 0.25  # share of the evaluations, and of the policies, at the end of the run that means are of
BEFORE = 10  # steps before the end of an episode that count as a fall


def falls(case: str, *, seed: int, steps: int, updates_per_step: float, every: int = 1_000, **fields: Any) -> dict[str, float]:
    """What a run of MBPO shows of its policies, critics and model.

    Args:
        case: task to learn in.
        seed: of the run.
        steps: in the simulator.
        updates_per_step: of the policy.
        every: steps between evaluations, and between policies that are kept.
        **fields: of MBPO; those of Table B.1 where absent.

    Returns:
        best: highest mean return of an evaluation, with mean actions.
        last: mean return of the last quarter of the evaluations.
        drawn: the same of drawn actions, of the same policies.
        promised: median over these evaluations of the critics' value at the start divided by the discounted return.
        behind: mean distance of the targets' values from the critics' at the end, on what the last policy does, in standard
            deviations of the critics' values over these rows.
        error: the last model's squared error on the data of the last policies, in variances, but for the steps before falls.
        error_of_falls: the same on the last ten steps of episodes that ended in a fall; absent where none did.
    """
    settled = {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}
    settings = turns_of(MBPO, case, False, updates_per_step=updates_per_step)
    with tempfile.TemporaryDirectory() as folder:
        plan: dict[str, Any] = {"evaluate_every": every, "episodes": 10, "settings": settings}
        run = train_online(MBPO(**settled), case, steps=steps, seed=seed, out=folder, **plan)
        evaluations = {name: np.asarray(column) for name, column in run.evaluations.to_pydict().items()}
        found = measured(Options(run=str(run.path), seed=seed, policies=1 + steps // every, rows=5_000, episodes=1, horizon=1))
        state = lane_of(reopened(run.path).states, 0)
        view = run.policies[0].view

    def by_evaluation(name: str) -> np.ndarray:
        return np.array([evaluations[name][evaluations["step"] == step].mean() for step in np.unique(evaluations["step"])])

    returns = by_evaluation("return")
    late = slice(-max(1, int(LATE * len(returns))), None)
    logs = found.logs[late]
    seen = jnp.asarray(view.observe(np.asarray(logs[-1].observations)))
    action = jnp.asarray(view.to_unit(np.asarray(logs[-1].actions)))
    now, target = (minimum(q_values(net, seen, action)) for net in (state.critics, state.target_critics))
    falling = np.concatenate([_falling(log) for log in logs])
    parts = [columns_of(log) for log in logs]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    changes = columns["next_observation"] - columns["observation"]
    variance = np.append(changes.var(0), columns["reward"].var())
    errors = {
        name: error_of(found.agent.model, found.ensemble, {key: column[which] for key, column in columns.items()}, variance)
        for name, which in (("error", ~falling), ("error_of_falls", falling)) if which.any()
    }  # fmt: skip
    return {
        "best": float(returns.max()),
        "last": float(returns[late].mean()),
        "drawn": _drawn(logs),
        "promised": float(np.median((by_evaluation("estimated_value") / by_evaluation("discounted_return"))[late])),
        "behind": float(jnp.abs(target - now).mean() / now.std()),
    } | errors


def _drawn(logs: Sequence[Dataset]) -> float:
    """Mean over policies of their mean return: one that falls early has more episodes in as many rows."""
    return float(np.mean([so_far(log, int(log.lengths.max()))[-1].mean() for log in logs]))


def _falling(log: Dataset) -> np.ndarray:
    """Which rows are among the last steps of an episode that ended in a fall."""
    found = np.zeros(len(log), bool)
    for start, length in zip(log.starts, log.lengths):
        if log.terminals[start + length - 1]:
            found[start + max(0, length - BEFORE) : start + length] = True
    return found
