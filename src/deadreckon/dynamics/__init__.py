"""Learned models of what an environment does next."""

from deadreckon.dynamics.autoregressive import AutoRegressive
from deadreckon.dynamics.ensemble import Ensemble, Report, Trainer
from deadreckon.dynamics.gaussian import Gaussian
from deadreckon.dynamics.model import Change, Model
from deadreckon.dynamics.rollout import Branch, branches, ended, packed, transition

__all__ = ["AutoRegressive", "Branch", "Change", "Ensemble", "Gaussian", "Model", "Report", "Trainer", "branches", "ended",
           "packed", "transition"]  # fmt: skip
