"""Finite worlds that are solved exactly: ground truth for estimators and agents, and the arguments of the thesis in small."""

from deadreckon.theory import (
    branching,
    cnml,
    constrained,
    discrepancy,
    fitted,
    looseness,
    monotonic,
    piecewise,
    propagation,
    solve,
)
from deadreckon.theory.tabular import MDP, chain, garnet, gridworld

__all__ = [
    "MDP", "branching", "chain", "cnml", "constrained", "discrepancy", "fitted", "garnet", "gridworld", "looseness",
    "monotonic", "piecewise", "propagation", "solve",
]  # fmt: skip
