"""Off-policy evaluation: what policies are worth, from a log alone (thesis chapter 8)."""

from deadreckon.ope.dice import DICE
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimate import BehaviorModel, Case, Estimates, Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.fqe_d import FQED
from deadreckon.ope.importance import ImportanceSampling
from deadreckon.ope.vpm import VPM

__all__ = [
    "DICE", "FQE", "FQED", "VPM", "BehaviorModel", "Case", "DoublyRobust", "Estimates", "Estimator", "ImportanceSampling",
]  # fmt: skip
