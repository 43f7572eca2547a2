"""VPM: the variational power method for occupancy ratios (Wen et al. 2020; thesis 8.5).

A policy's discounted occupancy d is the fixed point of d' = (1 - g) start + g P d, where `start` is the initial states with the
policy's actions and P a step followed by the policy's action: the iteration converges to it from any d (the power method). With
d = tau log, tau the ratio to the distribution of the log, one iteration is the density ratio d' / log. Every f-divergence has a
variational form whose solution is that ratio and which needs only expectations; with the squared one it is

    tau' = argmin E_log[tau^2] / 2 - (1 - g) E_start[tau] - g E_log[tau_k(s, a) (1 - terminal) tau(s', a')]

(least-squares importance fitting), which needs a single network, where other divergences need a second one. A penalty keeps the
mass of an occupancy, E_log[tau (1 - g (1 - terminal))] = 1 - g. The weights need no behaviour policy.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import Fitted, create, expected, taken
from deadreckon.ope.dice import estimates, mass, occupancy_rows, weighted
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, host, static

EXCESS_RATE = 0.01  # rate of the running mean of the mass minus one


class State(NamedTuple):
    """The ratio of this iteration, that of the one before, a running mean of the mass minus one, and the optimiser."""

    tau: MLP
    before: MLP
    excess: Array
    opt: optax.OptState


class Power(eqx.Module):
    """The learner of the ratios."""

    settings: "VPM"
    discount: float
    policies: int = eqx.field(static=True)

    def needs(self, spec):
        """Transitions and as many initial states, each with the policies' actions and the members' weights."""
        return BatchSpec(batch_size=self.settings.batch_size, initial=self.settings.batch_size, standardise=True)

    def init(self, spec, key):
        """Initial networks."""
        members = self.settings.members
        tau = create(spec, self.settings.hidden, members, self.policies, key)
        return State(tau, copy(tau), jnp.zeros((members, self.policies)), init_opt(tau))

    def update(self, state: State, batch: Batch, *, step, key):
        """One step of the fit; every `inner_updates` steps an iteration is over and the next begins."""
        grads, (whole, metrics) = jax.grad(self.loss, has_aux=True)(state.tau, state.before, state.excess, batch)
        tau, opt = apply_gradients(state.tau, grads, state.opt, self.settings.lr)
        over = (step + 1) % self.settings.inner_updates == 0
        before = jax.tree.map(lambda new, old: jnp.where(over, new, old), tau, state.before)
        # A penalty on the squared excess of a batch would also penalise the variance of its mass, which is huge because a
        # terminal has the mass 1 / (1 - discount). So the gradient of the penalty is taken at the running mean of the excess.
        return State(tau, before, polyak_update(state.excess, whole - 1.0, EXCESS_RATE), opt), metrics

    def loss(self, tau_net: MLP, before_net: MLP, excess: Array, batch: Batch):
        """The objective in the docstring of the module, summed over members and policies."""
        extra = batch.extra
        assert extra is not None
        lasts = 1.0 - batch.terminal
        tau = jax.nn.softplus(taken(tau_net, batch.observation, batch.action))
        before = jax.nn.softplus(taken(before_net, batch.observation, batch.action))
        future = _expected_ratio(tau_net, batch.next_observation, extra["policy"])
        first = _expected_ratio(tau_net, batch.initial_observation, extra["initial_policy"])
        weight, initial_weight = extra["weight"].T[:, None, :], extra["initial_weight"].T[:, None, :]
        fit = (weight * (jnp.square(tau) / 2 - self.discount * before * lasts * future)).mean(-1)
        fit = fit - (1.0 - self.discount) * (initial_weight * first).mean(-1)
        whole = (weight * tau * mass(batch.terminal, self.discount)).mean(-1)
        return (fit + self.settings.penalty * excess * whole).sum(), (whole, {"loss": fit.mean(), "mass": whole.mean()})


def _expected_ratio(net: MLP, observation: Array, table: Array) -> Array:
    """As `critics.expected`, of the positive outputs: (members, policies, b)."""
    return expected(net, observation, table, jax.nn.softplus)


class VPM(Estimator):
    """The variational power method."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"inner": "inner_updates"}
    takes_apart = False

    members: Count = static(3)  # networks per policy, each fitted on a bootstrap resample of the episodes
    hidden: Sizes = static((64, 64))  # width of each hidden layer
    steps: Count = host(100_000)  # updates of the networks
    inner_updates: Count = static(10)  # updates per iteration of the power method
    batch_size: Count = static(2048)  # batch size (transitions per update)
    lr: NonNegative = 1e-4  # learning rate of the networks
    penalty: NonNegative = 1.0  # weight of the penalty on a mass other than one
    samples: Count = host(1)  # actions sampled once at each next observation
    initial_samples: Count = host(10)  # actions sampled at each initial observation

    def ratios(self, case: OPEInput) -> np.ndarray:
        """(members, policies, rows) occupancy of the policy over that of the log."""
        return case.once(self, lambda: self._fit(case))

    def _fit(self, case: OPEInput) -> np.ndarray:
        data = case.data
        learner = Power(self, case.discount, case.count)
        rows = occupancy_rows(case, learner, self.members, self.samples, self.initial_samples)
        state = case.train(learner, rows, self.steps, "vpm")
        found = Fitted(state.tau, 1.0, rows.view).of_actions(data.observations, data.actions)
        return np.asarray(jax.nn.softplus(jnp.asarray(found)))

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "VPM"

    def solve(self, case: OPEInput) -> Estimates:
        """The weighted average of the logged rewards."""
        data, ratios = case.data, self.ratios(case)
        masses = weighted(case, ratios, mass(np.asarray(data.terminals, np.float64), case.discount))
        found = weighted(case, ratios, data.rewards) / (1.0 - case.discount) / masses
        warnings = case.convergence_warnings("vpm", "mass")
        return estimates(case, self.label, ratios, found, np.full(case.count, not warnings), warnings)
