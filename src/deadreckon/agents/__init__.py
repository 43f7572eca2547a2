"""Agents: one algorithm, one file. `deadreckon.agents.BEAR()` or, by name, `agent_class("bear")()`.

Agents of other packages are known by `module:Class`, or by the name of an entry point in the group `deadreckon.agents`.
"""

import importlib
import importlib.metadata
import sys
from typing import TYPE_CHECKING

from deadreckon.agents.published import agent_key, preset, preset_for, presets, space
from deadreckon.errors import UserError, unknown
from deadreckon.imports import imported, trusted

if TYPE_CHECKING:
    from deadreckon.agents.abm import ABM
    from deadreckon.agents.agent import Agent
    from deadreckon.agents.algae_dice import AlgaeDICE
    from deadreckon.agents.awac import AWAC
    from deadreckon.agents.awr import AWR
    from deadreckon.agents.bc import BC
    from deadreckon.agents.bcq import BCQ
    from deadreckon.agents.bear import BEAR
    from deadreckon.agents.bear_is import ISBEAR
    from deadreckon.agents.brac import BRAC
    from deadreckon.agents.cal_ql import CalQL
    from deadreckon.agents.combo import COMBO
    from deadreckon.agents.cql import CQL
    from deadreckon.agents.crr import CRR
    from deadreckon.agents.crr_d import CRRD
    from deadreckon.agents.d4pg import D4PG
    from deadreckon.agents.dapg import DAPG
    from deadreckon.agents.decision_transformer import DecisionTransformer
    from deadreckon.agents.dqfd import DQfD
    from deadreckon.agents.edac import EDAC
    from deadreckon.agents.fql import FQL
    from deadreckon.agents.iql import IQL
    from deadreckon.agents.kl_control import KLControl
    from deadreckon.agents.mbpo import MBPO
    from deadreckon.agents.mobile import MOBILE
    from deadreckon.agents.mopo import MOPO
    from deadreckon.agents.morel import MOReL
    from deadreckon.agents.mve import MVE
    from deadreckon.agents.pets import PETS
    from deadreckon.agents.ppo import PPO
    from deadreckon.agents.rebrac import ReBRAC
    from deadreckon.agents.rem import REM
    from deadreckon.agents.rlpd import RLPD
    from deadreckon.agents.sac import SAC
    from deadreckon.agents.sac_n import SACN
    from deadreckon.agents.slbo import SLBO
    from deadreckon.agents.steve import STEVE
    from deadreckon.agents.td3 import TD3
    from deadreckon.agents.td3_bc import TD3BC
    from deadreckon.agents.xql import XQL

# Name on the command line: (module, class, one line). Modules load on first use: they need JAX.
AGENTS = {
    "bc": ("bc", "BC", "behaviour cloning: tanh-Gaussian, VAE (thesis A.4) or clipped Gaussian"),
    "td3": ("td3", "TD3", "twin delayed DDPG on a fixed log, the naive baseline (thesis 4.4)"),
    "td3_bc": ("td3_bc", "TD3BC", "TD3 that also imitates the log (Fujimoto & Gu 2021)"),
    "d4pg": ("d4pg", "D4PG", "DDPG with a critic of return distributions, offline or --online (Barth-Maron et al. 2018)"),
    "sac": ("sac", "SAC", "soft actor-critic on a fixed log (thesis 7.4, SAC-off)"),
    "ppo": ("ppo", "PPO", "clipped policy gradients on the last block of steps, --online only (Schulman et al. 2017)"),
    "dapg": ("dapg", "DAPG", "natural policy gradients from demonstrations, --online only (Rajeswaran et al. 2018)"),
    "mbpo": ("mbpo", "MBPO", "SAC on short rollouts in a learned model, --online only (thesis 5.3, Algorithm 3)"),
    "pets": ("pets", "PETS", "actions planned in an ensemble at every step, --online only (Chua et al. 2018)"),
    "slbo": ("slbo", "SLBO", "PPO on whole episodes simulated by a model, --online only (Luo et al. 2019)"),
    "mve": ("mve", "MVE", "SAC with targets after some steps in a model, --online only (Feinberg et al. 2018; thesis 5.4)"),
    "steve": ("steve", "STEVE", "SAC with targets of all horizons, weighted by certainty, --online only (Buckman et al. 2018)"),
    "mopo": ("mopo", "MOPO", "SAC on rollouts in a model of the log, rewards lowered by its deviation (Yu et al. 2020)"),
    "morel": ("morel", "MOReL", "SAC in a model that ends where its networks disagree (Kidambi et al. 2020)"),
    "combo": ("combo", "COMBO", "SAC on rollouts in a model, critics held down on unseen actions (Yu et al. 2021)"),
    "mobile": ("mobile", "MOBILE", "SAC on rollouts in a model, values lowered where backups differ (Sun et al. 2023)"),
    "iql": ("iql", "IQL", "expectile values of logged actions, imitation weighted by advantage (Kostrikov et al. 2022)"),
    "xql": ("xql", "XQL", "IQL with a soft maximum by Gumbel regression (Garg et al. 2023)"),
    "awac": ("awac", "AWAC", "imitation weighted by the advantage of an action over the policy (Nair et al. 2020)"),
    "crr": ("crr", "CRR", "imitation of the logged actions that are better than the policy's (Wang et al. 2020)"),
    "crr_d": ("crr_d", "CRRD", "CRR with a critic of return distributions, as in RL Unplugged (Wang et al. 2020)"),
    "abm": ("abm", "ABM", "a policy near a model of logged actions with good outcomes (Siegel et al. 2020)"),
    "rebrac": ("rebrac", "ReBRAC", "TD3+BC with penalties for actor and critics, normalised critics (Tarasov et al. 2023)"),
    "cql": ("cql", "CQL", "SAC with critics held down on unseen actions (Kumar et al. 2020; thesis 7.4)"),
    "cal_ql": ("cal_ql", "CalQL", "CQL with values no lower than logged returns, to continue online (Nakamoto et al. 2023)"),
    "rlpd": ("rlpd", "RLPD", "SAC online with a log in every batch, normalised critics, many updates (Ball et al. 2023)"),
    "sac_n": ("sac_n", "SACN", "SAC with an ensemble of critics (An et al. 2021)"),
    "edac": ("edac", "EDAC", "SAC-N with diversified critics (An et al. 2021)"),
    "bcq": ("bcq", "BCQ", "the critics' choice among a VAE's actions, slightly perturbed (Fujimoto et al. 2019; thesis 7.4)"),
    "brac": ("brac", "BRAC", "an actor-critic penalised for leaving the log's policy (Wu et al. 2019; thesis 7.4)"),
    "awr": ("awr", "AWR", "imitation weighted by recorded returns beyond the value (Peng et al. 2019; thesis 7.4)"),
    "algae_dice": ("algae_dice", "AlgaeDICE", "policy gradients by the dual of the value (Nachum et al. 2019; thesis 7.4)"),
    "rem": ("rem", "REM", "TD3 on random mixtures of many heads (Agarwal et al. 2020; thesis 7.4)"),
    "kl_control": ("kl_control", "KLControl", "SAC penalised for its divergence from the log (Jaques et al. 2019; thesis 4.4)"),
    "dqfd": ("dqfd", "DQfD", "TD3 with logged actions above all others by a margin (Hester et al. 2018; thesis 4.4)"),
    "fql": ("fql", "FQL", "a one-step actor held to a flow model of the log (Park et al. 2025)"),
    "decision_transformer": (
        "decision_transformer", "DecisionTransformer", "imitation given the return-to-go (Chen et al. 2021)",
    ),
    "bear": ("bear", "BEAR", "Q-learning held to the log's support (thesis 4.3, Algorithm 1)"),
    "bear_is": ("bear_is", "ISBEAR", "importance-sampled BEAR (thesis A.3, Algorithm 5)"),
}
__all__ = [
    "ABM",
    "AGENTS",
    "AWAC",
    "AWR",
    "BC",
    "BCQ",
    "BEAR",
    "BRAC",
    "COMBO",
    "CQL",
    "CRR",
    "CRRD",
    "D4PG",
    "DAPG",
    "EDAC",
    "FQL",
    "IQL",
    "ISBEAR",
    "MBPO",
    "MOBILE",
    "MOPO",
    "MVE",
    "PETS",
    "PPO",
    "REM",
    "RLPD",
    "SAC",
    "SACN",
    "SLBO",
    "STEVE",
    "TD3",
    "TD3BC",
    "XQL",
    "Agent",
    "AlgaeDICE",
    "CalQL",
    "DQfD",
    "DecisionTransformer",
    "KLControl",
    "MOReL",
    "ReBRAC",
    "agent_class",
    "agent_name",
    "plugins",
    "preset",
    "preset_for",
    "presets",
    "short_name",
    "space",
]  # fmt: skip


def agent_class(name: str) -> "type[Agent]":
    """The class behind a name such as `td3_bc` (also `td3-bc`), or behind `module:Class`.

    Modules are looked for as Python does, and in the current folder.

    Raises:
        UserError: no agent has this name, or the named object is not an agent.
    """
    key = agent_key(name)
    if key in AGENTS:
        module, attribute, _ = AGENTS[key]
        return getattr(importlib.import_module(f"deadreckon.agents.{module}"), attribute)
    path = name if ":" in name else {agent_key(each): path for each, path in plugins().items()}.get(key)
    if path is None:
        raise unknown("agent", name, [*AGENTS, *plugins()])
    return _imported(path)


def canonical_name(name: str) -> str:
    """The name under which `AGENTS` has an agent of the package, from any spelling of it, such as `td3-bc` or `TD3+BC`; any
    other name as it is."""
    return key if (key := agent_key(name)) in AGENTS else name


def known_agent(name: str) -> bool:
    """Whether `agent_class` of a name that a file says imports no more than the user has: names of the package, those that
    installed packages register, and classes of modules that are imported already or trusted (`imports.trust`)."""
    module, colon, _ = name.partition(":")
    return not colon or trusted(module) or module in sys.modules


def plugins() -> dict[str, str]:
    """Agents of other packages that are installed: name -> `module:Class`."""
    return {point.name: point.value for point in importlib.metadata.entry_points(group="deadreckon.agents")}


def _imported(path: str) -> "type[Agent]":
    kind = imported(path, "agent", "Class")
    if not isinstance(kind, type) or not issubclass(kind, importlib.import_module("deadreckon.agents.agent").Agent):
        module, _, attribute = path.partition(":")
        raise UserError(f"agent {path}: {module} has no class {attribute} that is a deadreckon.agents.Agent")
    return kind


def agent_name(agent: object) -> str:
    """The name by which `agent_class` finds an agent's class; that of the class alone where it cannot be imported."""
    kind = type(agent)
    path = f"{kind.__module__}:{kind.__qualname__}"
    known = {f"deadreckon.agents.{module}:{attribute}": name for name, (module, attribute, _) in AGENTS.items()}
    known |= {value: name for name, value in plugins().items()}
    if path in known:
        return known[path]
    return kind.__name__ if kind.__module__ == "__main__" or "<locals>" in path else path


def short_name(agent: object) -> str:
    """`agent_name` without a module, for titles and folders."""
    return agent_name(agent).rpartition(":")[2]


def __dir__() -> list[str]:
    return sorted(__all__)


def __getattr__(name: str):
    for module, attribute, _ in (("agent", "Agent", ""), *AGENTS.values()):
        if attribute == name:
            return getattr(importlib.import_module(f"deadreckon.agents.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
