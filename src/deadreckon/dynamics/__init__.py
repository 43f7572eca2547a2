"""Learned models of what an environment does next."""

from deadreckon.dynamics.autoregressive import AutoRegressive
from deadreckon.dynamics.gaussian import Gaussian
from deadreckon.dynamics.model import Change, Model

__all__ = ["AutoRegressive", "Change", "Gaussian", "Model"]
