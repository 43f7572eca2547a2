"""What is saved, evaluated and shipped: policies between raw observations and the environment's actions."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from deadreckon.data.history import beginning, history_size
from deadreckon.data.normalizer import EDGE, Normalizer
from deadreckon.data.spec import Spec
from deadreckon.data.step import Step
from deadreckon.errors import UserError
from deadreckon.nets.encoder import Encoder
from deadreckon.nets.layer_norm_mlp import LayerNormMLP
from deadreckon.nets.mlp import MLP
from deadreckon.policies.candidates import GreedyActions, GreedyQ, OneStep, PerturbedPolicy, VAEDecoder
from deadreckon.policies.kinds import Categorical, ClippedGaussian, Gaussian, TanhGaussian
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.policies.portable import check_finite, check_size
from deadreckon.randomness import keys
from deadreckon.training.pictures import Seen


class EnvPolicy(eqx.Module):
    """An inner policy with its conversions from raw observations and to the environment's actions; it is saved and evaluated.

    Attributes:
        inner: in the method's coordinates.
        mean, std: of the observations, or None.
        low, high: (size,) bounds of the actions.
    """

    inner: NormalizedPolicy
    mean: Array | None
    std: Array | None
    low: Array | None
    high: Array | None

    @classmethod
    def of(cls, inner: NormalizedPolicy, view: Normalizer) -> "EnvPolicy":
        """`inner` seen through `view`."""
        arrays = (None if v is None else jnp.asarray(v) for v in (view.mean, view.std, view.low, view.high))
        return cls(inner, *arrays)

    @property
    def view(self) -> Normalizer:
        """The change of coordinates."""
        return Normalizer(self.mean, self.std, self.low, self.high)  # pyrefly: ignore[bad-argument-type] - JAX's arrays do

    @property
    def has_log_prob(self) -> bool:
        """Whether `log_prob` is defined."""
        return self.inner.has_log_prob

    def start(self, n: int) -> Any:
        """The inner policy's carry."""
        return self.inner.start(n)

    def act(self, step: Step, carry: Any, key: PRNGKeyArray, *, greedy: bool) -> tuple[Array, Any]:
        """Actions in the environment's bounds, where these are known."""
        seen = step._replace(observation=self.view.observe(step.observation))
        action, carry = self.inner.act(seen, carry, key, greedy=greedy)
        if isinstance(self.inner, Gaussian) and self.low is not None:
            action = jnp.clip(action, -1.0, 1.0)
        return self.view.from_unit(action), carry

    def log_prob(self, observation: Any, action: Any) -> Array:
        """Log-density of environment actions (n, size) at raw observations (n, *shape); see also `ClippedGaussian`."""
        if isinstance(self.inner, Seeing):
            return self.inner.member.log_prob(self.inner.encoder(jnp.asarray(observation)), action)
        if not isinstance(self.inner, TanhGaussian | Gaussian | Categorical):
            raise UserError(f"a {type(self.inner).__name__} policy has no log-probabilities")
        view = self.view
        unit = view.to_unit(jnp.asarray(action))
        log_prob = self.inner.log_prob(view.observe(jnp.asarray(observation)), unit)
        if self.low is None or self.high is None:
            return log_prob
        # As `Normalizer.log_scale`, but also where the bounds are traced; what a bound has of a clipped Gaussian is no density.
        scale = jnp.log(0.5 * (self.high - self.low))
        dense = jnp.abs(unit) < EDGE if isinstance(self.inner, ClippedGaussian) else 1.0
        return log_prob - (dense * scale).sum(-1)

    @property
    def action_probs(self) -> Callable[[Any], np.ndarray] | None:
        """Of discrete actions, what gives the probabilities (n, actions) at raw observations; None for continuous ones.

        Those of a mixture are of an episode's first action; later actions depend on the member that was drawn.
        """
        if isinstance(self.inner, Mixture):
            found = [member.action_probs for member in self.inner.members]
            told = [tells for tells in found if tells is not None]
            if len(told) < len(found):
                return None
            return lambda observations: np.mean([tells(observations) for tells in told], 0)
        if isinstance(self.inner, Seeing):
            encoder, tells = self.inner.encoder, self.inner.member.action_probs
            return None if tells is None else lambda observations: tells(encoder(jnp.asarray(observations)))
        if not isinstance(self.inner, Categorical | GreedyActions):
            return None
        return lambda observations: np.asarray(_probs(self, jnp.asarray(observations)))

    def __call__(self, observations: Any, legal: Any = None) -> np.ndarray:
        """Greedy first actions for one observation or a batch of them, as numpy; draws nothing that is not seeded.

        Args:
            observations: (size,) or (n, size), raw; of pictures (height, width, channels) or (n, ...), uint8.
            legal: (actions,) or (n, actions) truth values, which are legal: the end of the observations, where these lack it.

        Raises:
            UserError: the policy acts on the last steps of an episode, of which one observation does not tell; observations of
                another size, such as without the legal actions, or that are not finite; or no action is legal.
        """
        if (steps := history_of(self)) > 1:
            raise UserError(
                f"this policy acts on the last {steps} steps of an episode, not on one observation: use its start and act"
            )
        if (shape := picture_shape(self)) is not None:
            if legal is not None:
                raise UserError("legal actions are the end of flat observations; this policy takes images, so leave legal out")
            x = checked_pictures(observations, shape)
            actions = first_actions(self, jnp.asarray(x if x.ndim == 4 else x[None]), jax.random.key(0), True)
            return np.asarray(actions if x.ndim == 4 else actions[0])
        x = np.asarray(observations, np.float32)
        x = x if legal is None else np.concatenate([x, np.asarray(legal, np.float32)], -1)
        single = x.ndim == 1
        x = x[None] if single else x
        net = getattr(self.inner, "net", getattr(self.inner, "critic", None))
        mask = net.mask if isinstance(self.inner, Categorical | GreedyActions) and isinstance(net, MLP) else 0
        size = observed_size(self)
        try:
            if size is not None:
                check_size(x, size, mask)
            check_finite(x)
        except ValueError as error:
            raise UserError(str(error)) from error
        actions = first_actions(self, jnp.asarray(x), jax.random.key(0), True)
        return np.asarray(actions[0] if single else actions)


class Mixture(NormalizedPolicy):
    """One of several policies, drawn with equal chances when an episode begins, also when `greedy`, and kept to its end.

    A policy that came of another part of a log has its own coordinates, so these are whole policies: a mixture sees raw
    observations and gives the environment's actions.

    Attributes:
        members: the policies.
    """

    members: tuple[EnvPolicy, ...]

    @classmethod
    def of(cls, members: Sequence[EnvPolicy]) -> EnvPolicy:
        """A mixture of policies with equal sizes, to be saved and evaluated."""
        return EnvPolicy(cls(tuple(members)), None, None, None, None)

    def start(self, n: int) -> tuple[Array, tuple[Any, ...]]:
        """(n,) which member acts, not drawn yet, and the members' carries."""
        return jnp.zeros(n, jnp.int32), tuple(member.start(n) for member in self.members)

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`; in the environment's bounds."""
        which, carries = carry
        k_which, k_members = keys(key, "which", "members")
        first = jnp.asarray(step.first, bool)
        which = jnp.where(first, jax.random.randint(k_which, first.shape, 0, len(self.members)), which)
        own = jax.random.split(k_members, len(self.members))
        acts = [member.act(step, c, k, greedy=greedy) for member, c, k in zip(self.members, carries, own)]
        actions = jnp.stack([action for action, _ in acts])
        return actions[which, jnp.arange(len(which))], (which, tuple(kept for _, kept in acts))


class History(NormalizedPolicy):
    """Acts on the last steps of an episode, which it carries, as a memoryless policy does on rows of `data.history.stacked`.

    As in a mixture the member is a whole policy: this one sees raw observations and gives the environment's actions. It takes
    what it does for what is done, so it cannot be stepped beside another policy that acts in its place.

    Attributes:
        member: from histories to actions.
        steps: observations in a history.
        observation_size, action_size: numbers in one observation, and in an action as a history has it.
    """

    member: EnvPolicy
    steps: int = eqx.field(static=True)
    observation_size: int = eqx.field(static=True)
    action_size: int = eqx.field(static=True)

    @classmethod
    def of(cls, member: EnvPolicy, steps: int, spec: Spec) -> EnvPolicy:
        """The policy to save and evaluate; `member` itself if a history is one observation. `spec` is the unstacked
        log's."""
        if steps == 1:
            return member
        return EnvPolicy(cls(member, steps, spec.observation_size, spec.action_size), None, None, None, None)

    def start(self, n: int) -> tuple[Array, Array]:
        """(n, history_size) the histories and (n, action_size) the last actions, which an episode's first step replaces."""
        size = history_size(self.observation_size, self.action_size, self.steps)
        return jnp.zeros((n, size)), jnp.zeros((n, self.action_size))

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`; in the environment's bounds."""
        history, last = carry
        observation = jnp.asarray(step.observation, jnp.float32)
        kept = history[:, self.observation_size + self.action_size :]
        later = jnp.concatenate([kept, last, observation], 1)
        first = jnp.asarray(step.first, bool)[:, None]
        history = jnp.where(first, beginning(observation, self.action_size, self.steps), later)
        action, _ = self.member.act(step._replace(observation=history), (), key, greedy=greedy)
        done = jax.nn.one_hot(action, self.action_size) if self.member.low is None else self.member.view.to_unit(action)
        return action, (history, done)


class Seeing(NormalizedPolicy):
    """Acts on the features that an encoder computes of images.

    As in a mixture the member is a whole policy: this one takes raw images and returns the environment's actions.

    Attributes:
        encoder: from images to features.
        member: from features to actions.
    """

    encoder: Encoder
    member: EnvPolicy

    @property
    def has_log_prob(self) -> bool:  # pyrefly: ignore[bad-override] - nobody sets it
        """Whether `log_prob` is defined."""
        return self.member.has_log_prob

    def start(self, n):
        """See `NormalizedPolicy`."""
        return self.member.start(n)

    def act(self, step, carry, key, *, greedy):
        """See `NormalizedPolicy`; in the environment's bounds."""
        return self.member.act(step._replace(observation=self.encoder(step.observation)), carry, key, greedy=greedy)

    def actions(self, observation, key, *, greedy, count=()):
        """See `NormalizedPolicy`; in the environment's bounds."""
        drawn = self.member.inner.actions(self.encoder(observation), key, greedy=greedy, count=count)
        return self.member.view.from_unit(drawn)


def deployed(agent: Any, state: Any, view: Normalizer) -> EnvPolicy:
    """An agent's policy in a state, to be saved and evaluated; `view` has the coordinates of its batches."""
    if not isinstance(state, Seen):
        return EnvPolicy.of(agent.policy(state), view)
    seeing = Seeing(state.encoder, EnvPolicy.of(agent.policy(state.inner), view))
    return EnvPolicy(seeing, None, None, None, None)


def picture_shape(policy: Any) -> tuple[int, int, int] | None:
    """(height, width, channels) of the images that a policy, or a mixture's members, take; None for others."""
    inner = policy.inner if isinstance(policy, EnvPolicy) else None
    if isinstance(inner, Mixture):
        return picture_shape(inner.members[0])
    return inner.encoder.shape if isinstance(inner, Seeing) else None


def observed_size(policy: EnvPolicy) -> int | None:
    """Numbers of an observation that a policy takes; None if its networks do not tell."""
    if policy.mean is not None:
        return policy.mean.shape[-1]
    inner: Any = policy.inner
    if isinstance(inner, Mixture):
        return observed_size(inner.members[0])
    inner = inner.actor if isinstance(inner, GreedyQ) else inner
    if isinstance(inner, PerturbedPolicy | VAEDecoder):
        return inner.vae.encoder.weights[0].shape[-2] - inner.vae.decoder.biases[-1].shape[-1]
    net = getattr(inner, "net", getattr(inner, "critic", None))
    if not isinstance(net, MLP | LayerNormMLP):
        return None
    return net.weights[0].shape[-2] - (net.biases[-1].shape[-1] if isinstance(inner, OneStep) else 0)


def checked_pictures(given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """One image or a batch of images.

    Raises:
        UserError: they are not of uint8, or of another shape.
    """
    pictures = np.asarray(given)
    if pictures.dtype != np.uint8 or pictures.shape[-3:] != shape or pictures.ndim > 4:
        seen = f"{pictures.dtype} of shape {pictures.shape}"
        raise UserError(f"this policy takes images, uint8 of shape {shape} or (n, {str(shape)[1:]}, got {seen}")
    return pictures


def history_of(policy: Any) -> int:
    """Last observations that a policy acts on; 1 for those that carry no history."""
    inner = policy.inner if isinstance(policy, EnvPolicy) else None
    if isinstance(inner, Mixture):
        return max(map(history_of, inner.members))
    return inner.steps if isinstance(inner, History) else 1


def memoryless(policy: Any) -> Any:
    """The policy on histories inside one that carries them; others unchanged."""
    return policy.inner.member if isinstance(policy, EnvPolicy) and isinstance(policy.inner, History) else policy


@eqx.filter_jit
def first_actions(policy: EnvPolicy, observations: Array, key: PRNGKeyArray, greedy: bool) -> Array:
    """What the policy does at raw observations (n, *shape) as the first of an episode, (n, size)."""
    n = len(observations)
    step = Step(observations, jnp.zeros(n), jnp.ones(n, bool))
    return policy.act(step, policy.start(n), key, greedy=greedy)[0]


@eqx.filter_jit
def _probs(policy: EnvPolicy, observations: Array) -> Array:
    assert isinstance(policy.inner, Categorical | GreedyActions)
    return policy.inner.probs(policy.view.observe(observations))
