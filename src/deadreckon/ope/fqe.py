"""FQE-L2: fitted Q evaluation with a squared loss (Le et al. 2019; thesis 8.5; settings of the public implementation).

Every policy has `members` critics, each of which is trained on a bootstrap sample of the episodes (`OPEInput.redrawn`): their
mean is the estimate and their spread determines its interval. All critics of all policies are trained in one program, on the
same minibatches.

For doubly robust estimates the members are folds instead: each is trained on the episodes outside its fold and stops where its
loss on a held-out tenth of them is smallest.
"""

import dataclasses
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, BatchSpec, TransitionSource
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.ope.behavior import masks
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import Best, Fitted, OutOfFold, create, expected, sizes, taken, where_known
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, UnitInterval, host, static


class State(NamedTuple):
    """Critics (members, policies, ...), their target networks, their optimiser and the best parameters so far."""

    critics: MLP
    targets: MLP
    opt: optax.OptState
    best: Best | None


class Scale(NamedTuple):
    """Units of the critics: a return divided by the discounted number of steps (`OPEInput.effective_horizon`) and by the
    standard deviation of the reward.

    Attributes:
        std: standard deviation of the reward, or 1 if it never changes.
        unit: the return for which a critic's output is 1.
        low, high: smallest and largest possible value of a critic.
    """

    std: float
    unit: float
    low: float
    high: float

    @classmethod
    def of(cls, case: OPEInput) -> "Scale":
        """The scale for a case's rewards; if episodes end, values of 0 are possible, too."""
        reward = case.data.spec.reward
        std = float(reward.std) or 1.0
        ends = bool(np.asarray(case.data.terminals).any())
        low, high, unit = float(reward.min) / std, float(reward.max) / std, std * case.effective_horizon
        if case.discount == 1.0 and case.estimand.horizon is None:  # an episode may be longer than any in the log
            return cls(std, unit, -np.inf, np.inf)
        return cls(std, unit, min(low, 0.0) if ends else low, max(high, 0.0) if ends else high)


class Critics(eqx.Module):
    """The learner: the critics of all policies.

    Attributes:
        settings: of the estimator.
        discount: of the returns.
        scale: of the critics' values.
        share: 1 / the discounted number of steps, by which rewards are multiplied.
        first: update from which the best critics may be kept.
        members, policies: how many critics there are.
        stops: whether critics stop early, by the column `check`.
    """

    settings: "FQE"
    discount: float
    scale: Scale
    share: float
    first: float
    members: int = eqx.field(static=True)
    policies: int = eqx.field(static=True)
    stops: bool = eqx.field(static=True)

    def needs(self, spec):
        """Transitions with the columns `policy` and `weight`, and `known` (policies,) if that is not all ones."""
        return BatchSpec(batch_size=self.settings.batch_size, standardise=True)

    def init(self, spec, key):
        """Initial critics; targets are copies."""
        critics = create(spec, self.settings.hidden, self.members, self.policies, key)
        best = Best.begin(critics, (self.members, self.policies)) if self.stops else None
        return State(critics, copy(critics), init_opt(critics), best)

    def update(self, state: State, batch: Batch, *, step, key):
        """One step of every critic towards r + discount (1 - terminal) V_target(s'), clipped to the range of values."""
        assert batch.extra is not None
        future = expected(state.targets, batch.next_observation, batch.extra["policy"])
        reward = self.share * batch.reward / self.scale.std
        target = jnp.clip(reward + self.discount * (1.0 - batch.terminal) * future, self.scale.low, self.scale.high)
        grads, (metrics, checked) = jax.grad(self.loss, has_aux=True)(state.critics, batch, target)
        critics, opt = apply_gradients(state.critics, grads, state.opt, self.settings.lr, self.settings.weight_decay)
        targets = polyak_update(state.targets, critics, self.settings.tau)
        best = None if state.best is None else state.best.look(targets, checked[0], checked[1], step, self.first)
        return State(critics, targets, opt, best), metrics

    def loss(self, critics: MLP, batch: Batch, target: Float[Array, "m p b"]):
        """Mean squared error, weighted by how often the row's episode counts for the member; summed over critics."""
        assert batch.extra is not None
        q = taken(critics, batch.observation, batch.action)
        square = where_known(jnp.square(q - target), batch.extra)
        error = square * batch.extra["weight"].T[:, None, :]
        checked = jnp.zeros(()), jnp.zeros((), bool)
        if self.stops:
            check = batch.extra["check"].T[:, None, :]
            checked = (square * check).sum(-1) / jnp.maximum(check.sum(-1), 1e-6), check.sum((-1, -2)) > 0
        return error.mean(-1).sum(), ({"loss": error.mean()} | sizes(q), checked)


class FQE(Estimator):
    """Fitted Q evaluation with a squared loss."""

    revision: ClassVar[int] = 1

    takes_horizon = True

    members: Count = host(3)  # critics per policy, each fitted on a bootstrap resample of the episodes
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    steps: Count = host(100_000)  # updates of the critics (public code: 1,000,000)
    batch_size: Count = static(256)  # batch size (transitions per update)
    lr: NonNegative = 3e-4  # learning rate of the critics
    weight_decay: NonNegative = 1e-5  # weight decay of AdamW
    tau: UnitInterval = 0.005  # Polyak rate of the target critics, per update
    samples: Count = host(1)  # actions sampled once at each next observation; their mean value is the target
    initial_samples: Count = host(10)  # actions sampled at each initial observation

    def fitted(self, case: OPEInput) -> Fitted:
        """The critics of a case's policies; fitted once per case."""
        return case.once(self, lambda: self._fit(case))

    def problem(
        self, case: OPEInput, weight: np.ndarray | None = None, check: np.ndarray | None = None
    ) -> tuple[Critics, TransitionSource]:
        """The learner for a case, and the rows that it is trained on.

        Args:
            case: log and policies.
            weight: (episodes, members) how often each episode counts for a member; None: resampled with replacement.
            check: (episodes, members) the same for the validation loss by which critics stop early; None: they do not.
        """
        data, scale = case.timed, Scale.of(case)
        weight = case.redrawn(self.members) if weight is None else weight
        soon = case.discount == 0.0 or case.estimand.horizon == 1 or bool(np.asarray(data.terminals).all())
        # While values propagate back in time, targets are still too small, and so are losses: these do not count.
        first = 0.0 if soon else self.steps / 2
        learner = Critics(
            self, case.discount, scale, share=1.0 / case.effective_horizon, first=first, members=weight.shape[1],
            policies=case.count, stops=check is not None,
        )  # fmt: skip
        extra = {"policy": case.next_actions(self.samples), "weight": weight[data.episode_of]} | case.known_next(data.terminals)
        if check is not None:
            extra["check"] = check[data.episode_of]
        return learner, TransitionSource(data, learner.needs(data.spec), extra)

    def _fit(self, case: OPEInput) -> Fitted:
        learner, rows = self.problem(case)
        state = case.train(learner, rows, self.steps, "fqe")
        return Fitted(state.targets, Scale.of(case).unit, rows.view)

    def out_of_fold(self, case: OPEInput, folds: int, samples: int) -> OutOfFold:
        """The out-of-fold predictions of critics; those of all folds are trained in one program.

        Args:
            case: log and policies.
            folds: number of parts of the evaluated episodes.
            samples: actions sampled at each row for its value.
        """
        key = ("out of fold", self, folds, samples)
        return case.once(key, lambda: self._out_of_fold(case, folds, samples))

    def _out_of_fold(self, case: OPEInput, folds: int, samples: int) -> OutOfFold:
        fold, whole = case.folds(folds), case.whole()
        weight, check = masks(case, fold, whole)
        learner, rows = self.problem(whole, weight, check)
        state = case.train(learner, rows, self.steps, "fqe by folds")
        scale = Scale.of(whole)
        fitted = Fitted(state.best.params, scale.unit, rows.view)

        data = case.timed
        of_row = fold[data.episode_of]
        now = fitted.values(data.observations, case.current_actions(samples))
        last = fitted.values(data.final_observations, case.final_actions(samples))
        chosen = fitted.of_actions(data.observations, data.actions)

        def told(by: int) -> OutOfFold:
            """By the critics of the fold that is `by` further on: those of 0 were not trained on the episode, others were."""
            of = lambda found, lane: np.take_along_axis(found, ((lane + by) % (fold.max() + 1))[None, None], 0)[0]  # noqa: E731
            own, final, taken = (of(x, lane).astype(np.float64) for x, lane in ((now, of_row), (last, fold), (chosen, of_row)))
            return OutOfFold.of_values(case, own[:, data.starts], own, final, taken)

        by_fold = now[:, :, data.starts].mean(-1, dtype=np.float64)
        left_out = data.episodes / len(by_fold) / whole.data.episodes
        return dataclasses.replace(
            told(0), fitted=np.square(told(1).errors).mean(1), by_fold=lambda: by_fold, left_out=left_out
        )

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "FQE-L2"

    def solve(self, case: OPEInput) -> Estimates:
        """Mean value of the initial observations."""
        values = self.fitted(case).values(case.timed.observations[case.data.starts], case.initial_actions(self.initial_samples))
        weight = case.redrawn(self.members).T
        found = (values * weight[:, None]).sum(-1) / weight.sum(-1)[:, None]
        settled, warnings = case.convergence("fqe", case.names)
        return Estimates.of_members(
            self.label, case, found, warnings=tuple(warnings), diagnostics={"settled": settled.astype(float)}
        )
