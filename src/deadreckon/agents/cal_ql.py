"""Cal-QL (Nakamoto et al. 2023): CQL with values not lowered below the log's returns, to continue online.

The conservative term (eq. 5.1) lowers max(Q_j(s, a), V(s)) instead of Q_j(s, a), for actions of the policy,

    cql_weight ( log sum_a exp max(Q_j(s, a), V(s)) - Q_j(s, a_log) ),

so that it has no slope where Q_j is below the return of the log from s on, the reference value V(s). Uniform actions are as in
CQL. The loss is the same offline and online; online the returns are those of the agent's own episodes.
"""

from typing import ClassVar

from jaxtyping import Array, Float

from deadreckon.agents.cql import CQL, soft_maximum
from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.errors import UserError
from deadreckon.training.hyperparameters import Sizes, static


class CalQL(CQL):
    """Calibrated conservative critics."""

    revision: ClassVar[int] = 1
    supports_discrete: ClassVar[bool] = False

    hidden: Sizes = static((256, 256))  # width of each hidden layer of the actor
    critic_hidden: Sizes | None = static((256, 256))
    """width of each hidden layer of the critics (AntMaze: four of 256); None: as the actor's"""
    max_target_backup: bool = static(True)
    """whether targets take the best of as many actions of the policy as `samples` says, and not one"""

    @classmethod
    def acting(cls, task):
        """How acting and learning take turns: one environment, so that its episodes, and with them their returns, end early."""
        return {"copies": 1}

    def resolve(self, spec, steps):
        """Refuses what has no calibrated form."""
        agent = super().resolve(spec, steps)
        if self.form != "H":
            raise UserError(f"CalQL.form takes 'H', got {self.form!r}: the published term is the log-sum-exp over actions")
        if not self.discount < 1.0:
            raise UserError(f"CalQL.discount takes a number below 1, got {self.discount}: returns of cut episodes have no end")
        return agent

    def needs(self, spec):
        """Transitions, and the returns of the episodes."""
        columns = *BatchSpec.columns, "monte_carlo"
        return BatchSpec(columns, self.batch_size, standardise=self.standardise, gamma=self.discount)

    def reference(self, batch: Batch) -> Float[Array, "b"]:
        """V(s): the return from each row on, in the units of training; -inf if it is not known yet."""
        return self.reward_scale * batch.monte_carlo[:, 0] + self.reward_shift * batch.monte_carlo[:, 1]

    def held_down(self, critics, state, batch, key):
        """The values that the penalty lowers, those of the policy's actions no further than the reference value."""
        return soft_maximum(critics, state.actor, batch, self.samples, key, self.reference(batch))
