"""The agents that `recommend` tries, with settings from their papers, and the scaling of observations and rewards."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from deadreckon.agents import agent_class
from deadreckon.agents.agent import Agent
from deadreckon.data.dataset import Dataset
from deadreckon.data.sizes import reward_units, usual_observations


@dataclass(frozen=True)
class Candidate:
    """An agent with settings to try.

    Attributes:
        name: its name in tables, and of its run folder.
        agent: its registered name.
        fields: settings that differ from its defaults.
        why: the reason to try it, in a few words.
        deterministic: its policy does not sample, so no logged reward can correct its estimate if actions are continuous.
    """

    name: str
    agent: str
    fields: dict[str, Any]
    why: str
    deterministic: bool = False


# In the order in which they are tried, more of them if there is more time. All are cheap: an hour is better spent on more
# updates of these than on agents that draw ten actions per row. The settings are those that their papers vary. Stochastic
# policies come first, because importance weights can correct their estimates by logged rewards.
CONTINUOUS = (
    Candidate("bc", "bc", {}, "copies the log; what the others must beat"),
    Candidate("iql", "iql", {}, "weighs logged actions by their advantage; joins parts of episodes"),
    Candidate("awac", "awac", {}, "advantage-weighted imitation with a policy's own values"),
    Candidate("iql-bold", "iql", {"expectile": 0.9, "beta": 10.0}, "for rewards that are rare"),
    Candidate("td3_bc", "td3_bc", {}, "stays near the logged actions, improves where the values are sure", True),
    Candidate("td3_bc-loose", "td3_bc", {"alpha": 10.0}, "for logs of poor or varied behaviour", True),
    Candidate("td3_bc-close", "td3_bc", {"alpha": 1.0}, "for narrow logs of good behaviour", True),
    Candidate("rebrac", "rebrac", {"batch_size": 256}, "TD3+BC with penalised targets and normalised critics", True),
)
DISCRETE = (
    Candidate("bc", "bc", {}, "copies the log; what the others must beat"),
    Candidate("iql", "iql", {}, "weighs logged actions by their advantage"),
    Candidate("cql", "cql", {"cql_weight": 1.0}, "values of actions that the log lacks are pushed down"),
    Candidate("bcq", "bcq", {}, "takes the best among actions that the log takes often enough"),
    Candidate("iql-bold", "iql", {"expectile": 0.9, "beta": 10.0}, "for rewards that are rare"),
    Candidate("cql-strict", "cql", {"cql_weight": 5.0}, "for logs that show few actions per state"),
)


def units(log: Dataset) -> dict[str, Any]:
    """Settings that scale observations and rewards to about 1 in size, if those of a log are far from that.

    Agents train badly on observations and rewards in the usual units of measurement: see docs/recommend.md.
    """
    found: dict[str, Any] = {} if usual_observations(log.spec) else {"standardise": True}
    scale, shift = reward_units(log)
    return found | ({} if scale == 1.0 else {"reward_scale": scale}) | ({} if shift == 0.0 else {"reward_shift": shift})


def agent_of(candidate: Candidate, **common: Any) -> Agent:
    """The agent of a candidate, with those of the `common` settings that it has."""
    kind = agent_class(candidate.agent)
    own = {f.name for f in dataclasses.fields(kind)}
    return kind(**{name: value for name, value in common.items() if name in own} | candidate.fields)
