"""What every estimator is asked (`Case`) and answers (`Estimates`).

The value of a policy is, everywhere: the expected discounted return sum_t discount^t r_t of an episode, from the initial
states of the log. Terminals end it; where the log cuts an episode off (a timeout) it goes on, for estimators that can look
beyond. `Estimates.average` is the same on the scale of a reward, (1 - discount) times it.
"""

import contextlib
import dataclasses
import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np

from deadreckon.data.batch import Batch, Needs, Rows, redrawn
from deadreckon.data.dataset import Dataset
from deadreckon.data.view import View
from deadreckon.errors import UserError
from deadreckon.files import alone, read_json, write_json
from deadreckon.nets.optim import begin, descend
from deadreckon.ope.tables import Actor
from deadreckon.policies import behavior as models
from deadreckon.policies.policy import ClippedGaussian, Deployed, Policy, create_actor
from deadreckon.training.checkpoint import folder_of
from deadreckon.training.fit import Fit, Progress, complete
from deadreckon.training.learner import check_fields, described, static

Watcher = Callable[[str, int, int], None]  # gets what is fitted, updates done and updates in all
NEXT, INITIAL, CURRENT, FINAL = range(4)  # purposes of draws
SETTLED = 0.05  # relative change of a fit's metric over its last fifth beyond which one is warned
LOGGED = "the log"  # the name of the policy that made it


@dataclass(frozen=True)
class Estimates:
    """What an estimator says about each policy.

    Attributes:
        method: the estimator.
        names: of the policies.
        value: (policies,) expected discounted return of an episode.
        low, high: (policies,) 95 % interval; NaN where the method gives none.
        discount: of the returns.
        redraws: (n, policies) estimates of redrawn logs or of members of an ensemble, the same redraws for all policies, so
            that differences between policies can be judged; None where there are none.
        effective: (policies,) episodes that the weights amount to, (sum w)^2 / sum w^2; None where nothing is weighted.
        warnings: why not to trust it, one line each.
        seconds: it took, without what was there already for another estimator.
    """

    method: str
    names: tuple[str, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    discount: float
    redraws: np.ndarray | None = field(default=None, repr=False)
    effective: np.ndarray | None = None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def average(self) -> np.ndarray:
        """(policies,) discounted average reward, (1 - discount) times the value."""
        return (1.0 - self.discount) * self.value

    @property
    def best(self) -> int:
        """Index of the policy with the highest estimate."""
        return int(np.argmax(np.where(np.isnan(self.value), -np.inf, self.value)))

    def __str__(self) -> str:
        width = max(map(len, self.names))
        lines = [f"{self.method}, discounted return ({self.discount:g}) with 95 % intervals"]
        for i, name in enumerate(self.names):
            weight = "" if self.effective is None else f"   {self.effective[i]:,.1f} effective episodes"
            lines.append(f"  {name:<{width}}  {self.value[i]:10.2f} [{self.low[i]:.2f}, {self.high[i]:.2f}]{weight}")
        return "\n".join([*lines, *(f"  warning: {line}" for line in self.warnings)])


class BehaviorModel(eqx.Module):
    """The policy that made the log, a tanh-Gaussian or categorical network by maximum likelihood (thesis 8.5).

    Beside policies that are clipped Gaussians it is one itself: what these have at the bounds are probabilities, which no
    density may divide.
    """

    hidden: tuple[int, ...] = static((256, 256))  # width of each hidden layer
    lr: float = 3e-4  # learning rate
    steps: int = static(50_000)  # updates
    batch_size: int = static(256)  # rows a batch
    clipped: bool = static(False)  # a clipped Gaussian; cases set it

    def needs(self, spec):
        """Observations and actions."""
        return Needs(columns=("observation", "action"), batch_size=self.batch_size, standardise=True)

    def init(self, spec, key):
        """Network and optimiser."""
        make = models.Clipped.create if self.clipped else create_actor
        model = make(spec, self.hidden, key)
        return model, begin(model)

    def update(self, state, batch: Batch, *, step, key):
        """One step of maximum likelihood."""
        model, opt = state
        loss = models.censored if self.clipped else models.loss
        grads, metrics = jax.grad(loss, has_aux=True)(model, batch.observation, batch.action, key)
        model, opt = descend(model, grads, opt, self.lr)
        return (model, opt), metrics


class Case:
    """A log, the policies to judge by it, and all that estimators share about them, each made when first asked for.

    Args:
        data: the log.
        policies: a policy, a run, or a sequence of these.
        discount: of the returns, below one.
        seed: of everything random.
        greedy: the policies' best guesses instead of their draws.
        names: of the policies.
        logged: judge the log's own policy too, as the last and under the name `LOGGED`: at each row it does what was logged.
        out: folder of checkpoints, from which a killed fit goes on; None keeps nothing.
        watch: called with what is fitted, the updates done and those in all.

    Raises:
        UserError: a log or policies that no estimator can work with.
    """

    def __init__(
        self,
        data: Dataset,
        policies: Any,
        *,
        discount: float = 0.995,
        seed: int = 0,
        greedy: bool = False,
        names: Sequence[str] | None = None,
        logged: bool = False,
        out: Path | str | None = None,
        watch: Watcher = lambda what, step, steps: None,
    ):
        if not 0.0 <= discount < 1.0:
            raise UserError(f"discount must be 0 .. 1 without 1, got {discount}")
        if not 0 <= seed < 2**32:
            raise UserError(f"seed must be 0 .. 2^32 - 1, got {seed}")
        self.policies = _policies(policies)
        if not self.policies:
            raise UserError("no policy to judge")
        self.names = tuple(names) if names is not None else tuple(f"policy {i}" for i in range(len(self.policies)))
        if len(self.names) != len(self.policies):
            raise UserError(f"{len(self.policies)} policies need as many names, got {len(self.names)}")
        if len(data.spec.observation_shape) != 1:
            raise UserError(f"estimators need flat observations, {data.name} has shape {data.spec.observation_shape}")
        self.data, self.discount, self.seed, self.greedy = data, discount, seed, greedy
        self.out, self.watch = None if out is None else Path(out), watch
        if len(set(self.names)) < len(self.names) or LOGGED in self.names:
            raise UserError(f"names must differ, and from {LOGGED!r}, got {', '.join(self.names)}")
        self.actor = Actor(self.policies, self.names, data.spec, greedy, seed)
        self.logged = logged
        if logged:
            self.names = (*self.names, LOGGED)
        self._kept: dict[Any, Any] = {}
        self._metrics: dict[str, dict[int, dict[str, float]]] = {}  # of each fit, by updates done

    @property
    def count(self) -> int:
        """Policies that are judged, the log's own among them where it is."""
        return len(self.names)

    # ---- what policies do -------------------------------------------------------------------------------------------

    def next_actions(self, samples: int) -> np.ndarray:
        """(rows, policies, ...) table of what the policies do after each row; see `Actor.table`."""
        # What the log's policy would have done after an episode's last row is not known; its last action stands in.
        rows = np.arange(len(self.data))
        after = np.where(self.data._is_end, rows, rows + 1)
        return self._table("next", _Following(self.data), samples, NEXT, after)

    def initial_actions(self, samples: int) -> np.ndarray:
        """(episodes, policies, ...) table of what the policies do at the initial observations."""
        starts = self.data.starts
        return self._table("initial", np.asarray(self.data.observations[starts]), samples, INITIAL, starts)

    def current_actions(self, samples: int) -> np.ndarray:
        """(rows, policies, ...) table of what the policies do at each row."""
        return self._table("current", self.data.observations, samples, CURRENT, np.arange(len(self.data)))

    def final_actions(self, samples: int) -> np.ndarray:
        """(episodes, policies, ...) table of what the policies do at the final observations."""
        return self._table("final", self.data.final_observations, samples, FINAL, self.data.ends)

    def _table(self, name: str, observations: Any, samples: int, purpose: int, rows: np.ndarray) -> np.ndarray:
        """The policies' table; the log's own policy does what it did at `rows`."""

        def make() -> np.ndarray:
            table = self.actor.table(observations, samples, purpose, more=int(self.logged))
            if self.logged:
                taken = np.asarray(self.data.actions)[rows]
                own = np.eye(table.shape[-1])[taken] if table.ndim == 3 else View.of(self.data.spec).to_unit(taken)[:, None]
                table[:, -1] = own
            return table

        # Probabilities are the same however many draws are asked for.
        return self.once((name, None if self.data.spec.discrete else samples), make)

    @cached_property
    def log_probs(self) -> np.ndarray:
        """(policies, rows) log-probabilities of the logged actions, without the log's own policy."""
        return self.actor.log_probs(self.data.observations, self.data.actions)

    def behavior_log_probs(self, kind: Literal["auto", "logged", "learned"], model: BehaviorModel) -> np.ndarray:
        """(rows,) log-probabilities of the logged actions under the policy that made the log.

        Args:
            kind: `logged` takes the log's column `behavior_log_probs`, `learned` fits `model`, `auto` fits it where there is
                no such column.
            model: how it is learned.
        """
        column = self.data.extras.get("behavior_log_probs")
        if kind == "logged" and column is None:
            raise UserError(f"{self.data.name} has no column behavior_log_probs; ask for behavior='learned'")
        if kind != "learned" and column is not None:
            return np.asarray(column, np.float64)
        return self.once(("behavior", model), lambda: self._learned(model))

    def _learned(self, model: BehaviorModel) -> np.ndarray:
        return self.behavior(model).log_probs(self.data.observations, self.data.actions)[0]

    def behavior(self, model: BehaviorModel) -> Actor:
        """A model of the policy that made the log, which draws its actions; made once."""
        clipped = any(isinstance(getattr(policy, "inner", None), ClippedGaussian) for policy in self.policies)
        model = dataclasses.replace(model, clipped=clipped)

        def make() -> Actor:
            rows = Rows(self.data, model.needs(self.data.spec))
            fitted, _ = self.train(model, rows, model.steps, "behaviour")
            policy = Deployed.of(models.policy(fitted), rows.view)
            return Actor([policy], ["the behaviour model"], self.data.spec, False, self.seed)

        return self.once(("behavior policy", model), make)

    # ---- fits -------------------------------------------------------------------------------------------------------

    def train(self, learner: Any, rows: Rows, steps: int, what: str) -> Any:
        """The state of a learner after `steps` updates, gone on with from its checkpoints where there are some.

        Raises:
            UserError: its numbers went bad.
        """
        folder = None if self.out is None else self._folder(learner, rows, steps, what)
        with contextlib.nullcontext() if folder is None else alone(folder, f"fits {what} already"):
            return self._train(learner, rows, steps, what, folder)

    def _train(self, learner: Any, rows: Rows, steps: int, what: str, folder: Path | None) -> Any:
        job = Fit([learner], rows, [self.seed], steps, chunk=max(1, min(1000, steps // 10)), folder=folder)
        kept = None if folder is None else folder / "metrics.json"
        known = read_json(kept)["metrics"] if kept is not None and kept.exists() else []
        seen = self._metrics[what] = {step: metrics for step, metrics in known}

        def told(progress: Progress) -> None:
            # What a kill lost is computed, and noted, again.
            seen[progress.step] = {name: float(value[0]) for name, value in progress.metrics.items()}
            if kept is not None:  # for who asks again when the fit is done
                write_json(kept, {"metrics": list(seen.items())})
            self.watch(what, progress.step, steps)

        complete(job, what, told)
        return jax.tree.map(lambda leaf: leaf[0], job.states)

    def unsettled(self, what: str, metric: str) -> list[str]:
        """A warning if a metric of a fit still changed by more than 5 % over its last fifth, else nothing."""
        seen = self._metrics.get(what, {})
        last = max(seen, default=0)
        early = max((step for step in seen if step <= 0.8 * last), default=None)
        if early is None:
            return []
        value, before = seen[last][metric], seen[early][metric]
        change = abs(value - before) / max(abs(value), abs(before), 1e-12)
        if change <= SETTLED:
            return []
        found = f"{metric} by {100 * change:.0f} % over its last fifth"
        return [f"{what} still changes: {found}; more than {last:,} updates are needed"]

    def _folder(self, learner: Any, rows: Rows, steps: int, what: str) -> Path:
        """Where a fit's checkpoints lie: a folder of its own for every log, set of policies and setting."""
        assert self.out is not None
        columns = {name: column.shape for name, column in {**rows.extra, **(rows.initial or {})}.items()}
        asked = {
            "learner": described(learner), "steps": steps, "log": rows.log.fingerprint, "policies": self._manner,
            "columns": columns, "discount": self.discount, "greedy": self.greedy, "seed": self.seed,
        }  # fmt: skip
        return folder_of(self.out, what, asked)

    @cached_property
    def _manner(self) -> str:
        """Tells sets of policies apart by what they do at observations from all over the log."""
        some = np.unique(np.linspace(0, len(self.data) - 1, 256).astype(int))
        done = self.actor.table(np.asarray(self.data.observations[some]), 1)
        return hashlib.blake2b(np.ascontiguousarray(done).tobytes(), digest_size=16).hexdigest()

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """What `make` gives, made once."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def redrawn(self, members: int) -> np.ndarray:
        """(episodes, members) how often each episode counts for each member of an ensemble: redrawn with replacement.

        One member alone counts every episode once.
        """
        return redrawn(self.data.episodes, members, self.seed)


class Estimator(eqx.Module):
    """Hyperparameters in, estimates out."""

    def estimate(
        self,
        data: Dataset,
        policies: Any,
        *,
        discount: float = 0.995,
        seed: int = 0,
        greedy: bool = False,
        names: Sequence[str] | None = None,
        logged: bool = False,
        out: Path | str | None = None,
        watch: Watcher = lambda what, step, steps: None,
    ) -> Estimates:
        """The value of each policy, from the log alone; see `Case` for the arguments."""
        options = {"discount": discount, "seed": seed, "greedy": greedy, "names": names, "logged": logged}
        return self.on(Case(data, policies, **options, out=out, watch=watch))

    def on(self, case: Case) -> Estimates:
        """The same on a case that several estimators share."""
        for each in (self, *vars(self).values()):
            if isinstance(each, eqx.Module):
                check_fields(each)
        begun = time.perf_counter()
        found = self.solve(case)
        warnings = found.warnings
        if getattr(self, "members", None) == 1:
            warnings = (*warnings, f"{found.method} has one member, which gives no interval; more members do")
        return dataclasses.replace(found, warnings=warnings, seconds=time.perf_counter() - begun)

    @property
    def label(self) -> str:
        """What tables call it."""
        raise NotImplementedError

    def solve(self, case: Case) -> Estimates:
        """What the estimator is."""
        raise NotImplementedError

    def replace(self, **changes: Any) -> Any:
        """The same estimator with some fields changed."""
        return dataclasses.replace(self, **changes)


class _Following:
    """The observations after each row, made block by block."""

    def __init__(self, data: Dataset):
        self.data = data

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self.data.next_observations_at(np.arange(*rows.indices(len(self.data))))


def _policies(given: Any) -> list[Any]:
    if hasattr(given, "policies"):  # a run
        return list(given.policies)
    if isinstance(given, Policy):
        return [given]
    if isinstance(given, Sequence) and not isinstance(given, str | bytes):
        return [policy for one in given for policy in _policies(one)]
    raise UserError(f"policies must be policies or runs, got {type(given).__name__}")
