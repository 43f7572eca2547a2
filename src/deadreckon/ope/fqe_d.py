"""FQE-D: fitted Q evaluation of the distribution of returns (Paine et al. 2020; thesis 8.5; settings of the public code).

Each critic gives probabilities of `atoms` returns, evenly spaced over the possible ones (C51, Bellemare et al. 2017). The
target is the distribution of r + discount Z(s', a') by target networks, projected onto the atoms.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, BatchSpec, TransitionSource
from deadreckon.nets.layer_norm_mlp import LayerNormMLP
from deadreckon.nets.mlp import ensemble
from deadreckon.nets.optim import apply_gradients, copy, init_opt, renewed
from deadreckon.nets.return_distributions import cross_entropy, mean, project, support
from deadreckon.ope.case import OPEInput
from deadreckon.ope.critics import in_blocks, sizes, where_known
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.fqe import Scale
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, TwoOrMore, host, static


class State(NamedTuple):
    """Critics (members, policies, ...), their target networks, and the optimiser."""

    critics: LayerNormMLP
    targets: LayerNormMLP
    opt: optax.OptState


class Distributions(eqx.Module):
    """The learner: as `fqe.Critics`, with the returns of the atoms between `scale.low` and `scale.high`."""

    settings: "FQED"
    discount: float
    scale: Scale
    share: float
    policies: int = eqx.field(static=True)

    @property
    def support(self) -> Float[Array, "z"]:
        """(atoms,) the returns that a critic gives probabilities of."""
        return support(self.scale.low, self.scale.high, self.settings.atoms)

    def needs(self, spec):
        """Transitions with the columns `policy` and `weight`."""
        return BatchSpec(batch_size=self.settings.batch_size, standardise=True)

    def init(self, spec, key):
        """Initial critics; targets are copies."""
        inputs = spec.observation_size + (0 if spec.discrete else spec.action_size)
        settings = self.settings
        sizes = (inputs, *settings.hidden, settings.atoms * (spec.action_size if spec.discrete else 1))
        policies = lambda k: ensemble(lambda key: LayerNormMLP.create(sizes, key), self.policies, k)  # noqa: E731
        critics = ensemble(policies, settings.members, key)
        return State(critics, copy(critics), init_opt(critics))

    def logits(self, critics: LayerNormMLP, observation: Array, action: Array) -> Float[Array, "m p b z"]:
        """Logits of the returns after one action per row, the same for all critics."""
        if action.ndim == 1:
            every = self._every(critics, observation)
            return jnp.take_along_axis(every, action[None, None, :, None, None], -2)[..., 0, :]
        inputs = jnp.concatenate([observation, action], -1)
        return jax.vmap(jax.vmap(lambda net: net(inputs)))(critics)

    def _every(self, critics: LayerNormMLP, observation: Array) -> Float[Array, "m p b n z"]:
        out = jax.vmap(jax.vmap(lambda net: net(observation)))(critics)
        return out.reshape(*out.shape[:-1], -1, self.settings.atoms)

    def mixture(self, critics: LayerNormMLP, observation: Array, table: Array) -> Float[Array, "m p b z"]:
        """Probabilities of the returns of the policies' actions; see `critics.expected` for the table."""
        if table.ndim == 3:
            return jnp.einsum("mpbnz,bpn->mpbz", jax.nn.softmax(self._every(critics, observation)), table)
        seen = jnp.broadcast_to(observation[:, None], (*table.shape[:1], table.shape[2], observation.shape[-1]))

        def one(net: LayerNormMLP, own: Float[Array, "b s a"]) -> Array:
            return jax.nn.softmax(net(jnp.concatenate([seen, own], -1))).mean(1)

        return jax.vmap(lambda member: jax.vmap(one, (0, 1))(member, table))(critics)

    def update(self, state: State, batch: Batch, *, step, key):
        """One step of every critic towards the projected target; targets are updated every `target_update_period` steps."""
        assert batch.extra is not None
        future = self.mixture(state.targets, batch.next_observation, batch.extra["policy"])
        reward = self.share * batch.reward / self.scale.std
        target = project(future, reward, self.discount * (1.0 - batch.terminal), self.support)
        grads, metrics = jax.grad(self.loss, has_aux=True)(state.critics, batch, target)
        # Every critic's gradient is clipped separately, by its norm.
        square = sum(jnp.square(g).sum(tuple(range(2, g.ndim))) for g in jax.tree.leaves(grads))
        scale = jnp.minimum(1.0, self.settings.max_grad_norm / jnp.sqrt(jnp.maximum(square, 1e-12)))
        grads = jax.tree.map(lambda g: g * scale.reshape(*scale.shape, *[1] * (g.ndim - 2)), grads)
        critics, opt = apply_gradients(state.critics, grads, state.opt, self.settings.lr)
        targets = renewed(state.targets, critics, step, self.settings.target_update_period)
        return State(critics, targets, opt), metrics

    def loss(self, critics: LayerNormMLP, batch: Batch, target: Float[Array, "m p b z"]):
        """Cross entropy, weighted by how often the row's episode counts for the member; summed over critics."""
        assert batch.extra is not None
        logits = self.logits(critics, batch.observation, batch.action)
        error, q = where_known(cross_entropy(logits, target), batch.extra), mean(logits, self.support)
        return (error * batch.extra["weight"].T[:, None, :]).mean(-1).sum(), {"loss": error.mean()} | sizes(q)


@eqx.filter_jit
def _values(learner: Distributions, critics: LayerNormMLP, observation: Array, table: Array) -> Float[Array, "m p b"]:
    return (learner.mixture(critics, observation, table) * learner.support).sum(-1)


class FQED(Estimator):
    """Fitted Q evaluation of return distributions."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {"renew": "target_update_period", "gradient_clip": "max_grad_norm"}

    members: Count = static(3)  # critics per policy, each fitted on a bootstrap resample of the episodes
    hidden: Sizes = static((512, 512, 256))  # width of each hidden layer
    atoms: TwoOrMore = static(51)  # number of returns that have a probability
    steps: Count = host(100_000)  # updates of the critics
    batch_size: Count = static(1024)  # batch size (transitions per update)
    lr: NonNegative = 1e-4  # learning rate of the critics
    target_update_period: Count = static(100)  # updates between copies of the critics to the targets
    max_grad_norm: NonNegative = 40.0  # norm above which the gradient of a critic is clipped
    samples: Count = host(1)  # actions sampled once at each next observation
    initial_samples: Count = host(10)  # actions sampled at each initial observation

    @property
    def label(self) -> str:
        """Its name in tables."""
        return "FQE-D"

    def problem(self, case: OPEInput) -> tuple[Distributions, TransitionSource]:
        """The learner for a case, and the rows that it is trained on."""
        data, scale = case.data, Scale.of(case)
        scale = scale._replace(high=max(scale.high, scale.low + 1e-3))
        learner = Distributions(self, case.discount, scale, share=1.0 / case.effective_horizon, policies=case.count)
        weight = case.redrawn(self.members)[data.episode_of]
        extra = {"policy": case.next_actions(self.samples), "weight": weight} | case.known_next(data.terminals)
        return learner, TransitionSource(data, learner.needs(data.spec), extra)

    def solve(self, case: OPEInput) -> Estimates:
        """Mean of the distributions at the initial observations."""
        data, redrawn = case.data, case.redrawn(self.members)
        learner, rows = self.problem(case)
        state = case.train(learner, rows, self.steps, "fqe-d")
        first = rows.view.observe(np.asarray(data.observations[data.starts]))
        of = lambda seen, table: _values(learner, state.critics, seen, table)  # noqa: E731
        values = learner.scale.unit * in_blocks(of, first, case.initial_actions(self.initial_samples))
        found = (values * redrawn.T[:, None]).sum(-1) / redrawn.sum(0)[:, None]
        settled, warnings = case.convergence("fqe-d", case.names)
        return Estimates.of_members(
            self.label, case, found, warnings=tuple(warnings), diagnostics={"settled": settled.astype(float)}
        )
