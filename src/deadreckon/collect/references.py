"""Measures the returns that mean 0 and 100 on the normalised scale (thesis 7.3).

`python -m deadreckon.collect.references` prints the numbers that `tasks/maze2d.py`, `driving.py`, `town.py` and, where SUMO is
installed, `flow.py` hold, and what uniform actions earn in the Gym-MuJoCo tasks, of which Humanoid's is used, and, where
dm_control is installed, in its tasks (`control.py`).
"""

import importlib.util
from collections.abc import Sequence

import numpy as np

from deadreckon.collect.driving import pursue
from deadreckon.collect.flow import Controller, FollowerStopper, PISaturation
from deadreckon.collect.maze2d import to_the_goal
from deadreckon.collect.town import drive
from deadreckon.data.spec import Box
from deadreckon.tasks import control, driving, flow, gym_mujoco, town
from deadreckon.tasks.driving import LaneDriving
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.flow_merge import Merge
from deadreckon.tasks.maze2d import TASKS, Maze2D
from deadreckon.tasks.task import Task
from deadreckon.tasks.town import TownDriving

EPISODES = 100  # of uniform actions (thesis 7.3), and of a controller
GOING = 1000  # episodes of Maze2D's controller


def measure(task: Maze2D | LaneDriving | TownDriving | Flow) -> tuple[float, float]:
    """Mean returns of uniform random actions, and of a controller in episodes with the same starts.

    In a maze that is the controller of the logs going to the task's goal and staying there; along a lane and in a town that of
    the logs without noise. In Flow it is PI with saturation on the ring, whose length it need not know, and past the on-ramp
    FollowerStopper at the speed that the reward asks for (Stern et al. 2018).
    """
    # Sparse and dense variants of a maze see the same episodes.
    starts, actions, jitter = np.random.SeedSequence(0).spawn(3)
    seeds = [int(s) for s in starts.generate_state(GOING, np.uint64)]
    random = uniform_return(task, seeds[:EPISODES], np.random.default_rng(actions))
    if isinstance(task, Maze2D):
        ways = to_the_goal(task, seeds, np.random.default_rng(jitter))
        return random, sum(float(way.rewards.mean(dtype=np.float64)) for way in ways)
    if isinstance(task, Flow):
        controller = PISaturation(task) if task.road == "ring" else FollowerStopper(task, Merge.TARGET)
    else:
        controller = drive if isinstance(task, TownDriving) else pursue
    return random, float(controlled_returns(task, controller, seeds[:EPISODES]).mean())


def controlled_returns(task: Task, controller: Controller, seeds: Sequence[int]) -> np.ndarray:
    """(episodes,) returns of one episode of a controller from each seed."""
    simulator = task.simulate(seeds)
    seen, returns = simulator.reset(), np.zeros(len(seeds))
    for _ in range(task.horizon):
        seen, rewards, _, _ = simulator.step(controller(seen))
        returns += rewards
    return returns


def uniform_return(task: Task, seeds: Sequence[int], generator: np.random.Generator) -> float:
    """Mean return of one episode of uniform actions from each seed; the generator draws them."""
    assert isinstance(task.action_space, Box)
    space, episodes = task.action_space, len(seeds)
    simulator = task.simulate(seeds)
    simulator.reset()
    returns, alive = np.zeros(episodes), np.ones(episodes, bool)
    while alive.any():
        _, rewards, terminals, timeouts = simulator.step(generator.uniform(space.low, space.high, (episodes, space.size)))
        returns += np.where(alive, rewards, 0.0)
        alive &= ~(terminals | timeouts)
    return float(returns.mean())


def main() -> None:
    """Prints the measured table."""
    sumo = flow.TASKS if importlib.util.find_spec("libsumo") is not None else ()
    for task in (*TASKS, driving.TASK, town.TASK, *sumo):
        random, expert = measure(task)
        print(f'    "{task.name}": ({random:.4f}, {expert:.4f}),')
    for task in gym_mujoco.TASKS:
        print(f"{task.name}, uniform actions: {uniform_return(task, range(1000), np.random.default_rng(0)):.4f}")
    for task in control.TASKS if importlib.util.find_spec("dm_control") is not None else ():
        print(f'    "{task.name}": {uniform_return(task, range(100), np.random.default_rng(0)):.4f},')


if __name__ == "__main__":
    main()
