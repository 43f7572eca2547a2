"""The kind of experience that an agent is trained on online."""

from deadreckon.agents.agent import Agent
from deadreckon.agents.dapg import DAPG
from deadreckon.agents.mbpo import MBPO
from deadreckon.agents.model_based import OnlineModelBasedAgent
from deadreckon.agents.ppo import PPO
from deadreckon.agents.slbo import SLBO
from deadreckon.online.branched_rollouts import BranchedRollouts
from deadreckon.online.demonstrated import Demonstrated
from deadreckon.online.exploration import Exploration
from deadreckon.online.mixed import MixedReplay
from deadreckon.online.model_learning import ModelLearning
from deadreckon.online.model_rollouts import ModelRollouts
from deadreckon.online.on_policy import OnPolicy

_KINDS: dict[type[Agent], type[Exploration]] = {
    MBPO: BranchedRollouts, SLBO: ModelRollouts, OnlineModelBasedAgent: ModelLearning, PPO: OnPolicy, DAPG: Demonstrated,
}  # fmt: skip


def experience_of(agent: Agent, beside: bool = False) -> type[Exploration]:
    """The class of experience for this agent, `beside` a log or without one; of several that fit, the first in the table."""
    if beside:
        return MixedReplay
    return next((kind for base, kind in _KINDS.items() if isinstance(agent, base)), Exploration)
