"""Estimators on the command line: their names, and the sizes of what they fit."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import tyro

NAMES = tyro.conf.arg(metavar="NAME[,NAME...]")


@dataclass
class Fits:
    """Sizes of what the estimators fit; None: each estimator's own default."""

    steps: int | None = None  # updates of each estimator; None: its own default
    members: int | None = None
    """networks per policy, each fitted on a bootstrap sample; their spread gives the interval; None: the default"""
    batch_size: int | None = None  # batch size (transitions per update); None: the default of each estimator
    hidden: tuple[int, ...] | None = None  # width of each hidden layer; None: the default of each estimator

    @property
    def given(self) -> dict[str, Any]:
        """What is not left to the estimators."""
        return {name: value for name, value in vars(self).items() if value is not None}


def estimators(names: str, fits: Fits, budget: Mapping[str, dict[str, Any]] | None = None) -> list[Any]:
    """Estimators by their names with commas between, of these sizes; `budget` has sizes by name where none are given."""
    from deadreckon.ope.registry import estimator

    return [estimator(name, **(budget or {}).get(name, {}) | fits.given) for name in map(str.strip, names.split(","))]
