"""Policies in JAX that take rows of a table by the names of its columns, of files and of runs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.errors import UserError
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy, History, Mixture, first_actions
from deadreckon.policies.file import fitting
from deadreckon.policies.table_encoder import like
from deadreckon.policies.table_predict import Predictor


class JaxPlayer:
    """A `table_predict.Player` of a policy as agents give it.

    Args:
        policy: what acts.
    """

    def __init__(self, policy: EnvPolicy):
        inner = policy.inner
        self.policy = policy
        self.members = [JaxPlayer(member) for member in inner.members] if isinstance(inner, Mixture) else []
        self.member = JaxPlayer(inner.member) if isinstance(inner, History) else None
        self.steps, self.action_size = (inner.steps, inner.action_size) if isinstance(inner, History) else (1, 0)
        if not self.members and self.member is None and not _is_empty(policy.start(1)):
            text = f"a {type(inner).__name__} policy has a memory of the episode and does not act on single rows"
            raise UserError(f"{text}: use its start and act")

    def act(self, observations: np.ndarray, rng: np.random.Generator, greedy: bool) -> np.ndarray:
        """See `Player`."""
        key = jax.random.key(0 if greedy else int(rng.integers(2**31)))
        return np.asarray(first_actions(self.policy, _padded(observations), key, greedy))[: len(observations)]

    def probs(self, observations: np.ndarray) -> np.ndarray | None:
        """See `Player`."""
        tells = self.policy.action_probs
        return None if tells is None else tells(_padded(observations))[: len(observations)]

    def done(self, actions: np.ndarray) -> np.ndarray:
        """See `Player`."""
        assert self.member is not None
        view = self.member.policy.view
        if view.low is None:
            return np.eye(self.action_size, dtype=np.float32)[actions]
        return np.asarray(view.to_unit(np.asarray(actions, np.float32)), np.float32)


def _is_empty(carry: Any) -> bool:
    return isinstance(carry, tuple) and not len(carry)


def _padded(observations: np.ndarray) -> jax.Array:
    """The observations and further rows up to a power of two, so that tables of all lengths share a few compiled programs."""
    rows = 1 << max(len(observations) - 1, 0).bit_length()
    padding = [(0, rows - len(observations)), *[(0, 0)] * (observations.ndim - 1)]
    return jnp.asarray(np.pad(observations, padding))


class TablePolicy(Predictor):
    """A policy in JAX that takes rows of a table by the names of its columns, and gives actions by theirs.

    Args:
        policy: what acts.
        log: what its file keeps of its log, `store.meta(file)["log"]`.
        name: of the rows, for errors.

    Attributes:
        policy: it.
    """

    def __init__(self, policy: EnvPolicy, log: Mapping[str, Any], name: str = "rows"):
        super().__init__(JaxPlayer(policy), log, name)
        self.policy = policy

    def _acts(self) -> tuple[int | None, int | None]:
        """As of `Predictor`, by shapes alone, because compiling takes seconds."""
        seen = jax.ShapeDtypeStruct((1, *(shape := self.encoder.shape or ())), like(shape))
        acts = jax.eval_shape(lambda one: first_actions(self.policy, one, jax.random.key(0), True), seen).shape
        return acts[1] if len(acts) > 1 else None, None


def load_policy(path: Path | str) -> TablePolicy:
    """A policy from its file, which takes rows by the names of its log's columns.

    Args:
        path: of a policy file, such as `runs/mine/policies/seed0.npz` or a cross-fit's `mixture.npz`.

    Raises:
        UserError: the file is missing, broken or not a policy file.
    """
    if Path(path).is_dir():
        raise UserError(f"{path} is a folder; load_run({str(path)!r}).predict takes the policy of a run")
    saved = store.load_all(path)
    return fitting(path, TablePolicy(saved.policy, saved.meta.get("log") or {}))
