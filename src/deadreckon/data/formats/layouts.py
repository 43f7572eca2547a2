"""A table of the layouts of other libraries: names of columns, meaning of end flags, and how the layouts are recognised."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from deadreckon.data.formats import layout_rows as rows
from deadreckon.data.formats.layout_rows import Parts, has

_GYMNASIUM = {"observations": "observations", "actions": "actions", "rewards": "rewards",
              "next_observations": "next_observations"}  # fmt: skip
_STEP = {"observation": "observations", "action": "actions", "reward": "rewards", "next_observation": "next_observations",
         "episode_id": "episode"}  # fmt: skip
_PREFIXES = ("_meta/",)  # groups around the columns, without meaning


@dataclass(frozen=True)
class Layout:
    """How one library lays out logged steps.

    Attributes:
        library: name of the library, for messages.
        ends: meaning of its end flags, for messages.
        needs: columns, or dicts of columns, all of which the layout has.
        one_of: columns of which the layout has at least one, if any are listed.
        never: columns of which the layout has none.
        names: {column of the library: our name, or one of the roles below}. The first that exists takes the role. Roles beside
            the names of `Dataset.from_arrays`: `terminated` (the task ended), `truncated` (only the recording ended), `done`
            (either), `alive` (1 while the task has not ended), `discount` (0 where it has), `episode` (an identifier), `time`
            (orders the rows of an episode), `cut` (the recording stops after this row), `unknown` (the next observation is
            not known), `log_probs` and `probs` (of the logged action), `legal` (rows, actions).
        order: function that puts the rows into order first, if new names are not enough.
        ours: whether names are those of `Dataset.from_arrays`, so that nothing has to be changed.
    """

    library: str
    ends: str
    needs: tuple[str, ...]
    one_of: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    order: Callable[[Parts], None] | None = None
    ours: bool = False

    def fits(self, names: Iterable[str]) -> bool:
        """Whether columns called `names` have this layout."""
        names = set(names)
        there = all(has(names, name) for name in self.needs) and not any(has(names, name) for name in self.never)
        return there and (not self.one_of or any(has(names, name) for name in self.one_of))


# The first that fits is taken, so those with more specific names are first.
LAYOUTS = (
    Layout(
        "d3rlpy 2", "`terminated` marks episodes that ended by termination; in others the last next observation is not known",
        needs=("columns", "num_episodes", "actions_0"), order=rows.d3rlpy_episodes,
        names={**_GYMNASIUM, "terminated": "terminated", "done": "done"},
    ),
    Layout(
        "d3rlpy 1", "`terminals` are terminations, `episode_terminals` end episodes",
        needs=("observations", "actions", "rewards", "terminals", "episode_terminals"),
        names={**_GYMNASIUM, "terminals": "terminated", "episode_terminals": "done"},
    ),
    Layout(
        "RL Unplugged (Atari)", "`d_t` 0 is a termination, `episode_id` identifies episodes",
        needs=("o_t", "a_t", "r_t", "d_t", "o_tp1"),
        names={"o_t": "observations", "a_t": "actions", "r_t": "rewards", "d_t": "discount", "o_tp1": "next_observations",
               "episode_id": "episode"},
    ),
    Layout(
        "RL Unplugged (RLDS steps)",
        "an `is_last` row is only the last observation, without its action and reward; `is_terminal` there is a termination",
        needs=("observation", "action", "reward", "is_last"), order=rows.steps,
        names={**_STEP, "terminated": "terminated", "discount": "discount", "cut": "cut"},
    ),
    Layout(
        "RL Unplugged (dm_env steps)",
        "a row of `step_type` 2 is only the last observation, without its action and reward; `discount` 0 is a termination",
        needs=("observation", "action", "reward", "discount", "step_type"), order=rows.steps,
        names={**_STEP, "discount": "discount", "cut": "cut"},
    ),
    Layout(
        "RL Unplugged (transitions)", "`discount` 0 is a termination",
        needs=("observation", "action", "reward", "discount"), names={**_STEP, "discount": "discount"},
    ),
    Layout(
        "TorchRL", "`next/terminated` are terminations, `next/truncated` time limits, `next/done` either of the two",
        needs=("action", "next/reward"), one_of=("observation", "pixels"), order=rows.torchrl,
        names={"observation": "observations", "pixels": "observations", "action": "actions", "next/reward": "rewards",
               "next/observation": "next_observations", "next/pixels": "next_observations", "next/terminated": "terminated",
               "next/truncated": "truncated", "next/done": "done", "collector/traj_ids": "episode", "traj_ids": "episode",
               "action_mask": "legal", "next/action_mask": "next_legal",
               "action_log_prob": "log_probs", "sample_log_prob": "log_probs",
               "cut": "cut", "unknown": "unknown"},
    ),
    Layout(
        "Tianshou", "`terminated` are terminations, `truncated` time limits, `done` either of the two",
        needs=("obs", "act", "rew"), order=rows.tianshou,
        names={"obs": "observations", "act": "actions", "rew": "rewards", "obs_next": "next_observations",
               "terminated": "terminated", "truncated": "truncated", "info/TimeLimit.truncated": "truncated", "done": "done",
               "legal": "legal", "next_legal": "next_legal", "cut": "cut"},
    ),
    Layout(
        "RLlib", "`terminateds` are terminations, `truncateds` time limits, `eps_id` identifies episodes",
        needs=("obs", "actions", "rewards"), order=partial(rows.masks, now="obs", after="new_obs"),
        names={"obs": "observations", "actions": "actions", "rewards": "rewards", "new_obs": "next_observations",
               "terminateds": "terminated", "truncateds": "truncated", "dones": "done", "eps_id": "episode", "t": "time",
               "action_logp": "log_probs", "action_prob": "probs", "action_mask": "legal", "legal": "legal",
               "next_legal": "next_legal"},
    ),
    Layout(
        "Stable-Baselines3", "`dones` end episodes, those that are `timeouts` too are time limits",
        needs=("observations", "actions", "rewards", "dones"), one_of=("timeouts",), never=("terminals",), order=rows.sb3,
        names={**_GYMNASIUM, "dones": "done", "timeouts": "truncated", "cut": "cut"},
    ),
    Layout(
        "OGBench", "`terminals` end trajectories, `masks` say whether the task ended",
        needs=("observations", "actions", "terminals"), one_of=("masks", "valids"), never=("timeouts", "dones"),
        order=rows.ogbench, names={**_GYMNASIUM, "terminals": "done", "masks": "alive"},
    ),
    Layout(
        "D4RL", "`terminals` are terminations, `timeouts` time limits; `masks` are 0 where terminals are 1",
        needs=("observations", "actions", "rewards", "terminals", "timeouts", "masks"), never=("dones",),
        names={**_GYMNASIUM, "terminals": "terminated", "timeouts": "truncated", "masks": "alive"},
    ),
    Layout(
        "Open Bandit", "each round is an episode of one terminal step, `pscore` is the probability of the logged action",
        needs=("context", "action", "reward", "pscore"), order=rows.rounds,
        names={"context": "observations", "action": "actions", "reward": "rewards", "pscore": "probs",
               "terminated": "terminated"},
    ),
    Layout(
        "Minari", "`terminations` are terminations, `truncations` time limits",
        needs=("observations", "actions", "rewards"), one_of=("terminations", "truncations"), never=("terminals",),
        names={**_GYMNASIUM, "terminations": "terminated", "truncations": "truncated"},
    ),
    Layout(
        "Gymnasium", "`terminated` are terminations, `truncated` time limits",
        needs=("observations", "actions", "rewards"), one_of=("terminated", "truncated"), never=("terminals",),
        names={**_GYMNASIUM, "terminated": "terminated", "truncated": "truncated", "timeouts": "truncated", "done": "done",
               "dones": "done"},
    ),
    Layout(
        "DSRL", "`terminals` are terminations, `timeouts` time limits; `costs` are costs, which `ope` estimates and limits",
        needs=("observations", "actions", "rewards", "terminals", "costs"), never=("masks", "dones"), ours=True,
    ),
    Layout(
        "CORL", "`terminals` are terminations; an episode also ends where the next row does not continue it (D4RL's "
        "`qlearning_dataset`)",
        needs=("observations", "actions", "rewards", "next_observations", "terminals"),
        never=("timeouts", "masks", "valids", "dones"), ours=True,
    ),
)  # fmt: skip

# Names are ours, but the observation is a dict or tuple of columns.
_SEVERAL = Layout(
    "D4RL", "`terminals` are terminations, `timeouts` time limits; parts of the observation are put one after the other",
    needs=("observations", "actions", "rewards"),
    names={**_GYMNASIUM, "terminals": "terminated", "timeouts": "truncated"},
)  # fmt: skip


def layout_of(names: Iterable[str]) -> Layout | None:
    """The layout that columns called `names` have; None where none is known, or they have our names."""
    names = {plain_name(name) for name in names}
    found = next((layout for layout in LAYOUTS if layout.fits(names)), None)
    several = (found is None or found.ours) and "observations" not in names and _SEVERAL.fits(names)
    return _SEVERAL if several else found


def told(layout: Layout) -> str:
    """The message on how columns are read."""
    return f"read as {layout.library}'s layout: {layout.ends}"


def flat(columns: Mapping[Any, Any]) -> dict[str, Any]:
    """Nested dicts, tuples and lists of arrays as one dict whose keys are paths such as `next/observation`."""
    found: dict[str, Any] = {}
    for key, value in columns.items():
        key = "/".join(map(str, key)) if isinstance(key, tuple) else str(key)
        if isinstance(value, Mapping):
            found |= {f"{key}/{inner}": column for inner, column in flat(value).items()}
        elif isinstance(value, tuple):
            found |= {f"{key}/{inner}": column for inner, column in flat(dict(enumerate(value))).items()}
        else:
            found[key] = value
    return found


def plain_name(name: str) -> str:
    """A column's path without the group that buffers are stored in, and with slashes where TorchRL writes dots."""
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    return name.replace(".", "/") if name.startswith(("next.", "collector.")) else name
