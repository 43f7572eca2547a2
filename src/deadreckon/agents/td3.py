"""TD3 on a fixed log: the naive baseline of chapter 4 (Fujimoto et al. 2018)."""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import optax

from deadreckon.agents.agent import Agent, backup, bellman_loss, create_critics, loss_of_critics
from deadreckon.data.batch import BatchSpec
from deadreckon.nets.mlp import MLP, UNIFORM, Init, minimum, q_values
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.policies.kinds import Deterministic
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, UnitInterval, static


class State(NamedTuple):
    """Networks, their targets and optimisers."""

    actor: MLP | tuple[()]  # empty where REM has discrete actions
    critics: MLP  # stacked: leading axis 2; REM's is one network
    target_actor: MLP | tuple[()]
    target_critics: MLP
    actor_opt: optax.OptState
    critics_opt: optax.OptState


class TD3(Agent):
    """Twin critics, smoothed targets, delayed deterministic actor; nothing holds it to the log."""

    revision: ClassVar[int] = 1
    fine_tunes: ClassVar[bool] = True
    supports_images: ClassVar[bool] = True
    exploration_noise: ClassVar[float] = 0.1  # published for TD3 and for TD3+BC online
    actor_init: ClassVar[Init] = UNIFORM  # how its networks begin
    critic_init: ClassVar[Init] = UNIFORM
    other_names: ClassVar[dict[str, str]] = {"noise": "policy_noise", "actor_every": "policy_freq", "normalise": "layer_norm"}

    actor_lr: NonNegative = 3e-4  # learning rate of the actor
    critic_lr: NonNegative = 3e-4  # learning rate of the critics
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of the target networks, per update
    policy_noise: NonNegative = 0.2  # standard deviation of the noise added to target actions
    noise_clip: NonNegative = 0.5  # largest absolute noise added to target actions
    policy_freq: Count = static(2)  # critic updates per actor update
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    layer_norm: bool = static(False)  # whether the critics use layer normalisation
    standardise: bool = static(False)  # whether flat observations are standardised to mean 0 and standard deviation 1

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    def init(self, spec, key):
        """Fresh networks; targets are copies."""
        ka, kc = keys(key, "actor", "critics")
        actor = MLP.create(spec.observation_size, self.hidden, spec.action_size, ka, init=self.actor_init)
        critics = create_critics(spec, self.hidden, 2, kc, normalise=self.layer_norm, init=self.critic_init)
        return State(actor, critics, copy(actor), copy(critics), init_opt(actor), init_opt(critics))

    def next_action(self, state, batch, key):
        """The target actor's action at s', plus clipped noise (TD3 eq. 14)."""
        noise = jnp.clip(self.policy_noise * jax.random.normal(key, batch.action.shape), -self.noise_clip, self.noise_clip)
        return jnp.clip(jnp.tanh(state.target_actor(batch.next_observation)) + noise, -1.0, 1.0)

    def target(self, state, batch, key) -> Any:
        """r + discount min_j Q'_j(s', a') (TD3 eq. 15)."""
        action = self.next_action(state, batch, key)
        return backup(batch, self.discount, minimum(q_values(state.target_critics, batch.next_observation, action)))

    def critic_loss(self, critics, state, batch, target, key):
        """Squared errors of both critics."""
        return bellman_loss(critics, batch, target)

    def actor_loss(self, actor, state, batch):
        """-Q_1(s, pi(s))."""
        first = jax.tree.map(lambda w: w[:1], state.critics)
        q = q_values(first, batch.observation, jnp.tanh(actor(batch.observation)))[0]
        return -q.mean()

    def update(self, state, batch, *, step, key):
        """Critics always; every `policy_freq` updates the actor and all targets."""
        k_target, k_critics = keys(key, "target", "critic_loss")
        target = self.target(state, batch, k_target)
        grads, metrics = jax.grad(self.critic_loss, has_aux=True)(state.critics, state, batch, target, k_critics)
        critics, critics_opt = apply_gradients(state.critics, grads, state.critics_opt, self.critic_lr)
        state = state._replace(critics=critics, critics_opt=critics_opt)

        def improve(state):
            loss, grads = jax.value_and_grad(self.actor_loss)(state.actor, state, batch)
            actor, opt = apply_gradients(state.actor, grads, state.actor_opt, self.actor_lr)
            targets = polyak_update((state.target_actor, state.target_critics), (actor, state.critics), self.tau)
            state = state._replace(actor=actor, actor_opt=opt, target_actor=targets[0], target_critics=targets[1])
            return state, loss * self.policy_freq  # so that the mean over a chunk is the mean over actor updates

        # `step` is shared by all lanes: a batched predicate would compute both branches always.
        state, loss = jax.lax.cond(step % self.policy_freq == 0, improve, lambda s: (s, jnp.zeros(())), state)
        return state, metrics | {"actor_loss": loss}

    def representation_loss(self, state, batch, *, step, key):
        """That of the critics."""
        return loss_of_critics(self, state, batch, key)

    def policy(self, state) -> NormalizedPolicy:
        """The actor."""
        return Deterministic(state.actor)

    def q_value(self, state, observation, action):
        """The smaller of the two critics."""
        return minimum(q_values(state.critics, observation, action))
