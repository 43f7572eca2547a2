"""How well agents imitate a log with many actions at the bounds, by the likelihood that they learn by.

    python evidence/studies/cloning.py                 (some minutes; collects 200,000 steps of maze2d-umaze first)

Root mean squared error of the greedy action on the last fifth of the log, after 5,000 updates on the others. Agents that weigh
actions do so equally here: a clone is what their likelihood makes of the log.
"""

from typing import Any

import numpy as np

import deadreckon as dr
from deadreckon.agents import AWAC, AWR, BC, CRR, IQL, XQL, KLControl
from deadreckon.collect.recipes import collect
from deadreckon.data.batch import TransitionSource
from deadreckon.policies import EnvPolicy
from deadreckon.training.fit import fit

ROWS, UPDATES = 200_000, 5_000
ALIKE: dict[str, Any] = {
    "IQL": IQL(beta=0.0, actor_decay_steps=0.0), "XQL": XQL(beta=0.0, actor_decay_steps=0.0), "AWAC": AWAC(temperature=1e9),
    "CRR": CRR(filter="exp", temperature=1e9), "AWR": AWR(temperature=1e9),
    "KL-control": KLControl(behavior_steps=UPDATES, actor_lr=0.0),  # whose actor begins as its model of the log
}  # fmt: skip


def error(agent: Any, train: Any, test: Any, seed: int = 0) -> float:
    """Of the greedy action on held-out rows."""
    updates = 1 if isinstance(agent, KLControl) else UPDATES
    agent = agent.resolve(train.spec, UPDATES)
    rows = TransitionSource(train, agent.needs(train.spec))
    result = fit([agent], rows, [seed], updates)
    policy = EnvPolicy.of(agent.policy(result.lane(0)), rows.view)
    return float(np.sqrt(np.square(policy(np.asarray(test.observations)) - np.asarray(test.actions)).mean()))


def main() -> None:
    """Prints the table."""
    log = dr.read(collect("maze2d-umaze-v1", steps=ROWS))
    train, test = (
        dr.Dataset.from_arrays(
            observations=log.observations[part], actions=log.actions[part], rewards=log.rewards[part],
            terminals=log.terminals[part], action_space=log.action_space,
        )
        for part in (slice(0, ROWS * 4 // 5), slice(ROWS * 4 // 5, ROWS))
    )  # fmt: skip
    print(f"{(np.abs(np.asarray(log.actions)) >= 0.999).mean():.0%} of the action entries lie at the bounds")
    for name, model in (("tanh-Gaussian", "gaussian"), ("normal", "normal"), ("clipped Gaussian", "clipped")):
        print(f"BC, {name}: {error(BC(model=model), train, test):.3f}", flush=True)
    for name, agent in ALIKE.items():
        normal = "truncated_normal" if isinstance(agent, KLControl) else "normal"
        found = [error(agent.replace(likelihood=likelihood), train, test) for likelihood in (normal, "tanh_normal")]
        print(f"{name}: normal {found[0]:.3f}, tanh-normal {found[1]:.3f}", flush=True)


if __name__ == "__main__":
    main()
