"""What is known of every named log: task, original file, Minari twin, our recipe. Pure data and look-up."""

import difflib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats import minari_ids as minaris
from deadreckon.data.formats.build import TABLE_ENDINGS
from deadreckon.data.formats.io import read
from deadreckon.data.kitchen import KITCHENS, kitchen_goal
from deadreckon.errors import UserError, unknown
from deadreckon.files import home, is_there, read_json
from deadreckon.names import file_part

VERSION = "dr1"  # of our recipes; a log that we collected carries it in its name, so that none passes for the original
ORIGINAL, TWIN = "d4rl", "minari"  # stand where the version would in the names of downloaded logs


@dataclass(frozen=True)
class Entry:
    """One named log.

    Attributes:
        name: D4RL's.
        domain: such as `maze2d`.
        task: where policies learned from it are judged.
        recipe: name that `deadreckon data collect` takes.
        rows: steps in the original, as the thesis' Table D.1 has them; our recipe may take another number. Table D.1 counts the
            v0 files where it says medium-replay, and does not have Ant's, for which this is a round number.
        original: path of D4RL's file below its download root; None where D4RL has no such log.
        minari: id of the Minari twin, which was collected anew and differs.
        version: of our recipe.
        earlier: versions of it that are read where they lie, and that nothing collects any more.
        twin_layout: (width, columns, constants): of the twin's observations, which have this width, these columns are taken
            and these numbers put behind them, so that they are laid out as the original's; None takes them as they are.
        sha256: of the original file, in hexadecimal; D4RL never published any.
        controller: who acts, thesis Table D.1: `planner`, `policy` (random ones and hand-made controllers too) or `human`.
    """

    name: str
    domain: str
    task: str
    recipe: str
    rows: int
    original: str | None
    minari: str | None
    version: str = VERSION
    earlier: tuple[str, ...] = ()
    twin_layout: tuple[int, tuple[int, ...], tuple[float, ...]] | None = None
    sha256: str | None = None
    controller: str = "policy"

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

def _driving(place: str, kind: str) -> Entry:
    name = f"carla-{place}-state{kind}-v0"
    return Entry(name, "carla", f"carla-{place}-state", name, 100_000, None, None)


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
        *(_driving(place, kind) for place in ("lane", "town") for kind in ("", "-noisy", "-uniform")),
    )
}


TWINS = {found.minari: name for name, found in ENTRIES.items() if found.minari is not None}  # by Minari's ids


def version_of(name: str) -> str:
    """The version of our recipe of that name."""
    return ENTRIES[name].version if name in ENTRIES else VERSION


def plain_name(name: str) -> str:
    """The name of the downloaded copy that an id of Minari's means (`hopper-medium-v2@minari`); other names as they are."""
    return f"{TWINS[name]}@{TWIN}" if name in TWINS else name


def entry(name: str) -> Entry:
    """The entry of a log, by D4RL's name, that of a copy (`maze2d-umaze-v1@dr1`, `@d4rl`, `@minari`) or its twin's Minari id.

    Raises:
        UserError: no such name, with the nearest if one is near; or no such copy.
    """
    base, _, version = plain_name(name).partition("@")
    if base not in ENTRIES:
        if not difflib.get_close_matches(base, ENTRIES, 1, 0.5):
            raise UserError(f"no file {name}, and no data set is called so (`deadreckon data list` lists them)")
        raise unknown("data set", base, ENTRIES)
    found = ENTRIES[base]
    if version and version not in (found.version, *found.earlier, *found.sources):
        downloads = "".join(f", {base}@{each} (collected earlier)" for each in found.earlier)
        downloads += "".join(f", {base}@{source} (downloaded)" for source in found.sources)
        raise UserError(f"unknown version {version!r} of {base}: known are {found.collected} (collected){downloads}")
    return found


def cached_path(name: str) -> Path:
    """Where the log `name` is kept, whether it is there or not: a catalogue name means the collected version.

    Raises:
        UserError: the name would lead out of the cache.
    """
    if name.startswith("~") or file_part(name) != name:
        raise UserError(f"{name!r} is no file here and not the name of a log, such as maze2d-umaze-v1")
    if name in ENTRIES:
        name = ENTRIES[name].collected
    return home() / "data" / f"{name}.hdf5"


def record_path(path: Path) -> Path:
    """Where it is recorded what the original at `path`, which is kept byte for byte, was downloaded from."""
    return path.with_suffix(".json")


def at_hand(found: Entry) -> list[str]:
    """Which copies of a log are in the cache, in the order in which `load` takes them: collected, original, twin."""
    return [kind for kind in (found.version, *found.sources) if cached_path(f"{found.name}@{kind}").exists()]


def load(name: Path | str, mmap: bool | None = None, strict: bool = False, **options: Any) -> Dataset:
    """The log `name` from the cache, or the log in the file `name`.

    A plain name such as `hopper-medium-v2` means the first that is there of the log collected by our recipe
    (`hopper-medium-v2@dr1`), the downloaded original (`@d4rl`) and the downloaded Minari twin (`@minari`); what is given
    says in its name which it is. The longer names mean that one copy.

    Args:
        name: from the catalogue, or an existing file or folder, or a Minari id, such as `mujoco/hopper/medium-v0`: of a data
            set that is installed here, else of a twin in the cache.
        mmap: memory-map the columns; see `read`.
        strict: refuse actions out of bounds instead of warning.
        **options: more that `read` takes.

    Raises:
        UserError: one line: no such name, or how the log can be had.
    """
    text = str(name)
    if text.startswith("minari:") or is_there(name) or (text not in ENTRIES and minaris.installed(text)):
        return read(name, mmap=mmap, strict=strict, **options)
    looks_like_a_file = Path(text).suffix in (".hdf5", ".h5", ".npz", ".pickle", ".pkl", ".gz", ".txt", *TABLE_ENDINGS)
    if isinstance(name, Path) or looks_like_a_file:
        raise UserError(f"no file {text}")
    text = plain_name(text)
    if minaris.is_id(text):
        near = difflib.get_close_matches(text, TWINS, 1, 0.8)
        raise unknown("Minari data set", text, TWINS) if near else UserError(minaris.missing(text))
    if text in ENTRIES and (there := at_hand(ENTRIES[text])):
        text = f"{text}@{there[0]}"
    path = cached_path(text)
    if not path.exists():
        raise UserError(_how(entry(text), text.partition("@")[2]))
    if not text.endswith(f"@{ORIGINAL}"):
        return read(path, mmap=mmap, strict=strict, **options)
    return _with_record(read(path, mmap=mmap, strict=strict, **{"name": text, **options}), path)


def _how(found: Entry, version: str) -> str:
    """What can be done about a log that is not there: any copy of it, or the one of that version."""
    gets = [
        f"`deadreckon data get {found.name} --source {source}` downloads {'the original' if source == ORIGINAL else 'a twin'}"
        for source in found.sources
        if version in ("", source)
    ][:1]
    collect = f"`deadreckon data collect {found.recipe}` makes"
    if version == "" and (old := [each for each in found.earlier if cached_path(f"{found.name}@{each}").exists()]):
        return f"{found.name} is here as {found.name}@{old[0]} alone, of an earlier recipe: {collect} {found.collected} offline"
    if version in found.earlier:
        return f"{found.name}@{version} is not here, and is of an earlier recipe: {collect} {found.collected} offline"
    if version in found.sources:
        return f"{found.name}@{version} is not here yet: {gets[0]}, or {collect} {found.collected} offline"
    name = f"{found.name}@{version}" if version else found.name
    return f"{name} is not here yet: {', or '.join([f'{collect} it offline', *gets])}"


def _with_record(log: Dataset, path: Path) -> Dataset:
    """The original read from `path`, with what was recorded when it was downloaded."""
    record = record_path(path)
    about = read_json(record) if record.exists() else None
    if not isinstance(about, dict) or about.get("bytes") != path.stat().st_size:
        text = f"where it came from is not recorded: no {record.name} that fits the file"
        return replace(log, warnings=(*log.warnings, text))
    return replace(log, provenance=replace(log.provenance, extra={**log.provenance.extra, **about}))
