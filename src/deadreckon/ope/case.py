"""The input of every estimator: a log, policies, and the computations that estimators share."""

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Unpack

import numpy as np

from deadreckon.data.batch import TransitionSource, redrawn
from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import rows_of
from deadreckon.data.normalizer import EDGE, Normalizer
from deadreckon.data.split import clusters as clusters_of
from deadreckon.errors import UserError
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.ends import within_bounds
from deadreckon.ope.estimand import TAIL, discounted_steps
from deadreckon.ope.estimates import LOGGED
from deadreckon.ope.features import Table
from deadreckon.ope.fits import Fits
from deadreckon.ope.histories import with_histories
from deadreckon.ope.pictures import behind, with_features
from deadreckon.ope.positions import with_positions
from deadreckon.ope.sequences import times
from deadreckon.ope.settings import EstimateOptions, EstimateSettings
from deadreckon.ope.tables import NOISE, Actor
from deadreckon.ope.weights import GROUPS, Episodes
from deadreckon.policies import behavior as models
from deadreckon.policies.deployed import EnvPolicy, memoryless
from deadreckon.policies.kinds import ClippedGaussian
from deadreckon.policies.resolve import policies_of
from deadreckon.randomness import generator, sequence
from deadreckon.training.pictures import of_pictures

LARGEST = 1e15  # size of a reward: the mean square of such values is still within float32
WITHIN = 1.0 - 1e-4  # an action on the scale of -1 to 1 that is just within the bounds
WEIGHTLESS = "need importance weights, which are degenerate for deterministic policies with continuous actions"


@dataclass(frozen=True)
class CrossFitted:
    """A policy that was trained once per fold, evaluated on each episode by the one that was not trained on it.

    Its value is that of the mixture which draws one of the policies for each episode, if folds are equally large.

    Attributes:
        policies: one per fold.
        which: (episodes of the log,) the policy of each episode.
        drawn: whether `which` was drawn at random for another log, on which none of the policies was trained.
    """

    policies: tuple[Any, ...]
    which: np.ndarray
    drawn: bool = False


class OPEInput(Fits):
    """A log, the policies to evaluate, and the computations that estimators share, each made on first use.

    Args:
        data: the log.
        policies: a policy, a policy file, a run, or a sequence of these.
        names: of the policies.
        logged: also evaluate the behaviour policy, as the last one and under the name `LOGGED`: at each row it takes the logged
            action.
        held: (n,) indices of the episodes that policies are evaluated on; None: all. The other episodes of `data`, on which the
            policies may have been trained, are only used to fit the models of doubly robust estimators.
        clusters: (episodes of `data`,) integers that are equal for episodes of one cluster, such as a user; None: each episode
            is one, or all copies of it (`data.repeats`). Clusters are resampled as a whole for all intervals.
        noise: added to deterministic policies if weights need a density; None: their weights are zero; see `Actor`.
        positions: whether models of the behaviour policy and of values see each episode's position in the log, which policies
            do not; see `ope.over_time`.
        **options: `discount`, `horizon` (see `Estimand.of`), `greedy`, `seed`, `out` and `watch`; see
            `ope.settings.EstimateSettings`.

    Attributes:
        settings: the same as one object.
        log: all episodes, cut to the horizon; its observations are histories if policies act on these (`ope.histories`), and
            features if they are images (`ope.pictures`).
        data: the evaluated episodes, cut to the horizon.
        plain: `log` without positions.
        estimand: what is estimated.

    Raises:
        UserError: a log or policies that no estimator can use.
    """

    def __init__(
        self,
        data: Dataset,
        policies: Any,
        *,
        names: Sequence[str] | None = None,
        logged: bool = False,
        held: np.ndarray | None = None,
        clusters: np.ndarray | None = None,
        noise: float | None = NOISE,
        positions: bool = False,
        **options: Unpack[EstimateOptions],
    ):
        self.settings = EstimateSettings.of(options)
        super().__init__(self.settings.estimand(data), self.settings)
        self.policies = policies_of(policies, (CrossFitted,))
        if not self.policies:
            raise UserError("no policy to evaluate")
        self.names = tuple(names) if names is not None else tuple(f"policy {i}" for i in range(len(self.policies)))
        if len(self.names) != len(self.policies):
            raise UserError(f"{len(self.policies)} policies need as many names, got {len(self.names)}")
        pictures = of_pictures(data.spec)
        if len(data.spec.observation_shape) != 1 and not pictures:
            raise UserError(f"estimators need flat observations, {data.name} has shape {data.spec.observation_shape}")
        if (largest := float(np.abs(data.rewards).max())) > LARGEST:
            told = f"{data.name}: rewards reach {largest:.3g} in size, and models of values square them in float32"
            raise UserError(f"{told}; divide the column until they are below {LARGEST:g}")
        if logged:
            check_order(data)
        self.discount = self.estimand.discount
        self.held = np.arange(data.episodes) if held is None else _different(held, data.episodes)
        if clusters is not None and np.shape(clusters) != (data.episodes,):
            raise UserError(f"clusters must be one number per episode, ({data.episodes},), got {np.shape(clusters)}")
        self.given = data
        each = [p.policies if isinstance(p, CrossFitted) else (p,) for p in self.policies]
        flat = [one for own in each for one in own]
        whose = [name for name, own in zip(self.names, each) for _ in own]
        data, seen = with_features(data, flat, whose) if pictures else with_histories(data, flat)
        self.clusters = clusters_of(self.given) if clusters is None else np.unique(clusters, return_inverse=True)[1]
        self.positions, plain = positions, data
        if positions:
            data, seen = with_positions(data, self.clusters, seen, len(flat))
        self.log = self.estimand.cut(data)
        self.plain = self.estimand.cut(plain) if positions else self.log
        self.data = self.log if held is None else self.log.select(self.held)
        if len(set(self.names)) < len(self.names) or LOGGED in self.names:
            raise UserError(f"names must differ, and from {LOGGED!r}, got {', '.join(self.names)}")
        self._parts = [np.asarray(p.which)[self.held] if isinstance(p, CrossFitted) else None for p in self.policies]
        acting = []
        for name, own, part in zip(self.names, each, self._parts):
            if part is not None and (part.min() < 0 or part.max() >= len(own)):
                raise UserError(f"{name} has no policy for some evaluated episodes; each needs that of a fold")
            acting += [name] if part is None else [f"{name} fold {k}" for k in range(len(own))]
        self.owner = np.repeat(np.arange(len(self.policies)), [len(own) for own in each])
        self.actor = Actor(
            [behind(memoryless(p)) for p in flat], acting, data.spec, self.estimand.greedy, self.seed, noise, seen
        )
        self.logged = logged
        if logged:
            self.names = (*self.names, LOGGED)

    @property
    def count(self) -> int:
        """Number of evaluated policies, including the behaviour policy if it is one of them."""
        return len(self.names)

    @cached_property
    def units(self) -> np.ndarray:
        """(episodes of `data`,) unit of each episode, 0 .. n - 1: its cluster, or a random group of clusters where there are
        more than `GROUPS`. Units are resampled, and influence functions are summed over them."""
        count = int(self.cluster.max()) + 1
        mixed = generator(self.seed, "units").permutation(np.arange(count) % min(count, GROUPS))
        return mixed[self.cluster]

    @cached_property
    def cluster(self) -> np.ndarray:
        """(episodes of `data`,) cluster of each, 0 .. n - 1."""
        return np.unique(self.clusters[self.held], return_inverse=True)[1]

    @cached_property
    def clustered(self) -> bool:
        """Whether some of the evaluated episodes are of one cluster."""
        return int(self.cluster.max()) + 1 < len(self.cluster)

    @cached_property
    def episodes(self) -> Episodes:
        """The shape of the evaluated episodes, as weighted sums need it."""
        return Episodes(self.data, self.discount, self.seed, self.units)

    def episodes_of(self, part: np.ndarray) -> Episodes:
        """`episodes` for a part of them, a mask (episodes,): the probability of a cut-off is estimated from the part alone."""
        units = np.unique(self.units[part], return_inverse=True)[1]
        return Episodes(self.data.select(np.flatnonzero(part)), self.discount, self.seed, units)

    @cached_property
    def time(self) -> np.ndarray:
        """(rows,) steps since the episode's start."""
        return times(self.data.lengths)

    @cached_property
    def ended(self) -> np.ndarray:
        """(rows,) whether the task ended there: terminals of the log, without the ends that the horizon makes."""
        return self._uncut[0]

    @cached_property
    def followed(self) -> np.ndarray:
        """(rows,) whether the row's successor is known, or the horizon or the task ends the episode there; all true if only the
        first reward counts."""
        return np.ones(len(self.data), bool) if self._alone else self._uncut[1]

    @property
    def _alone(self) -> bool:
        return self.discount == 0.0 or self.estimand.horizon == 1

    @cached_property
    def shown(self) -> np.ndarray:
        """(rows,) whether the behaviour policy's next action is known: the log shows it, or its frequency there, or there is no
        next row."""
        return ~(self.data.is_end | self._apart) | self.ended | (self._habits is not None) | self._alone

    @cached_property
    def _apart(self) -> np.ndarray:
        """(rows,) `Dataset.apart` of the original log: features of one image may differ by rounding between computations."""
        if self.data.successors is None:
            return np.zeros(len(self.data), bool)
        given = self.given  # no horizon cuts such a log
        return given.apart[rows_of(given.starts[self.held], given.lengths[self.held])]

    @cached_property
    def complete(self) -> bool:
        """Whether the log shows the return of each episode: all end at the same step or earlier, and hardly any of the
        estimand's discounted time lies beyond."""
        return self.episodes.even and self.beyond <= TAIL

    @cached_property
    def beyond(self) -> float:
        """Share of the estimand's discounted time that lies beyond the ends of the recording, in the log's episodes."""
        return self._beyond(self.data.lengths, np.asarray(self.data.terminals)[self.data.ends])

    @cached_property
    def cut_ahead(self) -> float:
        """The same share in the episodes that are cut off; 0 if there are none."""
        cut = ~np.asarray(self.data.terminals)[self.data.ends]
        return float(self._ahead[self.data.lengths[cut] - 1].mean()) if cut.any() else 0.0

    def beyond_of(self, log_rho: np.ndarray, part: Episodes | None = None) -> float:
        """`beyond` in a policy's episodes, whose weights estimate how many of them end before they would be cut off; at least
        `beyond`. The uncertainty of this estimate is not known: weights based on few episodes may miss those that are cut off,
        and are reported separately.

        Args:
            log_rho: (rows,) logarithms of the products of its ratios along each episode; see `Episodes.cumulate`.
            part: the evaluated episodes that the rows belong to; None: all of them.
        """
        part = self.episodes if part is None else part
        if self._endless(part).sum() <= (least := self._beyond(part.lengths, part.ended)):  # no policy has more
            return least
        return self._at_least(part, part.going_on(log_rho))

    def beyond_if(self, going_on: np.ndarray) -> float:
        """The same for a policy of whose episodes the share `going_on` (steps,) continues after each step."""
        return self._at_least(self.episodes, going_on)

    def _at_least(self, part: Episodes, going_on: np.ndarray) -> float:
        share, least = float(self._endless(part) @ going_on), self._beyond(part.lengths, part.ended)
        return share if share > least * (1 + 1e-9) else least

    def _beyond(self, lengths: np.ndarray, ended: np.ndarray) -> float:
        return float((self._ahead[lengths - 1] * ~ended).mean())

    def _endless(self, part: Episodes) -> np.ndarray:
        """(steps,) `beyond` of episodes that no terminal ends, by the step after which they are cut off."""
        return -np.diff(part.uncensored) * self._ahead[: part.steps]

    @cached_property
    def _ahead(self) -> np.ndarray:
        """(steps,) share of the estimand's discounted time that lies after each step of the longest episode."""
        steps, horizon = np.arange(1, int(self.data.lengths.max()) + 1), self.estimand.horizon
        if horizon is None:
            return self.discount**steps
        done = np.array([discounted_steps(self.discount, int(step)) for step in steps])
        return 1.0 - done / discounted_steps(self.discount, horizon)

    @property
    def table(self) -> Table | None:
        """The log's different observations, numbered; None if there are many, if models see positions, or if actions are
        continuous. Made once."""
        return None if self.positions else self.once("table", lambda: Table.of(self.log))

    @cached_property
    def _habits(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """A function from (n, d) observations to (n, actions) action frequencies in the log, for next actions that the log does
        not show. None if it shows them all, or if there are too many different observations."""
        whole = self.data.terminals[self.data.ends].all() and not self._apart.any()
        if whole or (table := Table.of(self.plain) if self.positions else self.table) is None:
            return None
        shares, size = table.shares(self.plain), self.plain.spec.observation_size
        return lambda observations: shares[table.codes(np.asarray(observations)[:, -size:])]

    @cached_property
    def _uncut(self) -> tuple[np.ndarray, np.ndarray]:
        if self.estimand.horizon is None:
            return np.asarray(self.data.terminals), self.data.usable
        whole = self.given.select(self.held)
        kept = times(whole.lengths) < self.estimand.horizon
        return np.asarray(whole.terminals)[kept], whole.usable[kept]

    def folds(self, count: int) -> np.ndarray:
        """(episodes of `data`,) fold of each, 0 .. count - 1, or as many as there are clusters; clusters stay whole.

        Raises:
            UserError: fewer than two clusters.
        """
        clusters = int(self.cluster.max()) + 1
        if clusters < 2:
            raise UserError(f"{self.data.name}: one episode or cluster cannot be cross-fitted; two or more are needed")
        dealt = generator(self.seed, "folds").permutation(np.arange(clusters) % min(count, clusters))
        return dealt[self.cluster]

    def teaching(self, rows: int | None = None) -> "OPEInput | None":
        """The episodes that are not evaluated, as a case with the same policies; None if all are.

        Args:
            rows: at most about this many, from a random part of the episodes. None: all.
        """
        others = np.setdiff1d(np.arange(self.given.episodes), self.held)
        if rows is not None and (lengths := self.given.lengths[others]).sum() > rows:
            drawn = generator(self.seed, "teaching").permutation(len(others))
            others = np.sort(others[drawn[: max(int(np.searchsorted(np.cumsum(lengths[drawn]), rows)), 1)]])
            return self.once(("teaching", rows), lambda: self._teaching(others))
        return self.once("teaching", lambda: self._teaching(others)) if len(others) else None

    def _teaching(self, others: np.ndarray) -> "OPEInput":
        found = self._beside(others)
        # Draws depend on the number of a row: a seed of its own keeps its draws independent of those of evaluated rows.
        own = int(sequence(self.seed, "teaching draws").generate_state(1)[0])
        found.actor = dataclasses.replace(found.actor, seed=own)
        return found

    def whole(self) -> "OPEInput":
        """All episodes of the log, as a case with the same policies."""
        if len(self.held) == self.given.episodes and (np.diff(self.held) > 0).all():
            return self
        return self.once("whole", lambda: self._beside(None))

    def _beside(self, held: np.ndarray | None) -> "OPEInput":
        # Episodes that are not evaluated only train nuisance models; one that belongs to no fold gets the policy of any fold.
        policies = [
            dataclasses.replace(p, which=np.where(np.asarray(p.which) < 0, np.arange(len(p.which)) % len(p.policies), p.which))
            if isinstance(p, CrossFitted) else p
            for p in self.policies
        ]  # fmt: skip
        return self._again(self.given, policies, held, self.positions)

    def with_positions(self) -> "OPEInput":
        """The case with models that see the positions of episodes."""
        return self._again(self.given, self.policies, self.held, positions=True)

    def _again(self, log: Dataset, policies: Sequence[Any], held: np.ndarray | None, positions: bool) -> "OPEInput":
        return OPEInput(
            log, policies, names=self.names[: len(self.policies)], logged=self.logged, held=held,
            clusters=self.clusters, noise=self.actor.noise, positions=positions, **vars(self.settings),
        )  # fmt: skip

    def of_rewards(self, rewards: np.ndarray, shared: Sequence[str]) -> "OPEInput":
        """The case with other rewards.

        Args:
            rewards: (rows of the whole log,).
            shared: names of results of `once` that do not depend on rewards.
        """
        log = dataclasses.replace(self.given, rewards=rewards)
        found = self._again(log, self.policies, self.held, self.positions)
        found._kept |= {key: own for key, own in self._kept.items() if (key[0] if isinstance(key, tuple) else key) in shared}
        return found

    @cached_property
    def effective_horizon(self) -> float:
        """The divisor that brings a return to the scale of a reward."""
        return self.estimand.effective_horizon(self.data)

    @cached_property
    def timed(self) -> Dataset:
        """`data` as critics use it: with a horizon, observations include the elapsed share of it (0 to 1)."""
        return _timed(self.data, self.estimand.horizon)

    # ---- actions of policies ----------------------------------------------------------------------------------------

    def next_actions(self, samples: int) -> np.ndarray:
        """(rows, policies, ...) table of the policies' actions after each row; see `Actor.table`."""
        # The behaviour policy's next action after an episode's last row is not known; its last action is used instead.
        rows = np.arange(len(self.data))
        after = np.where(self.data.is_end, rows, rows + 1)
        return self._table("next", _Following(self.data), samples, after)

    def known_next(self, terminals: np.ndarray) -> dict[str, np.ndarray]:
        """The column `known` (rows, policies) for a fit of critics: 1 if a policy's next action after a row is known, else 0.
        Only the behaviour policy's can be unknown; {} if none is.

        Args:
            terminals: (rows,) of the fitted rows; true also where the horizon ends an episode, as no action follows there.
        """
        shown = self.shown | np.asarray(terminals)
        if not self.logged or shown.all():
            return {}
        return {"known": np.where(np.arange(self.count) == self.count - 1, shown[:, None], True).astype(np.float32)}

    def initial_actions(self, samples: int) -> np.ndarray:
        """(episodes, policies, ...) table of the policies' actions at the initial observations."""
        starts = self.data.starts
        if self.data.spec.discrete and len(starts) == len(self.data):  # the same rows, and probabilities are exact
            return self.current_actions(samples)
        return self._table("initial", np.asarray(self.data.observations[starts]), samples, starts)

    def current_actions(self, samples: int) -> np.ndarray:
        """(rows, policies, ...) table of the policies' actions at each row."""
        return self._table("current", self.data.observations, samples, np.arange(len(self.data)))

    def final_actions(self, samples: int) -> np.ndarray:
        """(episodes, policies, ...) table of the policies' actions at the final observations."""
        return self._table("final", self.data.final_observations, samples, self.data.ends)

    def _table(self, name: str, observations: Any, samples: int, rows: np.ndarray) -> np.ndarray:
        """The policies' table; the behaviour policy's actions are those logged at `rows`."""

        def make() -> np.ndarray:
            table = self.actor.table(observations, samples, name, more=int(self.logged))
            if self.crossed:
                own = [table[np.arange(len(table)), each] for each in self._acting(self.data.episode_of[rows])]
                table = np.stack([*own, *([table[:, -1]] if self.logged else [])], 1)
            if self.logged:
                taken = np.asarray(self.data.actions)[rows]
                unit = Normalizer.of(self.data.spec).to_unit
                own = np.eye(table.shape[-1])[taken] if table.ndim == 3 else unit(taken)[:, None]
                if self._habits is not None and name == "final":
                    own = self._habits(self.data.final_observations)
                if self._habits is not None and name == "next":
                    unseen = self.data.is_end | self._apart
                    own[unseen] = self._habits(self.data.next_observations_at(np.flatnonzero(unseen)))
                table[:, -1] = own
            return table

        # Probabilities do not depend on the number of samples.
        return self.once((name, None if self.data.spec.discrete else samples), make)

    @cached_property
    def log_probs(self) -> np.ndarray:
        """(policies, rows) log-probabilities of the logged actions, without the behaviour policy."""
        found = self.actor.log_probs(self.data.observations, self.data.actions)
        if not self.crossed:
            return found
        return np.stack([found[each, np.arange(found.shape[1])] for each in self._acting(self.data.episode_of)])

    @cached_property
    def log_densities(self) -> np.ndarray:
        """(policies, rows) as `log_probs`, to be divided by logged propensities, which are densities also at ends of the data.

        By default the bounds of actions are the range of the logged ones, so that the least and the greatest lie at a bound. A
        policy that clips its actions has a probability there, which has no unit, while their logged propensities are densities
        unless actions were clipped. A bound that a single row of the log attains is taken for an end of the data: there the
        policy's density just within the bounds is used.
        """
        if not self.clips.any():
            return self.log_probs
        view, logged, actions = Normalizer.of(self.data.spec), np.asarray(self.log.actions), np.asarray(self.data.actions)
        unit = np.asarray(view.to_unit(actions))
        lone = np.zeros(unit.shape, bool)
        for side, end in ((-1.0, logged.min(0)), (1.0, logged.max(0))):
            lone |= (side * unit >= EDGE) & ((logged == end).sum(0) == 1)
        rows = np.flatnonzero(lone.any(1))
        if not len(rows):
            return self.log_probs
        within = np.where(lone[rows], view.from_unit(np.sign(unit[rows]) * WITHIN), actions[rows])
        return self._log_probs_of_others(rows, within, self.clips)

    @cached_property
    def within(self) -> np.ndarray:
        """(rows, ...) actions at which learned densities are divided; those near the bounds are moved (`ope.ends`)."""
        if self.data.spec.discrete:
            return np.asarray(self.data.actions)
        moved = within_bounds(self.log)
        return np.asarray(moved.actions[rows_of(self.log.starts[self.held], self.log.lengths[self.held])])

    @cached_property
    def learned_log_probs(self) -> np.ndarray:
        """(policies, rows) as `log_probs`, to be divided by learned propensities. Clipped policies have probabilities at the
        bounds, and so have their propensities."""
        if self.data.spec.discrete or self.clips.all():
            return self.log_probs
        rows = np.flatnonzero((self.within != self.data.actions).any(1))
        return self._log_probs_of_others(rows, self.within[rows], ~self.clips) if len(rows) else self.log_probs

    def _log_probs_of_others(self, rows: np.ndarray, actions: np.ndarray, which: np.ndarray) -> np.ndarray:
        """`log_probs` with those of other actions (n, size) at these rows (n,), of the policies that `which` marks."""
        told = self.actor.log_probs(self.data.observations[rows], np.asarray(actions, np.float32))
        own = np.stack([told[each, np.arange(len(rows))] for each in self._acting(self.data.episode_of[rows])])
        found = self.log_probs.copy()
        found[np.ix_(which, rows)] = own[which]
        return found

    @property
    def crossed(self) -> bool:
        """Whether some of the policies are several, one for each episode: cross-fitted, or drawn."""
        return len(self.owner) > len(self.policies)

    @cached_property
    def cross_fitted(self) -> np.ndarray:
        """(policies,) whether each is evaluated on each episode by a policy that was trained on the others."""
        return np.array([isinstance(policy, CrossFitted) and not policy.drawn for policy in self.policies])

    @cached_property
    def inflation(self) -> np.ndarray:
        """(policies, with the behaviour policy,) factors of the standard errors: sqrt(2) if cross-fitted on the log, else one.

        Each fold evaluates the policies of the others. If an action looks good in one fold by chance, the other's policy takes
        it, and vice versa, so their errors are equal and not independent: with t_k the chance error of fold k, the estimate is
        sum_{k != l} t_k t_l, whose variance is twice the sum of those of its folds. No estimate of that from one cross-fit is
        unbiased (Bengio and Grandvalet 2004), so the upper limit is used.
        """
        return np.where(np.append(self.cross_fitted, [False] * int(self.logged)), np.sqrt(2.0), 1.0)

    @cached_property
    def degenerate(self) -> np.ndarray:
        """(policies,) whether importance weights are degenerate; see `Actor.degenerate`."""
        return np.bincount(self.owner, self.actor.degenerate, len(self.policies)) > 0

    def _acting(self, episodes: np.ndarray) -> list[np.ndarray]:
        """For each policy, (episodes,) which of the actor's policies acts in each of these episodes."""
        first = np.searchsorted(self.owner, np.arange(len(self.policies)))
        return [
            np.full(len(episodes), begin) if part is None else begin + part[episodes] for begin, part in zip(first, self._parts)
        ]

    def behavior_log_probs(
        self, kind: Literal["auto", "logged", "learned"], model: BehaviorModel, *, clipped: bool = False
    ) -> np.ndarray:
        """(rows,) log-probabilities of the logged actions under the behaviour policy.

        Args:
            kind: `logged` takes the log's column `behavior_log_probs`, `learned` fits `model`, `auto` fits it if there is no
                such column.
            model: settings of its fit.
            clipped: whether the model has probabilities at the bounds of continuous actions; see `clips`.

        Raises:
            UserError: `logged`, without that column.
        """
        column = self.data.extras.get("behavior_log_probs")
        if kind == "logged" and column is None:
            raise UserError(f"{self.data.name} has no column behavior_log_probs; ask for behavior='learned'")
        if kind != "learned" and column is not None:
            return np.asarray(column, np.float64)
        model = dataclasses.replace(model, clipped=clipped)
        learned = lambda: self._behavior(model).log_probs(self.data.observations, self.data.actions)[0]  # noqa: E731
        return self.once(("behavior", model), learned)

    @cached_property
    def clips(self) -> np.ndarray:
        """(policies,) whether each has probabilities at the bounds of the actions, as clipped Gaussians do."""
        own = [isinstance(getattr(policy, "inner", None), ClippedGaussian) for policy in self.actor.policies]
        return np.bincount(self.owner, own, len(self.policies)) > 0

    def behavior(self, model: BehaviorModel) -> Actor:
        """A model of the behaviour policy, which samples its actions; made once."""
        return self._behavior(dataclasses.replace(model, clipped=bool(self.clips.any())))

    def _behavior(self, model: BehaviorModel) -> Actor:
        def make() -> Actor:
            rows = TransitionSource(self.data, model.needs(self.data.spec))
            fitted, _ = self.train(model, rows, model.steps, "behaviour")
            policy = EnvPolicy.of(models.policy(fitted), rows.view)
            return Actor([policy], ["the behaviour model"], self.data.spec, False, self.seed)

        return self.once(("behavior policy", model), make)

    @cached_property
    def policies_digest(self) -> str:
        """Hash of the policies' actions at observations from all parts of the log, which identifies this set of policies. It
        does not depend on the seed of the case."""
        some = np.unique(np.linspace(0, len(self.data) - 1, 256).astype(int))
        # Digests, and the folders of checkpoints that have them, depend on the name of the draws.
        done = dataclasses.replace(self.actor, seed=0).table(np.asarray(self.data.observations[some]), 1, "manner")
        return hashlib.blake2b(np.ascontiguousarray(done).tobytes(), digest_size=16).hexdigest()

    def redrawn(self, members: int) -> np.ndarray:
        """(episodes, members) count of each episode for each member of an ensemble: resampled with replacement.

        One member alone counts every episode once.
        """
        return redrawn(int(self.cluster.max()) + 1, members, self.seed)[self.cluster]


def check_order(log: Dataset) -> None:
    """Refuses logs that do not show the behaviour policy's next actions, because its value is then not known.

    Raises:
        UserError: for most rows the next observation differs from that of the next row, and there are many observations.
    """
    inside, apart = len(log) - log.episodes, int(log.apart.sum())
    if 2 * apart > inside and Table.of(log) is None:
        raise UserError(
            f"{log.name}: {apart:,} of {inside:,} rows inside of episodes are followed by another observation than that of "
            "the next row, so it does not show what its policy did next; give the rows in the order in which they were recorded"
        )


def _different(held: Any, episodes: int) -> np.ndarray:
    """Checked indices of episodes. With duplicates, critics could be trained on episodes that they evaluate."""
    found = np.asarray(held)
    if found.ndim != 1 or not len(found) or not np.issubdtype(found.dtype, np.integer):
        raise UserError(f"held must be whole numbers, indices of one or more episodes, got {found.dtype}, shape {found.shape}")
    if found.min() < 0 or found.max() >= episodes or len(np.unique(found)) < len(found):
        told = f"got {len(found)}, of which {len(np.unique(found))} differ, from {found.min()} to {found.max()}"
        raise UserError(f"held must be different episodes, 0 .. {episodes - 1}, {told}")
    return found


def _timed(data: Dataset, horizon: int | None) -> Dataset:
    if horizon is None or horizon == 1:
        return data
    time = times(data.lengths)
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
