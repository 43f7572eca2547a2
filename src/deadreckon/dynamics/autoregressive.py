"""Auto-regressive models: each number of the next observation is drawn given those before it (Zhang et al. 2021; thesis 8.5).

p(change, reward | s, a) = prod_i p(x_i | s, a, x_1 .. x_{i-1}), so that the numbers may depend on each other, which a
diagonal Gaussian cannot say. One network serves all i: it sees the numbers so far and which one it is asked for.
"""

import jax
import jax.numpy as jnp

from deadreckon.dynamics.gaussian import BOUND_WEIGHT
from deadreckon.dynamics.model import LOG_VARIANCE, Model, bernoulli_nll, choices, gaussian_nll, known_of, soft_bounds
from deadreckon.nets.mlp import MLP, ensemble
from deadreckon.randomness import key_for, keys
from deadreckon.training.hyperparameters import Count, static


class AutoRegressive(Model):
    """An ensemble of auto-regressive networks."""

    outputs: Count = static(4)  # outputs of a row, drawn at random, that an update fits

    def create(self, spec, key):
        """Networks with outputs (mean, log-variance), others for the end, and bounds of the log-variances."""
        numbers = spec.observation_size + 1
        inputs = spec.observation_size + spec.action_size
        kn, ke = keys(key, "nets", "ends")
        make = lambda k: MLP.create(inputs + 2 * numbers, self.hidden, 2, k, activation="swish")  # noqa: E731
        end = lambda k: MLP.create(inputs + numbers, self.hidden[:2], 1, k, activation="swish")  # noqa: E731
        bounds = jnp.broadcast_to(jnp.asarray(LOG_VARIANCE)[:, None], (self.members, 2, numbers)) + 0.0
        return {
            "nets": ensemble(make, self.members, kn), "ends": ensemble(end, self.members, ke), "bounds": bounds,
            "choices": choices(spec, self.members),
        }  # fmt: skip

    @staticmethod
    def _number(net, bounds, inputs, known, which):
        """Mean and log-variance of number `which` (*b,), given those before it in `known` (*b, numbers)."""
        numbers = known.shape[-1]
        before = jnp.where(jnp.arange(numbers) < which[..., None], known, 0.0)
        out = net(jnp.concatenate([inputs, before, jax.nn.one_hot(which, numbers)], -1))
        own = bounds[:, which]
        return out[..., 0], soft_bounds(out[..., 1], own)

    def losses(self, params, inputs, target, terminal, key):
        """See `Model`; an estimate from the `outputs` that were drawn."""
        target, known = known_of(target)
        # Unknown changes are sampled from the model itself: rewards and ends that were conditioned on zeros would hardly ever
        # be drawn, because the model hardly ever draws zeros.
        drawn = lambda: self.sample(jax.lax.stop_gradient(params), inputs, key_for(key, "not known"))[0]  # noqa: E731
        target = jnp.where(known, target, jax.lax.cond(known.all(), lambda: target, drawn))
        numbers = target.shape[-1]
        which = jax.random.randint(key, (*terminal.shape, self.outputs), 0, numbers)
        wide = lambda x: jnp.broadcast_to(x[:, None], (len(x), self.outputs, x.shape[-1]))  # noqa: E731

        def one(net, end, bounds, inputs, target, known, terminal, which):
            mean, log_variance = self._number(net, bounds, wide(inputs), wide(target), which)
            nll = gaussian_nll(mean, log_variance, jnp.take_along_axis(target, which, 1))
            nll = jnp.where(jnp.take_along_axis(known, which, 1), nll, 0.0)
            logit = end(jnp.concatenate([inputs, target], -1))[..., 0]
            return numbers * nll.mean(1) + bernoulli_nll(logit, terminal) + BOUND_WEIGHT * (bounds[1] - bounds[0]).sum()

        return jax.vmap(one)(params["nets"], params["ends"], params["bounds"], inputs, target, known, terminal, which)

    def sample(self, params, inputs, key):
        """See `Model`; number by number. Without a key each number is the mean that follows from the means before it."""
        numbers = params["bounds"].shape[-1]
        shape = numbers, *inputs.shape[:-1]
        noise = jnp.zeros(shape) if key is None else jax.random.normal(key, shape)

        def one(net, end, bounds, inputs, noise):
            def step(i, known):
                mean, log_variance = self._number(net, bounds, inputs, known, jnp.full(inputs.shape[:-1], i))
                return known.at[..., i].set(mean + jnp.exp(0.5 * log_variance) * noise[i])

            known = jax.lax.fori_loop(0, numbers, step, jnp.zeros((*inputs.shape[:-1], numbers)))
            return known, end(jnp.concatenate([inputs, known], -1))[..., 0]

        return jax.vmap(one, (0, 0, 0, 0, 1))(params["nets"], params["ends"], params["bounds"], inputs, noise)
