"""SAC-N (An et al. 2021): SAC on a fixed log with so many critics that their least holds it to what the log knows."""

from typing import ClassVar

from deadreckon.agents.sac import SAC
from deadreckon.training.hyperparameters import Count, Sizes, static


class SACN(SAC):
    """SAC with an ensemble of critics."""

    revision: ClassVar[int] = 1
    online: ClassVar[bool] = False

    critics: Count = static(10)
    """number of Q-networks, of which the minimum is used (published: halfcheetah 10, walker2d 20, hopper 500)"""
    hidden: Sizes = static((256, 256, 256))  # width of each hidden layer
