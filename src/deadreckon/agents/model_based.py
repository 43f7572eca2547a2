"""What model-based agents share: the settings of the ensemble, and the rule that ends episodes in the model."""

from typing import Any, ClassVar, Literal

from jaxtyping import PRNGKeyArray

from deadreckon.agents.agent import Agent
from deadreckon.agents.sac import SAC
from deadreckon.data import terminations
from deadreckon.data.spec import Spec
from deadreckon.data.terminations import LEARNED
from deadreckon.dynamics import Ensemble, Gaussian, Trainer
from deadreckon.dynamics.ensemble import check_sizes
from deadreckon.dynamics.rollout import Ends
from deadreckon.errors import UserError
from deadreckon.randomness import key_for
from deadreckon.training.hyperparameters import Count, NonNegative, Number, Sizes, Weights, static
from deadreckon.training.later_fields import later

# Table B.1 and the public code's target entropies. Of the two columns with G = 40 only HalfCheetah is sure in the
# thesis's scan; InvertedPendulum has 10 in the public code. `rollout_length` is k: first, last, from epoch, to epoch.
PRESETS: dict[str, dict[str, Any]] = {
    "inverted-pendulum": {"rollout_length": (1, 1, 1, 2), "target_entropy": -0.05, "updates_per_step": 10},
    "hopper": {"rollout_length": (1, 15, 20, 100), "target_entropy": -1.0},
    "halfcheetah": {"rollout_length": (1, 1, 1, 2), "target_entropy": -3.0, "updates_per_step": 40},
    "walker2d": {"rollout_length": (1, 1, 1, 2), "target_entropy": -3.0},
    "ant": {"rollout_length": (1, 25, 20, 100), "target_entropy": -4.0},
    "humanoid": {
        "rollout_length": (1, 25, 20, 300), "target_entropy": -2.0, "model_hidden": (400, 400, 400, 400), "retain_steps": 5000,
    },
}
_OTHERS = {"rollout_length": (1, 1, 1, 2), "retain_steps": 1000, "model_hidden": (200, 200, 200, 200)}


class ModelBasedAgent(Agent):
    """An agent with an ensemble of dynamics models. Fields that are None come from the task that is acted in: see `PRESETS`."""

    revision: ClassVar[int] = 1
    fine_tunes: ClassVar[bool] = False
    supports_history: ClassVar[bool] = False
    own_history: ClassVar[str] = "its model predicts single observations, by which episodes end"
    other_names: ClassVar[dict[str, str]] = {"model_decay": "model_weight_decay", "ends": "termination"}

    members: Count = static(7)  # number of networks in the ensemble
    elites: Count = static(5)
    """number of networks that predict, those with the lowest validation loss; all members as the thesis prints it"""
    model_hidden: Sizes | None = static(None)
    """width of each hidden layer of the model; None: the task's, or four layers of 200"""
    model_lr: NonNegative = 1e-3  # learning rate of the model
    model_weight_decay: Weights = static((2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4))
    """weight decay of each layer of the model (L2 penalty, halved)"""
    model_patience: Count = static(5)  # epochs in a row without improvement that a fit of the model goes on after
    model_epochs: Count = static(1000)  # largest number of epochs of a fit of the model
    model_first_weights: Literal["uniform", "truncated_normal"] = later("uniform")
    """initial weights of the model: uniform in +-1/sqrt(inputs), or truncated normal with deviation 1/(2 sqrt(inputs))"""
    termination: str | None = static(None)
    """task whose rule ends episodes in the model, or "learned"; None: this task's, if observations show it"""

    def resolve(self, spec: Spec, steps: int):
        """Fills in the task's preset and the rule that ends episodes."""
        known = _OTHERS | ({} if spec.rows else PRESETS.get(spec.name, {}))  # a log of this name need not be the task's
        missing = {name: value for name, value in known.items() if getattr(self, name, 0) is None}
        own = terminations.of_spec(spec)
        ends = self.termination or (LEARNED if own is None else own.name)
        if ends != LEARNED and (shape := terminations.termination(ends).observation_shape) != spec.observation_shape:
            raise UserError(f"termination={ends!r}: its observations are {shape}, {spec.name} has {spec.observation_shape}")
        if ends != LEARNED and getattr(self, "standardise", False):
            why = f"the rule that ends episodes of {ends} reads observations as they are"
            learned = f", or let the model learn ends, {LEARNED!r}" if spec.rows else ""  # online nothing is standardised
            raise UserError(f"{type(self).__name__}.standardise: {why}; leave it out{learned}")
        agent = super(ModelBasedAgent, self.replace(**missing, termination=ends)).resolve(spec, steps)
        assert agent.model_hidden is not None
        check_sizes(type(self).__name__, agent.members, agent.elites, agent.model_hidden, agent.model_weight_decay)
        return agent

    @property
    def model(self) -> Gaussian:
        """The networks of the ensemble."""
        assert self.model_hidden is not None  # resolved
        return Gaussian(
            self.members, self.model_hidden, self.model_lr, 0.0, layer_decay=self.model_weight_decay, as_mbpo=True,
            first_weights=self.model_first_weights,
        )  # fmt: skip

    @property
    def trainer(self) -> Trainer:
        """How the ensemble is fitted."""
        return Trainer(elites=self.elites, patience=self.model_patience, most_epochs=self.model_epochs)

    @property
    def over(self) -> Ends | None:
        """Whether episodes end at given observations; None: the model predicts it."""
        assert self.termination is not None  # resolved
        return None if self.termination == LEARNED else terminations.termination(self.termination).ends

    def unfitted(self, spec: Spec, key: PRNGKeyArray) -> Ensemble:
        """The ensemble with initial parameters."""
        return Ensemble.unfitted(self.model, spec, self.elites, key)


class OnlineModelBasedAgent(ModelBasedAgent):
    """A model-based agent that learns online. `online.model_learning` refits the ensemble in its state (`model`)."""

    revision: ClassVar[int] = 1
    offline: ClassVar[bool] = False
    other_names: ClassVar[dict[str, str]] = {"model_every": "model_train_freq"}

    model_train_freq: Count = static(250)  # environment steps between two fits of the model

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """How acting and learning take turns: see `online.exploration.Online`."""
        updates = PRESETS.get(task, {}).get("updates_per_step", 20)
        return {"copies": 5, "explore": 5000, "updates_per_step": updates, "block": 25}

    def init(self, spec: Spec, key: PRNGKeyArray) -> Any:
        """The state of the underlying model-free agent, and the ensemble."""
        return super().init(spec, key)._replace(model=self.unfitted(spec, key_for(key, "model")))


class ModelBasedSAC(OnlineModelBasedAgent, SAC):
    """Online SAC with an ensemble in its state."""

    revision: ClassVar[int] = 1
    supports_discrete: ClassVar[bool] = False

    target_entropy: Number | None = None  # target entropy in nats; None: the task's (Table B.1), or minus the action dimensions
