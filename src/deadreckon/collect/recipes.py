"""The recipes by name. A domain adds its own with `register`."""

import dataclasses
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from deadreckon.data.catalogue import ENTRIES, VERSION, cached_path, entry
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError, unknown
from deadreckon.files import alone
from deadreckon.policies.library import about, library_tasks
from deadreckon.progress import Progress
from deadreckon.tasks import adroit, antmaze, flow, gym_mujoco, kitchen, maze2d, registry
from deadreckon.tasks.adroit import Adroit
from deadreckon.tasks.antmaze import AntMaze
from deadreckon.tasks.flow import Flow
from deadreckon.tasks.gym_mujoco import GymMujoco
from deadreckon.tasks.kitchen import Kitchen
from deadreckon.tasks.maze2d import Maze2D
from deadreckon.tasks.task import Task


class Maker(Protocol):
    """What makes a recipe's log; see `collect_maze2d` and `collect_gym`."""

    def __call__(
        self, *, name: str, steps: int, seed: int, threads: int | None, scratch: Path, progress: Progress | None
    ) -> Dataset:
        """Collects `steps` rows; they must not depend on `threads`.

        What takes long keeps what it has in the folder `scratch`, and goes on with what it finds there. The log's columns
        may lie there too.
        """
        ...


@dataclass(frozen=True)
class Recipe:
    """How to make one log.

    Attributes:
        name: the original's name, such as `maze2d-umaze-v1`; the log made is `maze2d-umaze-v1@dr1`.
        task: name of the task whose simulator and reward it uses.
        steps: rows of the full log.
        make: what makes it.
        summary: one line on what acts in it.
    """

    name: str
    task: str
    steps: int
    make: Maker
    summary: str = ""


_RECIPES: dict[str, Recipe] = {}


def recipe(name: str) -> Recipe:
    """The recipe of that name (`@dr1` behind it is allowed).

    Raises:
        UserError: there is none; the message names the nearest.
    """
    try:
        return _RECIPES[name.removesuffix(f"@{VERSION}")]
    except KeyError:
        raise unknown("recipe", name, _RECIPES) from None


def recipe_names() -> list[str]:
    """All recipes' names, in the order in which they were registered."""
    return list(_RECIPES)


def register(recipe: Recipe) -> None:
    """Adds a recipe."""
    if recipe.name in _RECIPES:
        raise UserError(f"recipe {recipe.name!r} is registered already")
    _RECIPES[recipe.name] = recipe


def generate(
    name: str, *, steps: int | None = None, seed: int = 0, threads: int | None = None, progress: Progress | None = None
) -> Dataset:
    """Makes a log in memory.

    Args:
        name: of the recipe.
        steps: rows; those of the full log if None.
        seed: random seed.
        threads: to simulate with; all cores if None. The log does not depend on it.
        progress: called now and then with the rows done and the rows in all.
    """
    with tempfile.TemporaryDirectory() as scratch:
        made = _make(recipe(name), steps, seed, threads, Path(scratch), progress)
        return made.loaded()


def _make(
    found: Recipe, steps: int | None, seed: int, threads: int | None, scratch: Path, progress: Progress | None
) -> Dataset:
    steps = found.steps if steps is None else steps
    if steps < 1:
        raise UserError(f"{found.name}: steps must be 1 or more, got {steps}")
    if not 0 <= seed < 2**32:
        raise UserError(f"{found.name}: seed must be 0 .. 2^32 - 1, got {seed}")
    made = found.make(name=found.name, steps=steps, seed=seed, threads=threads, scratch=scratch, progress=progress)
    return dataclasses.replace(made, name=collected_name(found, steps, seed))


def collect(
    name: str,
    *,
    steps: int | None = None,
    seed: int = 0,
    out: Path | str | None = None,
    threads: int | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Makes a log and writes it as an HDF5 file with D4RL's column names.

    Recipes that take long keep what they have in a hidden folder beside the file, so that after a kill the same command
    goes on where it was.

    Args:
        name: of the recipe, such as `maze2d-umaze-v1`.
        steps: rows; those of the full log if None.
        seed: random seed.
        out: the file; if None, the place in the cache where `deadreckon.load` finds it (see `default_path`).
        threads: to simulate with; all cores if None. The log does not depend on it.
        force: replace a file that is there.
        progress: called now and then with the rows done and the rows in all.

    Returns:
        The file's path. It is written whole or not at all. A log that lies in the cache already is not made again.

    Raises:
        UserError: an unknown recipe, or a file `out` that is there already.
    """
    from deadreckon.data.formats.hdf5 import write_hdf5

    found = recipe(name)
    path = Path(out) if out is not None else default_path(found, steps, seed)
    if path.exists() and not force:
        if out is not None:
            raise UserError(f"{path} is there already; --force (force=True) replaces it")
        return path
    scratch = path.parent / f".{path.name}.part"
    with alone(path):
        write_hdf5(_make(found, steps, seed, threads, scratch, progress), path)
        shutil.rmtree(scratch, ignore_errors=True)
    return path


def collected_name(found: Recipe, steps: int | None, seed: int) -> str:
    """What a collected log is called. A part or another seed has it in its name: it never passes for the full log."""
    part = f"-{steps}-steps" if steps is not None and steps != found.steps else ""
    other = f"-seed-{seed}" if seed else ""
    return f"{found.name}@{VERSION}{part}{other}"


def default_path(found: Recipe, steps: int | None, seed: int) -> Path:
    """Where `collect` writes by default."""
    return cached_path(collected_name(found, steps, seed))


# ---- Maze2D -----------------------------------------------------------------------------------------------------------


def _maze2d(task: Maze2D) -> Recipe:
    def make(
        *, name: str, steps: int, seed: int, threads: int | None, scratch: Path, progress: Progress | None
    ) -> Dataset:
        from deadreckon.collect.maze2d import collect_maze2d

        return collect_maze2d(task, name=name, steps=steps, seed=seed, threads=threads, progress=progress)

    known = entry(f"{task.name}-v1")
    return Recipe(known.recipe, task.name, known.rows, make, "waypoints of a planner to random targets, PD control")


for _task in maze2d.TASKS:
    assert registry.task(_task.name) is _task
    register(_maze2d(_task))


# ---- Gym-MuJoCo -------------------------------------------------------------------------------------------------------

_GYM = {
    "random": "a randomly initialised policy",
    "uniform": "actions drawn uniformly between the bounds",
    "medium": "SAC, stopped early",
    "expert": "SAC, the best of its run",
    "medium-expert": "first medium, then expert",
    "uniform-expert": "first uniform actions, then expert",
    "medium-replay": "all that SAC did until medium, by training again",
}


def _gym(task: GymMujoco, kind: str, summary: str) -> Recipe:
    def make(
        *, name: str, steps: int, seed: int, threads: int | None, scratch: Path, progress: Progress | None
    ) -> Dataset:
        from deadreckon.collect.gym import collect_gym, collect_replay

        options = {"name": name, "steps": steps, "seed": seed, "threads": threads, "scratch": scratch, "progress": progress}
        return collect_replay(task, **options) if kind == "medium-replay" else collect_gym(task, kind, **options)

    known = entry(f"{task.name}-{kind}-v2")
    # The replay buffer is as long as our own run took to get to medium, whatever the original's length.
    ours = kind == "medium-replay" and task.name in library_tasks()
    rows = about(task.name)["medium_replay"]["environment_steps"] if ours else known.rows
    return Recipe(known.recipe, task.name, rows, make, summary)


for _task in gym_mujoco.TASKS:
    for _kind, _summary in _GYM.items():
        if f"{_task.name}-{_kind}-v2" in ENTRIES:
            register(_gym(_task, _kind, _summary))


def _of_the_catalogue(name: str, task: Task, make: Maker, summary: str) -> Recipe:
    """The recipe of a log that the catalogue has, with as many rows."""
    known = entry(name)
    return Recipe(known.recipe, task.name, known.rows, make, summary)


# ---- Flow -------------------------------------------------------------------------------------------------------------

_FLOW = {"random": "accelerations drawn uniformly between the bounds", "controller": "the intelligent driver model"}


def _flow(task: Flow, kind: str, summary: str) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.flow import collect_flow

        return collect_flow(task, kind, **options)

    return _of_the_catalogue(f"{task.name}-{kind}-v0", task, make, summary)


for _task in flow.TASKS:
    for _kind, _summary in _FLOW.items():
        register(_flow(_task, _kind, _summary))


# ---- Adroit -----------------------------------------------------------------------------------------------------------

_ADROIT = {
    "human": "people: 25 demonstrations",
    "cloned": "half people, over and over, half a clone of them by behaviour cloning",
    "expert": "the policy that DAPG trained",
}


def _adroit(task: Adroit, kind: str, summary: str) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.adroit import collect_adroit

        return collect_adroit(task, kind, **options)

    return _of_the_catalogue(f"{task.name}-{kind}-v1", task, make, summary)


for _task in adroit.TASKS:
    for _kind, _summary in _ADROIT.items():
        register(_adroit(_task, _kind, _summary))


# ---- FrankaKitchen ----------------------------------------------------------------------------------------------------

_KITCHEN = {
    "complete": "a scripted demonstrator: the four sub-tasks in order, always with success",
    "partial": "a scripted demonstrator: four sub-tasks of six at random, in one episode of four the task's",
    "mixed": "a scripted demonstrator: four sub-tasks of six at random, never all of the task's",
}


def _kitchen(task: Kitchen, summary: str) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.kitchen import collect_kitchen

        return collect_kitchen(task, **options)

    return _of_the_catalogue(f"{task.name}-v0", task, make, summary)


for _task in kitchen.TASKS:
    register(_kitchen(_task, _KITCHEN[_task.name.removeprefix("kitchen-")]))


# ---- AntMaze ----------------------------------------------------------------------------------------------------------

_ANTMAZE = {
    "play": "a planner's waypoints to hand-picked cells, one after the other, from anywhere; a walker with noise",
    "diverse": "a planner's waypoints to random cells, one after the other, from anywhere; a walker with noise",
}


def _antmaze(task: AntMaze) -> Recipe:
    def make(**options: Any) -> Dataset:
        from deadreckon.collect.antmaze import collect_antmaze

        return collect_antmaze(task, **options)

    summary = _ANTMAZE.get(task.name.rsplit("-", 1)[1], "a planner's waypoints from the start to the goal; a walker with noise")
    return _of_the_catalogue(f"{task.name}-v2", task, make, summary)


for _task in antmaze.TASKS:
    register(_antmaze(_task))
