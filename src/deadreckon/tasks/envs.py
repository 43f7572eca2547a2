"""Importing this module gives Gymnasium the ids of our environments, such as `deadreckon/Maze2D-UMaze-v1`.

`gymnasium.make("deadreckon.tasks.envs:deadreckon/Maze2D-UMaze-v1")` imports it by itself. It stands apart from
`deadreckon.tasks` because importing Gymnasium costs every command 150 ms.
"""

from gymnasium.envs.registration import register, registry

from deadreckon.tasks import maze2d

for _task in maze2d.TASKS:
    if _task.gym_id not in registry:
        register(
            _task.gym_id,
            "deadreckon.tasks.maze2d_env:Maze2DEnv",
            max_episode_steps=_task.horizon,
            kwargs={"task": _task.name},
        )
