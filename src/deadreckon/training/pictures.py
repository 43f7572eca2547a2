"""Training on images: an encoder, shared by actor and critics, computes features for the agent's own networks.

As in DrQ-v2 (Yarats et al. 2022, section 3.1) images may be shifted at random, and the encoder is trained with one loss of the
agent, `representation_loss`, usually that of its critics; no other loss changes it.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, PRNGKeyArray

from deadreckon.data.batch import Batch
from deadreckon.data.spec import Spec, Statistics
from deadreckon.nets.encoder import Encoder, Kind, shifted
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.randomness import keys

REVISION = 1  # raised when a change of the code changes training on images (see bench/identity.py)
FEATURES = 64  # features that an agent gets instead of an image
SHIFT = 4  # pixels, the largest shift of images of 84 x 84 in DrQ-v2; of others in proportion


class Sight(NamedTuple):
    """Settings for image observations.

    Attributes:
        network: kind of encoder; see `nets.encoder.Kind`.
        shift: pixels, the largest random shift in each direction.
    """

    network: Kind = "patches"
    shift: int = 0


USUAL = Sight()


class Seen(NamedTuple):
    """The state of an agent with image observations.

    Attributes:
        encoder: the network that computes features.
        opt: its optimiser.
        inner: the agent's own state.
        shift: () int32, pixels, the largest shift of images.
    """

    encoder: Encoder
    opt: optax.OptState
    inner: Any
    shift: Array


def of_pictures(spec: Any) -> bool:
    """Whether a log's observations are images."""
    return getattr(spec, "observation_dtype", None) == "uint8" and len(spec.observation_shape) == 3  # designs have none


def features_of(spec: Spec) -> Spec:
    """The spec of a log of images for an agent that receives the encoder's features."""
    bounds = Statistics(np.zeros(FEATURES), np.ones(FEATURES), -np.ones(FEATURES), np.ones(FEATURES))
    return dataclasses.replace(spec, observation_shape=(FEATURES,), observation_dtype="float32", observation=bounds)


def usual_shift(height: int) -> int:
    """Pixels, the largest shift of images of this height, in proportion to `SHIFT`."""
    return max(1, round(SHIFT * height / 84))


def first_state(learner: Any, spec: Spec, key: PRNGKeyArray, sight: Sight) -> Any:
    """The learner's first state; for images with a new encoder."""
    if not of_pictures(spec):
        return learner.init(spec, key)
    k_encoder, k_inner = keys(key, "encoder", "agent")
    encoder = Encoder.create(sight.network, spec.observation_shape, FEATURES, k_encoder)
    inner = learner.init(features_of(spec), k_inner)
    return Seen(encoder, init_opt(encoder), inner, jnp.asarray(sight.shift, jnp.int32))


def update(learner: Any, state: Any, batch: Batch, *, step: Array, key: PRNGKeyArray) -> tuple[Any, dict[str, Array]]:
    """One update of a learner and, for images, of its encoder, both from the same features."""
    if not isinstance(state, Seen):
        return learner.update(state, batch, step=step, key=key)
    k_now, k_next, k_inner = keys(key, "shift", "next_shift", "agent")
    now = shifted(batch.observation, k_now, state.shift)
    features, back = jax.vjp(lambda encoder: encoder(now), state.encoder)
    seen = batch._replace(observation=features)
    if batch.next_observation is not None:
        seen = seen._replace(next_observation=state.encoder(shifted(batch.next_observation, k_next, state.shift)))

    def loss(features: Array) -> Array:
        return learner.representation_loss(state.inner, seen._replace(observation=features), step=step, key=k_inner)

    grads = back(jax.grad(loss)(features))[0]
    encoder, opt = apply_gradients(state.encoder, grads, state.opt, learner.representation_lr)
    inner, metrics = learner.update(state.inner, seen, step=step, key=k_inner)
    return Seen(encoder, opt, inner, state.shift), metrics
