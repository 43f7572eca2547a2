"""An environment of your own, a heated room, in which SAC learns and policies act: `python examples/own_environment.py`.

A task makes a simulator: copies of the environment that are stepped together (`deadreckon.tasks.task` says what each must do).
"""

import numpy as np

import deadreckon as dr
from deadreckon.data.spec import Box
from deadreckon.tasks.task import Starts

DAY = 96  # steps of a quarter of an hour
MIDDLE, UNIT = (20.0, 2.5, 0.5), (5.0, 5.0, 0.3)  # observations about 1 in size; from plain degrees SAC learns hardly anything


class Rooms:  # observations: degrees in the room and outside, time of day; actions: heating
    def __init__(self, seeds):
        self.starts = Starts(seeds, lambda rng: rng.uniform((15.0, -5.0), (25.0, 10.0)))
        self.degrees, self.time = np.zeros((len(seeds), 2)), np.zeros(len(seeds), int)

    def reset(self, which=None, seeds=None):
        which, starts = self.starts.begun(which, seeds)
        self.degrees[which], self.time[which] = starts, 0
        return self.observe()[which]

    def step(self, actions):
        room, outside = self.degrees.T
        self.degrees[:, 0] = room + 0.02 * (outside - room) + actions[:, 0]
        self.time += 1
        reward = -np.abs(self.degrees[:, 0] - 21.0) - 0.5 * actions[:, 0]
        return self.observe(), reward, np.zeros(len(room), bool), self.time >= DAY  # a day times out, nothing ends it

    def observe(self):
        return ((np.column_stack([self.degrees, self.time / DAY]) - MIDDLE) / UNIT).astype(np.float32)

    def state(self):
        return self.starts.state() | {"degrees": self.degrees.copy(), "time": self.time.copy()}

    def restore(self, state):
        self.starts.restore(state)
        self.degrees, self.time = state["degrees"].copy(), state["time"].copy()


class Room(dr.tasks.Task):
    def simulate(self, seeds, threads=None):
        return Rooms(seeds)


def main(steps=20_000, out="runs/own-environment"):
    scale = dr.tasks.Reference(random=-422.0, expert=-23.0, source="uniform actions, a thermostat")  # scores 0 and 100
    dr.tasks.register(Room("room", "own", DAY, (3,), Box((0.0,), (1.0,)), "own/Room-v0", scale))
    run = dr.train_online(dr.agents.SAC(hidden=(64, 64)), "room", steps=steps, out=out)
    print(dr.evaluate(run.policy, "room", episodes=100))


if __name__ == "__main__":
    main()
