"""Model-based policy optimisation (thesis chapter 5, Algorithm 3): SAC on short rollouts in a learned model.

The updates are SAC's. What they learn from is made by `online.branched_rollouts`: an ensemble is fitted to all real steps so
far, and rollouts of a few steps branch off from real states.
"""

from deadreckon.agents.modelled import ModelledSAC
from deadreckon.errors import UserError
from deadreckon.training.hyperparameters import Count, Share, Sizes, static


class MBPO(ModelledSAC):
    """SAC on branched rollouts of an ensemble."""

    length: Sizes | None = static(None)  # steps of a rollout: first, last, from epoch, to epoch; None: the task's
    rollouts: Count = static(400)  # begun for each real step, whenever the model was fitted
    keep: Count | None = static(None)  # real steps for which what was made up is learned from; None: the task's, or 1,000
    most: Count = static(2_000_000)  # made-up rows that are learned from; of longer rollouts each fit's are drawn to its share
    real: Share = static(0.05)  # share of real steps among those learned from; 0 as Algorithm 3 is printed

    def resolve(self, spec, steps):
        """Checks the lengths."""
        agent = super().resolve(spec, steps)
        assert agent.length is not None
        first, last, *epochs = agent.length if len(agent.length) == 4 else (1, 0)
        if not 1 <= first <= last or not 0 <= epochs[0] < epochs[1]:
            raise UserError(f"MBPO.length takes first, last >= first, from epoch, to a later epoch, got {agent.length}")
        if not 0.0 <= agent.real < 1.0:
            raise UserError(f"MBPO.real must be 0 .. 1 without 1, got {agent.real:g}")
        return agent

    def rollout_length(self, epoch: int) -> int:
        """k in an epoch, which is 1,000 real steps after the random ones: min(max(x + (e - a) / (b - a) (y - x), x), y)."""
        assert self.length is not None  # resolved
        first, last, start, end = self.length
        return int(min(max(first + (epoch - start) / (end - start) * (last - first), first), last))
