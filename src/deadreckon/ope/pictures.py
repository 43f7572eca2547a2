"""Policies with image observations are evaluated on the features that their encoders compute.

An encoder was trained only on its policy's training episodes, so features of other episodes are out of sample. With several
encoders, critics use the features of all of them, and each policy those of its encoder.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.nets.encoder import Encoder
from deadreckon.policies.deployed import EnvPolicy, Mixture, Seeing

BLOCK = 512  # images at a time


def with_features(log: Dataset, policies: Sequence[Any], names: Sequence[str]) -> tuple[Dataset, list[slice]]:
    """The log on which policies are evaluated, with features instead of images.

    Args:
        log: of images.
        policies: that take images.
        names: one each, for errors.

    Returns:
        The log, whose episodes keep their ids, and the part of a row that each policy acts on.

    Raises:
        UserError: a policy has no encoder of this package, or one for images of another shape.
    """
    encoders: list[Encoder] = []
    parts = []
    for policy, name in zip(policies, names):
        if isinstance(policy, EnvPolicy) and isinstance(policy.inner, Mixture):
            what = f"{name} is a mixture of policies with image observations"
            raise UserError(f"{what}: give the folder of its cross-fit, or its members")
        if not (isinstance(policy, EnvPolicy) and isinstance(policy.inner, Seeing)):
            raise UserError(
                f"{name} has no encoder: estimators evaluate policies with image observations on the features that the "
                "encoders of the package's agents make of them"
            )
        encoder = policy.inner.encoder
        if encoder.shape != log.spec.observation_shape:
            raise UserError(f"{name} takes images of shape {encoder.shape}, {log.name} has {log.spec.observation_shape}")
        same = [i for i, other in enumerate(encoders) if _equal(encoder, other)]
        if not same:
            encoders.append(encoder)
        which = same[0] if same else len(encoders) - 1
        first = sum(each.features for each in encoders[:which])
        parts.append(slice(first, first + encoder.features))
    following = None if log.successors is None else _features(encoders, log.successors)
    seen = replace(
        log, observations=_features(encoders, log.observations), final_observations=_features(encoders, log.final_observations),
        successors=following, part_of=lambda: log.episode_ids,
    )  # fmt: skip
    return seen, parts


def behind(policy: Any) -> Any:
    """The part of a policy with an encoder that acts on features; other policies unchanged."""
    return policy.inner.member if isinstance(policy, EnvPolicy) and isinstance(policy.inner, Seeing) else policy


def _equal(one: Encoder, other: Encoder) -> bool:
    if jax.tree.structure(one) != jax.tree.structure(other):
        return False
    return all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other)))


def _features(encoders: Sequence[Encoder], pictures: Any) -> np.ndarray:
    """(rows, features of all encoders) float32, a block of images at a time; all blocks are of one shape."""
    out = np.empty((len(pictures), sum(each.features for each in encoders)), np.float32)
    for start in range(0, len(out), BLOCK):
        part = np.asarray(pictures[start : start + BLOCK])
        wide = np.concatenate([part, np.repeat(part[-1:], min(BLOCK, len(out)) - len(part), 0)])
        out[start : start + BLOCK] = np.concatenate([_seen(each, wide) for each in encoders], 1)[: len(part)]
    return out


@eqx.filter_jit
def _seen(encoder: Encoder, pictures: Any) -> Array:
    return encoder(pictures)
