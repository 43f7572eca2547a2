"""Online training: on experience that agents collect in simulators, and in learned models of them."""

from deadreckon.online.exploration import Exploration
from deadreckon.online.rows import episodes_log, replay_log
from deadreckon.online.turns import Online

__all__ = ["Exploration", "Online", "episodes_log", "replay_log"]
