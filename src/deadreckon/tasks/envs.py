"""Importing this module gives Gymnasium the ids of our environments, such as `deadreckon/Maze2D-UMaze-v1`.

`gymnasium.make("deadreckon.tasks.envs:deadreckon/Maze2D-UMaze-v1")` imports it by itself. It stands apart from
`deadreckon.tasks` because importing Gymnasium costs every command 150 ms. Of the Gym-MuJoCo tasks, Ant and Humanoid have
environments of ours, `deadreckon/Ant-v5` and `deadreckon/Humanoid-v5`; the others are Gymnasium's own. Those of Adroit and
the kitchen, such as `deadreckon/AdroitDoor-v1`, of AntMaze, of driving, of dm_control and of the battery are the tasks'
simulators: gymnasium-robotics' have other rewards, bodies and ends.
"""

from gymnasium.envs.registration import register
from gymnasium.envs.registration import registry as registered

from deadreckon.tasks import adroit, antmaze, battery, control, driving, flow, kitchen, maze2d, registry, town

for _tasks, _env in ((maze2d.TASKS, "maze2d_env:Maze2DEnv"), (flow.TASKS, "flow_env:FlowEnv")):
    for _task in _tasks:
        if _task.gym_id not in registered:
            where = f"deadreckon.tasks.{_env}"
            register(_task.gym_id, where, max_episode_steps=_task.horizon, kwargs={"task": _task.name})

for _name, _env in (("ant", "PaddedAntEnv"), ("humanoid", "PaddedHumanoidEnv")):
    _task = registry.task(_name)
    if _task.gym_id not in registered:
        register(_task.gym_id, f"deadreckon.tasks.gym_env:{_env}", max_episode_steps=_task.horizon)

_DRIVING = *driving.TASKS, *town.TASKS
for _task in (*adroit.TASKS, *kitchen.TASKS, *antmaze.TASKS, antmaze.REACH_TASK, *_DRIVING, *control.TASKS, battery.TASK):
    if _task.gym_id not in registered:
        where = "deadreckon.tasks.simulator_env:SimulatorEnv"
        register(_task.gym_id, where, max_episode_steps=_task.horizon, kwargs={"task": _task.name})
