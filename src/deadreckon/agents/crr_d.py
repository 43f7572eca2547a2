"""CRR with a critic of return distributions (Wang et al. 2020), in the settings of RL Unplugged (Gulcehre et al. 2020).

The critic is D4PG's, its target that of actions drawn from a copy of the policy. The policy imitates logged actions, weighted
by how much better than its own draws their expected returns are.
"""

from typing import Any, ClassVar

from deadreckon.agents.agent import imitation_loss
from deadreckon.agents.crr import Filter, filtered
from deadreckon.agents.d4pg import D4PG, logits
from deadreckon.nets.return_distributions import mean
from deadreckon.policies.kinds import Likelihood, create_imitator, stochastic
from deadreckon.training.hyperparameters import Count, Number, Positive, Sizes, TwoOrMore, static


class CRRD(D4PG):
    """A stochastic actor that imitates by advantage, and a critic of return distributions."""

    revision: ClassVar[int] = 1
    online: ClassVar[bool] = False
    other_names: ClassVar[dict[str, str]] = D4PG.other_names | {"beta": "temperature", "ratio_upper_bound": "max_weight"}

    n_step: Count = static(1)  # rewards of the log summed before the value that follows
    v_min: Number = 0.0  # smallest return that has a probability
    v_max: Number = 100.0  # largest return that has a probability
    atoms: TwoOrMore = static(21)  # number of returns that have a probability
    temperature: Positive = 1.0  # temperature that divides the advantage, with filter="exp" (beta in the paper)
    samples: Count = static(4)  # actions sampled from the policy to estimate its value
    max_weight: Positive = 20.0  # largest weight of a transition in the loss of the actor, with filter="exp"
    filter: Filter = static("exp")
    """weight of an action: 1 where its advantage is positive (binary), or exp(advantage)"""
    likelihood: Likelihood = static("normal")
    """likelihood of logged actions: normal around tanh of a network, or tanh-normal"""
    hidden: Sizes = static((256, 256))  # width of each hidden layer of the actor

    def create_actor(self, spec, key):
        """A fresh stochastic policy."""
        return create_imitator(spec, self.hidden, key, self.likelihood)

    def actions(self, actor, observation, key):
        """What targets value: draws of the policy."""
        return stochastic(actor).actions(observation, key, greedy=False)

    def actor_loss(self, actor, critic, batch, key):
        """-E[w log pi(a|s)], w by the advantage E Z(s, a) - mean_i E Z(s, a_i) with a_i of the policy."""
        drawn = stochastic(actor).actions(batch.observation, key, greedy=False, count=(self.samples,))
        own = mean(logits(critic, batch.observation, drawn), self.support).mean(0)
        advantage = mean(logits(critic, batch.observation, batch.action), self.support) - own
        return imitation_loss(actor, batch, filtered(advantage, self.filter, self.temperature, self.max_weight))

    def policy(self, state) -> Any:
        """The actor; greedy is its mean."""
        return stochastic(state.actor)
