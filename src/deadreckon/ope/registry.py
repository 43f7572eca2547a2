"""Estimators by their names in tables and on the command line."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError, unknown
from deadreckon.files import digest
from deadreckon.ope.behavior_model import PROPENSITIES
from deadreckon.ope.case import OPEInput
from deadreckon.ope.dice import DICE
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.fqe import FQE
from deadreckon.ope.fqe_d import FQED
from deadreckon.ope.importance import PUBLIC_RANGE, ImportanceSampling
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.model_based import ModelBased
from deadreckon.ope.state_marginal import StateMarginal
from deadreckon.ope.vpm import VPM
from deadreckon.training.field_names import meant, with_field_names
from deadreckon.training.hyperparameters import static
from deadreckon.training.revisions import of_learning, revisions

ESTIMATORS: dict[str, tuple[Callable[[], Estimator], str]] = {
    "fqe": (FQE, "FQE-L2: fitted Q evaluation, squared loss (Le et al. 2019)"),
    "fqe-linear": (LinearFQE, "fitted Q evaluation, linear in fixed features (Lagoudakis and Parr 2003; Duan et al. 2020)"),
    "fqe-d": (FQED, "FQE-D: fitted Q evaluation of return distributions (Paine et al. 2020)"),
    "is": (ImportanceSampling, "self-normalised importance sampling per decision (Precup et al. 2000)"),
    "pdis": (lambda: ImportanceSampling(normalised=False, interval="t"), "the same without normalisation: unbiased"),
    "wis": (lambda: ImportanceSampling(kind="trajectory"), "self-normalised importance sampling of whole episodes"),
    "dr": (DoublyRobust, "weighted doubly robust: FQE corrected by importance sampling (Thomas and Brunskill 2016)"),
    "plain-dr": (lambda: DoublyRobust(kind="dr"), "doubly robust without normalisation (Jiang and Li 2016)"),
    "magic": (lambda: DoublyRobust(kind="magic"), "MAGIC: corrections of several lengths, blended (Thomas and Brunskill 2016)"),
    "dr-linear": (
        lambda: DoublyRobust(kind="dr", fqe=LinearFQE(), model=PROPENSITIES),
        "doubly robust with linear critics: solved, not trained",
    ),
    "drl": (
        lambda: DoublyRobust(kind="marginal", fqe=LinearFQE()),
        "doubly robust by occupancy ratios: double reinforcement learning (Kallus and Uehara 2020)",
    ),
    "switch": (
        lambda: DoublyRobust(kind="switch", fqe=LinearFQE(), model=PROPENSITIES),
        "SWITCH: dr-linear where weights are small, the critic alone beyond (Wang et al. 2017)",
    ),
    "dros": (
        lambda: DoublyRobust(kind="dros", fqe=LinearFQE(), model=PROPENSITIES),
        "DRos: dr-linear with optimistically shrunk weights (Su et al. 2020)",
    ),
    "mrdr": (
        lambda: DoublyRobust(kind="mrdr", fqe=LinearFQE(), model=PROPENSITIES),
        "MRDR: doubly robust with critics of minimum variance, for short episodes (Farajtabar et al. 2018)",
    ),
    "smis": (StateMarginal, "SMIS: importance sampling by the states of each step, where these are few (Xie et al. 2019)"),
    "dice": (DICE, "BestDICE: occupancy ratios by a regularised Lagrangian (Yang et al. 2020)"),
    "dual-dice": (lambda: DICE.preset("dual"), "DualDICE (Nachum et al. 2019)"),
    "gen-dice": (lambda: DICE.preset("gen"), "GenDICE (Zhang et al. 2020)"),
    "vpm": (VPM, "variational power method (Wen et al. 2020)"),
    "mb-ff": (ModelBased, "episodes simulated by a feed-forward model (Paduraru 2007)"),
    "mb-ar": (lambda: ModelBased(kind="autoregressive"), "episodes simulated by an auto-regressive model (Zhang et al. 2021)"),
}
# Weights as in the code that the thesis used (8.5).
PUBLIC = {"behavior": "learned", "log_ratio_range": PUBLIC_RANGE, "alive_only": True, "folds": 1}
# Settings for which one core needs an hour or two on a log of a million rows. Target networks follow faster than in the full
# settings: rewards propagate back one step each time that they have caught up, and 20,000 updates at the usual 0.005 are only a
# hundred such steps.
_FQE = {"steps": 20_000, "tau": 0.05}
_MARGINAL = {"steps": 10_000, "members": 1, "batch_size": 256, "lr": 3e-4}
CPU_BUDGET: dict[str, dict[str, Any]] = {
    "fqe": _FQE,
    # The behaviour model keeps its full size: it is fitted once for all estimators of a log.
    **{name: {"fqe": _FQE, "samples": 1} for name in ("dr", "plain-dr", "magic")},
    "fqe-d": {"steps": 5_000, "members": 1, "batch_size": 256, "hidden": (256, 256), "target_update_period": 20},
    **{name: _MARGINAL for name in ("dice", "dual-dice", "gen-dice", "vpm")},
    "mb-ff": {"steps": 20_000, "members": 1},
    "mb-ar": {"steps": 10_000, "members": 1},
}


_INNER = ("fqe", "model")  # fields of estimators with settings of models that they fit


def estimator(name: str, **changes: Any) -> Estimator:
    """An estimator by name.

    Args:
        name: among `ESTIMATORS`.
        changes: fields to set, also of its FQE and behaviour model; fields that only other estimators have are ignored.

    Raises:
        UserError: an unknown name, or a field that no estimator has.
    """
    if name not in ESTIMATORS:
        raise unknown("estimator", name, ESTIMATORS)
    own = ESTIMATORS[name][0]()
    foreign = [field for field in changes if not meant(type(own), field)]
    made = [make() for make, _ in ESTIMATORS.values()] if foreign else []
    for field in foreign:
        if not any(meant(type(each), field) for each in made):
            fields = {field.name for each in made for field in dataclasses.fields(each)}
            raise unknown("field of estimators", field, sorted(fields))
    return with_fields(own, changes)


def fits_name() -> str:
    """Name of a folder for checkpoints of fits, which estimators share; it depends on the revisions of their code."""
    shared = [of_learning(), *(revisions(make()) for make, _ in ESTIMATORS.values())]
    return f"fits-{digest(shared, 8)}"


def titled(label: str) -> str:
    """An estimator's name with its label, such as `is (WPDIS)`; the label alone if both are the same, or if it has no name."""
    names = {make().label: name for name, (make, _) in ESTIMATORS.items()}
    name = names.get(label, label)
    return label if name.lower() == label.lower() else f"{name} ({label})"


def with_fields(found: Any, changes: Mapping[str, Any]) -> Any:
    """The estimator with those fields changed that it, or a model that it fits, has; a mapping changes fields of one model."""
    own = {f.name for f in dataclasses.fields(found)}
    inner = {name: getattr(found, name) for name in _INNER if name in own}
    nested = {name: value for name, value in changes.items() if isinstance(value, Mapping)}
    plain = {name: value for name, value in changes.items() if name not in nested}
    for name, part in inner.items():
        both = (with_field_names(type(part), given) for given in (nested.get(name, {}), plain))
        inner[name] = with_fields(part, {field: value for given in both for field, value in given.items()})
    plain = with_field_names(type(found), plain)
    return dataclasses.replace(found, **{name: value for name, value in plain.items() if name in own}, **inner)


class Function(Estimator):
    """A user's function as an estimator: `fn(data, policies, discount) -> values`, one per policy."""

    fn: Callable[[Dataset, Sequence[Any], float], Any] = eqx.field(static=True)
    name: str = static("yours")

    @property
    def label(self) -> str:
        """Its name in tables."""
        return self.name

    def solve(self, case: OPEInput) -> Estimates:
        """Calls the function; there are no intervals."""
        data = case.plain.select(case.held) if case.positions else case.data  # positions are for the package's models
        values = np.asarray(self.fn(data, case.policies, case.discount), float)
        if values.shape != (len(case.policies),):
            raise UserError(f"the estimator function gave values of shape {values.shape} for {len(case.policies)} policies")
        if case.logged:
            ordered = case.data.successors is None  # else a sum along its rows is no return
            values = np.append(values, case.data.returns(case.discount).mean() if ordered else np.nan)
        nothing = np.full(len(values), np.nan)
        return Estimates(self.name, case.names, values, nothing, nothing, case.estimand, bootstrap=values[None])


def as_estimators(given: Any) -> list[Estimator]:
    """Estimators of a sequence, or a single one; see `as_estimator`.

    Raises:
        UserError: there is none, an unknown name, or something else.
    """
    several = isinstance(given, Iterable) and not isinstance(given, str) and not callable(given)
    found = [as_estimator(each) for each in given] if several else [as_estimator(given)]
    if not found:
        raise UserError("no estimator; give names, Estimator objects or functions")
    return found


def as_estimator(given: Any) -> Estimator:
    """The estimator for an `Estimator`, a name or a function.

    Raises:
        UserError: an unknown name, or something else.
    """
    if isinstance(given, Estimator):
        return given
    if isinstance(given, str):
        return estimator(given)
    if callable(given):
        return Function(given, getattr(given, "__name__", "yours"))
    raise UserError(f"estimators are names, Estimator objects or functions, got {type(given).__name__}")
