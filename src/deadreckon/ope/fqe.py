"""FQE-L2: fitted Q evaluation with a squared loss (Le et al. 2019; thesis 8.5; settings of the public implementation).

Every policy has `members` critics, each of which learns from episodes redrawn with replacement (`Case.redrawn`): their mean is
the estimate and their spread its interval. All critics of all policies are one program and see the same minibatches.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from deadreckon.data.batch import Batch, Needs, Rows
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import begin, copy, descend, track
from deadreckon.ope.critics import Fitted, create, expected, taken
from deadreckon.ope.estimate import Case, Estimates, Estimator
from deadreckon.ope.intervals import spread
from deadreckon.training.learner import static


class State(NamedTuple):
    """Critics (members, policies, ...), the slow copies that targets come from, and their optimiser."""

    critics: MLP
    targets: MLP
    opt: optax.OptState


class Scale(NamedTuple):
    """What critics count in: (1 - discount) times a return, in standard deviations of the reward.

    Attributes:
        std: of the reward, or 1 where it never changes.
        unit: a critic's 1 in units of the return.
        low, high: what a critic's value can be.
    """

    std: float
    unit: float
    low: float
    high: float

    @classmethod
    def of(cls, case: Case) -> "Scale":
        """Of a log's rewards; where episodes end, nothing (0) follows."""
        reward = case.data.spec.reward
        std = float(reward.std) or 1.0
        ends = bool(np.asarray(case.data.terminals).any())
        low, high = float(reward.min) / std, float(reward.max) / std
        return cls(std, std / (1.0 - case.discount), min(low, 0.0) if ends else low, max(high, 0.0) if ends else high)


class Critics(eqx.Module):
    """What `fit` trains: the critics of all policies.

    Attributes:
        lr, decay, target_rate: of the optimiser (AdamW) and of the targets.
        discount, reward_std: of the returns.
        low, high: of the targets.
        members, policies, hidden, batch_size: shapes.
    """

    lr: float
    decay: float
    target_rate: float
    discount: float
    reward_std: float
    low: float
    high: float
    members: int = eqx.field(static=True)
    policies: int = eqx.field(static=True)
    hidden: tuple[int, ...] = eqx.field(static=True)
    batch_size: int = eqx.field(static=True)

    def needs(self, spec):
        """Transitions, with the columns `policy` and `weight` beside them."""
        return Needs(batch_size=self.batch_size, standardise=True)

    def init(self, spec, key):
        """Fresh critics; targets are copies."""
        critics = create(spec, self.hidden, self.members, self.policies, key)
        return State(critics, copy(critics), begin(critics))

    def update(self, state: State, batch: Batch, *, step, key):
        """One step of every critic towards r + discount (1 - terminal) V_target(s'), clipped to what a value can be."""
        assert batch.extra is not None
        future = expected(state.targets, batch.next_observation, batch.extra["policy"])
        reward = (1.0 - self.discount) * batch.reward / self.reward_std
        target = jnp.clip(reward + self.discount * (1.0 - batch.terminal) * future, self.low, self.high)
        grads, metrics = jax.grad(self.loss, has_aux=True)(state.critics, batch, target)
        critics, opt = descend(state.critics, grads, state.opt, self.lr)
        # Decoupled weight decay (AdamW).
        critics = jax.tree.map(lambda new, old: new - self.lr * self.decay * old, critics, state.critics)
        return State(critics, track(state.targets, critics, self.target_rate), opt), metrics

    def loss(self, critics: MLP, batch: Batch, target: Float[Array, "m p b"]):
        """Mean squared error, weighted by how often the row's episode counts for the member; summed over critics."""
        assert batch.extra is not None
        q = taken(critics, batch.observation, batch.action)
        error = jnp.square(q - target) * batch.extra["weight"].T[:, None, :]
        return error.mean(-1).sum(), {"loss": error.mean(), "q": q.mean()}


class FQE(Estimator):
    """Fitted Q evaluation with a squared loss."""

    members: int = static(3)  # critics a policy, each on redrawn episodes
    hidden: tuple[int, ...] = static((256, 256))  # width of each hidden layer
    steps: int = static(100_000)  # updates (public code: 1,000,000)
    batch_size: int = static(256)  # rows a batch
    lr: float = 3e-4  # learning rate
    weight_decay: float = 1e-5  # AdamW
    target_rate: float = 0.005  # Polyak rate of the target critics
    samples: int = static(1)  # actions drawn at each next observation, once; their mean value is the target
    initial_samples: int = static(10)  # actions drawn at each initial observation

    def fitted(self, case: Case) -> Fitted:
        """The critics of a case's policies; made once for a case, whoever asks."""
        return case.once(self, lambda: self._fit(case))

    def problem(self, case: Case) -> tuple[Critics, Rows]:
        """What is trained for a case, and the rows that it learns from."""
        data, scale = case.data, Scale.of(case)
        learner = Critics(
            self.lr, self.weight_decay, self.target_rate, case.discount, scale.std, scale.low, scale.high, self.members,
            case.count, self.hidden, self.batch_size,
        )  # fmt: skip
        extra = {"policy": case.next_actions(self.samples), "weight": case.redrawn(self.members)[data.episode_of]}
        return learner, Rows(data, learner.needs(data.spec), extra)

    def _fit(self, case: Case) -> Fitted:
        learner, rows = self.problem(case)
        state = case.train(learner, rows, self.steps, "fqe")
        return Fitted(state.targets, Scale.of(case).unit, rows.view)

    @property
    def label(self) -> str:
        """What tables call it."""
        return "FQE-L2"

    def solve(self, case: Case) -> Estimates:
        """Mean value of the initial observations."""
        values = self.fitted(case).values(case.data.observations[case.data.starts], case.initial_actions(self.initial_samples))
        weight = case.redrawn(self.members).T
        found = (values * weight[:, None]).sum(-1) / weight.sum(-1)[:, None]
        low, high = spread(found)
        return Estimates(
            self.label, case.names, found.mean(0), low, high, case.discount, redraws=found,
            warnings=tuple(self.unsettled(case)),
        )  # fmt: skip

    def unsettled(self, case: Case) -> list[str]:
        """A warning where the fit still changes."""
        return case.unsettled("fqe", "q")
