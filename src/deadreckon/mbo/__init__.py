"""Offline model-based optimisation (design from data alone): methods that propose designs from scored ones."""

from deadreckon.mbo.baselines import BestOfData, Jitter, Random
from deadreckon.mbo.cbas import CbAS
from deadreckon.mbo.coms import COMs
from deadreckon.mbo.ddom import DDOM
from deadreckon.mbo.designer import Designer, Proposals
from deadreckon.mbo.forward import Forward
from deadreckon.mbo.gp import GP
from deadreckon.mbo.gp_bo import GPBO
from deadreckon.mbo.mins import MINs
from deadreckon.mbo.nemo import NEMO
from deadreckon.mbo.problems import PROBLEMS, Problem, problem
from deadreckon.mbo.ram import RaM
from deadreckon.mbo.registry import DESIGNERS, designer

__all__ = [
    "DDOM", "DESIGNERS", "GP", "GPBO", "NEMO", "PROBLEMS", "BestOfData", "COMs", "CbAS", "Designer", "Forward", "Jitter",
    "MINs", "Problem", "Proposals", "RaM", "Random", "designer", "problem",
]  # fmt: skip
