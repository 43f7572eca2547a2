"""Off-policy evaluation: the values of policies from a log alone (thesis chapter 8)."""

from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.coverage import coverage
from deadreckon.ope.dice import DICE
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.estimates import LOGGED, Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.fqe_d import FQED
from deadreckon.ope.importance import ImportanceSampling
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.metrics import Metrics, compare
from deadreckon.ope.model_based import ModelBased
from deadreckon.ope.registry import ESTIMATORS, estimator
from deadreckon.ope.select import Choice, select
from deadreckon.ope.vpm import VPM

__all__ = [
    "DICE",
    "ESTIMATORS",
    "FQE",
    "FQED",
    "LOGGED",
    "VPM",
    "BehaviorModel",
    "Choice",
    "DoublyRobust",
    "Estimand",
    "Estimates",
    "Estimator",
    "ImportanceSampling",
    "LinearFQE",
    "Metrics",
    "ModelBased",
    "OPEInput",
    "compare",
    "coverage",
    "estimator",
    "select",
]  # fmt: skip
