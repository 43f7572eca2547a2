"""The base class of estimators."""

import dataclasses
import time
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimates import Estimates
from deadreckon.training.hyperparameters import check_fields

CROSSED = "cross-fitted ones differ by fold, trained on the other folds"
MIXED = "those of a mixture differ by episode, one drawn for each"


class Estimator(eqx.Module):
    """An estimator: its fields are hyperparameters, its result is `Estimates`.

    Attributes:
        revision: raised in the class whose code has changed the estimates; here for the code that all estimators share (class
            attribute). It identifies results of suites (see bench/identity.py).
    """

    revision: ClassVar[int] = 1

    takes_horizon = False  # whether it can count the first steps of an episode only, and take a discount of one
    # Whether it can evaluate cross-fitted policies, as weights of single rows can. A model fitted to all folds would be trained
    # on the rewards that the policy was trained on, and a method that follows a policy to its next states needs one policy.
    takes_crossed = False
    takes_apart = True  # whether rows need not follow each other; see `Dataset.successors`

    def estimate(
        self,
        data: Dataset,
        policies: Any,
        **options: Any,
    ) -> Estimates:
        """The value of each policy, from the log alone; see `OPEInput` for the options and errors, and `check`."""
        return self.on(OPEInput(data, policies, **options))

    def check_settings(self) -> None:
        """Refuses settings out of range.

        Raises:
            UserError: in one line.
        """
        for each in (self, *vars(self).values()):
            if isinstance(each, eqx.Module):
                check_fields(each)

    def check(self, case: OPEInput) -> None:
        """Refuses settings out of range, and cases that this estimator cannot evaluate.

        Raises:
            UserError: in one line.
        """
        self.check_settings()
        if case.estimand.horizon not in (None, 1) and not self.takes_horizon:
            raise UserError(f"{self.label} does not take a horizon; use FQE, importance sampling or a doubly robust estimator")
        if case.discount == 1.0 and not self.takes_horizon:
            raise UserError(f"{self.label} needs a discount below 1, got 1")
        if case.crossed and not self.takes_crossed:
            several = np.bincount(case.owner) > 1  # policies that have more than one actor
            differ = CROSSED if (case.cross_fitted & several).any() else MIXED
            raise UserError(f"{self.label} evaluates each policy on all episodes, and {differ}; use dr-linear")
        if case.data.successors is not None and not self.takes_apart:
            raise UserError(
                f"{case.data.name}: its rows do not follow each other, so {self.label} would take what the behaviour policy "
                "did elsewhere for what it did next; use FQE, also with linear features or return distributions, or a model"
            )

    def on(self, case: OPEInput) -> Estimates:
        """The same on a case, which several estimators can share; see `check` for errors."""
        self.check(case)
        begun = time.perf_counter()
        found = self.solve(case)
        warnings = (*found.warnings, *case.actor.warnings())
        if getattr(self, "members", None) == 1:
            warnings = (*warnings, f"{found.method} has one member, which gives no interval; more members do")
        if case.crossed or found.inflation is not None:
            more = case.inflation * (1.0 if found.inflation is None else found.inflation)
            middle = np.where(np.isfinite(found.value), found.value, np.nan)
            low, high = middle - more * (middle - found.low), middle + more * (found.high - middle)
            found = dataclasses.replace(found, low=low, high=high, inflation=more)
        if (lost := ~np.isfinite(found.value)).any():
            found = found.unbounded(lost)
            names = [name for name, gone in zip(found.names, lost) if gone]
            warnings = (*warnings, f"no finite estimate of {names[0]}{f' and {len(names) - 1} more' if names[1:] else ''}")
        units = int(case.units.max()) + 1 if found.units is None else found.units
        return dataclasses.replace(found, warnings=warnings, seconds=time.perf_counter() - begun, units=units)

    @property
    def label(self) -> str:
        """Its name in tables."""
        raise NotImplementedError

    def solve(self, case: OPEInput) -> Estimates:
        """Computes the estimates."""
        raise NotImplementedError

    def replace(self, **changes: Any) -> Any:
        """The same estimator with some fields changed."""
        return dataclasses.replace(self, **changes)
