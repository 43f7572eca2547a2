"""Model-based estimates: the returns of episodes simulated in a learned model (Paduraru 2007; thesis 8.5).

MB-FF draws from feed-forward Gaussians, MB-AR from auto-regressive ones (`dynamics/`). Every member of the ensemble is trained
on a bootstrap sample of the episodes and simulates its own episodes. Observations and rewards stay within the log's range.
"""

from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.batch import TransitionSource
from deadreckon.dynamics import AutoRegressive, Gaussian, Model
from deadreckon.dynamics.model import Limits
from deadreckon.errors import UserError
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.case import OPEInput
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.randomness import generator, key_for
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, Sizes, static

KINDS: dict[str, type[Model]] = {"feedforward": Gaussian, "autoregressive": AutoRegressive}
TAIL = 0.01  # share of the discounted time that is left when a simulated episode is cut off, if not before


class ModelBased(Estimator):
    """Model-based estimator: mean returns of simulated episodes."""

    revision: ClassVar[int] = 1

    kind: Literal["feedforward", "autoregressive"] = static("feedforward")
    """kind of model: feed-forward (MB-FF) or auto-regressive (MB-AR)"""
    members: Count = static(3)  # number of networks, each fitted on a bootstrap resample of the episodes
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    steps: Count = static(50_000)  # updates of the models
    batch_size: Count = static(256)  # batch size (transitions per update)
    lr: NonNegative = 3e-4  # learning rate of the models
    weight_decay: NonNegative = 1e-5  # weight decay of AdamW
    episodes: Count = static(100)  # simulated episodes per network and policy, from initial observations of the log
    horizon: CountOrZero | None = static(None)
    """steps of an episode; None: until 1 % of the discount is left, or the longest where all end"""
    model: BehaviorModel = static(BehaviorModel())  # model of the behaviour policy, where it is estimated too

    def fitted(self, case: OPEInput) -> tuple[Model, Any, TransitionSource]:
        """The model, its parameters with the unit of its rewards, and the rows; fitted once per case."""
        return case.once(self.replace(episodes=1, horizon=None, model=None), lambda: self._fit(case))

    def _fit(self, case: OPEInput) -> tuple[Model, Any, TransitionSource]:
        model = KINDS[self.kind](self.members, self.hidden, self.lr, self.weight_decay, self.batch_size)
        extra = {"weight": case.redrawn(self.members)[case.data.episode_of]}
        rows = TransitionSource(case.data, model.needs(case.data.spec), extra)
        params, _, unit = case.train(model, rows, self.steps, f"model-{self.kind}")
        return model, (params, float(unit)), rows

    @property
    def label(self) -> str:
        """Its name in tables."""
        return {"feedforward": "MB-FF", "autoregressive": "MB-AR"}[self.kind]

    def solve(self, case: OPEInput) -> Estimates:
        """Simulates episodes and averages their returns."""
        model, (params, unit), rows = self.fitted(case)
        data, members, count = case.data, self.members, self.episodes
        if self.horizon == 0:
            raise UserError("horizon must be 1 or more, or None")
        limits = Limits.of(data.spec)
        horizon = self.horizon or int(np.ceil(np.log(TAIL) / np.log(max(case.discount, 1e-6))))
        if self.horizon is None and np.asarray(data.terminals)[data.ends].all():
            horizon = min(horizon, int(data.lengths.max()))
        # If no episode of the log ends, none does here: small learned probabilities of an end would add up over many steps.
        endings = jnp.float32(np.asarray(data.terminals).any())
        redrawn = case.redrawn(members)
        rng = generator(case.seed, "first observations")
        # Every policy begins at the same observations, drawn from the member's bootstrap sample of episodes.
        starts = np.stack([rng.choice(data.episodes, count, p=own / own.sum()) for own in redrawn.T.astype(float)])
        first = np.asarray(rows.view.observe(np.asarray(data.observations[data.starts[starts]])))
        returns = np.zeros((members, case.count))
        # Logged returns are not comparable where episodes were cut off, so the behaviour policy is simulated like the others.
        for i in range(case.count):
            actor, which = (case.actor, i) if i < len(case.policies) else (case.behavior(self.model), 0)
            observation, alive = jnp.asarray(first), jnp.ones((members, count))
            total = jnp.zeros((members, count))
            for t in range(horizon):
                seen = np.asarray(observation).reshape(members * count, -1)
                raw = seen * rows.view.std + rows.view.mean
                action = actor.act(which, raw, t).reshape(members, count, *data.actions.shape[1:])
                # The same draws for every policy, so that common errors cancel in differences between them.
                key = key_for(jax.random.key(case.seed), "model", t)
                factor = jnp.float32(case.discount**t)
                observation, alive, total = _step(
                    model, params, limits, observation, action, alive, total, factor, endings, key
                )
            returns[:, i] = unit * np.asarray(total.mean(1))
        return Estimates.of_members(self.label, case, returns)


@eqx.filter_jit
def _step(model: Model, params: Any, limits: Limits, observation, action, alive, total, factor, endings, key):
    """One step of all episodes: their observations, probabilities of not having ended, and discounted returns so far."""
    change = limits.hold(model.draw(params, observation, action, key))
    # Ends are not sampled: later rewards are weighted by the probability that they are reached.
    total = total + factor * alive * change.reward
    return change.observation, alive * (1.0 - endings * change.ends), total
