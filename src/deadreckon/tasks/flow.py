"""Flow: learners among drivers, who are to keep traffic flowing on a ring and past an on-ramp (thesis 7.3), on SUMO.

SUMO is no part of the default install; it runs in processes of its own (`tasks/flow_world.py`), which end when their
simulator does. There are no servers, no ports and no windows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from deadreckon.data.spec import Box
from deadreckon.tasks.flow_roads import STEP, Road
from deadreckon.tasks.flow_world import ROADS
from deadreckon.tasks.sumo import FEW, Traffic
from deadreckon.tasks.task import Reference, Simulator, Starts, Task, checked_actions, thread_count
from deadreckon.versions import installed


@dataclass(frozen=True)
class Flow(Task):
    """A Flow task. Actions are accelerations in m/s^2; a crash is terminal and pays nothing.

    Attributes:
        road: `ring` or `merge`.
        guarded: SUMO brakes for learners, and holds them back where they would not have the right of way, as in D4RL, so that
            they cannot crash. Without it they can.
    """

    revision: ClassVar[int] = 1

    road: str = ""
    guarded: bool = True

    @property
    def kind(self) -> type[Road]:
        """What is simulated."""
        return ROADS[self.road]

    def start(self, generator: np.random.Generator) -> np.ndarray:
        """All that is random about a new episode."""
        return self.kind.start(generator, self.horizon)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> "FlowSimulator":
        """One copy of the environment for each seed; see `Task.simulate`."""
        return FlowSimulator(self, seeds, threads)

    @property
    def versions(self) -> dict[str, str]:
        """See `Task.versions`: of SUMO."""
        return installed("libsumo")

    def shown(self, simulator: Simulator, observations: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(which, cars, 2) position in m and speed in m/s of all cars by number; see `Task.shown`."""
        assert isinstance(simulator, FlowSimulator)
        out = np.full((len(which), self.cars, 2), np.nan, np.float32)
        rows = simulator.traffic(which)
        out[rows[:, 0].astype(int), rows[:, 1].astype(int)] = rows[:, 2:]
        return out

    @property
    def cars(self) -> int:
        """That take part in an episode."""
        return self.kind.count(self.horizon)

    @property
    def learners(self) -> list[int]:
        """Their numbers among the cars."""
        return self.kind.learners(self.horizon)

    @property
    def seconds(self) -> float:
        """Of a step."""
        return STEP * self.kind.substeps


class FlowSimulator:
    """Copies of one environment; an episode follows from its start and the actions alone, to the last bit."""

    def __init__(self, task: Flow, seeds: Sequence[int], threads: int | None = None):
        self.task, copies = task, len(seeds)
        self._starts = Starts(seeds, task.start)
        processes = min(thread_count(threads, task.name), max(1, copies // FEW))
        self._traffic = Traffic(task, copies, processes)
        size = len(task.start(np.random.default_rng(0)))
        self._begun = np.zeros((copies, size))
        self._taken = np.zeros((copies, task.horizon, task.kind.action_size), np.float32)
        self._age = np.zeros(copies, int)
        self._alive = np.zeros(copies, bool)

    def reset(self, which: np.ndarray | None = None, seeds: Sequence[int] | None = None) -> np.ndarray:
        """Starts episodes; see `Simulator.reset`."""
        which, starts = self._starts.begun(which, seeds)
        self._begun[which] = starts
        self._age[which], self._alive[which] = 0, True
        return self._traffic.begin(which, self._begun[which])

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Applies (copies, size) accelerations, clipped to the bounds; gives observations, rewards, terminals and timeouts.

        A copy whose episode has ended rests until its `reset`: no reward, nothing ends.
        """
        running = np.flatnonzero(self._alive)
        actions = checked_actions(actions, (len(self._age), self.task.kind.action_size), self.task.name, running)
        actions = np.where(self._alive[:, None], actions, np.float32(0.0))
        self._taken[running, self._age[running]] = actions[running]
        seen, rewards, crashed = self._traffic.step(actions)
        self._age += self._alive
        timeouts = self._alive & ~crashed & (self._age >= self.task.horizon)
        over = np.flatnonzero(crashed | timeouts)
        self._alive[over] = False
        if len(over):
            self._traffic.end(over)
        return seen, rewards, crashed, timeouts

    def traffic(self, which: np.ndarray) -> np.ndarray:
        """See `Traffic.look`."""
        return self._traffic.look(which)

    def state(self) -> dict[str, np.ndarray]:
        """See `Simulator.state`. SUMO's own state is left out: it follows from these."""
        return {"begun": self._begun.copy(), "taken": self._taken.copy(), "age": self._age.copy(), "alive": self._alive.copy(),
                **self._starts.state()}  # fmt: skip

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """See `Simulator.restore`. The episodes under way are played again, at most a horizon of steps."""
        self._begun[:], self._taken[:] = state["begun"], state["taken"]
        self._age[:], self._alive[:] = state["age"], state["alive"]
        self._starts.restore(state)
        self._traffic.end(np.arange(len(self._age)))
        ages = np.where(self._alive, self._age, -1)
        for left in range(ages.max(), -1, -1):
            which = np.flatnonzero(ages == left)
            if len(which):
                self._traffic.begin(which, self._begun[which])
            if left:
                running = np.flatnonzero(ages >= left)
                actions = np.zeros((len(ages), self.task.kind.action_size), np.float32)
                actions[running] = self._taken[running, ages[running] - left]
                self._traffic.step(actions)

    def close(self) -> None:
        """Ends SUMO's processes, as losing the simulator does."""
        self._traffic.close()


# ---- the tasks --------------------------------------------------------------------------------------------------------

# Measured on this simulator (SUMO 1.28.0, seed 0): mean returns of 100 episodes of uniform actions (thesis 7.3), and of 100 of
# a controller that calms traffic (Stern et al. 2018). Made by `python -m deadreckon.collect.references`.
_MEASURED = {"flow-ring": (-173.1227, 13.0242), "flow-merge": (116.2687, 271.1366)}
_PUBLISHED = {"flow-ring": (-165.22, 24.42), "flow-merge": (118.67993, 330.03179)}


def _make(road: str, horizon: int, bound: float, summary: str) -> Flow:
    name, kind = f"flow-{road}", ROADS[road]
    random, expert = _MEASURED[name]
    return Flow(
        name=name, domain="flow", horizon=horizon, observation_shape=(kind.observation_size,),
        action_space=Box((-bound,) * kind.action_size, (bound,) * kind.action_size),
        gym_id=f"deadreckon/Flow-{road.title()}-v0",
        reference=Reference(random, expert, "measured on this simulator: uniform actions, a controller that calms traffic"),
        published=Reference(*_PUBLISHED[name], "D4RL"), summary=summary, road=road,
        properties=("non-representable policies", "realistic"), source="Wu et al. 2017",
    )  # fmt: skip


TASKS = (
    _make("ring", 100, 1.0, "drive one of 22 cars on a ring so that all flow; the learner sees only the car ahead"),
    _make("merge", 750, 1.5, "drive five of the cars on a highway past an on-ramp so that all flow"),
)
