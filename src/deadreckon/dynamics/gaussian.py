"""Feed-forward models: a diagonal Gaussian over the change of the observation and the reward, and a chance of an end.

The probabilistic ensemble of Chua et al. 2018 that MBPO uses (thesis B.4), and MB-FF among the estimators (8.5).
"""

from typing import Literal

import jax
import jax.numpy as jnp

from deadreckon.dynamics.model import LOG_VARIANCE, Model, bernoulli_nll, choices, gaussian_nll, known_of, soft_bounds
from deadreckon.nets.mlp import MLP, TRUNCATED, UNIFORM, ensemble
from deadreckon.training.hyperparameters import static
from deadreckon.training.later_fields import later

BOUND_WEIGHT = 0.01  # of the learned bounds in the loss, which keeps them close


class Gaussian(Model):
    """An ensemble of probabilistic networks, or of deterministic ones."""

    deterministic: bool = static(False)  # squared errors instead of likelihoods, means instead of draws
    as_mbpo: bool = static(False)  # losses in the proportions of MBPO's public code, which its decay is meant for
    first_weights: Literal["uniform", "truncated_normal"] = later("uniform")  # initial weights (MBPO's public code: the latter)

    def create(self, spec, key):
        """Networks with outputs (mean, log-variance, logit of an end), and bounds of the log-variances."""
        numbers = spec.observation_size + 1
        inputs = spec.observation_size + spec.action_size
        first = {"uniform": UNIFORM, "truncated_normal": TRUNCATED}[self.first_weights]
        make = lambda k: MLP.create(inputs, self.hidden, 2 * numbers + 1, k, activation="swish", init=first)  # noqa: E731
        bounds = jnp.broadcast_to(jnp.asarray(LOG_VARIANCE)[:, None], (self.members, 2, numbers)) + 0.0
        return {"nets": ensemble(make, self.members, key), "bounds": bounds, "choices": choices(spec, self.members)}

    def _heads(self, net, bounds, inputs):
        out = net(inputs)
        mean, log_variance = jnp.split(out[..., :-1], 2, -1)
        return mean, soft_bounds(log_variance, bounds), out[..., -1]

    def heads(self, params, inputs):
        """Means and log-variances (members, b, observation + 1), and logits of an end (members, b), of (members, b, inputs)."""
        return jax.vmap(self._heads)(params["nets"], params["bounds"], inputs)

    def losses(self, params, inputs, target, terminal, key):
        """See `Model`."""

        def one(net, bounds, inputs, target, terminal):
            mean, log_variance, logit = self._heads(net, bounds, inputs)
            target, known = known_of(target)
            each = jnp.square(mean - target) if self.deterministic else gaussian_nll(mean, log_variance, target)
            row, weight = jnp.where(known, each, 0.0).sum(-1) + bernoulli_nll(logit, terminal), BOUND_WEIGHT
            if self.as_mbpo:
                # There a row counts by the mean over its numbers, without the half, and all networks share their bounds.
                row, weight = 2.0 * row / target.shape[-1], BOUND_WEIGHT / self.members
            return row if self.deterministic else row + weight * (bounds[1] - bounds[0]).sum()

        return jax.vmap(one)(params["nets"], params["bounds"], inputs, target, terminal)

    def sample(self, params, inputs, key):
        """See `Model`."""
        mean, log_variance, logit = self.heads(params, inputs)
        if key is None or self.deterministic:
            return mean, logit
        return mean + jnp.exp(0.5 * log_variance) * jax.random.normal(key, mean.shape), logit
