"""Model-based policy optimisation (thesis chapter 5, Algorithm 3): SAC on short rollouts in a learned model.

The updates are SAC's. What they learn from is made by `online.branched_rollouts`: an ensemble is fitted to all real steps so
far, and rollouts of a few steps branch off from real states.
"""

from typing import Annotated, ClassVar

from deadreckon.agents.model_based import ModelBasedSAC
from deadreckon.errors import UserError
from deadreckon.training.hyperparameters import Count, Range, UnitInterval, static


class MBPO(ModelBasedSAC):
    """SAC on branched rollouts of an ensemble."""

    revision: ClassVar[int] = 1
    other_names: ClassVar[dict[str, str]] = {
        "length": "rollout_length", "rollouts": "rollouts_per_step", "keep": "retain_steps", "most": "model_buffer_size",
        "real": "real_ratio",
    }  # fmt: skip

    rollout_length: Annotated[tuple[int, ...], Range(ge=0)] | None = static(None)
    """steps of a rollout, as first, last, from epoch, to epoch; None: those of the task"""
    rollouts_per_step: Count = static(400)  # model rollouts per environment step
    retain_steps: Count | None = static(None)
    """environment steps for which model rollouts are kept; None: those of the task, or 1,000"""
    model_buffer_size: Count = static(2_000_000)  # largest number of model transitions kept; longer rollouts are subsampled
    real_ratio: UnitInterval = static(0.05)  # share of real transitions in a batch; 0 as Algorithm 3 is printed

    def resolve(self, spec, steps):
        """Checks the lengths of rollouts."""
        agent = super().resolve(spec, steps)
        assert agent.rollout_length is not None
        first, last, *epochs = agent.rollout_length if len(agent.rollout_length) == 4 else (1, 0)
        if not 1 <= first <= last or not 0 <= epochs[0] < epochs[1]:
            what = "first, last >= first, from epoch, to a later epoch"
            raise UserError(f"MBPO.rollout_length takes {what}, got {agent.rollout_length}")
        if not 0.0 <= agent.real_ratio < 1.0:
            raise UserError(f"MBPO.real_ratio must be in [0, 1), got {agent.real_ratio:g}")
        return agent

    def rollout_length_at(self, epoch: int) -> int:
        """k in an epoch, which is 1,000 real steps after the random ones: min(max(x + (e - a) / (b - a) (y - x), x), y)."""
        assert self.rollout_length is not None  # resolved
        first, last, start, end = self.rollout_length
        return int(min(max(first + (epoch - start) / (end - start) * (last - first), first), last))
