"""What every agent is, and the steps that several share. One algorithm is one file beside this one."""

import dataclasses
from typing import TYPE_CHECKING, Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP, UNIFORM, Init, ensemble, q_values
from deadreckon.policies.kinds import Categorical, TanhMeanGaussian, stochastic
from deadreckon.policies.policy import NormalizedPolicy
from deadreckon.provided import provided
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import check_fields
from deadreckon.training.learner import Metrics
from deadreckon.training.pictures import of_pictures

if TYPE_CHECKING:
    from deadreckon.runs.run import Run


class Agent(eqx.Module):
    """Hyperparameters in, pure functions out. Float fields are traced, all others are marked static.

    The comment behind a field becomes its help on the command line.

    Attributes:
        revision: raised in the class whose code has changed training or acting; here for the code that all agents share (class
            attribute). It identifies results of suites (see bench/identity.py).
        supports_discrete: whether it takes `Discrete` actions too, and not continuous ones alone (class attribute).
        supports_images: whether it also supports images, by an encoder (`training.pictures`; an attribute of the class
            itself, which subclasses do not inherit: they may learn by other losses).
        supports_history: whether observations may be histories of several steps (`data.history`; class attribute).
        own_history: why it takes none, where it does not (class attribute).
        one_log: whether the sizes of its networks depend on more of a log than the shapes of its columns, so that other logs
            cannot share its program (class attribute).
        by_length: fields left to it (None) that follow from the number of updates (class attribute).
        online: whether it supports online training, because its policy explores (class attribute).
        offline: whether it can learn from a log alone (class attribute).
        fine_tunes: whether it can continue in a simulator with a log in its replay (class attribute).
        exploration_noise: standard deviation of the normal noise that is added to its actions in [-1, 1] while it learns by
            acting, for policies that draw nothing (class attribute).
    """

    revision: ClassVar[int] = 1
    supports_discrete: ClassVar[bool] = False
    online: ClassVar[bool] = False
    offline: ClassVar[bool] = True
    fine_tunes: ClassVar[bool] = False
    exploration_noise: ClassVar[float] = 0.0
    supports_images: ClassVar[bool] = False
    supports_history: ClassVar[bool] = True
    own_history: ClassVar[str] = ""
    one_log: ClassVar[bool] = False
    by_length: ClassVar[tuple[str, ...]] = ()

    def needs(self, spec: Spec) -> BatchSpec:
        """What every batch must hold."""
        raise NotImplementedError

    def init(self, spec: Spec, key: PRNGKeyArray) -> Any:
        """The first state, a pytree of arrays."""
        raise NotImplementedError

    def update(self, state: Any, batch: Batch, *, step: Array, key: PRNGKeyArray) -> tuple[Any, Metrics]:
        """One pure update."""
        raise NotImplementedError

    def representation_loss(self, state: Any, batch: Batch, *, step: Array, key: PRNGKeyArray) -> Array:
        """The loss of an encoder of images, of features in the batch; `key` is that of `update`.

        Where there are critics it is their loss: an actor takes features as they are (Yarats et al. 2022, section 3.1).
        """
        raise NotImplementedError

    @property
    def representation_lr(self) -> Any:
        """Learning rate of an encoder of images: that of its loss."""
        return vars(self).get("critic_lr", vars(self).get("lr"))

    def policy(self, state: Any) -> NormalizedPolicy:
        """What acts, in the coordinates of the batches; `runs` puts it between raw observations and actions."""
        raise NotImplementedError

    def q_value(self, state: Any, observation: Array, action: Array) -> Float[Array, "b"] | None:
        """The agent's own estimate of the discounted return, for diagnostics; None if it has none."""
        return None

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """How acting and learning take turns in a task, where the agent does not want it as `online.Online` has it."""
        return {}

    def resolve(self, spec: Spec, steps: int) -> Self:
        """Checks the fields against the log and fills in those that were left to it (None).

        Args:
            spec: of the log.
            steps: updates of the whole run.

        Raises:
            UserError: names the field and what it takes.
        """
        check_fields(self)
        if spec.rows and not self.offline:
            raise UserError(f"{type(self).__name__} trains by acting in a simulator, not on a log; use --online --task TASK")
        if spec.discrete and not self.supports_discrete:
            raise UserError(f"{type(self).__name__} needs continuous actions, {spec.name} has {spec.action}")
        if len(spec.observation_shape) != 1 and not (vars(type(self)).get("supports_images") and of_pictures(spec)):
            seen = f"{spec.name} has shape {spec.observation_shape} of {spec.observation_dtype}"
            if self.supports_images:
                own = bool(vars(type(self)).get("supports_images"))
                may = "" if own else " where its class says supports_images = True"
                kinds = f"flat observations, or images (height, width, channels) of uint8{may}"
                if own or not type(self).__module__.startswith("deadreckon."):
                    raise UserError(f"{type(self).__name__} takes {kinds}; {seen}")
            raise UserError(f"{type(self).__name__} needs flat observations, {seen}")
        return self

    def fit(self, data: Any, *, out: Any = None, **settings: Any) -> "Run":
        """Learns from a log: `deadreckon.train(self, data, ...)`, in a new folder every time.

        The agent itself holds hyperparameters and does not change; the results of training are in the returned run.

        Args:
            data: a `Dataset`, the name of a known log, or a file.
            out: run folder; None: the first of `runs/AGENT-LOG`, `runs/AGENT-LOG-2`, ... that is not there yet.
            **settings: `steps`, `seeds`, `seed`, `task` and all others that `deadreckon.train` takes.

        Raises:
            UserError: input that does not fit, in one line; nothing is written then.
        """
        return provided("fit")(self, data, out=out, **settings)

    def going_on(self) -> Self:
        """The agent that continues in a simulator after a run on a log: without settings for that run alone."""
        return self

    def replace(self, **changes: Any) -> Self:
        """The same agent with some fields changed."""
        return dataclasses.replace(self, **changes)


def create_critics(
    spec: Spec, hidden: tuple[int, ...], count: int, key: PRNGKeyArray, *, activation: str = "relu", normalise: bool = False,
    init: Init = UNIFORM,
) -> MLP:  # fmt: skip
    """`count` Q-networks of (observation, action), stacked; of discrete actions they have an output each."""
    inputs = spec.observation_size + (0 if spec.discrete else spec.action_size)
    outputs = spec.action_size if spec.discrete else 1
    options: Any = {"activation": activation, "normalise": normalise, "init": init, "mask": spec.mask_size}
    return ensemble(lambda k: MLP.create(inputs, hidden, outputs, k, **options), count, key)


def bellman_loss(
    critics: MLP, batch: Batch, target: Float[Array, "*k b"], weight: Float[Array, "b"] | None = None
) -> tuple[Float[Array, ""], Metrics]:
    """Mean squared error of every critic to the same target, summed over critics; `weight` a row, of mean one."""
    q = q_values(critics, batch.observation, batch.action)
    error = jnp.square(q - jax.lax.stop_gradient(target))
    error = error if weight is None else error * weight
    return error.mean(-1).sum(), {"critic_loss": error.mean(), "q": q.mean()}


def loss_of_critics(agent: Any, state: Any, batch: Batch, key: PRNGKeyArray) -> Float[Array, ""]:
    """The `critic_loss` of an agent at its `target`, with the draws of its update, which `key` is of."""
    k_target, k_critics = keys(key, "target", "critic_loss")
    return agent.critic_loss(state.critics, state, batch, agent.target(state, batch, k_target), k_critics)[0]


def backup(batch: Batch, discount: Any, future: Float[Array, "*k b"]) -> Float[Array, "*k b"]:
    """r + discount (1 - terminal) future. A terminal has no future; a timeout does."""
    return batch.reward + discount * (1.0 - batch.terminal) * future


def traced_advantage(error: Float[Array, "t *b"], goes_on: Float[Array, "t *b"], decay: Any) -> Float[Array, "t *b"]:
    """sum_k decay^k error_{t+k} along the first axis, as far as `goes_on`: generalised advantages from errors of one step."""

    def back(later: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        advantage = step[0] + decay * step[1] * later
        return advantage, advantage

    return jax.lax.scan(back, jnp.zeros(error.shape[1:]), (error, goes_on), reverse=True)[1]


def advantage_in_windows(batch: Batch, error: Float[Array, "b w"], decay: Any) -> Float[Array, "b w"]:
    """`traced_advantage` of rows of windows: each hands its own to the one before it in the same episode and window."""
    goes_on = jnp.concatenate([batch.mask[:, 1:], jnp.zeros_like(batch.mask[:, :1])], 1)
    return traced_advantage(error.T, goes_on.T, decay).T


def rows_of_windows(batch: Batch, window: int) -> Float[Array, "b w"]:
    """What a row of a window counts for, of mean one: nothing beyond the episode's end.

    A row early in its episode is in fewer windows than others, and counts for more in them.
    """
    share = batch.mask / jnp.minimum(batch.time + 1.0, window)
    return share / jnp.maximum(share.mean(), 1e-12)


def capped_exp(x: Float[Array, "*b"], most: Any) -> Float[Array, "*b"]:
    """exp(x), `most` at most; the exponent is cut, so that no row is infinite."""
    return jnp.exp(jnp.minimum(x, jnp.log(most)))


def imitation_loss(
    actor: MLP | Categorical | TanhMeanGaussian, batch: Batch, weight: Float[Array, "*b"]
) -> Float[Array, ""]:
    """-E[weight log pi(a|s)] of a stochastic actor, in the likelihood that it was created with; weights have no slope."""
    log_prob = stochastic(actor).log_likelihood(batch.observation, batch.action)
    return -(jax.lax.stop_gradient(weight) * log_prob).mean()
