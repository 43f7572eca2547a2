"""SLBO (Luo et al. 2019): a policy that improves on whole episodes made up by a model, from initial states (thesis 5.4).

By turns a model is fitted to all real steps and the policy is trained on its own rollouts in the model, long ones that begin
where real episodes do: Algorithm 2 there, with PPO in the place of TRPO and the model's squared errors of one step in the place
of a norm over two. `online.model_rollouts` makes the episodes.
"""

import dataclasses
from typing import Any, ClassVar

from deadreckon.agents.model_based import OnlineModelBasedAgent
from deadreckon.agents.ppo import PPO
from deadreckon.dynamics import Gaussian
from deadreckon.training.hyperparameters import Count, NonNegative, Sizes, Weights, static


class SLBO(OnlineModelBasedAgent, PPO):
    """PPO on episodes in a deterministic model."""

    revision: ClassVar[int] = 1
    online: ClassVar[bool] = True
    offline: ClassVar[bool] = False
    other_names: ClassVar[dict[str, str]] = {"length": "rollout_length"}

    members: Count = static(1)  # number of networks in the ensemble
    elites: Count = static(1)  # number of networks that predict
    model_hidden: Sizes | None = static((500, 500))  # width of each hidden layer of the model
    model_weight_decay: Weights = static((1e-5, 1e-5, 1e-5))  # weight decay of each layer of the model (L2 penalty, halved)
    hidden: Sizes = static((32, 32))  # width of each hidden layer (tanh)
    entropy_weight: NonNegative = 0.005  # weight of the entropy bonus
    rollouts: Count = static(4)  # model rollouts side by side, per block of updates (whose number stays as it is)
    rollout_length: Count = static(1000)  # steps of a model rollout; where an episode ends the next one begins

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """25 real steps, then ten passes over 4,000 made-up ones in batches of 64."""
        return {"copies": 5, "explore": 5000, "updates_per_step": 25, "block": 25}

    @property
    def model(self) -> Gaussian:
        """One network that says what follows, without chance."""
        return dataclasses.replace(super().model, deterministic=True)
