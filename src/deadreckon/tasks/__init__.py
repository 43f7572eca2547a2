"""Where policies are judged: simulators with horizons and reference scores.

`import deadreckon.tasks.envs` also gives Gymnasium the ids of our own environments (`deadreckon/Maze2D-UMaze-v1`, ...).
"""

from deadreckon.tasks.registry import names, register, task
from deadreckon.tasks.task import Reference, Simulator, Task

__all__ = ["Reference", "Simulator", "Task", "names", "register", "task"]
