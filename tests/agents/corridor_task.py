"""The corridor of `worlds.corridor` as a simulator, in which agents act and are judged."""

from dataclasses import dataclass

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.tasks.task import Reference, Starts, Task


@dataclass(frozen=True)
class Corridor(Task):
    """A point on a line, see `Points`."""

    def simulate(self, seeds, threads=None):
        return Points(self, seeds)


class Points:
    """s' = s + 0.2 a, reward -s'^2, from anywhere within 1 of the middle; episodes of 20 steps."""

    def __init__(self, task, seeds):
        self.task = task
        self.starts = Starts(seeds, lambda generator: generator.uniform(-1, 1))
        self.place = np.zeros(len(seeds))
        self.age = np.zeros(len(seeds), int)

    def reset(self, which=None, seeds=None):
        which = np.arange(len(self.age)) if which is None else which
        if seeds is not None:
            self.starts.begin(which, seeds)
        self.place[which] = [self.starts.next(i) for i in which]
        self.age[which] = 0
        return self.place[which, None].astype(np.float32)

    def step(self, actions):
        self.place = np.clip(self.place + 0.2 * np.clip(actions[:, 0], -1, 1), -2, 2)
        self.age += 1
        never = np.zeros(len(self.age), bool)
        return self.place[:, None].astype(np.float32), -(self.place**2).astype(np.float32), never, self.age >= self.task.horizon

    def state(self):
        return {"place": self.place.copy(), "age": self.age.copy(), **self.starts.state()}

    def restore(self, state):
        self.starts.restore(state)
        self.place, self.age = state["place"].copy(), state["age"].copy()


# Scores: 0 stays where it begins, 20 times a mean square of 1/3; 100 goes to the middle as fast as can be, which from s >= 0 is
# the sum over k of max(s - 0.2 k, 0)^2, on average (0.8^3 + 0.6^3 + 0.4^3 + 0.2^3) / 3.
CORRIDOR = Corridor("corridor", "toy", 20, (1,), Box((-1.0,), (1.0,)), "", Reference(-20.0 / 3.0, -0.8 / 3.0, "by hand"))
