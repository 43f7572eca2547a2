"""The process that simulates roads in SUMO; the other end of the pipe is `tasks/sumo.py`."""

import importlib
import os
import signal
import struct
import sys
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from deadreckon.tasks.flow_merge import Merge
from deadreckon.tasks.flow_roads import STEP, Ring, Road

HEAD = struct.Struct("<cQ")  # of a message: what it is, and the bytes that follow
ROADS: dict[str, type[Road]] = {"ring": Ring, "merge": Merge}


class World:
    """Copies of a road in one simulation.

    Args:
        road: among `ROADS`.
        copies: of it.
        horizon: steps of an episode.
        guarded: whether SUMO keeps learners from crashing.
    """

    def __init__(self, road: str, copies: int, horizon: int, guarded: bool):
        self.sumo: Any = importlib.import_module("libsumo")
        kind = ROADS[road]
        place = '<location netOffset="0,0" convBoundary="0,0,1,1" origBoundary="0,0,1,1" projParameter="!"/>'
        with tempfile.TemporaryDirectory() as folder:
            network, types = Path(folder) / "roads.net.xml", Path(folder) / "types.add.xml"
            network.write_text(f'<net version="1.20">\n{place}\n{kind.network(copies)}\n</net>')
            types.write_text(f"<additional>{kind.types()}</additional>")
            options = {
                "net-file": network, "additional-files": types, "step-length": STEP, "xml-validation": "never",
                "no-step-log": True, "no-warnings": True, "no-internal-links": road == "ring", "time-to-teleport": -1,
                "collision.action": "warn", "collision.mingap-factor": 0,
            }  # fmt: skip
            self.sumo.start(["sumo", *(word for key, value in options.items() for word in (f"--{key}", str(value).lower()))])
        self.roads = [kind(self.sumo, copy, horizon, guarded) for copy in range(copies)]

    def begin(self, which: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """(which, observation_size) float32, of new episodes in these copies."""
        for copy, start in zip(which.tolist(), starts):
            self.roads[copy].end()
            self.roads[copy].begin(start)
        return np.array([self.roads[copy].observe() for copy in which.tolist()], np.float32)

    def end(self, which: np.ndarray) -> None:
        """Takes the cars of these copies away."""
        for copy in which.tolist():
            self.roads[copy].end()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Takes (copies, action_size) accelerations in m/s^2; gives float32 observations and rewards, and uint8 crashes.

        Copies without cars rest: zeros.
        """
        copies = len(self.roads)
        seen = np.zeros((copies, self.roads[0].observation_size), np.float32)
        rewards, crashed = np.zeros(copies, np.float32), np.zeros(copies, np.uint8)
        running = [road for road in self.roads if road.running]
        for _ in range(self.roads[0].substeps):
            for road in running:
                road.drive(actions[road.copy])
            self.sumo.simulationStep()
            for car in self.sumo.simulation.getDepartedIDList():
                self._road(car).departed(car)
            for car in self.sumo.simulation.getArrivedIDList():
                self._road(car).arrived(car)
            for car in self.sumo.simulation.getCollidingVehiclesIDList():
                crashed[self._road(car).copy] = True
        for road in running:
            seen[road.copy] = road.observe()
            if not crashed[road.copy]:
                rewards[road.copy] = road.reward(actions[road.copy])
        return seen, rewards, crashed

    def _road(self, car: str) -> Road:
        return self.roads[int(car.split(".", 1)[0])]

    def traffic(self, which: np.ndarray) -> np.ndarray:
        """(cars, 4) float64 position in `which`, number of the car, its position in m, and its speed in m/s."""
        roads = [(i, self.roads[copy]) for i, copy in enumerate(which.tolist())]
        rows = [(i, *car) for i, road in roads if road.running for car in road.traffic()]
        return np.array(rows, np.float64).reshape(-1, 4)


def read(stream: IO[bytes]) -> tuple[bytes, bytes] | None:
    """A message: a letter and what follows it; None where the stream has ended."""
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    letter, size = HEAD.unpack(head)
    body = stream.read(size)
    return (letter, body) if len(body) == size else None


def write(stream: IO[bytes], letter: bytes, *arrays: np.ndarray) -> None:
    """Sends a message; see `read`."""
    body = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    stream.write(HEAD.pack(letter, len(body)) + body)
    stream.flush()


def serve(road: str, copies: int, horizon: int, guarded: bool) -> None:
    """Simulates what standard input asks for until it ends, as it does when whoever asks is gone, however they went."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever asks
    asked = sys.stdin.buffer
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libsumo prints is no answer
    world = World(road, copies, horizon, guarded)
    kind = ROADS[road]
    while (message := read(asked)) is not None:
        letter, body = message
        if letter == b"S":
            write(answers, b"S", *world.step(np.frombuffer(body, np.float32).reshape(copies, kind.action_size)))
            continue
        count = int(np.frombuffer(body, np.int64, 1)[0])
        which = np.frombuffer(body, np.int64, count, offset=8)
        if letter == b"B":
            write(answers, b"B", world.begin(which, np.frombuffer(body, np.float64, offset=8 * (1 + count)).reshape(count, -1)))
        elif letter == b"E":
            world.end(which)
            write(answers, b"E")
        elif letter == b"T":
            write(answers, b"T", world.traffic(which))
