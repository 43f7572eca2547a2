"""Every named log: task, original file, Minari twin, our recipe. Pure data; `catalogue` looks things up in it."""

from dataclasses import dataclass

from deadreckon.data.formats.flat_pictures import CARLA_FILES
from deadreckon.data.kitchen import KITCHENS, kitchen_goal

VERSION = "dr1"  # of our recipes; a log that we collected carries it in its name, so that none passes for the original
ORIGINAL, TWIN = "d4rl", "minari"  # stand where the version would in the names of downloaded logs


@dataclass(frozen=True)
class Entry:
    """One named log.

    Attributes:
        name: D4RL's.
        domain: such as `maze2d`.
        task: where policies learned from it are judged; None where that is a server's, which has to be named.
        recipe: name that `deadreckon data collect` takes; None where there is no recipe.
        rows: steps in the original, as the thesis' Table D.1 has them; our recipe may take another number. Table D.1 counts the
            v0 files where it says medium-replay, and does not have Ant's, for which this is a round number. None: not known.
        original: path of D4RL's file below its download root; None where D4RL has no such log.
        minari: id of the Minari twin, which was collected anew and differs.
        version: of our recipe.
        earlier: versions of it that are read where they lie, and that nothing collects any more.
        twin_layout: (width, columns, constants): of the twin's observations, which have this width, these columns are taken
            and these numbers put behind them, so that they are laid out as the original's; None takes them as they are.
        sha256: of the original file, in hexadecimal; D4RL never published any.
        controller: who acts, thesis Table D.1: `planner`, `policy` (random ones and hand-made controllers too) or `human`.
        elsewhere: whether the original is of another world than the task.
    """

    name: str
    domain: str
    task: str | None
    recipe: str | None
    rows: int | None
    original: str | None
    minari: str | None
    version: str = VERSION
    earlier: tuple[str, ...] = ()
    twin_layout: tuple[int, tuple[int, ...], tuple[float, ...]] | None = None
    sha256: str | None = None
    controller: str = "policy"
    elsewhere: bool = False

    @property
    def collected(self) -> str:
        """The name of the log as our recipe collects it."""
        return f"{self.name}@{self.version}"

    @property
    def sources(self) -> tuple[str, ...]:
        """Where it can be downloaded from: `d4rl`, `minari`, both or neither."""
        known = ((ORIGINAL, self.original), (TWIN, self.minari))
        return tuple(source for source, place in known if place is not None)


def _maze2d(size: str, rows: int, dense: bool) -> Entry:
    middle = "-dense" if dense else ""
    name = f"maze2d-{size}{middle}-v1"
    file = name if dense else f"maze2d-{size}-sparse-v1"
    twin = None if size.startswith("eval-") else f"D4RL/pointmaze/{size}{middle}-v2"
    return Entry(name, "maze2d", f"maze2d-{size}{middle}", name, rows, f"maze2d/{file}.hdf5", twin, controller="planner")


# Rows: thesis Table D.1. The original has logs of the evaluation mazes too, though no Minari twin does.
_MAZES = tuple(
    (f"{split}{size}", rows)
    for split in ("", "eval-")
    for size, rows in (("umaze", 1_000_000), ("medium", 2_000_000), ("large", 4_000_000))
)
_ROBOTS = {"hopper": 200_920, "halfcheetah": 101_000, "walker2d": 100_930, "ant": 100_000}  # rows of medium-replay
_POLICIES = ("random", "medium", "expert", "medium-replay", "medium-expert")
_OURS = ("uniform", "uniform-expert")  # kinds that the thesis speaks of (A.4, 7.3) and D4RL has no files of


def _gym(robot: str, policy: str) -> Entry:
    name = f"{robot}-{policy}-v2"
    rows = _ROBOTS[robot] if policy == "medium-replay" else 2_000_000 if policy.endswith("-expert") else 1_000_000
    file = None if policy in _OURS or robot not in _ROBOTS else f"gym_mujoco_v2/{robot}_{policy.replace('-', '_')}-v2.hdf5"
    # Minari's `simple` logs are those of a weak policy, not of a random one.
    twin = f"mujoco/{robot}/{policy}-v0" if policy in ("medium", "expert") and file else None
    # Ant's contact forces, which the twin observes, were zero in the originals.
    layout = (105, tuple(range(27)), (0.0,) * 84) if robot == "ant" and twin else None
    return Entry(name, "gym", robot, name, rows, file, twin, twin_layout=layout)


def _flow(road: str, kind: str) -> Entry:
    name = f"flow-{road}-{kind}-v0"
    file = f"flow/flow-{road}-v0-{'idm' if kind == 'controller' else kind}.hdf5"
    return Entry(name, "flow", f"flow-{road}", name, 1_000_000, file, None)


# Rows: thesis Table D.1.
_HUMAN = {"pen": 5_000, "hammer": 11_310, "door": 6_729, "relocate": 9_942}


def _adroit(task: str, kind: str) -> Entry:
    name = f"{task}-{kind}-v1"
    rows = _HUMAN[task] if kind == "human" else 500_000 if task == "pen" else 1_000_000
    return Entry(name, "adroit", task, name, rows, f"hand_dapg_v1/{name}.hdf5", f"D4RL/{task}/{kind}-v2")


_KITCHEN = {  # rows, and D4RL's file
    "complete": (3_680, "mini_kitchen_microwave_kettle_light_slider-v0"),
    "partial": (136_950, "kitchen_microwave_kettle_light_slider-v0"),
    "mixed": (136_950, "kitchen_microwave_kettle_bottomburner_light-v0"),
}
# Minari's twins show positions (9), velocities (9), the kitchen's positions (21) and velocities (20), and the goal elsewhere;
# the originals positions and the goal.
_POSITIONS = (*range(9), *range(18, 39))


def _kitchen(kind: str) -> Entry:
    rows, file = _KITCHEN[kind]
    name = f"kitchen-{kind}-v0"
    twin, layout = f"D4RL/kitchen/{kind}-v2", (59, _POSITIONS, kitchen_goal(KITCHENS[f"kitchen-{kind}"]))
    # dr1 paid once for each sub-task, as the task does, and had timeouts where demonstrations end.
    return Entry(
        name, "kitchen", f"kitchen-{kind}", name, rows, f"kitchen/{file}.hdf5", twin, version="dr2", earlier=("dr1",),
        twin_layout=layout,
    )  # fmt: skip


# D4RL's own words for the mazes in the names of its files.
_ANT_FILES = {"umaze": "u-maze", "medium": "big-maze", "large": "hardest-maze"}


def _antmaze(maze: str, kind: str) -> Entry:
    name = "-".join(filter(None, ("antmaze", maze, kind)))
    several = f"multistart_{kind != ''}_multigoal_{kind == 'diverse'}_sparse"
    words = _ANT_FILES.get(maze)  # D4RL lists no files of the evaluation mazes
    file = f"ant_maze_v2/Ant_maze_{words}_noisy_{several}_fixed.hdf5" if words else None
    return Entry(f"{name}-v2", "antmaze", name, f"{name}-v2", 1_000_000, file, None, controller="planner")


_ANTS = tuple(
    (f"{split}{maze}", kind)
    for split in ("", "eval-")
    for maze, kinds in (("umaze", ("", "diverse")), ("medium", ("play", "diverse")), ("large", ("play", "diverse")))
    for kind in kinds
)

_DRIVERS = ("", "-noisy", "-uniform")


def _carla(task: str, kind: str) -> Entry:
    name, who = f"{task}{kind}-v0", "planner" if kind in ("", "-full") else "policy"
    file = f"carla/{CARLA_FILES[name]}.hdf5" if name in CARLA_FILES else None
    place = (task, name, 100_000) if kind != "-full" else (None, None, None)  # the town's file is a part of that one
    return Entry(name, "carla", *place, file, None, controller=who, elsewhere=bool(file))


# Rows of RL Unplugged's logs: thesis Table 8.1. They are not D4RL's, and no file of theirs is read.
_CONTROL = {
    "cartpole-swingup": 40_000, "cheetah-run": 300_000, "finger-turn-hard": 500_000, "fish-swim": 200_000,
    "humanoid-run": 3_000_000, "manipulator-insert-ball": 1_500_000, "manipulator-insert-peg": 1_500_000,
    "walker-stand": 200_000, "walker-walk": 200_000,
}  # fmt: skip


def _control(task: str) -> Entry:
    name = f"{task}-full-replay-v0"
    return Entry(name, "control", task, name, _CONTROL[task], None, None)


ENTRIES: dict[str, Entry] = {
    entry.name: entry
    for entry in (
        *(_maze2d(size, rows, dense) for dense in (False, True) for size, rows in _MAZES),
        *(_gym(robot, policy) for robot in _ROBOTS for policy in (*_POLICIES, *_OURS)),
        *(_gym("humanoid", policy) for policy in ("medium", "uniform")),  # thesis Figure 4.4; never among D4RL's
        *(_flow(road, kind) for road in ("ring", "merge") for kind in ("random", "controller")),
        *(_adroit(task, kind) for task in _HUMAN for kind in ("human", "cloned", "expert")),
        *map(_kitchen, _KITCHEN),
        *(_antmaze(maze, kind) for maze, kind in _ANTS),
        *(_carla(f"carla-{place}{seen}", kind) for place in ("lane", "town") for seen in ("-state", "") for kind in _DRIVERS),
        _carla("carla-town", "-full"),
        *map(_control, _CONTROL),
    )
}


def task_of(name: str) -> str | None:
    """The task of a log of the catalogue, by the log's name; None for other logs, and for originals of another world."""
    base, _, version = name.partition("@")
    found = ENTRIES.get(base)
    return None if found is None or (found.elsewhere and version == ORIGINAL) else found.task


def has_original(name: str) -> bool:
    """Whether a benchmark has published files of this log, or nobody knows since it is not in the catalogue."""
    return name not in ENTRIES or bool(ENTRIES[name].sources)
