"""Model-based policy optimisation (thesis chapter 5, Algorithm 3): SAC on short rollouts in a learned model.

The updates are SAC's. What they learn from is made by `collect.imagined`: an ensemble is fitted to all real steps so far, and
rollouts of a few steps branch off from real states.
"""

from typing import Any, ClassVar, Literal

from deadreckon.agents.sac import SAC
from deadreckon.dynamics.ensemble import check_sizes
from deadreckon.errors import UserError
from deadreckon.training.learner import static

# Table B.1 and the public code's target entropies. Of the two columns with G = 40 only HalfCheetah is sure (ERRATA of the
# thesis's scan); InvertedPendulum has 10 in the public code. `length` is k: first, last, from epoch, to epoch.
PRESETS: dict[str, dict[str, Any]] = {
    "inverted-pendulum": {"length": (1, 1, 1, 2), "target_entropy": -0.05, "updates_per_step": 10},
    "hopper": {"length": (1, 15, 20, 100), "target_entropy": -1.0},
    "halfcheetah": {"length": (1, 1, 1, 2), "target_entropy": -3.0, "updates_per_step": 40},
    "walker2d": {"length": (1, 1, 1, 2), "target_entropy": -3.0},
    "ant": {"length": (1, 25, 20, 100), "target_entropy": -4.0},
    "humanoid": {"length": (1, 25, 20, 300), "target_entropy": -2.0, "model_hidden": (400, 400, 400, 400), "keep": 5000},
}


class MBPO(SAC):
    """SAC on branched rollouts of an ensemble."""

    offline: ClassVar[bool] = False

    length: tuple[int, ...] | None = static(None)  # steps of a rollout: first, last, from epoch, to epoch; None: the task's
    rollouts: int = static(400)  # begun for each real step
    model_every: int = static(250)  # real steps between two fits of the model, each followed by rollouts
    keep: int | None = static(None)  # real steps for which what was made up is learned from; None: the task's, or 1,000
    real: float = static(0.05)  # share of real steps among those learned from; 0 as Algorithm 3 is printed
    members: int = static(7)  # networks of the model
    elites: int = static(5)  # of them are believed; as many as members: any, as printed
    model_hidden: tuple[int, ...] | None = static(None)  # width of each hidden layer of the model; None: the task's, or 4 x 200
    model_lr: float = static(1e-3)  # learning rate of the model
    model_decay: tuple[float, ...] = static((2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4))  # of half the squared weights, layer by layer
    model_patience: int = static(5)  # epochs without a better network before a fit ends
    model_epochs: int = static(1000)  # of a fit, at most
    ends: Literal["known", "learned"] = static("known")  # whether the model is told when episodes end, or learns it

    def resolve(self, spec, steps):
        """Fills in what a task's preset has, also where SAC would."""
        known = {"length": (1, 1, 1, 2), "keep": 1000, "model_hidden": (200, 200, 200, 200)} | PRESETS.get(spec.name, {})
        missing = {name: known[name] for name in ("length", "keep", "model_hidden", "target_entropy")
                   if getattr(self, name) is None and name in known}  # fmt: skip
        agent = super(MBPO, self.replace(**missing)).resolve(spec, steps)
        assert agent.length is not None
        assert agent.model_hidden is not None
        if len(agent.length) != 4 or agent.length[2] >= agent.length[3]:
            raise UserError(f"MBPO.length takes first, last, from epoch, to a later epoch, got {agent.length}")
        check_sizes("MBPO", self.members, self.elites, agent.model_hidden, self.model_decay)
        return agent

    def rollout_length(self, epoch: float) -> int:
        """k in an epoch, which is 1,000 real steps after the random ones: min(max(x + (e - a) / (b - a) (y - x), x), y)."""
        assert self.length is not None
        first, last, start, end = self.length
        return int(min(max(first + (epoch - start) / (end - start) * (last - first), first), last))

    @classmethod
    def acting(cls, task: str) -> dict[str, Any]:
        """How acting and learning take turns: see `collect.online.Online`."""
        updates = PRESETS.get(task, {}).get("updates_per_step", 20)
        return {"copies": 5, "explore": 5000, "updates_per_step": updates, "block": 25}
