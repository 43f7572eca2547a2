"""DICE: ratios of state-action occupancies by one regularised Lagrangian (Yang et al. 2020; thesis 8.5).

    max over zeta, min over Q and lambda of
      (1 - g) E[Q(s_0, a_0)] + lambda
      + E_log[ zeta(s, a) (reward r + g Q(s', a') - Q(s, a) - lambda) ] + primal E[Q^2 / 2] - dual E_log[zeta^2 / 2]

where a_0 and a' are the policy's, g is the discount, and E_log[zeta r] / (1 - g) the estimate. Its settings give DualDICE,
GenDICE and BestDICE (`PRESETS`).

Where episodes end, Q(s', a') is zero, and the occupancy of the log's states sums to less than one: the constraint of lambda is
then E_log[zeta (1 - g (1 - terminal))] = 1 - g, which every occupancy satisfies, and which is E_log[zeta] = 1 if nothing ends.
"""

from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from deadreckon.data.batch import Batch, BatchSpec, TransitionSource
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import Fitted, create, expected, sizes, taken
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.fqe import Scale
from deadreckon.ope.weights import effective, few
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, UnitInterval, host, static

PRESETS: dict[str, dict[str, Any]] = {
    "best": {"primal": 0.0, "dual": 1.0, "reward": 1.0, "norm": True, "positive": True},
    "dual": {"primal": 0.0, "dual": 1.0, "reward": 0.0, "norm": False, "positive": False},
    "gen": {"primal": 1.0, "dual": 0.0, "reward": 0.0, "norm": True, "positive": True},
}


class State(NamedTuple):
    """Q, zeta and lambda (members, policies, ...) with their optimisers, and a running mean of zeta's parameters."""

    q: MLP
    zeta: MLP
    multiplier: Array
    mean: MLP
    q_opt: optax.OptState
    zeta_opt: optax.OptState
    multiplier_opt: optax.OptState


def positive_part(out: Array, positive: bool) -> Array:
    """A network's output as a ratio."""
    return jax.nn.softplus(out) if positive else out


class Saddle(eqx.Module):
    """The learner of Q, zeta and lambda."""

    settings: "DICE"
    discount: float
    reward_std: float
    policies: int = eqx.field(static=True)

    def needs(self, spec):
        """Transitions and as many initial states, each with the policies' actions and the members' weights."""
        return BatchSpec(batch_size=self.settings.batch_size, initial=self.settings.batch_size, standardise=True)

    def init(self, spec, key):
        """Initial networks."""
        kq, kz = keys(key, "q", "zeta")
        members = self.settings.members
        q, zeta = (create(spec, self.settings.hidden, members, self.policies, k) for k in (kq, kz))
        multiplier = jnp.zeros((members, self.policies))
        return State(q, zeta, multiplier, copy(zeta), init_opt(q), init_opt(zeta), init_opt(multiplier))

    def update(self, state: State, batch: Batch, *, step, key):
        """One descent step of Q and lambda and one ascent step of zeta, from the same point."""
        arguments = (state.q, state.multiplier), state.zeta
        (down, up), metrics = jax.grad(self.lagrangian, (0, 1), has_aux=True)(*arguments, batch)
        lr = self.settings.lr
        q, q_opt = apply_gradients(state.q, down[0], state.q_opt, lr)
        multiplier, multiplier_opt = state.multiplier, state.multiplier_opt
        if self.settings.norm:
            multiplier, multiplier_opt = apply_gradients(multiplier, down[1], multiplier_opt, lr)
        zeta, zeta_opt = apply_gradients(state.zeta, jax.tree.map(jnp.negative, up), state.zeta_opt, lr)
        # Gradient descent-ascent cycles around the saddle point; the mean of its iterates is closer to it than the last one.
        mean = polyak_update(state.mean, zeta, jnp.maximum(self.settings.ema_rate, 1.0 / (step + 1)))
        return State(q, zeta, multiplier, mean, q_opt, zeta_opt, multiplier_opt), metrics

    def lagrangian(self, primal: tuple[MLP, Array], dual: MLP, batch: Batch):
        """The sum over members and policies of the Lagrangian in the docstring of the module."""
        q_net, multiplier = primal
        settings, extra = self.settings, batch.extra
        assert extra is not None
        lasts = 1.0 - batch.terminal
        q = taken(q_net, batch.observation, batch.action)
        future = expected(q_net, batch.next_observation, extra["policy"])
        first = expected(q_net, batch.initial_observation, extra["initial_policy"])
        zeta = positive_part(taken(dual, batch.observation, batch.action), settings.positive)
        error = settings.reward * batch.reward / self.reward_std + self.discount * lasts * future - q
        weight, initial_weight = extra["weight"].T[:, None, :], extra["initial_weight"].T[:, None, :]
        inside = zeta * error + settings.primal * jnp.square(q) / 2 - settings.dual * jnp.square(zeta) / 2
        if settings.norm:
            inside = inside - zeta * multiplier[..., None] * mass(batch.terminal, self.discount)
        value = (1.0 - self.discount) * (initial_weight * first).mean(-1) + (weight * inside).mean(-1)
        value = value + multiplier if settings.norm else value
        return value.sum(), {"lagrangian": value.mean(), "ratio": zeta.mean(), **sizes(q)}


class DICE(Estimator):
    """Marginalised importance sampling by a saddle point: BestDICE, or DualDICE and GenDICE by `DICE.preset`."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"average": "ema_rate"}
    takes_apart = False

    primal: NonNegative = 0.0  # weight of the regularisation of Q
    dual: NonNegative = 1.0  # weight of the regularisation of zeta
    reward: UnitInterval = 1.0  # weight of the reward in the Lagrangian: 0 or 1
    norm: bool = static(True)  # whether zeta is constrained to the mass of an occupancy (lambda)
    positive: bool = static(True)  # whether zeta is made positive by a softplus
    members: Count = static(3)  # pairs of networks per policy, each fitted on a bootstrap resample of the episodes
    hidden: Sizes = static((64, 64))  # width of each hidden layer
    steps: Count = host(100_000)  # updates of the networks
    batch_size: Count = static(2048)  # batch size (transitions per update)
    lr: NonNegative = 1e-4  # learning rate of the networks
    ema_rate: UnitInterval = 1e-3  # rate of the moving average of zeta's parameters that the estimate uses; 1: the last ones
    samples: Count = host(1)  # actions sampled once at each next observation
    initial_samples: Count = host(10)  # actions sampled at each initial observation

    @classmethod
    def preset(cls, name: Literal["best", "dual", "gen"], **changes: Any) -> "DICE":
        """BestDICE, DualDICE or GenDICE."""
        return cls(**(PRESETS[name] | changes))

    def ratios(self, case: OPEInput) -> np.ndarray:
        """(members, policies, rows) occupancy of the policy over that of the log."""
        return case.once(self, lambda: self._fit(case))

    def _fit(self, case: OPEInput) -> np.ndarray:
        data = case.data
        learner = Saddle(self, case.discount, Scale.of(case).std, case.count)
        rows = occupancy_rows(case, learner, self.members, self.samples, self.initial_samples)
        state = case.train(learner, rows, self.steps, "dice")
        found = Fitted(state.mean, 1.0, rows.view).of_actions(data.observations, data.actions)
        return np.asarray(positive_part(jnp.asarray(found), self.positive))

    def solve(self, case: OPEInput) -> Estimates:
        """Logged rewards weighted by the ratios."""
        ratios = self.ratios(case)
        found = weighted(case, ratios, case.data.rewards) / (1.0 - case.discount)
        return estimates(case, self.label, ratios, found, *case.convergence("dice", case.names))

    @property
    def label(self) -> str:
        """Its name in tables."""
        fields = {name: getattr(self, name) for name in PRESETS["best"]}
        return next((f"{name.capitalize()}DICE" for name, preset in PRESETS.items() if preset == fields), "DICE")


def estimates(
    case: OPEInput, label: str, ratios: np.ndarray, found: np.ndarray, settled: np.ndarray, warnings: list[str]
) -> Estimates:
    """Estimates from (members, policies, rows) ratios and the (members, policies) values by them, with (policies,) whether the
    fit has converged, and its warnings.

    An episode's weight is the sum of its rows' ratios, averaged over members.
    """
    rows = ratios.mean(0) * case.data.usable
    weight = np.stack([np.bincount(case.data.episode_of, own, case.data.episodes) for own in rows])
    ess = effective(weight)
    warnings = [*few(case.names, ess, case.data.episodes), *warnings]
    return Estimates.of_members(
        label, case, found, ess=ess, warnings=tuple(warnings), diagnostics={"settled": settled.astype(float)}
    )


def occupancy_rows(case: OPEInput, learner: Any, members: int, samples: int, initial_samples: int) -> TransitionSource:
    """The log for learners of occupancies: transitions and initial states, with the policies' actions and members' weights."""
    redrawn = case.redrawn(members)
    # Episodes are resampled, not rows: where they differ in length, the weights of a member's rows do not average one.
    weight = redrawn[case.data.episode_of]
    extra = {"policy": case.next_actions(samples), "weight": weight / weight[case.data.usable].mean(0)}
    # Clusters of several episodes are resampled as a whole: then the weights of the initial states do not average one either.
    initial = {"initial_policy": case.initial_actions(initial_samples), "initial_weight": redrawn / redrawn.mean(0)}
    return TransitionSource(case.data, learner.needs(case.data.spec), extra, initial)


def mass(terminal: Any, discount: Any) -> Any:
    """Each row's share of an occupancy's mass, whose mean under its ratios is one: 1, or 1 / (1 - discount) at a terminal."""
    return (1.0 - discount * (1.0 - terminal)) / (1.0 - discount)


def weighted(case: OPEInput, ratios: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(members, policies) means of ratio times `x` (rows,) over the rows that each member was trained on."""
    weight = case.redrawn(len(ratios))[case.data.episode_of].T * case.data.usable
    x = np.asarray(x, np.float64)
    return np.stack([own @ (seen * x) for own, seen in zip(ratios, weight)]) / weight.sum(1)[:, None]
