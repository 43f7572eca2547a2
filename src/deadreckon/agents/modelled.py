"""What agents with a learned model share: an ensemble's settings, and how it is known in it when episodes end."""

from typing import Any, ClassVar

from jaxtyping import PRNGKeyArray

from deadreckon.agents.agent import Agent
from deadreckon.agents.sac import SAC
from deadreckon.data.spec import Spec
from deadreckon.dynamics import Ensemble, Gaussian, Trainer
from deadreckon.dynamics.ensemble import check_sizes
from deadreckon.dynamics.rollout import Ends
from deadreckon.errors import UserError
from deadreckon.tasks.registry import names, of_log, task
from deadreckon.training.learner import static

LEARNED = "learned"  # when episodes end is then the model's to say

# Table B.1 and the public code's target entropies. Of the two columns with G = 40 only HalfCheetah is sure in the
# thesis's scan; InvertedPendulum has 10 in the public code. `length` is k: first, last, from epoch, to epoch.
PRESETS: dict[str, dict[str, Any]] = {
    "inverted-pendulum": {"length": (1, 1, 1, 2), "target_entropy": -0.05, "updates_per_step": 10},
    "hopper": {"length": (1, 15, 20, 100), "target_entropy": -1.0},
    "halfcheetah": {"length": (1, 1, 1, 2), "target_entropy": -3.0, "updates_per_step": 40},
    "walker2d": {"length": (1, 1, 1, 2), "target_entropy": -3.0},
    "ant": {"length": (1, 25, 20, 100), "target_entropy": -4.0},
    "humanoid": {"length": (1, 25, 20, 300), "target_entropy": -2.0, "model_hidden": (400, 400, 400, 400), "keep": 5000},
}
_OTHERS = {"length": (1, 1, 1, 2), "keep": 1000, "model_hidden": (200, 200, 200, 200)}


class Modelled(Agent):
    """An agent with an ensemble. Fields that are None come from the task: see `PRESETS`."""

    members: int = static(7)  # networks of the model
    elites: int = static(5)  # of them are believed; as many as members: any, as the thesis prints it
    model_hidden: tuple[int, ...] | None = static(None)  # width of each hidden layer of the model; None: the task's, or 4 x 200
    model_lr: float = 1e-3  # learning rate of the model
    model_decay: tuple[float, ...] = static((2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4))  # of half the squared weights, layer by layer
    model_patience: int = static(5)  # epochs without a better network before a fit ends
    model_epochs: int = static(1000)  # of a fit, at most
    ends: str | None = static(None)  # task that tells when episodes end, or "learned"; None: this one, if observations tell

    def resolve(self, spec: Spec, steps: int):
        """Fills in what a task's preset has, and when episodes end."""
        known = _OTHERS | PRESETS.get(spec.name, {})
        missing = {name: value for name, value in known.items() if getattr(self, name, 0) is None}
        acted_in = task(spec.name) if spec.name in names() else None
        own = of_log(spec.name) if spec.rows else acted_in
        ends = self.ends or (LEARNED if own is None or own.ends is None else own.name)
        if ends != LEARNED and task(ends).ends is None:
            raise UserError(f"{ends}: its observations do not tell when an episode ends; ask for ends='{LEARNED}'")
        if ends != LEARNED and task(ends).observation_shape != spec.observation_shape:
            sizes = f"{task(ends).observation_shape}, {spec.name} has {spec.observation_shape}"
            raise UserError(f"ends={ends!r}: its observations are {sizes}")
        agent = super(Modelled, self.replace(**missing, ends=ends)).resolve(spec, steps)
        assert agent.model_hidden is not None
        check_sizes(type(self).__name__, agent.members, agent.elites, agent.model_hidden, agent.model_decay)
        return agent

    @property
    def model(self) -> Gaussian:
        """What the ensemble consists of."""
        assert self.model_hidden is not None  # resolved
        return Gaussian(
            self.members, self.model_hidden, self.model_lr, 0.0, layer_decay=self.model_decay, as_mbpo=True
        )

    @property
    def trainer(self) -> Trainer:
        """How it is fitted."""
        return Trainer(elites=self.elites, patience=self.model_patience, most_epochs=self.model_epochs)

    @property
    def over(self) -> Ends | None:
        """Tells of observations whether episodes end there; None leaves it to the model."""
        assert self.ends is not None  # resolved
        return None if self.ends == LEARNED else task(self.ends).ends

    def unfitted(self, spec: Spec, key: PRNGKeyArray) -> Ensemble:
        """Where the ensemble begins."""
        return Ensemble.unfitted(self.model, spec, self.elites, key)


class ModelledOnline(Modelled):
    """A modelled agent that learns by acting. Its state has the ensemble as `model`, which `collect.modelled` fits anew."""

    offline: ClassVar[bool] = False

    model_every: int = static(250)  # real steps between two fits of the model

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """How acting and learning take turns: see `collect.online.Online`."""
        updates = PRESETS.get(task, {}).get("updates_per_step", 20)
        return {"copies": 5, "explore": 5000, "updates_per_step": updates, "block": 25}

    def init(self, spec: Spec, key: PRNGKeyArray) -> Any:
        """The state of the agent that it is without a model, and the ensemble."""
        return super().init(spec, key)._replace(model=self.unfitted(spec, key))


class ModelledSAC(ModelledOnline, SAC):
    """SAC, online, with an ensemble in its state."""
