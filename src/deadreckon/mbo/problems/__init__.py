"""Design problems with their oracles."""

from deadreckon.mbo.problems.problem import Problem, Scores
from deadreckon.mbo.problems.registry import PROBLEMS, problem

__all__ = ["PROBLEMS", "Problem", "Scores", "problem"]
