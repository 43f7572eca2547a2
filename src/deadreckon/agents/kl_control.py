"""KL-control (Jaques et al. 2019; thesis 4.4): SAC with the log's policy in place of the uniform one.

A model of the log's policy is fitted first and stays. Where SAC has entropy, this has the divergence from that model: targets
and actor pay temperature (log pi(a|s) - log model(a|s)), and the temperature is such that the divergence is `target_kl` on
average.
"""

from typing import Any, ClassVar, Literal

import jax.numpy as jnp

from deadreckon.agents.bc import cloned
from deadreckon.agents.sac import SAC
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.optim import copy
from deadreckon.policies.kinds import Gaussian, Likelihood, TanhMeanGaussian, create_imitator
from deadreckon.randomness import key_for
from deadreckon.training.hyperparameters import Count, NonNegative, static


class KLControl(SAC):
    """SAC that pays for its divergence from the log's policy."""

    revision: ClassVar[int] = 2
    supports_discrete: ClassVar[bool] = False
    online: ClassVar[bool] = False
    fine_tunes: ClassVar[bool] = False

    target_kl: NonNegative = 1.0  # target KL divergence of the policy from the behaviour model, in nats
    behavior_lr: NonNegative = 3e-4  # learning rate of the behaviour model
    likelihood: Literal["truncated_normal", "tanh_normal"] = static("truncated_normal")
    """likelihood of the behaviour model: normal around tanh of a network, truncated to the bounds of actions, or tanh-normal"""
    behavior_steps: Count = static(100_000)  # updates of the behaviour model before all others

    def resolve(self, spec, steps):
        """There is no entropy to hold."""
        if self.target_entropy not in (None, 0.0):
            raise UserError("KLControl holds a divergence, not an entropy: set target_kl and leave out target_entropy")
        return super().resolve(spec, steps).replace(target_entropy=0.0)

    @property
    def imitation(self) -> Likelihood:
        """The likelihood by which the model is fitted: it is truncated when it is compared with the actor."""
        return "tanh_normal" if self.likelihood == "tanh_normal" else "normal"

    @property
    def entropy_target(self):
        """Minus the divergence is in the place of the entropy."""
        return -self.target_kl

    def init(self, spec, key) -> Any:
        """SAC's state with a model of the log's policy, as yet unfitted."""
        model = create_imitator(spec, self.hidden, key_for(key, "model"), self.imitation)
        return super().init(spec, key)._replace(model=model)

    def prepare(self, state, rows, key, fit):
        """Fits the model, by maximum likelihood; the actor begins as it."""
        model = cloned(self, fit, key, self.imitation)
        # The actor is before a tanh; where the model is not, it begins with the model's deviations there.
        actor = Gaussian.of(model.net, model.log_std).net if isinstance(model, TanhMeanGaussian) else model
        return state._replace(model=model, actor=copy(actor))

    def entropy_cost(self, state, d, pre, observation):
        """log pi(a|s) - log model(a|s): one draw's estimate of the KL divergence, (b,)."""
        own = super().entropy_cost(state, d, pre, observation)
        if isinstance(state.model, TanhMeanGaussian):
            # Not truncated, its mass beyond the bounds would count as a divergence that no policy can avoid.
            return own - state.model.log_truncated(observation, jnp.tanh(pre))
        return own - dist.log_prob(dist.gaussian_head(state.model(observation)), pre)

    def update(self, state, batch, *, step, key):
        """SAC's, whose entropy is minus the divergence."""
        state, metrics = super().update(state, batch, step=step, key=key)
        return state, metrics | {"divergence": -metrics.pop("entropy")}
