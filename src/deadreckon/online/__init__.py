"""Learning online: experience that agents make for themselves, in simulators and in learned models of these."""

from deadreckon.online.exploration import Exploration, Online
from deadreckon.online.rows import replay_log

__all__ = ["Exploration", "Online", "replay_log"]
