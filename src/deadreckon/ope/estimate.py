"""What every estimator is asked (`Case`) and answers (`Estimates`). What is estimated is an `Estimand`, for all alike."""

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
from deadreckon.ope.estimand import Estimand, discounted_steps
from deadreckon.ope.features import Table
from deadreckon.ope.tables import NOISE, Actor
from deadreckon.ope.weights import GROUPS, Episodes
from deadreckon.policies import behavior as models
from deadreckon.policies.policy import ClippedGaussian, Deployed, Policy, create_actor
from deadreckon.stats import inference
from deadreckon.stats.interval import PERCENT
from deadreckon.training.checkpoint import folder_of
from deadreckon.training.fit import Fit, Progress, complete
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, check_fields, described, static

Watcher = Callable[[str, int, int], None]  # gets what is fitted, updates done and updates in all
NEXT, INITIAL, CURRENT, FINAL = range(4)  # purposes of draws
SETTLED = 0.05  # relative change of a fit's metric over its last fifth beyond which one is warned
LOGGED = "behaviour policy"  # the name of the policy that made the log
APART = "judges each policy by all episodes, and cross-fitted ones are one for each fold, taught by the others; use dr-linear"
WEIGHTLESS = "need weights, which mean nothing for policies of continuous actions that do not draw them"


@dataclass(frozen=True)
class Estimates:
    """What an estimator says about each policy.

    Attributes:
        method: the estimator.
        names: of the policies.
        value: (policies,) expected discounted return of an episode.
        low, high: (policies,) ends of intervals at `stats.interval.LEVEL`; NaN where the method gives none.
        estimand: what is estimated.
        redraws: (n, policies) estimates of redrawn logs or of members of an ensemble, the same redraws for all policies, so
            that differences between policies can be judged; None where there are none.
        influence: (units, policies) influence function of the estimates at each unit of the log (`Case.units`: episodes,
            clusters or groups of them), which has mean zero; the sum of its squares over units^2 is the variance of the
            estimate. The same units for all policies and methods of a case, so that gains are paired. None where there is none.
        effective: (policies,) effective sample size of the weights, (sum w)^2 / sum w^2 in episodes; None where nothing is
            weighted.
        corrected: whether logged rewards, weighted by how likely the policy is to act as logged, decide the estimate. Otherwise
            it is model-based: an error of the fitted model is not corrected by anything.
        warnings: why not to trust it, one line each.
        seconds: it took, without what was there already for another estimator.
        diagnostics: further numbers about the estimate by name, each (policies,); the checks of a decision read them.
        inflation: (policies,) by which errors are multiplied, beyond what the influence function says; see `Case.inflation`.
            None: by one.
    """

    method: str
    names: tuple[str, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    estimand: Estimand
    redraws: np.ndarray | None = field(default=None, repr=False)
    influence: np.ndarray | None = field(default=None, repr=False)
    effective: np.ndarray | None = None
    corrected: bool = False
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    diagnostics: dict[str, np.ndarray] = field(default_factory=dict, repr=False)
    inflation: np.ndarray | None = field(default=None, repr=False)

    @classmethod
    def of_influence(cls, method: str, case: "Case", value: np.ndarray, influence: np.ndarray, **more: Any) -> "Estimates":
        """Estimates of (policies,) values with (units, policies) influence functions, and intervals by them, each for
        itself.
        """
        low, high = inference.intervals(value, influence, seed=case.seed)
        if (weights := more.get("effective")) is not None:  # without weights nothing is known
            low, high = np.where(weights > 0, low, -np.inf), np.where(weights > 0, high, np.inf)
        return cls(method, case.names, value, low, high, case.estimand, influence=influence, **more)

    @property
    def discount(self) -> float:
        """Of the returns."""
        return self.estimand.discount

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
        model = "" if self.corrected else ", model-based"
        lines = [f"{self.method}{model}: {self.estimand}; {PERCENT} intervals"]
        for i, name in enumerate(self.names):
            weight = "" if self.effective is None else f"   effective sample size {self.effective[i]:,.1f} episodes"
            lines.append(f"  {name:<{width}}  {self.value[i]:10.2f} [{self.low[i]:.2f}, {self.high[i]:.2f}]{weight}")
        return "\n".join([*lines, *(f"  warning: {line}" for line in self.warnings)])


@dataclass(frozen=True)
class CrossFitted:
    """A policy that was learned once for each fold, judged on each episode as the one that has not learned from it.

    Its value is that of the mixture which draws one of the policies for each episode, where folds are equally large.

    Attributes:
        policies: one a fold.
        which: (episodes of the log,) the policy of each episode.
    """

    policies: tuple[Any, ...]
    which: np.ndarray


class BehaviorModel(eqx.Module):
    """The behaviour policy, a tanh-Gaussian or categorical network by maximum likelihood (thesis 8.5).

    Beside policies that are clipped Gaussians it is one itself: what these have at the bounds are probabilities, which no
    density may divide.
    """

    hidden: Sizes = static((256, 256))  # width of each hidden layer
    lr: NonNegative = 3e-4  # learning rate
    steps: Count = static(10_000)  # updates; out of fold the best by validation loss are kept
    batch_size: Count = static(256)  # rows a batch
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
        discount: of the returns; one where episodes end or have a horizon.
        seed: random seed.
        greedy: deterministic (greedy) instead of sampled actions of the policies.
        names: of the policies.
        logged: judge the log's own policy too, as the last and under the name `LOGGED`: at each row it does what was logged.
        out: folder of checkpoints, from which a killed fit goes on; None keeps nothing.
        watch: called with what is fitted, the updates done and those in all.
        horizon: steps of an episode that count, None for all, or "auto"; see `Estimand.of`.
        held: (n,) indices of the episodes that policies are judged on; None: all. The other episodes of `data`, which may have
            taught the policies, only help to fit what doubly robust estimators need.
        clusters: (episodes of `data`,) integers that are equal for episodes of one cluster, such as a user; None: each episode
            is one. Clusters are redrawn as one wherever intervals are made.
        noise: given to deterministic policies where weights need a density; None: their weights are zero; see `Actor`.

    Attributes:
        log: all episodes, cut to the horizon.
        data: those that are judged, cut to the horizon.
        estimand: what is estimated.

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
        horizon: int | Literal["auto"] | None = None,
        held: np.ndarray | None = None,
        clusters: np.ndarray | None = None,
        noise: float | None = NOISE,
    ):
        self.estimand = Estimand.of(data, discount, horizon, greedy)
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
        self.discount, self.seed, self.greedy = discount, seed, greedy
        self.held = np.arange(data.episodes) if held is None else np.asarray(held)
        if len(np.unique(self.held)) < len(self.held) or not len(self.held):
            raise UserError("held must be different episodes of the log, one or more")
        if clusters is not None and np.shape(clusters) != (data.episodes,):
            raise UserError(f"clusters must be one number an episode, ({data.episodes},), got {np.shape(clusters)}")
        self._given = data
        self.log = self.estimand.cut(data)
        self.data = self.log if held is None else self.log.select(self.held)
        self.clusters = np.arange(data.episodes) if clusters is None else np.unique(clusters, return_inverse=True)[1]
        self.out, self.watch = None if out is None else Path(out), watch
        if len(set(self.names)) < len(self.names) or LOGGED in self.names:
            raise UserError(f"names must differ, and from {LOGGED!r}, got {', '.join(self.names)}")
        self._parts: list[np.ndarray | None] = [None] * len(self.policies)
        acting, acting_names = [], []
        for i, policy in enumerate(self.policies):
            if isinstance(policy, CrossFitted):
                which = np.asarray(policy.which)[self.held]
                if which.min() < 0 or which.max() >= len(policy.policies):
                    raise UserError(f"{self.names[i]} has no policy for some judged episodes; each needs that of a fold")
                self._parts[i] = len(acting) + which
                acting += policy.policies
                acting_names += [f"{self.names[i]} fold {k}" for k in range(len(policy.policies))]
            else:
                acting.append(policy)
                acting_names.append(self.names[i])
        self.owner = np.repeat(
            np.arange(len(self.policies)),
            [len(p.policies) if isinstance(p, CrossFitted) else 1 for p in self.policies],
        )
        self.actor = Actor(acting, acting_names, data.spec, greedy, seed, noise)
        self.logged = logged
        if logged:
            self.names = (*self.names, LOGGED)
        self._kept: dict[Any, Any] = {}
        self._metrics: dict[str, dict[int, dict[str, float]]] = {}  # of each fit, by updates done

    @property
    def count(self) -> int:
        """Policies that are judged, the log's own among them where it is."""
        return len(self.names)

    @cached_property
    def units(self) -> np.ndarray:
        """(episodes of `data`,) unit of each episode, 0 .. n - 1: its cluster, or a random group of clusters where there are
        more than `GROUPS`. Units are what is redrawn and what influence functions are summed over."""
        own = np.unique(self.clusters[self.held], return_inverse=True)[1]
        count = int(own.max()) + 1
        mixed = np.random.default_rng([self.seed, 2]).permutation(np.arange(count) % min(count, GROUPS))
        return mixed[own]

    @cached_property
    def episodes(self) -> Episodes:
        """The shape of the judged episodes, as weighted sums need it."""
        return Episodes(self.data, self.discount, self.seed, self.units)

    @cached_property
    def time(self) -> np.ndarray:
        """(rows,) steps since the episode's start."""
        return np.arange(len(self.data)) - np.repeat(self.data.starts, self.data.lengths)

    @cached_property
    def ended(self) -> np.ndarray:
        """(rows,) whether the task ended there: terminals of the log, without the ends that the horizon makes."""
        return self._uncut[0]

    @cached_property
    def followed(self) -> np.ndarray:
        """(rows,) whether what follows the row is known, also where the horizon ends the episode, or the task ended there."""
        return self._uncut[1]

    @cached_property
    def shown(self) -> np.ndarray:
        """(rows,) whether it is known what the behaviour policy did next: the log shows it, or how often it does so there, or
        nothing comes next."""
        return ~self.data._is_end | self.ended | (self._habits is not None)

    @cached_property
    def beyond(self) -> float:
        """Share of the discounted time that is asked for and lies beyond the ends of the recording."""
        cut = ~np.asarray(self.data.terminals)[self.data.ends]
        if not cut.any():
            return 0.0
        lengths, horizon = self.data.lengths, self.estimand.horizon
        if horizon is None:
            return float((self.discount**lengths * cut).mean())
        done = np.array([discounted_steps(self.discount, steps) for steps in range(horizon + 1)])
        return float((1.0 - done[lengths] / done[-1])[cut].sum() / len(cut))

    @cached_property
    def _habits(self) -> np.ndarray | None:
        """(episodes, actions) probabilities of the behaviour policy at the final observations, where these are few and have
        actions elsewhere in the log; None where they are many, or nothing is cut off."""
        if self.data.terminals[self.data.ends].all() or (table := Table.of(self.log)) is None:
            return None
        return table.shares(self.log)[table.codes(np.asarray(self.data.final_observations))]

    @cached_property
    def _uncut(self) -> tuple[np.ndarray, np.ndarray]:
        if self.estimand.horizon is None:
            return np.asarray(self.data.terminals), self.data.usable
        whole = self._given.select(self.held)
        time = np.arange(len(whole)) - np.repeat(whole.starts, whole.lengths)
        kept = time < self.estimand.horizon
        return np.asarray(whole.terminals)[kept], whole.usable[kept]

    def folds(self, count: int) -> np.ndarray:
        """(episodes of `data`,) fold of each, 0 .. count - 1, or as many as there are clusters; clusters stay whole."""
        own = np.unique(self.clusters[self.held], return_inverse=True)[1]
        clusters = int(own.max()) + 1
        if clusters < 2:
            raise UserError(f"{self.data.name}: one episode or cluster cannot be cross-fitted; two or more are needed")
        dealt = np.random.default_rng([self.seed, 9]).permutation(np.arange(clusters) % min(count, clusters))
        return dealt[own]

    def teaching(self, rows: int | None = None) -> "Case | None":
        """The episodes that are not judged, as a case with the same policies; None where all are.

        Args:
            rows: of them; where there are more, a random part of the episodes with about so many. None: all.
        """
        others = np.setdiff1d(np.arange(self._given.episodes), self.held)
        if rows is not None and (lengths := self._given.lengths[others]).sum() > rows:
            drawn = np.random.default_rng([self.seed, 13]).permutation(len(others))
            others = np.sort(others[drawn[: max(int(np.searchsorted(np.cumsum(lengths[drawn]), rows)), 1)]])
            return self.once(("teaching", rows), lambda: self._beside(others))
        return self.once("teaching", lambda: self._beside(others)) if len(others) else None

    def whole(self) -> "Case":
        """All episodes of the log, as a case with the same policies."""
        if len(self.held) == self._given.episodes and (np.diff(self.held) > 0).all():
            return self
        return self.once("whole", lambda: self._beside(None))

    def _beside(self, held: np.ndarray | None) -> "Case":
        # What is not judged only teaches nuisances; an episode of no fold has the policy of any.
        policies = [
            CrossFitted(p.policies, np.where(np.asarray(p.which) < 0, np.arange(len(p.which)) % len(p.policies), p.which))
            if isinstance(p, CrossFitted) else p
            for p in self.policies
        ]  # fmt: skip
        return Case(
            self._given, policies, discount=self.discount, horizon=self.estimand.horizon, seed=self.seed,
            greedy=self.greedy, names=self.names[: len(self.policies)], logged=self.logged, out=self.out, watch=self.watch,
            held=held, clusters=self.clusters, noise=self.actor.noise,
        )  # fmt: skip

    @cached_property
    def span(self) -> float:
        """What a return is divided by to be on the scale of a reward."""
        return self.estimand.span(self.data)

    @cached_property
    def timed(self) -> Dataset:
        """`data` as critics see it: where only so many steps count, observations tell how many have passed (0 to 1)."""
        return _timed(self.data, self.estimand.horizon)

    # ---- what policies do -------------------------------------------------------------------------------------------

    def next_actions(self, samples: int) -> np.ndarray:
        """(rows, policies, ...) table of what the policies do after each row; see `Actor.table`."""
        # Where nobody knows what the log's policy would have done after an episode's last row, its last action stands in.
        rows = np.arange(len(self.data))
        after = np.where(self.data._is_end, rows, rows + 1)
        return self._table("next", _Following(self.data), samples, NEXT, after)

    def initial_actions(self, samples: int) -> np.ndarray:
        """(episodes, policies, ...) table of what the policies do at the initial observations."""
        starts = self.data.starts
        if self.data.spec.discrete and len(starts) == len(self.data):  # the same rows, whose probabilities are no draws
            return self.current_actions(samples)
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
            if self.crossed:
                own = [table[np.arange(len(table)), each] for each in self._acting(self.data.episode_of[rows])]
                table = np.stack([*own, *([table[:, -1]] if self.logged else [])], 1)
            if self.logged:
                taken = np.asarray(self.data.actions)[rows]
                own = np.eye(table.shape[-1])[taken] if table.ndim == 3 else View.of(self.data.spec).to_unit(taken)[:, None]
                if self._habits is not None and name == "next":
                    own[self.data.ends] = self._habits
                table[:, -1] = own if self._habits is None or name != "final" else self._habits
            return table

        # Probabilities are the same however many draws are asked for.
        return self.once((name, None if self.data.spec.discrete else samples), make)

    @cached_property
    def log_probs(self) -> np.ndarray:
        """(policies, rows) log-probabilities of the logged actions, without the log's own policy."""
        found = self.actor.log_probs(self.data.observations, self.data.actions)
        if not self.crossed:
            return found
        return np.stack([found[each, np.arange(found.shape[1])] for each in self._acting(self.data.episode_of)])

    @property
    def crossed(self) -> bool:
        """Whether some of the policies are cross-fitted."""
        return len(self.owner) > len(self.policies)

    @cached_property
    def inflation(self) -> np.ndarray:
        """(policies, with the behaviour policy,) by which errors are multiplied: sqrt(2) of cross-fitted policies, else one.

        Folds judge each other's policies. Where one fold by chance likes an action, the other's policy takes it, and the
        other way round, so that their errors are the same twice and not independent: with t_k the chance of fold k, the
        estimate is sum_{k != l} t_k t_l, whose variance is twice the sum of those of its folds. No estimate of that from one
        cross-fit is unbiased (Bengio and Grandvalet 2004), so the most of it is taken.
        """
        crossed = np.bincount(self.owner, minlength=len(self.policies)) > 1
        return np.where(np.append(crossed, [False] * int(self.logged)), np.sqrt(2.0), 1.0)

    @cached_property
    def degenerate(self) -> np.ndarray:
        """(policies,) whether importance weights mean nothing; see `Actor.degenerate`."""
        return np.bincount(self.owner, self.actor.degenerate, len(self.policies)) > 0

    def _acting(self, episodes: np.ndarray) -> list[np.ndarray]:
        """For each policy, which of the actor's acts in these episodes."""
        first = np.searchsorted(self.owner, np.arange(len(self.policies)))
        return [np.full(len(episodes), first[i]) if part is None else part[episodes] for i, part in enumerate(self._parts)]

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

    @property
    def clips(self) -> bool:
        """Whether policies have probabilities at the bounds of the actions, as clipped Gaussians do."""
        return any(isinstance(getattr(policy, "inner", None), ClippedGaussian) for policy in self.actor.policies)

    def behavior(self, model: BehaviorModel) -> Actor:
        """A model of the policy that made the log, which draws its actions; made once."""
        model = dataclasses.replace(model, clipped=self.clips)

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
            "learner": described(learner), "steps": steps, "log": rows.log.fingerprint, "policies": self.manner,
            "columns": columns, "estimand": self.estimand.as_json(), "seed": self.seed,
        }  # fmt: skip
        return folder_of(self.out, what, asked)

    @cached_property
    def manner(self) -> str:
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
        own = np.unique(self.clusters[self.held], return_inverse=True)[1]
        return redrawn(int(own.max()) + 1, members, self.seed)[own]


class Estimator(eqx.Module):
    """Hyperparameters in, estimates out."""

    takes_horizon = False  # whether it can count the first steps of an episode only, and take a discount of one
    # Whether it can judge cross-fitted policies: weights are of single rows. What is fitted to all folds for a policy has the
    # rewards that taught it, and what follows policies from state to state needs one for all states.
    takes_crossed = False

    def estimate(
        self,
        data: Dataset,
        policies: Any,
        **options: Any,
    ) -> Estimates:
        """The value of each policy, from the log alone; see `Case` for the options."""
        return self.on(Case(data, policies, **options))

    def on(self, case: Case) -> Estimates:
        """The same on a case that several estimators share."""
        for each in (self, *vars(self).values()):
            if isinstance(each, eqx.Module):
                check_fields(each)
        if case.estimand.horizon not in (None, 1) and not self.takes_horizon:
            raise UserError(f"{self.label} does not take a horizon; use FQE, importance sampling or a doubly robust estimator")
        if case.discount == 1.0 and not self.takes_horizon:
            raise UserError(f"{self.label} needs a discount below 1, got 1")
        if case.crossed and not self.takes_crossed:
            raise UserError(f"{self.label} {APART}")
        begun = time.perf_counter()
        found = self.solve(case)
        warnings = found.warnings
        if getattr(self, "members", None) == 1:
            warnings = (*warnings, f"{found.method} has one member, which gives no interval; more members do")
        if case.crossed:
            more, middle = case.inflation, found.value
            low, high = middle - more * (middle - found.low), middle + more * (found.high - middle)
            found = dataclasses.replace(found, low=low, high=high, inflation=more)
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


def _timed(data: Dataset, horizon: int | None) -> Dataset:
    if horizon is None or horizon == 1:
        return data
    time = np.arange(len(data)) - np.repeat(data.starts, data.lengths)
    with_time = lambda seen, t: np.concatenate([np.asarray(seen), (t / horizon).astype(np.float32)[:, None]], 1)  # noqa: E731
    final = with_time(data.final_observations, data.lengths)
    successors = None if data.successors is None else with_time(data.successors, time + 1)
    observations = with_time(data.observations, time)
    return dataclasses.replace(data, observations=observations, final_observations=final, successors=successors)


class _Following:
    """The observations after each row, made block by block."""

    def __init__(self, data: Dataset):
        self.data = data

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self.data.next_observations_at(np.arange(*rows.indices(len(self.data))))


def _policies(given: Any) -> list[Any]:
    if isinstance(given, Policy | CrossFitted):
        return [given]
    if hasattr(given, "policies"):  # a run
        return list(given.policies)
    if isinstance(given, Sequence) and not isinstance(given, str | bytes):
        return [policy for one in given for policy in _policies(one)]
    raise UserError(f"policies must be policies or runs, got {type(given).__name__}")
