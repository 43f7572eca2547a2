"""The least divergence of a tanh-Gaussian from a normal model of a log's policy, the model truncated to the bounds or not.

    python evidence/studies/kl_floor.py hopper-medium-v2 antmaze-umaze-v2

KL-control holds the divergence at a target, which must not lie below the least one. Without truncation the model's mass beyond
the bounds, where no policy has any, counts as a divergence.
"""

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

import deadreckon as dr
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.policies.kinds import Gaussian, TanhMeanGaussian

MODEL, ACTOR, BATCH, RATE = 6_000, 3_000, 256, 3e-4  # updates of both, rows and learning rate of an update
ROWS = 5_000  # by which divergences are estimated


@partial(jax.jit, static_argnums=(0, 4))
def fitted(loss: Callable[..., Any], nets: Any, rows: Any, key: Any, steps: int) -> Any:
    """Networks after updates on random rows."""

    def update(i, carry):
        nets, opt = carry
        k_rows, k_loss = jax.random.split(jax.random.fold_in(key, i))
        some = jax.random.randint(k_rows, (BATCH,), 0, len(rows[0]))
        return apply_gradients(nets, jax.grad(loss)(nets, *(each[some] for each in rows), k_loss), opt, RATE)

    return jax.lax.fori_loop(0, steps, update, (nets, init_opt(nets)))[0]


def divergence(density: Callable[..., Any], actor: MLP, seen: Any, taken: Any, key: Any) -> Any:
    """Mean of log pi - log model over draws of the actor."""
    d = dist.gaussian_head(actor(seen))
    pre = dist.sample(d, key)
    return (dist.log_prob(d, pre) - density(seen, jnp.tanh(pre))).mean()


def main(names: list[str]) -> None:
    """Prints the mass of each model within the bounds, and both divergences."""
    for name in names:
        data, key = dr.load(name), jax.random.key(0)
        limit = 1.0 - 1e-6
        rows = jnp.asarray(data.observations), jnp.clip(jnp.asarray(data.actions, jnp.float32), -limit, limit)
        first = TanhMeanGaussian.create(data.spec, (256, 256), key)
        model = fitted(lambda model, seen, taken, _: -model.log_likelihood(seen, taken).mean(), first, rows, key, MODEL)
        drawn = jax.random.randint(key, (ROWS,), 0, len(rows[0]))
        some = rows[0][drawn], rows[1][drawn]
        within = jnp.exp(model.log_likelihood(*some) - model.log_truncated(*some)).mean()
        told = [f"{name}: {within:.2f} of the model's mass within the bounds"]
        for kind, density in (("not truncated", model.log_likelihood), ("truncated", model.log_truncated)):
            away = partial(divergence, density)
            actor = fitted(away, Gaussian.of(model.net, model.log_std).net, rows, key, ACTOR)
            told.append(f"least divergence {away(actor, *some, key):.2f} ({kind})")
        print("; ".join(told))


if __name__ == "__main__":
    main(sys.argv[1:])
