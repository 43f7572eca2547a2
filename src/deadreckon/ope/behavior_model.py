"""A model of the behaviour policy, for logs without propensities."""

from typing import ClassVar

import equinox as eqx
import jax

from deadreckon.data.batch import Batch, BatchSpec
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.policies import behavior as models
from deadreckon.policies.kinds import create_actor
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, host, static


class BehaviorModel(eqx.Module):
    """A model of the behaviour policy: a tanh-Gaussian or categorical network fitted by maximum likelihood (thesis 8.5).

    If the policies are clipped Gaussians, so is the model: they have probabilities at the bounds, which cannot be divided by a
    density.
    """

    revision: ClassVar[int] = 1

    hidden: Sizes = static((256, 256))  # width of each hidden layer
    lr: NonNegative = 3e-4  # learning rate of the model
    steps: Count = host(10_000)  # number of updates; cross-fitted models keep the parameters with the lowest validation loss
    batch_size: Count = static(256)  # batch size (transitions per update)
    clipped: bool = static(False)  # whether the Gaussian is clipped to the bounds; set by the case

    def needs(self, spec):
        """Observations and actions."""
        return BatchSpec(columns=("observation", "action"), batch_size=self.batch_size, standardise=True)

    def init(self, spec, key):
        """Network and optimiser."""
        make = models.Clipped.create if self.clipped else create_actor
        model = make(spec, self.hidden, key)
        return model, init_opt(model)

    def update(self, state, batch: Batch, *, step, key):
        """One step of maximum likelihood."""
        model, opt = state
        loss = models.censored if self.clipped else models.loss
        grads, metrics = jax.grad(loss, has_aux=True)(model, batch.observation, batch.action, key)
        model, opt = apply_gradients(model, grads, opt, self.lr)
        return (model, opt), metrics


# The default model of propensities in decisions: small, so that its fit is quick; early stopping prevents overfitting.
PROPENSITIES = BehaviorModel(hidden=(64, 64), lr=1e-3, steps=3_000)
