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
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.flow_merge import Merge
from deadreckon.tasks.maze2d import TASKS, Maze2D
from deadreckon.tasks.task import Reference, Task


def measure(task: Maze2D, *, episodes: int = 100, expert_episodes: int = 1000, seed: int = 0) -> Reference:
    """Mean returns of uniform random actions, and of the logs' controller going to the task's goal and staying there.

    Args:
        task: a Maze2D task.
        episodes: of uniform random actions; the thesis takes 100.
        expert_episodes: of the controller.
        seed: of the starts, the actions and the waypoints' jitter.
    """
    # Sparse and dense variants see the same episodes.
    starts, actions, jitter = np.random.SeedSequence(seed).spawn(3)
    seeds = [int(s) for s in starts.generate_state(max(episodes, expert_episodes), np.uint64)]

    random = uniform_return(task, seeds[:episodes], np.random.default_rng(actions))
    ways = to_the_goal(task, seeds[:expert_episodes], np.random.default_rng(jitter))
    expert = sum(float(way.rewards.mean(dtype=np.float64)) for way in ways)
    source = f"measured on this simulator: {episodes} episodes of uniform actions, {expert_episodes} of the waypoint planner"
    return Reference(random, expert, source)


def measure_flow(task: Flow, *, episodes: int = 100, seed: int = 0) -> Reference:
    """Mean returns of uniform random actions, and of a controller that calms traffic.

    That is PI with saturation on the ring, whose length it need not know, and past the on-ramp FollowerStopper at the speed
    that the reward asks for (Stern et al. 2018).

    Args:
        task: a Flow task.
        episodes: of each.
        seed: of the starts and actions.
    """
    calm = PISaturation(task) if task.road == "ring" else FollowerStopper(task, Merge.TARGET)
    return _between(task, calm, episodes, seed)


def measure_driving(task: Task, controller: Controller = pursue, *, episodes: int = 100, seed: int = 0) -> Reference:
    """Mean returns of uniform random actions, and of the controller of the logs without noise.

    Args:
        task: a driving task.
        controller: of its logs.
        episodes: of each.
        seed: of the starts and actions.
    """
    return _between(task, controller, episodes, seed)


def _between(task: Task, controller: Controller, episodes: int, seed: int) -> Reference:
    """Uniform actions as 0 and a controller as 100, in the same episodes."""
    starts, actions = np.random.SeedSequence(seed).spawn(2)
    seeds = [int(s) for s in starts.generate_state(episodes, np.uint64)]
    random = uniform_return(task, seeds, np.random.default_rng(actions))
    expert = float(controlled_returns(task, controller, seeds).mean())
    return Reference(random, expert, f"on this simulator: {episodes} episodes of uniform actions, {episodes} of a controller")


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
    for task in TASKS:
        found = measure(task)
        print(f'    "{task.name}": ({found.random:.4f}, {found.expert:.4f}),')
    for task, controller in ((driving.TASK, pursue), (town.TASK, drive)):
        found = measure_driving(task, controller)
        print(f'    "{task.name}": ({found.random:.4f}, {found.expert:.4f}),')
    if importlib.util.find_spec("libsumo") is not None:
        for task in flow.TASKS:
            found = measure_flow(task)
            print(f'    "{task.name}": ({found.random:.4f}, {found.expert:.4f}),')
    for task in gym_mujoco.TASKS:
        print(f"{task.name}, uniform actions: {uniform_return(task, range(1000), np.random.default_rng(0)):.4f}")
    for task in control.TASKS if importlib.util.find_spec("dm_control") is not None else ():
        print(f'    "{task.name}": {uniform_return(task, range(100), np.random.default_rng(0)):.4f},')


if __name__ == "__main__":
    main()
