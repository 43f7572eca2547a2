"""What acts: the protocol, what policies of agents have in common, and any Python function as a policy."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from deadreckon.data.step import Step
from deadreckon.errors import UserError

KINDS: dict[str, type[eqx.Module]] = {}  # of policies that a file can hold, by name; each registers itself


@runtime_checkable
class Policy(Protocol):
    """Acts in `n` environments at once. Memoryless policies carry ()."""

    has_log_prob: bool

    def start(self, n: int) -> Any:
        """The carry before the first step."""
        ...

    def act(self, step: Step, carry: Any, key: Any, *, greedy: bool) -> tuple[Any, Any]:
        """Actions (n, size) and the next carry. `greedy` asks for the deterministic (greedy) action instead of a sample."""
        ...


class NormalizedPolicy(eqx.Module):
    """A policy in a method's coordinates: observations as trained on, actions in [-1, 1] or indices.

    Memoryless continuous ones implement `pre_actions` alone, or `actions` where these are not squashed by a tanh; those that
    remember, or choose among discrete actions, override `start` and `act`. Greedy actions of a memoryless policy are a function
    of the observation: they use no `key`, and what they draw, such as candidates, is drawn once and kept in the policy.
    """

    has_log_prob = False

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        if cls.__name__.startswith("_"):
            return
        known = KINDS.setdefault(cls.__name__, cls)
        if known.__module__ != cls.__module__:  # files name kinds, and one name must not come to mean another
            raise TypeError(f"{known.__module__} has a kind of policy called {cls.__name__} already; choose another name")
        KINDS[cls.__name__] = cls

    def start(self, n: int) -> Any:
        """The carry before the first step of `n` environments."""
        return ()

    def act(self, step: Step, carry: Any, key: PRNGKeyArray, *, greedy: bool) -> tuple[Array, Any]:
        """Actions in [-1, 1] (or indices) and the next carry."""
        return self.actions(step.observation, key, greedy=greedy), carry

    def actions(
        self, observation: Float[Array, "n o"], key: PRNGKeyArray, *, greedy: bool, count: tuple[int, ...] = ()
    ) -> Float[Array, "*c n a"]:
        """Actions in [-1, 1]; `count` of them along new leading axes."""
        return jnp.tanh(self.pre_actions(observation, key, greedy=greedy, count=count))

    def pre_actions(
        self, observation: Float[Array, "n o"], key: PRNGKeyArray, *, greedy: bool, count: tuple[int, ...] = ()
    ) -> Float[Array, "*c n a"]:
        """Draws before the tanh; `count` of them along new leading axes."""
        raise NotImplementedError


class BlackBoxPolicy:
    """Any Python function `fn(observations, rng) -> actions` on numpy arrays as a policy.

    Args:
        fn: gets observations (n, *shape) and a `numpy.random.Generator`, gives actions (n, size), or (n,) discrete ones.
        log_prob: gets observations and actions, gives their log-densities (n,), of discrete actions their log-probabilities;
            None where it is not known.
        action_probs: of discrete actions: gets observations, gives (n, actions) probabilities; None where it is not known.
    """

    def __init__(
        self,
        fn: Callable[[np.ndarray, np.random.Generator], np.ndarray],
        log_prob: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
        action_probs: Callable[[np.ndarray], np.ndarray] | None = None,
    ):
        self.fn, self._log_prob, self.action_probs = fn, log_prob, action_probs

    @property
    def has_log_prob(self) -> bool:
        """Whether `log_prob` is defined."""
        return self._log_prob is not None

    def log_prob(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """(n,) log-densities of actions, where the function came with them."""
        if self._log_prob is None:
            raise UserError("this BlackBoxPolicy has no log-probabilities; give it log_prob=")
        return np.asarray(self._log_prob(observations, actions))

    def start(self, n: int) -> tuple[()]:
        """Nothing is carried; the function may keep its own state."""
        return ()

    def act(self, step: Step, carry: Any, key: Any, *, greedy: bool = False) -> tuple[np.ndarray, Any]:
        """Calls the function. `key` may be a numpy generator or a JAX key."""
        if not isinstance(key, np.random.Generator):
            key = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        actions = np.asarray(self.fn(np.asarray(step.observation), key))
        if len(actions) != len(step.observation):
            raise UserError(f"the policy function gave {len(actions)} actions for {len(step.observation)} observations")
        return actions, carry

    def __call__(self, observations: Any) -> np.ndarray:
        """The function's actions with a generator seeded with 0."""
        x = np.asarray(observations)
        single = x.ndim == 1
        actions = self.act(Step(x[None] if single else x, None, None), (), np.random.default_rng(0))[0]
        return actions[0] if single else actions
