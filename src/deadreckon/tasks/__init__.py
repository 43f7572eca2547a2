"""Where policies are judged: simulators with horizons and reference scores.

Importing this package also gives Gymnasium the ids of our own environments (`deadreckon/Maze2D-UMaze-v1`, ...).
"""

from deadreckon.tasks.registry import names, register, register_envs, register_envs_lazily, task
from deadreckon.tasks.task import Reference, Simulator, Task

__all__ = ["Reference", "Simulator", "Task", "names", "register", "register_envs", "task"]

register_envs_lazily()
