"""Steps along natural gradients (Kakade 2001) of Gaussian policies whose deviations depend on no observation."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP


class Actor(NamedTuple):
    """A network to the means of the actions, and a log-deviation for each of them that no observation changes."""

    net: MLP
    log_std: Float[Array, "a"]

    def at(self, observation: Float[Array, "n o"]) -> dist.Gaussian:
        """The distributions at standardised observations."""
        mean = self.net(observation)
        return dist.Gaussian(mean, jnp.broadcast_to(self.log_std, mean.shape))


def log_prob(d: dist.Gaussian, action: Float[Array, "n a"]) -> Float[Array, "n"]:
    """Log-densities of actions that nothing bounds, up to a constant."""
    return (-0.5 * jnp.square((action - d.mean) * jnp.exp(-d.log_std)) - d.log_std).sum(-1)


def fisher_product(actor: Actor, observation: Float[Array, "n o"], vector: Actor) -> Actor:
    """The Fisher matrix on some observations times a vector of parameters.

    The divergence KL(old || new) has at old the Hessian J^T D J with J the Jacobian of (means, log-deviations) and D diagonal,
    1/std^2 for means and 2 for log-deviations: exact, and without a second derivative of the network.
    """

    def outputs(actor: Actor) -> tuple[Array, Array]:
        return actor.net(observation), actor.log_std

    (_, log_std), (mean_change, log_std_change) = jax.jvp(outputs, (actor,), (vector,))
    pull = jax.vjp(outputs, actor)[1]
    return pull((mean_change * jnp.exp(-2.0 * log_std) / len(observation), 2.0 * log_std_change))[0]


def natural_step(
    actor: Actor, gradient: Actor, observation: Float[Array, "n o"], delta: Any, damping: Any, iterations: int
) -> Actor:
    """The actor moved along F^-1 g, as far that the divergence, to second order, is delta / 2."""
    flat, rebuilt = ravel_pytree(gradient)

    def product(v: Array) -> Array:
        return ravel_pytree(fisher_product(actor, observation, rebuilt(v)))[0] + damping * v

    direction = jax.scipy.sparse.linalg.cg(product, flat, tol=1e-7, maxiter=iterations)[0]
    length = jnp.sqrt(delta / (flat @ direction + 1e-20))
    return jax.tree.map(lambda p, d: p + length * d, actor, rebuilt(direction))
