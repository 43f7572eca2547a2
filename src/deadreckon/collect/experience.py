"""Which kind of experience an agent learns from online."""

from deadreckon.agents.agent import Agent
from deadreckon.agents.dapg import DAPG
from deadreckon.agents.mbpo import MBPO
from deadreckon.agents.modelled import ModelledOnline
from deadreckon.agents.ppo import PPO
from deadreckon.agents.slbo import SLBO
from deadreckon.collect.demonstrated import Demonstrated
from deadreckon.collect.imagined import Imagination
from deadreckon.collect.modelled import Modelling
from deadreckon.collect.on_policy import OnPolicy
from deadreckon.collect.online import Exploration
from deadreckon.collect.virtual import Virtual

_KINDS: dict[type[Agent], type[Exploration]] = {
    MBPO: Imagination, SLBO: Virtual, ModelledOnline: Modelling, PPO: OnPolicy, DAPG: Demonstrated,
}  # fmt: skip


def experience_of(agent: Agent) -> type[Exploration]:
    """The class whose rows this agent learns from; of several that fit, the first in the table."""
    return next((kind for base, kind in _KINDS.items() if isinstance(agent, base)), Exploration)
