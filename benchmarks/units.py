"""What agents learn from a log in people's units: the heated room of `examples/own_environment.py`.

    python benchmarks/units.py [FOLDER]

Each agent learns from 10,000 steps of uniform actions: 3,000 updates, networks of 64 units, 3 seeds, returns of 20 episodes.
"Degrees" are observations as a thermometer shows them, about 25 of them, and "x 1,000" are rewards in another currency; returns
are in the room's own. "As recommend" has the settings with which `deadreckon recommend` tries agents on such a log.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import deadreckon as dr
from deadreckon.agents import agent_class
from deadreckon.collect.in_task import collect_in_task
from deadreckon.data.spec import Box
from deadreckon.runs.candidates import units

AGENTS = "bc", "iql", "awac", "td3_bc", "bear"
STEPS, SEEDS, EPISODES = 3_000, 3, 20
SIZES = {"hidden": (64, 64), "critic_hidden": (64, 64), "behavior_hidden": (64, 64)}


def learned(name: str, log: dr.Dataset, room: str, out: Path, asked: dict[str, Any]) -> str:
    """Mean return over seeds, and the lowest and highest of them."""
    kind = agent_class(name)
    own = {f.name for f in dataclasses.fields(kind)}
    fields = {key: value for key, value in (SIZES | asked).items() if key in own}
    run = dr.train(kind(**fields), log, task=room, steps=STEPS, seeds=SEEDS, episodes=EPISODES, out=out)
    table = run.evaluations.to_pandas()
    last = table[table["step"] == table["step"].max()].groupby("seed")["return"].mean()
    return f"{last.mean():.0f} ({last.min():.0f} to {last.max():.0f})"


def main(folder: Path) -> None:
    """Prints a table, a row for each agent."""
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))
    import own_environment
    from own_environment import DAY, Room

    shown = {"room": (own_environment.MIDDLE, own_environment.UNIT), "degrees": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))}
    scale = dr.tasks.Reference(random=-422.0, expert=-23.0, source="uniform actions, a thermostat")
    logs = {}
    for room in shown:
        own_environment.MIDDLE, own_environment.UNIT = shown[room]
        dr.tasks.register(Room(room, "own", DAY, (3,), Box((0.0,), (1.0,)), f"own/{room}-v0", scale))
        logs[room] = dr.read(collect_in_task(room, steps=10_000, out=folder / f"{room}.hdf5", force=True))
    ways = []
    for room, factor, title in (("room", 1.0, "about 1"), ("degrees", 1.0, "degrees"), ("room", 1000.0, "rewards x 1,000")):
        log = logs[room]
        if factor != 1.0:
            names = "observations", "actions", "terminals", "timeouts", "final_observations", "action_space"
            columns: dict[str, Any] = {each: getattr(log, each) for each in names}
            log = dr.Dataset.from_arrays(**columns, rewards=factor * np.asarray(log.rewards), name=title)
        ways.append((title, room, log, {}))
        if found := units(log.spec):
            ways.append((f"{title}, as recommend", room, log, found))
    print("| agent | " + " | ".join(title for title, *_ in ways) + " |\n|---|" + "---:|" * len(ways), flush=True)
    for name in AGENTS:
        cells = []
        for i, (_, room, log, asked) in enumerate(ways):
            own_environment.MIDDLE, own_environment.UNIT = shown[room]
            cells.append(learned(name, log, room, folder / f"{name}-{i}", asked))
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp()))
