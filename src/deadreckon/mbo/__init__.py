"""Design from data alone: methods that propose designs from scored ones."""

from deadreckon.mbo.coms import COMs
from deadreckon.mbo.designer import Designer, Proposals
from deadreckon.mbo.floor import BestOfData, Random
from deadreckon.mbo.forward import Forward
from deadreckon.mbo.nemo import NEMO
from deadreckon.mbo.problems import PROBLEMS, Problem, problem
from deadreckon.mbo.ram import RaM
from deadreckon.mbo.registry import DESIGNERS, designer

__all__ = [
    "DESIGNERS", "NEMO", "PROBLEMS", "BestOfData", "COMs", "Designer", "Forward", "Problem", "Proposals", "RaM", "Random",
    "designer", "problem",
]  # fmt: skip
