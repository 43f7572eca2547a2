"""RLPD (Ball et al. 2023): SAC online, whose batches are half of a log, with normalised critics and many updates a step.

Each update draws `subset` of the `critics` target networks at random (Algorithm 1, as in REDQ) and moves all critics towards

    r + discount (min over these of Q'_j(s', a') - temperature log pi(a' | s')),   a' ~ pi(. | s').

Every `policy_freq` updates the actor climbs the mean of all critics, and the temperature moves. The share of the log in a batch
is a setting of the run (`log_share`), and the number of updates a step is that of `Online`.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp

from deadreckon.agents.agent import create_critics
from deadreckon.agents.sac import SAC
from deadreckon.agents.scaled_rewards import ScaledRewards
from deadreckon.errors import UserError
from deadreckon.nets.mlp import FirstWeights, minimum
from deadreckon.nets.optim import polyak_update
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, Number, static
from deadreckon.training.later_fields import later


class RLPD(ScaledRewards, SAC):
    """SAC on an ensemble of layer-normalised critics."""

    revision: ClassVar[int] = 1
    supports_discrete: ClassVar[bool] = False  # as published; its target entropy is one of densities
    other_names: ClassVar[dict[str, str]] = {"num_qs": "critics", "num_min_qs": "subset", "critic_layer_norm": "layer_norm"}

    critics: Count = static(10)  # number of Q-networks
    subset: Count = static(2)  # number of target networks drawn for each update, whose minimum is the target (AntMaze: 1)
    layer_norm: bool = static(True)  # whether the critics use layer normalisation
    target_entropy: Number | None = None  # target entropy in nats; None: minus half the action dimensions
    policy_freq: Count = static(20)  # critic updates per update of actor and temperature
    first_weights: FirstWeights = later("glorot")  # initial weights: "uniform", "glorot", "orthogonal" or "rlkit"

    @classmethod
    def acting(cls, task):
        """How acting and learning take turns: one step, then 20 updates."""
        return {"copies": 1, "explore": 5000, "updates_per_step": 20.0, "block": 1}

    def resolve(self, spec, steps):
        """Fills in the target entropy, minus half the action dimensions."""
        agent = super().resolve(spec, steps)
        if self.subset > self.critics:
            raise UserError(f"RLPD.subset takes a number up to critics ({self.critics}), got {self.subset}")
        return agent if self.target_entropy is not None else agent.replace(target_entropy=-0.5 * spec.action_size)

    def first_critics(self, spec, key):
        """Fresh Q-networks."""
        return create_critics(spec, self.hidden, self.critics, key, normalise=self.layer_norm, init=self.critic_init)

    def min_q(self, values):
        """The mean over the critics' values (k, *b), which the actor climbs."""
        return values.mean(0)

    def target_q(self, values):
        """The minimum over the drawn target networks' values (k, *b)."""
        return minimum(values)

    def target(self, state, batch, key):
        """SAC's, by `subset` of the target networks."""
        k_subset, k_noise = keys(key, "subset", "noise")
        drawn = jax.random.choice(k_subset, self.critics, (self.subset,), replace=False)
        some = jax.tree.map(lambda leaf: leaf[drawn], state.target_critics)
        return super().target(state._replace(target_critics=some), batch, k_noise)

    def update(self, state, batch, *, step, key):
        """Critics and targets always; at the end of every `policy_freq` updates actor and temperature."""
        k_target, k_critics, k_actor = keys(key, "target", "critic_loss", "actor_loss")
        state, metrics = self.update_critics(state, batch, k_target, k_critics)
        state = state._replace(target_critics=polyak_update(state.target_critics, state.critics, self.tau))

        def improve(state):
            state, loss, log_prob = self.update_actor(state, batch, step, k_actor)
            # Times `policy_freq`, so that the mean over a chunk is the mean over actor updates.
            return self.update_temperature(state, log_prob), loss * self.policy_freq, -log_prob * self.policy_freq

        # `step` is shared by all lanes: a batched predicate would compute both branches always.
        due = step % self.policy_freq == self.policy_freq - 1
        state, loss, entropy = jax.lax.cond(due, improve, lambda s: (s, jnp.zeros(()), jnp.zeros(())), state)
        return state, metrics | {"actor_loss": loss, "entropy": entropy, "temperature": jnp.exp(state.log_temperature)}

    def q_value(self, state, observation, action):
        """Mean over the critics, in the log's units; includes the entropy bonus of later steps where targets do."""
        return self.logged_value(super().q_value(state, observation, action))
