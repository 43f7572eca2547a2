"""The small world in forms that other libraries have beside their main ones, as dicts of columns."""

import layout_files
import numpy as np
from layout_files import WORLD, stacked


def ogbench_compact(world):
    """The same with `compact_dataset=True`: a row more in each trajectory, whose action is not valid."""
    more = lambda column, value: np.append(column, value).astype(np.float32)  # noqa: E731
    ends = [more(e.last, 1) for e in world]
    return {
        "observations": np.concatenate([e.observations for e in world]),
        "actions": np.concatenate([np.append(e.actions, 0) for e in world]),
        "rewards": np.concatenate([more(e.rewards, 77) for e in world]),
        "terminals": np.concatenate(ends),
        "valids": np.concatenate([more(np.ones(len(e.actions)), 0) for e in world]),
        "masks": np.concatenate([more(~(e.last & e.terminated), 1) for e in world]),
    }


def rlds_steps(world):
    """google-research/rlds, README.md (dataset format): the last step holds the last observation, its action is not valid."""
    first = [np.arange(len(e.observations)) == 0 for e in world]
    last = [np.arange(len(e.observations)) == len(e.actions) for e in world]
    return {
        "observation": np.concatenate([e.observations for e in world]),
        "action": np.concatenate([np.append(e.actions, 0) for e in world]),
        "reward": np.concatenate([np.append(e.rewards, 77) for e in world]),
        "discount": np.concatenate([np.append(1.0 - (e.last & e.terminated), 0) for e in world]),
        "is_first": np.concatenate(first),
        "is_last": np.concatenate(last),
        "is_terminal": np.concatenate([flag & e.terminated for flag, e in zip(last, world)]),
    }


def flat_file(names, extra=None):
    """WORLD as a dict of columns under other names; `extra` are further ones."""
    given = {theirs: stacked(WORLD, ours) for ours, theirs in names.items()}
    return {**given, **(extra or {})}


D4RL = {"observations": "observations", "actions": "actions", "rewards": "rewards", "next_observations": "next_observations"}
TIANSHOU = {"observations": "obs", "actions": "act", "rewards": "rew", "next_observations": "obs_next"}
TORCHRL = {
    "observations": "observation",
    "actions": "action",
    "rewards": "next.reward",
    "next_observations": "next.observation",
}
STEP = {"observations": "observation", "actions": "action", "rewards": "reward", "next_observations": "next_observation"}
CUT = {"info": {"TimeLimit.truncated": stacked(WORLD, "truncated")}}
ALIKE = {
    "Minari's names in a flat file": flat_file({**D4RL, "terminated": "terminations", "truncated": "truncations"}),
    "D4RL's names and masks": flat_file(
        {**D4RL, "terminated": "terminals", "truncated": "timeouts"}, {"masks": 1 - stacked(WORLD, "terminated")}
    ),
    "Gymnasium's name and D4RL's": flat_file({**D4RL, "terminated": "terminated", "truncated": "timeouts"}),
    "Gymnasium's names": flat_file({**D4RL, "terminated": "terminated", "truncated": "truncated"}),
    "d3rlpy 1": flat_file({**D4RL, "terminated": "terminals", "done": "episode_terminals"}),
    "Tianshou's dict": flat_file({**TIANSHOU, "terminated": "terminated", "done": "done"}),
    "Tianshou's before 0.5": flat_file({**TIANSHOU, "done": "done"}, CUT),
    "TorchRL's dict": flat_file({**TORCHRL, "terminated": "next.terminated", "done": "next.done"}),
    "OGBench's compact form": ogbench_compact(WORLD),
    "steps of RLDS": rlds_steps(WORLD),
    "transitions with a discount": flat_file(STEP, {"discount": 0.99 * ~stacked(WORLD, "terminated"),
                                                    "episode_id": layout_files.identifiers(WORLD)}),
    "a buffer of environments that step together": layout_files.sb3_fields(WORLD),
    "RLlib's before Gymnasium": flat_file(
        {"observations": "obs", "actions": "actions", "rewards": "rewards", "next_observations": "new_obs"},
        {"terminateds": stacked(WORLD, "terminated"), "eps_id": layout_files.identifiers(WORLD)},
    ),
}  # fmt: skip

FLAGS = {**D4RL, "terminated": "terminated", "truncated": "truncated"}
BOTH = {**TIANSHOU, "terminated": "terminated", "truncated": "truncated"}
STEPS = rlds_steps(WORLD)
COMPACT = ogbench_compact(WORLD)
