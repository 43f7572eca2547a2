"""Design from data alone: problems with oracles, and methods that propose designs."""

from deadreckon.mbo.designer import Designer, Proposals
from deadreckon.mbo.nemo import NEMO

__all__ = ["NEMO", "Designer", "Proposals"]
